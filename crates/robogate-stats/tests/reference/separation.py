"""Writes separation.json: which rows of a logistic regression can be separated, by linear programs of SciPy (HiGHS).

    python3 -m venv venv && venv/bin/pip install -r requirements.txt && venv/bin/python separation.py

A row i with signed design a_i can be separated if a_i.d > 0 for a direction d with a_j.d >= 0 for every row j. The number of such
rows is the maximum of sum z_i with a_i.d >= z_i and 0 <= z_i <= 1 over z and d: the sum of directions separates all that any of
them separates, and d may be scaled.
"""

import json
import pathlib

import numpy as np
import scipy.optimize as so
import scipy.sparse as ss
import scipy.special as sp

OUT = {"small": [], "large": []}


def separated(signed):
    """The number of rows that can be separated."""
    rows, q = signed.shape
    constraints = ss.hstack([ss.csr_matrix(-signed), ss.identity(rows)])
    bounds = [(None, None)] * q + [(0, 1)] * rows
    found = so.linprog(np.r_[np.zeros(q), -np.ones(rows)], A_ub=constraints, b_ub=np.zeros(rows), bounds=bounds)
    assert found.status == 0, found.message
    z = found.x[q:]
    assert np.all((z < 1e-6) | (z > 1 - 1e-6)), "not decided"
    return int(round(z.sum()))


# Few rows with ties.
rng = np.random.default_rng(5)
while len(OUT["small"]) < 90:
    rows, q = int(rng.integers(4, 40)), int(rng.integers(1, 5))
    columns = [rng.integers(0, 3, rows) if rng.random() < 0.6 else np.round(rng.normal(size=rows), 1) for _ in range(q)]
    eta = np.column_stack(columns) @ (rng.normal(size=q) * rng.choice([0.5, 3, 10]))
    y = rng.random(rows) < sp.expit(eta - np.median(eta))
    design = np.column_stack([np.ones(rows), *columns])
    if y.all() or not y.any() or np.linalg.matrix_rank(design) < q + 1:
        continue
    OUT["small"].append({
        "columns": [[float(c) for c in column] for column in columns], "outcomes": [int(o) for o in y],
        "rows": separated(design * np.where(y, 1, -1)[:, None]),
    })


def unit(row, column, case):
    """A number in [0, 1) from integers; the test computes the same."""
    x = (row * 2654435761 + column * 40503 + case * 97 + 12345) % 2**32
    for shift, factor in [(15, 2246822519), (13, 3266489917), (16, 1)]:
        x = ((x ^ (x >> shift)) * factor) % 2**32
    return x / 2**32


def column(j, case, rows):
    """Hundredths, a rare category, or three levels."""
    u = np.array([unit(i, j, case) for i in range(rows)])
    return [np.floor(100 * u) / 100, (u < 0.03).astype(float), np.floor(3 * u)][j % 3]


def outcomes(case, columns, rows):
    """Rare successes; never with the rare category; decided by two columns; or decided within the rare category."""
    rare = np.array([unit(i, 99, case) for i in range(rows)]) < 0.02 + 0.01 * (case % 3)
    by_columns = columns[0] + columns[2] / 3 > 0.8
    special = columns[1] > 0.5
    return [rare, rare & ~special, by_columns, np.where(special, columns[0] > 0.5, rare)][case % 4]


for case in range(32):
    rows, q = 300 + 150 * (case % 5), 3 + (case * 7) % 31
    columns = [column(j, case, rows) for j in range(q)]
    y = outcomes(case, columns, rows)
    design = np.column_stack([np.ones(rows), *columns])
    assert y.any() and not y.all() and np.linalg.matrix_rank(design) == q + 1
    OUT["large"].append({"rows": rows, "columns": q, "separated": separated(design * np.where(y, 1, -1)[:, None])})

pathlib.Path(__file__).with_name("separation.json").write_text(json.dumps(OUT) + "\n")
