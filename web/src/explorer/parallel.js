// Parallel coordinates: one axis per column, one line per row, and brushes on the axes.

import { element, layer, svg } from "./dom.js";
import { faint } from "./colours.js";
import { count, named, shown, ticks } from "./data.js";
import { Raster, isDue } from "./raster.js";

/** The smallest distance of two axes, in pixels. A narrow page scrolls. */
const LEAST_GAP = 64;
const TOP = 54, BOTTOM = 18, SIDE = 66, HEIGHT = 330;
/** The largest number of lines. Of more rows, a sample of each class is drawn, and each line stands for several rows. */
const LINES = 20000;
/** The distance from an axis within which a brush starts, in pixels. */
const REACH = 14;

export class Parallel {
  constructor(parent, explorer) {
    this.explorer = explorer;
    this.stage = element("div", { class: "x-parallel" });
    this.heads = element("div", { class: "x-heads", role: "group", "aria-label": "Axes: arrow keys move an axis, Delete removes it" });
    this.back = layer(this.stage);
    this.front = layer(this.stage);
    this.overlay = svg("svg", { class: "x-overlay", role: "img", "aria-label": "Parallel coordinates. The filters below do the same as brushes on the axes." });
    this.stage.append(this.overlay, this.heads);
    this.note = element("p", { class: "x-quality", hidden: true });
    parent.append(element("div", { class: "x-wide" }, this.stage), this.note);
    this.width = 0;
    new ResizeObserver(() => this.layout()).observe(this.stage);
    this.overlay.addEventListener("pointerdown", (event) => this.begin(event));
    this.overlay.addEventListener("pointermove", (event) => this.drag(event));
    this.overlay.addEventListener("pointerup", () => this.end());
    this.overlay.addEventListener("pointercancel", () => this.end());
    this.work = [this.job(true), this.job(false)];
  }

  get axes() {
    return this.explorer.axes;
  }

  x(at) {
    return SIDE + (this.axes.length > 1 ? (at / (this.axes.length - 1)) * (this.width - 2 * SIDE) : (this.width - 2 * SIDE) / 2);
  }

  y(place) {
    return TOP + (1 - place) * (HEIGHT - TOP - BOTTOM);
  }

  layout() {
    this.stage.style.minWidth = `${2 * SIDE + LEAST_GAP * (this.axes.length - 1)}px`;
    const width = Math.floor(this.stage.clientWidth);
    if (width < 50) return;
    if (width !== this.width) {
      this.width = width;
      // More pixels cost time and show no more of many lines.
      this.ratio = this.explorer.data.rows > 30000 ? 1 : Math.min(2, devicePixelRatio || 1);
      for (const one of [this.back, this.front]) one.resize(width, HEIGHT, this.ratio);
      this.raster = [0, 1].map(() => new Raster(width * this.ratio, HEIGHT * this.ratio));
      this.overlay.setAttribute("viewBox", `0 0 ${width} ${HEIGHT}`);
    }
    this.decorate();
    this.restart(true);
  }

  /** Draws axes, ticks and brushes. */
  decorate() {
    const { data, selection } = this.explorer;
    this.stale = false;
    if (!this.width) return;
    this.overlay.replaceChildren();
    const gap = this.axes.length > 1 ? this.x(1) - this.x(0) : this.width;
    this.axes.forEach((column, at) => {
      const x = this.x(at);
      this.overlay.append(svg("line", { class: "x-axis", x1: x, x2: x, y1: this.y(1), y2: this.y(0) }));
      for (const [place, text] of ticks(data, column, 5)) {
        if (place < -0.001 || place > 1.001) continue;
        this.overlay.append(svg("line", { class: "x-axis", x1: x - 4, x2: x, y1: this.y(place), y2: this.y(place) }));
        const letters = Math.max(4, Math.floor(gap / 7));
        const short = text.length > letters ? `${text.slice(0, letters - 1)}…` : text;
        this.overlay.append(svg("text", { class: "x-tick halo-text", x: x - 7, y: this.y(place) + 4, "text-anchor": "end" }, short));
      }
      const filter = selection.filters.get(column);
      if (!filter) return;
      const ends = filter.levels
        ? [...filter.levels].map((level) => [data.place(column, level - 0.42), data.place(column, level + 0.42)])
        : [[data.place(column, filter.low), data.place(column, filter.high)]];
      for (const [low, high] of ends) {
        const [a, b] = [Math.max(0, low), Math.min(1, high)];
        this.overlay.append(svg("rect", { class: "x-brush", x: x - 7, width: 14, y: this.y(b), height: Math.max(2, this.y(a) - this.y(b)), rx: 2 }));
      }
    });
    const key = `${this.width} ${this.axes.map((column) => column.at)}`;
    if (key !== this.labelled) this.label(gap);
    this.labelled = key;
  }

