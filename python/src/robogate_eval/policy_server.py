"""Any Python policy behind a server of openpi's dialect, with requests of several episodes answered in one batch.

Needs the extra `policies` (websockets, msgpack, numpy). Shapes are those of the requests: images are `uint8` arrays (height, width, 3),
states are vectors of floats, `prompt` is a text. An answer is an array (actions, numbers).
"""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Callable
from queue import Empty, Queue
from typing import Any

# How long a batch waits for further requests: this many seconds, or this share of the time of the last batch if that is longer.
# Requests of all connected episodes end the wait earlier.
GATHER_S = 0.005
GATHER_SHARE = 0.5
# The largest difference between an answer alone and in a batch, as a share of the spread of the actions.
TOLERANCE = 1e-3
# Requests that are answered alone for this comparison.
COMPARED = 4

Answer = Callable[["list[dict[str, Any]]"], "list[Any]"]


def is_policy(thing: Any) -> bool:
    """Whether `serve` treats this as a policy, and not as an environment."""
    return any(callable(getattr(thing, name, None)) for name in ("predict_batch", "infer"))


def as_batch(policy: Any) -> tuple[Answer, bool]:
    """The policy as a function from a list of requests to a list of answers, and whether it computes them together."""
    if callable(batch := getattr(policy, "predict_batch", None)):
        return batch, True
    single = getattr(policy, "infer", policy)
    if not callable(single):
        raise TypeError(
            f"{type(policy).__name__}: not a policy. Expected an object with `predict_batch(observations)` or `infer(observation)`, or a "
            "function of an observation"
        )
    return lambda observations: [single(observation) for observation in observations], False


class Batcher:
    """Gathers the requests of all connections and answers them together, in the order of their arrival.

    Before the first batch with several requests, one of them is answered alone, twice, and in the batch: an answer that depends on the
    others would make an episode depend on what runs beside it. Then there are no batches.
    """

    def __init__(self, answer: Answer, most: int, gather_s: float = GATHER_S) -> None:
        self._answer, self._most, self._gather_s = answer, most, gather_s
        self._requests: Queue[tuple[dict[str, Any], Queue[Any]]] = Queue()
        self._lock = threading.Lock()
        self._episodes = 0
        self._checked = most == 1
        # What the comparison of an answer alone and in a batch found, and whether the answers to one request vary.
        self.note, self.varies = "no batches were asked for", False
        self.requests = self.batches = 0
        self.busy_s = self._last_s = 0.0
        threading.Thread(target=self._run, daemon=True).start()

    @contextlib.contextmanager
    def episode(self) -> Any:
        """A connection that sends one request at a time."""
        with self._lock:
            self._episodes += 1
        try:
            yield
        finally:
            with self._lock:
                self._episodes -= 1

    def ask(self, observation: dict[str, Any]) -> tuple[Any, int, float]:
        """The answer to a request, the size of its batch, and the seconds that it took. Raises what the policy raises."""
        reply: Queue[Any] = Queue(1)
        self._requests.put((observation, reply))
        answer = reply.get()
        if isinstance(answer, Exception):
            raise answer
        return answer

    def _gather(self) -> list[tuple[dict[str, Any], Queue[Any]]]:
        batch = [self._requests.get()]
        until = time.monotonic() + max(self._gather_s, GATHER_SHARE * self._last_s)
        # All episodes wait: nothing else can come.
        while len(batch) < min(self._most, self._episodes):
            try:
                batch.append(self._requests.get(timeout=max(until - time.monotonic(), 0.0)))
            except Empty:
                break
        return batch

    def _run(self) -> None:
        while True:
            batch = self._gather()
            if not self._checked and len(batch) > 1:
                # A request that cannot be answered is not checked, and is told below.
                with contextlib.suppress(Exception):
                    print(json.dumps({"batch_check": self.compare([observation for observation, _ in batch])}), flush=True)
            if len(batch) > self._most or not self._reply(batch):
                for one in batch:
                    self._reply([one])

    def _reply(self, batch: list[tuple[dict[str, Any], Queue[Any]]]) -> bool:
        """Answer these requests together. False if the policy cannot: one of several may be wrong, and only that one is told."""
        began = time.monotonic()
        try:
            answers = [actions_of(answer) for answer in self._answer([observation for observation, _ in batch])]
            if len(answers) != len(batch):
                raise ValueError(f"the policy gave {len(answers)} answers to {len(batch)} requests")
        except Exception as error:
            if len(batch) == 1:
                batch[0][1].put(error)
            return len(batch) == 1
        took_s = time.monotonic() - began
        self.requests += len(batch)
        self.batches += 1
        self.busy_s += took_s
        self._last_s = took_s
        for (_, reply), answer in zip(batch, answers):
            reply.put((answer, len(batch), took_s))
        return True

    def compare(self, observations: list[dict[str, Any]]) -> str:
        """Compare an answer alone with the one in a batch of these requests, before the first batch. Returns what was found. If they
        differ, there are no batches."""
        if self._checked or len(observations) < 2:
            return self.note
        self._check(observations)
        return self.note

    def summary(self, time_s: float) -> str:
        """What was answered in this time, in a sentence."""
        mean = self.requests / max(self.batches, 1)
        return (
            f"policy: {self.requests} requests, {mean:.1f} in a batch on average of at most {self._most}, busy in "
            f"{100.0 * self.busy_s / max(time_s, 1e-9):.0f} % of the time; {self.note}"
        )

    def _check(self, observations: list[dict[str, Any]]) -> None:
        import numpy as np

        def answers(requests: list[dict[str, Any]]) -> list[Any]:
            return [np.asarray(actions_of(answer)) for answer in self._answer(requests)]

        some = observations[:COMPARED]
        alone = [answers([request])[0] for request in some]
        again, together = answers(some[:1]), answers(observations)
        values = np.concatenate([answer.ravel() for answer in together])
        allowed = TOLERANCE * max(float(np.ptp(values)), 1e-6)

        def difference(others: list[Any]) -> float:
            pairs = list(zip(alone, others))
            if any(one.shape != other.shape for one, other in pairs):
                return float("inf")
            return max(float(np.max(np.abs(one - other), initial=0.0)) for one, other in pairs)

        varies, differs = difference(again), difference(together)
        self.varies = varies > allowed
        if self.varies:
            self.note = f"answers to one request vary by {varies:.3g}, so they cannot be compared with those in a batch"
        elif differs > allowed:
            self._most = 1
            self.note = (
                f"no batches: an answer in a batch of {len(observations)} differs by {differs:.3g} from the answer alone, so it depends on "
                "the other requests, for example on padding or on statistics of the batch"
            )
        else:
            self.note = f"an answer in a batch of {len(observations)} differs by {differs:.1g} from the answer alone (tolerance {allowed:.1g})"
        self._checked = True


