"""Records cycles as other programs do: rosbags writes a folder of rosbag2 (CDR), the mcap package writes JSON.

Usage: record.py FOLDER CYCLES
"""

import json
import sys
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

folder, cycles = Path(sys.argv[1]), int(sys.argv[2])
store = get_typestore(Stores.ROS2_HUMBLE)
text = "uint8 GOOD=4\nstd_msgs/Header header\nuint32 serial\nbool[<=3] flags\nstring status\nbuiltin_interfaces/Duration duration\n"
store.register(get_types_from_msg(text, "cell_msgs/msg/Result"))
Result, Header = store.types["cell_msgs/msg/Result"], store.types["std_msgs/msg/Header"]
Time, Duration = store.types["builtin_interfaces/msg/Time"], store.types["builtin_interfaces/msg/Duration"]
Float64, Image = store.types["std_msgs/msg/Float64"], store.types["std_msgs/msg/String"]


def status(i):
    return "jammed" if i % 10 == 9 else "ok"


with Bag(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
    scale = bag.add_connection("/scale", Float64.__msgtype__, typestore=store)
    result = bag.add_connection("/cell/result", Result.__msgtype__, typestore=store)
    camera = bag.add_connection("/camera", Image.__msgtype__, typestore=store)
    for i in range(cycles):
        at = (1795254000 + 4 * i) * 10**9
        message = Result(
            header=Header(stamp=Time(sec=1795254000 + 4 * i, nanosec=0), frame_id="cell"), serial=i, flags=np.array([True, False]), status=status(i),
            duration=Duration(sec=3, nanosec=500000000),
        )
        bag.write(camera, at, store.serialize_cdr(Image(data="x" * 1000), Image.__msgtype__))
        bag.write(scale, at, store.serialize_cdr(Float64(data=0.25 + i), Float64.__msgtype__))
        bag.write(result, at + 1, store.serialize_cdr(message, Result.__msgtype__))
for name, compression in [("zstd", CompressionType.ZSTD), ("lz4", CompressionType.LZ4)]:
    with open(folder / f"{name}.mcap", "wb") as file:
        writer = Writer(file, compression=compression)
        writer.start()
        channels = {
            topic: writer.register_channel(topic, "json", writer.register_schema(topic, "jsonschema", b"{}")) for topic in ["/scale", "/cell/result"]
        }
        for i in range(cycles):
            at = (1795254000 + 4 * i) * 10**9
            stamp = {"sec": 1795254000 + 4 * i, "nanosec": 0}
            message = {"header": {"stamp": stamp}, "serial": i, "status": status(i), "duration": 3.5}
            for topic, value in [("/scale", {"data": 0.25 + i}), ("/cell/result", message)]:
                writer.add_message(channels[topic], log_time=at, publish_time=at, data=json.dumps(value).encode())
        writer.finish()
