"""The server loop. Each request gets one reply, and no request ends the server."""

import ipaddress
import json
import random
import signal
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import isfinite
from operator import le
from typing import Any, Protocol

import zmq

from . import codec, declaration, shape
from .errors import FATAL, Problem

# How long a server runs ahead in one request. A short time, so that no request comes near its timeout.
AHEAD_S = 0.1
NUMBERS = frozenset((float, int))
FLOAT = frozenset((float,))
LIST = frozenset((list,))


@dataclass(frozen=True)
class Scenario:
    """The scenario of an episode. All randomness must depend on `seed` and `index` only."""

    index: int
    seed: int
    # The requested parameters.
    parameters: dict[str, float | int | str]
    # The cell, for a server that only computes physics.
    cell: dict[str, Any] | None = None
    # Every declared parameter: as requested, otherwise its nominal value, if it has one.
    values: dict[str, float | int | str] = field(default_factory=dict)
    # The declared policy that proposes the actions of this episode, if there is one.
    policy: str | None = None
    # Record the motion of all bodies, with at most one frame in this time in seconds. None: no recording.
    record_s: float | None = None

    def random(self):
        """A random number generator for this episode."""
        return random.Random(f"{self.seed}/{self.index}")


# Not frozen: that would triple the time to make one.
@dataclass(slots=True)
class Action:
    """The action of one control period.

    `space` is one of the task's action spaces. `numbers` are joint positions (rad or m), six numbers from -1 to 1 for
    `tool_delta`, or the numbers of the task's own vector. `gripper` is from -1 (open) to 1 (close); None without a gripper.
    `object` is the index of the object that the gripper acts on, for a server that only computes physics.
    """

    space: str
    numbers: list[float]
    gripper: float | None = None
    object: int = 0

    @property
    def close(self):
        """Whether a binary gripper closes."""
        return self.gripper is not None and self.gripper > 0.0


@dataclass(frozen=True)
class Image:
    """An image of a camera: `rgb` has 3 x width x height bytes, row by row from the top left."""

    camera: str
    width: int
    height: int
    rgb: bytes


@dataclass(slots=True)
class FreeRun:
    """Control periods that a simulator ran with the actions of its own policy (`free_run`).

    The simulator guarantees that rows and actions are finite, that they have the declared lengths, and that actions are within their bounds.
    """

    # Name of the only vector of the observation.
    vector: str
    # For each control period: the vector, the next action of the policy, and the hash of the state. NumPy arrays of little-endian
    # doubles (periods x length) and 64-bit integers, or anything with their `tolist` and `tobytes`.
    rows: Any
    actions: Any
    digests: Any
    # Results of later control periods, as `step` returns them, with `state_hash`. They are checked.
    answers: list[dict]
    # The error that ended the run.
    error: Exception | None = None


@dataclass(slots=True)
class Recording:
    """The recorded motion of all bodies of an episode.

    The arrays are NumPy arrays of little-endian 32-bit floats, or anything with their `tobytes`.
    """

    # The names of the bodies.
    bodies: list[str]
    # The visible solids: maps as in bridges/PROTOCOL.md.
    solids: list[dict]
    # The number of frames.
    frames: int
    # For each frame its time in s, then x, y, z in m and the quaternion w, x, y, z of each body.
    motion: Any
    # The three corners of each triangle of the meshes.
    triangles: Any
    # For each contact: index of the frame, kind (0: robot and object, 1: robot and surroundings, 2: object and surroundings),
    # position, normal force in N on the object, or on the robot if no object is involved.
    contacts: Any


class Simulator(Protocol):
    """What a server makes available. Return values are the maps of bridges/PROTOCOL.md; NumPy arrays are accepted as lists.

    Raise `Problem` for an error with a kind of the protocol. Any other exception becomes `internal`. `render` and `close` are
    optional, `motion` is needed if `hello` declares `records_motion`, and optional is also the pair `can_free_run() -> bool` and `free_run(action, periods, ends) -> FreeRun`.
    """

    def hello(self) -> dict:
        """The reply to `hello`, without `quaternion_order` and `image_origin`, which are fixed."""

    def reset(self, scenario: Scenario) -> dict:
        """Set up the scenario. Return `observation`, and `applied` and optionally `instance`; a server that does not score
        itself returns `readback` and `sight` instead of these. With `scenario.policy`, return also `proposed`."""

    def step(self, action: Action) -> dict:
        """Run one control period. Return one entry of the reply's `steps`. `state_hash` is optional."""

    def state_hash(self) -> int:
        """Return a hash of the full state, below 2^64. `robogate_bridge.state_hash` computes one."""

    def render(self, cameras: list[str]) -> list[Image]:
        """Return the images of these cameras, in this order. Only called if the task declares cameras."""

    def motion(self) -> Recording:
        """Return the motion since the last reset, which had `scenario.record_s`. The episode may have ended."""

    def close(self) -> None:
        """End the episode."""


