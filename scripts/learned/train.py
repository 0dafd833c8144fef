"""Trains a small visuomotor network on demonstrations by behaviour cloning, and writes it as ONNX.

    robogate demos --out runs/demos -n 1000 --push 0.012
    python scripts/learned/train.py runs/demos --out policy.onnx

The network observes the central half of the front image (48 x 48 pixels), the wrist image (64 x 64), the arm's joints and the
gripper's opening. It predicts the next CHUNK actions: absolute joint positions and whether the gripper is open. An auxiliary output
predicts the position of the object, which the dataset contains; this makes the network use the images early in its training. Everything is
seeded: on the same machine with the same number of threads, the same dataset gives the same network. Brightness and contrast of the
images vary slightly, and the observed joints are noisy, so that the network relies on the images instead of extrapolating the motion.
"""

import argparse
import io
import json
import time
from pathlib import Path

import numpy as np
import onnx
import pyarrow.parquet as pq
import torch
from PIL import Image
from torch import nn
from torch.nn import functional as F

CHUNK = 10
# For each camera: the fraction of the image's width and height that the crop keeps, and the side length after it in pixels.
CAMERAS = {"front": (0.5, 48), "wrist": (1.0, 64)}
# Approximate motion of the tool per radian of each joint, in metres. The value of the last joint is a weight.
LEVER_M = (0.55, 0.6, 0.5, 0.5, 0.2, 0.25, 0.1)
STATE_NOISE_RAD = 0.004
# The workspace centre (x, y).
WORKSPACE_M = (0.5, 0.0)
# Number of feature points per encoder.
POINTS = 24


def fitted(png, crop, side):
    """Preprocesses an image as the profile does: centre crop, then resampling with Pillow's bilinear filter."""
    image = Image.open(io.BytesIO(png))
    keep = round(image.width * crop)
    at = (image.width - keep) // 2
    image = image.crop((at, at, at + keep, at + keep))
    return np.asarray(image if keep == side else image.resize((side, side), Image.Resampling.BILINEAR))


def load(folder):
    """Returns the images of each camera (frames x height x width x 3, bytes), states, actions, object positions and episodes."""
    info = json.loads((folder / "meta/info.json").read_text())
    if info["codebase_version"] != "v3.0":
        raise SystemExit(f"{folder}: unsupported layout {info['codebase_version']}. Expected v3.0")
    names = info["features"]["observation.state"]["names"]
    joints = [i for i, name in enumerate(names) if name.startswith("joint_")]
    kept = joints + [names.index("gripper_opening_m")]
    pictures, states, actions, objects, index = {camera: [] for camera in CAMERAS}, [], [], [], []
    for path in sorted((folder / "data").glob("*/*.parquet")):
        table = pq.read_table(path)
        for camera, (crop, side) in CAMERAS.items():
            for file in table[f"observation.images.{camera}"].to_pylist():
                pictures[camera].append(fitted(file["bytes"], crop, side))
        states.append(np.array(table["observation.state"].to_pylist(), dtype=np.float32)[:, kept])
        actions.append(np.array(table["action"].to_pylist(), dtype=np.float32))
        positions = np.array(table["expert.object"].to_pylist(), dtype=np.float32)
        objects.append(positions[:, :2])
        index.append(np.array(table["episode_index"]))
    return [np.stack(files) for files in pictures.values()], *map(np.concatenate, (states, actions, objects, index))


class Eye(nn.Module):
    """Image encoder that returns feature positions: convolutions and a spatial softmax (Levine et al. 2016)."""

    def __init__(self, side):
        super().__init__()
        self.layers = nn.Sequential(
            nn.Conv2d(3, 12, 5, stride=2, padding=2), nn.ReLU(),
            nn.Conv2d(12, 24, 3, stride=2, padding=1), nn.ReLU(),
            nn.Conv2d(24, POINTS, 3, padding=1),
        )
        n = side // 4
        line = torch.linspace(-1, 1, n)
        self.register_buffer("x", line.repeat(n))
        self.register_buffer("y", line.repeat_interleave(n))

    def forward(self, picture):
        shares = F.softmax(self.layers(picture).flatten(2), dim=2)
        return torch.cat([(shares * self.x).sum(2), (shares * self.y).sum(2)], dim=1)


