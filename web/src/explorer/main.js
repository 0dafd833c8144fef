// The explorer: linked plots, a table and a player over the episodes of one or several runs.

import { Viewer } from "./viewer.js";
import { colouring } from "./colours.js";
import { Dataset, count, named, shown } from "./data.js";
import { choice, element } from "./dom.js";
import { Filters } from "./filters.js";
import { ModelMap } from "./map.js";
import { Model } from "./model.js";
import { Parallel } from "./parallel.js";
import { Predictor } from "./predictor.js";
import { Scatter } from "./scatter.js";
import { Selection } from "./selection.js";
import { source } from "./source.js";
import { clopperPearson, wilson } from "./stats.js";
import { Summary } from "./summary.js";
import { Table } from "./table.js";

/** Milliseconds of a frame for drawing. The rest is for the browser. */
const SLICE = 10;
/** Milliseconds between two questions for new rows. */
const EVERY = 1500;
/** Axes at the beginning. */
const MOST_AXES = 11;

class Explorer {
  constructor(root) {
    this.source = source();
    this.data = new Dataset();
    this.selection = new Selection(this.data);
    this.axes = [];
    this.offered = [];
    this.models = [];
    this.reasons = [];
    this.colours = { classes: new Uint8Array(0), palette: [], labels: [], sets: null };
    this.work = { frames: 0, longest: 0 };
    this.build(root);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.recolour();
      this.map.compute();
    });
  }

  build(root) {
    const panel = (title, name) => {
      const section = element("section", { class: `x-panel ${name}`, "aria-label": title }, element("h2", {}, title));
      return section;
    };
    this.title = element("h1", {}, "Episodes");
    this.status = element("p", { class: "x-status", role: "status" });
    this.colour = choice("Colour", [], "", (at) => this.colourBy(this.columnOf(at)));
    const top = element("header", { class: "x-top" }, element("div", {}, element("p", { class: "brand" }, element("b", {}, "RoboGate"), " explorer"), this.title, this.status), this.colour.root);
    const overview = element("section", { class: "x-panel", "aria-label": "Selection" });
    const lines = panel("All columns", "x-lines"), dots = panel("Two columns", "x-dots"), map = panel("Model", "x-map"), rows = panel("Episodes", "x-rows"), player = panel("Replay", "x-player");
    root.replaceChildren(top, element("main", { class: "x-main" }, overview, lines, dots, map, rows, player));
    this.summary = new Summary(overview, this);
    this.parallel = new Parallel(lines, this);
    this.filters = new Filters(lines, this);
    this.scatter = new Scatter(dots, this);
    this.map = new ModelMap(map, this);
    this.table = new Table(rows, this);
    this.player = element("div", { class: "x-stage" });
    this.message = element("p", { class: "x-reading", "aria-live": "polite" }, "Choose an episode in the list, or click a dot, to play it.");
    player.append(this.message, this.player);
    this.predictor = new Predictor(this);
    this.views = [this.summary, this.map, this.scatter, this.parallel, this.table, this.predictor];
  }

  columnOf(at) {
    return at === "prediction" ? this.prediction : this.data.columns[at];
  }

  /** Requests a frame. Views draw for a few milliseconds of each until they are done. */
  wake() {
    if (this.awake) return;
    this.awake = true;
    requestAnimationFrame(() => this.frame());
  }

  frame() {
    this.awake = false;
    const begun = performance.now(), deadline = begun + SLICE;
    let done = true;
    for (const view of this.views) {
      if (performance.now() < deadline || view === this.views[0]) done = view.step(deadline) && done;
      else done = false;
    }
    // The view that came last comes first in the next frame, but for the summary.
    if (!done) this.views.push(this.views.splice(1, 1)[0]);
    this.work.frames += 1;
    this.work.longest = Math.max(this.work.longest, performance.now() - begun);
    this.work.last = performance.now() - begun;
    if (!done) this.wake();
    else this.idle = true;
  }

  async start() {
    try {
      await this.source.load(this.data);
    } catch (error) {
      this.status.textContent = `The episodes cannot be read: ${error.message}.`;
      this.status.classList.add("bad");
      return;
    }
    this.refresh(true);
    document.body.dataset.ready = "true";
    void this.fit();
    if (!this.source.episodes) void this.follow();
    else this.openFirst();
  }

  /** Opens a recorded episode of a page that contains some: a failed one with its passing twin, if there is one. */
  openFirst() {
    const first = this.source.episodes.find((one) => one.twin) ?? this.source.episodes[0], { data } = this;
    if (!first) return;
    const row = data.run.values.findIndex((run, at) => run === first.run && data.index.values[at] === first.index);
    if (row >= 0) void this.open(row);
  }

  /** Asks for new rows while a run is unfinished. */
  async follow() {
    while (this.data.runs.some((run) => !run.finished)) {
      await new Promise((done) => setTimeout(done, EVERY));
      if (document.hidden) continue;
      try {
        const epoch = this.data.epoch, rows = this.data.rows;
        if (await this.source.load(this.data)) this.refresh(epoch !== this.data.epoch);
        if (this.data.rows > 1.2 * (this.fitted ?? rows) || this.data.runs.every((run) => run.finished)) void this.fit();
        this.status.classList.remove("bad");
      } catch (error) {
        this.status.textContent = `No connection to the server: ${error.message}. The page tries again.`;
        this.status.classList.add("bad");
      }
    }
  }

  /** Takes new rows. */
  refresh(all) {
    const { data } = this;
    this.title.textContent = data.runs.map((run) => run.name).join(", ");
    this.tell();
    const usable = data.columns.filter((column) => !["weight", "index"].includes(column.role) && (column.role === "outcome" || data.varies(column)));
    if (this.prediction) usable.push(this.prediction);
    this.offered = usable;
    if (this.axes.length < 2) {
      // Parameters first, then the measures, and the outcome last.
      const order = ["run", "parameter", "scenario", "measure", "outcome"];
      const shown = usable.filter((column) => order.includes(column.role) && (column.kind !== "category" || column.levels.length <= 24));
      shown.sort((a, b) => order.indexOf(a.role) - order.indexOf(b.role));
      const outcome = shown.pop();
      this.axes = [...shown.slice(0, MOST_AXES - 1), outcome].filter(Boolean);
      if (this.axes.length < 2) this.axes = [data.index, ...this.axes];
    }
    const key = usable.map((column) => column.at).join();
    if (key !== this.offeredKey) {
      this.offeredKey = key;
      const parameters = usable.filter((column) => column.role === "parameter");
      this.scatter.offer([...parameters, ...usable.filter((column) => column.role !== "parameter")]);
      this.colours.column ??= data.runs.length > 1 ? data.run : data.outcome;
      this.colour.fill(usable.map((column) => [column.at, named(column)]), this.colours.column.at);
    }
    this.predictor.restart(false);
    this.selection.update(all);
    this.recolour();
    this.parallel.layout();
    this.scatter.layout();
    this.filters.fill();
  }

  tell() {
    const { data } = this;
    const parts = data.runs.map((run) => {
      const name = data.runs.length > 1 ? `${run.name}: ` : "";
      const of = run.finished || run.planned === null ? `${count(run.rows)} episodes` : `unfinished, ${count(run.rows)} of ${count(run.planned)} episodes`;
      // Imported rows may not say what was run where.
      const known = [["", run.policy], ["on ", run.robot], ["in ", run.engine]].filter(([, word]) => word && word !== "unknown");
      const where = known.length > 0 ? `, ${known.map(([before, word]) => before + word).join(" ")}` : "";
      return `${name}${of}${where}${run.problem ? ` (${run.problem})` : ""}`;
    });
    const sample = data.isSample ? ` · the plots show a random sample of ${count(data.rows)} episodes` : "";
    this.status.textContent = `${data.runs[0]?.task ?? ""} · ${parts.join(" · ")}${sample}`;
  }

  /** Fetches the models, which takes seconds for a server. */
  async fit() {
    this.fitted = this.data.rows;
    for (let run = 0; run < this.data.runs.length; run++) {
      try {
        const document = await this.source.model(run);
        this.models[run] = document.because ? null : new Model(document);
        this.reasons[run] = document.because;
      } catch (error) {
        this.models[run] = null;
        this.reasons[run] = error.message;
      }
    }
    const first = !this.prediction && this.models.some(Boolean);
    if (first) {
      this.prediction = {
        at: "prediction", name: "prediction", label: "predicted success", unit: "", role: "prediction", kind: "number", percent: true, computed: true, log: false,
        levels: [], values: new Float32Array(0), units: null, order: null, range: [0, 1], low: 0, high: 1, filled: 0,
      };
    }
    this.predictor.restart(true);
    this.refresh(false);
    this.map.take(this.models);
    document.body.dataset.modelled = "true";
  }

  /** Takes the predictions of all rows. */
  predicted() {
    const { prediction, selection } = this;
    if (selection.filters.has(prediction)) selection.filter(prediction, selection.filters.get(prediction));
    const shown = this.axes.includes(prediction) || [this.scatter.horizontal, this.scatter.up].includes(prediction);
    if (this.colours.column === prediction) this.recolour();
    if (shown || selection.filters.has(prediction)) {
      this.parallel.restart(true);
      this.scatter.restart(true);
      this.summary.restart();
    }
    this.table.restart();
  }

  setAxes(axes) {
    this.axes = axes;
    this.parallel.layout();
    this.table.restart();
    this.filters.fill();
  }

  colourBy(column) {
    this.colours = { ...this.colours, column };
    this.colour.select.value = column.at;
    this.recolour();
  }

  recolour() {
    this.colours = colouring(this.data, this.colours.column ?? this.data.outcome);
    const sizes = new Array(this.colours.palette.length).fill(0);
    for (const kind of this.colours.classes) sizes[kind] += 1;
    this.colours.sizes = sizes;
    this.selection.sort(this.colours.classes, sizes.length);
    this.parallel.restart(false);
    this.scatter.restart(false);
    this.table.restart();
    this.summary.restart();
  }

  /** Takes a change of the selection. */
  selected() {
    const first = this.selection.isEmpty !== this.wasEmpty;
    this.wasEmpty = this.selection.isEmpty;
    this.parallel.stale = this.scatter.stale = true;
    // The background is empty without a selection.
    this.parallel.restart(first);
    this.scatter.restart(first);
    this.table.restart();
    this.summary.restart();
    this.filters.fill();
  }

  setFilter(column, filter) {
    this.selection.filter(column, filter);
    this.selected();
  }

  /** Filters one or two columns by places on their axes. */
  brush(...pairs) {
    for (let i = 0; i < pairs.length; i += 2) {
      const [column, [low, high]] = [pairs[i], pairs[i + 1]];
      const { data } = this;
      if (column.kind === "category") {
        const levels = column.levels.map((_, at) => at).filter((at) => data.place(column, at) >= low - 1e-9 && data.place(column, at) <= high + 1e-9);
        this.selection.filter(column, { levels: new Set(levels) });
      } else this.selection.filter(column, { low: low <= 0 ? -Infinity : data.value(column, low), high: high >= 1 ? Infinity : data.value(column, high) });
    }
    this.selected();
  }

  setLasso(lasso) {
    this.selection.draw(lasso);
    this.selected();
  }

  clear() {
    this.selection.clear();
    this.selected();
  }

  canPlay(run, index) {
    return Boolean(this.data.runs[run]?.playable) && this.source.has(run, index);
  }

  /** Plays the episode of a row. */
  async open(row) {
    const { data } = this;
    const run = data.run.values[row], index = data.index.values[row];
    this.opened = row;
    this.table.stale = true;
    this.wake();
    const name = `${data.runs.length > 1 ? `${data.runs[run].name}, episode` : "Episode"} ${shown(data.index, index)}`;
    const facts = `${name}: ${shown(data.outcome, data.outcome.values[row])}.`;
    if (!this.canPlay(run, index)) {
      const values = this.axes.filter((column) => column !== data.outcome).map((column) => `${column.label} ${shown(column, column.values[row])}${column.unit ? ` ${column.unit}` : ""}`);
      const because = data.runs[run].playable ? "This file does not contain its recording: robogate view plays it beside the run." : "It has no recording.";
      this.message.textContent = `${facts} ${values.join(", ")}. ${because}`;
      this.player.hidden = true;
      return;
    }
    const ticket = (this.ticket = (this.ticket ?? 0) + 1);
    this.message.textContent = `${name} is being recomputed …`;
    try {
      const { reel, at, twin } = await this.source.clip(run, index);
      if (ticket !== this.ticket) return;
      this.player.hidden = false;
      this.viewer ??= new Viewer(this.player, reel);
      if (this.viewer.reel !== reel) this.viewer.load(reel);
      await this.viewer.open(at, twin?.at);
      this.message.textContent = twin ? `${facts} ${beside(twin)}` : facts;
      this.player.dataset.row = String(row);
    } catch (error) {
      if (ticket !== this.ticket) return;
      this.player.hidden = true;
      this.message.textContent = `${facts} It cannot be shown: ${error.message}`;
    }
  }

  /** Moves a brush over an axis for some frames, and measures them, in milliseconds. */
  async measure(frames = 90) {
    const column = this.axes.find((one) => one.kind === "number") ?? this.axes[0];
    const settled = async () => {
      while (this.awake) await new Promise(requestAnimationFrame);
    };
    await settled();
    const intervals = [], work = [];
    let last = await new Promise(requestAnimationFrame);
    for (let i = 0; i < frames; i++) {
      const from = (0.7 * i) / frames, begun = performance.now();
      this.brush(column, [from, from + 0.3]);
      const input = performance.now() - begun;
      const now = await new Promise(requestAnimationFrame);
      intervals.push(now - last);
      work.push(input + this.work.last);
      last = now;
    }
    const begun = performance.now();
    await settled();
    const refined = performance.now() - begun;
    this.setFilter(column, null);
    await settled();
    const of = (values) => {
      const sorted = [...values].sort((a, b) => a - b);
      const at = (share) => Number(sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))].toFixed(1));
      return { median: at(0.5), p95: at(0.95), longest: at(1) };
    };
    return { rows: this.data.rows, axes: this.axes.length, frames, interval_ms: of(intervals), script_ms: of(work), complete_after_ms: Number(refined.toFixed(0)) };
  }
}

/** The passing episode beside a failed one, in words. */
function beside(twin) {
  if (typeof twin.at !== "number") return `The most similar passing episode, ${count(twin.index)}, is not shown${twin.because ? `: ${twin.because}` : "."}`;
  return `Beside it: episode ${count(twin.index)}, the passing episode with the most similar parameters. ${twin.differences}`;
}

const root = document.getElementById("explorer");
if (root) {
  const explorer = new Explorer(root);
  // For tests and for the console of the browser.
  window.robogateExplorer = {
    wilson, clopperPearson,
    explorer,
    measure: (frames) => explorer.measure(frames),
    predict: (run, row) => {
      const model = explorer.models[run];
      model.of(explorer.data.columns.map((column) => column.values), row);
      return model.interval();
    },
  };
  void explorer.start();
}
