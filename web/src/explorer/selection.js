// The rows that all filters keep, and their success rate.

/** Filters by column, each with a bit of its own; a lasso has the last one. */
const LASSO = 31;

export class Selection {
  constructor(data) {
    this.data = data;
    this.filters = new Map();
    this.slots = new Map();
    this.failed = new Uint32Array(0);
    this.lasso = null;
    this.kept = 0;
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
    if (filter) this.filters.set(column, filter);
    else this.filters.delete(column);
    this.mark(column, slot, 0);
    if (!filter) this.slots.delete(column);
    this.count();
  }

  mark(column, slot, from) {
    const bit = (1 << slot) >>> 0, { failed, data } = this;
    const filter = this.filters.get(column), { values } = column;
    if (!filter) {
      for (let i = from; i < data.rows; i++) failed[i] &= ~bit;
    } else if (filter.levels) {
      const kept = new Uint8Array(column.levels.length);
      filter.levels.forEach((level) => { kept[level] = 1; });
      for (let i = from; i < data.rows; i++) {
        if (kept[values[i]] === 1) failed[i] &= ~bit;
        else failed[i] |= bit;
      }
    } else {
      const { low, high } = filter;
      for (let i = from; i < data.rows; i++) {
        if (values[i] >= low && values[i] <= high) failed[i] &= ~bit;
        else failed[i] |= bit;
      }
    }
  }

  /** Sets the lasso: { inside(row), text }, or null. */
  draw(lasso, from = 0) {
    this.lasso = lasso;
    const bit = (1 << LASSO) >>> 0, { failed, data } = this;
    for (let i = from; i < data.rows; i++) {
      if (!lasso || lasso.inside(i)) failed[i] &= ~bit;
      else failed[i] |= bit;
    }
    this.count();
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
    const from = all ? 0 : Math.min(this.failed.length, this.known ?? 0);
    if (this.failed.length < this.data.rows) {
      const failed = new Uint32Array(this.data.room);
      failed.set(this.failed.subarray(0, from));
      this.failed = failed;
    }
    if (all) this.failed.fill(0);
    for (const [column, slot] of this.slots) this.mark(column, slot, from);
    this.known = this.data.rows;
    if (this.lasso) this.draw(this.lasso, from);
    else this.count();
  }

  /**
   * Counts the selection: for each run, valid rows and successes of stages that sample the operating space, rows of other
   * stages, and invalid rows.
   */
  count() {
    const { data, failed } = this;
    const { run, stage, outcome } = data;
    const focused = this.focused();
    const invalid = outcome.levels.indexOf("invalid");
    const runs = data.runs.map(() => ({ n: 0, k: 0, focused: 0, invalid: 0, rows: 0 }));
    this.outcomes = new Array(outcome.levels.length).fill(0);
    this.kept = 0;
    for (let i = 0; i < data.rows; i++) {
      if (failed[i] !== 0) continue;
      this.kept += 1;
      const of = runs[run.values[i]], code = outcome.values[i];
      this.outcomes[code] += 1;
      of.rows += 1;
      if (code === invalid) of.invalid += 1;
      else if (focused[stage.values[i]]) of.focused += 1;
      else {
        of.n += 1;
        if (code === 0) of.k += 1;
      }
    }
    this.runs = runs;
  }

  /**
   * The stages whose points were not sampled from the operating space: the boundary and the active stage, and any unknown
   * stage whose weights are not all 1. The analysis also counts the uniform part of the active stage, so it has more rows.
   */
  focused() {
    const { stage, weight, rows } = this.data;
    if (this.focusedFor === rows && this.focusedStages.length === stage.levels.length) return this.focusedStages;
    const plain = (name) => name === "uniform" || name === "imported";
    const found = stage.levels.map((name) => name === "boundary" || name === "active");
    for (let i = 0; i < rows; i++) {
      const at = stage.values[i];
      if (!found[at] && weight.values[i] !== 1 && !plain(stage.levels[at])) found[at] = true;
    }
    [this.focusedFor, this.focusedStages] = [rows, found];
    return found;
  }
}
