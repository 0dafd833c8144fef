"""RoboGate: deployment gate for robot manipulation policies."""

from robogate_eval._command import CommandNotFoundError, command, run_command

__all__ = ["CommandNotFoundError", "__version__", "command", "run_command"]


# Names that need the packages of an environment, and the modules that have them.
_ON_DEMAND = {
    "serve": "robogate_eval.serving.process",
    **dict.fromkeys(["CommandError", "gate", "run"], "robogate_eval.judging"),
    **dict.fromkeys(["Run", "Verdict", "load"], "robogate_eval.results"),
    **dict.fromkeys(["Camera", "Environment", "FailureMode", "Knob", "Measure", "Policy", "Task", "Trajectory"], "robogate_eval.serving"),
}


def __getattr__(name: str) -> object:
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