class Server:
    """Answers requests. `answer` takes the frames of any request and returns those of its reply."""

    def __init__(self, simulator: Simulator):
        self._simulator = simulator
        self._hello = declaration.hello(simulator.hello())
        self._task = self._hello["task"]
        self._parameters = {spec["name"]: spec for spec in self._task["parameters"]}
        self._spaces = {space["kind"]: space for space in self._task["action"]["spaces"]}
        vector = self._spaces.get("vector", {"low": [], "high": []})
        self._low, self._high = vector["low"], vector["high"]
        self._only_vector = list(self._spaces) == ["vector"] and self._task["action"].get("gripper") is None
        self._lengths = {vector["name"]: vector["length"] for vector in self._task["observation"]["vectors"]}
        self._scores = self._hello["scores_itself"]
        self._period = self._task["control_period_s"]
        step = self._hello["time_step_s"]
        self._sights = 0 if step is None else round(self._period / step)
        self._frees = hasattr(self._simulator, "free_run")
        self._episode: int | None = None
        # The last episode, whose final state may be rendered.
        self._last: int | None = None
        # The episode whose motion is recorded.
        self._recorded: int | None = None
        self._tick = 0
        # The object that the gripper acts on, and the number of objects, for a server that only computes physics.
        self._object, self._objects = 0, 0
        # Whether a policy of this server proposes the actions of the episode.
        self._proposes = False
        # An error in a control period that no request has asked for yet.
        self._waiting: Problem | None = None
        numbers = sum(self._lengths.values())
        # Each number takes nine bytes of the header.
        self._most_ahead = min(codec.MAX_ACTIONS, codec.MAX_HEADER // (40 * (numbers + 50)))

    def answer(self, frames: list[bytes]) -> list[bytes]:
        episode = 0
        try:
            try:
                if len(frames) != 1:
                    raise Problem("bad_request", f"a request has one frame, not {len(frames)}")
                request = codec.decode(frames[0])
                episode = _u64(request, "episode")
                if request.get("v") != codec.VERSION:
                    detail = f"this server uses protocol version {codec.VERSION}, but the request has version {request.get('v')}"
                    raise Problem("bad_request", detail)
                operation = self._operations.get(request.get("op"))
                if operation is None:
                    known = ", ".join(self._operations)
                    raise Problem("bad_request", f"unknown operation {request.get('op')!r}. Expected one of: {known}")
                fields, images = operation(self, request, episode)
                header = codec.encode({"v": codec.VERSION, "episode": episode, "ok": True, **fields})
                return [header, *images]
            except codec.Malformed as why:
                raise Problem("bad_request", str(why)) from why
            except Problem:
                raise
            except Exception as why:
                traceback.print_exc()
                raise Problem("internal", f"{type(why).__name__}: {why}") from why
        except Problem as problem:
            if problem.kind in FATAL:
                self._over()
            detail = " ".join(problem.detail.split())[: codec.MAX_STRING // 4]
            error = {"kind": problem.kind, "detail": detail}
            return [codec.encode({"v": codec.VERSION, "episode": episode, "ok": False, "error": error})]

    def _do_hello(self, request, episode):
        return self._hello, []

    def _do_reset(self, request, episode):
        requested = self._requested(request)
        nominal = {name: spec["nominal"] for name, spec in self._parameters.items() if "nominal" in spec}
        index, seed, policy = _u64(request, "index"), _u64(request, "seed"), self._policy(request)
        record_s = _record_s(request) if self._hello["records_motion"] else None
        scenario = Scenario(index, seed, requested, self._cell(request), nominal | requested, policy, record_s)
        self._over()
        self._last = self._recorded = None
        self._object, self._objects = 0, 0 if scenario.cell is None else _count(scenario.cell.get("objects"))
        answer = self._simulator.reset(scenario)
        fields = {"observation": shape.observation(shape.entry(answer, "observation", "reset"), self._task, 0.0)}
        if self._hello["scores_itself"]:
            fields["instance"] = shape.instance(answer.get("instance"), self._task)
            fields["applied"] = shape.applied(shape.entry(answer, "applied", "reset"))
        else:
            fields["readback"] = shape.readback(shape.entry(answer, "readback", "reset"))
            fields["sight"] = shape.sight(shape.entry(answer, "sight", "reset"))
        if policy is not None:
            fields["proposed"] = shape.proposed(shape.entry(answer, "proposed", "reset"), self._task, "reset")
        self._episode, self._tick, self._proposes, self._waiting = episode, 0, policy is not None, None
        self._recorded = None if record_s is None else episode
        self._last = episode
        return fields, []

    def _do_step(self, request, episode):
        self._running(episode)
        if self._waiting is not None:
            raise self._waiting
        if _u64(request, "tick") != self._tick:
            raise Problem("bad_request", f"the request is for tick {request['tick']}. Expected tick {self._tick}")
        steps, actions = [], self._actions(request)
        self._choose(request)
        for action in actions:
            action.object = self._object
            steps.append(self._period_of(action, len(steps)))
            if steps[-1].get("ending") is not None:
                return {"steps": steps}, []
        ahead, proposed = _optional_u64(request, "ahead"), steps[-1].get("proposed")
        if request.get("packed") is True and ahead and proposed is not None and self._can_free_run(proposed):
            return self._packed(steps, proposed, min(ahead, codec.MAX_ACTIONS))
        self._run_ahead(steps, min(ahead, self._most_ahead))
        return {"steps": steps}, []

    def _packed(self, steps, proposed, periods):
        """The reply with further control periods as arrays in frames of their own, which both sides copy instead of reading number
        by number."""
        fields, frames = {"steps": steps}, []
        with self._keeping_errors():
            run = self._simulator.free_run(proposed["action"], periods, time.monotonic() + AHEAD_S)
            count, later = len(run.rows), steps
            if count:
                self._tick += count
                later = []
                fields |= {"packed": {"vector": run.vector, "periods": count}, "later": later}
                frames = [run.rows.tobytes(), run.actions.tobytes(), run.digests.tobytes()]
            for answer in run.answers:
                later.append(self._checked(answer, answer["state_hash"], 1 + count + len(later)))
            if run.error is not None:
                raise run.error
        return fields, frames

    @contextmanager
    def _keeping_errors(self):
        """Keep an error for the request that gets to it, so that the record does not depend on how far this server ran ahead."""
        try:
            yield
        except Problem as problem:
            self._waiting = problem
        except Exception as why:
            traceback.print_exc()
            self._waiting = Problem("internal", f"{type(why).__name__}: {why}")

    def _period_of(self, action, position):
        """Run one control period, the one at this position of a reply."""
        answer = self._simulator.step(action)
        digest = answer.get("state_hash")
        return self._checked(answer, self._simulator.state_hash() if digest is None else digest, position)

    def _checked(self, answer, digest, position):
        """The entry of a reply for a control period that the simulator ran."""
        self._tick += 1
        plain = self._plain(answer, digest)
        if plain is not None:
            return plain
        where = f"steps[{position}]"
        result = shape.step(answer, self._hello, self._tick * self._period, self._sights, where)
        result["state_hash"] = shape.integer(digest, f"{where}.state_hash")
        if result.get("ending") is not None:
            self._over()
        elif self._proposes and answer.get("proposed") is not None:
            result["proposed"] = shape.proposed(answer["proposed"], self._task, where)
        return result

    def _plain(self, answer, digest):
        """The same as the rest of `_checked` for the answer that most control periods have, in a fraction of its time: valid, with
        lists of floats, an action and nothing else. None for any other answer."""
        try:
            observation, proposed = answer["observation"], answer["proposed"]
            vectors = observation["vectors"]
            more = len(observation) != 1 or answer.get("ending") is not None or answer.get("measures") or answer.get("events")
            if more or not self._proposes or not self._in_bounds(proposed):
                return None
            if vectors.keys() != self._lengths.keys() or "tool_pose" in vectors or type(digest) is not int:
                return None
            for name, values in vectors.items():
                # A sum is finite only if all of its terms are.
                right = type(values) is list and len(values) == self._lengths[name] and FLOAT.issuperset(map(type, values))
                if not right or not isfinite(sum(values)):
                    return None
        except (KeyError, TypeError, AttributeError):
            return None
        if not self._scores or not 0 <= digest <= codec.MAX_NUMBER:
            return None
        return {
            "observation": {"time_s": self._tick * self._period, "vectors": vectors},
            "measures": {},
            "ending": None,
            "events": [],
            "state_hash": digest,
            "proposed": proposed,
        }

    def _in_bounds(self, proposed):
        """Whether a proposed action is a list of floats within the bounds of a task that only takes vectors."""
        numbers = proposed["action"]
        return (
            self._only_vector
            and proposed["action_space"] == "vector"
            and type(numbers) is list
            and len(numbers) == len(self._low)
            and FLOAT.issuperset(map(type, numbers))
            and all(map(le, self._low, numbers))
            and all(map(le, numbers, self._high))
        )

    def _run_ahead(self, steps, periods):
        """Run further control periods with the actions that the policy of this server proposes."""
        most, ends = len(steps) + periods, time.monotonic() + AHEAD_S
        with self._keeping_errors():
            while len(steps) < most and steps[-1].get("proposed") is not None and time.monotonic() <= ends:
                proposed = steps[-1]["proposed"]
                if self._can_free_run(proposed):
                    run = self._simulator.free_run(proposed["action"], most - len(steps), ends)
                    steps += self._finished(run)
                    answers, error = [(answer, answer["state_hash"]) for answer in run.answers], run.error
                else:
                    answers, error = self._free_run(proposed, most - len(steps), ends)
                for answer, digest in answers:
                    steps.append(self._checked(answer, digest, len(steps)))
                if error is not None:
                    raise error

    def _can_free_run(self, proposed):
        """Whether the simulator runs ahead by itself, which takes less time."""
        return self._frees and self._simulator.can_free_run() and self._in_bounds(proposed)

    def _finished(self, run):
        """The entries of a reply for the control periods of a `FreeRun`, which are valid already."""
        first, self._tick = self._tick, self._tick + len(run.rows)
        return [
            {
                "observation": {"time_s": tick * self._period, "vectors": {run.vector: row}},
                "measures": {},
                "ending": None,
                "events": [],
                "state_hash": digest,
                "proposed": {"action_space": "vector", "action": action},
            }
            for tick, row, action, digest in zip(
                range(first + 1, self._tick + 1), run.rows.tolist(), run.actions.tolist(), run.digests.tolist()
            )
        ]

    def _free_run(self, proposed, periods, ends):
        """Up to so many control periods, each with the action that the one before it proposed. Returns their answers with the
        hashes, and the error that ended them.

        The answers are checked afterwards, all at once: that takes a fraction of the time of checks in turn with the physics,
        because the processor finds their code in its caches.
        """
        answers, step = [], self._simulator.step
        try:
            while proposed is not None and len(answers) < periods and time.monotonic() <= ends:
                if self._in_bounds(proposed):
                    action = Action("vector", proposed["action"])
                else:
                    checked = shape.proposed(proposed, self._task, "proposed")
                    action = self._action(checked["action_space"], checked["action"])
                answer = step(action)
                digest = answer.get("state_hash")
                answers.append((answer, self._simulator.state_hash() if digest is None else digest))
                # An array may be a view of memory that the next control period changes.
                if answer.get("ending") is not None or not LIST.issuperset(map(type, answer["observation"]["vectors"].values())):
                    break
                proposed = answer.get("proposed")
        except Exception as error:
            return answers, error
        return answers, None

    def _do_render(self, request, episode):
        # After its end, a simulator that is not told about it still has the final state.
        if self._episode is not None or episode != self._last or hasattr(self._simulator, "close"):
            self._running(episode)
        known = {camera["name"]: camera for camera in self._task["observation"]["cameras"]}
        if not known:
            raise Problem("unsupported", "this simulator has no cameras")
        wanted = request.get("cameras")
        wanted = list(known) if wanted is None else wanted
        if not isinstance(wanted, list) or not all(isinstance(name, str) and name in known for name in wanted):
            raise Problem("bad_request", f"cameras must be some of {', '.join(known)}")
        images, frames = [], []
        for name, image in zip(wanted, self._simulator.render(wanted), strict=True):
            size = (image.width, image.height)
            if image.camera != name or size != (known[name]["width"], known[name]["height"]):
                raise shape.wrong(f"the image of {name}", "of the size that the task declares")
            if len(image.rgb) != 3 * image.width * image.height:
                raise shape.wrong(f"the image of {name}", f"{3 * image.width * image.height} bytes")
            frames.append(image.rgb)
            images.append({"camera": name, "width": size[0], "height": size[1], "frame": len(frames)})
        return {"tick": self._tick, "images": images}, frames

    def _do_hash(self, request, episode):
        self._running(episode)
        return {"tick": self._tick, "state_hash": shape.integer(self._simulator.state_hash(), "state_hash")}, []

    def _do_motion(self, request, episode):
        # An episode that has ended is still the recorded one.
        if self._recorded is None or episode != self._recorded:
            raise Problem("bad_request", f"the motion of episode {episode} is not recorded")
        recording = self._simulator.motion()
        frames = [array.tobytes() for array in (recording.motion, recording.triangles, recording.contacts)]
        size = sum(map(len, frames))
        if size + codec.MAX_HEADER > codec.MAX_MESSAGE:
            raise Problem("unsupported", f"the motion has {size} bytes. Expected at most {codec.MAX_MESSAGE - codec.MAX_HEADER}")
        return {"bodies": recording.bodies, "solids": recording.solids, "frames": recording.frames}, frames

    def _do_close(self, request, episode):
        self._running(episode)
        self._last = None
        self._over()
        return {}, []

    _operations = {
        "hello": _do_hello,
        "reset": _do_reset,
        "step": _do_step,
        "render": _do_render,
        "hash": _do_hash,
        "motion": _do_motion,
        "close": _do_close,
    }

    def _running(self, episode):
        if self._episode is None:
            raise Problem("bad_request", "no episode is running")
        if episode != self._episode:
            raise Problem("bad_request", f"episode {episode} is not running")

    def _over(self):
        if self._episode is not None:
            self._episode = None
            if hasattr(self._simulator, "close"):
                self._simulator.close()

    def _requested(self, request):
        parameters = request.get("parameters")
        if not isinstance(parameters, dict) or len(parameters) > codec.MAX_PARAMETERS:
            raise Problem("bad_request", f"parameters must be a map of up to {codec.MAX_PARAMETERS} entries")
        for name, value in parameters.items():
            if isinstance(value, bool) or not isinstance(value, (float, int, str)):
                raise Problem("bad_request", f"parameter {name} must be a number or a string")
            if name not in self._parameters:
                raise Problem("not_applied", f"the task {self._task['name']} declares no parameter {name}")
            if (expected := declaration.refusal(self._parameters[name], value)) is not None:
                raise Problem("setup", f"parameter {name} = {value}: expected {expected}")
        return parameters

    def _policy(self, request):
        policy, known = request.get("policy"), [policy["name"] for policy in self._hello["policies"]]
        if policy is None or policy in known:
            return policy
        names = ", ".join(known) or "none"
        raise Problem("setup", f"this server declares no policy {policy!r}. Its policies: {names}")

    def _cell(self, request):
        cell = request.get("cell")
        if self._hello["scores_itself"]:
            if cell is not None:
                raise Problem("bad_request", "this server has its own task and takes no cell")
        elif not isinstance(cell, dict):
            raise Problem("bad_request", "this server needs a cell")
        elif cell.get("control_period_s") != self._period:
            raise Problem("setup", f"the control period of this server is {self._period} s")
        return cell

    def _choose(self, request):
        """Choose the object that the gripper acts on from now on."""
        if request.get("object") is None:
            return
        chosen = _u64(request, "object")
        if self._scores or chosen >= self._objects:
            raise Problem("bad_request", "object must be the index of an object of the cell")
        self._object = chosen

    def _actions(self, request):
        kind, actions = request.get("action_space"), request.get("actions")
        if not isinstance(kind, str) or kind not in self._spaces:
            raise Problem("bad_request", f"action_space must be one of {', '.join(self._spaces)}")
        if not isinstance(actions, list) or not 1 <= len(actions) <= codec.MAX_ACTIONS:
            raise Problem("bad_request", f"actions must be a list of 1 to {codec.MAX_ACTIONS}")
        return [self._action(kind, action) for action in actions]

    def _action(self, kind, action):
        count, gripper = shape.action_length(self._task, kind), None
        # The numbers are finite, because the header was checked.
        if not isinstance(action, list) or len(action) != count or not NUMBERS.issuperset(map(type, action)):
            raise Problem("bad_action", f"an action of {kind} has {count} numbers, got {str(action)[:200]}")
        numbers = list(map(float, action))
        if self._task["action"].get("gripper") is not None:
            gripper = min(max(numbers.pop(), -1.0), 1.0)
        if kind == "tool_delta":
            numbers = [min(max(x, -1.0), 1.0) for x in numbers]
        elif kind == "vector" and not (all(map(le, self._low, numbers)) and all(map(le, numbers, self._high))):
            _bounded(numbers, self._spaces[kind])
        return Action(kind, numbers, gripper)


def _bounded(numbers, space):
    for name, x, low, high in zip(space["names"], numbers, space["low"], space["high"]):
        # A value that exceeds a bound by a rounding error is accepted.
        room = 1e-6 * (high - low)
        if not low - room <= x <= high + room:
            raise Problem("bad_action", f"{name} is {x}. Expected {low} to {high}")


def _u64(request, key):
    value = request.get(key)
    if type(value) is not int or not 0 <= value <= codec.MAX_NUMBER:
        raise Problem("bad_request", f"{key} must be an integer from 0 to 2^64 - 1")
    return value


def _count(objects):
    return len(objects) if isinstance(objects, list) else 0


def _optional_u64(request, key):
    return 0 if request.get(key) is None else _u64(request, key)


def _record_s(request):
    value = request.get("record_s")
    if value is None:
        return None
    if type(value) not in (float, int) or not value > 0:
        raise Problem("bad_request", "record_s must be a number above 0")
    return float(value)


def _announce(address: str) -> None:
    print(json.dumps({"listening": address}), flush=True)


def serve(
    simulator: Simulator,
    bind: str = "tcp://127.0.0.1:5570",
    allow_remote: bool = False,
    ready: Callable[[str], None] = _announce,
    listener: int | None = None,
) -> None:
    """Serve until interrupted. `tcp://127.0.0.1:*` takes a free port. `listener` is the descriptor of a socket that listens already: a
    process in a sandbox cannot create one.

    Calls `ready` with the address, which by default prints one line of JSON, `{"listening": "tcp://..."}`. An address that other
    machines can reach requires `allow_remote`: the protocol has no authentication.
    """
    if not allow_remote and not loopback(bind):
        raise SystemExit(f"{bind}: other machines can reach this address, and the protocol has no authentication. Use allow_remote")
    try:
        server = Server(simulator)
    except Problem as problem:
        raise SystemExit(f"error: {problem.detail}") from None
    context = zmq.Context()
    socket = context.socket(zmq.REP)
    socket.setsockopt(zmq.LINGER, 200)
    # Requests consist of a header only. A larger frame ends its connection before it is in memory.
    socket.setsockopt(zmq.MAXMSGSIZE, codec.MAX_HEADER)
    for name in (signal.SIGINT, signal.SIGTERM):
        # A caller that ignores a signal wants that.
        if signal.getsignal(name) is not signal.SIG_IGN:
            signal.signal(name, _stop)
    try:
        try:
            if listener is not None:
                socket.setsockopt(zmq.USE_FD, listener)
            socket.bind(bind)
        except zmq.ZMQError as why:
            raise SystemExit(f"cannot listen on {bind}: {why.strerror}") from None
        ready(socket.getsockopt(zmq.LAST_ENDPOINT).decode().rstrip("\0"))
        while True:
            # A signal that arrives just before the socket blocks is noticed only when it returns.
            if not socket.poll(500):
                continue
            socket.send_multipart(server.answer(socket.recv_multipart()), copy=False)
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
    finally:
        socket.close()
        context.term()


def _stop(number, frame):
    raise KeyboardInterrupt


def loopback(address):
    """Whether only this machine can reach the address."""
    host = address.removeprefix("tcp://").rpartition(":")[0].strip("[]")
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
