// The strip chart: phases, events and signals of one or two episodes on one time axis.

import { locate } from "./unpack.js";

/** The namespace of SVG, taken from the parser. */
const NS = (() => {
  const parent = document.createElement("div");
  parent.innerHTML = "<svg></svg>";
  return parent.firstChild.namespaceURI;
})();
const ROW = 32, GAP = 7, TOP = 4, BAND = 18;
/** Room for names and for readings beside the chart, in pixels; and on a narrow page. */
const SIDES = [150, 96], NARROW_SIDES = [128, 60], NARROW = 480;
/** Stepped signals: a command holds until the next one. */
const STEPPED = /command/;

export function svg(name, attributes = {}, text) {
  const node = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text !== undefined) node.textContent = text;
  return node;
}

/** A number with at most three significant digits. */
export function figure(x) {
  if (x === null || x === undefined || !Number.isFinite(x)) return "–";
  const size = Math.abs(x);
  if (size === 0) return "0";
  if (size >= 1000) return Math.round(x).toLocaleString("en-US");
  if (size < 0.001) return x.toExponential(1);
  return String(Number(x.toPrecision(3)));
}

/** Round steps for an axis of this length. */
export function step(span, wanted) {
  const raw = span / Math.max(1, wanted);
  const power = 10 ** Math.floor(Math.log10(raw));
  return [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw) ?? 10 * power;
}

/** Values in the units that a person reads: millimetres for short lengths. `other` is the same signal of the other episode, which gets the same unit. */
export function readable(signal, other) {
  const size = (of) => (of ? Math.max(Math.abs(of.low), Math.abs(of.high)) : 0);
  if (signal.unit === "m" && Math.max(size(signal), size(other)) < 0.5) {
    return { ...signal, unit: "mm", low: millimetres(signal.low), high: millimetres(signal.high), values: signal.values.map((x) => (x === null ? null : millimetres(x))) };
  }
  return signal;
}

/** Tenths of a millimetre: smaller lengths are noise of the contacts. */
const millimetres = (metres) => Math.round(metres * 1e4) / 10;

/** The value of a signal that has one value throughout its episode, such as a mark of the scenario. `undefined` if it changes. */
export function constant(signal) {
  const values = signal.values.filter((x) => x !== null);
  return values.every((x) => x === values[0]) ? values[0] : undefined;
}

/** The name of a signal without its unit. */
export function title(name) {
  const units = /_(nms_rad|m_s2|rad_s|m_s|kg|mm|rad|deg|m|nm|n|s|j|w|v|a|hz|lux)$/;
  const text = name.replace(units, "").replace(/_/g, " ");
  return text.charAt(0).toUpperCase() + text.slice(1);
}

/** Phases of a clip as bars: start, end, name. */
function spans(clip, end) {
  return clip.phases.map((phase, i) => [phase.t, clip.phases[i + 1]?.t ?? Math.max(end, phase.t), phase.what]);
}

/** A strip chart in `parent`. `sides` are one or two { clip, motion }; `seek` is called with a time. */
export class Chart {
  constructor(parent, sides, end, seek) {
    this.sides = sides;
    this.end = end;
    const names = [];
    for (const { motion } of sides) for (const s of motion.signals) if (!names.includes(s.name)) names.push(s.name);
    // A force of zero throughout, in an environment without contacts, says nothing.
    const silent = (name) => name === "contact force" && sides.every(({ motion }) => motion.contacts.every((points) => points.length === 0));
    const rows = names.filter((name) => !silent(name)).map((name) => ({
      name,
      signals: sides.map(({ motion }) => motion.signals.find((s) => s.name === name)).map((found, side, both) => found && readable(found, both[1 - side])),
    }));
    // Signals that do not change over time are in the table of parameters.
    this.rows = rows.filter(({ signals }) => signals.some((signal) => signal && constant(signal) === undefined)).slice(0, 8);
    const bands = sides.filter(({ clip }) => clip.phases.length > 0).length;
    this.first = TOP + bands * (BAND + 4) + (bands ? 6 : 0);
    this.height = this.first + this.rows.length * (ROW + GAP) + 26;
    this.root = svg("svg", { class: "strip", role: "img", "aria-label": "Phases, events and signals over time" });
    parent.replaceChildren(this.root);
    this.seek = seek;
    this.width = 0;
    this.observer = new ResizeObserver(() => this.layout());
    this.observer.observe(parent);
    this.parent = parent;
    const at = (event) => {
      const box = this.root.getBoundingClientRect();
      seek(((event.clientX - box.left - this.left) / (this.width - this.left - this.right)) * this.end);
    };
    this.root.addEventListener("pointerdown", (event) => {
      this.root.setPointerCapture(event.pointerId);
      at(event);
    });
    this.root.addEventListener("pointermove", (event) => event.buttons & 1 && at(event));
    this.layout();
  }

