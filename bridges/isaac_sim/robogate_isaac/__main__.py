"""Serves the cell in Isaac Sim: python.sh -m robogate_isaac. It polls its socket in the main loop, because Isaac Sim must not run in
another thread."""

import argparse
import sys
from pathlib import Path

from robogate_bridge import Problem, serve

from .robot import Robot
from .version import check

ROBOT = Path(__file__).resolve().parents[3] / "assets" / "robots" / "franka"


def main():
    parser = argparse.ArgumentParser(prog="robogate_isaac", description="Serve RoboGate's cell in Isaac Sim 5.1.")
    parser.add_argument("--robot", type=Path, default=ROBOT, help="use this robot folder (default: assets/robots/franka)")
    parser.add_argument("--port", type=int, default=5570, help="listen on this port; 0 takes a free one (default: 5570)")
    parser.add_argument("--host", default="127.0.0.1", help="listen on this address (default: this machine only)")
    parser.add_argument("--allow-remote", action="store_true", help="allow an address that other machines can reach; the protocol has no authentication")
    args = parser.parse_args()
    try:
        robot = Robot.read(args.robot)
    except Problem as problem:
        print(f"error: {problem.detail}", file=sys.stderr)
        return 2
    try:
        from isaacsim import SimulationApp
    except ImportError:
        print("error: this Python has no Isaac Sim. Start the server with Isaac Sim's python.sh", file=sys.stderr)
        return 2
    app = SimulationApp({"headless": True})
    try:
        # Modules of Isaac Sim can be imported only after the app was started.
        from .runtime import Runtime, version
        from .simulator import Isaac

        simulator = Isaac(robot, Runtime, check(version()))
        serve(simulator, f"tcp://{args.host}:{args.port or '*'}", args.allow_remote)
    except Problem as problem:
        print(f"error: {problem.detail}", file=sys.stderr)
        return 2
    finally:
        app.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
