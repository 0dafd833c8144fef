"""vla-eval's model server with a stub: CHECKOUT PORT FOLDER SETTINGS."""

import sys

import absent
import model

checkout, port, stub, options = model.from_arguments(sys.argv[1:])
sys.path.insert(0, str(checkout / "src"))
# The build writes this file; a checkout does not have it.
absent.module("vla_eval._version", __version__="0", __version_tuple__=(0,))
from vla_eval.model_servers.predict import PredictModelServer  # noqa: E402
from vla_eval.model_servers.serve import serve  # noqa: E402
from vla_eval.specs import (  # noqa: E402
    GRIPPER_CLOSE_POS, IMAGE_RGB, LANGUAGE, POSITION_DELTA, ROTATION_AA, STATE_EEF_POS_AA_GRIP,
)


class Stub(PredictModelServer):
    """The buffer of chunks and the sessions are those of vla-eval."""

    def predict(self, obs, ctx):
        chunk = stub.infer(obs["images"], {"states": obs["states"]}, obs["task_description"])
        return {"actions": chunk}

    def get_action_spec(self):
        return {"position": POSITION_DELTA, "rotation": ROTATION_AA, "gripper": GRIPPER_CLOSE_POS}

    def get_observation_spec(self):
        return {"image": IMAGE_RGB, "language": LANGUAGE, "state": STATE_EEF_POS_AA_GRIP}

    def get_observation_params(self):
        return {"send_wrist_image": True, "send_state": True}


serve(Stub(chunk_size=options["chunk_size"]), "127.0.0.1", port)
