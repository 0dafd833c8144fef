"""LeRobot's async_inference.policy_server with a stub for the policy: CHECKOUT PORT FOLDER SETTINGS.

PyTorch is real here: the server resizes images with it, and sends tensors as pickles.
"""

import os
import sys
from types import SimpleNamespace

import absent
import model
import torch

checkout, port, stub, options = model.from_arguments(sys.argv[1:])
sys.path.insert(0, str(checkout / "src"))
# The server writes its log into the present folder.
os.chdir(stub.folder)
# Nothing is downloaded.
os.environ.update(HF_HUB_OFFLINE="1", HF_HOME=str(stub.folder))
absent.without("accelerate", "av", "cv2", "datasets", "deepdiff", "diffusers", "einops", "gymnasium", "imageio",
               "jsonlines", "lerobot.optim", "lerobot.processor", "lerobot.utils.io_utils", "lerobot.policies", "lerobot.robots", "lerobot.cameras", "lerobot.motors",
               "lerobot.datasets.lerobot_dataset", "lerobot.datasets.video_utils", "lerobot.envs", "lerobot.teleoperators",
               "pandas", "pyarrow", "pynput", "rerun", "serial", "torchcodec", "torchvision", "transformers", "wandb")
from lerobot.async_inference import policy_server  # noqa: E402


class Stub:
    """A policy of LeRobot: images of 3 x 256 x 256 from 0 to 1, and a chunk of known actions."""

    config = SimpleNamespace(image_features={
        f"observation.images.{name}": SimpleNamespace(shape=(3, 256, 256)) for name in ("image", "image2")
    })

    @classmethod
    def from_pretrained(cls, name):
        assert name == "lerobot/smolvla_libero", name
        return cls()

    def to(self, device):
        return self

    def predict_action_chunk(self, observation):
        name = lambda key: key.removeprefix("observation.images.")
        bytes_of = lambda image: (255.0 * image[0]).round().to(torch.uint8).permute(1, 2, 0).numpy()
        images = {name(key): bytes_of(value) for key, value in observation.items() if key.startswith("observation.images.")}
        state = observation["observation.state"][0].numpy()
        chunk = stub.infer(images, {"state": state}, observation["task"])
        return torch.from_numpy(chunk.astype("float32"))[None]


same = lambda value: value
policy_server.get_policy_class = lambda kind: Stub
policy_server.make_pre_post_processors = lambda *_, **__: (same, same)
from lerobot.async_inference.configs import PolicyServerConfig  # noqa: E402

policy_server.serve.__wrapped__(PolicyServerConfig(host="127.0.0.1", port=port, inference_latency=0.0))
