"""Reads a dataset of `robogate demos` with LeRobot's own package and says what it finds; exit code 1 if something is wrong.

    pip install -r scripts/learned/requirements-lerobot.txt
    python scripts/learned/check_dataset.py runs/demos

Not part of the test run: the package and what it needs take gigabytes.
"""

import json
import sys
from pathlib import Path

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset


def main(folder):
    info = json.loads((folder / "meta/info.json").read_text())
    dataset = LeRobotDataset("local/robogate", root=folder, delta_timestamps={"action": [0.0, 0.05, 0.1]})
    assert dataset.num_episodes == info["total_episodes"], "episodes"
    assert len(dataset) == dataset.num_frames == info["total_frames"], "frames"
    for index in (0, len(dataset) // 2, len(dataset) - 1):
        frame = dataset[index]
        for camera in ("front", "wrist"):
            picture = frame[f"observation.images.{camera}"]
            height, width, _ = info["features"][f"observation.images.{camera}"]["shape"]
            assert tuple(picture.shape) == (3, height, width), picture.shape
            assert 0 <= float(picture.min()) < float(picture.max()) <= 1, "an empty picture"
        assert tuple(frame["action"].shape) == (3, info["features"]["action"]["shape"][0]), frame["action"].shape
        assert frame["task"].startswith("pick up the "), frame["task"]
    # What the dataset says of itself against what is in it.
    states = np.array(dataset.hf_dataset.with_format("numpy")["observation.state"])
    stats = dataset.meta.stats["observation.state"]
    for name, got in (("min", states.min(0)), ("max", states.max(0)), ("mean", states.mean(0)), ("std", states.std(0))):
        assert np.allclose(stats[name], got, atol=1e-4), name
    print(f"{folder}: LeRobot reads {dataset.num_episodes} episodes, {dataset.num_frames} frames, "
          f"tasks {list(dataset.meta.tasks.index)}")


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]))
    except AssertionError as wrong:
        sys.exit(f"wrong: {wrong}")
