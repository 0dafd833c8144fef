"""An environment as a simulator of the bridge protocol."""

from __future__ import annotations

import dataclasses
import hashlib
import random
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from robogate_bridge import Action, FreeRun, Image, Problem, Recording

from . import declaration
from .cameras import Cameras
from .disturbances import Disturbances
from .environment import DeclarationError, Environment, innermost
from .foreign import Translated, holds_tensors, plain, translated
from .knobs import Knob, Undoing, differs
from .layers import action_masks
from .model import Model, NoModel
from .motion import Recorder
from .offer import is_bound, offered
from .probe import Probe
from .scoring import Scoring, truth
from .spaces import Observations, actions_of, same
from .starting import STARTS, first_reset
from .timing import control_period, step_limit
from .trajectory import Trajectory, owned


ALREADY = (
    "already successful at the start: the criterion holds before the policy acts. Correct the criterion or the starts, or declare "
    "Task(..., starts_may_succeed=True)"
)

CARRIED = (
    "success in the first control period, where another instance of the environment with the same seed and action has none: an earlier "
    "episode has an effect. Let the reset of the environment set everything that its criterion uses"
)

# First actions that are tried beside those at the ends of their range, where the first action of an episode succeeds.
OTHER_ACTIONS = 5


class Raised(Problem):
    """The environment raised twice in one start, so that this episode is invalid."""


