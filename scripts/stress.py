#!/usr/bin/env python3
"""Prints how a policy does under each kind of stress: success by quarters of the range (docs/results/stress.md).

    robogate run --policy assets/policies/learned.onnx --profile learned --space learned --stress images,state,actions \
        --family each -n 1800 --out stress
    robogate export stress stress.csv
    python3 scripts/stress.py stress.csv

A row of the file is an episode in which one parameter varies, or a nominal twin.
"""

import csv
import math
import sys

# The ranges of docs/guides/stress.md, from the value without effect outwards. Both sides of a range are counted by distance.
RANGES = {
    "noise": (0, 80), "blur_px": (0, 8), "brightness": (0, 120), "contrast": (1, 1.8), "warmth": (0, 80), "jpeg_loss": (0, 99),
    "occlusion": (0, 0.6), "crop": (0, 0.3), "rotation_deg": (0, 30), "dropped_frames": (0, 0.9), "delayed_frames": (0, 20),
    "state_noise": (0, 0.1), "state_bias": (0, 0.1), "delayed_state": (0, 20), "action_step": (0, 0.1), "delayed_action": (0, 10),
}


def wilson(successes, n, z=1.96):
    """The 95 % interval of a rate (Wilson 1927), in percent."""
    if n == 0:
        return "-"
    rate, spread = successes / n, z * z / n
    middle, half = (rate + spread / 2) / (1 + spread), z * math.sqrt(rate * (1 - rate) / n + spread / (4 * n)) / (1 + spread)
    return f"{successes} of {n} ({max(0, 100 * (middle - half)):.0f} to {min(100, 100 * (middle + half)):.0f} %)"


def main():
    with open(sys.argv[1], newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["outcome"] != "invalid"]
    print("| parameter | first quarter of the range | second | third | last |")
    print("|---|---|---|---|---|")
    for name, (nominal, end) in RANGES.items():
        counts = [[0, 0] for _ in range(4)]
        for row in rows:
            value = row.get(f"transit_{name}") or ""
            distance = abs(float(value) - nominal) / (end - nominal) if value else 0.0
            if distance > 0:
                quarter = counts[min(3, int(4 * distance))]
                quarter[0] += row["outcome"] == "success"
                quarter[1] += 1
        if any(n for _, n in counts):
            print(f"| `transit_{name}` | " + " | ".join(wilson(*count) for count in counts) + " |")


if __name__ == "__main__":
    main()
