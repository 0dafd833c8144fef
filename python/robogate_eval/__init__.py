"""RoboGate: deployment gate for robot manipulation policies."""

from robogate_eval._command import CommandNotFoundError, command, run_command

__all__ = ["CommandNotFoundError", "__version__", "command", "run_command"]


def __getattr__(name: str) -> str:
    # Reading metadata takes longer than importing this package, so it is done on demand.
    if name == "__version__":
        from importlib.metadata import version

        return version("robogate-eval")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
