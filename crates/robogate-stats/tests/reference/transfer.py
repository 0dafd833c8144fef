"""Writes transfer.json: prediction-powered intervals of a mean by ppi-python, at fixed and tuned lambda.

Usage: python transfer.py   (packages: requirements.txt)
"""

import json
from pathlib import Path

import numpy as np
from ppi_py import ppi_mean_ci, ppi_mean_pointestimate

random = np.random.default_rng(2026)
cases = []
for n, big, strength in [(20, 100, 3.0), (30, 150, 1.0), (60, 200, 5.0), (50, 80, 0.0)]:
    x = random.normal(size=n + big)
    truth = 1 / (1 + np.exp(-(1 + strength * x)))
    y = (random.random(n) < truth[:n]).astype(float)
    f = np.round(1 / (1 + np.exp(-(0.5 + 0.8 * strength * x + 0.3 * random.normal(size=n + big)))), 3)
    for lam in [0.0, 1.0, None]:
        estimate = ppi_mean_pointestimate(y, f[:n], f[n:], lam=lam)
        low, high = ppi_mean_ci(y, f[:n], f[n:], alpha=0.05, lam=lam)
        number = lambda v: float(np.ravel(v)[0])
        cases.append(
            {"y": y.tolist(), "f": f[:n].tolist(), "population": f[n:].tolist(), "lambda": lam,
             "estimate": number(estimate), "low": number(low), "high": number(high)}
        )
Path(__file__).with_name("transfer.json").write_text(json.dumps(cases) + "\n")
