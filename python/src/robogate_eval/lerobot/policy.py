"""Policies of LeRobot, with the processors that are stored with them and those of LeRobot's environments."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from ..serving.layers import layers
from .world import register_plugins

# The part of the names of LeRobot's inputs that other environments do not have.
PREFIXES = ("observation.images.", "observation.")
# Keys of the observations of LeRobot's environments.
KEYS = {"pixels", "agent_pos", "environment_state", "robot_state"}


def checkpoint(path: "str | os.PathLike[str]") -> Path:
    """The folder of a checkpoint: this one, or the last one of the training whose output folder this is.

    Raises:
        ValueError: The folder has no checkpoint.
    """
    for inner in ("", "pretrained_model", "checkpoints/last/pretrained_model"):
        if (Path(path) / inner / "config.json").is_file():
            return Path(path) / inner
    raise ValueError(f"{path}: not a checkpoint of LeRobot. Expected a folder with config.json, such as .../pretrained_model")


def load(path: "str | os.PathLike[str]", rename_map: "Mapping[str, str] | None" = None) -> Any:
    """Load the policy of a checkpoint folder. Its configuration can name any Python class: load only folders that you trust.

    `rename_map` is that of `lerobot-eval`: names of the policy's inputs by those of the environment. Default: the stored one.

    Raises:
        ValueError: The folder has no checkpoint.
    """
    folder = checkpoint(path)
    import lerobot.policies  # registers the configurations of all policies
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class

    del lerobot
    register_plugins()
    config = PreTrainedConfig.from_pretrained(folder)
    config.pretrained_path = folder
    policy = get_policy_class(config.type).from_pretrained(folder, config=config)
    if rename_map is not None:
        if not isinstance(rename_map, Mapping):
            raise ValueError(f"{path}: rename_map is {rename_map!r}. Expected a map such as {{\"observation.images.top\": \"observation.image\"}}")
        config.robogate_rename_map = dict(rename_map)
    return policy


def version(path: "str | os.PathLike[str]") -> str:
    """The SHA-256 of the files of a checkpoint: their names and contents."""
    folder, digest = checkpoint(path), hashlib.sha256()
    for file in sorted(file for file in folder.rglob("*") if file.is_file()):
        digest.update(f"{file.relative_to(folder)}\0{file.stat().st_size}\0".encode())
        with open(file, "rb") as opened:
            while part := opened.read(1 << 20):
                digest.update(part)
    return f"sha256:{digest.hexdigest()}"


def as_function(policy: Any, env: Any = None, ask: "Callable[[Any], Any] | None" = None) -> Callable[[Any], Any]:
    """A policy as a function from an observation of `env` to an action. Called at the start of each episode, after `policy.reset()`. With
    `ask`, another process computes the actions (`batched`), and this one prepares its batch of one observation."""
    import torch

    before, after = _processors(policy)
    config = next((found for layer in layers(env) if (found := getattr(layer, "lerobot_config", None)) is not None), None)
    first, last = _environment_processors(config, policy)
    inputs = policy.config.input_features
    renames = next((found for step in getattr(before, "steps", ()) if (found := getattr(step, "rename_map", None))), {})
    before_renaming = {new: old for old, new in renames.items()}
    device = next(policy.parameters()).device
    policy.eval()

    def prepared(observation: Any) -> dict[str, Any]:
        batch = first(_batch(observation, env))
        for wanted, feature in inputs.items():
            name = before_renaming.get(wanted, wanted)
            if name not in batch and (wanted in batch or _key(name, observation) is None and _key(wanted, observation) is not None):
                # The environment has the new name already.
                name = wanted
            if name not in batch:
                batch[name] = torch.as_tensor(_input(name, feature, observation, len(inputs))).unsqueeze(0)
            elif feature.type.name != "VISUAL" and tuple(batch[name].shape[1:]) != tuple(feature.shape):
                found = tuple(batch[name].shape[1:])
                raise ValueError(f"the policy expects {name} of the shape {tuple(feature.shape)}, but the environment observes {found}")
        return batch

    def performed(action: Any) -> Any:
        return last({"action": action})["action"].squeeze(0).float().cpu().numpy()

    if ask is not None:
        from ..in_flight import rows

        chunk = rows(ask, prepared)
        return lambda observation: performed(torch.as_tensor(chunk(observation), dtype=torch.float32).unsqueeze(0))

    def act(observation: Any) -> Any:
        batch = _on(device, prepared(observation))
        with torch.inference_mode(), torch.autocast(device.type) if getattr(policy.config, "use_amp", False) else nullcontext():
            action = after(policy.select_action(before(batch)))
        return performed(action)

    return act


def batched(policy: Any) -> "Callable[[list[Any]], list[Any]] | None":
    """A policy as a function from several prepared batches of one observation to the actions that `select_action` would execute of each.
    None if its actions depend on more than the present observation."""
    config = policy.config
    alone = getattr(config, "n_obs_steps", 1) != 1 or getattr(config, "temporal_ensemble_coeff", None) is not None
    if alone or not hasattr(policy, "predict_action_chunk"):
        return None
    import torch

    before, after = _processors(policy)
    device = next(policy.parameters()).device
    policy.eval()

    def answer(batches: list[Any]) -> list[Any]:
        def joined(values: list[Any]) -> Any:
            return torch.cat(values) if isinstance(values[0], torch.Tensor) else [text for one in values for text in one]

        batch = _on(device, {name: joined([one[name] for one in batches]) for name in batches[0]})
        with torch.inference_mode(), torch.autocast(device.type) if getattr(config, "use_amp", False) else nullcontext():
            chunks = after(policy.predict_action_chunk(before(batch)))
        return list(chunks[:, : getattr(config, "n_action_steps", 1)].float().cpu())

    return answer


def _on(device: Any, batch: dict[str, Any]) -> dict[str, Any]:
    import torch

    return {name: value.to(device) if isinstance(value, torch.Tensor) else value for name, value in batch.items()}


def _batch(observation: Any, env: Any) -> dict[str, Any]:
    """The batch of one observation, as LeRobot's evaluation makes it. Without LeRobot's keys: the instruction only."""
    batch: dict[str, Any] = {}
    if isinstance(observation, Mapping) and KEYS & observation.keys():
        from lerobot.envs.utils import preprocess_observation

        batch = preprocess_observation(_with_axis(observation))
    for layer in layers(env):
        text = next((text for name in ("instruction", "task_description", "task") if isinstance(text := getattr(layer, name, None), str)), None)
        if text is not None:
            return batch | {"task": [text]}
    return batch | {"task": [""]}


def _with_axis(value: Any) -> Any:
    """The same observation with a first axis of one, as a vector of one environment returns it."""
    import numpy as np

    if isinstance(value, Mapping):
        return {key: _with_axis(part) for key, part in value.items()}
    return np.asarray(value)[None]


def _processors(policy: Any) -> tuple[Callable, Callable]:
    """The processors before and after a policy that was loaded from a folder. Older versions of LeRobot have none."""
    path = getattr(policy.config, "pretrained_path", None) or getattr(policy, "name_or_path", None)
    try:
        from lerobot.policies.factory import make_pre_post_processors
    except ImportError:
        return _same, _same
    if not path:
        return _same, _same
    overrides = {"device_processor": {"device": str(next(policy.parameters()).device)}}
    if (renamed := getattr(policy.config, "robogate_rename_map", None)) is not None:
        overrides["rename_observations_processor"] = {"rename_map": renamed}
    return make_pre_post_processors(policy.config, pretrained_path=str(path), preprocessor_overrides=overrides)


def _environment_processors(config: Any, policy: Any) -> tuple[Callable, Callable]:
    """The processors of one of LeRobot's environments, which has this configuration."""
    if config is None:
        return _same, _same
    from lerobot.envs import factory

    make = getattr(factory, "make_env_pre_post_processors", None)
    return (_same, _same) if make is None else make(env_cfg=config, policy_cfg=policy.config)


def _same(value: Any) -> Any:
    return value


def _key(name: str, observation: Any) -> str | None:
    """The key in an observation for the input of this name. None without one."""
    short = next((name.removeprefix(prefix) for prefix in PREFIXES if name.startswith(prefix)), name)
    return next((key for key in (name, short) if key in observation), None) if isinstance(observation, Mapping) else None


def _input(name: str, feature: Any, observation: Any, inputs: int) -> Any:
    """The input of this name in an observation of any environment, as an array."""
    import numpy as np

    value = observation
    if isinstance(observation, Mapping):
        key = _key(name, observation)
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
