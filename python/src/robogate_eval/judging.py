"""`run` and `gate`: judge a policy in an environment from Python."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from . import notebook
from ._command import run_command
from .policies import as_function, is_model_file, load
from .results import Run, Verdict

# Exit codes of the command after which there is a result: done or pass, fail, inconclusive, invalid evidence.
WITH_RESULT = (0, 1, 3, 4)


class CommandError(RuntimeError):
    """The command ended without a result. Its output has the reason."""

    def __init__(self, code: int):
        super().__init__(f"robogate ended with exit code {code} and without a result; its message is above")
        self.code = code


def run(env: Any, policy: Any = None, *, episodes: int | None = None, out: "str | Path | None" = None, **options: Any) -> Run:
    """Run a campaign and return its result.

    `env` is the name of an environment, an `Environment`, or a function that makes a `gymnasium.Env`. `policy` is

    - a function from an observation of the environment to an action;
    - a model of Stable-Baselines3 or sb3_contrib; `"sb3:PATH"` for its `.zip` file or a folder of RL Baselines3 Zoo, with
      `vecnormalize.pkl` beside it; anything with `predict`;
    - a policy of LeRobot, or `"lerobot:PATH"` for its checkpoint folder. In an environment of LeRobot it sees what LeRobot's own
      evaluation shows it. Elsewhere its inputs are found by name in a Dict observation: `observation.state` is `state`;
    - the name of a policy that the environment declares, or `"random"`;
    - the address of a policy server or an ONNX file, with `profile=...`, and `map=...` for the map between the environment and the
      profile: paths of TOML files, names of built-in profiles, or the same tables as dicts;
    - None for the environment's own policy.

    A function or a model runs in this process, one episode at a time; with `in_flight=16`, 16 episodes run at once in processes of
    their own, and the policy answers their requests together in this one. It needs `predict_batch(observations)` (a list of arrays of
    actions, all of which are executed before the next request), or is a model of Stable-Baselines3 or LeRobot that keeps nothing
    between its actions. An answer in a batch must not differ from the answer alone; this is checked and recorded. Anything else runs in processes of the command, one for each
    core or for each of `threads`. `episodes` is their number, and `out` the folder of the result; without one it is a new folder
    below the temporary folder, in a notebook below `runs` beside it. Further `options` are those of `robogate run`: `seed=7` is
    `--seed 7`, and `twins=True` is `--twins`.

    Raises:
        CommandError: There is no result.
    """
    with _folder(out, "run") as folder:
        _judge("run", env, policy, folder, {"n": episodes, **options})
    return Run(folder)


def gate(env: Any, policy: Any = None, *, requirements: "str | Path | None" = None, out: "str | Path | None" = None, **options: Any) -> Verdict:
    """Decide whether a policy may run.

    `env` and `policy` are those of `run`. `requirements` is the path of a TOML file; the default requires a success rate. Further
    `options` are those of `robogate gate`: `rounds=30`, `seed=7`. In a notebook a progress bar replaces the output.

    Raises:
        CommandError: There is no verdict.
    """
    with _folder(out, "gate") as folder:
        _judge("gate", env, policy, folder, {"requirements": requirements, **options})
    return Verdict(folder)


@contextmanager
def _folder(out: "str | Path | None", verb: str) -> Iterator[Path]:
    """The folder of the result. Without a name, a new one that no other program removes. It does not stay if nothing was written."""
    if out is not None:
        yield Path(out)
        return
    # A notebook has its results beside it.
    beside = Path("runs") if notebook.in_notebook() else None
    if beside is not None:
        beside.mkdir(exist_ok=True)
    parent = Path(tempfile.mkdtemp(prefix=f"robogate-{verb}-", dir=beside))
    try:
        yield parent / verb
    except BaseException:
        # A folder with episodes is not empty, and stays.
        with suppress(OSError):
            parent.rmdir()
        raise


def _judge(verb: str, env: Any, policy: Any, out: Path, options: dict[str, Any]) -> None:
    if is_model_file(policy):
        policy = load(policy)
    with _tables_as_files(options) as options:
        _command(env, policy, options, [verb, "--out", str(out), *_options(options)])


def _command(env: Any, policy: Any, options: dict[str, Any], arguments: list[str]) -> None:
    if isinstance(env, str) and (policy is None or isinstance(policy, (str, os.PathLike))):
        interpreter = [] if "python" in options else ["--python", sys.executable]
        code = _run(*arguments, "--env", env, *interpreter, *_named(policy))
    else:
        # The command then proposes calls from Python, because no command line reaches an environment in this process.
        with _served(env, policy, options.get("in_flight")) as (address, chosen), _set("ROBOGATE_CALLED_FROM_PYTHON"):
            code = _run(*arguments, "--simulator", address, *_named(chosen))
    if code not in WITH_RESULT:
        raise CommandError(code)


@contextmanager
def _set(name: str) -> Iterator[None]:
    os.environ[name] = "1"
    try:
        yield
    finally:
        os.environ.pop(name, None)


def _run(*arguments: str) -> int:
    if notebook.in_notebook():
        return notebook.run(*arguments, results=WITH_RESULT)
    return run_command(*arguments).returncode


@contextmanager
def _tables_as_files(options: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The options, with a TOML file for each dict."""
    with tempfile.TemporaryDirectory(prefix="robogate-") as folder:
        named = dict(options)
        for name, value in options.items():
            if isinstance(value, Mapping):
                named[name] = Path(folder) / f"{name}.toml"
                named[name].write_text("".join(f"{json.dumps(key)} = {_toml(one)}\n" for key, one in value.items()), encoding="utf-8")
        yield named


