"""Models of Stable-Baselines3 and sb3_contrib: a zip file, or a folder of RL Baselines3 Zoo."""

from __future__ import annotations

import importlib
import json
import os
import pickle
import re
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from .serving.layers import action_masks, layers

# The algorithms of sb3_contrib, by a part of the module of their policies.
CONTRIB = {"recurrent": "RecurrentPPO", "maskable": "MaskablePPO", "tqc": "TQC", "qrdqn": "QRDQN", "ars": "ARS", "crossq": "CrossQ"}
# Names of the statistics of VecNormalize beside a model.
STATISTICS = ("vecnormalize.pkl", "vec_normalize.pkl")
# What a model needs for training only. Replaced when it is loaded: a replay buffer takes memory and may need an environment, and a
# schedule is code of the Python version of the training.
TRAINING = {
    "buffer_size": 1, "replay_buffer_class": None, "replay_buffer_kwargs": {}, "optimize_memory_usage": False,
    "learning_rate": 0.0, "lr_schedule": lambda _: 0.0, "exploration_schedule": lambda _: 0.0, "clip_range": 0.0, "clip_range_vf": None,
}  # fmt: skip
# The wrapper that adds the remaining time to the observation, of several packages, and its number of steps where the environment has
# no limit.
TIME_FEATURE = "TimeFeatureWrapper"
TIME_FEATURE_STEPS = 1000


class Model:
    """A saved model with what its observations passed through in training. `files` are all that were read, and `arguments` those of the
    environment in training."""

    def __init__(
        self,
        model: Any,
        statistics: "Statistics | None",
        time_feature: dict[str, Any] | None,
        files: list[Path],
        arguments: Mapping[str, Any] | None = None,
    ):
        self.model = model
        self.files = files
        self._arguments = dict(arguments or {})
        self._statistics = statistics
        self._time_feature = time_feature

    def function(self, env: Any, ask: "Callable[[Any], Any] | None" = None) -> Callable[[Any], Any]:
        """The model as a function from an observation of `env` to an action. Called at the start of each episode. With `ask`, another
        process computes the actions (`batched`)."""
        import numpy as np

        self._check_arguments(env)
        self._check_actions(env)
        model, recurrent = self.model, hasattr(getattr(self.model, "policy", None), "lstm_actor")
        masks = action_masks(env)
        limit = self._limit(env)
        state, steps = None, 0

        def act(observation: Any) -> Any:
            nonlocal state, steps
            if self._time_feature is not None:
                observation = _with_time(observation, 1.0 if self._time_feature.get("test_mode") else 1.0 - steps / limit)
            self._check(observation)
            if self._statistics is not None:
                observation = self._statistics.normalized(observation)
            if ask is not None:
                steps += 1
                return ask(observation)[0]
            options = {"action_masks": masks()} if masks is not None and type(model).__name__ == "MaskablePPO" else {}
            if recurrent:
                options |= {"state": state, "episode_start": np.array([steps == 0])}
            action, state = model.predict(observation, deterministic=True, **options)
            steps += 1
            return action

        return act

    def check(self, env: Any) -> None:
        """Raise if `env` is not like that of the training, as far as it can be seen without an episode."""
        import numpy as np

        self._check_arguments(env)
        self._check_actions(env)
        if type(self.model).__name__ == "MaskablePPO" and action_masks(env) is None:
            raise ValueError("the model was trained with masked actions, but the environment has no action_masks()")
        space = getattr(env, "observation_space", None)
        parts = getattr(space, "spaces", None)
        shapes = {key: getattr(part, "shape", None) for key, part in parts.items()} if isinstance(parts, Mapping) else {None: getattr(space, "shape", None)}
        if any(shape is None for shape in shapes.values()):
            return
        zeros = {key: np.zeros(shape, np.float32) for key, shape in shapes.items()}
        example = zeros.get(None, zeros)
        self._check(_with_time(example, 1.0) if self._time_feature is not None else example)

    def _check_arguments(self, env: Any) -> None:
        """Raise if the environment was made with other arguments than that of the training: RL Baselines3 Zoo evaluates with these. One that is
        not registered shows them as attributes."""
        spec = next(filter(None, (getattr(layer, "spec", None) for layer in layers(env))), None)
        given = dict(getattr(spec, "kwargs", None) or {})
        if spec is None:
            found = ((key, [getattr(layer, key) for layer in layers(env) if hasattr(layer, key)]) for key in self._arguments)
            given = {key: values[0] for key, values in found if values}
        other = {key: value for key, value in self._arguments.items() if str(given.get(key)) != str(value)}
        if not other:
            return
        stated = ", ".join(f"{key} = {json.dumps(value)}" for key, value in other.items())
        if spec is None:
            raise ValueError(
                f"the model was trained in an environment with {stated} (env_kwargs of args.yml), and this one does not show that it has them. "
                "Hint: make it with these arguments in its file, and keep each as an attribute of its name"
            )
        query = "&".join(f"{key}={json.dumps(value)}" for key, value in (given | other).items())
        raise ValueError(
            f"the model was trained in an environment with {stated} (env_kwargs of args.yml). Hint: add ?{query} to its name, for example "
            f"gymnasium:{spec.id}?{query}"
        )

    def _check_actions(self, env: Any) -> None:
        """Raise if the environment takes other actions than that of the training: the model's numbers would mean something else."""
        import numpy as np

        trained, found = getattr(self.model, "action_space", None), getattr(env, "action_space", None)
        parts = ("shape", "n", "nvec", "start", "low", "high")
        if trained is None or found is None or type(trained).__name__ != type(found).__name__:
            same = trained is None or found is None
        else:
            both = [(getattr(trained, part, None), getattr(found, part, None)) for part in parts]
            same = all((a is None) == (b is None) and (a is None or np.shape(a) == np.shape(b) and np.allclose(a, b)) for a, b in both)
        if not same:
            raise ValueError(
                f"the model was trained with the actions {trained}, but the environment takes {found}. Hint: name the environment with the "
                "wrapper of the training (for example gymnasium.wrappers.RescaleAction)"
            )

    def _limit(self, env: Any) -> int:
        limits = (getattr(getattr(layer, "spec", None), "max_episode_steps", None) for layer in layers(env))
        return next(filter(None, limits), None) or (self._time_feature or {}).get("max_steps", TIME_FEATURE_STEPS)

    def _check(self, observation: Any) -> None:
        """Raise if an observation has another shape than those of the training."""
        import numpy as np

        space = getattr(self.model, "observation_space", None)
        spaces = getattr(space, "spaces", None)
        wanted = {key: part.shape for key, part in spaces.items()} if spaces else {"observation": getattr(space, "shape", None)}
        seen = observation if isinstance(observation, Mapping) else {"observation": observation}
        for key, shape in wanted.items():
            found = np.shape(seen[key]) if key in seen else None
            # The model moves the channels of an image to the front itself.
            if shape is not None and found not in (tuple(shape), (*shape[1:], shape[0]) if len(shape) == 3 else None):
                at_end = len(shape) == 1 and found == (shape[0] - 1,)
                hint = (
                    ". If it was trained with the remaining time as a feature, name the folder of RL Baselines3 Zoo, whose config.yml says so"
                    if at_end
                    else ""
                )
                raise ValueError(f"the model expects {key} of the shape {tuple(shape)}, but the environment observes {found}{hint}")


