// Intervals of a success rate. The tests compare them with those of crates/robogate-stats/src/interval.rs.

/** The two-sided 95 % point of the standard normal distribution. */
const Z = 1.959963984540054;

/** The smaller root of the score equation, without cancellation near 0. */
function wilsonLow(k, n) {
  const zz = Z * Z;
  const larger = (2 * k + zz + Z * Math.sqrt(zz + (4 * k * (n - k)) / n)) / (2 * (n + zz));
  return (k * k) / (n * (n + zz)) / larger;
}

/** The 95 % interval of Wilson (1927). Without trials it is [0, 1]. */
export function wilson(k, n) {
  return n > 0 ? [wilsonLow(k, n), 1 - wilsonLow(n - k, n)] : [0, 1];
}

/** ln Γ(x) by the approximation of Lanczos (1964) with g = 7 and nine terms. */
function lnGamma(x) {
  const c = [
    0.99999999999980993, 676.5203681218851, -1259.1392167224028, 771.32342877765313, -176.61502916214059,
    12.507343278686905, -0.13857109526572012, 9.9843695780195716e-6, 1.5056327351493116e-7,
  ];
  const t = x + 6.5;
  const sum = c.reduce((s, value, i) => (i === 0 ? value : s + value / (x - 1 + i)), 0);
  return 0.5 * Math.log(2 * Math.PI) + (x - 0.5) * Math.log(t) - t + Math.log(sum);
}

/** The continued fraction of the incomplete beta function, by the method of Lentz (1976). */
function betaFraction(a, b, x) {
  const tiny = 1e-300;
  let c = 1, d = 1 - ((a + b) * x) / (a + 1);
  d = 1 / (Math.abs(d) < tiny ? tiny : d);
  let h = d;
  for (let m = 1; m < 10000; m++) {
    for (const top of [(m * (b - m) * x) / ((a + 2 * m - 1) * (a + 2 * m)), (-(a + m) * (a + b + m) * x) / ((a + 2 * m) * (a + 2 * m + 1))]) {
      d = 1 + top * d;
      c = 1 + top / c;
      d = 1 / (Math.abs(d) < tiny ? tiny : d);
      if (Math.abs(c) < tiny) c = tiny;
      h *= d * c;
    }
    if (Math.abs(d * c - 1) < 1e-15) break;
  }
  return h;
}

/** The regularised incomplete beta function. */
function beta(a, b, x) {
  if (x <= 0 || x >= 1) return x <= 0 ? 0 : 1;
  const front = Math.exp(lnGamma(a + b) - lnGamma(a) - lnGamma(b) + a * Math.log(x) + b * Math.log1p(-x));
  return x < (a + 1) / (a + b + 2) ? (front * betaFraction(a, b, x)) / a : 1 - (front * betaFraction(b, a, 1 - x)) / b;
}

function exactLow(k, n) {
  if (k <= 0) return 0;
  let low = 0, high = 1;
  for (let i = 0; i < 60; i++) {
    const middle = 0.5 * (low + high);
    if (beta(k, n - k + 1, middle) < 0.025) low = middle;
    else high = middle;
  }
  return 0.5 * (low + high);
}

/** The exact 95 % interval of Clopper and Pearson (1934). Without trials it is [0, 1]. */
export function clopperPearson(k, n) {
  return n > 0 ? [exactLow(k, n), 1 - exactLow(n - k, n)] : [0, 1];
}
