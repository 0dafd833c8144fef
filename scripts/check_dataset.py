"""Checks a dataset of `robogate demos` with LeRobot's own package; exit code 1 if there is a problem.

    pip install lerobot==0.4.4
    python scripts/check_dataset.py runs/demos

Not part of the tests, because the package and its dependencies take gigabytes.
"""

import json
import sys
from pathlib import Path

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from torch.utils.data import DataLoader


def demand(holds, what):
    if not holds:
        sys.exit(f"wrong: {what}")


def close(ours, theirs):
    return np.allclose(np.asarray(ours, float).ravel(), np.asarray(theirs, float).ravel(), rtol=1e-4, atol=1e-4)


def main(folder):
    info = json.loads((folder / "meta/info.json").read_text())
    step_s = 1 / info["fps"]
    dataset = LeRobotDataset("local/robogate", root=folder, delta_timestamps={"action": [0.0, step_s, 2 * step_s]})
    demand(dataset.num_episodes == info["total_episodes"], "the number of episodes")
    demand(len(dataset) == dataset.num_frames == info["total_frames"], "the number of frames")
    cameras = [name for name, feature in info["features"].items() if feature["dtype"] == "image"]
    demand(len(cameras) > 0, "no images")

    # Reads every frame as a training run does: decoded images, the next actions, nothing beyond the end of an episode.
    frames, sums = 0, {camera: 0.0 for camera in cameras}
    for batch in DataLoader(dataset, batch_size=32):
        frames += len(batch["index"])
        for camera in cameras:
            height, width, _ = info["features"][camera]["shape"]
            demand(tuple(batch[camera].shape[1:]) == (3, height, width), f"the shape of {camera}")
            demand(0 <= batch[camera].min() < batch[camera].max() <= 1, f"{camera} is empty")
            sums[camera] += batch[camera].double().mean(dim=(2, 3)).sum(dim=0).numpy()
        demand(tuple(batch["action"].shape[1:]) == (3, *info["features"]["action"]["shape"]), "the shape of action")
        for episode, index, padded in zip(batch["episode_index"], batch["index"], batch["action_is_pad"]):
            end = dataset.meta.episodes[int(episode)]["dataset_to_index"]
            wanted = [int(index) + ahead >= end for ahead in range(3)]
            demand(padded.tolist() == wanted, f"the end of episode {int(episode)} at frame {int(index)}")
        demand(all(task in dataset.meta.tasks.index for task in batch["task"]), "a task that is not in meta/tasks")
    demand(frames == len(dataset), "frames are missing")

    # Compares the stored statistics with those that are computed from the frames.
    stats = dataset.meta.stats
    for camera in cameras:
        demand(close(stats[camera]["mean"], sums[camera] / frames), f"the mean of {camera}")
    table = dataset.hf_dataset.with_format("numpy")
    for name in ("observation.state", "action"):
        column = np.array(table[name])
        for what in ("min", "max", "mean", "std"):
            demand(close(stats[name][what], getattr(column, what)(0)), f"the {what} of {name}")
    print(f"{folder}: LeRobot reads {dataset.num_episodes} episodes, {frames} frames, {', '.join(cameras)}, "
          f"tasks: {'; '.join(dataset.meta.tasks.index)}")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
