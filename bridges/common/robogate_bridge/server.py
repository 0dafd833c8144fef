"""The server loop: one question, one answer, and nothing that a client sends ends it."""

import ipaddress
import json
import signal
import sys
import traceback
from dataclasses import dataclass
from typing import Any, Protocol

import zmq

from . import codec, shape
from .errors import FATAL, Problem


@dataclass(frozen=True)
class Scenario:
    """What a reset asks for. All that is random must depend on `seed` and `index` alone."""

    index: int
    seed: int
    parameters: dict[str, float | int | str]
    cell: dict[str, Any] | None


@dataclass(frozen=True)
class Action:
    """One control period's action: `arm` is joint positions (rad), or six numbers from -1 to 1 for `tool_delta`."""

    space: str
    arm: list[float]
    close: bool


@dataclass(frozen=True)
class Image:
    """A camera's picture: `rgb` holds 3 x width x height bytes, row by row from the top left."""

    camera: str
    width: int
    height: int
    rgb: bytes


class Simulator(Protocol):
    """What a server puts behind the protocol. Answers are the maps of bridges/PROTOCOL.md; NumPy arrays will do for lists.

    Raise `Problem` for what the protocol has a kind for; anything else that is raised becomes `internal`.
    """

    def hello(self) -> dict:
        """All keys of the reply to `hello`, but `quaternion_order` and `image_origin`, which are fixed."""

    def reset(self, scenario: Scenario) -> dict:
        """Sets the scenario up. `observation` and, judging, `task` and `applied`; otherwise `readback` and `sight`."""

    def step(self, action: Action) -> dict:
        """Runs one control period; one entry of the reply's `steps`."""

    def state_hash(self) -> int:
        """A hash over the full state, below 2^64."""

    def render(self, cameras: list[str]) -> list[Image]:
        """What these cameras show, in this order. Only called where `hello` names cameras."""

    def close(self) -> None:
        """The episode is over."""


