"""StarVLA's WebSocket server, with a stub behind it: CHECKOUT PORT FOLDER SETTINGS."""

import sys

import model

checkout, port, stub, options = model.from_arguments(sys.argv[1:])
sys.path.insert(0, str(checkout))
from deployment.model_server.tools.websocket_policy_server import WebsocketPolicyServer  # noqa: E402

# What `PolicyServerWrapper.metadata` sends for a checkpoint of LIBERO.
METADATA = {
    "env": "starvla_policy_server", "ckpt_path": "stub", "action_chunk_size": stub.settings["length"], "available_unnorm_keys": ["franka"],
    "default_unnorm_key": "franka", "training_data_mix": "libero_all", "training_obs_image_size": [224, 224],
    "action_keys": ["action.x"], "state_keys": [],
}  # fmt: skip


class Stub:
    """The interface of `PolicyServerWrapper` around the stub."""

    def predict_action(self, examples, unnorm_key=None, do_sample=True, use_ddim=False, num_ddim_steps=0):
        (example,) = examples
        if example["lang"] == "refuse":
            raise ValueError("the stub refuses this instruction")
        images = {f"image_{number}": image for number, image in enumerate(example["image"])}
        states = {"state": example["state"]} if "state" in example else {}
        return {"actions": stub.infer(images, states, example["lang"])[None]}


WebsocketPolicyServer(Stub(), host="127.0.0.1", port=port, metadata=METADATA).serve_forever()
