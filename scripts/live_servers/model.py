"""The model behind every server: it records what it was given, and returns known numbers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np


def actions(request: int, length: int, size: int, magnitude: float, gripper: tuple[float, float]) -> np.ndarray:
    """The chunk that the model returns to its request number `request`: no two of its numbers are equal.

    The numbers for the arm are between minus and plus `magnitude`. The last number opens or closes the gripper:
    `gripper` has the numbers that do so. It changes every seven actions.
    """
    row = np.arange(length)[:, None] + length * request
    column = np.arange(size)[None, :]
    # A low-discrepancy sequence: multiples of the golden ratio, modulo 1.
    chunk = magnitude * (2.0 * np.mod((row * size + column + 1) * 0.6180339887498949, 1.0) - 1.0)
    chunk[:, -1] = np.where((row[:, 0] // 7) % 2 == 0, *gripper)
    return chunk


class Model:
    """Records requests in a folder, one file each, and returns chunks of known numbers."""

    def __init__(self, folder: Path, settings: dict):
        self.folder, self.settings, self.requests = folder, settings, 0
        folder.mkdir(parents=True, exist_ok=True)

    def infer(self, images: dict, states: dict, instruction: str) -> np.ndarray:
        """The chunk for this observation: an array of shape (length, size)."""
        chunk = actions(self.requests, **self.settings)
        arrays = {f"image/{name}": np.asarray(image) for name, image in images.items()}
        arrays |= {f"state/{name}": np.asarray(state) for name, state in states.items()}
        np.savez(self.folder / f"{self.requests:05}.npz", actions=chunk, instruction=np.array(instruction), **arrays)
        self.requests += 1
        return chunk


def from_arguments(arguments: list[str]) -> tuple[Path, int, Model, dict]:
    """Checkout, port, model and options of a server script: CHECKOUT PORT FOLDER SETTINGS."""
    checkout, port, folder, settings = arguments
    options = json.loads(settings)
    return Path(checkout), int(port), Model(Path(folder), options.pop("model")), options
