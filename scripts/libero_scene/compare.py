"""Compares the two paths from one scene of LIBERO to a policy: scripts/libero_scene.sh calls it.

    compare.py REFERENCE ENVIRONMENT SCENE CELL    prints the page docs/results/libero-scene.md; exit code 1 if a limit is exceeded

REFERENCE is what LIBERO's own environment gives (scene.py reference). The others are folders of requests that a policy server received:
through `--env libero:...`, from the same scene in the form of a cell, and from the built-in cell, which has another scene.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import schedule
from PIL import Image

# The limits of crates/robogate-policy/tests/libero.rs.
STATE, FINGERS, MOTION = 2e-4, 1e-3, 0.1
# Two renderers of the same scene: mean difference of a byte.
PICTURE = 2.0
KEYS = {"agentview": "observation.image", "robot0_eye_in_hand": "observation.wrist_image"}
TURNS = {
    "as sent": lambda image: image, "left and right exchanged": lambda image: image[:, ::-1],
    "top and bottom exchanged": lambda image: image[::-1], "rotated by 180 degrees": lambda image: image[::-1, ::-1],
}  # fmt: skip


def requests(folder: str) -> list:
    return [np.load(path) for path in sorted(Path(folder).glob("*.npz"))]


def states(received: list) -> np.ndarray:
    return np.array([request["observation.state"] for request in received])


def main() -> int:
    known = np.load(sys.argv[1])
    environment, scene, cell = (requests(folder) for folder in sys.argv[2:])
    failed = []

    def limited(what: str, value: float, limit: float) -> str:
        if not value <= limit:
            failed.append(f"{what}: {value:.3g} exceeds {limit:.3g}")
        return f"{value:.2g}"

    print("## What the policy receives\n")
    print("Differences from LIBERO's own environment, after the benchmark's ten actions that do nothing. An image is compared in four orientations.\n")
    print("| path | position, m | rotation vector, rad | fingers, m | camera | as sent | " + " | ".join(list(TURNS)[1:]) + " |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name, received in (("environment", environment), ("cell", scene)):
        off = np.abs(states(received)[0] - known["states"][0])
        parts = [limited(f"{name}: position", off[:3].max(), STATE), limited(f"{name}: rotation", off[3:6].max(), STATE),
                 limited(f"{name}: fingers", off[6:].max(), FINGERS)]  # fmt: skip
        for camera, key in KEYS.items():
            sent = received[0][key].astype(float)
            # openpi's client resizes the image in this way.
            small = Image.fromarray(np.ascontiguousarray(known[camera])).resize(sent.shape[1::-1], Image.Resampling.BILINEAR)
            expected = np.array(small).astype(float)
            off = {turn: float(np.abs(change(sent) - expected).mean()) for turn, change in TURNS.items()}
            limited(f"{name}: {camera}", off["as sent"], PICTURE)
            if min(off, key=off.get) != "as sent":
                failed.append(f"{name}: {camera} fits better {min(off, key=off.get)}")
            print(f"| {name} | " + " | ".join(parts) + f" | `{camera}` | " + " | ".join(f"{value:.2f}" for value in off.values()) + " |")
            parts = ["", "", ""]

    print("\n## How the tool moves\n")
    print(f"Each motion is {schedule.STEPS} equal actions from rest. The unit is mm, or mrad for the rotations about the vertical axis.\n")
    print("| motion | value | LIBERO | environment | cell | cell / LIBERO | last step: LIBERO | cell |")
    print("|---|---|---|---|---|---|---|---|")
    libero, *paths = (schedule.displacements(states[:, :3], states[:, 3:6]) for states in (known["states"], states(environment), states(cell)))
    for name, _, value in schedule.MOTIONS:
        (total, last), (same, _), (ours, our_last) = libero[name], paths[0].get(name, (np.nan, 0)), paths[1].get(name, (np.nan, 0))
        limited(f"environment: motion {name}", abs(same - total), 1e-6)
        limited(f"cell: motion {name}", abs(ours / total - 1.0), MOTION)
        print(f"| {name} | {value:+.1f} | {1e3 * total:+.2f} | {1e3 * same:+.2f} | {1e3 * ours:+.2f} | {ours / total:.3f} | {1e3 * last:+.2f} | {1e3 * our_last:+.2f} |")
    count = min(len(environment), len(known["states"]))
    off = float(np.abs(states(environment)[:count] - known["states"][:count]).max())
    print(f"\nOver {count} actions, the largest difference of any number of the state between the environment's path and LIBERO's own loop is {off:.1e}.")
    print(f"\nThe base of the robot in this scene is at {[round(float(n), 4) for n in known['base']]} m.")
    for why in failed:
        print(f"\n**Limit exceeded**: {why}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
