"""Policies of the calling process: functions, models of Stable-Baselines3, and policies of LeRobot."""

from __future__ import annotations

import importlib
import json
import os
import zipfile
from collections.abc import Callable, Mapping
from typing import Any

# The part of the names of LeRobot's inputs that environments do not have.
PREFIXES = ("observation.images.", "observation.")


def is_model_file(policy: Any) -> bool:
    """Whether this is the path of a model that Stable-Baselines3 saved."""
    return isinstance(policy, (str, os.PathLike)) and os.fspath(policy).endswith(".zip")


def load(path: "str | os.PathLike[str]") -> Any:
    """Load a model that Stable-Baselines3 saved. It contains pickles, which are programs: load only files that you trust.

    Raises:
        ValueError: The file does not name one of the algorithms of Stable-Baselines3.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            data = json.loads(archive.read("data"))
    except (KeyError, zipfile.BadZipFile, json.JSONDecodeError) as why:
        raise ValueError(f"{os.fspath(path)}: not a model of Stable-Baselines3: {why}") from None
    # Stored as text: "stable_baselines3.sac.policies". The policies of PPO and A2C are those of `common`.
    module = str(data.get("policy_class", {}).get("__module__", ""))
    name = module.removesuffix(".policies").rpartition(".")[2]
    if name == "common":
        name = "ppo" if "clip_range" in data else "a2c"
    try:
        algorithms = importlib.import_module("stable_baselines3")
    except ModuleNotFoundError:
        raise ValueError(f"{os.fspath(path)}: the package stable_baselines3 is missing: pip install stable-baselines3") from None
    algorithm = getattr(algorithms, name.upper(), None)
    if algorithm is None:
        raise ValueError(f"{os.fspath(path)}: unknown algorithm ({module}). Load the model yourself, and pass the object")
    return algorithm.load(path, device="cpu")


def as_function(policy: Any) -> Callable[[Any], Any]:
    """A policy as a function from an observation to an action. Called at the start of each episode."""
    if hasattr(policy, "predict"):
        return lambda observation: policy.predict(observation, deterministic=True)[0]
    reset = getattr(policy, "reset", None)
    if callable(reset):
        reset()
    if hasattr(policy, "select_action"):
        return _lerobot(policy)
    if callable(policy):
        return policy
    raise TypeError(
        f"{type(policy).__name__}: not a policy. Expected a function, a model with `predict` (Stable-Baselines3) or `select_action` "
        "(LeRobot), or a name"
    )


def _lerobot(policy: Any) -> Callable[[Any], Any]:
    """A policy of LeRobot, with the normalisation that is stored with it."""
    import torch

    before, after = _processors(policy)
    inputs = policy.config.input_features
    device = next(policy.parameters()).device
    policy.eval()

    def act(observation: Any) -> Any:
        batch = {name: torch.as_tensor(_input(name, inputs[name], observation, len(inputs))).unsqueeze(0).to(device) for name in inputs}
        with torch.inference_mode():
            action = after(policy.select_action(before(batch)))
        return action.squeeze(0).float().cpu().numpy()

    return act


def _processors(policy: Any) -> tuple[Callable, Callable]:
    """The processors before and after a policy that was loaded from a folder. Older versions of LeRobot have none."""
    path = getattr(policy.config, "pretrained_path", None) or getattr(policy, "name_or_path", None)
    try:
        from lerobot.policies.factory import make_pre_post_processors
    except ImportError:
        return (lambda batch: batch), (lambda action: action)
    if not path:
        return (lambda batch: batch), (lambda action: action)
    device = str(next(policy.parameters()).device)
    return make_pre_post_processors(
        policy.config, pretrained_path=str(path), preprocessor_overrides={"device_processor": {"device": device}}
    )


def _input(name: str, feature: Any, observation: Any, inputs: int) -> Any:
    """The input of this name in an observation of the environment, as an array."""
    import numpy as np

    value = observation
    if isinstance(observation, Mapping):
        short = next((name.removeprefix(prefix) for prefix in PREFIXES if name.startswith(prefix)), name)
        key = next((key for key in (name, short) if key in observation), None)
        if key is None:
            known = ", ".join(f"{key} {np.shape(one)}" for key, one in observation.items())
            raise KeyError(f"the policy expects {name} {tuple(feature.shape)}, but the environment observes {known}")
        value = observation[key]
    elif inputs > 1:
        raise KeyError(f"the policy expects {name} {tuple(feature.shape)} and others, but the environment observes one array")
    array = np.asarray(value)
    if array.dtype == np.uint8 and array.ndim == 3:
        # Height, width, channel in bytes; the policy takes channel, height, width from 0 to 1.
        array = np.moveaxis(array, 2, 0).astype(np.float32) / 255.0
    if array.shape != tuple(feature.shape):
        raise ValueError(f"the policy expects {name} of the shape {tuple(feature.shape)}, but the environment observes {array.shape}")
    return np.ascontiguousarray(array, dtype=np.float32)
