"""Serves one RoboGate process over standard input and output. See `robogate_worlds`."""

import argparse
import json
import os
import sys

import mujoco
import mujoco_warp
import warp as wp

from .group import Group


def main():
    parser = argparse.ArgumentParser(prog="robogate_worlds")
    parser.add_argument("--device", default=None, help="Warp device, for example cpu or cuda:0")
    parser.add_argument("--deterministic", action="store_true", help="give the same bytes on the same card")
    arguments = parser.parse_args()
    # Only replies go to standard output.
    replies = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    wp.config.quiet = True
    wp.init()
    if arguments.device:
        wp.set_device(arguments.device)
    device = wp.get_device()
    groups = {}

    def answer(request):
        match request["do"]:
            case "hello":
                return {
                    "device": device.name, "alias": str(device), "warp": wp.__version__, "mujoco": mujoco.__version__,
                    "mujoco_warp": getattr(mujoco_warp, "__version__", ""), "deterministic": arguments.deterministic,
                }
            case "group":
                group = Group(
                    request["file"], request["model"], request["plan"], request["worlds"], arguments.deterministic
                )
                groups[request["group"]] = group
                return {"layout": group.tables.layout, "fields": group.fields}
            case "step":
                for key, worlds in request["resets"]:
                    groups[key].reset(worlds)
                # All groups are queued before the first result is read.
                for key in request["groups"]:
                    groups[key].begin()
                for key in request["groups"]:
                    groups[key].finish()
                return {}
        raise ValueError(f"unknown request {request['do']!r}")

    for line in sys.stdin:
        try:
            reply = answer(json.loads(line))
        except Exception as why:  # noqa: BLE001 - every failure is a reply
            reply = {"error": f"{type(why).__name__}: {why}"}
        replies.write(json.dumps(reply) + "\n")


if __name__ == "__main__":
    main()
