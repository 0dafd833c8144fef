"""openpi's WebSocket server and its input transforms, with a stub behind them: CHECKOUT PORT FOLDER SETTINGS."""

import enum
import sys

import absent
import model

checkout, port, stub, options = model.from_arguments(sys.argv[1:])
sys.path[:0] = [str(checkout / "src"), str(checkout / "packages/openpi-client/src")]
absent.without("jax", "jaxlib", "flax", "torch", "augmax", "orbax", "beartype", "jaxtyping", "optax", "equinox", "treescope",
               "openpi.models", "openpi.shared", "openpi.training", "lerobot", "etils", "transformers", "sentencepiece")
ModelType = enum.Enum("ModelType", ["PI0", "PI0_FAST", "PI05"])
absent.module("openpi.models.model", ModelType=ModelType, IMAGE_RESOLUTION=(224, 224))
from openpi.policies import aloha_policy, droid_policy, libero_policy  # noqa: E402
from openpi.serving.websocket_policy_server import WebsocketPolicyServer  # noqa: E402
from openpi_client.base_policy import BasePolicy  # noqa: E402

INPUTS = {
    "libero": lambda: libero_policy.LiberoInputs(model_type=ModelType.PI05),
    "droid": lambda: droid_policy.DroidInputs(model_type=ModelType.PI05),
    "aloha": aloha_policy.AlohaInputs,
}
OUTPUTS = {"libero": libero_policy.LiberoOutputs, "droid": droid_policy.DroidOutputs, "aloha": aloha_policy.AlohaOutputs}


class Stub(BasePolicy):
    """The transforms of a configuration of openpi, without normalisation and resizing, around the stub."""

    def __init__(self):
        self.into = INPUTS[options["environment"]]()
        self.back = OUTPUTS[options["environment"]]()

    def infer(self, obs):
        inputs = self.into(dict(obs))
        images = {name: image for name, image in inputs["image"].items() if inputs["image_mask"][name]}
        chunk = stub.infer(images, {"state": inputs["state"]}, inputs["prompt"])
        return {"actions": self.back({"actions": chunk})["actions"], "policy_timing": {"infer_ms": 0.0}}


WebsocketPolicyServer(Stub(), host="127.0.0.1", port=port, metadata=options.get("metadata")).serve_forever()