class Network(nn.Module):
    """Maps both images and the arm's state to a chunk of actions. Images: batch x height x width x 3, from 0 to 1."""

    def __init__(self, state_mean, state_std, action_mean, action_std):
        super().__init__()
        self.front, self.wrist = (Eye(side) for _, side in CAMERAS.values())
        seen = 4 * POINTS + len(state_mean)
        self.finder = nn.Sequential(nn.Linear(seen, 64), nn.ReLU(), nn.Linear(64, 2))
        self.head = nn.Sequential(
            nn.Linear(seen + 2, 256), nn.ReLU(),
            nn.Linear(256, 256), nn.ReLU(),
            nn.Linear(256, CHUNK * (len(action_mean) + 1)),
        )
        for name, value in (("state_mean", state_mean), ("state_std", state_std),
                            ("action_mean", action_mean), ("action_std", action_std)):
            self.register_buffer(name, torch.as_tensor(value))

    def see(self, picture):
        return 2.0 * picture.permute(0, 3, 1, 2) - 1.0

    def forward(self, front, wrist, state):
        return self.both(front, wrist, state)[0]

    def both(self, front, wrist, state):
        """Returns the actions, and the position of the object (decimetres from the workspace centre)."""
        seen = torch.cat([self.front(self.see(front)), self.wrist(self.see(wrist)),
                          (state - self.state_mean) / self.state_std], dim=1)
        place = self.finder(seen)
        out = self.head(torch.cat([seen, place], dim=1)).reshape(-1, CHUNK, self.action_mean.shape[0] + 1)
        # The last number is the logit of an open gripper.
        return torch.cat([out[:, :, :-1] * self.action_std + self.action_mean, out[:, :, -1:]], dim=2), place


