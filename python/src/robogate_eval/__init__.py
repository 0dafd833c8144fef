"""RoboGate: deployment gate for robot manipulation policies.

Judge a policy in an environment:

    import robogate_eval as rg

    verdict = rg.gate(make_env, policy)        # a function that makes a gymnasium.Env, and a function or a model
    assert verdict, verdict.because            # true if the verdict is pass

Find where it fails:

    run = rg.run("metaworld:drawer-open-v3", episodes=200)
    run.success_rate, run.interval_95
    run.rows()                                 # one row for each episode (pandas)
    run.figures()                              # names of the figures of its report page
    run.figure("effects-success-rate")         # the data of one, drawn with matplotlib; returns the axes

`load` opens the folder of an earlier run or gate. `Environment` describes an environment that Gymnasium alone cannot describe: its
knobs, cameras, measures and failure modes. `serve` offers one to `robogate run --simulator ADDRESS`, or a policy to `--policy ADDRESS`. `run_command` runs the installed
command `robogate` with any arguments.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robogate_eval._command import CommandNotFoundError, command, run_command

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from robogate_eval.judging import CommandError, gate, run
    from robogate_eval.results import Run, Verdict, load
    from robogate_eval.serving import Camera, Environment, FailureMode, Knob, Measure, Policy, Task, Trajectory

__all__ = [
    "Camera", "CommandError", "CommandNotFoundError", "Environment", "FailureMode", "Knob", "Measure", "Policy", "Run", "Task",
    "Trajectory", "Verdict", "command", "gate", "load", "run", "run_command", "serve",
]

# Names that are imported on demand, and the modules that have them. The process of an environment uses few of them.
_ON_DEMAND = {
    **dict.fromkeys(["CommandError", "gate", "run"], "robogate_eval.judging"),
    **dict.fromkeys(["Run", "Verdict", "load"], "robogate_eval.results"),
    **dict.fromkeys(["Camera", "Environment", "FailureMode", "Knob", "Measure", "Policy", "Task", "Trajectory"], "robogate_eval.serving"),
}


def serve(
    make_env: Any,
    *,
    task: Task | None = None,
    knobs: Sequence[str | Knob] | None = None,
    bind: str | None = None,
    batch: int | None = None,
    metadata: dict[str, Any] | None = None,
) -> None:
    """Serve an environment, or a policy, until interrupted.

    A policy is an object with `predict_batch(observations)` or `infer(observation)`, or, with `batch`, a function of an observation. It
    stands behind a server of openpi's dialect at `bind` (`ws://127.0.0.1:8000`; `*` as the port takes a free one). Requests of several
    episodes are answered together, at most `batch` at once (16), if the policy has `predict_batch`: a list of requests in, a list of
    arrays (actions, numbers) out. An answer must not depend on the other requests; the server checks this and refuses batches otherwise.
    `metadata` is what the server says about the policy. Needs `pip install robogate-eval[policies]`.

    An environment is a simulator that scores itself.

    `make_env` makes a `gymnasium.Env`, or is an `Environment`. `task` and `knobs` replace those of the environment. Prints the
    address as one line of JSON; `bind` is `tcp://127.0.0.1:5570`, and `*` takes a free port. Then `robogate run --simulator ADDRESS` runs
    it.
    """
    from robogate_eval.policy_server import is_policy, serve_policy

    if batch is not None or is_policy(make_env):
        if batch is not None and batch < 1:
            raise ValueError(f"batch={batch}: expected at least 1")
        return serve_policy(make_env, bind or "ws://127.0.0.1:8000", batch or 16, metadata)
    import dataclasses

    from robogate_eval.serving.environment import as_environment
    from robogate_eval.serving.process import serve_adapter

    environment = as_environment(make_env, getattr(make_env, "__name__", "environment"))
    changes = {key: value for key, value in (("task", task), ("knobs", knobs)) if value is not None}
    return serve_adapter(dataclasses.replace(environment, **changes), bind or "tcp://127.0.0.1:5570")


def __dir__() -> list[str]:
    return sorted({*globals(), *_ON_DEMAND})


def __getattr__(name: str) -> Any:
    if name in _ON_DEMAND:
        from importlib import import_module

        return getattr(import_module(_ON_DEMAND[name]), name)
    # Reading metadata takes longer than importing this package, so it is done on demand.
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("robogate-eval")
        except PackageNotFoundError as error:
            raise AttributeError("robogate-eval is not installed, so its version is unknown") from error
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
