// The episodes as columns of numbers.

/** Blocks of rows that are drawn together. Blocks come in a mixed order, so that a part of them shows the whole. */
const BLOCK = 64;

/** Bins of the order of a column. */
const BINS = 4096;

/** A number between -0.5 and 0.5 that depends on the row and the column alone. */
function jitter(row, column) {
  let x = Math.imul(row ^ Math.imul(column + 1, 0x9e3779b9), 0x85ebca6b);
  x = Math.imul(x ^ (x >>> 13), 0xc2b2ae35);
  return ((x ^ (x >>> 16)) >>> 0) / 4294967296 - 0.5;
}

function greatestDivisor(a, b) {
  return b === 0 ? a : greatestDivisor(b, a % b);
}

export class Dataset {
  constructor() {
    this.columns = [];
    this.runs = [];
    this.rows = 0;
    this.room = 0;
    this.halvings = 0;
    /** Whether the rows are a part of the table. */
    this.isPart = false;
  }

  /** Takes the description of runs and columns. Values of known columns stay. */
  describe(state) {
    this.runs = state.runs;
    this.epoch = state.epoch;
    // How often the table dropped half of its rows, because it was full.
    this.halvings = state.halvings;
    state.columns.forEach((spec, at) => {
      const known = this.columns[at];
      if (known) {
        if (known.levels.length !== spec.levels.length) known.units = null;
        known.levels = spec.levels;
      } else {
        const values = new Float32Array(this.room).fill(NaN);
        this.columns.push({ ...spec, at, values, units: null, order: null, low: Infinity, high: -Infinity, filled: 0 });
      }
    });
    const of = (role) => this.columns.find((column) => column.role === role);
    this.run = of("run");
    this.index = of("index");
    this.stage = of("stage");
    this.outcome = of("outcome");
    this.weight = of("weight");
  }

  clear() {
    this.rows = 0;
    for (const column of this.columns) Object.assign(column, { units: null, order: null, low: Infinity, high: -Infinity, filled: 0 });
  }

  /** Appends rows: one array of numbers per column. */
  append(arrays) {
    const count = arrays[0]?.length ?? 0;
    const from = this.rows;
    if (from + count > this.room) {
      this.room = Math.max(from + count, Math.ceil(1.5 * this.room), 1024);
      for (const column of this.columns) {
        const values = new Float32Array(this.room).fill(NaN);
        values.set(column.values.subarray(0, from));
        column.values = values;
      }
    }
    this.columns.forEach((column, at) => {
      const values = arrays[at];
      if (!values) return;
      column.values.set(values, from);
      let { low, high, filled } = column;
      for (const x of values) {
        if (x !== x) continue;
        filled += 1;
        if (x < low) low = x;
        if (x > high) high = x;
      }
      Object.assign(column, { low, high, filled, units: null, order: null });
    });
    this.rows = from + count;
  }

  /** Whether the page has a random sample of the episodes. */
  get isSample() {
    return this.halvings > 0 || this.isPart;
  }

  /** Whether a column tells anything: it has values, and not all are equal. */
  varies(column) {
    return column.filled > 0 && column.high > column.low;
  }

  /** The ends of the axis of a column. */
  range(column) {
    if (column.kind === "category") return [-0.5, Math.max(1, column.levels.length) - 0.5];
    let [low, high] = [column.low, column.high];
    if (column.range && !column.computed) [low, high] = [Math.min(low, column.range[0]), Math.max(high, column.range[1])];
    if (!(high > low)) [low, high] = Number.isFinite(low) ? [low - 0.5, low + 0.5] : [0, 1];
    return [low, high];
  }

  /** Whether the axis of a column is logarithmic. */
  isLog(column) {
    const [low, high] = this.range(column);
    return column.log && low > 0 && high / low > 3;
  }

  /** The place of a value on the axis, from 0 to 1. */
  place(column, value) {
    const [low, high] = this.range(column);
    if (value === -Infinity || value === Infinity) return value < 0 ? 0 : 1;
    return this.isLog(column) ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
  }

  /** The value at a place on the axis. */
  value(column, place) {
    const [low, high] = this.range(column);
    return this.isLog(column) ? low * Math.exp(place * Math.log(high / low)) : low + place * (high - low);
  }

