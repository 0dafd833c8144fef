"""python.sh -m robogate_isaac: serves the cell in Isaac Sim. It polls its socket in the main loop: Isaac Sim is not to be
threaded."""

import argparse
import sys
from pathlib import Path

from robogate_bridge import Problem, serve

from .robot import Robot
from .version import check

ROBOT = Path(__file__).resolve().parents[3] / "assets" / "robots" / "franka"


def main():
    parser = argparse.ArgumentParser(prog="robogate_isaac", description="RoboGate's cell in Isaac Sim 5.1.")
    parser.add_argument("--robot", type=Path, default=ROBOT, help="folder of the robot (default: assets/robots/franka)")
    parser.add_argument("--port", type=int, default=5570, help="port; 0 takes a free one (default: 5570)")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this machine alone)")
    parser.add_argument("--allow-remote", action="store_true", help="let other machines in: there is no authentication")
    args = parser.parse_args()
    try:
        robot = Robot.read(args.robot)
    except Problem as problem:
        print(f"error: {problem.detail}", file=sys.stderr)
        return 2
    try:
        from isaacsim import SimulationApp
    except ImportError:
        print("error: there is no Isaac Sim in this Python; start it with Isaac Sim's own python.sh", file=sys.stderr)
        return 2
    app = SimulationApp({"headless": True})
    try:
        # Nothing of Isaac Sim can be imported before the app runs.
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
