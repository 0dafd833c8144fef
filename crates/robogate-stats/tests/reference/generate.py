"""Writes reference.json: what SciPy, statsmodels and scikit-learn say about the cases in tests/.

    python3 -m venv venv && venv/bin/pip install -r requirements.txt && venv/bin/python generate.py

Large data sets are given by formula (see `formula` here and in tests/common), small ones are stored.
Where no library has the estimator (Firth, Newcombe's paired interval, thresholds), it is written here a second
time from its source, by another route than the Rust code takes.
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


# ---------------------------------------------------------------- special functions
z = [0.0, 0.3, 1.0, 1.96, 2.1213, 2.2, 5.0, 12.0, 37.5, 60.0, -0.7, -2.5, -9.0]
OUT["normal"] = [{"z": v, "ln_sf": float(st.norm.logsf(v))} for v in z]
OUT["normal_quantile"] = [
    {"tail": t, "z": float(st.norm.isf(t))} for t in [0.5, 0.4999, 0.25, 0.1, 0.05, 0.025, 0.005, 1e-6, 1e-12, 1e-100, 0.7, 0.975]
]
OUT["beta"] = [
    {"a": a, "b": b, "x": x, "cdf": float(sp.betainc(a, b, x))}
    for a, b, x in [(0.5, 0.5, 0.2), (2, 3, 0.4), (1, 1000, 1e-4), (10, 9991, 0.002), (5e5, 5e5, 0.4985), (3e5, 7e5, 0.301), (50, 0.5, 0.99), (0.5, 4999, 1e-9)]
]
OUT["chi_squared"] = [{"df": d, "x": x, "ln_sf": float(st.chi2.logsf(x, d))} for d, x in [(1, 0.01), (1, 3.84), (4, 2.0), (4, 30.0), (30, 25.0), (9, 100.0), (100, 130.0)]]
OUT["student"] = [{"df": d, "t": t, "ln_p": float(math.log(2) + st.t.logsf(abs(t), d))} for d, t in [(1, 0.5), (3, 2.0), (10, -1.5), (998, 4.0), (50, 9.0), (5, 0.01)]]

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
    """Maximises ln L + 1/2 ln det I directly: Nelder-Mead to get near, then roots of its numerical gradient."""
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

# Overwhelming evidence, by formula: p far below the smallest double.
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

path = pathlib.Path(__file__).parent / "reference.json"
path.write_text(json.dumps(OUT, separators=(",", ":"), allow_nan=False) + "\n")
print(path, path.stat().st_size, "bytes")
