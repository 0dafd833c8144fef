"""Changes of the images that a policy of the environment observes, with the names and units of stress in transit (`--stress`)."""

from __future__ import annotations

import hashlib
import math
from collections import deque
from typing import Any

import numpy as np

from .knobs import Knob

# Name, unit, family, value without effect, allowed range, integer, meaning.
CHANGES = (
    ("image_noise", "levels", "image_noise", 0.0, 0.0, 80.0, False, "Standard deviation of the noise of each colour value, of 255 levels."),
    ("image_blur_px", "px", "image_blur", 0.0, 0.0, 8.0, False, "Standard deviation of the blur."),
    ("image_brightness", "levels", "image_light", 0.0, -120.0, 120.0, False, "Levels that are added to each colour value, of 255."),
    ("image_contrast", "1", "image_light", 1.0, 0.2, 2.0, False, "Factor of the distance of each colour value from the middle."),
    ("image_warmth", "levels", "image_colour", 0.0, -80.0, 80.0, False, "Levels that are added to red and taken from blue, of 255."),
    ("image_occlusion", "1", "image_occlusion", 0.0, 0.0, 0.6, False, "Share of each image that a grey square covers."),
    ("image_crop", "1", "image_view", 0.0, 0.0, 0.3, False, "Share that is cut off at each side; the rest is enlarged."),
    ("image_rotation_deg", "deg", "image_view", 0.0, -30.0, 30.0, False, "Rotation about the centre."),
    ("image_dropped_frames", "1", "image_timing", 0.0, 0.0, 0.9, False, "Share of the images that do not arrive; the last one is repeated."),
    ("image_delay", "control periods", "image_timing", 0, 0, 20, True, "Age of the images."),
)


class ImageChanges:
    """The changes of the images of an episode. All randomness follows from its seed."""

    def __init__(self) -> None:
        self.begin("")

    def begin(self, episode: str) -> None:
        """Start an episode without changes."""
        self._values = {name: nominal for name, _, _, nominal, *_ in CHANGES}
        self._episode = episode
        self._cameras: dict[str, tuple[np.random.Generator, np.ndarray, deque]] = {}
        # Whether anything changes.
        self.active = False

    def knobs(self) -> list[Knob]:
        """A knob for each change."""

        def write(env: Any, value: float, name: str) -> None:
            self._values[name] = value
            self.active = True

        return [
            Knob(name, lambda env, value, name=name: write(env, value, name), lambda env, name=name: self._values[name], low, high, nominal=nominal,
                 unit=unit, family=family, integer=whole, meaning=meaning, read_from="the changes of images")
            for name, unit, family, nominal, low, high, whole, meaning in CHANGES
        ]  # fmt: skip

    def changed(self, camera: str, image: np.ndarray) -> np.ndarray:
        """What the policy receives in place of the next image of this camera: height x width x channels, bytes."""
        value = self._values
        if camera not in self._cameras:
            digest = hashlib.blake2b(f"{self._episode}/image/{camera}".encode(), digest_size=8).digest()
            random = np.random.default_rng(int.from_bytes(digest, "little"))
            self._cameras[camera] = (random, random.uniform(size=2), deque(maxlen=int(value["image_delay"]) + 1))
        random, place, sent = self._cameras[camera]
        if sent and random.uniform() < value["image_dropped_frames"]:
            sent.append(sent[-1])
        else:
            sent.append(self._picture(image, random, place))
        return sent[0]

    def _picture(self, image: np.ndarray, random: np.random.Generator, place: np.ndarray) -> np.ndarray:
        value = self._values
        # Without the transparency of an image with four channels.
        pixels = image[..., :3].astype(float)
        if value["image_crop"] or value["image_rotation_deg"]:
            pixels = _turned(pixels, value["image_crop"], math.radians(value["image_rotation_deg"]))
        if value["image_blur_px"]:
            pixels = _blurred(pixels, value["image_blur_px"])
        pixels = value["image_contrast"] * (pixels - 127.5) + 127.5 + value["image_brightness"]
        if pixels.shape[2] >= 3:
            pixels[..., 0] += value["image_warmth"]
            pixels[..., 2] -= value["image_warmth"]
        if value["image_noise"]:
            pixels += random.normal(0.0, value["image_noise"], pixels.shape)
        if value["image_occlusion"]:
            height, width, _ = pixels.shape
            wide = min(width, round(math.sqrt(value["image_occlusion"] * width * height)))
            high = min(height, round(value["image_occlusion"] * width * height / max(1, wide)))
            left, top = int(place[0] * (width - wide)), int(place[1] * (height - high))
            pixels[top : top + high, left : left + wide] = 128.0
        changed = np.clip(np.rint(pixels), 0, 255).astype(np.uint8)
        return np.concatenate([changed, image[..., 3:]], axis=2)


def _turned(pixels: np.ndarray, crop: float, angle: float) -> np.ndarray:
    """Crop and rotation, by bilinear interpolation. Beyond the border the image goes on with its last pixels."""
    height, width, _ = pixels.shape
    cx, cy, scale = 0.5 * (width - 1), 0.5 * (height - 1), 1.0 - 2.0 * crop
    y, x = np.mgrid[0:height, 0:width]
    dx, dy = scale * (x - cx), scale * (y - cy)
    sx = np.clip(cx + math.cos(angle) * dx - math.sin(angle) * dy, 0.0, width - 1.0)
    sy = np.clip(cy + math.sin(angle) * dx + math.cos(angle) * dy, 0.0, height - 1.0)
    x0, y0 = sx.astype(int), sy.astype(int)
    x1, y1 = np.minimum(x0 + 1, width - 1), np.minimum(y0 + 1, height - 1)
    fx, fy = (sx - x0)[..., None], (sy - y0)[..., None]
    top = pixels[y0, x0] + fx * (pixels[y0, x1] - pixels[y0, x0])
    low = pixels[y1, x0] + fx * (pixels[y1, x1] - pixels[y1, x0])
    return top + fy * (low - top)


def _blurred(pixels: np.ndarray, deviation: float) -> np.ndarray:
    """A Gaussian blur. Beyond the border the image goes on with its last pixels."""
    half = max(1, math.ceil(3.0 * deviation))
    weights = np.exp(-0.5 * (np.arange(-half, half + 1) / deviation) ** 2)
    weights /= weights.sum()
    for axis in (0, 1):
        padding = [(half, half) if one == axis else (0, 0) for one in range(3)]
        padded, length = np.pad(pixels, padding, mode="edge"), pixels.shape[axis]
        pixels = sum(weight * padded.take(range(i, i + length), axis) for i, weight in enumerate(weights))
    return pixels
