"""Writes paper_rule.json: a recorded stream of successes and, after each cycle, the level of the paper's rule in exact
rational arithmetic. Python 3.11, no packages: python3 paper_rule.py > paper_rule.json"""

import json
import random
from fractions import Fraction

stream = random.Random(20260314)
rates = [(400, 0.95), (250, 0.90), (250, 0.80), (400, 0.97)]
successes = [stream.random() < rate for length, rate in rates for _ in range(length)]

cases = []
for window, baseline, warning, critical, decline in [
    (100, "0.95", "0.05", "0.10", "absolute"),
    (100, "0.95", "0.05", "0.10", "relative"),
    (100, "0.9473", "0.05", "0.10", "absolute"),
    (40, "0.9", "0.05", "0.10", "absolute"),
    (37, "0.93", "0.04", "0.11", "relative"),
]:
    levels = ""
    for i in range(len(successes)):
        if i + 1 < window:
            levels += "-"
            continue
        rate = Fraction(sum(successes[i + 1 - window : i + 1]), window)
        lost = Fraction(baseline) - rate
        if decline == "relative":
            lost /= Fraction(baseline)
        levels += "C" if lost >= Fraction(critical) else "W" if lost >= Fraction(warning) else "-"
    cases.append(
        {
            "window": window,
            "baseline": float(baseline),
            "warning": float(warning),
            "critical": float(critical),
            "decline": decline,
            "levels": levels,
        }
    )
print(json.dumps({"successes": "".join("1" if s else "0" for s in successes), "cases": cases}, indent=1))
