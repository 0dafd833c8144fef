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
knobs, cameras, measures and failure modes. `serve` offers one to `robogate run --simulator ADDRESS`. `run_command` runs the installed
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
    make_env: Callable[[], Any] | Environment,
    *,
    task: Task | None = None,
    knobs: Sequence[str | Knob] | None = None,
    bind: str = "tcp://127.0.0.1:5570",
) -> None:
    """Serve an environment until interrupted, as a simulator that scores itself.

    `make_env` makes a `gymnasium.Env`, or is an `Environment`. `task` and `knobs` replace those of the environment. Prints the
    address as one line of JSON; `tcp://127.0.0.1:*` takes a free port. Then `robogate run --simulator ADDRESS` runs it.
    """
    import dataclasses

    from robogate_eval.serving.environment import as_environment
    from robogate_eval.serving.process import serve_adapter

    environment = as_environment(make_env, getattr(make_env, "__name__", "environment"))
    changes = {key: value for key, value in (("task", task), ("knobs", knobs)) if value is not None}
    serve_adapter(dataclasses.replace(environment, **changes), bind)


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
