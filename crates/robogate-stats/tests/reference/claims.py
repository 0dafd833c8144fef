"""Writes claims.json: SciPy and statsmodels reference values for the tests behind headlines.

    python3 -m venv venv && venv/bin/pip install -r requirements.txt && venv/bin/python claims.py
"""

import json
import math
import pathlib

import numpy as np
import scipy.stats as st
import statsmodels.api as sm

OUT = {}


def formula(n, multiplier, modulus):
    """((i * multiplier) mod modulus) / modulus, i = 0..n-1: the same doubles in Rust."""
    return ((np.arange(n) * multiplier) % modulus) / modulus


n = 400
a, b, u = formula(n, 37, 101) * 2 - 1, formula(n, 53, 211) * 2 - 1, formula(n, 29, 97)
level = (np.arange(n) * 7) % 5
y = (u < 1 / (1 + np.exp(-(a - 2 * b + 0.8 * (level == 2))))).astype(float)

# Likelihood ratio of five levels, given two numbers.
dummies = np.column_stack([(level == k).astype(float) for k in range(1, 5)])
small = sm.Logit(y, sm.add_constant(np.column_stack([a, b]))).fit(disp=0, tol=1e-12)
large = sm.Logit(y, sm.add_constant(np.column_stack([a, b, dummies]))).fit(disp=0, tol=1e-12)
statistic = 2 * (large.llf - small.llf)
OUT["likelihood_ratio"] = {"statistic": statistic, "df": 4, "ln_p": float(st.chi2.logsf(statistic, 4))}

# Score test of the product, as the Rao test of a generalised linear model (statsmodels).
null = sm.GLM(y, sm.add_constant(np.column_stack([a, b])), family=sm.families.Binomial()).fit(tol=1e-12)
score = null.model.score_test(null.params, exog_extra=(a * b)[:, None])
OUT["score_test"] = {"chi_squared": float(np.ravel(score[0])[0]), "p": float(np.ravel(score[1])[0])}

# Scan of ordered cells by explicit enumeration, with a permutation p-value from 20,000 tables (SciPy's sampler).
cells_n = np.array([20, 25, 30, 15, 40, 35])
cells_k = np.array([9, 14, 21, 10, 17, 14])


def statistic_of(k):
    def ll(k, m):
        return (k * math.log(k / m) if k > 0 else 0) + ((m - k) * math.log((m - k) / m) if k < m else 0)

    total, most = ll(int(k.sum()), int(cells_n.sum())), -math.inf
    for i in range(len(k)):
        for j in range(i, len(k)):
            if (i, j) != (0, len(k) - 1):
                inside_k, inside_n = int(k[i : j + 1].sum()), int(cells_n[i : j + 1].sum())
                rest = ll(int(k.sum()) - inside_k, int(cells_n.sum()) - inside_n)
                most = max(most, ll(inside_k, inside_n) + rest - total)
    return most


seen = statistic_of(cells_k)
sampler = st.multivariate_hypergeom(m=cells_n, n=int(cells_k.sum()))
tables = sampler.rvs(size=20_000, random_state=np.random.default_rng(1))
OUT["scan"] = {
    "n": cells_n.tolist(),
    "k": cells_k.tolist(),
    "log_ratio": seen,
    "p": float(np.mean([statistic_of(k) >= seen - 1e-9 for k in tables])),
}

# Regression estimator on the margins of two stratified parameters (ordinary least squares with known means).
bins_a, bins_b = (formula(n, 37, 101) * 4).astype(int), (formula(n, 53, 211) * 3).astype(int)
shares_a, shares_b = [0.25] * 4, [1 / 3] * 3
design = np.column_stack(
    [np.ones(n)]
    + [(bins_a == k) - shares_a[k] for k in range(3)]
    + [(bins_b == k) - shares_b[k] for k in range(2)]
).astype(float)
ols = sm.OLS(y, design).fit()
OUT["adjusted"] = {"rate": float(ols.params[0]), "se": float(ols.bse[0])}

# The same with piecewise linear functions of two uniform parameters (five and three knots), whose means are integrated.
hats = []
for values, knots in [(formula(n, 37, 101), 5), (formula(n, 53, 211), 3)]:
    places, fine = np.linspace(0, 1, knots), (np.arange(200_000) + 0.5) / 200_000
    for k in range(knots - 1):
        unit = np.eye(knots)[k]
        hats.append(np.interp(values, places, unit) - np.interp(fine, places, unit).mean())
ols = sm.OLS(y, np.column_stack([np.ones(n), *hats]).astype(float)).fit()
OUT["adjusted_linear"] = {"rate": float(ols.params[0]), "se": float(ols.bse[0])}

pathlib.Path(__file__).with_name("claims.json").write_text(json.dumps(OUT, indent=1) + "\n")
