"""Isaac GR00T N1.6 and N1.7: run_gr00t_server.py with a stub behind Gr00tPolicy: CHECKOUT PORT FOLDER SETTINGS."""

import sys

import absent
import model
import numpy as np

checkout, port, stub, options = model.from_arguments(sys.argv[1:])
sys.path.insert(0, str(checkout))
absent.without("torch", "torchvision", "transformers", "gr00t.data.dataset", "gr00t.model", "tianshou", "pandas", "av")
from gr00t.configs.data.embodiment_configs import MODALITY_CONFIGS  # noqa: E402
from gr00t.data.embodiment_tags import EmbodimentTag  # noqa: E402
from gr00t.eval import run_gr00t_server  # noqa: E402
from gr00t.policy.gr00t_policy import Gr00tPolicy  # noqa: E402
from gr00t.policy.policy import BasePolicy  # noqa: E402


class Stub(Gr00tPolicy):
    """GR00T's own policy with its checks of observations and actions. Only the model is replaced."""

    def __init__(self, embodiment_tag, model_path, *, device, strict=True):
        BasePolicy.__init__(self, strict=strict)
        self.embodiment_tag = embodiment_tag
        self.modality_configs = MODALITY_CONFIGS[embodiment_tag.value]
        self.language_key = self.modality_configs["language"].modality_keys[0]

    def _get_action(self, observation, options=None):
        images = {name: video[0] for name, video in observation["video"].items()}
        states = {name: state[0, 0] for name, state in observation["state"].items()}
        chunk = stub.infer(images, states, observation["language"][self.language_key][0][0])
        widths = run_options["widths"]
        starts = np.cumsum([0, *widths.values()])
        parts = {name: chunk[:, start : start + width] for (name, width), start in zip(widths.items(), starts)}
        for name in self.modality_configs["action"].modality_keys:
            parts.setdefault(name, np.zeros((len(chunk), 9)))
        return {name: part[None].astype(np.float32) for name, part in parts.items()}, {}

    def reset(self, options=None):
        return {}


run_options = options
run_gr00t_server.Gr00tPolicy = Stub
tag = options["embodiment_tag"]
if isinstance(run_gr00t_server.ServerConfig.__dataclass_fields__["embodiment_tag"].default, EmbodimentTag):
    tag = EmbodimentTag(tag)
run_gr00t_server.main(run_gr00t_server.ServerConfig(
    model_path="stub", embodiment_tag=tag, device="cpu", host="127.0.0.1", port=port,
    use_sim_policy_wrapper=options.get("wrapper", False)))
