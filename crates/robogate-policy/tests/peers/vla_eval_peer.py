"""vla-eval's model server with a model that reports the received observation."""

import socket
import sys

import numpy as np
from vla_eval.model_servers.predict import PredictModelServer
from vla_eval.model_servers.serve import serve
from vla_eval.specs import GRIPPER_CLOSE_POS, IMAGE_RGB, LANGUAGE, POSITION_DELTA, ROTATION_AA, STATE_EEF_POS_AA_GRIP


class Echo(PredictModelServer):
    def predict(self, obs, ctx):
        if obs["task_description"] == "boom":
            raise ValueError("no such task")
        image = obs["images"]["agentview"]
        assert image.dtype == np.uint8 and image.shape == (256, 256, 3) and image[0, 1, 2] == 5, image.shape
        row = np.concatenate([obs["states"][:6], [1.0]]).astype(np.float32)
        # A chunk of two: the server keeps the second for the next observation.
        return {"actions": np.stack([row, row + 1])}

    def get_action_spec(self):
        return {"position": POSITION_DELTA, "rotation": ROTATION_AA, "gripper": GRIPPER_CLOSE_POS}

    def get_observation_spec(self):
        return {"image": IMAGE_RGB, "language": LANGUAGE, "state": STATE_EEF_POS_AA_GRIP}

    def get_observation_params(self):
        return {"send_wrist_image": True, "send_state": True}


with socket.socket() as free:
    free.bind(("127.0.0.1", 0))
    port = free.getsockname()[1]
print(f"ws://127.0.0.1:{port}", flush=True)
sys.stdout.close()
serve(Echo(chunk_size=2), "127.0.0.1", port)
