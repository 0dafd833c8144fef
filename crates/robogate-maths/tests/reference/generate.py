"""Writes reference.json: SciPy reference values for the special functions.

    python3 -m venv venv && venv/bin/pip install -r requirements.txt && venv/bin/python generate.py
"""

import json
import math
import pathlib

import numpy as np
import scipy.special as sp
import scipy.stats as st

OUT = {}


def lst(a):
    return [float(v) for v in np.asarray(a).ravel()]


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

u = np.concatenate([np.array([2.0**-53, 1e-12, 1e-5, 0.01, 0.075, 0.5, 0.9, 0.9999]), (np.arange(20) + 0.5) / 20])
OUT["quantile"] = {"u": lst(u), "quantile": lst(sp.ndtri(u)), "cdf": lst(sp.ndtr(sp.ndtri(u)))}

path = pathlib.Path(__file__).with_name("reference.json")
path.write_text(json.dumps(OUT, separators=(",", ":"), allow_nan=False) + "\n")