def _toml(value: Any) -> str:
    """A value in TOML."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{json.dumps(str(key))} = {_toml(one)}" for key, one in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_toml, value)) + "]"
    # Strings, numbers and truth values are written as in JSON.
    return json.dumps(value)


def _named(policy: Any) -> list[str]:
    return [] if policy is None else ["--policy", os.fspath(policy)]


def _options(options: dict[str, Any]) -> list[str]:
    out = []
    for name, value in options.items():
        flag = f"-{name}" if len(name) == 1 else f"--{name.replace('_', '-')}"
        if value is True:
            out.append(flag)
        elif value is not None and value is not False:
            out += [flag, str(value)]
    return out


@contextmanager
def _served(env: Any, policy: Any, in_flight: "int | None" = None) -> Iterator[tuple[str, Any]]:
    """Serve an environment in a thread of this process, or in so many processes. Gives the address or addresses, and the name of the
    policy."""
    import dataclasses

    from robogate_bridge import Scenario

    from .environments import find
    from .serving.adapter import Adapter
    from .serving.environment import Policy, as_environment
    from .serving.process import Background

    environment = find(env) if isinstance(env, str) else as_environment(env, getattr(env, "__name__", "environment"))
    chosen = policy
    if policy is not None and not isinstance(policy, (str, os.PathLike)):
        chosen = _name(policy)
        if in_flight is not None and in_flight > 1:
            from .in_flight import served

            with served(environment, chosen, policy, in_flight) as addresses:
                yield ",".join(addresses), chosen
            return
        own = Policy(lambda env: as_function(policy, env), f"{type(policy).__name__} of the calling process.")
        environment = dataclasses.replace(environment, policies={**environment.policies, chosen: own})
    adapter = Adapter(environment)
    if chosen in environment.policies:
        # A policy that does not fit the observations raises here, and not in each episode.
        adapter.reset(Scenario(index=0, seed=0, parameters={}, policy=chosen))
    with Background(adapter) as address:
        yield address, chosen


def _name(policy: Any) -> str:
    name = getattr(policy, "__name__", type(policy).__name__)
    cleaned = "".join(c for c in name if c.isascii() and (c.isalnum() or c in "_-"))[:64] or "policy"
    # These names mean other policies.
    return f"own-{cleaned}" if cleaned in ("random", "scripted") else cleaned
