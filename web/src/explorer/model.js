// The risk model of a run: ridge logistic regression on splines and products, evaluated from its numbers. The form is that of
// crates/robogate-stats/src/spline_logistic.rs; the calibration that of crates/robogate-risk.

const logistic = (x) => 1 / (1 + Math.exp(-x));

/** A value on the scale of an input. */
function coded(input, value) {
  if (input.level !== undefined) return input.level === value ? 1 : 0;
  if (input.low === input.high) return 0.5;
  return input.log ? Math.log(value / input.low) / Math.log(input.high / input.low) : (value - input.low) / (input.high - input.low);
}

export class Model {
  constructor(document) {
    this.document = document;
    const { terms, factor, coefficients } = document;
    this.size = coefficients.length;
    this.beta = Float64Array.from(coefficients);
    this.mean = Float64Array.from(document.mean);
    this.deviation = Float64Array.from(document.deviation);
    this.factor = Float64Array.from(factor);
    this.terms = terms;
    this.inputs = document.inputs;
    this.row = new Float64Array(this.inputs.length);
    this.z = new Float64Array(this.size);
    /** Inputs of each column of the table. */
    this.columns = [...new Set(this.inputs.map((input) => input.column))];
  }

  /** Sets the inputs of one column of the table. */
  set(column, value) {
    for (let at = 0; at < this.inputs.length; at++) if (this.inputs[at].column === column) this.row[at] = coded(this.inputs[at], value);
  }

  /** The chance of success of a row of these columns. */
  of(columns, row) {
    for (let at = 0; at < this.inputs.length; at++) this.row[at] = coded(this.inputs[at], columns[this.inputs[at].column][row]);
    return this.chance();
  }

  /** The scaled terms of the inputs that are set. */
  scaled() {
    const { row, z } = this;
    z[0] = 1;
    for (let i = 0; i < this.terms.length; i++) {
      const term = this.terms[i];
      const value = term.length === 1 ? row[term[0]] : term.length === 2 ? row[term[0]] * row[term[1]] : Math.max(0, row[term[0]] - term[1]);
      z[i + 1] = (value - this.mean[i]) / this.deviation[i];
    }
  }

  /** The chance of success of the inputs that are set. */
  chance() {
    this.scaled();
    let eta = 0;
    for (let i = 0; i < this.size; i++) eta += this.beta[i] * this.z[i];
    const [intercept, slope] = this.document.calibration;
    return logistic(intercept + slope * eta);
  }

  /** The chance of success and its 95 % interval: posterior mean of the log-odds, and 1.96 posterior standard deviations. */
  interval() {
    this.scaled();
    const { z, factor, size } = this;
    let eta = 0, variance = 0;
    for (let i = 0; i < size; i++) eta += this.beta[i] * z[i];
    for (let i = 0, at = 0; i < size; i++) {
      let value = z[i];
      for (let k = 0; k < i; k++) value -= factor[at + k] * z[k];
      z[i] = value / factor[at + i];
      variance += z[i] * z[i];
      at += i + 1;
    }
    const [intercept, slope] = this.document.calibration;
    const half = 1.959963984540054 * Math.sqrt(variance);
    return [eta, eta - half, eta + half].map((x) => logistic(intercept + slope * x));
  }
}
