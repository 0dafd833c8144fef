// A scatter plot of two columns, with rectangles and lassos.

import { choice, element, layer, svg } from "./dom.js";
import { faint } from "./colours.js";
import { named, shown, ticks } from "./data.js";
import { Raster, isDue } from "./raster.js";

/** Rows from which a row is one pixel instead of a disc. */
const MANY = 40000;
const LEFT = 76, RIGHT = 14, TOP = 12, BOTTOM = 46;

export class Scatter {
  constructor(parent, explorer) {
    this.explorer = explorer;
    this.tool = "rectangle";
    this.across = choice("Horizontal", [], "", (at) => this.show(explorer.data.columns[at], this.up));
    this.upward = choice("Vertical", [], "", (at) => this.show(this.horizontal, explorer.data.columns[at]));
    this.tools = choice("Drag draws a", [["rectangle", "rectangle"], ["lasso", "lasso"]], "rectangle", (tool) => { this.tool = tool; });
    this.stage = element("div", { class: "x-plot" });
    this.back = layer(this.stage);
    this.front = layer(this.stage);
    this.overlay = svg("svg", { class: "x-overlay", role: "img" });
    this.hint = element("p", { class: "x-reading", "aria-live": "off" });
    this.stage.append(this.overlay);
    parent.append(element("div", { class: "x-bar" }, this.across.root, this.upward.root, this.tools.root), this.stage, this.hint);
    new ResizeObserver(() => this.layout()).observe(this.stage);
    this.overlay.addEventListener("pointerdown", (event) => this.begin(event));
    this.overlay.addEventListener("pointermove", (event) => this.drag(event));
    this.overlay.addEventListener("pointerup", (event) => this.end(event));
    this.overlay.addEventListener("pointercancel", () => { this.path = null; });
    this.overlay.addEventListener("pointerleave", () => this.point(-1));
    this.work = [{ all: true, done: true }, { all: false, done: true }];
  }

  /** Fills the choices of columns. */
  offer(columns) {
    const options = columns.map((column) => [column.at, named(column)]);
    const [x, y] = [this.horizontal ?? columns[0], this.up ?? columns[1] ?? columns[0]];
    this.across.fill(options, x?.at);
    this.upward.fill(options, y?.at);
    if (x && y && (x !== this.horizontal || y !== this.up)) this.show(x, y);
  }

  show(x, y) {
    [this.horizontal, this.up] = [x, y];
    this.across.select.value = x.at;
    this.upward.select.value = y.at;
    this.hint.textContent = "Drag to select. Point at a dot to read it; click it to play its episode.";
    this.decorate();
    this.restart(true);
  }

  layout() {
    const width = Math.floor(this.stage.clientWidth), height = Math.floor(this.stage.clientHeight);
    if (width < 50 || height < 50) return;
    if (width !== this.width || height !== this.height) {
      [this.width, this.height] = [width, height];
      this.ratio = this.explorer.data.rows > 200000 ? 1 : Math.min(2, devicePixelRatio || 1);
      for (const one of [this.back, this.front]) one.resize(width, height, this.ratio);
      this.raster = [0, 1].map(() => new Raster(width * this.ratio, height * this.ratio));
      this.overlay.setAttribute("viewBox", `0 0 ${width} ${height}`);
    }
    this.decorate();
    this.restart(true);
  }

  x(place) {
    return LEFT + place * (this.width - LEFT - RIGHT);
  }

  y(place) {
    return this.height - BOTTOM - place * (this.height - TOP - BOTTOM);
  }

