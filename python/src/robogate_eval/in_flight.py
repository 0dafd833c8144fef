"""Episodes in several processes at once, whose policy answers their requests together in this process.

Each process has an environment, and asks for actions through a pipe. What a policy does to one observation alone (normalisation, the time
feature) runs there too; what it computes for several runs here, in the `Batcher` that `serve` has.
"""

from __future__ import annotations

import contextlib
import dataclasses
import multiprocessing
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from .policies import as_function, batched
from .policy_server import Batcher

# What a process says beside its requests.
READY, LISTENING, FAILED = "ready", "listening", "failed"


@contextlib.contextmanager
def served(environment: Any, name: str, policy: Any, in_flight: int) -> Iterator[list[str]]:
    """Serve an environment in so many processes with this policy under this name. Gives their addresses.

    Raises:
        ValueError: The policy cannot answer several requests together, or its answers to one request vary.
    """
    answer = batched(policy)
    if answer is None:
        raise ValueError(
            f"in_flight={in_flight}: {type(policy).__name__} answers one request at a time. Expected an object with "
            "predict_batch(observations), a model of Stable-Baselines3 without memory and masks, or a policy of LeRobot with "
            "predict_action_chunk and one observation"
        )
    if "fork" not in multiprocessing.get_all_start_methods():
        raise ValueError(f"in_flight={in_flight}: this system cannot fork processes. Hint: put the policy behind a server with `serve`")
    fork = multiprocessing.get_context("fork")
    pipes, processes = [], []
    for number in range(in_flight):
        ours, theirs = fork.Pipe()
        # A process would keep the pipes of the others open.
        inherited = [ours, *pipes]
        process = fork.Process(target=_serve, args=(environment, name, policy, number, theirs, inherited))
        process.start()
        theirs.close()
        pipes.append(ours)
        processes.append(process)
    try:
        batcher = Batcher(answer, in_flight)
        first = [_received(pipe) for pipe in pipes]
        note = batcher.compare(first)
        if batcher.varies:
            raise ValueError(
                f"in_flight={in_flight}: {note}, and an episode must repeat. Hint: leave out in_flight, or make the policy repeatable"
            )
        for pipe, observation in zip(pipes, first):
            pipe.send(_answer(batcher, observation))
        addresses = []
        for pipe in pipes:
            _received(pipe)
            # A run records it as the version of the policy.
            pipe.send(note)
            addresses.append(_received(pipe))
        began = time.monotonic()
        for pipe in pipes:
            threading.Thread(target=_answer_all, args=(batcher, pipe), daemon=True).start()
        yield addresses
        print(batcher.summary(time.monotonic() - began), file=sys.stderr)
    finally:
        for process in processes:
            process.kill()
        for process in processes:
            process.join()


def _received(pipe: Any) -> Any:
    """The next message of a process. Raises what the process raised."""
    try:
        kind, value = pipe.recv()
    except EOFError:
        raise RuntimeError("a process of the environment has ended; its output is above") from None
    if kind == FAILED:
        raise value
    return value


def _answer(batcher: Batcher, observation: Any) -> tuple[bool, Any]:
    try:
        return True, batcher.ask(observation)[0]
    except Exception as error:
        return False, f"{type(error).__name__}: {error}"


def _answer_all(batcher: Batcher, pipe: Any) -> None:
    with contextlib.suppress(EOFError, OSError), batcher.episode():
        while True:
            pipe.send(_answer(batcher, pipe.recv()[1]))


def _serve(environment: Any, name: str, policy: Any, number: int, pipe: Any, inherited: list[Any]) -> None:
    """Serve an environment in this process until it is ended."""
    import robogate_bridge
    from robogate_bridge import Scenario

    from .serving.adapter import Adapter
    from .serving.environment import Policy
    from .serving.process import end_with_parent

    end_with_parent(multiprocessing.parent_process().pid)
    # The command ends the episodes; then the parent ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for other in inherited:
        other.close()

    def ask(observation: Any) -> Any:
        pipe.send((None, observation))
        answered, value = pipe.recv()
        if not answered:
            raise RuntimeError(f"the policy raised {value}")
        return value

    def declared(version: str) -> Policy:
        return Policy(lambda env: as_function(policy, env, ask), f"{type(policy).__name__} of the calling process.", version)

    try:
        policies = {**environment.policies, name: declared("")}
        adapter = Adapter(dataclasses.replace(environment, policies=policies))
        # A policy that does not fit the observations raises here, and not in each episode. Other starts, so that requests differ.
        adapter.reset(Scenario(index=number, seed=number, parameters={}, policy=name))
        pipe.send((READY, None))
        policies[name] = declared(pipe.recv())
        robogate_bridge.serve(adapter, "tcp://127.0.0.1:*", ready=lambda address: pipe.send((LISTENING, address)))
    except Exception as error:
        pipe.send((FAILED, _plain(error)))


def _plain(error: Exception) -> Exception:
    """An error that can pass through a pipe."""
    return ValueError(str(error)) if isinstance(error, ValueError) else RuntimeError(f"{type(error).__name__}: {error}")


def rows(ask: Callable[[Any], Any], prepared: Callable[[Any], Any] = lambda observation: observation) -> Callable[[Any], Any]:
    """A function from an observation to an action, that executes all actions of an answer before it asks again."""
    left: list[Any] = []

    def act(observation: Any) -> Any:
        if not left:
            left.extend(ask(prepared(observation)))
        return left.pop(0)

    return act
