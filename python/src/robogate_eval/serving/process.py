"""The server process: its address, its output, and its end."""

from __future__ import annotations

import ctypes
import gc
import json
import os
import signal
import sys
import threading
import traceback
from pathlib import Path

import robogate_bridge

from .adapter import Adapter
from .environment import Environment
from . import sandbox
from .imported import imported
from .opened import Opened
from .probe import Probe

# Linux: signal that this process gets when the thread that started it ends.
PR_SET_PDEATHSIG = 1


def serve_adapter(environment: Environment, bind: str) -> None:
    """Serve an environment at an address until interrupted."""
    adapter = Adapter(environment)
    _keep()
    robogate_bridge.serve(adapter, bind)


def _keep() -> None:
    """Exclude everything that exists now from garbage collection.

    An episode keeps its observations until it ends, so the collector often looks at all objects, most of which belong to imported
    packages and live as long as the process. That took 2 to 3 % of the time of Meta-World's episodes.
    """
    gc.collect()
    gc.freeze()


def end_with_parent(parent: int) -> None:
    """End this process when the thread that started it ends, if this process is still a child of `parent`. Linux only."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(0)


class Child:
    """This process as a child of the command.

    Its answer is one line on standard output, after lines that say what it is about to do, so that the parent knows what hangs.
    Everything else that is printed goes to standard error. The process ends when its standard input is closed, or when its parent
    ends; then the processes that the environment started end too.
    """

    def __init__(self) -> None:
        end_with_parent(os.getppid())
        # A group of its own, with the processes that the environment starts.
        os.setpgrp()
        # Packages print to standard output when they are imported.
        self._output = os.fdopen(os.dup(1), "w")
        os.dup2(2, 1)
        self._answered = False
        threading.Thread(target=self._end_with_input, daemon=True).start()

    def doing(self, what: str) -> None:
        """Say what this process is about to do: `import`, `make`, `knobs`, `reset` or `step`."""
        print(json.dumps({"doing": what}), file=self._output, flush=True)

    def answer(self, text: str) -> None:
        """Print the answer, one line."""
        self._answered = True
        print(text, file=self._output, flush=True)

    def _end_with_input(self) -> None:
        # The descriptor itself, so that no lock of `sys.stdin` is held when the process ends.
        while os.read(0, 4096):
            pass
        self._tell_where()
        # With the processes that the environment started: they would outlive this one.
        os.killpg(0, signal.SIGKILL)

    def _tell_where(self) -> None:
        """Print what the main thread does, if it works for the parent: it may hang."""
        frame = sys._current_frames().get(threading.main_thread().ident or 0)
        if frame is None:
            return
        working = any(one.f_code is robogate_bridge.Server.answer.__code__ for one, _ in traceback.walk_stack(frame))
        if working or not self._answered:
            # In one piece, because the parent does not wait for long.
            stack = "".join(traceback.format_stack(frame))
            os.write(2, f"It was here when it was ended (most recent call last):\n{stack}".encode())


def serve_child(name: str, policy: str | None = None, first: bool = False, probe: str | None = None) -> None:
    """Serve the environment of this name to the parent process: `robogate run --env`. The answer is its address. `policy` is one to
    load beside its own (`with_policy`). The `first` server of the user's own environment runs one episode before, which shows what
    the environment imports and opens. `probe` is a folder for the physics of the episodes (`Probe`)."""
    from ..environments import own_folder

    child = Child()
    # Ctrl-C reaches all processes of the terminal. The parent finishes its episodes and then closes the standard input.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    folder = own_folder(name)
    opened = Opened(folder) if folder else None
    adapter = child_adapter(child, name, policy)
    if first and folder:
        adapter.rehearse(child.doing)
    if probe is not None:
        adapter.probe = Probe(Path(probe))
    _keep()
    def ready(address: str) -> None:
        child.answer(json.dumps({"listening": address, "refused": sandbox.refused, "notes": adapter.notes} | imported(opened)))

    robogate_bridge.serve(adapter, "tcp://127.0.0.1:*", ready=ready, listener=sandbox.listener())


def child_adapter(child: Child, name: str, policy: str | None = None) -> Adapter:
    """The adapter of the environment of this name."""
    from ..environments import find, with_policy
    from .rendering import choose_library

    choose_library()
    sandbox.watch()
    child.doing("import")
    environment = find(name)
    return Adapter(environment if policy is None else with_policy(environment, policy), child.doing)


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
