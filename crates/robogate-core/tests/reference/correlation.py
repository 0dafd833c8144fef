"""Writes correlation.json: SciPy and NumPy reference values for Gaussian copulas and Iman and Conover's method.

    python3 -m venv venv && venv/bin/pip install numpy==2.4.6 scipy==1.17.1 && venv/bin/python correlation.py
"""

import json
import math
import pathlib

import numpy as np
import scipy.integrate as si
import scipy.stats as st
from scipy.special import ndtr

OUT = {}


def lst(a):
    return [float(v) for v in np.asarray(a).ravel()]


# ---------------------------------------------------------------- Spearman's rho of a Gaussian copula
# rho_S = 12 int int C(u, v) du dv - 3 = 12 E[Phi(X) Phi(Y)] - 3, by quadrature over the normal density, independently of
# the closed form rho_S = (6/pi) asin(r/2).


def spearman(r):
    def inner(x):
        # E[Phi(Y) | X = x] with Y | x ~ N(r x, 1 - r^2).
        return ndtr(r * x / math.sqrt(2 - r * r)) * ndtr(x) * st.norm.pdf(x)

    return 12 * si.quad(inner, -12, 12, epsabs=1e-13)[0] - 3


OUT["copula"] = [{"pearson": r, "rank": spearman(r)} for r in [-0.95, -0.5, -0.1, 0.2, 0.6, 0.9, 0.99]]

# ---------------------------------------------------------------- Iman and Conover (1982), one pass
rng = np.random.default_rng(20261121)
n, d = 40, 3
columns = np.array([rng.permutation(n) for _ in range(d)]).T
rank = np.array([[1, 0.8, -0.3], [0.8, 1, 0], [-0.3, 0, 1]])
target = 2 * np.sin(np.pi / 6 * rank)
np.fill_diagonal(target, 1)
scores = ndtri((columns + 1) / (n + 1))
have = np.corrcoef(scores, rowvar=False)
moved = scores @ np.linalg.inv(np.linalg.cholesky(have)).T @ np.linalg.cholesky(target).T
after = np.array([st.rankdata(moved[:, j], method="ordinal") - 1 for j in range(d)]).T.astype(int)
OUT["iman_conover"] = {
    "columns": [[int(v) for v in columns[:, j]] for j in range(d)],
    "target": lst(target),
    "after": [[int(v) for v in after[:, j]] for j in range(d)],
    "spearman": lst(st.spearmanr(after).statistic),
}

pathlib.Path(__file__).with_name("correlation.json").write_text(json.dumps(OUT) + "\n")
