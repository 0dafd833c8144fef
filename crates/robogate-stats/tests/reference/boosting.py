"""Writes boosting.json: LightGBM and scikit-learn reference values for gradient boosting and for splines.

    python3 -m venv venv && venv/bin/pip install -r requirements.txt && venv/bin/python boosting.py
"""

import json
import pathlib

import numpy as np
from lightgbm import LGBMClassifier
from scipy.special import expit
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.linear_model import LogisticRegression

TREES, RATE, LEAVES, ROWS = 100, 0.1, 15, 20
MONOTONE = [1, -1, 0, 0]
rng = np.random.default_rng(20)


def sample(n):
    """Columns rounded to four decimals, the chance of success and the outcome."""
    x = np.round(rng.uniform(-1, 1, (n, 4)), 4)
    x[:, 3] = np.round(2 * x[:, 3])  # five values
    p = expit(3 * np.tanh(3 * x[:, 0]) - 2 * x[:, 1] * (x[:, 1] > 0) + 2 * x[:, 0] * x[:, 2] + 0.3 * x[:, 3])
    return x, p, rng.uniform(size=n) < p


train, _, y = sample(1500)
test, truth, outcome = sample(1500)


def scores(p):
    return {
        "brier": float(np.mean((p - outcome) ** 2)),
        "error": float(np.mean((p - truth) ** 2)),
        "first": [round(float(v), 6) for v in p[:200]],
    }


lightgbm = LGBMClassifier(
    n_estimators=TREES, learning_rate=RATE, num_leaves=LEAVES, min_child_samples=ROWS, min_child_weight=0.0,
    reg_lambda=1.0, max_bin=64, min_data_in_bin=1, monotone_constraints=MONOTONE, deterministic=True, n_jobs=1,
    force_row_wise=True, verbose=-1,
).fit(train, y)
histogram = HistGradientBoostingClassifier(
    max_iter=TREES, learning_rate=RATE, max_leaf_nodes=LEAVES, min_samples_leaf=ROWS, l2_regularization=1.0,
    max_bins=64, monotonic_cst=MONOTONE, early_stopping=False,
).fit(train, y)


def terms(x):
    """A line for each column, hinges at the quartiles of the training rows, and products of the first three."""
    out = []
    for j in range(4):
        ordered = np.sort(train[:, j])
        knots = dict.fromkeys(ordered[q * len(ordered) // 4] for q in (1, 2, 3))
        out += [x[:, j]] + [np.maximum(x[:, j] - k, 0) for k in knots]
    for i in range(3):
        out += [x[:, j] * x[:, i] for j in range(i)]
    return np.column_stack(out)


base = terms(train)
mean, deviation = base.mean(0), base.std(0)
keep = deviation > 1e-9
standard = lambda x: ((terms(x) - mean) / np.where(keep, deviation, 1))[:, keep]
splines = []
for variance in (0.02, 0.1, 0.5):
    model = LogisticRegression(C=variance, solver="newton-cholesky", tol=1e-12, max_iter=1000).fit(standard(train), y)
    splines.append(scores(model.predict_proba(standard(test))[:, 1]))

OUT = {
    "options": {"trees": TREES, "learning_rate": RATE, "leaves": LEAVES, "rows_of_leaf": ROWS},
    "train": {"columns": train.T.tolist(), "success": [bool(v) for v in y]},
    "test": {"columns": test.T.tolist(), "success": [bool(v) for v in outcome], "p": [round(float(v), 8) for v in truth]},
    "lightgbm": scores(lightgbm.predict_proba(test)[:, 1]),
    "histogram": scores(histogram.predict_proba(test)[:, 1]),
    "splines": splines,
}
pathlib.Path(__file__).with_name("boosting.json").write_text(json.dumps(OUT) + "\n")
