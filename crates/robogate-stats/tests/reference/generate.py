"""Writes reference.json: reference values of SciPy, statsmodels and scikit-learn for the tests.

    python3 -m venv venv && venv/bin/pip install -r requirements.txt && venv/bin/python generate.py

Large data sets are computed by formula (see `formula` here and in tests/agreement), small ones are stored.
Estimators without a library implementation (Firth, Newcombe's paired interval, thresholds) are implemented here
independently from their source, with a different method than the Rust code.
"""

import json
import math
import pathlib

import numpy as np
import scipy.optimize as so
import scipy.special as sp
import scipy.stats as st
import sklearn.calibration as skc
import sklearn.metrics as skm
import statsmodels.api as sm
import statsmodels.stats.contingency_tables as ct
import statsmodels.stats.multitest as mt
import statsmodels.stats.proportion as prop

OUT = {}
rng = np.random.default_rng(20261121)


def lst(a):
    return [float(v) for v in np.asarray(a).ravel()]


def formula(n, multiplier, modulus):
    """((i * multiplier) mod modulus) / modulus, i = 0..n-1: the same doubles in Rust."""
    return ((np.arange(n) * multiplier) % modulus) / modulus


# ---------------------------------------------------------------- intervals
OUT["interval"] = []
for k, n in [(0, 1), (1, 1), (0, 20), (20, 20), (1, 20), (3, 8), (7, 10), (10, 10_000), (9_990, 10_000), (7432, 10_000), (500_123, 1_000_000), (1, 1_000_000)]:
    for level in [0.8, 0.95, 0.999]:
        w = prop.proportion_confint(k, n, 1 - level, method="wilson")
        c = prop.proportion_confint(k, n, 1 - level, method="beta")
        OUT["interval"].append({"k": k, "n": n, "level": level, "wilson": lst(w), "clopper_pearson": [0.0 if k == 0 else float(c[0]), 1.0 if k == n else float(c[1])]})

# ---------------------------------------------------------------- logistic regression


def logit_reference(x, y, weights=None, cov_type="nonrobust", weight_kind="freq"):
    design = sm.add_constant(np.column_stack(x))
    if weights is not None:
        design, y, weights = design[weights > 0], y[weights > 0], weights[weights > 0]
    kw = {}
    if weights is not None:
        kw = {f"{weight_kind}_weights": weights}
    fit = sm.GLM(y.astype(float), design, family=sm.families.Binomial(), **kw).fit(tol=1e-14, maxiter=200, cov_type=cov_type)
    p = design @ fit.params
    w = np.ones(len(y)) if weights is None else weights
    ll = float(np.sum(w * -np.logaddexp(0, np.where(y, -p, p))))
    return {
        "estimate": lst(fit.params),
        "se": lst(fit.bse),
        "z": lst(fit.tvalues),
        "ln_p": lst(math.log(2) + st.norm.logsf(np.abs(fit.tvalues))),
        "covariance": lst(fit.cov_params()),
        "log_likelihood": ll,
    }


def penalised(beta, design, y, w):
    eta = design @ beta
    ll = np.sum(w * -np.logaddexp(0, np.where(y, -eta, eta)))
    p = sp.expit(eta)
    info = design.T @ (design * (w * p * (1 - p))[:, None])
    sign, ld = np.linalg.slogdet(info)
    return -(ll + 0.5 * ld) if sign > 0 else np.inf


def firth_reference(x, y, weights=None):
    """Maximises ln L + 1/2 ln det I directly: Nelder-Mead for the start, then roots of its numerical gradient."""
    design = sm.add_constant(np.column_stack(x))
    w = np.ones(len(y)) if weights is None else weights
    q = design.shape[1]
    f = lambda b: penalised(b, design, y, w)
    b = so.minimize(f, np.zeros(q), method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-13, "maxiter": 40000, "maxfev": 40000}).x

    def gradient(b):
        g = np.zeros(q)
        for j in range(q):
            h = 1e-3 * (1 + abs(b[j]))
            e = np.zeros(q)
            e[j] = h
            # Sixth-order central difference.
            g[j] = (45 * (f(b + e) - f(b - e)) - 9 * (f(b + 2 * e) - f(b - 2 * e)) + (f(b + 3 * e) - f(b - 3 * e))) / (60 * h)
        return g

    b = so.root(gradient, b, tol=1e-13).x
    p = sp.expit(design @ b)
    cov = np.linalg.inv(design.T @ (design * (w * p * (1 - p))[:, None]))
    return {"estimate": lst(b), "se": lst(np.sqrt(np.diag(cov))), "objective": -float(f(b))}


