"""A Meta-World environment whose resets wait for their turn, for `scripts/environments_overhead.py`.

After each BLOCK episodes a reset tells the script that the block is over, and waits until the script starts the next one. The resets
of the check before the first episode do not count: their seeds are others.
"""

import dataclasses
import os
import socket
import types

from robogate_eval.environments import find
from robogate_eval.serving.adapter import _seed

TASK, BLOCK, ADDRESS = os.environ["TURNS_TASK"], int(os.environ["TURNS_BLOCK"]), os.environ["TURNS_ADDRESS"]
# The seed of the campaign.
SEED = 7


def seed_of(index):
    """The seed of the reset of an episode."""
    return _seed(types.SimpleNamespace(seed=SEED, index=index))


class Turns:
    """The connection of one side to the script."""

    def __init__(self, side):
        self._connection = socket.socket(socket.AF_UNIX)
        self._connection.connect(ADDRESS)
        # The time of the command counts as well.
        processes = [os.getpid(), os.getppid()] if side == "gated" else [os.getpid()]
        self._connection.sendall(f"{side} {' '.join(map(str, processes))}\n".encode())

    def wait(self):
        """Ends a block, and waits for the next one. Returns whether there is one."""
        self._connection.sendall(b".")
        return self._connection.recv(1) == b"."


def make(side="gated"):
    """The environment. The first reset with the seed of episode 0 connects to the script."""
    env = _found.make()
    reset, state = env.reset, {"turns": None, "episodes": 0}

    def waiting(*, seed=None, **options):
        if state["turns"] is None and seed == seed_of(0):
            state["turns"] = Turns(side)
        if state["turns"] is not None:
            if state["episodes"] % BLOCK == 0 and not state["turns"].wait():
                state["turns"] = None
            state["episodes"] += 1
        return reset(seed=seed, **options)

    env.reset = waiting
    return env


_found = find(f"metaworld:{TASK}")
environment = dataclasses.replace(_found, make=make)
