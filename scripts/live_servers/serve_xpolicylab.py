"""XPolicyLab's WebSocket server, with a stub behind it: CHECKOUT PORT FOLDER SETTINGS."""

import asyncio
import sys

import model
import numpy as np

checkout, port, stub, options = model.from_arguments(sys.argv[1:])
sys.path.insert(0, str(checkout))
from client_server.ws.model_server import PolicyServer, PolicyServerConfig  # noqa: E402


class Stub:
    """The interface of a policy's `Model` around the stub. `widths` are the sizes of the parts of an action."""

    def update_obs(self, observation):
        self.seen = observation

    def get_action(self):
        if self.seen["instruction"] == "refuse":
            raise ValueError("the stub refuses this instruction")
        images = {name: camera["color"] for name, camera in self.seen["vision"].items()}
        chunk = stub.infer(images, self.seen["state"], self.seen["instruction"])
        ends = np.cumsum(list(options["widths"].values()))[:-1]
        return [dict(zip(options["widths"], np.split(row.astype(np.float32), ends))) for row in chunk]

    def reset(self):
        self.seen = None


asyncio.run(PolicyServer(Stub(), PolicyServerConfig(host="127.0.0.1", port=port)).serve_forever())
