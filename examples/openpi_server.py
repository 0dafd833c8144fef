"""Put a policy behind openpi's dialect: pip install msgpack==1.1.2 numpy==2.3.5 websockets==15.0.1, then run this file.

robogate policy check ws://127.0.0.1:8000 --profile examples/openpi_server.toml
"""

import sys

import msgpack
import numpy as np
from websockets.sync.server import serve


def policy(observation):
    """Replace this: pictures (height, width, 3), state and prompt in; actions (chunk, 7) out. This one goes down, hand open."""
    # with torch.inference_mode(): return model(torch.from_numpy(observation["observation/image"]) ...).numpy()
    return np.tile([0.0, 0.0, -0.5, 0.0, 0.0, 0.0, -1.0], (5, 1))


def pack(value):
    if isinstance(value, np.ndarray):
        return {b"__ndarray__": True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}
    raise TypeError(type(value))


def unpack(value):
    if b"__ndarray__" in value:
        return np.frombuffer(value[b"data"], np.dtype(value[b"dtype"])).reshape(value[b"shape"])
    return value


def converse(socket):
    socket.send(msgpack.packb({"model": "an example that goes down"}))
    for message in socket:
        observation = msgpack.unpackb(message, object_hook=unpack)
        socket.send(msgpack.packb({"actions": policy(observation)}, default=pack))


port = int(sys.argv[1]) if len(sys.argv) > 1 else 8000
with serve(converse, "127.0.0.1", port, compression=None, max_size=None) as server:
    print(f"listening on ws://127.0.0.1:{server.socket.getsockname()[1]}", flush=True)
    server.serve_forever()