def firth_profile_reference(x, y, column, level):
    design = sm.add_constant(np.column_stack(x))
    w = np.ones(len(y))
    q = design.shape[1]
    j = column + 1
    best = firth_reference(x, y)
    top = best["objective"]
    limit = st.chi2.ppf(level, 1) / 2

    def drop(value):
        others = [i for i in range(q) if i != j]

        def f(free):
            b = np.zeros(q)
            b[others] = free
            b[j] = value
            return penalised(b, design, y, w)

        r = so.minimize(f, np.array(best["estimate"])[others], method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-14, "maxiter": 40000, "maxfev": 40000})
        return top + r.fun

    est = best["estimate"][j]
    step = best["se"][j]
    ends = []
    for side in [-1, 1]:
        far = est + side * step
        while drop(far) < limit:
            far += side * step
        ends.append(so.brentq(lambda v: drop(v) - limit, est, far, xtol=1e-10))
    return {"estimate": est, "interval": ends, "ln_p": float(st.chi2.logsf(2 * drop(0.0), 1))}


n = 300
x0 = np.round(rng.uniform(0.05, 1.2, n), 4)
x1 = np.round(rng.uniform(0.05, 2.0, n), 4)
x2 = np.round(rng.normal(1000.0, 3.0, n), 3)
y = rng.uniform(size=n) < sp.expit(-1.5 + 3.7 * x0 - 0.4 * x1 - 1.4 * x0 * x1 + 0.1 * (x2 - 1000))
w = np.round(rng.uniform(0.2, 3.0, n), 2)
w[:5] = 0.0
mean, sd = [c.mean() for c in (x0, x1, x2)], [c.std() for c in (x0, x1, x2)]
plain = {
    "columns": [lst(x0), lst(x1), lst(x2)],
    "outcomes": [bool(v) for v in y],
    "weights": lst(w),
    "raw": logit_reference([x0, x1, x2], y),
    "standardized": logit_reference([(c - c.mean()) / c.std() for c in (x0, x1, x2)], y),
    "weighted": logit_reference([x0, x1, x2], y, w),
    "sandwich": logit_reference([x0, x1, x2][:], y, w, cov_type="HC0", weight_kind="var"),
    "firth": firth_reference([(x0 - mean[0]) / sd[0], (x1 - mean[1]) / sd[1], (x2 - mean[2]) / sd[2]], y),
    "firth_weighted": firth_reference([x0, x1], y, w),
}
OUT["plain"] = plain

# 10 successes in 10,000, by formula.
u = formula(10_000, 7919, 10_007)
v = formula(10_000, 104_729, 99_991)
rare_rows = [17, 420, 1001, 2502, 3333, 5150, 6007, 7777, 9001, 9998]
yr = np.zeros(10_000, bool)
yr[rare_rows] = True
OUT["rare"] = {"rows": rare_rows, "raw": logit_reference([u, v], yr), "firth": firth_reference([u, v], yr)}

# A very strong effect, by formula: p is far below the smallest double.
u = formula(20_000, 7919, 20_011)
v = formula(20_000, 104_729, 99_991)
OUT["overwhelming"] = {"raw": logit_reference([u], (u + 0.8 * (v - 0.5)) > 0.5)}

# Complete separation: success exactly above 0.5. Quasi: one of three placements never succeeds.
xs = np.array([0.1, 0.2, 0.3, 0.45, 0.55, 0.7, 0.8, 0.95])
ys = xs > 0.5
OUT["complete"] = {"columns": [lst(xs)], "outcomes": [bool(b) for b in ys], "firth": firth_reference([xs], ys), "profile": firth_profile_reference([xs], ys, 0, 0.95)}
m = 120
xa = np.round(rng.uniform(0, 1, m), 3)
place = np.arange(m) % 3
yq = (rng.uniform(size=m) < sp.expit(2 * xa - 0.5)) & (place != 2)
d1, d2 = (place == 1).astype(float), (place == 2).astype(float)
OUT["quasi"] = {
    "columns": [lst(xa), lst(d1), lst(d2)],
    "outcomes": [bool(b) for b in yq],
    "firth": firth_reference([xa, d1, d2], yq),
    "profile": firth_profile_reference([xa, d1, d2], yq, 2, 0.95),
    "profile_x": firth_profile_reference([xa, d1, d2], yq, 0, 0.95),
}

