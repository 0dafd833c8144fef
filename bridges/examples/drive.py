"""Control `robogate serve` with tool deltas: pick up the object and carry it to the target.

    robogate serve                                              # prints its address
    bridges/common/setup.sh .venv                               # once: a Python environment with pyzmq and msgpack
    .venv/bin/python bridges/examples/drive.py tcp://127.0.0.1:5570

A proportional controller for the position of the tool. It uses the details of the task (nominal pose of the object, target) and the
observations. Exit code 0 if every episode is a success.
"""

import argparse
import sys
from pathlib import Path

# Uses the package of this repository, unless another one is installed.
sys.path.append(str(Path(__file__).resolve().parents[1] / "common"))

try:
    from robogate_bridge import Client
except ImportError as missing:
    sys.exit(f"error: {missing}. Run bridges/common/setup.sh .venv, then .venv/bin/python {sys.argv[0]}")

ABOVE, GRASP, LIFT = 0.25, 0.025, 0.25  # heights of the tool above the table, in metres
NEAR = 0.004  # distance to a waypoint at which it is reached, in metres


def unit(x):
    return max(-1.0, min(1.0, x))


class Controller:
    """Follows waypoints. The gripper closes at the third and opens at the seventh."""

    def __init__(self, details, scale):
        x, y, _ = details["object_pose"]["position"]
        u, v, _ = details["target_pose"]["position"]
        self.points = [(x, y, ABOVE, -1), (x, y, GRASP, -1), (x, y, GRASP, 1), (x, y, LIFT, 1),
                       (u, v, LIFT, 1), (u, v, GRASP + 0.004, 1), (u, v, GRASP + 0.004, -1), (u, v, ABOVE, -1)]
        self.scale = scale
        self.waited = 0

    def act(self, observation):
        x, y, z, grip = self.points[0]
        at = observation["vectors"]["tool_pose"][:3]
        off = [goal - is_ for goal, is_ in zip((x, y, z), at)]
        if max(map(abs, off)) < NEAR:
            self.waited += 1
            # The fingers need half a second to close or open.
            moved = len(self.points) > 1 and self.points[1][3] == grip
            if len(self.points) > 1 and self.waited > (2 if moved else 1):
                self.points.pop(0)
                self.waited = 0 if moved else -15
        # Half of the remaining distance, at most one unit (0.02 m) in each control period.
        return [unit(0.5 * d / self.scale) for d in off] + [0.0, 0.0, 0.0, float(grip)]


def episode(client, task, scale, index, parameters):
    start = client.reset(parameters, seed=1, index=index)
    controller = Controller(start["instance"]["details"], scale)
    observation = start["observation"]
    for _ in range(round(task["time_limit_s"] / task["control_period_s"])):
        (step,) = client.step(controller.act(observation))
        for event in step["events"]:
            print(f"  {step['observation']['time_s']:6.2f} s  {event}", file=sys.stderr)
        if step["ending"] is not None:
            return step["ending"]["failure"] or "success"
        observation = step["observation"]
    return "timeout"


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("address", nargs="?", default="tcp://127.0.0.1:5570")
    arguments.add_argument("-n", type=int, default=3, help="number of episodes (default: 3)")
    chosen = arguments.parse_args()
    with Client(chosen.address) as client:
        task = client.hello()["task"]
        scales = [space["translation_m"] for space in task["action"]["spaces"] if space["kind"] == "tool_delta"]
        if task["name"] != "pick_place" or not scales:
            sys.exit(f"error: expected the task pick_place with tool_delta actions; the server has {task['name']}")
        outcomes = []
        for index in range(chosen.n):
            parameters = {"mass_kg": 0.2 + 0.1 * index, "friction": 0.8, "offset_y_m": 0.05 * (index - 1)}
            outcomes.append(episode(client, task, scales[0], index, parameters))
            print(f"episode {index}: {outcomes[-1]}")
    sys.exit(any(outcome != "success" for outcome in outcomes))


if __name__ == "__main__":
    main()
