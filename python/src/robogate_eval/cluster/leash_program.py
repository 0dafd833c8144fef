"""The program of a leash: runs a command that never outlives the parent of this process, however the parent ends.

Usage: python -I -S leash_program.py PARENT COMMAND [ARGUMENTS...]

PARENT is the process id of the parent. When the parent dies, also by SIGKILL, the command and all its descendants are killed. Their
orphans become children of this process (PR_SET_CHILD_SUBREAPER), so that descendants in other process groups are found too. Two
processes do this work, one the parent of the other: if one of them is killed, the other one kills all descendants. Needs Linux.

Every process with shards starts this program, so it imports as little as possible: with `subprocess`, `pathlib` and `typing` it took
45 ms of processor time instead of 16 ms.
"""

import ctypes
import os
import signal
import sys

# <linux/prctl.h>
PR_SET_PDEATHSIG = 1
PR_SET_CHILD_SUBREAPER = 36

# How often the leash checks that its parent is alive, in seconds. The signal of the kernel arrives at once; the check finds a parent
# that died before the signal was requested.
CHECK_S = 1.0


def _prctl(option: int, value: int) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(option, ctypes.c_ulong(value), 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl")


def _children() -> "list[int]":
    """The children of this process."""
    found = []
    for name in os.listdir("/proc"):
        if name.isdigit():
            try:
                with open(f"/proc/{name}/stat", errors="replace") as file:
                    # The name of the command is in parentheses and may contain any character.
                    fields = file.read().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[1]) == os.getpid():
                found.append(int(name))
    return found


def _kill_descendants() -> None:
    """Kills all descendants. The children of a killed process become children of this process."""
    while children := _children():
        for child in children:
            try:
                os.kill(child, signal.SIGKILL)
            except ProcessLookupError:
                pass
        for child in children:
            try:
                os.waitpid(child, 0)
            except ChildProcessError:
                pass


def _become(command: "list[str]", unblocked: "set[signal.Signals]") -> None:
    """Turns this new process into the command. Ends it if that is not possible."""
    try:
        _prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, unblocked)
        # Python ignores these signals. A command expects their defaults.
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)
        signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
        os.execvp(command[0], command)
    except OSError as error:
        os.write(2, f"error: cannot start {command[0]}: {error.strerror}\n".encode(errors="replace"))
    finally:
        os._exit(127)


def _hold_inside(parent: int, command: "list[str]") -> None:
    """Turns this new process into the second process of the leash, and ends with it."""
    code = 128 + signal.SIGTERM
    try:
        code = run(parent, command, inside=True)
    except OSError as error:
        os.write(2, f"error: cannot supervise {command[0]}: {error.strerror}\n".encode(errors="replace"))
    finally:
        os._exit(code)


def run(parent: int, command: "list[str]", inside: bool = False) -> int:
    """Run a command until it ends or the parent dies. Returns its exit code, or 128 plus the number of its signal.

    `inside` is for the second process of the leash, which starts the command.
    """
    ended = {signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGCHLD}
    # Blocked signals wait until sigtimedwait takes them.
    signal.pthread_sigmask(signal.SIG_BLOCK, ended)
    # The parent may ignore it. The kernel would then keep no exit status of a child.
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    _prctl(PR_SET_CHILD_SUBREAPER, 1)
    _prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:
        return 128 + signal.SIGTERM
    this = os.getpid()
    # This process has one thread, so code may run between fork and exec.
    child = os.fork()
    if child == 0:
        if not inside:
            _hold_inside(this, command)
        _become(command, ended)
    while True:
        info = signal.sigtimedwait(ended, CHECK_S)
        code = _reap(child)
        if code is not None:
            _kill_descendants()
            return code
        if os.getppid() != parent or (info and info.si_signo != signal.SIGCHLD):
            _kill_descendants()
            return 128 + signal.SIGTERM


def _reap(child: int) -> "int | None":
    """Takes the exit status of all processes that have ended. Returns the exit code of `child` if it is among them."""
    code = None
    while True:
        try:
            process, status = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return code
        if process == 0:
            return code
        if process == child:
            code = os.WEXITSTATUS(status) if os.WIFEXITED(status) else 128 + os.WTERMSIG(status)


if __name__ == "__main__":
    sys.exit(run(int(sys.argv[1]), sys.argv[2:]))
