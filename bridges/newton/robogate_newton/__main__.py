"""Serves the cell in Newton: python -m robogate_newton."""

import argparse
import sys
from pathlib import Path

import warp as wp

# Standard output carries only the address.
wp.config.log_level = wp.LOG_WARNING

from robogate_bridge import CONTROL_PERIOD_S, Problem, serve  # noqa: E402

from .example import example_cell  # noqa: E402
from .robot import Robot  # noqa: E402
from .simulator import ENGINES, Newton  # noqa: E402

ROBOT = Path(__file__).resolve().parents[3] / "assets" / "robots" / "franka"


def main():
    parser = argparse.ArgumentParser(prog="bridges/newton/start.sh", description="Serve RoboGate's cell in Newton, on the CPU.")
    parser.add_argument("--solver", choices=sorted(ENGINES), default="mujoco", help="choose Newton's solver (default: mujoco)")
    parser.add_argument("--robot", type=Path, default=ROBOT, help="use this robot folder (default: assets/robots/franka)")
    parser.add_argument("--port", type=int, default=5570, help="listen on this port; 0 takes a free one (default: 5570)")
    parser.add_argument("--host", default="127.0.0.1", help="listen on this address (default: this machine only)")
    parser.add_argument("--allow-remote", action="store_true", help="allow an address that other machines can reach; the protocol has no authentication")
    parser.add_argument("--time-step", type=float, help="set the time step in seconds (default: that of the solver)")
    parser.add_argument("--compile", action="store_true", help="compile the solver's kernels into the cache and exit")
    args = parser.parse_args()
    step = args.time_step
    if step is not None and not (1e-5 <= step <= CONTROL_PERIOD_S and _whole(CONTROL_PERIOD_S / step)):
        parser.error(f"--time-step: the control period of {CONTROL_PERIOD_S} s must be an integer multiple of it")
    if not 0 <= args.port < 65536:
        parser.error("--port: 0 to 65535")
    try:
        robot = Robot.read(args.robot)
        simulator = Newton(robot, args.solver, step)
        print("starting; the first start compiles kernels, which takes about a minute", file=sys.stderr)
        # Kernels are compiled before a client connects.
        simulator.try_out(example_cell(robot))
    except Problem as problem:
        print(f"error: {problem.detail}", file=sys.stderr)
        return 2
    if not args.compile:
        serve(simulator, f"tcp://{args.host}:{args.port or '*'}", args.allow_remote)
    return 0


def _whole(x):
    return abs(x - round(x)) < 1e-6


if __name__ == "__main__":
    sys.exit(main())