class Server:
    """Answers requests. `answer` takes the frames of one request and gives those of its reply, whatever they are."""

    def __init__(self, simulator: Simulator):
        self._simulator = simulator
        self._hello = shape.hello(simulator.hello())
        self._joints = len(self._hello["joints"])
        self._period = self._hello["control_period_s"]
        self._sights = round(self._period / self._hello["time_step_s"])
        self._episode: int | None = None
        self._tick = 0

    def answer(self, frames: list[bytes]) -> list[bytes]:
        episode = 0
        try:
            try:
                if len(frames) != 1:
                    raise Problem("bad_request", f"a request has one frame, not {len(frames)}")
                request = codec.decode(frames[0])
                episode = _u64(request, "episode")
                if request.get("v") != codec.VERSION:
                    raise Problem("bad_request", f"this server speaks version {codec.VERSION} of the protocol")
                operation = self._operations.get(request.get("op"))
                if operation is None:
                    known = ", ".join(self._operations)
                    raise Problem("bad_request", f"there is no op {request.get('op')!r}; there are {known}")
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
        scenario = Scenario(_u64(request, "index"), _u64(request, "seed"), self._parameters(request), self._cell(request))
        self._over()
        answer = self._simulator.reset(scenario)
        fields = {"observation": shape.observation(shape.entry(answer, "observation", "reset"), self._joints, 0.0)}
        if self._hello["judges"]:
            fields["task"] = shape.task(shape.entry(answer, "task", "reset"))
            fields["applied"] = shape.applied(shape.entry(answer, "applied", "reset"))
        else:
            fields["readback"] = shape.readback(shape.entry(answer, "readback", "reset"))
            fields["sight"] = shape.sight(shape.entry(answer, "sight", "reset"))
        self._episode, self._tick = episode, 0
        return fields, []

    def _do_step(self, request, episode):
        self._under_way(episode)
        if _u64(request, "tick") != self._tick:
            raise Problem("bad_request", f"tick {request['tick']} was asked for, {self._tick} is due")
        steps = []
        for action in self._actions(request):
            self._tick += 1
            answer = self._simulator.step(action)
            where = f"steps[{len(steps)}]"
            steps.append(
                shape.step(answer, self._joints, self._tick * self._period, self._hello["judges"], self._sights, where)
            )
            if steps[-1].get("ending") is not None:
                self._over()
                break
        return {"steps": steps}, []

    def _do_render(self, request, episode):
        self._under_way(episode)
        known = {camera["name"]: camera for camera in self._hello["cameras"]}
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
                raise shape.wrong(f"the picture of {name}", "of the size that hello said")
            if len(image.rgb) != 3 * image.width * image.height:
                raise shape.wrong(f"the picture of {name}", f"{3 * image.width * image.height} bytes")
            frames.append(image.rgb)
            images.append({"camera": name, "width": size[0], "height": size[1], "frame": len(frames)})
        return {"tick": self._tick, "images": images}, frames

    def _do_hash(self, request, episode):
        self._under_way(episode)
        return {"tick": self._tick, "state_hash": shape.whole(self._simulator.state_hash(), "state_hash")}, []

    def _do_close(self, request, episode):
        self._under_way(episode)
        self._over()
        return {}, []

    _operations = {
        "hello": _do_hello,
        "reset": _do_reset,
        "step": _do_step,
        "render": _do_render,
        "hash": _do_hash,
        "close": _do_close,
    }

    def _under_way(self, episode):
        if self._episode is None:
            raise Problem("bad_request", "no episode is under way")
        if episode != self._episode:
            raise Problem("bad_request", f"episode {episode} is not the one under way")

    def _over(self):
        if self._episode is not None:
            self._episode = None
            self._simulator.close()

    def _parameters(self, request):
        parameters = request.get("parameters")
        if not isinstance(parameters, dict) or len(parameters) > codec.MAX_PARAMETERS:
            raise Problem("bad_request", f"parameters must be a map of up to {codec.MAX_PARAMETERS} entries")
        for name, value in parameters.items():
            if isinstance(value, bool) or not isinstance(value, (float, int, str)):
                raise Problem("bad_request", f"parameter {name} must be a number or a string")
            if name not in self._hello["parameters"]:
                raise Problem("not_applied", f"this server cannot apply the parameter {name}")
        return parameters

    def _cell(self, request):
        cell = request.get("cell")
        if self._hello["judges"]:
            if cell is not None:
                raise Problem("bad_request", "this server has a world of its own and takes no cell")
        elif not isinstance(cell, dict):
            raise Problem("bad_request", "this server needs a cell")
        elif cell.get("control_period_s") != self._period:
            raise Problem("setup", f"the control period of this server is {self._period} s")
        return cell

    def _actions(self, request):
        space, actions = request.get("action_space"), request.get("actions")
        if space not in self._hello["action_spaces"]:
            raise Problem("bad_request", f"action_space must be one of {', '.join(self._hello['action_spaces'])}")
        if not isinstance(actions, list) or not 1 <= len(actions) <= codec.MAX_ACTIONS:
            raise Problem("bad_request", f"actions must be a list of 1 to {codec.MAX_ACTIONS}")
        due = 7 if space == "tool_delta" else self._joints + 1
        out = []
        for action in actions:
            # Finite they are: the header was looked at.
            if not isinstance(action, list) or len(action) != due or not all(type(x) in (float, int) for x in action):
                raise Problem("bad_action", f"an action in {space} has {due} numbers, got {str(action)[:200]}")
            arm = [float(x) for x in action[:-1]]
            if space == "tool_delta":
                arm = [min(max(x, -1.0), 1.0) for x in arm]
            out.append(Action(space, arm, action[-1] > 0))
        return out


def _u64(request, key):
    value = request.get(key)
    if type(value) is not int or not 0 <= value <= codec.MAX_NUMBER:
        raise Problem("bad_request", f"{key} must be a whole number from 0 to 2^64 - 1")
    return value


def serve(simulator: Simulator, bind: str = "tcp://127.0.0.1:5570", allow_remote: bool = False) -> None:
    """Serves until it is interrupted. `tcp://127.0.0.1:*` takes a free port.

    The address that it listens on is printed as one line of JSON, `{"listening": "tcp://..."}`. An address that
    other machines reach needs `allow_remote`: the protocol has no authentication.
    """
    if not allow_remote and not loopback(bind):
        raise SystemExit(f"{bind} is reached by other machines and the protocol has no authentication: use allow_remote")
    server = Server(simulator)
    context = zmq.Context()
    socket = context.socket(zmq.REP)
    socket.setsockopt(zmq.LINGER, 200)
    # Requests are headers alone; a larger frame ends its connection before it is in memory.
    socket.setsockopt(zmq.MAXMSGSIZE, codec.MAX_HEADER)
    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, _stop)
    try:
        try:
            socket.bind(bind)
        except zmq.ZMQError as why:
            raise SystemExit(f"cannot listen on {bind}: {why.strerror}") from None
        print(json.dumps({"listening": socket.getsockopt(zmq.LAST_ENDPOINT).decode().rstrip("\0")}), flush=True)
        while True:
            socket.send_multipart(server.answer(socket.recv_multipart()), copy=False)
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
    finally:
        socket.close()
        context.term()


def _stop(number, frame):
    raise KeyboardInterrupt


def loopback(address):
    """Whether only this machine reaches the address."""
    host = address.removeprefix("tcp://").rpartition(":")[0].strip("[]")
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
