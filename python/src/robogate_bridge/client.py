"""A client of the bridge protocol."""

import secrets

import zmq

from . import codec


class Refused(Exception):
    """The server answered with an error."""

    def __init__(self, kind, detail):
        super().__init__(f"{kind}: {detail}")
        self.kind = kind
        self.detail = detail


class Unanswered(Exception):
    """The server did not answer in time, or its reply does not belong to the request."""


class Client:
    """A client for one server, with one episode at a time. Replies are the maps of bridges/PROTOCOL.md."""

    def __init__(self, address, timeout_s=30.0):
        self._address = address
        self._timeout = timeout_s
        self._context = zmq.Context()
        self._socket = None
        self.episode = 0
        self.tick = 0

    def hello(self):
        return self._ask("hello", 0)[0]

    def reset(self, parameters=None, seed=0, index=0, cell=None):
        """Begin an episode."""
        self.episode, self.tick = secrets.randbits(63) + 1, 0
        return self._ask("reset", self.episode, index=index, seed=seed, parameters=parameters or {}, cell=cell)[0]

    def step(self, actions, action_space="tool_delta", choose=None):
        """Run the actions, one for each control period. Returns the steps: fewer than actions if the episode ended. `choose` is the
        index of the object that the gripper acts on from now on, for a server that only computes physics."""
        if actions and not isinstance(actions[0], (list, tuple)):
            actions = [actions]
        rows = [[float(x) for x in action] for action in actions]
        more = {} if choose is None else {"object": choose}
        reply, _ = self._ask("step", self.episode, tick=self.tick, action_space=action_space, actions=rows, **more)
        self.tick += len(reply["steps"])
        return reply["steps"]

    def render(self, cameras=None):
        """Images by camera: width, height and bytes."""
        more = {} if cameras is None else {"cameras": list(cameras)}
        reply, frames = self._ask("render", self.episode, **more)
        return {
            image["camera"]: (image["width"], image["height"], frames[image["frame"] - 1]) for image in reply["images"]
        }

    def state_hash(self):
        return self._ask("hash", self.episode)[0]["state_hash"]

    def close(self):
        self._ask("close", self.episode)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._drop()
        self._context.term()

    def _ask(self, op, episode, **fields):
        if self._socket is None:
            self._socket = self._context.socket(zmq.REQ)
            self._socket.setsockopt(zmq.LINGER, 0)
            self._socket.setsockopt(zmq.MAXMSGSIZE, codec.MAX_MESSAGE)
            self._socket.connect(self._address)
        self._socket.send(codec.encode({"v": codec.VERSION, "op": op, "episode": episode, **fields}))
        if not self._socket.poll(1000 * self._timeout):
            self._drop()
            raise Unanswered(f"{self._address} did not answer {op} within {self._timeout} s")
        header, *frames = self._socket.recv_multipart()
        try:
            reply = codec.decode(header)
        except codec.Malformed as why:
            self._drop()
            raise Unanswered(f"{self._address}: {why}") from why
        if reply.get("v") != codec.VERSION:
            self._drop()
            theirs = reply.get("v")
            raise Unanswered(f"{self._address} uses protocol version {theirs}, but this client uses {codec.VERSION}")
        if reply.get("episode") != episode:
            self._drop()
            raise Unanswered(f"{self._address} answered for another episode")
        if reply.get("ok") is not True:
            error = reply.get("error") or {}
            raise Refused(error.get("kind", "internal"), error.get("detail", "without a reason"))
        return reply, frames

    def _drop(self):
        if self._socket is not None:
            self._socket.close()
            self._socket = None
