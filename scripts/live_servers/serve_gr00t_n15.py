"""Isaac GR00T N1.5: inference_service.py over ZeroMQ or HTTP, with a stub for the policy: CHECKOUT PORT FOLDER SETTINGS."""

import functools
import json
import sys

import absent
import model
import numpy as np

checkout, port, stub, options = model.from_arguments(sys.argv[1:])
sys.path[:0] = [str(checkout), str(checkout / "scripts")]


class ModalityConfig:
    """What the server sends of a configuration."""

    def __init__(self, delta_indices, modality_keys):
        self.content = {"delta_indices": delta_indices, "modality_keys": modality_keys}

    def model_dump_json(self):
        return json.dumps(self.content)


absent.without("torch", "torchvision", "transformers", "gr00t.model", "gr00t.data.transform", "gr00t.experiment", "pandas", "av",
               "decord", "albumentations", "pytorch3d")
absent.module("gr00t.data.dataset", ModalityConfig=ModalityConfig)
import inference_service  # noqa: E402

KEYS = {
    "video": ["video.image", "video.wrist_image"],
    "state": [f"state.{name}" for name in ("x", "y", "z", "roll", "pitch", "yaw", "gripper")],
    "action": [f"action.{name}" for name in ("x", "y", "z", "roll", "pitch", "yaw", "gripper")],
    "language": ["annotation.human.action.task_description"],
}


class Stub:
    """Takes and returns what the policy of LIBERO's example does (examples/Libero)."""

    def __init__(self, **_):
        pass

    def get_modality_config(self):
        horizon = {"action": list(range(16))}
        return {kind: ModalityConfig(horizon.get(kind, [0]), keys) for kind, keys in KEYS.items()}

    def get_action(self, observation):
        part = lambda kind: {name: np.asarray(observation[name]) for name in KEYS[kind]}
        images = {name.removeprefix("video."): video for name, video in part("video").items()}
        states = {name.removeprefix("state."): state[0] for name, state in part("state").items()}
        text = observation[KEYS["language"][0]]
        chunk = stub.infer(images, states, text if isinstance(text, str) else text[0])
        # One number for each action, as the real policy returns it.
        return {name: chunk[:, i] for i, name in enumerate(KEYS["action"])}


inference_service.Gr00tPolicy = Stub
# The script gives the ZeroMQ server no address; its default is every interface.
inference_service.RobotInferenceServer = functools.partial(inference_service.RobotInferenceServer, host="127.0.0.1")
http = options.get("http", False)
inference_service.main(inference_service.ArgsConfig(
    model_path="stub", data_config="stub", port=port, host="127.0.0.1", server=True, http_server=http))
