"""The installed command."""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path


class CommandNotFoundError(RuntimeError):
    """The command `robogate` is not installed."""


def _folders() -> "list[Path]":
    """Folders into which installers put the command: first those that belong to this package, then those of the interpreter."""
    packages = Path(__file__).resolve().parents[1]
    folders = []
    if packages.name in ("site-packages", "dist-packages"):
        # PREFIX/lib/pythonX.Y/site-packages
        folders.append(packages.parents[2] / "bin")
    # pip install --target DIR
    folders.append(packages / "bin")
    folders.append(Path(sysconfig.get_path("scripts")))
    folders.append(Path(sysconfig.get_path("scripts", f"{os.name}_user")))
    return list(dict.fromkeys(folders))


def command() -> Path:
    """Return the path of the command `robogate`.

    Searches the folders into which pip installs commands, then `PATH`. The environment variable `ROBOGATE_COMMAND` overrides both,
    for example with a build from source.

    Raises:
        CommandNotFoundError: No executable file was found.
    """
    named = os.environ.get("ROBOGATE_COMMAND")
    if named:
        if not _executable(Path(named)):
            raise CommandNotFoundError(f"ROBOGATE_COMMAND={named}: not an executable file. Expected the path of the command `robogate`")
        return Path(named)
    folders = _folders()
    for folder in folders:
        if _executable(folder / "robogate"):
            return folder / "robogate"
    found = shutil.which("robogate")
    if found is None:
        raise CommandNotFoundError(
            f"no command `robogate` in {', '.join(map(str, folders))} or in PATH. "
            f"Hint: install it with `{sys.executable} -m pip install --force-reinstall robogate-eval`, or set ROBOGATE_COMMAND"
        )
    return Path(found)


def _executable(file: Path) -> bool:
    return file.is_file() and os.access(file, os.X_OK)


def run_command(*arguments: "str | os.PathLike[str]", **options: object) -> "subprocess.CompletedProcess":
    """Run `robogate` with these arguments; `options` are those of `subprocess.run`.

    The exit code is in `returncode`: 0 done or pass, 1 fail, 2 usage error, 3 inconclusive, 4 invalid evidence, 5 infrastructure
    fault.

    Raises:
        CommandNotFoundError: The command is not installed.
    """
    return subprocess.run([str(command()), *map(os.fspath, arguments)], **options)  # type: ignore[call-overload]
