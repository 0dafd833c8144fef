"""Times statsmodels, scikit-learn and SciPy on the columns written by the benchmark. Prints one JSON line with seconds.

    python peers.py FOLDER ROWS COLUMNS

FOLDER contains x.f64 (COLUMNS runs of ROWS little-endian doubles), outcomes.u8, scores.f64. Packages as in
../tests/reference/requirements.txt. The thresholds take the first 20,000 rows and five columns, as the benchmark does.
"""

import json
import pathlib
import sys
import time

import numpy as np
import scipy.stats as st
import sklearn.isotonic as ski
import sklearn.linear_model as skl
import sklearn.metrics as skm
import statsmodels.api as sm

folder, rows, columns = pathlib.Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
x = np.fromfile(folder / "x.f64", "<f8").reshape(columns, rows).T
x = np.ascontiguousarray(x)
y = np.fromfile(folder / "outcomes.u8", "u1")
scores = np.fromfile(folder / "scores.f64", "<f8")


def timed(work):
    begun = time.perf_counter()
    result = work()
    return time.perf_counter() - begun, result


def thresholds(replicates):
    """Isotonic fit of 20 equal-count bins and its crossing of one half, five columns of 20,000 rows."""
    rng = np.random.default_rng(1)
    n = 20_000
    for column in range(5):
        edges = np.quantile(x[:n, column], np.linspace(0, 1, 21))
        bins = np.clip(np.searchsorted(edges, x[:n, column], "right") - 1, 0, 19)
        centres = 0.5 * (edges[1:] + edges[:-1])
        for _ in range(replicates):
            i = rng.integers(0, n, n)
            count = np.bincount(bins[i], minlength=20)
            rate = np.bincount(bins[i], weights=y[:n][i], minlength=20) / count
            fit = ski.isotonic_regression(rate, sample_weight=count, increasing=bool(np.corrcoef(centres, rate)[0, 1] > 0))
            np.interp(0.5, np.sort(fit), centres)


design = sm.add_constant(x)
out = {}
out["logistic, statsmodels Logit (Newton)"], fit = timed(lambda: sm.Logit(y, design).fit(disp=0))
out["logistic, scikit-learn (lbfgs, no penalty, no errors)"], _ = timed(
    lambda: skl.LogisticRegression(C=np.inf, max_iter=1000, tol=1e-8).fit(x, y)
)
out["auc without an interval, scikit-learn"], _ = timed(lambda: skm.roc_auc_score(y, scores))
seconds, _ = timed(lambda: thresholds(50))
out["thresholds, bootstrap of 1,000 (from 50), NumPy and scikit-learn"] = seconds * 20
out["spearman, SciPy"], _ = timed(lambda: st.spearmanr(x[:, 0], scores))
print(json.dumps({"seconds": out, "coefficients": [float(v) for v in fit.params], "auc": float(skm.roc_auc_score(y, scores))}))