  decorate() {
    const { data, selection } = this.explorer;
    const { horizontal, up, overlay } = this;
    this.stale = false;
    if (!this.width || !horizontal || !up) return;
    overlay.replaceChildren();
    overlay.setAttribute("aria-label", `Scatter plot of ${named(up)} over ${named(horizontal)}. The filters above do the same as rectangles.`);
    const [left, right, low, high] = [this.x(0), this.x(1), this.y(0), this.y(1)];
    for (const [place, text] of ticks(data, horizontal, Math.max(3, this.width / 110))) {
      if (place < -0.001 || place > 1.001) continue;
      overlay.append(svg("line", { class: "x-grid", x1: this.x(place), x2: this.x(place), y1: low, y2: high }));
      overlay.append(svg("text", { class: "x-tick", x: this.x(place), y: low + 16, "text-anchor": "middle" }, text.length > 13 ? `${text.slice(0, 12)}…` : text));
    }
    for (const [place, text] of ticks(data, up, 6)) {
      if (place < -0.001 || place > 1.001) continue;
      overlay.append(svg("line", { class: "x-grid", x1: left, x2: right, y1: this.y(place), y2: this.y(place) }));
      overlay.append(svg("text", { class: "x-tick", x: left - 7, y: this.y(place) + 4, "text-anchor": "end" }, text.length > 10 ? `${text.slice(0, 9)}…` : text));
    }
    overlay.append(svg("text", { class: "x-name", x: (left + right) / 2, y: this.height - 8, "text-anchor": "middle" }, named(horizontal)));
    overlay.append(svg("text", { class: "x-name", "text-anchor": "middle", transform: `translate(14 ${(low + high) / 2}) rotate(-90)` }, named(up)));
    const ends = (column) => {
      const filter = selection.filters.get(column);
      return filter && !filter.levels ? [data.place(column, filter.low), data.place(column, filter.high)].map((p) => Math.min(1, Math.max(0, p))) : null;
    };
    const [a, b] = [ends(horizontal), ends(up)];
    if (a || b) {
      const [x0, x1] = (a ?? [0, 1]).map((p) => this.x(p)), [y0, y1] = (b ?? [0, 1]).map((p) => this.y(p));
      overlay.append(svg("rect", { class: "x-brush", x: x0, width: Math.max(1, x1 - x0), y: y1, height: Math.max(1, y0 - y1) }));
    }
    const lasso = selection.lasso;
    if (lasso && lasso.x === horizontal && lasso.y === up) {
      overlay.append(svg("path", { class: "x-brush", d: `M${lasso.path.map(([x, y]) => `${this.x(x)} ${this.y(y)}`).join("L")}Z` }));
    }
    this.trace = svg("path", { class: "x-brush" });
    this.mark = svg("circle", { class: "x-mark", r: 6, visibility: "hidden" });
    overlay.append(this.trace, this.mark);
  }

  at(event) {
    const box = this.overlay.getBoundingClientRect();
    const clamp = (p) => Math.min(1, Math.max(0, p));
    return [clamp((event.clientX - box.left - LEFT) / (this.width - LEFT - RIGHT)), clamp((this.height - BOTTOM - event.clientY + box.top) / (this.height - TOP - BOTTOM))];
  }

  begin(event) {
    if (!this.horizontal) return;
    this.overlay.setPointerCapture(event.pointerId);
    this.path = [this.at(event)];
    this.shape = event.shiftKey ? "lasso" : this.tool;
    this.moved = false;
  }

  drag(event) {
    const here = this.at(event);
    if (!this.path) {
      this.point(this.nearest(here));
      return;
    }
    const [first] = this.path;
    if (!this.moved && Math.hypot((here[0] - first[0]) * this.width, (here[1] - first[1]) * this.height) < 5) return;
    this.moved = true;
    if (this.shape === "lasso") {
      this.path.push(here);
      this.trace.setAttribute("d", `M${this.path.map(([x, y]) => `${this.x(x)} ${this.y(y)}`).join("L")}Z`);
      return;
    }
    const range = (i) => [Math.min(first[i], here[i]), Math.max(first[i], here[i])];
    this.explorer.brush(this.horizontal, range(0), this.up, range(1));
  }

  end(event) {
    const path = this.path;
    this.path = null;
    if (!path) return;
    if (!this.moved) {
      const row = this.nearest(this.at(event));
      if (row >= 0) this.explorer.open(row);
      return;
    }
    if (this.shape === "lasso" && path.length > 2) this.explorer.setLasso(this.lasso(path));
  }

  /** A lasso as a mask of pixels, so that a row is tested in constant time. */
  lasso(path) {
    const size = 512;
    const canvas = new OffscreenCanvas(size, size);
    const context = canvas.getContext("2d");
    context.beginPath();
    path.forEach(([x, y]) => context.lineTo(x * size, y * size));
    context.fill("evenodd");
    const alpha = context.getImageData(0, 0, size, size).data;
    const { data } = this.explorer;
    const { horizontal: x, up: y } = this;
    const cell = (unit) => Math.min(size - 1, Math.max(0, Math.floor(unit * size)));
    const inside = (row) => {
      const a = data.units(x)[row], b = data.units(y)[row];
      return a === a && b === b && alpha[4 * (cell(b) * size + cell(a)) + 3] > 127;
    };
    return { x, y, path, inside, text: `lasso on ${x.label} and ${y.label}` };
  }

