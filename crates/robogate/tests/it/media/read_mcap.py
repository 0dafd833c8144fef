"""Reads an MCAP file with the mcap package, an implementation that shares no code with RoboGate, and prints a summary as JSON.

Usage: read_mcap.py FILE
"""

import base64
import json
import sys

from mcap.reader import make_reader


def undeclared(schema, value, path):
    """The paths of all values that a schema does not declare."""
    kind = schema.get("type")
    if isinstance(value, dict):
        if kind != "object":
            return [path]
        known = schema["properties"]
        return [p for k, v in value.items() for p in ([f"{path}.{k}"] if k not in known else undeclared(known[k], v, f"{path}.{k}"))]
    if isinstance(value, list):
        return [path] if kind != "array" else [p for v in value for p in undeclared(schema["items"], v, path)]
    kinds = {"string": str, "integer": int, "number": (int, float), "boolean": bool}
    return [] if isinstance(value, kinds[kind]) else [path]


topics, wrong, last = {}, set(), -1
with open(sys.argv[1], "rb") as file:
    reader = make_reader(file, validate_crcs=True)
    summary = reader.get_summary()
    for schema, channel, message in reader.iter_messages():
        assert message.log_time >= last, "messages are in order of time"
        last = message.log_time
        value = json.loads(message.data)
        topic = topics.setdefault(channel.topic, {"schema": schema.name, "messages": 0, "first": value})
        assert message.sequence == topic["messages"], "sequence numbers have no gap"
        topic["messages"] += 1
        topic["last"] = value
        wrong.update(undeclared(json.loads(schema.data), value, channel.topic))
        if schema.name == "foxglove.CompressedImage":
            assert base64.b64decode(value["data"], validate=True).startswith(b"\x89PNG"), "images are PNG files"
    metadata = {m.name: m.metadata for m in reader.iter_metadata()}
assert sum(t["messages"] for t in topics.values()) == summary.statistics.message_count
for topic in topics.values():
    for value in (topic["first"], topic["last"]):
        value.pop("data", None)
print(json.dumps({"topics": topics, "undeclared": sorted(wrong), "metadata": metadata, "end_ns": last, "chunks": summary.statistics.chunk_count}))
