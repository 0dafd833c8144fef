"""Writes ridge.json: scikit-learn and SciPy reference values for penalised fits, Student quantiles and crossed means.

    python3 -m venv venv && venv/bin/pip install -r requirements.txt && venv/bin/python ridge.py
"""

import json
import math
import pathlib

import numpy as np
import scipy.stats as st
from scipy.special import expit
from sklearn.linear_model import LogisticRegression

OUT = {}


def lst(a):
    return [float(v) for v in np.asarray(a).ravel()]


def formula(n, multiplier, modulus):
    """((i * multiplier) mod modulus) / modulus, i = 0..n-1: the same doubles in Rust."""
    return ((np.arange(n) * multiplier) % modulus) / modulus


# The last two columns determine each other; only the prior separates them.
n = 300
a, b, c = formula(n, 37, 101) * 2 - 1, formula(n, 53, 211) * 2 - 1, formula(n, 71, 307) * 2 - 1
X = np.column_stack([a, b, a * b, c, 2 * c])
y = formula(n, 29, 97) < expit(3 * a - 2 * b + a * b)
w = 0.5 + formula(n, 11, 13)
fresh = np.array([[0.0, 0.0, 0.0, 0.0, 0.0], [0.9, -0.9, -0.81, 0.3, 0.6], [-1.0, 4.0, -4.0, -3.0, -6.0]])

OUT["ridge"] = []
for s2, weights in [(0.01, None), (1.0, None), (100.0, None), (1.0, w)]:
    model = LogisticRegression(C=s2, solver="newton-cholesky", tol=1e-12, max_iter=1000)
    model.fit(X, y, sample_weight=weights)
    beta = np.concatenate([model.intercept_, model.coef_[0]])
    # Evidence and moderated output, written from MacKay (1992) with explicit determinants.
    design = np.column_stack([np.ones(n), X])
    p = expit(design @ beta)
    sw = np.ones(n) if weights is None else weights
    log_likelihood = float(np.sum(sw * np.where(y, np.log(p), np.log1p(-p))))
    hessian = design.T @ (design * (sw * p * (1 - p))[:, None]) + np.diag([0.0] + [1 / s2] * 5)
    evidence = log_likelihood - np.sum(beta[1:] ** 2) / (2 * s2) - 2.5 * math.log(s2) - 0.5 * np.linalg.slogdet(hessian)[1]
    rows = np.column_stack([np.ones(len(fresh)), fresh])
    variance = np.einsum("ij,jk,ik->i", rows, np.linalg.inv(hessian), rows)
    OUT["ridge"].append(
        {
            "s2": s2,
            "weighted": weights is not None,
            "beta": lst(beta),
            "log_likelihood": log_likelihood,
            "evidence": float(evidence),
            "moderated": lst(expit(rows @ beta / np.sqrt(1 + math.pi * variance / 8))),
        }
    )

# With equal rows, the interval is Student's over repeats.
repeats = np.array([0.031, 0.027, 0.044, 0.012, 0.029])
OUT["repeats"] = {
    "values": lst(repeats),
    "interval": lst(st.t.interval(0.95, len(repeats) - 1, loc=repeats.mean(), scale=st.sem(repeats))),
}
# Repeats and rows together, by explicit sums.
table = np.array([[((r * 31 + i * 17 + r * i * 7) % 23) / 23 for i in range(11)] for r in range(4)])
v_r, v_i = st.sem(table.mean(axis=1)) ** 2, st.sem(table.mean(axis=0)) ** 2
df = (v_r + v_i) ** 2 / (v_r**2 / 3 + v_i**2 / 10)
OUT["crossed"] = {
    "interval": lst(st.t.interval(0.9, df, loc=table.mean(), scale=math.sqrt(v_r + v_i))),
    "se_repeats": math.sqrt(v_r),
    "se_rows": math.sqrt(v_i),
}

pathlib.Path(__file__).with_name("ridge.json").write_text(json.dumps(OUT, indent=1) + "\n")
