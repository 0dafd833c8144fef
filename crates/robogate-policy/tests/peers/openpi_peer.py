"""A server with openpi-client's codec, as in openpi's serve_policy.py. Its actions report the received observation."""

import asyncio

import numpy as np
from openpi_client import image_tools, msgpack_numpy
from websockets.asyncio.server import serve


def infer(observation):
    image, wrist = observation["observation/image"], observation["observation/wrist_image"]
    assert image.dtype == np.uint8 and image.shape == wrist.shape == (224, 224, 3), (image.dtype, image.shape)
    # The image that the official client would send: 256 x 256, with increasing bytes.
    counted = np.arange(3 * 256 * 256).astype(np.uint8).reshape(256, 256, 3)
    assert (image == image_tools.resize_with_pad(counted, 224, 224)).all(), "not resized as the official client does"
    state = observation["observation/state"]
    assert state.dtype == np.float64 and state.shape == (8,), state
    row = np.concatenate([state[:6], [len(observation["prompt"])]])
    return {"actions": np.tile(row, (10, 1)), "policy_timing": {"infer_ms": 1.0}}


async def converse(socket):
    packer = msgpack_numpy.Packer()
    await socket.send(packer.pack({"reset_pose": [0.0, -1.5]}))
    async for message in socket:
        await socket.send(packer.pack(infer(msgpack_numpy.unpackb(message))))


async def main():
    # As upstream, except for more frequent pings, so that a test can observe them.
    settings = {"compression": None, "max_size": None, "ping_interval": 0.5, "ping_timeout": 1.5}
    async with serve(converse, "127.0.0.1", 0, **settings) as server:
        print(f"ws://127.0.0.1:{server.sockets[0].getsockname()[1]}", flush=True)
        await server.serve_forever()


asyncio.run(main())