  /** The names of the axes, as buttons that move them. */
  label(gap) {
    const focused = [...this.heads.children].findIndex((head) => head === document.activeElement);
    this.heads.replaceChildren(...this.axes.map((column, at) => {
      const head = element("button", { type: "button", class: "x-head", title: `${named(column)}. Drag or use the arrow keys to move; Delete removes the axis.` }, named(column));
      head.style.left = `${this.x(at) - 0.5 * Math.min(gap, 150)}px`;
      head.style.width = `${Math.min(gap, 150)}px`;
      head.addEventListener("keydown", (event) => {
        const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
        if (by) {
          event.preventDefault();
          this.move(at, at + by);
          this.heads.children[Math.min(this.axes.length - 1, Math.max(0, at + by))].focus();
        } else if (event.key === "Delete" && this.axes.length > 2) this.explorer.setAxes(this.axes.filter((one) => one !== column));
      });
      head.addEventListener("pointerdown", (event) => {
        head.setPointerCapture(event.pointerId);
        const start = event.clientX, left = this.x(at) - 0.5 * Math.min(gap, 150);
        const follow = (move) => { head.style.left = `${left + move.clientX - start}px`; };
        head.addEventListener("pointermove", follow);
        head.addEventListener("pointerup", (stop) => {
          head.removeEventListener("pointermove", follow);
          this.move(at, Math.round(at + (stop.clientX - start) / gap));
        }, { once: true });
      });
      return head;
    }));
    if (focused >= 0) this.heads.children[focused]?.focus();
  }

  move(from, to) {
    const axes = [...this.axes];
    const [column] = axes.splice(from, 1);
    axes.splice(Math.min(axes.length, Math.max(0, to)), 0, column);
    this.explorer.setAxes(axes);
  }

  point(event) {
    const box = this.overlay.getBoundingClientRect();
    const [x, y] = [event.clientX - box.left, event.clientY - box.top];
    let nearest = 0;
    this.axes.forEach((_, at) => { if (Math.abs(this.x(at) - x) < Math.abs(this.x(nearest) - x)) nearest = at; });
    const place = Math.min(1, Math.max(0, 1 - (y - TOP) / (HEIGHT - TOP - BOTTOM)));
    return { at: nearest, far: Math.abs(this.x(nearest) - x), place, y };
  }

  begin(event) {
    const { at, far, place } = this.point(event);
    if (far > Math.max(REACH, 0.25 * (this.axes.length > 1 ? this.x(1) - this.x(0) : 60))) return;
    this.overlay.setPointerCapture(event.pointerId);
    const column = this.axes[at], { data, selection } = this.explorer;
    const filter = selection.filters.get(column);
    this.brush = { column, from: place, moved: false };
    if (filter && !filter.levels) {
      const [low, high] = [data.place(column, filter.low), data.place(column, filter.high)];
      // Inside a brush, the brush moves; near an end, that end.
      if (Math.abs(place - low) < 0.02) this.brush.from = high;
      else if (Math.abs(place - high) < 0.02) this.brush.from = low;
      else if (place > low && place < high) Object.assign(this.brush, { carry: [low - place, high - place] });
    }
  }

  drag(event) {
    if (!this.brush) return;
    const { column, from, carry } = this.brush;
    const { place } = this.point(event);
    if (!this.brush.moved && Math.abs(place - from) < 0.008) return;
    this.brush.moved = true;
    const ends = carry ? [Math.max(0, place + carry[0]), Math.min(1, place + carry[1])] : [Math.min(place, from), Math.max(place, from)];
    this.explorer.brush(column, ends);
  }

