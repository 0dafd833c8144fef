"""A policy server with openpi's dialect: it records what it receives in FOLDER, and returns the actions of schedule.py.

An episode starts at action 0 when the server starts; each run has a server of its own. The first requests, with `--skip N`, are checks.
"""

from __future__ import annotations

import sys
from pathlib import Path

import msgpack
import numpy as np
import schedule
from websockets.sync.server import serve

folder, port = Path(sys.argv[1]), int(sys.argv[2])
received = 0


def pack(value):
    return {b"__ndarray__": True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}


def unpack(value):
    marked = b"__ndarray__" in value
    return np.frombuffer(value[b"data"], np.dtype(value[b"dtype"])).reshape(value[b"shape"]) if marked else value


def converse(socket):
    global received
    socket.send(msgpack.packb({}))
    for message in socket:
        request = msgpack.unpackb(message, object_hook=unpack)
        np.savez(folder / f"{received:05}.npz", **{key.replace("/", "."): np.asarray(value) for key, value in request.items()})
        socket.send(msgpack.packb({"actions": schedule.action(received)[None]}, default=pack))
        received += 1


with serve(converse, "127.0.0.1", port, compression=None, max_size=None) as server:
    print("listening", flush=True)
    server.serve_forever()