def actions_of(answer: Any) -> Any:
    """The actions of an answer: an array, or openpi's dict with `actions`. Tensors become arrays."""
    import numpy as np

    actions = answer["actions"] if isinstance(answer, dict) else answer
    for name in ("detach", "cpu", "numpy"):
        if hasattr(actions, name) and not isinstance(actions, np.ndarray):
            actions = getattr(actions, name)()
    return np.atleast_2d(np.asarray(actions, dtype=float))


def serve_policy(policy: Any, bind: str, batch: int, metadata: "dict[str, Any] | None") -> None:
    """Serve a policy until interrupted. Prints the address as one line of JSON, and at the end what the server did."""
    import msgpack
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.server import serve

    answer, together = as_batch(policy)
    batcher = Batcher(answer, batch if together else 1)
    declared = {"model": type(policy).__name__, "batch": batch if together else 1, **(metadata or {})}
    host, port = _place(bind)
    began = time.monotonic()

    def converse(socket: Any) -> None:
        with contextlib.suppress(ConnectionClosed), batcher.episode():
            socket.send(msgpack.packb(declared, default=_pack))
            for message in socket:
                try:
                    actions, size, took_s = batcher.ask(msgpack.unpackb(message, object_hook=_unpack))
                except Exception as error:
                    # As openpi's server: a text, and then the connection is closed.
                    socket.send(f"{type(error).__name__}: {error}")
                    socket.close(1011, "the policy raised an error")
                    return
                timing = {"infer_ms": 1_000.0 * took_s, "batch": size}
                socket.send(msgpack.packb({"actions": actions, "server_timing": timing}, default=_pack))

    with serve(converse, host, port, compression=None, max_size=None) as server:
        print(json.dumps({"address": f"ws://{host}:{server.socket.getsockname()[1]}", **declared}, default=str), flush=True)
        with contextlib.suppress(KeyboardInterrupt):
            server.serve_forever()
    used = {"requests": batcher.requests, "mean_batch": batcher.requests / max(batcher.batches, 1)}
    print(json.dumps({**used, "busy": batcher.busy_s / (time.monotonic() - began)}), flush=True)


def _place(bind: str) -> tuple[str, int]:
    host, _, port = bind.removeprefix("ws://").rpartition(":")
    number = 0 if port == "*" else int(port) if port.isdigit() else -1
    if not host or not 0 <= number < 65_536:
        raise ValueError(f"bind {bind!r}: not an address. Expected ws://HOST:PORT, such as ws://127.0.0.1:8000, or * for a free port")
    return host, number


def _pack(value: Any) -> Any:
    import numpy as np

    if isinstance(value, (np.ndarray, np.generic)):
        return {b"__ndarray__": True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}
    raise TypeError(f"{type(value).__name__} cannot be sent")


def _unpack(value: dict[Any, Any]) -> Any:
    import numpy as np

    if b"__ndarray__" not in value:
        return value
    return np.frombuffer(value[b"data"], np.dtype(value[b"dtype"])).reshape(value[b"shape"])
