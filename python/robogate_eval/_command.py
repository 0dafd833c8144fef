"""The installed command."""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path


class CommandNotFoundError(RuntimeError):
    """The command `robogate` is not installed."""


def command() -> Path:
    """Return the path of the command `robogate`.

    Searches the folders into which pip installs commands for this interpreter, then `PATH`. `ROBOGATE_COMMAND` overrides both, for
    example with a build from source.

    Raises:
        CommandNotFoundError: No such file exists.
    """
    named = os.environ.get("ROBOGATE_COMMAND")
    if named:
        if not os.access(named, os.X_OK):
            raise CommandNotFoundError(f"ROBOGATE_COMMAND={named}: not an executable file")
        return Path(named)
    folders = [sysconfig.get_path("scripts"), sysconfig.get_path("scripts", f"{os.name}_user")]
    # pip install --target DIR puts commands into DIR/bin, beside this package.
    folders.append(str(Path(__file__).resolve().parents[1] / "bin"))
    for folder in folders:
        file = Path(folder) / "robogate"
        if os.access(file, os.X_OK):
            return file
    found = shutil.which("robogate")
    if found is None:
        raise CommandNotFoundError(
            f"no command `robogate` in {', '.join(folders)} or in PATH. Reinstall with `{sys.executable} -m pip install "
            "--force-reinstall robogate-eval`"
        )
    return Path(found)


def run_command(*arguments: "str | os.PathLike[str]", **options: object) -> "subprocess.CompletedProcess":
    """Run `robogate` with these arguments; `options` are those of `subprocess.run`.

    The exit code is in `returncode`: 0 done or pass, 1 fail, 2 usage error, 3 inconclusive, 4 invalid evidence, 5 infrastructure
    fault.
    """
    return subprocess.run([str(command()), *map(os.fspath, arguments)], **options)  # type: ignore[call-overload]
