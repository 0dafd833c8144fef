// The predicted chance of success of every row, a part in each frame.

/** Rows between two looks at the clock. */
const BLOCK = 128;

export class Predictor {
  constructor(explorer) {
    this.explorer = explorer;
    this.known = 0;
  }

  /** The column of the predictions. It is absent until a run has a model. */
  get column() {
    return this.explorer.prediction;
  }

  /** Computes the predictions of all rows, or of those that have none. */
  restart(all) {
    const { data } = this.explorer, { column } = this;
    if (!column) return;
    this.known = all ? 0 : Math.min(this.known, data.rows);
    if (column.values.length < data.rows) {
      const values = new Float32Array(data.room).fill(NaN);
      values.set(column.values.subarray(0, this.known));
      column.values = values;
    }
    Object.assign(column, { units: null, order: null, filled: data.rows });
    this.done = false;
    this.explorer.wake();
  }

  step(deadline) {
    const { data, models } = this.explorer, { column } = this;
    if (!column || this.done) return true;
    const arrays = data.columns.map((one) => one.values);
    while (this.known < data.rows && performance.now() < deadline) {
      const end = Math.min(data.rows, this.known + BLOCK);
      for (let row = this.known; row < end; row++) {
        const model = models[data.run.values[row]];
        column.values[row] = model ? model.of(arrays, row) : NaN;
      }
      this.known = end;
    }
    if (this.known < data.rows) return false;
    this.done = true;
    Object.assign(column, { units: null, order: null });
    this.explorer.predicted();
    return true;
  }
}