def _with_time(observation: Any, feature: float) -> Any:
    import numpy as np

    if isinstance(observation, Mapping):
        return {**observation, "observation": _with_time(observation["observation"], feature)}
    return np.append(observation, np.array(feature, dtype=np.asarray(observation).dtype))


def load(path: "str | os.PathLike[str]", statistics: "str | os.PathLike[str] | None" = None) -> Model:
    """Load a model: a zip file, or a folder of RL Baselines3 Zoo.

    `statistics` are those of VecNormalize; default: `vecnormalize.pkl` beside the file. The model contains pickles, which are
    programs: load only files that you trust. The statistics are read without running any.

    Raises:
        ValueError: There is no such model, or its observations passed through something that this package does not know.
    """
    place = Path(path)
    file = place if not place.is_dir() else _zip_in(place)
    settings = _settings(file)
    # The Zoo normalises only where its settings say so, also with statistics beside them.
    off = "normalize" in settings and not _normalizes(settings)
    found = [Path(statistics)] if statistics is not None else [] if off else _statistics_of(file)
    if not found and _normalizes(settings):
        raise ValueError(f"{file}: the model was trained with normalised observations, but there is no {STATISTICS[0]} beside it")
    normalizer = Statistics(found[0]) if found else None
    model = _algorithm(file).load(file, device="cpu", custom_objects=TRAINING)
    return Model(model, normalizer, _time_feature(file, settings), [file, *found[:1]], _settings(file, "args.yml").get("env_kwargs"))


