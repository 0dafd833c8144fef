"""An environment as a simulator of the bridge protocol."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from robogate_bridge import FreeRun, Image, Problem, Recording

from . import mujoco_knobs
from .default_space import default_space
from .disturbances import Disturbances
from .environment import Camera, DeclarationError, Environment, task_name
from .knobs import Knob, differs, parameter_name
from .model import Model, NoModel
from .motion import Recorder
from .rendering import Pictures
from .spaces import Actions, Observations, same
from .trajectory import Trajectory

# The protocol allows 256 parameters.
MAX_KNOBS = 250
# Width and height of the images of the model's own cameras, in pixels, and how many of them are offered.
PICTURE_PX = 256
MAX_CAMERAS = 16
# The protocol allows images of this width and height.
MAX_PIXELS = 4096


def _mujoco_sha256() -> str | None:
    """The hash of MuJoCo's library, or None if the package contains none."""
    import mujoco

    libraries = sorted(Path(mujoco.__file__).parent.glob("libmujoco*"))
    return hashlib.sha256(libraries[0].read_bytes()).hexdigest() if libraries else None


class Adapter:
    """Serves an environment.

    `doing` is called before each call of the environment until it is ready: with `make`, `reset`, `knobs` and `step`.
    """

    def __init__(self, environment: Environment, doing: Callable[[str], None] = lambda _: None):
        self._environment = environment
        self._task = environment.task
        doing("make")
        self._env = env = environment.make()
        if (worlds := getattr(env, "num_envs", 1)) != 1:
            raise DeclarationError(f"the environment steps {worlds} worlds at once (num_envs). Expected one: RoboGate starts a process for each")
        self._observations = Observations(env.observation_space)
        self._actions = Actions(env.action_space, self._task.action_names)
        rest = np.zeros(len(self._actions.low)) if self._task.rest_action is None else np.asarray(self._task.rest_action)
        # Zeros at a bound or outside the bounds are not a rest position.
        known = self._task.rest_action is not None or bool((self._actions.low < 0.0).all() and (self._actions.high > 0.0).all())
        lengths = {name: length for name, (_, length) in self._observations.vectors.items()}
        rest = self._actions.decode(rest)
        self._disturbances = Disturbances(lengths, rest if known else None)
        doing("reset")
        first = self._first_reset()
        if not isinstance(first, tuple) or len(first) != 2:
            raise DeclarationError(f"reset returned {_values(first)}. Expected observation and info, as in Gymnasium")
        self._observations.check(first[0])
        self._observe = self._find_observe(first[0])
        try:
            self._model: Model | None = Model(env)
        except (NoModel, ImportError):
            self._model = None
        self._period = self._control_period(rest, doing)
        self._limit = self._step_limit()
        doing("knobs")
        # Knobs that do not act, with the reason.
        self.dropped: list[tuple[str, str]] = []
        # Whether a reset of the check below built another model.
        self._changes = False
        self._offer(self._knobs())
        self._cameras = self._find_cameras()
        self._pictures = Pictures()
        self._hash = 0
        try:
            self.deterministic = self._is_deterministic(doing)
            self._require_success(doing)
            if self._model is not None and self._changes:
                self.dropped += [(knob.name, "each reset builds a model with other bodies or joints") for knob in self.knobs if self._is_bound(knob)]
                self._offer([knob for knob in self.knobs if not self._is_bound(knob)])
        except Problem as problem:
            # The first episode of any environment shows what its declaration lacks.
            if problem.kind in ("setup", "not_applied"):
                raise DeclarationError(problem.detail) from None
            raise

    def _offer(self, knobs: list[Knob]) -> None:
        self.knobs = knobs
        self._by_parameter = {knob.parameter: knob for knob in knobs}
        self._order = {knob.parameter: position for position, knob in enumerate(knobs)}

    def _is_bound(self, knob: Knob) -> bool:
        """Whether a knob changes a body, joint or camera by its number in the first model."""
        own = any(knob is one for one in self._environment.knobs)
        return not own and ":" in knob.name and not knob.name.startswith(("gain:", "noise:"))

    def _first_reset(self) -> Any:
        try:
            return self._env.reset(seed=0)
        except TypeError as error:
            if "seed" not in str(error):
                raise
            raise DeclarationError(
                "reset takes no seed. Expected Gymnasium's reset(seed=..., options=...), from which all randomness of an episode follows. "
                "The package shimmy translates environments of the older gym"
            ) from None

    # Declaration

    def hello(self) -> dict:
        name, version = self._engine()
        engine = {"name": name, "version": version, "solver": self._environment.source or None}
        if self._model is not None:
            engine["sha256"] = _mujoco_sha256()
        return {
            "server": {"name": "robogate-eval", "version": "1"},
            "engine": engine,
            "task": self._declaration(),
            "space": self._space(),
            "policies": [{"name": name, "meaning": policy.meaning, "version": policy.version} for name, policy in self._environment.policies.items()],
            "scores_itself": True,
            "deterministic": self.deterministic,
            "records_motion": self._model is not None,
        }

    def _declaration(self) -> dict:
        task = self._task
        modes = [{"name": mode.name, "meaning": mode.meaning, "severity": mode.severity} for mode in task.failure_modes]
        if all(mode.name != "terminated" for mode in task.failure_modes):
            modes.append({"name": "terminated", "meaning": "The environment ended the episode without success."})
        return {
            "name": task.name,
            "version": task.version,
            "instruction": task.instruction or task.name,
            "control_period_s": self._period,
            "time_limit_s": self._limit * self._period,
            "failure_modes": modes,
            "measures": [
                {"name": measure.name, "unit": measure.unit, "meaning": measure.meaning, "better": measure.better}
                for measure in task.measures
            ],
            "parameters": [knob.declaration() for knob in self.knobs],
            "observation": {
                "vectors": self._observations.declaration(),
                "cameras": [{"name": c.name, "width": c.width, "height": c.height} for c in self._cameras],
            },
            "action": {"spaces": [self._actions.declaration()]},
        }

    def _space(self) -> dict | None:
        """The space that is sampled by default."""
        parameters = []
        for name, domain in (self._environment.space or self._default_space()).items():
            knob = self._by_parameter.get(parameter_name(name))
            if knob is None:
                reason = dict(self.dropped).get(name, "the environment has no such knob")
                raise DeclarationError(f"the space of {self._task.name} contains {name}: {reason}")
            if knob.choices:
                parameters.append({"name": knob.parameter, "kind": "categorical", "choices": list(domain)})
                continue
            low, high, *scale = domain
            parameter = {"name": knob.parameter, "kind": "integer" if knob.integer else "continuous", "low": low, "high": high}
            if scale:
                parameter["scale"] = scale[0]
            parameters.append(parameter)
        return {"name": self._task.name, "parameter": parameters} if parameters else None

    def _default_space(self) -> dict[str, tuple]:
        """What is sampled if the environment does not say it."""
        wanted = self._environment.knobs
        own = {knob.name for knob in wanted if isinstance(knob, Knob)}
        named = {knob for knob in wanted if isinstance(knob, str)}
        return default_space(self.knobs, own, named, self._model, self._period)

    def _control_period(self, rest: np.ndarray, doing: Callable[[str], None]) -> float:
        if self._task.control_period_s is not None:
            return float(self._task.control_period_s)
        base = self._env.unwrapped
        period, rate = getattr(base, "dt", None), (getattr(base, "metadata", None) or {}).get("render_fps")
        stated = [float(period)] if isinstance(period, (int, float)) and period > 0 else []
        if rate:
            stated.append(1.0 / float(rate))
        if self._model is not None and (simulated := self._simulated_period(self._model, rest, doing)) > 0.0:
            return next((one for one in stated if math.isclose(one, simulated, rel_tol=0.01)), round(simulated, 9))
        example = "control_period_s=0.05"
        if not stated:
            raise DeclarationError(self._unknown("control period", example))
        if not math.isclose(stated[0], stated[-1], rel_tol=0.01):
            what = f'control period (`dt` says {stated[0]:g} s, and `metadata["render_fps"]` {stated[-1]:g} s)'
            raise DeclarationError(self._unknown(what, example))
        return stated[0]

    def _simulated_period(self, model: Model, rest: np.ndarray, doing: Callable[[str], None]) -> float:
        """How far a step moves the time of the physics."""
        before = float(model.data.time)
        doing("step")
        self._env.step(rest)
        after = float(model.data.time)
        doing("reset")
        self._env.reset(seed=0)
        model.bind(self._env)
        return after - before

    def _step_limit(self) -> int:
        if self._task.time_limit_s is not None:
            return max(1, round(self._task.time_limit_s / self._period))
        specification = getattr(self._env, "spec", None)
        for limit in (getattr(specification, "max_episode_steps", None), getattr(self._env.unwrapped, "max_path_length", None)):
            if limit:
                return int(limit)
        raise DeclarationError(self._unknown("time limit", "time_limit_s=10.0"))

    def _unknown(self, what: str, field: str) -> str:
        """The error for something that neither the environment nor its task says."""
        return f"the {what} of {self._task.name} is unknown. Declare it in a Task:\n{_example(self._env, self._task.name, field)}"

    def _engine(self) -> tuple[str, str]:
        if self._environment.engine is not None:
            return self._environment.engine
        if self._model is not None:
            import mujoco

            return "mujoco", mujoco.__version__
        import gymnasium

        return "gymnasium", gymnasium.__version__

    def _knobs(self) -> list[Knob]:
        wanted = self._environment.knobs
        own = [knob for knob in wanted if isinstance(knob, Knob)]
        names = {knob for knob in wanted if isinstance(knob, str)}
        offered = self._disturbances.knobs(self._period)
        if self._model is not None:
            found = mujoco_knobs.catalogue(self._model, self._observe is not None, names | set(self._environment.space), bool(self._observations.images))
            if "*" not in names:
                found = [knob for knob in found if knob.name in names]
            kept, self.dropped = mujoco_knobs.self_test(self._model, found, self._env)
            offered += kept
            if "*" in names:
                self.dropped += mujoco_knobs.unnamed(self._model, names)
                if self._observe is None and mujoco_knobs.has_free_body(self._model):
                    why = "`_get_obs()` does not return the observation of the reset. Declare `observe` in the Environment"
                    self.dropped.append(("shift_x, shift_y and turn of the free bodies", why))
        known = {knob.name for knob in offered} | dict(self.dropped).keys()
        unknown = sorted(names - known - {"*"})
        if unknown:
            raise DeclarationError(f"{self._task.name}: no knob is named {', '.join(unknown)}")
        taken: dict[str, str] = {}
        unique = []
        # Knobs that are sampled by default come first, so that they are within the limit.
        order = [*own, *sorted(offered, key=lambda knob: knob.name not in self._environment.space and knob.name not in names)]
        for knob in order:
            first = taken.get(knob.parameter)
            if first is None:
                taken[knob.parameter] = knob.name
                unique.append(knob)
            elif first != knob.name:
                self.dropped.append((knob.name, f"its parameter {knob.parameter} is that of {first}"))
        self.dropped += [(knob.name, f"the task has more than {MAX_KNOBS} parameters") for knob in unique[MAX_KNOBS:]]
        return unique[:MAX_KNOBS]

    def _find_observe(self, first: Any) -> Callable[[Any], Any] | None:
        """How an observation is taken again after a change: as declared, or with `_get_obs()` if it returns the observation of the
        last reset. With observation wrappers, or with arguments, it does not."""
        if self._environment.observe is not None:
            return self._environment.observe
        if not callable(getattr(self._env.unwrapped, "_get_obs", None)):
            return None
        try:
            return _get_obs if same(_get_obs(self._env), first) else None
        except Exception:  # any function may have this name
            return None

    def _is_deterministic(self, doing: Callable[[str], None]) -> bool:
        """Run one scenario twice, with another one in between, and compare all states."""

        def repeats() -> bool:
            first = self._states(1, 25, doing)
            self._states(2, 10, doing)
            return first == self._states(1, 25, doing)

        if repeats():
            return True
        if self._model is None:
            return False
        self._model.keep_state()
        return repeats()

    def _states(self, index: int, steps: int, doing: Callable[[str], None]) -> list[int]:
        from robogate_bridge import Action, Scenario

        doing("reset")
        self.reset(Scenario(index=index, seed=0, parameters={}))
        self._changes = self._changes or (self._model is not None and self._model.differs)
        random, states = np.random.default_rng(index), [self.state_hash()]
        for _ in range(min(steps, self._limit)):
            numbers = random.uniform(self._actions.low, self._actions.high).tolist()
            doing("step")
            if self.step(Action("vector", numbers))["ending"] is not None:
                break
            states.append(self.state_hash())
        return states

    def _require_success(self, doing: Callable[[str], None]) -> None:
        """Raise if the environment does not report success. Many do so at the end of an episode only, so one is run to its end."""
        if self._task.success is not None or _reported(self._trajectory) is not None:
            return
        from robogate_bridge import Action, Scenario

        doing("reset")
        self.reset(Scenario(index=3, seed=0, parameters={}))
        random, ending = np.random.default_rng(3), None
        while ending is None:
            doing("step")
            ending = self.step(Action("vector", random.uniform(self._actions.low, self._actions.high).tolist()))["ending"]

    # Episodes

    def reset(self, scenario: Any) -> dict:
        requested = [(self._by_parameter[name], value) for name, value in scenario.parameters.items()]
        # The order of the declaration: a mass is set before the inertia that scales with it.
        requested.sort(key=lambda pair: self._order[pair[0].parameter])
        if self._model is not None:
            self._model.before_reset()
        self._disturbances.begin(scenario.seed, scenario.index)
        for knob, value in requested:
            if knob.before_reset:
                knob.set(self._env, value)
        observation, _ = self._env.reset(seed=_seed(scenario))
        if self._model is not None:
            self._model.bind(self._env)
            if self._model.differs and (bound := [knob.name for knob, _ in requested if self._is_bound(knob)]):
                raise Problem("not_applied", f"the reset built a model with other bodies or joints, so {bound[0]} has no meaning")
        for knob, value in requested:
            if not knob.before_reset:
                knob.set(self._env, value)
        if self._model is not None and requested:
            self._model.finish()
        if any(knob.moves for knob, _ in requested):
            observation = self._observe(self._env)
        applied = {knob.parameter: self._read(knob) for knob, _ in requested}
        # Friction is read again in every step: the engine decides it contact by contact.
        self._watched = [(knob, value) for knob, value in requested if knob.watch is not None]
        if self._task.prepare is not None:
            observation = self._task.prepare(self._env, observation)
            if self._model is not None:
                self._model.advanced()
        self._trajectory = Trajectory(self._env, self._period, observations=[observation])
        self._recorder = None
        if scenario.record_s is not None and self._model is not None:
            self._recorder = Recorder(self._env, self._model, scenario.record_s)
        self._policy = None
        if scenario.policy is not None:
            self._policy = self._environment.policies[scenario.policy].make(self._env)
        reply = self._reply(observation) | {"applied": applied}
        if self._task.episode_instruction is not None:
            reply["instance"] = {"instruction": self._task.episode_instruction(self._env)}
        return reply

    def _read(self, knob: Knob) -> Any:
        value = knob.read(self._env)
        if value is None:
            raise Problem("not_applied", f"{knob.name} cannot be read in this episode")
        if isinstance(value, str):
            return value
        return int(value) if knob.integer else float(value)

    def _reply(self, observation: Any) -> dict:
        """What a policy receives, and the action of the policy that runs here."""
        seen = observation
        if self._disturbances.noisy:
            seen = self._observations.with_noise(observation, self._disturbances.noise())
        self._seen = seen
        self._hash = self._state()
        reply = {"observation": {"vectors": self._observations.encode(seen)}}
        if self._policy is not None:
            reply["proposed"] = {"action_space": "vector", "action": self._actions.encode(self._policy(seen))}
        return reply

    def step(self, action: Any) -> dict:
        observation, ending, measures = self._advance(action.numbers)
        reply = self._reply(observation)
        reply["ending"], reply["measures"], reply["state_hash"] = ending, measures, self._hash
        return reply

    def free_run(self, numbers: list[float], periods: int, ends: float) -> FreeRun:
        """Up to so many control periods with the actions of the episode's policy, of which `numbers` is the next: what `step` does in
        turns. Stops at the time `ends` of the monotonic clock.

        What does not decide the next action is computed afterwards, all at once: between two steps of the physics, the processor
        finds neither code nor data of it in its caches.
        """
        seen_all, actions, states = [], [], []
        last, error = None, None
        noisy, vectors = self._disturbances.noisy, self._observations
        try:
            while len(actions) < periods and time.monotonic() <= ends:
                observation, ending, measures = self._advance(numbers)
                if self._policy is None or not vectors.is_plain(observation):
                    last = self._reply(observation) | {"ending": ending, "measures": measures, "state_hash": self._hash}
                    break
                seen = vectors.with_noise(observation, self._disturbances.noise()) if noisy else observation
                # The next control period may write to the array.
                self._seen = seen = seen.copy()
                state = self._model.state()
                numbers = self._actions.bounded(self._policy(seen))
                if not self._actions.are_finite(numbers):
                    last = self._answer(seen, numbers, state)
                    break
                seen_all.append(seen)
                actions.append(numbers)
                states.append(state)
        except Exception as why:
            error = why
        digests = [self._model.hash_of(state) for state in states]
        if digests and last is None:
            self._hash = digests[-1]
        rows, answers = np.asarray(seen_all, dtype="<f8"), [] if last is None else [last]
        if not np.isfinite(rows).all():
            # The server says which number is not finite.
            answers = [self._answer(*one) for one in zip(seen_all, actions, states)] + answers
            rows, actions, digests = rows[:0], [], []
        return FreeRun("observation", rows, np.asarray(actions, dtype="<f8"), np.asarray(digests, dtype="<u8"), answers, error)

    def _answer(self, seen: Any, action: np.ndarray, state: bytes) -> dict:
        """What `step` returns for a control period in which the episode goes on."""
        return {
            "observation": {"vectors": self._observations.encode(seen)},
            "proposed": {"action_space": "vector", "action": action.tolist()},
            "ending": None,
            "measures": {},
            "state_hash": self._model.hash_of(state),
        }

    def can_free_run(self) -> bool:
        """Whether `free_run` can run this environment."""
        return self._model is not None and self._policy is not None and bool(self._observations.single)

    def _advance(self, numbers: "list[float] | np.ndarray") -> tuple[Any, dict | None, dict]:
        """Run one control period. Returns the observation, and the ending with its measures."""
        executed = self._actions.decode(numbers)
        if self._disturbances.delays:
            executed = self._disturbances.delayed(executed)
        try:
            result = self._env.step(executed)
        except Exception as error:
            # dm_control's, by its name: the package may be missing.
            if type(error).__name__ == "PhysicsError":
                raise Problem("diverged", str(error)) from error
            raise
        try:
            observation, reward, terminated, truncated, info = result
        except (TypeError, ValueError):
            raise Problem("setup", f"step returned {_values(result)}. Expected observation, reward, terminated, truncated, info") from None
        trajectory = self._trajectory
        trajectory.observations.append(observation)
        trajectory.actions.append(executed)
        try:
            trajectory.rewards.append(float(reward))
        except (TypeError, ValueError):
            raise Problem("setup", f"step returned the reward {reward!r:.80}. Expected a number") from None
        trajectory.infos.append(info)
        trajectory.terminated = bool(terminated)
        trajectory.over = over = bool(terminated or truncated or len(trajectory.actions) >= self._limit)
        if self._model is not None:
            self._check(self._model)
        if self._recorder is not None:
            self._recorder.advance(trajectory.time_s)
        ending, measures = self._ending(trajectory, info), {}
        if ending is not None or over:
            # A policy is not asked for an action that nobody runs.
            self._policy = None
            if self._task.measure is not None:
                measures = dict(self._task.measure(trajectory))
        return observation, ending, measures

    def _ending(self, trajectory: Trajectory, info: dict) -> dict | None:
        if self._task.success is None:
            # Most environments report it in this way.
            reported = info.get("success", info)
            done = reported if type(reported) is bool else bool(reported) if type(reported) is float else self._succeeded(trajectory)
        else:
            done = self._task.success(trajectory)
        if done:
            return {"failure": None}
        failure = None if self._task.failure is None else self._task.failure(trajectory)
        if failure is None and trajectory.over:
            failure = "terminated" if trajectory.terminated else "timeout"
        return None if failure is None else {"failure": failure}

    def _succeeded(self, trajectory: Trajectory) -> bool:
        reported = _reported(trajectory)
        if reported is None and trajectory.over:
            example = _example(trajectory.env, self._task.name, "success=lambda t: t.rewards[-1] > 0.9")
            has = ", ".join(map(str, trajectory.info)) or "nothing"
            raise Problem(
                "setup",
                "the environment reports no success: until the end of an episode, info had neither `success` nor `is_success` (it has "
                f"{has}), and there is no check_success(). Say in a file what success is, and name the file with --env. If it is a reward "
                f"above 0.9:\n{example}",
            )
        return bool(reported)

    def _check(self, model: Model) -> None:
        """Raise if the physics diverged, or if a parameter does not act any more."""
        if (why := model.diverged()) is not None:
            raise Problem("diverged", why)
        if not model.advanced():
            raise Problem("not_applied", "the environment does not step the model to which the parameters were written")
        for knob, wanted in self._watched:
            found = knob.watch(self._env)
            if found is not None and differs(wanted, found):
                time_s = self._trajectory.time_s
                raise Problem("not_applied", f"requested {knob.parameter} = {wanted:g}, but {found:g} acted at {time_s:.3f} s")

    def motion(self) -> Recording:
        return self._recorder.recording(self._trajectory.time_s)

    def state_hash(self) -> int:
        return self._hash

    def _state(self) -> int:
        if self._model is not None:
            return self._model.hash()
        digest = hashlib.blake2b(digest_size=8)
        observation = self._trajectory.observations[-1]
        for name in self._observations.vectors:
            digest.update(np.asarray(self._observations.encode(observation)[name]).tobytes())
        digest.update(np.asarray(self._trajectory.rewards[-1:]).tobytes())
        return int.from_bytes(digest.digest(), "little")

    # Cameras

    def _find_cameras(self) -> list[Camera]:
        seen = [Camera(name, width, height) for name, (_, height, width) in self._observations.images.items()]
        declared = [*seen, *self._task.cameras]
        if declared:
            return declared
        if self._model is None:
            return self._own_picture()
        # Without a choice of the environment: the cameras of its model. Only those that a policy uses are rendered.
        names = {task_name(name): name for name in self._model.names("camera") if name}
        own = [Camera(task, PICTURE_PX, PICTURE_PX, partial(self._pixels, name)) for task, name in names.items()]
        # The same views in a quality that takes a fraction of the time without a GPU.
        plain = [Camera(f"{task[:58]}.plain", PICTURE_PX, PICTURE_PX, partial(self._pixels, name, plain=True)) for task, name in names.items()]
        return [*own, *plain][:MAX_CAMERAS]

    def _own_picture(self) -> list[Camera]:
        """What the environment itself renders, if it was made for images."""
        if getattr(self._env, "render_mode", None) != "rgb_array":
            return []
        try:
            pixels = _rgb(self._env)
        except Exception:  # a package for rendering is missing, or a display
            return []
        if pixels.ndim != 3 or pixels.shape[2] != 3 or not 1 <= min(pixels.shape) <= max(pixels.shape) <= MAX_PIXELS:
            return []
        height, width, _ = pixels.shape
        return [Camera("render", width, height, _rgb)]

    def render(self, cameras: list[str]) -> list[Image]:
        by_name = {camera.name: camera for camera in self._cameras}
        return [self._image(by_name[name]) for name in cameras]

    def _image(self, camera: Camera) -> Image:
        if camera.name in self._observations.images:
            pixels = self._observations.image(self._seen, camera.name)
        elif camera.render is not None:
            pixels = np.ascontiguousarray(camera.render(self._env), dtype=np.uint8)
        else:
            pixels = self._rendered(camera)
        return Image(camera.name, camera.width, camera.height, pixels.tobytes())

    def _rendered(self, camera: Camera) -> np.ndarray:
        if self._model is None:
            raise Problem("unsupported", f"the camera {camera.name} has no render function, and there is no MuJoCo model")
        return self._pixels(camera.name, self._env, camera.width, camera.height)

    def _pixels(self, name: str, env: Any, width: int = PICTURE_PX, height: int = PICTURE_PX, plain: bool = False) -> np.ndarray:
        """The image of a camera of the model."""
        try:
            return self._pictures.picture(self._model.model, self._model.data, name, height, width, plain)
        except Exception as why:
            raise Problem("setup", f"MuJoCo cannot render the camera {name}: {why}. Set MUJOCO_GL to egl, osmesa or glfw") from why


