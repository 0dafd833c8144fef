"""Runs a command that never outlives this process, however this process ends."""

import os
import subprocess
import sys
from typing import IO

# The program between this process and the command.
_PROGRAM = os.path.join(os.path.dirname(os.path.abspath(__file__)), "leash_program.py")


def start(command: "list[str]", output: "int | IO[bytes]", errors: "int | IO[bytes]") -> "subprocess.Popen[bytes]":
    """Start a command on a leash that this process holds. Terminating the leash kills the command and its descendants."""
    leash = [sys.executable, "-I", "-S", _PROGRAM, str(os.getpid()), *command]
    return subprocess.Popen(leash, stdin=subprocess.DEVNULL, stdout=output, stderr=errors)