def augment(picture, rng):
    """Changes brightness and contrast of each image of a batch slightly."""
    gain = 1.0 + 0.1 * torch.randn(len(picture), 1, 1, 1, generator=rng)
    shift = 0.03 * torch.randn(len(picture), 1, 1, 1, generator=rng)
    return (picture * gain + shift).clamp(0, 1)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path, nargs="+", help="folders of robogate demos")
    parser.add_argument("--out", type=Path, required=True, help="the ONNX file")
    parser.add_argument("--steps", type=int, default=30000)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--rate", type=float, default=1.5e-3, help="maximum learning rate")
    parser.add_argument("--minutes", type=float, help="limit the number of steps to this time, estimated from the first steps")
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    torch.manual_seed(arguments.seed)
    torch.set_num_threads(arguments.threads)
    rng = torch.Generator().manual_seed(arguments.seed)

    parts = [load(folder) for folder in arguments.dataset]
    fronts, wrists = (torch.from_numpy(np.concatenate(files)) for files in zip(*(p[0] for p in parts)))
    states = torch.from_numpy(np.concatenate([p[1] for p in parts]))
    actions = torch.from_numpy(np.concatenate([p[2] for p in parts]))
    objects = (torch.from_numpy(np.concatenate([p[3] for p in parts])) - torch.tensor(WORKSPACE_M)) * 10
    offset, episode = 0, []
    for part in parts:
        episode.append(part[4] + offset)
        offset += int(part[4].max()) + 1
    episode = np.concatenate(episode)
    n = len(states)
    # The last frame of each frame's episode. Chunks end there, with its action repeated.
    last = np.empty(n, dtype=np.int64)
    # The object is at its initial position until it is gripped.
    stands = np.zeros(n, dtype=bool)
    for e in range(offset):
        where = np.flatnonzero(episode == e)
        last[where] = where[-1]
        closing = np.flatnonzero(actions[where, -1].numpy() < 0.5)
        stands[where[: closing[0] if len(closing) else None]] = True
    last, stands = torch.from_numpy(last), torch.from_numpy(stands)
    ahead = torch.arange(CHUNK)
    # Every twentieth episode is held out, or the last one if there are fewer.
    held = torch.from_numpy(episode % 20 == 19 if offset >= 20 else episode == offset - 1)
    train, test = (~held).nonzero()[:, 0], held.nonzero()[:, 0]
    joints = actions[:, :-1]
    network = Network(states.mean(0).numpy(), (states.std(0) + 0.01).numpy(),
                      joints.mean(0).numpy(), (joints.std(0) + 0.01).numpy())
    lever = torch.tensor(LEVER_M)
    print(f"{n} frames of {offset} episodes, {sum(p.numel() for p in network.parameters())} weights", flush=True)

    def loss_of(at, noisy):
        chunk = torch.minimum(at[:, None] + ahead, last[at][:, None])
        want = actions[chunk]
        front, wrist = fronts[at].float() / 255, wrists[at].float() / 255
        state = states[at]
        if noisy:
            front, wrist = augment(front, rng), augment(wrist, rng)
            noise = STATE_NOISE_RAD * torch.randn(len(at), state.shape[1] - 1, generator=rng)
            state = state + F.pad(noise, (0, 1))
        got, place = network.both(front, wrist, state)
        way = ((got[:, :, :-1] - want[:, :, :-1]).abs() * lever).sum(2).mean()
        grip = F.binary_cross_entropy_with_logits(got[:, :, -1], want[:, :, -1])
        away = (place - objects[at]).abs().sum(1)
        found = (away * stands[at]).sum() / stands[at].sum().clamp(min=1)
        return way, grip, found

    optimizer = torch.optim.AdamW(network.parameters(), lr=arguments.rate, weight_decay=1e-4)
    steps, begun, step = arguments.steps, time.time(), 0
    while step < steps:
        if step == 100 and arguments.minutes:
            steps = max(200, min(steps, int(arguments.minutes * 60 / ((time.time() - begun) / 100))))
            print(f"{steps} steps fit into {arguments.minutes} minutes", flush=True)
        warm, left = min(1.0, (step + 1) / 200), 0.5 * (1 + np.cos(np.pi * step / steps))
        for group in optimizer.param_groups:
            group["lr"] = arguments.rate * warm * max(left, 0.01)
        at = train[torch.randint(len(train), (arguments.batch,), generator=rng)]
        way, grip, found = loss_of(at, noisy=True)
        optimizer.zero_grad()
        (100 * way + grip + 2 * found).backward()
        nn.utils.clip_grad_norm_(network.parameters(), 10.0)
        optimizer.step()
        step += 1
        if step % 1000 == 0 or step == steps:
            with torch.no_grad():
                picked = test[torch.randint(len(test), (512,), generator=torch.Generator().manual_seed(0))]
                held_way, held_grip, held_found = loss_of(picked, noisy=False)
            print(f"step {step}  {time.time() - begun:.0f} s  path {1000 * way:.1f} mm  grip {grip:.4f}  "
                  f"held out: path {1000 * held_way:.1f} mm  grip {held_grip:.4f}  object {100 * held_found:.1f} mm", flush=True)
    export(network.eval(), arguments.out)


def export(network, path):
    """Writes the network as ONNX: inputs front, wrist and state, output actions; checked against PyTorch."""
    rng = torch.Generator().manual_seed(1)
    pictures = (torch.rand((1, side, side, 3), generator=rng) for _, side in CAMERAS.values())
    example = (*pictures, network.state_mean[None].clone())
    torch.onnx.export(network, example, path, input_names=["front", "wrist", "state"], output_names=["actions"],
                      opset_version=17, dynamo=False)
    model = onnx.load(path)
    onnx.checker.check_model(model)
    import onnxruntime

    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    got = session.run(None, {name: value.numpy() for name, value in zip(("front", "wrist", "state"), example)})[0]
    with torch.no_grad():
        want = network(*example).numpy()
    print(f"{path}: {path.stat().st_size} bytes, ONNX Runtime differs by {np.abs(got - want).max():.1e}")


if __name__ == "__main__":
    main()