  /** The places of all rows. Words and few integers are spread around their place, so that rows do not hide each other. */
  units(column) {
    if (column.units && column.units.length >= this.rows) return column.units;
    const units = new Float32Array(this.rows);
    const { values } = column;
    const [low, high] = this.range(column);
    const spread = column.kind === "category" ? 0.6 : column.kind === "integer" && high - low <= 30 ? 0.4 : 0;
    if (this.isLog(column)) {
      const scale = 1 / Math.log(high / low);
      for (let i = 0; i < this.rows; i++) units[i] = Math.log(values[i] / low) * scale;
    } else if (spread > 0) {
      const scale = 1 / (high - low);
      for (let i = 0; i < this.rows; i++) units[i] = (values[i] + spread * jitter(i, column.at | 0) - low) * scale;
    } else {
      const scale = 1 / (high - low);
      for (let i = 0; i < this.rows; i++) units[i] = (values[i] - low) * scale;
    }
    column.units = units;
    return units;
  }

  /**
   * The rows of a column in ascending bins of its values, without rows that have no value: `rows` from `starts[bin]` to
   * `starts[bin + 1]` have values in that bin, in order of their number.
   */
  order(column) {
    if (column.order) return column.order;
    const { values } = column;
    let [low, high] = [Infinity, -Infinity];
    for (let i = 0; i < this.rows; i++) {
      const x = values[i];
      if (x < low) low = x;
      if (x > high) high = x;
    }
    const scale = high > low ? BINS / (high - low) : 0;
    const bin = (x) => (x > low ? (x < high ? Math.min(BINS - 1, Math.floor((x - low) * scale)) : BINS - 1) : 0);
    const starts = new Uint32Array(BINS + 1);
    for (let i = 0; i < this.rows; i++) if (values[i] === values[i]) starts[bin(values[i]) + 1] += 1;
    for (let i = 0; i < BINS; i++) starts[i + 1] += starts[i];
    const next = starts.slice(), rows = new Uint32Array(starts[BINS]);
    for (let i = 0; i < this.rows; i++) if (values[i] === values[i]) rows[next[bin(values[i])]++] = i;
    column.order = { rows, starts, bin, bins: BINS };
    return column.order;
  }

  /** Calls `work(from, to)` with blocks of rows in a mixed order, from `progress` on, until `work` says stop. */
  blocks(progress, work) {
    const count = Math.ceil(this.rows / BLOCK);
    let stride = Math.max(1, Math.floor(count * 0.6180339887));
    while (count > 1 && greatestDivisor(count, stride) !== 1) stride += 1;
    while (progress < count) {
      const at = ((progress * stride) % count) * BLOCK;
      progress += 1;
      if (work(at, Math.min(at + BLOCK, this.rows))) break;
    }
    return [progress, progress >= count];
  }
}

/** A number with at most four significant digits. */
export function figure(x) {
  if (x === null || x === undefined || !Number.isFinite(x)) return "–";
  const size = Math.abs(x);
  if (size === 0) return "0";
  if (size >= 10000) return Math.round(x).toLocaleString("en-US");
  if (size < 0.0005) return x.toExponential(1);
  return String(Number(x.toPrecision(size >= 1000 ? 5 : 4)));
}

export const percent = (x) => `${(100 * x).toFixed(1)} %`;
export const count = (n) => n.toLocaleString("en-US");

/** The name of a column with its unit. */
export function named(column) {
  return column.unit ? `${column.label} (${column.unit})` : column.label;
}

/** A word of a file as a person reads it. */
export const readable = (word) => word.replace(/_/g, " ");

/** A value of a column as text. */
export function shown(column, value) {
  if (value !== value) return "–";
  if (column.kind === "category") return readable(column.levels[value] ?? "–");
  if (column.role === "index") return count(value);
  if (column.percent) return percent(value);
  return figure(value);
}

/** Round ticks of an axis: place and text. */
export function ticks(data, column, wanted) {
  if (column.kind === "category") {
    const every = Math.ceil(column.levels.length / Math.max(2, wanted * 1.6));
    return column.levels.map((level, i) => [data.place(column, i), readable(level), i]).filter(([, , i]) => i % every === 0);
  }
  const [low, high] = data.range(column);
  const out = [];
  if (data.isLog(column)) {
    const steps = high / low > 1000 ? [1] : high / low > 50 ? [1, 3] : [1, 2, 5];
    for (let decade = Math.floor(Math.log10(low)); decade <= Math.log10(high); decade++) {
      for (const m of steps) {
        const x = m * 10 ** decade;
        if (x >= low * 0.999 && x <= high * 1.001) out.push([data.place(column, x), figure(x)]);
      }
    }
    if (out.length > 1) return out;
    out.length = 0;
  }
  const raw = (high - low) / Math.max(1, wanted);
  const power = 10 ** Math.floor(Math.log10(raw));
  let by = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw) ?? 10 * power;
  if (column.kind === "integer") by = Math.max(1, Math.round(by));
  for (let i = Math.ceil(low / by - 1e-9); i * by <= high + 1e-9 * by; i++) out.push([data.place(column, i * by), column.percent ? `${Math.round(100 * i * by)} %` : figure(i * by)]);
  return out;
}