  x(t) {
    return this.left + (t / this.end) * (this.width - this.left - this.right);
  }

  layout() {
    const width = Math.max(300, Math.floor(this.parent.clientWidth));
    if (width === this.width) return;
    this.width = width;
    [this.left, this.right] = width < NARROW ? NARROW_SIDES : SIDES;
    const root = this.root;
    root.setAttribute("viewBox", `0 0 ${width} ${this.height}`);
    root.setAttribute("height", this.height);
    root.replaceChildren();
    const bottom = this.height - 22;
    const ticks = step(this.end, (width - this.left - this.right) / 70);
    for (let t = 0; t <= this.end + 1e-9; t += ticks) {
      root.append(svg("line", { class: "strip-grid", x1: this.x(t), x2: this.x(t), y1: TOP, y2: bottom }));
      root.append(svg("text", { class: "strip-tick", x: this.x(t), y: this.height - 6, "text-anchor": "middle" }, `${figure(t)} s`));
    }
    let y = TOP;
    this.sides.forEach(({ clip, motion }, side) => {
      if (clip.phases.length === 0) return;
      root.append(svg("text", { class: `strip-name side${side}`, x: 0, y: y + 13 }, this.sides.length > 1 ? clip.title : "Phase"));
      spans(clip, motion.end).forEach(([from, to, what], i) => {
        const [a, b] = [this.x(from), this.x(to)];
        const bar = svg("rect", { class: `strip-phase p${i % 2}`, x: a, y, width: Math.max(0, b - a - 1), height: BAND, rx: 2 });
        bar.append(svg("title", {}, `${title(what.toLowerCase())}: ${figure(from)} to ${figure(to)} s`));
        root.append(bar);
        const letters = Math.floor((b - a - 6) / 6.1);
        const name = title(what.toLowerCase());
        if (letters >= Math.min(4, name.length)) {
          const short = name.length > letters ? `${name.slice(0, letters - 1)}…` : name;
          root.append(svg("text", { class: "strip-phase-name", x: a + 4, y: y + 13 }, short));
        }
      });
      for (const event of clip.events) {
        const mark = svg("path", { class: "strip-event", d: `M${this.x(event.t)} ${y + BAND + 1}l-4 6h8z` });
        mark.append(svg("title", {}, `${figure(event.t)} s: ${event.what}`));
        root.append(mark);
      }
      y += BAND + 4;
    });
    this.readings = this.rows.map((row, i) => this.row(row, this.first + i * (ROW + GAP)));
    this.cursor = svg("line", { class: "strip-cursor", y1: TOP, y2: bottom });
    root.append(this.cursor);
    this.show(this.now ?? 0);
  }

  row({ name, signals }, y) {
    const known = signals.filter(Boolean);
    let low = Math.min(...known.map((s) => s.low)), high = Math.max(...known.map((s) => s.high));
    if (high - low < 1e-12) [low, high] = [low - 0.5, high + 0.5];
    const unit = known[0].unit;
    const root = this.root;
    root.append(svg("text", { class: "strip-name", x: 0, y: y + 13 }, title(name)));
    root.append(svg("text", { class: "strip-range", x: 0, y: y + 28 }, `${figure(low)} to ${figure(high)} ${unit}`.trim()));
    root.append(svg("line", { class: "strip-base", x1: this.left, x2: this.width - this.right, y1: y + ROW, y2: y + ROW }));
    const place = (value) => y + ROW - 2 - ((value - low) / (high - low)) * (ROW - 6);
    signals.forEach((signal, side) => {
      if (!signal) return;
      let path = "", down = false;
      signal.values.forEach((value, i) => {
        if (value === null) {
          down = false;
          return;
        }
        const x = this.x(signal.times[i]).toFixed(1), v = place(value).toFixed(1);
        path += down ? (STEPPED.test(name) ? `H${x}V${v}` : `L${x} ${v}`) : `M${x} ${v}`;
        down = true;
      });
      root.append(svg("path", { class: `strip-line side${side}`, d: path }));
    });
    return signals.map((signal, side) => {
      const text = svg("text", { class: `strip-value side${side}`, x: this.width - this.right + 8, y: y + 13 + 15 * side });
      root.append(text);
      return { text, signal };
    });
  }

  show(t) {
    this.now = t;
    if (!this.cursor) return;
    this.cursor.setAttribute("x1", this.x(t));
    this.cursor.setAttribute("x2", this.x(t));
    for (const row of this.readings) {
      for (const { text, signal } of row) {
        if (!signal) continue;
        const [at] = locate(signal.times, t);
        const value = signal.values[at];
        text.textContent = value === null || value === undefined ? "–" : `${figure(value)} ${signal.unit}`;
      }
    }
  }

  dispose() {
    this.observer.disconnect();
  }
}
