"""RoboGate: deployment gate for robot manipulation policies."""

from robogate_eval._command import CommandNotFoundError, command, run_command

__all__ = ["CommandNotFoundError", "__version__", "command", "run_command"]


def __getattr__(name: str) -> str:
    # Reading metadata takes longer than importing this package, so it is done on demand.
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("robogate-eval")
        except PackageNotFoundError as error:
            raise AttributeError("robogate-eval is not installed, so its version is unknown") from error
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
