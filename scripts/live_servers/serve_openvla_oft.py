"""OpenVLA-OFT's vla-scripts/deploy.py, with a stub for its functions of the model: CHECKOUT PORT FOLDER SETTINGS."""

import runpy
import sys

import absent
import model
import numpy as np

checkout, port, stub, options = model.from_arguments(sys.argv[1:])
sys.path.insert(0, str(checkout))


class Network:
    llm_dim = 1
    norm_stats = {"libero_spatial_no_noops": {}}


def get_vla_action(cfg, vla, processor, obs, task_label, **_):
    # As in experiments/robot/openvla_utils.py: the images are `full_image` and every key with `wrist`.
    images = {"full_image": obs["full_image"]} | {name: obs[name] for name in obs if "wrist" in name}
    for image in images.values():
        # `check_image_format` of that file.
        assert isinstance(image, np.ndarray) and image.dtype == np.uint8 and image.shape[-1] == 3
    assert cfg.use_proprio and isinstance(obs["state"], np.ndarray)
    return list(stub.infer(images, {"state": obs["state"]}, task_label))


nothing = lambda *_, **__: None
absent.without("torch", "transformers", "prismatic.models", "prismatic.vla.materialize", "prismatic.vla.datasets",
               "prismatic.extern", "prismatic.conf")
absent.module("experiments.robot.openvla_utils", get_vla=lambda cfg: Network(), get_vla_action=get_vla_action,
              get_action_head=nothing, get_processor=nothing, get_proprio_projector=nothing)
absent.module("experiments.robot.robot_utils", get_image_resize_size=lambda cfg: 224)
sys.argv = ["deploy.py", "--host", "127.0.0.1", "--port", str(port), "--unnorm_key", "libero_spatial_no_noops",
            "--num_images_in_input", "2"]
runpy.run_path(str(checkout / "vla-scripts/deploy.py"), run_name="__main__")
