"""The sandbox of this process, as Python sees it: it tells which operations the kernel refuses.

The command restricts the process before Python starts (robogate-session/src/isolation). Code can catch the error of a refused
operation; so each one is also written to standard error and kept for the answer to the command.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Callable
from typing import Any

# What the process may do, as JSON: the files and folders that it may `read`, and those that it may also `write`.
RIGHTS = "ROBOGATE_SANDBOX"
# The descriptor of the socket on which the process listens.
LISTENER = "ROBOGATE_LISTENER"
# The most operations that are told.
MOST = 50

refused: list[str] = []


def listener() -> int | None:
    """The descriptor of the socket on which a process in the sandbox listens."""
    return int(os.environ[LISTENER]) if LISTENER in os.environ else None


def watch() -> None:
    """Tell refused operations from now on, if this process is in the sandbox."""
    if RIGHTS in os.environ:
        sys.addaudithook(_hook(json.loads(os.environ[RIGHTS])))


def _hook(rights: dict) -> Callable[[str, tuple], None]:
    writable = tuple(rights["write"])
    readable = (*rights["read"], *writable)
    busy = threading.local()

    def below(path: str, folders: tuple[str, ...]) -> bool:
        return any(path == folder or path.startswith(folder.rstrip("/") + "/") for folder in folders)

    def read(path: Any) -> str | None:
        full = _full(path)
        # A file that does not exist cannot be read outside of the sandbox either.
        return f"read {full}" if full and not below(full, readable) and os.path.lexists(full) else None

    def write(path: Any, *_: Any) -> str | None:
        full = _full(path)
        return f"write {full}" if full and not below(full, (*writable, "/dev/null")) else None

    def opened(path: Any, mode: str | None, flags: int) -> str | None:
        writes = flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
        return write(path) if writes else read(path)

    def process(*_: Any) -> str:
        return "start a process"

    def socket(*_: Any) -> str:
        return "open a socket"

    told = {
        "open": opened,
        "os.listdir": read,
        "os.scandir": read,
        "os.mkdir": write,
        "os.rmdir": write,
        "os.remove": write,
        "os.rename": lambda source, target, *_: write(source) or write(target),
        "os.link": lambda source, target, *_: write(target),
        "os.symlink": lambda source, target, *_: write(target),
        "os.truncate": write,
        "os.chmod": lambda path, *_: f"change the permissions of {_full(path)}",
        "os.chown": lambda path, *_: f"change the owner of {_full(path)}",
        "os.fork": process,
        "os.forkpty": process,
        "os.posix_spawn": process,
        "os.system": process,
        "subprocess.Popen": lambda program, *_: f"start the process {os.fsdecode(program)}",
        "socket.__new__": socket,
        "socket.getaddrinfo": socket,
        "os.kill": lambda number, *_: None if number in (0, os.getpid()) else f"signal the process {number}",
    }

    def hook(event: str, arguments: tuple) -> None:
        tell = told.get(event)
        if tell is None or getattr(busy, "here", False):
            return
        busy.here = True
        try:
            what = tell(*arguments)
            if what is not None and what not in refused and len(refused) < MOST:
                refused.append(what)
                os.write(2, f"sandbox: refused to {what}\n".encode(errors="replace"))
        finally:
            busy.here = False

    return hook


def _full(path: Any) -> str | None:
    """The path without links. None for a descriptor."""
    return os.path.realpath(os.fsdecode(path)) if isinstance(path, (str, bytes, os.PathLike)) else None