class Adapter:
    """Serves an environment.

    `doing` is called before each call of the environment until it is ready: with `make`, `reset`, `knobs` and `step`.
    """

    def __init__(self, environment: Environment, doing: Callable[[str], None] = lambda _: None, is_twin: bool = False):
        self._environment = environment
        # Another instance, which tries another first action where the first action succeeds at once.
        self._twin: Adapter | None = None
        self._is_twin = is_twin
        self._task = environment.task
        doing("make")
        self._env = env = translated(environment.make())
        self._observations = Observations(env.observation_space)
        self._actions = actions_of(env.action_space, self._task.action_names)
        self._actions.unclipped = environment.unclipped_actions
        rest = np.zeros(len(self._actions.low)) if self._task.rest_action is None else np.asarray(self._task.rest_action)
        # Zeros at a bound or outside the bounds are not a rest position.
        inside = self._actions.zeros_rest and bool((self._actions.low < 0.0).all() and (self._actions.high > 0.0).all())
        known = self._task.rest_action is not None or inside
        lengths = {name: length for name, (_, length) in self._observations.vectors.items()}
        rest = self._actions.decode(rest)
        self._disturbances = Disturbances(lengths, rest if known else None, bool(self._observations.images))
        doing("reset")
        first = first_reset(self._env)
        if not isinstance(first, tuple) or len(first) != 2:
            raise DeclarationError(f"reset returned {_values(first)}. Expected observation and info, as in Gymnasium")
        if holds_tensors(first):
            self._env, first = Translated(env), plain(first)
            env = self._env
        self._observations.check(first[0])
        self._observe = self._find_observe(first[0])
        try:
            self._model: Model | None = Model(env)
        except (NoModel, ImportError):
            self._model = None
        self._period = control_period(env, self._task, self._model, rest, doing)
        self._limit = step_limit(env, self._task, self._period)
        doing("knobs")
        # `dropped`: knobs that do not act, with the reason.
        knobs, self.dropped = offered(environment, env, self._model, self._observations, self._disturbances, self._observe, self._period)
        self._offer(knobs)
        if own := [knob for knob in knobs if self._is_own(knob)]:
            self._undoing.learn(env, own, lambda: first_reset(env))
            if self._model is not None:
                self._model.bind(env)
        self.dropped = [*self.dropped, *self._observations.skipped]
        # Whether a reset of the check below built another model.
        self._changes = False
        # Warnings of the check.
        self.notes: list[str] = []
        self._cameras = Cameras(env, self._model, self._observations, self._task)
        self._scoring = Scoring(self._task)
        # Records the physics of each episode.
        self.probe: Probe | None = None
        # Whether an episode that raised runs a second time now.
        self._repeats = False
        self._hash = 0
        # Whether the actions of the episode come from a policy of this environment.
        self._hosts = False
        self.deterministic = False
        if is_twin:
            return
        for name, policy in environment.policies.items():
            if policy.check is not None:
                try:
                    policy.check(env)
                except ValueError as why:
                    raise DeclarationError(f"the policy {name}: {why}") from None
        try:
            self.deterministic = self._is_deterministic(doing)
            self._require_success(doing)
            if self._model is not None and self._changes:
                why = "each reset builds a model with other bodies or joints"
                self.dropped += [(knob.name, why) for knob in self.knobs if is_bound(knob, environment)]
                self._offer([knob for knob in self.knobs if not is_bound(knob, environment)])
        except Problem as problem:
            # The first episode of any environment shows what its declaration lacks.
            if problem.kind in ("setup", "not_applied"):
                raise DeclarationError(problem.detail) from None
            raise

    def _offer(self, knobs: list[Knob]) -> None:
        self._undoing = Undoing()
        self.knobs = knobs
        self._by_parameter = {knob.parameter: knob for knob in knobs}
        self._order = {knob.parameter: position for position, knob in enumerate(knobs)}

    def hello(self) -> dict:
        environment, model = self._environment, self._model
        name, version = declaration.engine_of(environment, model)
        engine = {"name": name, "version": version, "solver": environment.source or None}
        if model is not None:
            engine["sha256"] = declaration.mujoco_sha256()
        task = declaration.task_declaration(
            self._environment, self._period, self._limit, self.knobs, self._observations, self._cameras, self._actions
        )
        return {
            "server": {"name": "robogate-eval", "version": "1"},
            "engine": engine,
            "task": task,
            "space": declaration.space_declaration(environment, self.knobs, self.dropped, model, self._period),
            "policies": [{"name": name, "meaning": policy.meaning, "version": policy.version} for name, policy in environment.policies.items()],
            "scores_itself": True,
            "deterministic": self.deterministic,
            "records_motion": model is not None,
        }

    # The check before the first episode

    def _find_observe(self, first: Any) -> Callable[[Any], Any] | None:
        """How an observation is taken again after a change: as declared, or with `_get_obs()` if it returns the observation of the
        last reset. With observation wrappers, or with arguments, it does not."""
        if self._environment.observe is not None:
            return self._environment.observe
        if not callable(getattr(innermost(self._env), "_get_obs", None)):
            return None
        try:
            return _get_obs if same(_get_obs(self._env), first) else None
        except Exception:  # any function may have this name
            return None

    def _is_deterministic(self, doing: Callable[[str], None]) -> bool:
        """Run two scenarios twice, one after the other, and compare all states and endings: neither an earlier episode nor the number of
        episodes may have an effect."""

        def repeats() -> bool:
            equal, steps, raised = True, [25, 10], None
            for index in range(1, STARTS + 1):
                try:
                    once = self._states(index, steps[0], doing)
                except Raised as problem:
                    raised = raised or problem
                    continue
                try:
                    equal &= once == self._states(index, steps.pop(0), doing)
                except Raised:
                    equal = False
                if not steps:
                    return equal
            raise raised

        if repeats():
            return True
        if self._model is None:
            return False
        self._model.keep_state()
        return repeats()

    def _states(self, index: int, steps: int, doing: Callable[[str], None]) -> list:
        from robogate_bridge import Scenario

        doing("reset")
        self.reset(Scenario(index=index, seed=0, parameters={}))
        self._changes = self._changes or (self._model is not None and self._model.differs)
        random, states, first = np.random.default_rng(index), [self.state_hash()], self._observed_pictures()
        for _ in range(min(steps, self._limit)):
            numbers = self._random(random)
            doing("step")
            ending = self.step(Action("vector", numbers))["ending"]
            states.append(self.state_hash() if ending is None else ending["failure"])
            if ending is not None:
                break
        self._note_pictures(first, moved=len(set(states)) > 1)
        return states

    def _random(self, generator: np.random.Generator) -> list[float]:
        """A random action, of those that an environment with `action_masks()` allows now."""
        numbers = generator.uniform(self._actions.low, self._actions.high)
        masks = action_masks(self._env)
        allowed = np.flatnonzero(np.asarray(masks(), dtype=bool)) if masks is not None and len(numbers) == 1 else ()
        if len(allowed):
            # The first level lies half a level above the lower bound.
            numbers = self._actions.low + 0.5 + generator.choice(allowed)
        return numbers.tolist()

    def _observed_pictures(self) -> dict[str, np.ndarray]:
        return {name: self._observations.image(self._seen, name).copy() for name in self._observations.images}

    def _note_pictures(self, first: dict[str, np.ndarray], moved: bool) -> None:
        """Note pictures of the observation that show nothing, or that stay the same although the state changes: a policy that sees them is
        blind, and fails for no reason of its own."""
        last = self._observed_pictures()
        for name, picture in first.items():
            if (picture == picture[0, 0]).all():
                what = "shows one colour everywhere"
            elif moved and (picture == last[name]).all():
                what = "stays the same although the state changes"
            else:
                continue
            note = f"the picture {name} of the observation {what}: a policy that sees it is blind. Without a display, set MUJOCO_GL=egl"
            if note not in self.notes:
                self.notes.append(note)

    def _require_success(self, doing: Callable[[str], None]) -> None:
        """Raise if the environment does not report success. Many do so at the end of an episode only, so one is run to its end."""
        if self._scoring.is_known(self._trajectory):
            return
        from robogate_bridge import Scenario

        raised: Raised | None = None
        for index in range(3, 3 + STARTS):
            random, ending = np.random.default_rng(index), None
            try:
                doing("reset")
                self.reset(Scenario(index=index, seed=0, parameters={}))
                while ending is None:
                    doing("step")
                    ending = self.step(Action("vector", self._random(random)))["ending"]
                return
            except Raised as problem:
                raised = raised or problem
        raise raised

    def rehearse(self, doing: Callable[[str], None]) -> None:
        """Run one episode with the first declared policy, otherwise with random actions: so the process imports and opens what any episode
        does. An error is left to the episodes."""
        from robogate_bridge import Scenario

        policy = next(iter(self._environment.policies), None)
        generator = np.random.default_rng(0)
        try:
            doing("reset")
            reply = self.reset(Scenario(index=0, seed=0, parameters={}, policy=policy))
            while reply.get("ending") is None:
                numbers = self._random(generator)
                doing("step")
                reply = self.step(Action("vector", reply.get("proposed", {"action": numbers})["action"]))
        except Exception as error:
            print(f"the episode before the first one ended with {type(error).__name__}: {error}", file=sys.stderr)

    # Episodes

    def reset(self, scenario: Any) -> dict:
        self._scenario, self._sent = scenario, []
        with self._repeating_errors():
            return self._reset(scenario)

    @contextmanager
    def _repeating_errors(self) -> Iterator[None]:
        """Repeat an episode in which the environment or its policy raised, up to the same place. If it raises again, this start
        makes it raise, and only this episode is invalid. Otherwise the error passes on, and the episode runs again later."""
        try:
            yield
        except Problem:
            raise
        except Exception:
            if self._repeats:
                raise
            self._repeats = True
            try:
                sent = self._sent
                self.reset(self._scenario)
                for numbers in sent:
                    self.step(Action("vector", list(numbers)))
            except Problem:
                raise
            except Exception as again:
                raise Raised("setup", f"raised in two tries at this start: {type(again).__name__}: {again}") from again
            finally:
                self._repeats = False
            raise

    def _reset(self, scenario: Any) -> dict:
        requested = [(self._by_parameter[name], value) for name, value in scenario.parameters.items()]
        # The order of the declaration: a mass is set before the inertia that scales with it.
        requested.sort(key=lambda pair: self._order[pair[0].parameter])
        if self._model is not None:
            self._model.before_reset()
        self._disturbances.begin(scenario.seed, scenario.index)
        self._undoing.begin(self._env)
        observation, info = self._started(scenario, requested)
        if self._undoing.kept(self._env):
            observation, info = self._started(scenario, requested)
        if self._model is not None:
            self._model.bind(self._env)
            if self._model.differs and (bound := [knob.name for knob, _ in requested if is_bound(knob, self._environment)]):
                raise Problem("not_applied", f"the reset built a model with other bodies or joints, so {bound[0]} has no meaning")
        for knob, value in requested:
            if not knob.before_reset:
                self._set(knob, value)
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
        observation = owned(observation)
        self._trajectory = Trajectory(self._env, self._period, observations=[observation])
        self._solved = self._scoring.holds_at_start(self._trajectory, info)
        if self._solved and not self._task.starts_may_succeed:
            raise Problem("setup", ALREADY)
        self._recorder = None
        if scenario.record_s is not None and self._model is not None:
            self._recorder = Recorder(self._env, self._model, scenario.record_s)
        if self.probe is not None:
            self.probe.begin(scenario.index, self._model)
        self._policy = None
        self._hosts = scenario.policy is not None
        self._actions.begin()
        if self._hosts:
            self._policy = self._environment.policies[scenario.policy].make(self._env)
        reply = self._reply(observation) | {"applied": applied}
        if self._task.episode_instruction is not None:
            reply["instance"] = {"instruction": self._task.episode_instruction(self._env)}
        return reply

    def _started(self, scenario: Any, requested: list[tuple[Knob, Any]]) -> tuple[Any, dict]:
        for knob, value in requested:
            if knob.before_reset:
                self._set(knob, value)
        _seed_generators(_seed(scenario))
        return self._env.reset(seed=_seed(scenario))

    def _is_own(self, knob: Knob) -> bool:
        return any(knob is one for one in self._environment.knobs)

    def _set(self, knob: Knob, value: Any) -> None:
        # RoboGate's own knobs undo themselves.
        if self._is_own(knob):
            self._undoing.set(knob, self._env, value)
        else:
            knob.set(self._env, value)

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
        if self._disturbances.images.active:
            seen = self._observations.with_images(seen, self._disturbances.images.changed)
        self._seen = seen
        self._hash = self._state()
        reply = {"observation": {"vectors": self._observations.encode(seen)}}
        if self._policy is not None:
            reply["proposed"] = {"action_space": "vector", "action": self._actions.encode(self._policy(seen))}
        return reply

    def step(self, action: Any) -> dict:
        with self._repeating_errors():
            return self._step(action)

    def _step(self, action: Any) -> dict:
        self._sent.append(action.numbers)
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
                self._sent.append(numbers)
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
        except Exception:
            try:
                with self._repeating_errors():
                    raise
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
        plain = bool(self._observations.single) and not self._actions.unclipped
        return self._model is not None and self._policy is not None and plain

    def _advance(self, numbers: "list[float] | np.ndarray") -> tuple[Any, dict | None, dict]:
        """Run one control period. Returns the observation, and the ending with its measures."""
        executed = self._actions.decode(numbers)
        if self._disturbances.delays:
            executed = self._disturbances.delayed(executed)
        try:
            # The environment may change the array that it is given.
            result = self._env.step(owned(executed))
        except Exception as error:
            # dm_control's, by its name: the package may be missing.
            if type(error).__name__ == "PhysicsError":
                raise Problem("diverged", str(error)) from error
            raise
        try:
            observation, reward, terminated, truncated, info = result
        except (TypeError, ValueError):
            hint = ". The package shimmy translates environments of the older gym" if isinstance(result, tuple) and len(result) == 4 else ""
            raise Problem("setup", f"step returned {_values(result)}. Expected observation, reward, terminated, truncated, info{hint}") from None
        trajectory, observation = self._trajectory, owned(observation)
        trajectory.observations.append(observation)
        trajectory.actions.append(executed)
        try:
            trajectory.rewards.append(float(reward))
        except (TypeError, ValueError):
            raise Problem("setup", f"step returned the reward {reward!r:.80}. Expected a number") from None
        if type(info) is not dict and not isinstance(info, Mapping):
            raise Problem("setup", f"step returned the info {info!r:.80}. Expected a dict")
        info = owned(info)
        trajectory.infos.append(info)
        ended, cut = (one if type(one) is bool else truth(one, name, "") for one, name in ((terminated, "terminated"), (truncated, "truncated")))
        trajectory.terminated = ended
        trajectory.over = over = ended or cut or len(trajectory.actions) >= self._limit
        if self._model is not None:
            self._check(self._model)
        if self._recorder is not None:
            self._recorder.advance(trajectory.time_s)
        if self.probe is not None:
            self.probe.take()
        ending, measures = self._scoring.ending(trajectory, info), {}
        if len(trajectory.actions) == 1 and ending is not None and ending["failure"] is None:
            self._look_at_start(numbers)
        if ending is not None or over:
            if self.probe is not None:
                self.probe.end()
            # A policy is not asked for an action that nobody runs.
            self._policy = None
            if self._task.measure is not None:
                measures = dict(self._task.measure(trajectory))
                for name, value in measures.items():
                    if value is not None and not np.isfinite(value):
                        raise Problem("setup", f"the measure {name!r} is {value!r}. Return None for a measure without a value")
            if self._task.starts_may_succeed:
                measures[declaration.SUCCESS_AT_START.name] = float(self._solved)
            if self._hosts:
                measures[declaration.CLIPPED.name] = self._actions.clipped_share()
        return observation, ending, measures

    def _look_at_start(self, numbers: "list[float] | np.ndarray") -> None:
        """Find out whether the criterion also holds after any other first action: then it held before the policy acted, although the reset
        did not say so. One other action may succeed as well where the criterion is wide, so several are tried. Another instance is asked, so that the state of this one stays that of the episode. If it does not
        succeed with the same action, an earlier episode has decided this one."""
        if self._is_twin or self._solved:
            return
        if self._twin is None:
            self._twin = Adapter(self._environment, is_twin=True)
        low, high = self._actions.low, self._actions.high
        other = np.where(np.asarray(numbers) > 0.5 * (low + high), low, high)
        anywhere = np.random.default_rng(0).uniform(low, high, (OTHER_ACTIONS, len(low)))
        self._solved = all(self._twin_succeeds(action) for action in (other, low, high, *anywhere))
        if self._solved and not self._task.starts_may_succeed:
            raise Problem("setup", ALREADY)
        if not self._solved and self.deterministic and not self._twin_succeeds(numbers):
            raise Problem("setup", CARRIED)

    def _twin_succeeds(self, numbers: "list[float] | np.ndarray") -> bool:
        """Whether another instance succeeds in the first control period of this episode with this action."""
        # A scenario of the check before the first episode has no parameters and no policy.
        self._twin._reset(dataclasses.replace(self._scenario, policy=None, record_s=None))
        _, ending, _ = self._twin._advance(list(map(float, numbers)))
        return ending is not None and ending["failure"] is None

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
        if not self._observations.vectors:
            for name in self._observations.images:
                digest.update(self._observations.image(observation, name).tobytes())
        digest.update(np.asarray(self._trajectory.rewards[-1:]).tobytes())
        return int.from_bytes(digest.digest(), "little")

    def render(self, cameras: list[str]) -> list[Image]:
        return self._cameras.render(cameras, self._seen)


def _get_obs(env: Any) -> Any:
    return innermost(env)._get_obs()


def _values(result: Any) -> str:
    return f"{len(result)} values" if isinstance(result, tuple) else f"a {type(result).__name__}"


def _seed_generators(seed: int) -> None:
    """Seed the generators that all code of this process shares. An environment or a policy that draws from them then depends neither
    on earlier episodes nor on the process."""
    random.seed(seed)
    np.random.seed(seed)
    if (torch := sys.modules.get("torch")) is not None:
        torch.manual_seed(seed)


def _seed(scenario: Any) -> int:
    """The seed of an episode, from the seed of the campaign and the index of the episode; below 2^31."""
    digest = hashlib.blake2b(f"{scenario.seed}/{scenario.index}".encode(), digest_size=4).digest()
    return int.from_bytes(digest, "little") >> 1