  /** The visible row nearest to a place, if it is near. */
  nearest([x, y]) {
    const { data, selection } = this.explorer;
    if (!this.horizontal || !this.width) return -1;
    const [us, vs] = [data.units(this.horizontal), data.units(this.up)];
    const [w, h] = [this.width - LEFT - RIGHT, this.height - TOP - BOTTOM];
    let best = -1, least = 144;
    for (let row = 0; row < data.rows; row++) {
      const dx = (us[row] - x) * w, dy = (vs[row] - y) * h;
      const square = dx * dx + dy * dy;
      if (square < least && selection.has(row)) [best, least] = [row, square];
    }
    return best;
  }

  /** Marks a row and reads it. */
  point(row) {
    if (!this.mark) return;
    this.mark.setAttribute("visibility", row < 0 ? "hidden" : "visible");
    if (row < 0) return;
    const { data } = this.explorer;
    this.mark.setAttribute("cx", this.x(data.units(this.horizontal)[row]));
    this.mark.setAttribute("cy", this.y(data.units(this.up)[row]));
    const values = [data.outcome, this.horizontal, this.up].map((column) => `${column.label} ${shown(column, column.values[row])}`);
    const run = data.runs.length > 1 ? `${shown(data.run, data.run.values[row])}, ` : "";
    this.hint.textContent = `${run}episode ${shown(data.index, data.index.values[row])}: ${values.join(", ")}.`;
  }

  restart(all) {
    if (!this.raster || !this.horizontal) return;
    for (const work of this.work) if (!work.all || all) Object.assign(work, { done: false, progress: 0, drawn: 0, fresh: true, painted: 0 });
    this.explorer.wake();
  }

  step(deadline) {
    if (!this.raster || !this.horizontal) return true;
    if (this.stale) this.decorate();
    for (const work of this.work) if (!work.done && performance.now() < deadline) this.draw(work, deadline);
    return this.work.every((work) => work.done);
  }

  draw(work, deadline) {
    const { data, selection, colours } = this.explorer;
    const raster = this.raster[work.all ? 0 : 1], { ratio } = this;
    if (work.fresh) {
      raster.clear();
      work.fresh = false;
    }
    const [us, vs] = [data.units(this.horizontal), data.units(this.up)];
    const left = LEFT * ratio, width = (this.width - LEFT - RIGHT) * ratio, bottom = (this.height - BOTTOM) * ratio, height = (this.height - TOP - BOTTOM) * ratio;
    const expected = work.all ? data.rows : selection.kept;
    const many = expected >= MANY;
    const radius = ratio * (expected < 600 ? 3.2 : expected < 4000 ? 2.4 : 1.5);
    const { classes } = colours;
    const skip = work.all && selection.isEmpty;
    if (skip) work.done = true;
    else {
      [work.progress, work.done] = data.blocks(work.progress, (from, to) => {
        for (let row = from; row < to; row++) {
          if (!work.all && !selection.has(row)) continue;
          const u = us[row], v = vs[row];
          if (u !== u || v !== v) continue;
          work.drawn += 1;
          const layer = raster.layer(work.all ? 0 : classes[row]);
          if (many) layer[Math.trunc(bottom - v * height) * raster.width + Math.trunc(left + u * width)] += 1;
          else raster.dot(layer, left + u * width, bottom - v * height, radius);
        }
        return performance.now() > deadline;
      });
    }
    if (!work.done && !isDue(work)) return;
    const part = data.rows ? Math.min(1, (work.progress * 64) / data.rows) || 1 : 1;
    const density = Math.max(1, ((work.drawn / part) * (many ? 1 : Math.PI * radius * radius)) / (width * height));
    raster.paint((work.all ? this.back : this.front).context, work.all ? [faint()] : colours.palette, work.all ? [data.rows] : colours.sizes, work.all ? 5 * density : 0.5 + 2.5 * density, work.done ? 1 : 1 / part, work.all ? 0.42 : 0.95);
  }
}
