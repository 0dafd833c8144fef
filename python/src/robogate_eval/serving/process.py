"""The server process: its address, its output, and its end."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Any, TextIO

import robogate_bridge

from .adapter import Adapter
from .environment import Environment, Task, as_environment
from .knobs import Knob

# Linux: signal that this process gets when the thread that started it ends.
PR_SET_PDEATHSIG = 1


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

    environment = as_environment(make_env, getattr(make_env, "__name__", "environment"))
    changes = {key: value for key, value in (("task", task), ("knobs", knobs)) if value is not None}
    robogate_bridge.serve(Adapter(dataclasses.replace(environment, **changes)), bind)


def serve_child(load: Callable[[], Environment]) -> None:
    """Serve an environment to the parent process: `robogate run --env`.

    The address is one line of JSON on standard output. Everything else that is printed goes to standard error. The process ends
    when its standard input is closed, or when its parent ends.
    """
    parent = os.getppid()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(0)
    # Ctrl-C reaches all processes of the terminal. The parent finishes its episodes and then closes the standard input.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_input, daemon=True).start()
    # Packages print to standard output when they are imported.
    answer = own_output()
    environment = load()
    adapter = Adapter(environment)

    def ready(address: str) -> None:
        print(json.dumps({"listening": address}), file=answer, flush=True)

    robogate_bridge.serve(adapter, "tcp://127.0.0.1:*", ready=ready)


class Background:
    """Serves an environment in a thread of this process, on a free port of the loopback interface."""

    def __init__(self, adapter: Adapter):
        self._server = robogate_bridge.Server(adapter)
        self._stop = threading.Event()

    def __enter__(self) -> str:
        """Start. Returns the address."""
        import zmq

        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.REP)
        self._socket.setsockopt(zmq.LINGER, 0)
        port = self._socket.bind_to_random_port("tcp://127.0.0.1")
        self._thread = threading.Thread(target=self._answer, daemon=True)
        self._thread.start()
        return f"tcp://127.0.0.1:{port}"

    def _answer(self) -> None:
        while not self._stop.is_set():
            if self._socket.poll(100):
                self._socket.send_multipart(self._server.answer(self._socket.recv_multipart()), copy=False)

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._socket.close()
        self._context.term()


def own_output() -> TextIO:
    """Take the standard output for this process's own answers. Everything else that is printed goes to standard error."""
    answer = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    return answer


def _end_with_input() -> None:
    # The descriptor itself, so that no lock of `sys.stdin` is held when the process ends.
    while os.read(0, 4096):
        pass
    os._exit(0)
