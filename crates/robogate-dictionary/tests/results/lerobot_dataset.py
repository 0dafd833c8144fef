"""Writes a LeRobot dataset of version 3.0, as far as an import reads it: frames, tasks and meta/info.json.

Usage: lerobot_dataset.py FOLDER

By hand from the schema of LeRobot's `lerobot_eval.py` and `datasets/utils.py` (codebase version v3.0): features of shape (1,) are flat columns, states and
actions are lists, the tasks are a pandas table with the words as its index.
"""

import json
import pathlib
import sys

import pandas
import pyarrow
import pyarrow.parquet

folder = pathlib.Path(sys.argv[1])
episodes = [(length, task, success) for length, task, success in
            [(20, 0, True), (30, 0, False), (25, 1, True), (40, 1, True), (10, 0, False), (35, 1, False)]]
frames = {name: [] for name in ("observation.state", "action", "next.reward", "next.success", "next.done", "timestamp", "frame_index",
                                "episode_index", "index", "task_index")}
for episode, (length, task, success) in enumerate(episodes):
    for frame in range(length):
        last = frame == length - 1
        row = ([0.0, 1.0], [0.5], float(last and success), last and success, last, frame / 10, frame, episode,
               len(frames["index"]), task)
        for name, value in zip(frames, row):
            frames[name].append(value)
types = {"observation.state": pyarrow.list_(pyarrow.float32(), 2), "action": pyarrow.list_(pyarrow.float32(), 1),
         "next.reward": pyarrow.float32(), "timestamp": pyarrow.float32()}
table = pyarrow.table({name: pyarrow.array(values, types.get(name)) for name, values in frames.items()})
cut = sum(length for length, *_ in episodes[:4])
for at, part in enumerate((table.slice(0, cut), table.slice(cut))):
    path = folder / f"data/chunk-000/file-{at:03d}.parquet"
    path.parent.mkdir(parents=True, exist_ok=True)
    pyarrow.parquet.write_table(part, path)
(folder / "meta").mkdir()
pandas.DataFrame({"task_index": [0, 1]}, index=["fold the towel", "stack the cups"]).to_parquet(folder / "meta/tasks.parquet")
feature = {"dtype": "float32", "shape": [1], "names": None}
features = {name: feature for name in frames} | {"next.success": {"dtype": "bool", "shape": [1], "names": None}}
info = {"codebase_version": "v3.0", "robot_type": "so101_follower", "total_episodes": len(episodes), "total_frames": table.num_rows,
        "total_tasks": 2, "fps": 10, "features": features}
(folder / "meta/info.json").write_text(json.dumps(info, indent=4))
