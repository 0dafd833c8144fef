// The model's map of two parameters, with its uncertainty, and sliders for the other parameters.

import { button, choice, element, layer, svg } from "./dom.js";
import { css, ofChance } from "./colours.js";
import { count, named, percent, readable, shown, ticks } from "./data.js";

const LEFT = 76, RIGHT = 14, TOP = 12, BOTTOM = 46, CELLS = 56;

export class ModelMap {
  constructor(parent, explorer) {
    this.explorer = explorer;
    this.settings = new Map();
    this.across = choice("Horizontal", [], "", (at) => this.show(explorer.data.columns[at], this.up));
    this.upward = choice("Vertical", [], "", (at) => this.show(this.horizontal, explorer.data.columns[at]));
    this.mode = choice("Show", [["chance", "chance of success"], ["width", "uncertainty"]], "chance", () => this.compute());
    this.runs = choice("Run", [], 0, (run) => this.use(Number(run)));
    this.stage = element("div", { class: "x-plot" });
    this.picture = layer(this.stage);
    this.overlay = svg("svg", { class: "x-overlay", role: "application", tabindex: 0 });
    this.reading = element("p", { class: "x-reading", "aria-live": "polite" });
    this.quality = element("p", { class: "x-quality" });
    this.ramp = element("i");
    this.ends = [element("span"), element("span")];
    this.scale = element("p", { class: "x-ramp", "aria-hidden": "true" }, this.ends[0], this.ramp, this.ends[1]);
    this.sliders = element("div", { class: "x-sliders" });
    this.middle = button("Set to the medians of the selection", () => this.centre());
    this.others = element("details", { class: "x-others", open: true }, element("summary", {}, "Other parameters"), this.sliders, this.middle);
    this.stage.append(this.overlay);
    this.bar = element("div", { class: "x-bar" }, this.across.root, this.upward.root, this.mode.root, this.runs.root, this.scale);
    parent.append(
      this.bar,
      this.stage, this.reading, this.others, this.quality,
    );
    new ResizeObserver(() => this.layout()).observe(this.stage);
    this.overlay.addEventListener("pointermove", (event) => {
      const box = this.overlay.getBoundingClientRect();
      const place = [(event.clientX - box.left - LEFT) / (this.width - LEFT - RIGHT), (this.height - BOTTOM - event.clientY + box.top) / (this.height - TOP - BOTTOM)];
      if (place.every((p) => p >= 0 && p <= 1)) this.read(place);
    });
    this.overlay.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      if (!by || !this.model) return;
      event.preventDefault();
      const cells = this.cells;
      const here = this.cursor ?? [0.5, 0.5];
      this.read(here.map((p, i) => Math.min(1 - 0.5 / cells[i], Math.max(0.5 / cells[i], p + by[i] / cells[i]))));
    });
  }

  /** Takes a model of a run, or the reason why there is none. */
  take(models) {
    this.models = models;
    this.runs.fill(this.explorer.data.runs.map((run, at) => [at, run.name]), this.run ?? 0);
    this.runs.root.hidden = models.length < 2;
    this.use(this.run ?? Math.max(0, models.findIndex(Boolean)));
  }

  use(run) {
    this.run = run;
    this.model = this.models[run] ?? null;
    const because = this.explorer.reasons[run];
    this.stage.hidden = this.others.hidden = this.reading.hidden = !this.model;
    for (const part of [this.across.root, this.upward.root, this.mode.root, this.scale]) part.hidden = !this.model;
    this.quality.textContent = this.model ? this.judged() : because ? `No model: ${because}.` : "The model is being fitted …";
    if (!this.model) {
      this.reading.textContent = "";
      return;
    }
    const { data } = this.explorer;
    this.parameters = this.model.columns.map((at) => data.columns[at]);
    const usable = this.parameters.filter((column) => column.kind === "category" ? column.levels.length > 1 : data.varies(column));
    const options = usable.map((column) => [column.at, named(column)]);
    const [x, y] = this.pair(usable);
    this.across.fill(options, x?.at);
    this.upward.fill(options, y?.at);
    for (const column of this.parameters) if (!this.settings.has(column)) this.settings.set(column, this.median(column, () => true));
    if (x && y) this.show(x, y);
  }

  /** The pair that is shown: the present one, or the two numbers along which the model changes most. */
  pair(usable) {
    if (usable.includes(this.horizontal) && usable.includes(this.up)) return [this.horizontal, this.up];
    const { data } = this.explorer;
    for (const column of this.parameters) this.model.set(column.at, this.median(column, () => true));
    const effect = (column) => {
      const values = [0.05, 0.35, 0.65, 0.95].map((p) => {
        this.model.set(column.at, column.kind === "category" ? Math.round(data.value(column, p)) : data.value(column, p));
        return this.model.chance();
      });
      this.model.set(column.at, this.median(column, () => true));
      return Math.max(...values) - Math.min(...values);
    };
    const strong = usable.map((column) => [column, effect(column) + (column.kind === "category" ? -1 : 0)]).sort((a, b) => b[1] - a[1]);
    return [strong[0]?.[0], strong[1]?.[0] ?? strong[0]?.[0]];
  }

  /** How well the model predicts episodes that it was not fitted to. */
  judged() {
    const { brier, brier_of_rate: rate, rows, valid } = this.model.document;
    const gain = rate > 0 ? Math.max(0, 1 - brier / rate) : 0;
    const part = rows < valid ? `${count(rows)} of ${count(valid)} valid episodes` : `${count(rows)} valid episodes`;
    return `Ridge logistic regression on splines and products, fitted to ${part}. On episodes left out of the fit it removes ${percent(gain)} of the ` +
      `squared error of the plain rate (Brier score ${brier.toFixed(3)} against ${rate.toFixed(3)}). The band is where its 95 % interval contains 50 %.`;
  }

  median(column, keep) {
    const { data } = this.explorer;
    const values = [];
    const every = Math.max(1, Math.floor(data.rows / 20000));
    for (let row = 0; row < data.rows; row += every) if (keep(row) && column.values[row] === column.values[row]) values.push(column.values[row]);
    if (values.length === 0) return column.kind === "category" ? 0 : data.value(column, 0.5);
    if (column.kind === "category") {
      const counts = new Map();
      for (const value of values) counts.set(value, (counts.get(value) ?? 0) + 1);
      return [...counts].sort((a, b) => b[1] - a[1])[0][0];
    }
    values.sort((a, b) => a - b);
    return values[values.length >> 1];
  }

  centre() {
    const { selection } = this.explorer;
    for (const column of this.parameters) this.settings.set(column, this.median(column, (row) => selection.has(row)));
    this.show(this.horizontal, this.up);
  }

  show(x, y) {
    if (x === y) y = this.parameters.find((column) => column !== x && this.explorer.data.varies(column)) ?? y;
    [this.horizontal, this.up] = [x, y];
    this.across.select.value = x.at;
    this.upward.select.value = y.at;
    this.cursor = null;
    this.slide();
    this.layout();
  }

  /** A slider or a list for each parameter that is on no axis. */
  slide() {
    const { data } = this.explorer;
    const others = this.parameters.filter((column) => column !== this.horizontal && column !== this.up && (column.kind === "category" ? column.levels.length > 1 : data.varies(column)));
    this.others.hidden = others.length === 0;
    this.sliders.replaceChildren(...others.map((column) => {
      const value = this.settings.get(column);
      if (column.kind === "category") {
        const select = element("select", { onchange: () => this.set(column, Number(select.value)) }, ...column.levels.map((level, at) => new Option(readable(level), at, false, at === value)));
        return element("label", { class: "x-slider" }, element("span", {}, column.label), select);
      }
      const output = element("output", {}, `${shown(column, value)} ${column.unit}`);
      const slider = element("input", {
        type: "range", min: 0, max: 1, step: column.kind === "integer" ? 1 / Math.max(1, data.range(column)[1] - data.range(column)[0]) : 0.002, value: data.place(column, value),
        oninput: () => {
          const raw = data.value(column, Number(slider.value));
          const now = column.kind === "integer" ? Math.round(raw) : raw;
          output.textContent = `${shown(column, now)} ${column.unit}`;
          slider.setAttribute("aria-valuetext", output.textContent);
          this.set(column, now);
        },
      });
      return element("label", { class: "x-slider" }, element("span", {}, column.label), slider, output);
    }));
  }

  set(column, value) {
    this.settings.set(column, value);
    this.compute();
  }

  layout() {
    const width = Math.floor(this.stage.clientWidth), height = Math.floor(this.stage.clientHeight);
    if (width < 50 || height < 50 || !this.model) return;
    [this.width, this.height] = [width, height];
    this.picture.resize(width, height, Math.min(2, devicePixelRatio || 1));
    this.overlay.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.compute();
  }

  /** Requests the picture for the next frame. */
  compute() {
    this.stale = true;
    this.explorer.wake();
  }

  step() {
    if (this.stale && this.model && this.width) this.draw();
    this.stale = false;
    return true;
  }

  draw() {
    const { data } = this.explorer;
    const { model, horizontal: x, up: y } = this;
    const size = (column) => (column.kind === "category" ? column.levels.length : CELLS);
    const [nx, ny] = (this.cells = [size(x), size(y)]);
    for (const [column, value] of this.settings) model.set(column.at, value);
    const at = (column, i, n) => (column.kind === "category" ? i : data.value(column, (i + 0.5) / n));
    const chance = (this.chance = new Float64Array(nx * ny)), low = (this.low = new Float64Array(nx * ny)), high = (this.high = new Float64Array(nx * ny));
    for (let j = 0; j < ny; j++) {
      model.set(y.at, at(y, j, ny));
      for (let i = 0; i < nx; i++) {
        model.set(x.at, at(x, i, nx));
        [chance[j * nx + i], low[j * nx + i], high[j * nx + i]] = model.interval();
      }
    }
    const { context, canvas } = this.picture;
    const image = new ImageData(nx, ny);
    const widths = this.mode.select.value === "width";
    for (let j = 0; j < ny; j++) {
      for (let i = 0; i < nx; i++) {
        const k = j * nx + i, to = 4 * ((ny - 1 - j) * nx + i);
        const colour = widths ? ofChance(0.5 - 0.5 * Math.min(1, high[k] - low[k])) : ofChance(chance[k]);
        image.data.set([...colour, 255], to);
      }
    }
    const stops = Array.from({ length: 11 }, (_, i) => css(ofChance(widths ? 0.05 * (10 - i) : 0.1 * i)));
    this.ramp.style.background = `linear-gradient(90deg, ${stops.join(", ")})`;
    this.ends[0].textContent = widths ? "certain" : "0 %";
    this.ends[1].textContent = widths ? "100 points wide" : "100 %";
    const small = new OffscreenCanvas(nx, ny);
    small.getContext("2d").putImageData(image, 0, 0);
    const ratio = canvas.width / this.width;
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.imageSmoothingEnabled = x.kind !== "category" && y.kind !== "category";
    context.drawImage(small, LEFT * ratio, TOP * ratio, (this.width - LEFT - RIGHT) * ratio, (this.height - TOP - BOTTOM) * ratio);
    this.decorate(nx, ny);
  }

  px(place) {
    return LEFT + place * (this.width - LEFT - RIGHT);
  }

  py(place) {
    return this.height - BOTTOM - place * (this.height - TOP - BOTTOM);
  }

  decorate(nx, ny) {
    const { data } = this.explorer;
    const { overlay, horizontal: x, up: y, chance, low, high } = this;
    overlay.replaceChildren();
    overlay.setAttribute("aria-label", `Map of the predicted chance of success over ${named(y)} and ${named(x)}. Arrow keys read it.`);
    for (const [place, text] of ticks(data, x, Math.max(3, this.width / 110))) {
      if (place > -0.001 && place < 1.001) overlay.append(svg("text", { class: "x-tick", x: this.px(place), y: this.py(0) + 16, "text-anchor": "middle" }, text.length > 13 ? `${text.slice(0, 12)}…` : text));
    }
    for (const [place, text] of ticks(data, y, 6)) {
      if (place > -0.001 && place < 1.001) overlay.append(svg("text", { class: "x-tick", x: LEFT - 7, y: this.py(place) + 4, "text-anchor": "end" }, text.length > 10 ? `${text.slice(0, 9)}…` : text));
    }
    overlay.append(svg("text", { class: "x-name", x: (this.px(0) + this.px(1)) / 2, y: this.height - 8, "text-anchor": "middle" }, named(x)));
    overlay.append(svg("text", { class: "x-name", "text-anchor": "middle", transform: `translate(14 ${(this.py(0) + this.py(1)) / 2}) rotate(-90)` }, named(y)));
    const smooth = x.kind !== "category" && y.kind !== "category";
    if (smooth) {
      const point = (i, j) => [this.px((i + 0.5) / nx), this.py((j + 0.5) / ny)];
      const line = (values, name) => overlay.append(svg("path", { class: name, d: contour(values, nx, ny, 0.5, point) }));
      line(low, "x-band");
      line(high, "x-band");
      line(chance, "x-halo");
      line(chance, "x-boundary");
    }
    this.mark = svg("circle", { class: "x-mark", r: 5, visibility: "hidden" });
    overlay.append(this.mark);
    if (this.cursor) this.read(this.cursor);
    else this.reading.textContent = smooth ? "Solid line: chance of 50 %. Dashed lines: where the 95 % interval reaches 50 %. Point at the map, or press an arrow key, to read it." : "Point at the map, or press an arrow key, to read it.";
  }

  read(place) {
    if (!this.chance) return;
    this.cursor = place;
    const { data } = this.explorer;
    const [nx, ny] = this.cells;
    const [i, j] = [Math.min(nx - 1, Math.floor(place[0] * nx)), Math.min(ny - 1, Math.floor(place[1] * ny))];
    const k = j * nx + i;
    const value = (column, at, n) => shown(column, column.kind === "category" ? at : data.value(column, (at + 0.5) / n)) + (column.unit ? ` ${column.unit}` : "");
    const { horizontal: x, up: y } = this;
    this.mark.setAttribute("cx", this.px((i + 0.5) / nx));
    this.mark.setAttribute("cy", this.py((j + 0.5) / ny));
    this.mark.setAttribute("visibility", "visible");
    this.reading.textContent = `${x.label} ${value(x, i, nx)}, ${y.label} ${value(y, j, ny)}: predicted chance of success ${percent(this.chance[k])} ` +
      `(95 % interval of the model ${percent(this.low[k])} to ${percent(this.high[k])}).`;
  }
}

/** The line at a level, by marching squares. */
function contour(values, nx, ny, level, point) {
  let path = "";
  for (let j = 0; j + 1 < ny; j++) {
    for (let i = 0; i + 1 < nx; i++) {
      const corners = [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]];
      const v = corners.map(([a, b]) => values[b * nx + a] - level);
      const cuts = [];
      for (let k = 0; k < 4; k++) {
        const [a, b] = [v[k], v[(k + 1) % 4]];
        if (a < 0 === b < 0) continue;
        const share = a / (a - b), [p, q] = [corners[k], corners[(k + 1) % 4]];
        cuts.push(point(p[0] + share * (q[0] - p[0]), p[1] + share * (q[1] - p[1])));
      }
      for (let k = 0; k + 1 < cuts.length; k += 2) {
        path += `M${cuts[k].map((c) => c.toFixed(1)).join(" ")}L${cuts[k + 1].map((c) => c.toFixed(1)).join(" ")}`;
      }
    }
  }
  return path;
}