# ---------------------------------------------------------------- limit state


def limit_reference(fit, at, level):
    """Delta method by numerical gradient; compatible set by scanning and bisecting |eta| - z se."""
    b = np.array(fit["estimate"])
    cov = np.array(fit["covariance"]).reshape(4, 4)
    zz = st.norm.isf((1 - level) / 2)
    rows = []
    for y_ in at:
        star = lambda c: -(c[0] + c[2] * y_) / (c[1] + c[3] * y_)
        g = so.approx_fprime(b, star, 1e-7)
        g = np.array([(star(b + h) - star(b - h)) / 2e-5 for h in 1e-5 * np.eye(4)])
        x_ = star(b)

        def excess(x):
            v = np.array([1, x, y_, x * y_])
            return abs(v @ b) - zz * math.sqrt(v @ cov @ v)

        grid = np.linspace(x_ - 40, x_ + 40, 160_001)
        inside = np.array([excess(v) for v in grid]) <= 0
        ends = [so.brentq(excess, grid[i], grid[i + 1], xtol=1e-13) for i in np.flatnonzero(np.diff(inside))]
        rows.append({"y": y_, "x": float(x_), "se": float(math.sqrt(g @ cov @ g)), "ends": lst(ends)})
    return rows


product = x0 * x1
surface = logit_reference([x0, x1, product], y)
OUT["limit_state"] = {"points": limit_reference(surface, [0.1, 0.7, 1.3], 0.95)}

# ---------------------------------------------------------------- ROC


def delong(scores_a, scores_b, outcomes):
    """The textbook kernel over all pairs; covariance of two AUCs on the same rows, one term for each class."""
    k = lambda s: (s[outcomes][:, None] > s[~outcomes]) + 0.5 * (s[outcomes][:, None] == s[~outcomes])
    ka, kb = k(scores_a), k(scores_b)
    m, n_ = ka.shape
    return ka.mean(), np.array([np.cov(ka.mean(1), kb.mean(1))[0, 1] / m, np.cov(ka.mean(0), kb.mean(0))[0, 1] / n_])


def welch(terms, outcomes):
    """Degrees of freedom of the sum of the two terms."""
    return terms.sum() ** 2 / np.sum(terms**2 / (np.array([outcomes.sum(), (~outcomes).sum()]) - 1))


def obuchowski(scores, outcomes, clusters):
    """The variance of the AUC of clustered rows, with the notation of Obuchowski (1997)."""
    k = (scores[outcomes][:, None] > scores[~outcomes]) + 0.5 * (scores[outcomes][:, None] == scores[~outcomes])
    area, (m, n_) = k.mean(), k.shape
    c10, c01, names = clusters[outcomes], clusters[~outcomes], np.unique(clusters)
    x = np.array([np.sum(k.mean(1)[c10 == c]) - np.sum(c10 == c) * area for c in names])
    y_ = np.array([np.sum(k.mean(0)[c01 == c]) - np.sum(c01 == c) * area for c in names])
    i10, i01, i = len(np.unique(c10)), len(np.unique(c01)), len(names)
    s10, s01 = i10 / ((i10 - 1) * m) * np.sum(x**2), i01 / ((i01 - 1) * n_) * np.sum(y_**2)
    s11 = i / (i - 1) * np.sum(x * y_)
    return s10 / m + s01 / n_ + 2 * s11 / (m * n_)