def batched(model: Any) -> "Callable[[list[Any]], list[Any]] | None":
    """A model as a function from several observations to a list of actions. None if it has a memory or masks actions."""
    import numpy as np

    if hasattr(getattr(model, "policy", None), "lstm_actor") or type(model).__name__ == "MaskablePPO":
        return None

    def answer(observations: list[Any]) -> list[Any]:
        first = observations[0]
        stacked = {key: np.stack([one[key] for one in observations]) for key in first} if isinstance(first, Mapping) else np.stack(observations)
        return [action[None] for action in np.asarray(model.predict(stacked, deterministic=True)[0])]

    return answer


class Statistics:
    """The statistics of VecNormalize for observations. The pickle runs no code: only NumPy's arrays are made, and objects of all
    other classes keep their attributes and do nothing."""

    def __init__(self, path: Path):
        import numpy as np

        try:
            with open(path, "rb") as opened:
                found = vars(_Inert.Unpickler(opened).load())
        except Exception as why:  # a damaged pickle raises any
            raise ValueError(f"{path}: not the statistics of VecNormalize: {why}") from None
        if not {"norm_obs", "clip_obs", "epsilon", "obs_rms"} <= found.keys():
            raise ValueError(f"{path}: not the statistics of VecNormalize: it has no obs_rms, norm_obs, clip_obs and epsilon")
        parts = found["obs_rms"] if isinstance(found["obs_rms"], dict) else {None: found["obs_rms"]}
        names = parts if None in parts else found.get("norm_obs_keys") or parts
        self._clip = float(found["clip_obs"])
        try:
            self._parts = {name: (parts[name].mean, np.sqrt(parts[name].var + found["epsilon"])) for name in names if found["norm_obs"]}
        except (AttributeError, KeyError, TypeError) as why:
            raise ValueError(f"{path}: not the statistics of VecNormalize: {why}") from None

    def normalized(self, observation: Any) -> Any:
        """The observation as the model saw it in training."""
        if None in self._parts:
            return self._scaled(observation, None)
        return {**observation, **{name: self._scaled(observation[name], name) for name in self._parts}} if self._parts else observation

    def _scaled(self, value: Any, name: "str | None") -> Any:
        import numpy as np

        mean, deviation = self._parts[name]
        return np.clip((value - mean) / deviation, -self._clip, self._clip).astype(np.float32)


class _Inert:
    """An object of a pickle, with its attributes and without its class."""

    def __init__(self, *_: Any, **__: Any):
        pass

    def __setstate__(self, state: Any) -> None:
        if isinstance(state, dict):
            self.__dict__.update(state)

    def __setitem__(self, key: Any, value: Any) -> None:
        pass

    def append(self, value: Any) -> None:
        pass

    class Unpickler(pickle.Unpickler):
        """Makes arrays and numbers of NumPy, and inert objects in place of all others."""

        def find_class(self, module: str, name: str) -> Any:
            import numpy as np

            array = np.zeros(1)
            makers = {"_reconstruct": array.__reduce__()[0], "_frombuffer": array.__reduce_ex__(5)[0], "scalar": array[0].__reduce__()[0]}
            known = {"ndarray": np.ndarray, "dtype": np.dtype, **makers}
            return known[name] if module.partition(".")[0] == "numpy" and name in known else _Inert


def _zip_in(folder: Path) -> Path:
    """The model of a folder: `best_model.zip`, or the only zip file."""
    best = folder / "best_model.zip"
    files = [best] if best.is_file() else sorted(file for file in folder.glob("*.zip") if "_steps" not in file.stem)
    if len(files) != 1:
        names = ", ".join(file.name for file in files) or "none"
        raise ValueError(f"{folder}: expected one model, best_model.zip or one .zip file. It has: {names}")
    return files[0]


def _statistics_of(file: Path) -> list[Path]:
    """The statistics beside a model, its own ones first. RL Baselines3 Zoo has a folder with the name of the environment for them, and a
    callback of Stable-Baselines3 writes those of `PREFIX_N_steps.zip` to `PREFIX_vecnormalize_N_steps.pkl`."""
    own = re.sub(r"(_\d+_steps)?$", r"_vecnormalize\1", file.stem, count=1)
    names = (f"{own}.pkl", f"{file.stem}_{STATISTICS[0]}", f"{file.stem}_{STATISTICS[1]}", *STATISTICS)
    return [found for folder in _folders(file) for name in names if (found := folder / name).is_file()]


