// The rows that all filters keep, and their success rate.

/** Filters by column, each with a bit of its own; a lasso has the last one. */
const LASSO = 31;
/** Rows from which a moved range visits only the rows between its old and its new ends. */
const MANY = 50000;
/** Stages whose points were sampled where failures are likely, and those whose points were not. */
const FOCUSED_STAGES = ["boundary", "active"], PLAIN_STAGES = ["uniform", "imported", "active (uniform part)"];
/** How a row counts. */
const INVALID = 0, FOCUSED = 1, FAILED = 2, SUCCEEDED = 3, WAYS = 4;

export class Selection {
  constructor(data) {
    this.data = data;
    this.filters = new Map();
    this.slots = new Map();
    /** One bit per filter that leaves out the row. */
    this.failed = new Int32Array(0);
    /** Run and way of each row. */
    this.codes = new Uint16Array(0);
    this.classes = new Uint8Array(0);
    this.lasso = null;
    this.kept = 0;
    /** Selected rows by code, and by class. */
    this.counts = null;
    this.kinds = [];
  }

  get isEmpty() {
    return this.filters.size === 0 && this.lasso === null;
  }

  /** Whether a row is selected. */
  has(row) {
    return this.failed[row] === 0;
  }

  /** Sets the filter of a column: { low, high } in values, { levels } as a set of codes, or null. */
  filter(column, filter) {
    let slot = this.slots.get(column);
    if (slot === undefined) {
      slot = [...Array(LASSO).keys()].find((free) => ![...this.slots.values()].includes(free));
      if (slot === undefined) return;
      this.slots.set(column, slot);
    }
    const before = this.filters.get(column);
    if (filter) this.filters.set(column, filter);
    else this.filters.delete(column);
    const isMoved = before && filter && !before.levels && !filter.levels && this.data.rows > MANY;
    if (isMoved) this.move(column, slot, before, filter);
    else this.mark(column, slot, 0);
    if (!filter) this.slots.delete(column);
  }

  /** Sets whether one filter keeps a row, and updates the counts. */
  set(row, bit, kept) {
    const before = this.failed[row], after = kept ? before & ~bit : before | bit;
    if (before === after) return;
    this.failed[row] = after;
    if (before !== 0 && after !== 0) return;
    const by = after === 0 ? 1 : -1;
    this.kept += by;
    this.counts[this.codes[row]] += by;
    this.kinds[this.classes[row]] += by;
  }

  mark(column, slot, from) {
    const bit = 1 << slot, { rows } = this.data;
    const filter = this.filters.get(column), { values } = column;
    if (!filter) {
      for (let i = from; i < rows; i++) this.set(i, bit, true);
    } else if (filter.levels) {
      const kept = new Uint8Array(column.levels.length);
      filter.levels.forEach((level) => { kept[level] = 1; });
      for (let i = from; i < rows; i++) this.set(i, bit, kept[values[i]] === 1);
    } else {
      const { low, high } = filter;
      for (let i = from; i < rows; i++) this.set(i, bit, values[i] >= low && values[i] <= high);
    }
  }

  /** Moves the ends of a range. Only rows between the old and the new ends can change. */
  move(column, slot, before, after) {
    const bit = 1 << slot, { values } = column, { low, high } = after;
    const { rows, starts, bin } = this.data.order(column);
    for (const [from, to] of [[before.low, low], [before.high, high]]) {
      if (from === to) continue;
      const end = starts[bin(Math.max(from, to)) + 1];
      for (let at = starts[bin(Math.min(from, to))]; at < end; at++) {
        const row = rows[at];
        this.set(row, bit, values[row] >= low && values[row] <= high);
      }
    }
  }

  /** Sets the lasso: { inside(row), text }, or null. */
  draw(lasso, from = 0) {
    this.lasso = lasso;
    const bit = 1 << LASSO;
    for (let i = from; i < this.data.rows; i++) this.set(i, bit, !lasso || lasso.inside(i));
  }

  clear() {
    this.filters.clear();
    this.slots.clear();
    this.lasso = null;
    this.failed.fill(0);
    this.count();
  }

  /** Takes new rows of the data, or all of them. */
  update(all) {
    const { data } = this, from = all ? 0 : Math.min(this.failed.length, this.known ?? 0);
    if (this.failed.length < data.rows) {
      const failed = new Int32Array(data.room);
      failed.set(this.failed.subarray(0, from));
      this.failed = failed;
    }
    if (all) this.failed.fill(0);
    this.encode();
    this.classes = new Uint8Array(data.rows);
    this.count();
    for (const [column, slot] of this.slots) this.mark(column, slot, from);
    this.known = data.rows;
    if (this.lasso) this.draw(this.lasso, from);
  }

  /** Takes the classes of all rows, of which there are `size`. */
  sort(classes, size) {
    this.classes = classes;
    this.kinds = new Array(size).fill(0);
    for (let i = 0; i < this.data.rows; i++) if (this.failed[i] === 0) this.kinds[classes[i]] += 1;
  }

  encode() {
    const { data } = this, { run, stage, outcome } = data;
    if (this.codes.length < data.rows) this.codes = new Uint16Array(data.room);
    const focused = this.focused(), stages = stage.levels.length;
    const invalid = outcome.levels.indexOf("invalid");
    for (let i = 0; i < data.rows; i++) {
      const ending = outcome.values[i], of = run.values[i];
      const way = ending === invalid ? INVALID : focused[of * stages + stage.values[i]] ? FOCUSED : ending === 0 ? SUCCEEDED : FAILED;
      this.codes[i] = WAYS * of + way;
    }
  }

  count() {
    this.counts = new Uint32Array(WAYS * this.data.runs.length);
    this.kinds = new Array(Math.max(1, this.kinds.length)).fill(0);
    this.kept = 0;
    for (let i = 0; i < this.data.rows; i++) {
      if (this.failed[i] !== 0) continue;
      this.kept += 1;
      this.counts[this.codes[i]] += 1;
      this.kinds[this.classes[i]] += 1;
    }
  }

  /** Of each run: valid rows that sample the operating space and their successes, rows of other designs, and invalid rows. */
  get runs() {
    return this.data.runs.map((_, at) => {
      const of = (way) => this.counts[WAYS * at + way];
      return { n: of(FAILED) + of(SUCCEEDED), k: of(SUCCEEDED), focused: of(FOCUSED), invalid: of(INVALID) };
    });
  }

  /**
   * For each run and stage, whether its points were not sampled from the operating space: the boundary stage, the points
   * that the model of the active stage chose, and any unknown stage whose weights are not all 1. The analysis has the same
   * rule (crates/robogate-analysis/src/table.rs).
   */
  focused() {
    const { stage, weight, run, runs, rows } = this.data, stages = stage.levels.length;
    const plain = stage.levels.map((name) => PLAIN_STAGES.includes(name));
    const found = new Uint8Array(runs.length * stages);
    stage.levels.forEach((name, at) => {
      if (FOCUSED_STAGES.includes(name)) for (let of = 0; of < runs.length; of++) found[of * stages + at] = 1;
    });
    for (let i = 0; i < rows; i++) if (weight.values[i] !== 1 && !plain[stage.values[i]]) found[run.values[i] * stages + stage.values[i]] = 1;
    return found;
  }
}
