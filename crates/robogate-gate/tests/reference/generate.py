"""Writes reference.json: reference values of SciPy for the counts in tests/verdicts.md, and for the operating characteristic.

    python3 -m venv venv && venv/bin/pip install -r requirements.txt && venv/bin/python generate.py
"""

import json
import pathlib

import scipy.stats as st

HERE = pathlib.Path(__file__).parent
OUT = {"counts": [], "paper": {}}

seen = set()
for line in (HERE.parent / "verdicts.md").read_text().splitlines():
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    if len(cells) != 6 or not cells[0].isdigit() or cells[4] == "point":
        continue
    good, bad, invalid = map(int, cells[:3])
    metric, sense, limit = cells[3].split()
    n = good + bad + invalid
    if n == 0 or good + bad == 0 or (good, bad, invalid, cells[3]) in seen:
        continue
    seen.add((good, bad, invalid, cells[3]))
    p0 = float(limit) if sense == ">=" else 1 - float(limit)
    OUT["counts"].append(
        {
            "good": good,
            "bad": bad,
            "invalid": invalid,
            "demand": cells[3],
            "p_met": st.binomtest(good, n, p0, alternative="greater").pvalue,
            "p_violated": st.binomtest(good + invalid, n, p0, alternative="less").pvalue,
            # One-sided bounds at 95 % form a two-sided interval at 90 %.
            "interval": [
                st.binomtest(good, n).proportion_ci(0.90, "exact").low,
                st.binomtest(good + invalid, n).proportion_ci(0.90, "exact").high,
            ],
        }
    )

# Pass probability of the point gate "at least 0.92 of 68". 63 of 68 is the smallest passing count.
OUT["paper"] = [{"rate": p, "passes": float(st.binom.sf(62, 68, p))} for p in [0.85, 0.90, 0.92, 0.95, 0.98]]

path = HERE / "reference.json"
path.write_text(json.dumps(OUT, indent=1, allow_nan=False) + "\n")
print(path, len(OUT["counts"]), "cases")