def _folders(file: Path) -> list[Path]:
    inner = [folder for folder in sorted(file.parent.iterdir()) if (folder / "config.yml").is_file()]
    return [file.parent, *inner]


def _settings(file: Path, name: str = "config.yml") -> dict[str, Any]:
    """What RL Baselines3 Zoo writes beside a model: hyperparameters in config.yml, or arguments of the training in args.yml. Empty without
    such a file."""
    config = next((found for folder in _folders(file) if (found := folder / name).is_file()), None)
    if config is None:
        return {}
    try:
        import yaml
    except ModuleNotFoundError:
        raise ValueError(f"{config}: the package yaml is missing: pip install pyyaml") from None

    class Loader(yaml.SafeLoader):
        """Reads OrderedDicts as the Zoo writes them, and no other Python objects."""

    tag = "tag:yaml.org,2002:python/object/apply:collections.OrderedDict"
    Loader.add_constructor(tag, lambda loader, node: dict(loader.construct_sequence(node, deep=True)[0]))
    if name != "config.yml":
        # The arguments have objects that nothing here depends on.
        Loader.add_multi_constructor("tag:yaml.org,2002:python/", lambda loader, suffix, node: f"!!python/{suffix}")
    try:
        return dict(yaml.load(config.read_text(encoding="utf-8"), Loader=Loader) or {})  # noqa: S506
    except (yaml.YAMLError, TypeError, ValueError) as why:
        raise ValueError(f"{config}: not the settings of RL Baselines3 Zoo: {why}") from None


def _normalizes(settings: Mapping[str, Any]) -> bool:
    """Whether observations were normalised in training: `normalize` is a truth value, or a dict as text."""
    value = settings.get("normalize", False)
    return bool(value) and "'norm_obs': False" not in str(value)


def _time_feature(file: Path, settings: Mapping[str, Any]) -> dict[str, Any] | None:
    """The settings of the time feature in training. None without it."""
    if (settings.get("frame_stack") or 1) != 1:
        raise ValueError(f"{file}: the model was trained with stacked frames. Stack them in the environment: gymnasium.wrappers.FrameStackObservation")
    if outer := settings.get("vec_env_wrapper"):
        raise ValueError(f"{file}: the model was trained with the wrapper {outer} around several environments, which this package does not know")
    wrappers = settings.get("env_wrapper") or []
    feature = None
    for wrapper in wrappers if isinstance(wrappers, list) else [wrappers]:
        name, options = next(iter(wrapper.items())) if isinstance(wrapper, Mapping) else (wrapper, None)
        if str(name).rpartition(".")[2] != TIME_FEATURE:
            raise ValueError(f"{file}: the model was trained with the wrapper {name}. Put it around the environment in a file, and name the .zip file")
        feature = dict(options or {})
    return feature


def _algorithm(file: Path) -> Any:
    """The class of the algorithm that saved a model."""
    try:
        with zipfile.ZipFile(file) as archive:
            data = json.loads(archive.read("data"))
    except (OSError, KeyError, zipfile.BadZipFile, json.JSONDecodeError) as why:
        raise ValueError(f"{file}: not a model of Stable-Baselines3: {why}") from None
    # Stored as text: "stable_baselines3.sac.policies". The policies of PPO, A2C and TRPO are those of `common`.
    module = str(data.get("policy_class", {}).get("__module__", ""))
    package, _, parts = module.removesuffix(".policies").partition(".")
    name = parts.rpartition(".")[2].upper()
    if package == "sb3_contrib":
        name = CONTRIB.get(parts.rpartition(".")[2], name)
    elif name == "COMMON":
        package, name = ("sb3_contrib", "TRPO") if "cg_max_steps" in data else (package, "PPO" if "clip_range" in data else "A2C")
    installed = {"stable_baselines3": "stable-baselines3", "sb3_contrib": "sb3-contrib"}
    if package not in installed:
        raise ValueError(f"{file}: unknown algorithm ({module}). Load the model yourself, and pass the object")
    try:
        algorithms = importlib.import_module(package)
    except ModuleNotFoundError:
        raise ValueError(f"{file}: the package {package} is missing: pip install {installed[package]}") from None
    algorithm = getattr(algorithms, name, None)
    if algorithm is None:
        raise ValueError(f"{file}: unknown algorithm ({module}). Load the model yourself, and pass the object")
    return algorithm
