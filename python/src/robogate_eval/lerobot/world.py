"""LeRobot's own environments, made as its evaluation makes them."""

from __future__ import annotations

import dataclasses
from typing import Any

from ..environments.family import UnknownEnvironment, arguments, installed, unknown, widened
from ..serving.environment import Environment, Task, task_name


def environment(name: str) -> Environment:
    """The environment `TYPE`, `TYPE/TASK` or `TYPE/TASK/NUMBER`, with `?key=value&...` for fields of LeRobot's configuration."""
    from lerobot.envs import factory
    from lerobot.envs.configs import EnvConfig

    register_plugins()
    path, _, query = name.partition("?")
    kind, _, task = path.partition("/")
    number = None
    if task.rpartition("/")[2].isdecimal():
        task, _, last = task.rpartition("/")
        number = int(last)
    known = EnvConfig.get_known_choices()
    if kind not in known:
        raise unknown("environment", kind, sorted(known), "lerobot:")
    try:
        fields = arguments(query, {field.name for field in dataclasses.fields(known[kind])}) | ({"task": task} if task else {})
    except ValueError as why:
        raise UnknownEnvironment(f"lerobot:{name}: {why}") from None
    config = factory.make_env_config(kind, **fields)
    if getattr(config, "hub_path", None) is not None:
        raise UnknownEnvironment(f"lerobot:{name}: this environment downloads its code. Download it, and name its file with --env FILE.py")
    made = [World(config, number)]
    first = made[0]
    limit = first.max_episode_steps
    return Environment(
        make=lambda: made.pop() if made else World(config, number),
        task=Task(
            name=task_name(".".join(["lerobot", *filter(None, (kind, first.suite, None if number is None else str(number)))])),
            instruction=first.instruction,
            control_period_s=1.0 / config.fps,
            time_limit_s=None if limit is None else limit / config.fps,
            episode_instruction=lambda env: env.instruction,
        ),
        # LeRobot's evaluation clips nothing.
        unclipped_actions=True,
        source=installed("lerobot"),
    )


def register_plugins() -> None:
    """Let packages of others (`lerobot_env_...`, `lerobot_policy_...`) register what they add, as LeRobot's programs do."""
    try:
        from lerobot.utils.import_utils import register_third_party_plugins
    except ImportError:  # older versions have none
        return
    register_third_party_plugins()


class World:
    """One of LeRobot's environments, alone and not in a vector. Its start follows from the seed of `reset`."""

    def __init__(self, config: Any, number: int | None):
        from lerobot.envs import utils
        from lerobot.envs.factory import make_env

        option = getattr(utils, "NEW_ROLLOUT_OPTION", None)
        self._new_episode = {} if option is None else {option: True}
        self.lerobot_config = config
        suites = make_env(config, n_envs=1)
        # Older versions return the vector itself.
        tasks = suites if isinstance(suites, dict) else {config.type: {0: suites}}
        self.suite = str(config.task or next(iter(tasks)))
        numbers = next(iter(tasks.values()))
        if number is not None and number not in numbers:
            raise UnknownEnvironment(f"lerobot:{config.type}/{config.task}/{number}: unknown task. Expected 0 to {max(numbers)}")
        chosen = numbers[min(numbers) if number is None else number]
        self.env = widened(chosen.envs[0])
        self.action_space, self.observation_space = self.env.action_space, self.env.observation_space
        self.metadata, self.render_mode = self.env.metadata, self.env.render_mode
        self.spec = getattr(self.env, "spec", None)

    @property
    def unwrapped(self) -> Any:
        return self.env.unwrapped

    @property
    def max_episode_steps(self) -> int | None:
        """The number of control periods after which LeRobot ends an episode."""
        spec = getattr(self.spec, "max_episode_steps", None)
        return spec or getattr(self.unwrapped, "_max_episode_steps", None)

    @property
    def instruction(self) -> str:
        """What a policy is told, as LeRobot's evaluation finds it."""
        for name in ("task_description", "task"):
            if isinstance(text := getattr(self.unwrapped, name, None), str):
                return text
        return ""

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict]:
        base = self.unwrapped
        if hasattr(base, "init_state_id"):
            # LIBERO: each reset takes the next initial state, so a start would depend on the number of earlier episodes.
            base.init_state_id = 0 if seed is None else seed
        # What LeRobot passes at the start of an episode: its wrapper repeats the last observation of the episode before otherwise.
        return self.env.reset(seed=seed, options={**(options or {}), **self._new_episode} or None)

    def step(self, action: Any) -> tuple:
        return self.env.step(action)

    def render(self) -> Any:
        return self.env.render()

    def close(self) -> None:
        self.env.close()