def _get_obs(env: Any) -> Any:
    return env.unwrapped._get_obs()


def _rgb(env: Any) -> np.ndarray:
    """The image that an environment renders, without transparency."""
    return np.asarray(env.render(), dtype=np.uint8)[..., :3]


def _values(result: Any) -> str:
    return f"{len(result)} values" if isinstance(result, tuple) else f"a {type(result).__name__}"


def _seed(scenario: Any) -> int:
    """The seed of an episode, from the seed of the campaign and the index of the episode; below 2^31."""
    digest = hashlib.blake2b(f"{scenario.seed}/{scenario.index}".encode(), digest_size=4).digest()
    return int.from_bytes(digest, "little") >> 1


def _reported(trajectory: Trajectory) -> bool | None:
    """Success as most environments report it. None if this one has not reported anything yet."""
    for info in reversed(trajectory.infos):
        for key in ("success", "is_success"):
            if key in info:
                # Reported earlier and not now: this step is not a success.
                return info is trajectory.infos[-1] and _truth(info[key])
    check = getattr(trajectory.env.unwrapped, "check_success", None) or getattr(trajectory.env.unwrapped, "_check_success", None)
    return None if check is None else _truth(check())


def _truth(value: Any) -> bool:
    if isinstance(value, str):
        raise Problem("setup", f"info reports success as the text {value!r:.40}. Expected True or False")
    # `np.all` of one number takes ten times as long.
    return bool(np.all(value)) if isinstance(value, (np.ndarray, list, tuple)) else bool(value)


def _example(env: Any, name: str, field: str) -> str:
    """A file that declares a Task with this field."""
    specification = getattr(env, "spec", None)
    identifier = getattr(specification, "id", None)
    first, make = "", type(env.unwrapped).__name__
    if identifier:
        entry = getattr(specification, "entry_point", None)
        module = entry.partition(":")[0].partition(".")[0] if isinstance(entry, str) else ""
        registered = identifier if module in ("", "gymnasium") else f"{module}:{identifier}"
        first, make = "    import gymnasium\n", f'lambda: gymnasium.make("{registered}")'
    task = f'Task(name="{name.rpartition(".")[2].lower()}", {field})'
    return f"{first}    from robogate_eval import Environment, Task\n    environment = Environment(make={make}, task={task})"
