"""The remote functions and actors of `robogate_eval.ray`. Ray imports this module on every node."""

import os
import shlex
import socket
import subprocess
import tempfile
import time
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit, urlunsplit

import ray

from robogate_eval.cluster import leash, shards

# How long a server may take to accept connections, in seconds: models are large.
START_S = 600.0
# How much of the output of a failed server is shown, in bytes.
TAIL = 2000


class ServerError(Exception):
    """A server of environments or policies did not start."""


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def enter(folder: str) -> str:
    """Change to the folder of the driver, so that relative paths mean the same on all nodes. Returns a hint if that is not possible."""
    try:
        os.chdir(folder)
    except OSError as error:
        return (
            f"\nHint: this node cannot use {folder}, the folder in which robogate-ray was started ({error.strerror}). "
            "Relative paths need it: share the folder with all nodes, or use absolute paths"
        )
    return ""


def _accepts(port: int) -> bool:
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=1.0):
            return True
    except OSError:
        return False


@ray.remote(max_restarts=-1, max_task_retries=-1)
class Server:
    """A server of environments or policies in a process that dies with this actor."""

    def __init__(self, command: str, folder: str) -> None:
        """`command` contains `{port}`: the port on 127.0.0.1 where the server must listen. `folder` is that of the driver."""
        self._command = command
        self._hint = enter(folder)
        self._process: "subprocess.Popen[bytes] | None" = None
        self._output = tempfile.TemporaryFile()  # noqa: SIM115 - open as long as the actor lives
        self._port = 0

    def port(self) -> int:
        """Start the server unless it runs. Returns its port."""
        if self._process is None or self._process.poll() is not None:
            self._start()
        return self._port

    def process(self) -> int:
        """The id of the server's process."""
        self.port()
        assert self._process is not None
        return self._process.pid

    def _start(self) -> None:
        self._port = _free_port()
        words = [word.replace("{port}", str(self._port)) for word in shlex.split(self._command)]
        self._output.seek(0)
        self._output.truncate()
        self._process = leash.start(words, self._output, self._output)
        deadline = time.monotonic() + START_S
        while True:
            accepted = _accepts(self._port)
            code = self._process.poll()
            # Another server may have taken the port. The own one then ends.
            if code is not None:
                raise ServerError(f"`{shlex.join(words)}` ended with exit code {code}: {self._tail()}{self._hint}")
            if accepted:
                return
            if time.monotonic() > deadline:
                self._process.terminate()
                raise ServerError(f"`{shlex.join(words)}` accepts no connections after {START_S:.0f} s: {self._tail()}")
            time.sleep(0.1)

    def _tail(self) -> str:
        self._output.seek(0, os.SEEK_END)
        self._output.seek(max(0, self._output.tell() - TAIL))
        return self._output.read().decode(errors="replace").strip() or "no output"


@dataclass(frozen=True)
class Servers:
    """The servers that a shard uses."""

    simulator: Any = None
    policy: Any = None
    # The recorded address of the policy.
    policy_address: str = ""

    def arguments(self) -> "list[str]":
        """The arguments of `robogate run` that name these servers. Starts servers that are down."""
        arguments = []
        if self.simulator is not None:
            arguments += ["--simulator", f"tcp://127.0.0.1:{ray.get(self.simulator.port.remote())}"]
        if self.policy is not None:
            port = ray.get(self.policy.port.remote())
            recorded = urlsplit(self.policy_address)
            arguments += ["--policy-at", urlunsplit(recorded._replace(netloc=f"127.0.0.1:{port}"))]
        return arguments


@dataclass(frozen=True)
class Attempt:
    """The end of one call of `robogate` on a node."""

    node: str
    code: int
    reason: str
    # The JSON documents of the command, in order.
    documents: "list[dict[str, Any]]" = field(default_factory=list)


@ray.remote(max_retries=0)
def run(arguments: "list[str]", servers: Servers, folder: str) -> Attempt:
    """Run `robogate` with these arguments and servers in the folder of the driver. The driver decides whether to retry."""
    node = ray.util.get_node_ip_address()
    hint = enter(folder)
    result = shards.call([*arguments, *servers.arguments()])
    # A file that is not found is an error of usage.
    reason = result.reason + (hint if result.code == shards.USAGE else "")
    return Attempt(node, result.code, reason, result.documents)
