// A map of the observed success rate over two parameters that the reader chooses.

import { svg, figure, step } from "./chart.js";
import { integersOf } from "./unpack.js";

/** Episodes of a cell that are listed. */
const MOST = 24;
const WIDTH = 620, LEFT = 74, TOP = 10, RIGHT = 12, STEPS = 11;

/** The 95 % interval of Wilson (1927). */
function wilson(k, n) {
  const z = 1.959964, p = k / n, d = 1 + (z * z) / n;
  const centre = (p + (z * z) / (2 * n)) / d;
  const half = (z / d) * Math.sqrt((p * (1 - p)) / n + (z * z) / (4 * n * n));
  return [Math.max(0, centre - half), Math.min(1, centre + half)];
}

const cells = (axis) => (axis.levels.length ? axis.levels.length : axis.edges.length - 1);
const named = (axis) => (axis.unit ? `${axis.label} (${axis.unit})` : axis.label);
const percent = (x) => `${(100 * x).toFixed(1)} %`;

function cellName(axis, at) {
  if (axis.levels.length) return axis.levels[at];
  const unit = axis.unit ? ` ${axis.unit}` : "";
  return `${figure(axis.edges[at])} to ${figure(axis.edges[at + 1])}${unit}`;
}

/** Round ticks: position in cells, and text. */
function ticks(axis) {
  if (axis.levels.length) return axis.levels.map((level, i) => [i + 0.5, level.length > 9 ? `${level.slice(0, 8)}…` : level]);
  const low = axis.edges[0], high = axis.edges[axis.edges.length - 1], n = cells(axis);
  const log = axis.log && high / low > 10;
  const place = (x) => (axis.log ? Math.log(x / low) / Math.log(high / low) : (x - low) / (high - low)) * n;
  const out = [];
  if (log) {
    for (let decade = Math.floor(Math.log10(low)); decade <= Math.log10(high); decade++) {
      for (const m of [1, 2, 5]) {
        const x = m * 10 ** decade;
        if (x >= low * 0.999 && x <= high * 1.001) out.push([place(x), figure(x)]);
      }
    }
  } else {
    const by = step(high - low, 6);
    for (let i = Math.ceil(low / by - 1e-9); i * by <= high + 1e-9 * by; i++) out.push([place(i * by), figure(i * by)]);
  }
  return out;
}

/** Names and places of the recorded episodes of this page. */
function recordings() {
  const reel = document.getElementById("reel");
  const clips = reel ? JSON.parse(reel.textContent).clips : [];
  return new Map(clips.map((clip, at) => [clip.title, at]));
}

