"""Serves one RoboGate process over standard input and output. See `robogate_worlds`."""

import argparse
import json
import os
import sys
import time

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
    spent = {"periods": 0, "world_periods": 0, "create_s": 0.0, "reset_s": 0.0, "begin_s": 0.0, "finish_s": 0.0}

    def answer(request):
        match request["do"]:
            case "hello":
                return {
                    "device": device.name, "alias": str(device), "warp": wp.__version__, "mujoco": mujoco.__version__,
                    "mujoco_warp": getattr(mujoco_warp, "__version__", ""), "deterministic": arguments.deterministic,
                }
            case "group":
                began = time.perf_counter()
                group = Group(
                    request["file"], request["model"], request["plan"], request["worlds"], arguments.deterministic
                )
                groups[request["group"]] = group
                spent["create_s"] += time.perf_counter() - began
                return {"layout": group.tables.layout, "fields": group.fields}
            case "step":
                began = time.perf_counter()
                for key, worlds in request["resets"]:
                    groups[key].reset(worlds)
                reset = time.perf_counter()
                # All groups are queued before the first result is read.
                for key in request["groups"]:
                    groups[key].begin()
                begun = time.perf_counter()
                for key in request["groups"]:
                    groups[key].finish()
                spent["periods"] += 1
                spent["reset_s"] += reset - began
                spent["begin_s"] += begun - reset
                spent["finish_s"] += time.perf_counter() - begun
                spent["world_periods"] += sum(groups[key].worlds for key in request["groups"])
                return {}
        raise ValueError(f"unknown request {request['do']!r}")

    for line in sys.stdin:
        try:
            reply = answer(json.loads(line))
        except Exception as why:
            reply = {"error": f"{type(why).__name__}: {why}"}
        replies.write(json.dumps(reply) + "\n")
    print(json.dumps({**spent, "groups": [group.worlds for group in groups.values()]}), file=sys.stderr)


if __name__ == "__main__":
    main()