  end() {
    if (!this.brush) return;
    if (!this.brush.moved) this.explorer.setFilter(this.brush.column, null);
    this.brush = null;
  }

  job(all) {
    return { all, done: true, progress: 0, drawn: 0, total: 0 };
  }

  /** Draws anew: all rows in the background if the axes changed, and the selected ones. */
  restart(all) {
    if (!this.raster) return;
    for (const work of this.work) {
      if (work.all && !all) continue;
      Object.assign(work, { done: false, progress: 0, drawn: 0, fresh: true, painted: 0 });
    }
    this.explorer.wake();
  }

  /** Works until the deadline. Returns whether everything is drawn. */
  step(deadline) {
    if (!this.raster) return true;
    if (this.stale) this.decorate();
    for (const work of this.work) {
      if (!work.done && performance.now() < deadline) this.draw(work, deadline);
    }
    return this.work.every((work) => work.done);
  }

  /** Starts a picture: the rows of each class, the lines that stand for them, and the lines so far. */
  prepare(work, raster) {
    const { data, selection } = this.explorer;
    raster.clear();
    const rows = work.all ? [data.rows] : [...selection.kinds];
    const total = rows.reduce((sum, n) => sum + n, 0), classes = rows.filter((n) => n > 0).length;
    const each = Math.floor(LINES / Math.max(1, classes));
    const lines = total > LINES ? rows.map((n) => Math.min(n, each)) : rows;
    Object.assign(work, { fresh: false, rows, lines, total, taken: rows.map(() => 0), left: lines.reduce((sum, n) => sum + n, 0) });
    if (work.all) return;
    const sampled = work.left < total;
    this.note.hidden = !sampled;
    if (sampled) this.note.textContent = `The lines are a sample of ${count(work.left)} of ${count(total)} episodes, with at most ${count(each)} of each colour. All counts and rates use every episode.`;
  }

  draw(work, deadline) {
    const { data, selection, colours } = this.explorer;
    const raster = this.raster[work.all ? 0 : 1];
    if (work.fresh) this.prepare(work, raster);
    if (work.all && selection.isEmpty) {
      work.done = true;
      this.paint(work);
      return;
    }
    const units = this.axes.map((column) => data.units(column));
    const xs = this.axes.map((_, at) => this.x(at) * this.ratio);
    const top = TOP * this.ratio, span = (HEIGHT - TOP - BOTTOM) * this.ratio;
    const { classes } = colours, { rows, lines, taken } = work;
    let ended;
    [work.progress, ended] = data.blocks(work.progress, (from, to) => {
      for (let row = from; row < to; row++) {
        if (!work.all && !selection.has(row)) continue;
        const kind = work.all ? 0 : classes[row];
        if (taken[kind] >= lines[kind]) continue;
        taken[kind] += 1;
        work.left -= 1;
        const weight = rows[kind] / lines[kind];
        work.drawn += weight;
        const layer = raster.layer(kind);
        let before = units[0][row];
        for (let at = 1; at < units.length; at++) {
          const here = units[at][row];
          if (before === before && here === here) raster.line(layer, xs[at - 1], top + (1 - before) * span, xs[at], top + (1 - here) * span, weight);
          before = here;
        }
      }
      return work.left <= 0 || performance.now() > deadline;
    });
    work.done = ended || work.left <= 0;
    if (work.done || isDue(work)) this.paint(work);
  }

  paint(work) {
    const { colours, data } = this.explorer;
    const raster = this.raster[work.all ? 0 : 1];
    const part = work.done || !work.total ? 1 : Math.max(work.drawn, 1) / work.total;
    const density = Math.max(1, work.total / ((HEIGHT - TOP - BOTTOM) * this.ratio));
    const palette = work.all ? [faint()] : colours.palette;
    raster.paint((work.all ? this.back : this.front).context, palette, work.all ? [data.rows] : colours.sizes, work.all ? 6 * density : 1 + 4 * density, 1 / part, work.all ? 0.42 : 1);
  }

  /** The values of a row, for a hint. */
  describe(row) {
    return this.axes.map((column) => `${column.label} ${shown(column, column.values[row])}`).join(", ");
  }
}