class Pairs {
  constructor(parent, data, counts, listed) {
    this.axes = data.axes;
    this.data = data;
    this.episodes = this.read(listed);
    this.tables = [];
    let at = 0;
    for (let i = 0; i < this.axes.length; i++) {
      for (let j = i + 1; j < this.axes.length; j++) {
        const n = cells(this.axes[i]) * cells(this.axes[j]);
        this.tables.push({ i, j, counts: counts.subarray(at, at + 2 * n) });
        at += 2 * n;
      }
    }
    const choice = (label, value) => {
      const select = document.createElement("select");
      this.axes.forEach((axis, i) => select.append(new Option(named(axis), i, false, i === value)));
      select.addEventListener("change", () => this.draw());
      const wrapper = document.createElement("label");
      wrapper.append(`${label} `, select);
      return [wrapper, select];
    };
    const bar = document.createElement("div");
    bar.className = "pairs-bar";
    const [up, upSelect] = choice("Vertical", 0);
    const [across, acrossSelect] = choice("Horizontal", 1);
    this.up = upSelect;
    this.across = acrossSelect;
    bar.append(up, across);
    this.reading = document.createElement("p");
    this.reading.className = "pairs-reading";
    this.reading.setAttribute("aria-live", "polite");
    this.root = svg("svg", { class: "pairs-map", tabindex: 0, role: "application" });
    this.list = document.createElement("div");
    this.list.className = "pairs-list";
    this.list.setAttribute("aria-live", "polite");
    parent.append(bar, this.root, this.reading, this.list);
    this.root.addEventListener("keydown", (event) => {
      const move = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [1, 0], ArrowDown: [-1, 0] }[event.key];
      if (event.key === "Enter" || event.key === " ") {
        event.preventDefault();
        this.open(this.row, this.column);
      }
      if (!move) return;
      event.preventDefault();
      this.select(this.row + move[0], this.column + move[1]);
    });
    this.draw();
  }

  /** The listed episodes: index, outcome, and the cell on each axis. */
  read(listed) {
    const n = Math.floor(listed.length / (2 + this.axes.length));
    let index = 0;
    return Array.from({ length: n }, (_, i) => {
      index += listed[i];
      return { index, outcome: listed[n + i], cells: this.axes.map((_, axis) => listed[(2 + axis) * n + i] - 1) };
    });
  }

  /** Lists the episodes of a cell, the failures first. Those that the page has recorded can be played. */
  open(row, column) {
    this.select(row, column);
    const inside = this.episodes.filter(({ cells }) => cells[this.upAt] === this.row && cells[this.acrossAt] === this.column);
    inside.sort((a, b) => (a.outcome === this.data.success) - (b.outcome === this.data.success) || a.index - b.index);
    this.recorded ??= recordings();
    const items = inside.slice(0, MOST).map(({ index, outcome }) => {
      const item = document.createElement("li"), at = this.recorded.get(`Episode ${index}`);
      const text = `Episode ${index}: ${this.data.outcomes[outcome]}`;
      if (at === undefined) item.append(text);
      else {
        const play = document.createElement("button");
        play.type = "button";
        play.textContent = `▶ ${text}`;
        play.addEventListener("click", () => document.dispatchEvent(new CustomEvent("open-episode", { detail: at })));
        item.append(play);
      }
      return item;
    });
    const list = document.createElement("ul");
    list.append(...items);
    const hint = document.createElement("p");
    const more = inside.length > MOST ? `${MOST} of ${inside.length} episodes. ` : "";
    hint.textContent = items.length ? `${more}This page plays the marked ones. robogate replay . N prints any other one; robogate view . plays all.` : "No listed episode is in this cell.";
    this.list.replaceChildren(list, hint);
  }

  count(row, column) {
    const { y, x, table } = this;
    const at = table.i === this.upAt ? row * cells(x) + column : column * cells(y) + row;
    return [table.counts[2 * at], table.counts[2 * at + 1]];
  }

  draw() {
    this.upAt = Number(this.up.value);
    let acrossAt = Number(this.across.value);
    if (acrossAt === this.upAt) {
      acrossAt = this.upAt === 0 ? 1 : 0;
      this.across.value = acrossAt;
    }
    [this.y, this.x] = [this.axes[this.upAt], this.axes[acrossAt]];
    this.table = this.tables.find(({ i, j }) => (i === this.upAt && j === acrossAt) || (j === this.upAt && i === acrossAt));
    const [nx, ny] = [cells(this.x), cells(this.y)];
    const w = (WIDTH - LEFT - RIGHT) / nx, h = Math.min(46, Math.max(18, 320 / ny));
    const bottom = TOP + h * ny;
    this.root.setAttribute("viewBox", `0 0 ${WIDTH} ${bottom + 44}`);
    this.root.setAttribute("aria-label", `Success rate by ${named(this.y)} and ${named(this.x)}. Arrow keys read the cells.`);
    this.root.replaceChildren();
    for (let row = 0; row < ny; row++) {
      for (let column = 0; column < nx; column++) {
        const [n, k] = this.count(row, column);
        const place = { x: LEFT + w * column + 0.75, y: bottom - h * (row + 1) + 0.75, width: w - 1.5, height: h - 1.5 };
        const shade = Math.min(STEPS - 1, Math.floor((k / Math.max(1, n)) * STEPS));
        const cell = svg("rect", { ...place, class: n ? `r${shade}` : "none" });
        cell.addEventListener("pointerenter", () => this.select(row, column));
        cell.addEventListener("click", () => this.open(row, column));
        this.root.append(cell);
        if (n && w >= 26) {
          this.root.append(svg("text", { class: `s t${shade}`, x: place.x + w / 2, y: place.y + h / 2 + 3.5, "text-anchor": "middle", "pointer-events": "none" }, Math.round((100 * k) / n)));
        }
      }
    }
    for (const [at, text] of ticks(this.x)) this.root.append(svg("text", { class: "s d", x: LEFT + w * at, y: bottom + 16, "text-anchor": "middle" }, text));
    for (const [at, text] of ticks(this.y)) this.root.append(svg("text", { class: "s d", x: LEFT - 7, y: bottom - h * at + 4, "text-anchor": "end" }, text));
    this.root.append(svg("text", { class: "a", x: (LEFT + WIDTH - RIGHT) / 2, y: bottom + 37, "text-anchor": "middle" }, named(this.x)));
    this.root.append(svg("text", { class: "a", "text-anchor": "middle", transform: `translate(12 ${(TOP + bottom) / 2}) rotate(-90)` }, named(this.y)));
    this.frame = svg("rect", { class: "pairs-frame", visibility: "hidden" });
    this.root.append(this.frame);
    Object.assign(this, { w, h, bottom, nx, ny, row: 0, column: 0 });
    this.acrossAt = acrossAt;
    this.list.replaceChildren();
    this.reading.textContent = "Observed success in percent. Point at a cell, or press an arrow key, to read it. A click or Enter lists its episodes.";
  }

  select(row, column) {
    this.row = Math.min(this.ny - 1, Math.max(0, row));
    this.column = Math.min(this.nx - 1, Math.max(0, column));
    const [n, k] = this.count(this.row, this.column);
    const place = { x: LEFT + this.w * this.column, y: this.bottom - this.h * (this.row + 1), width: this.w, height: this.h, visibility: "visible" };
    for (const [name, value] of Object.entries(place)) this.frame.setAttribute(name, value);
    const where = `${this.y.label} ${cellName(this.y, this.row)}, ${this.x.label} ${cellName(this.x, this.column)}`;
    const [low, high] = n ? wilson(k, n) : [0, 1];
    this.reading.textContent = n ? `${where}: ${k} of ${n} succeeded, ${percent(k / n)} (95 % interval ${percent(low)} to ${percent(high)}).` : `${where}: no episode.`;
  }
}

function start() {
  const parent = document.querySelector("[data-pairs]"), data = document.getElementById("pairs");
  if (!parent || !data) return;
  const content = JSON.parse(data.textContent);
  parent.hidden = false;
  parent.addEventListener("toggle", async () => {
    if (!parent.open || parent.dataset.ready) return;
    parent.dataset.ready = "true";
    new Pairs(parent, content, await integersOf(content.counts), await integersOf(content.listed));
  });
}

start();
