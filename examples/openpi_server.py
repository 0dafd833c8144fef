"""Put a policy behind openpi's dialect: pip install robogate-eval[policies], then run this file.

robogate policy check ws://127.0.0.1:8000 --profile examples/openpi_server.toml
"""

import sys

import numpy as np
import robogate_eval


def policy(observation):
    """Replace this: pictures (height, width, 3), state and prompt in; actions (chunk, 7) out. This one goes down, hand open."""
    # with torch.inference_mode(): return model(torch.from_numpy(observation["observation/image"]) ...).numpy()
    return np.tile([0.0, 0.0, -0.5, 0.0, 0.0, 0.0, -1.0], (5, 1))


port = sys.argv[1] if len(sys.argv) > 1 else "8000"
robogate_eval.serve(policy, bind=f"ws://127.0.0.1:{port}", batch=1, metadata={"model": "an example that goes down"})