s1 = np.round(sp.expit(-1.2 + 3 * x0) + rng.normal(0, 0.15, n), 2)
s2 = np.round(x0 - 0.2 * x1, 1)
auc1, terms1 = delong(s1, s1, y)
auc2, terms2 = delong(s2, s2, y)
_, shared = delong(s1, s2, y)
v1, v2, terms = terms1.sum(), terms2.sum(), terms1 + terms2 - 2 * shared
half = st.t.isf(0.025, welch(terms1, y)) * math.sqrt(v1)
difference_se = math.sqrt(terms.sum())
difference_t = abs(auc1 - auc2) / difference_se
assert abs(auc1 - skm.roc_auc_score(y, s1)) < 1e-12 and abs(auc2 - skm.roc_auc_score(y, s2)) < 1e-12
fpr, tpr, thr = skm.roc_curve(y, s2, drop_intermediate=False)
OUT["roc"] = {
    "first": lst(s1),
    "second": lst(s2),
    "auc": [float(skm.roc_auc_score(y, s)) for s in (s1, s2)],
    "se": [math.sqrt(v1), math.sqrt(v2)],
    "clustered_se": math.sqrt(obuchowski(s1, y, np.arange(n) // 3)),
    "interval": [float(auc1 - half), float(auc1 + half)],
    "difference_se": difference_se,
    "difference_ln_p": float(math.log(2) + st.t.logsf(difference_t, welch(terms, y))),
    "fpr": lst(fpr),
    "tpr": lst(tpr),
    "thresholds": lst(thr[1:]),
}
import sklearn.linear_model as skl

folds = np.arange(n) % 5
cv = []
features = np.column_stack([x0, x1])
for k in range(5):
    model = skl.LogisticRegression(C=np.inf, tol=1e-12, max_iter=10_000).fit(features[folds != k], y[folds != k])
    cv.append(float(skm.roc_auc_score(y[folds == k], model.decision_function(features[folds == k]))))
OUT["cross_validated"] = {"folds": cv}

# ---------------------------------------------------------------- calibration
stated = sp.expit(-1.2 + 2.5 * x0)
frac, mean_stated = skc.calibration_curve(y, stated, n_bins=10, strategy="uniform")
which = np.minimum((stated * 10).astype(int), 9)
OUT["calibration"] = {
    "stated": lst(stated),
    "brier": float(skm.brier_score_loss(y, stated)),
    "log_loss": float(skm.log_loss(y, stated)),
    "brier_weighted": float(skm.brier_score_loss(y, stated, sample_weight=w)),
    "log_loss_weighted": float(skm.log_loss(y, stated, sample_weight=w)),
    "observed": lst(frac),
    "mean_stated": lst(mean_stated),
    "expected_error": float(sum(np.sum(which == b) / n * abs(f - m_) for b, f, m_ in zip(np.unique(which), frac, mean_stated))),
}

# ---------------------------------------------------------------- comparisons
OUT["two_rates"] = []
for k1, n1, k2, n2 in [(31, 50, 12, 47), (0, 10, 3, 12), (10, 10, 9, 10), (56, 70, 48, 80), (10, 10_000, 25, 10_000), (7432, 10_000, 3332, 10_000), (1, 1, 0, 1)]:
    z_, _ = prop.proportions_ztest([k1, k2], [n1, n2])
    lo, hi = prop.confint_proportions_2indep(k1, n1, k2, n2, method="newcomb", compare="diff", alpha=0.05)
    OUT["two_rates"].append({"k1": k1, "n1": n1, "k2": k2, "n2": n2, "z": float(z_), "ln_p": float(math.log(2) + st.norm.logsf(abs(z_))), "newcombe": [float(lo), float(hi)]})


def newcombe_paired(a, b, c, d):
    n_ = a + b + c + d
    (l1, u1), (l2, u2) = (prop.proportion_confint(k, n_, 0.05, method="wilson") for k in (a + b, a + c))
    p1, p2 = (a + b) / n_, (a + c) / n_
    margins = (a + b) * (c + d) * (a + c) * (b + d)
    phi = 0.0
    if margins:
        top = a * d - b * c
        phi = (max(top - n_ / 2, 0) if top > 0 else top) / math.sqrt(margins)
    q = lambda s, t: math.sqrt(np.array([s, t]) @ np.array([[1, -phi], [-phi, 1]]) @ np.array([s, t]))
    return [p1 - p2 - q(p1 - l1, u2 - p2), p1 - p2 + q(u1 - p1, p2 - l2)]


OUT["pairs"] = [
    {"table": list(t), "ln_p": float(math.log(ct.mcnemar([[t[0], t[1]], [t[2], t[3]]], exact=True).pvalue)), "newcombe": newcombe_paired(*t)}
    for t in [(20, 9, 3, 11), (36, 12, 2, 0), (0, 5, 0, 7), (60, 6, 2, 32), (50, 1, 1, 48), (1, 0, 0, 0), (500, 120, 20, 360)]
]
# binom.logcdf underflows to -inf far out, so the log masses are summed.
OUT["one_rate"] = [
    {
        "k": k,
        "n": n_,
        "p0": p0,
        "at_most": float(sp.logsumexp(st.binom.logpmf(np.arange(k + 1), n_, p0))),
        "at_least": float(sp.logsumexp(st.binom.logpmf(np.arange(k, n_ + 1), n_, p0))),
    }
    for k, n_, p0 in [(0, 20, 0.3), (3, 20, 0.3), (20, 20, 0.7), (150, 600, 0.3), (10, 10_000, 0.3), (2600, 10_000, 0.3)]
]
ps = [0.04, 0.001, 0.03, 0.03, 0.9, 1e-12, 0.2]
OUT["holm"] = {"p": ps, "adjusted": lst(mt.multipletests(ps, method="holm")[1])}

# ---------------------------------------------------------------- weights
ones = np.ones(n)
keep = w > 0
wls = sm.WLS(y[keep].astype(float), ones[keep], weights=w[keep]).fit(cov_type="HC1")
terms = w * y / 500.0
OUT["weighted"] = {
    "rate": float(wls.params[0]),
    "se": float(wls.bse[0]),
    "effective": float(w.sum() ** 2 / (w**2).sum()),
    "horvitz_thompson": float(terms.sum()),
    "horvitz_thompson_se": float(math.sqrt(n) * terms.std(ddof=1)),
}

# ---------------------------------------------------------------- correlations
r = st.pearsonr(x0, s1)
ci = r.confidence_interval(0.95)
sr = st.spearmanr(s1, s2)
pb = st.pointbiserialr(y, x0)
cat_a, cat_b = (np.arange(n) * 7 % 11) % 4, np.where(y, 1, 0) + (x0 > 0.8)
table = np.array([[np.sum((cat_a == i) & (cat_b == j)) for j in range(3)] for i in range(4)])
chi = st.chi2_contingency(table, correction=False)
two = np.array([[np.sum((x0 > 0.5) == bool(i)) and np.sum(((x0 > 0.5) == bool(i)) & (y == bool(j))) for j in range(2)] for i in range(2)])
OUT["correlation"] = {
    "pearson": {"r": float(r.statistic), "ln_p": float(math.log(r.pvalue)), "interval": lst(ci)},
    "point_biserial": {"r": float(pb.statistic), "ln_p": float(math.log(pb.pvalue))},
    "spearman": {"r": float(sr.statistic), "ln_p": float(math.log(sr.pvalue))},
    "cramer": {"a": [int(v) for v in cat_a], "b": [int(v) for v in cat_b], "v": float(st.contingency.association(table, "cramer")), "chi_squared": float(chi.statistic), "ln_p": float(st.chi2.logsf(chi.statistic, 6)), "smallest_expected": float(chi.expected_freq.min())},
    "phi": float(np.corrcoef(x0 > 0.5, y)[0, 1]),
}

# ---------------------------------------------------------------- failure modes
counts = [3918, 2735, 2098, 1532, 0]
OUT["modes"] = {"counts": counts, "goodman": lst(prop.multinomial_proportions_confint(counts, 0.05, method="goodman"))}

# ---------------------------------------------------------------- thresholds
from sklearn.isotonic import IsotonicRegression

u = formula(4_000, 7919, 4_001)
v = formula(4_000, 104_729, 99_991)
yt = 0.15 + 0.6 * u > v
wt = np.where(np.arange(4_000) % 3 == 0, 2.5, 0.5)
edges = np.linspace(u.min(), u.max(), 11)
bins = np.clip(np.searchsorted(edges, u, side="right") - 1, 0, 9)


def cross(rows, weights, positions):
    wt_ = np.bincount(bins[rows], weights[rows], 10)
    rate = np.bincount(bins[rows], (weights * yt)[rows], 10) / wt_
    fit = IsotonicRegression().fit(np.arange(10), rate, sample_weight=wt_).predict(np.arange(10))
    if fit[0] >= 0.5:
        return -np.inf, fit
    if fit[-1] < 0.5:
        return np.inf, fit
    i = np.flatnonzero(fit > 0.5)[0] - 1
    return positions[i] + (0.5 - fit[i]) / (fit[i + 1] - fit[i]) * (positions[i + 1] - positions[i]), fit


OUT["threshold"] = {}
for name, weights in [("plain", np.ones(4_000)), ("weighted", wt)]:
    positions = np.bincount(bins, weights * u) / np.bincount(bins, weights)
    at, fit = cross(np.arange(4_000), weights, positions)
    reps = np.array([cross(rng.integers(0, 4_000, 4_000), weights, positions)[0] for _ in range(4_000)])
    OUT["threshold"][name] = {"at": float(at), "monotone": lst(fit), "se": float(reps.std(ddof=1)), "interval": lst(np.percentile(reps, [2.5, 97.5]))}

values = np.round(rng.normal(size=37), 3)
OUT["percentile"] = {"values": lst(values), "ends": lst(np.percentile(values, [5, 95])), "sd": float(values.std(ddof=1))}


# ---------------------------------------------------------------- anytime-valid test of a rate, by quadrature
import scipy.integrate as si


def ln_evidence(k, n, p0):
    """ln of the mean likelihood ratio over q uniform on (p0, 1), by adaptive quadrature from its definition."""
    ln_ratio = lambda q: k * math.log(q / p0) + ((n - k) * math.log((1 - q) / (1 - p0)) if n > k else 0.0)
    top = max(ln_ratio(q) for q in np.linspace(p0, 1, 2001)[1:-1])
    points = [q for q in [max(p0, k / n - 0.05), k / n, min(1, k / n + 0.05)] if p0 < q < 1]
    value, _ = si.quad(lambda q: math.exp(ln_ratio(q) - top), p0, 1, points=points or None, epsabs=0, epsrel=1e-12, limit=400)
    return top + math.log(value / (1 - p0))


OUT["anytime"] = []
for k, n, p0 in [(68, 68, 0.92), (64, 68, 0.92), (60, 68, 0.92), (1, 1, 0.5), (0, 5, 0.3), (680, 680, 0.98), (1300, 1360, 0.92), (40, 68, 0.1), (9_950, 10_000, 0.99)]:
    case = {"k": k, "n": n, "p0": p0, "above": ln_evidence(k, n, p0)}
    if 0 < k:
        low = so.brentq(lambda p: ln_evidence(k, n, p) - math.log(20), 1e-9, k / n - 1e-9) if ln_evidence(k, n, 1e-9) > math.log(20) else 0.0
        case["low"] = low
    OUT["anytime"].append(case)

# ---------------------------------------------------------------- mean of a bounded quantity, by betting
def ln_capital(values, looks, ceiling, m):
    x = np.asarray(values) / ceiling
    m = m / ceiling
    paths = [np.cumsum(np.log1p(0.99 * 0.5**j * (m - x) / (1 - m))) for j in range(12)]
    return max(0.0, *[float(sp.logsumexp([path[look - 1] for path in paths]) - math.log(12)) for look in looks])


times = [float(v) for v in np.round(3 + 4 * formula(136, 37, 101), 6)]
OUT["bounded_mean"] = {"values": times, "looks": [68, 136], "ceiling": 15.0, "cases": []}
for m in [4.0, 5.2, 5.5, 7.0, 12.0]:
    mirrored = [15.0 - v for v in times]
    OUT["bounded_mean"]["cases"].append({"m": m, "below": ln_capital(times, [68, 136], 15.0, m), "above": ln_capital(mirrored, [68, 136], 15.0, 15.0 - m)})

# ---------------------------------------------------------------- operating characteristic of a gate in rounds, by an independent implementation
def walk(p0, alpha, beta, per_round, rounds, p):
    """Propagates the counts of all paths, with the closed form of the evidence from SciPy's binomial."""
    def above(k, n, p0):
        """The pooled part of the evidence: all larger rates, typical ones, and "every trial succeeds"."""
        failure = 1 - p0
        always, broad, typical, few, many = (0.02, 0.90, 0.03, 0.2, 0.7) if p0 < 0.5 else (0.52, 0.22, 0.24, 0.15, 0.35) if failure <= 0.015 + 1e-9 else (0.05, 0.60, 0.30, 0.2, 0.7)
        mass = st.binom.logpmf(k, n, p0)
        mixture = st.binom.logcdf(k, n + 1, p0) - math.log((n + 1) * failure) - mass
        # The integral of the binomial likelihood over a range of failure rates.
        inside = np.diff(st.beta.cdf([few * failure, many * failure], n - k + 1, k + 1))[0]
        focus = (math.log(inside) if inside > 0 else -math.inf) - math.log((n + 1) * failure * (many - few)) - mass
        spike = -n * math.log(p0) if k == n else -math.inf
        return np.logaddexp.reduce([math.log(always) + spike, math.log(broad) + mixture, math.log(typical) + focus])
    alive, met, violated, trials = {0: 1.0}, 0.0, 0.0, 0.0
    for r in range(1, rounds + 1):
        trials += per_round * sum(alive.values())
        n, nxt = r * per_round, {}
        for k, mass in alive.items():
            for j, q in enumerate(st.binom.pmf(np.arange(per_round + 1), per_round, p)):
                nxt[k + j] = nxt.get(k + j, 0.0) + mass * float(q)
        alive = {}
        for k, mass in nxt.items():
            if above(k, n, p0) >= -math.log(alpha):
                met += mass
            elif above(n - k, n, 1 - p0) >= -math.log(beta):
                violated += mass
            else:
                alive[k] = mass
    return {"met": met, "violated": violated, "open": sum(alive.values()), "trials": trials}


OUT["operating"] = [
    {"p0": p0, "alpha": 0.05, "beta": 0.01, "per_round": s, "rounds": r, "p": p, **walk(p0, 0.05, 0.01, s, r, p)}
    for p0, s, r, p in [(0.92, 68, 6, 0.92), (0.92, 68, 6, 0.97), (0.92, 68, 6, 0.85), (0.98, 68, 5, 0.995), (0.5, 10, 8, 0.7)]
]

# ---------------------------------------------------------------- non-inferiority of paired rates
def tango_z(b, c, n, d):
    """Score statistic with the constrained likelihood maximised numerically (b: first only, c: second only)."""
    def negative(q):
        return -sum(k * math.log(v) for k, v in [(b, q), (c, q - d), (n - b - c, 1 - 2 * q + d)] if k > 0)
    low, high = d, (1 + d) / 2
    q = so.minimize_scalar(negative, bounds=(low + 1e-13, high - 1e-13), method="bounded", options={"xatol": 1e-13, "maxiter": 2000}).x
    variance = n * (2 * q - d * (1 + d))
    return (c - b + n * d) / math.sqrt(variance)


def exact_p(b, c, n, d):
    """Largest tail probability over the nuisance parameter, with every table enumerated."""
    seen = tango_z(b, c, n, d)
    extreme = [(i, j) for i in range(n + 1) for j in range(n - i + 1) if tango_z(i, j, n, d) >= seen - 1e-6]
    i, j = np.array(extreme).T
    ln_ways = sp.gammaln(n + 1) - sp.gammaln(i + 1) - sp.gammaln(j + 1) - sp.gammaln(n - i - j + 1)
    def tail(q):
        return float(np.exp(ln_ways + sp.xlogy(i, q) + sp.xlogy(j, q - d) + sp.xlogy(n - i - j, np.maximum(1 - 2 * q + d, 0))).sum())
    grid = np.linspace(d, (1 + d) / 2, 2001)
    best = grid[int(np.argmax([tail(q) for q in grid]))]
    step = grid[1] - grid[0]
    found = so.minimize_scalar(lambda q: -tail(q), bounds=(max(d, best - step), min((1 + d) / 2, best + step)), method="bounded", options={"xatol": 1e-12})
    return max(tail(best), -found.fun)


OUT["non_inferiority"] = []
for b, c, n, d in [(1, 3, 30, 0.1), (0, 2, 25, 0.2), (4, 2, 40, 0.15), (6, 9, 40, 0.05), (10, 2, 30, 0.1), (3, 3, 68, 0.05)]:
    case = {"both": n - b - c, "first_only": b, "second_only": c, "margin": d, "tango_p": float(st.norm.sf(tango_z(b, c, n, d)))}
    if n <= 40:
        case["exact_p"] = exact_p(b, c, n, d)
    OUT["non_inferiority"].append(case)


def finite(value, where):
    if isinstance(value, dict):
        for k, v_ in value.items():
            finite(v_, f"{where}.{k}")
    elif isinstance(value, list):
        for i, v_ in enumerate(value):
            finite(v_, f"{where}[{i}]")
    elif isinstance(value, float):
        assert math.isfinite(value), where


finite(OUT, "reference")
path = pathlib.Path(__file__).parent / "reference.json"
path.write_text(json.dumps(OUT, separators=(",", ":"), allow_nan=False) + "\n")
print(path, path.stat().st_size, "bytes")
