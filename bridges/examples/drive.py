"""Drives `robogate serve` with 7-D delta actions: picks the object up where it stands and carries it to the target.

    robogate serve                                   # prints its address
    python bridges/examples/drive.py tcp://127.0.0.1:5570

A proportional controller on the tool's position, nothing more: it knows the object's nominal pose and the target's, as the task
tells them, and what it observes. Exit code 0 where every episode was a success.
"""

import argparse
import sys

from robogate_bridge import Client

ABOVE, GRASP, LIFT = 0.25, 0.025, 0.25  # heights of the tool above the table, in metres
NEAR = 0.004  # there, in metres


def unit(x):
    return max(-1.0, min(1.0, x))


class Controller:
    """Goes through way points; the gripper closes at the second and opens at the fifth."""

    def __init__(self, task, scale):
        x, y, _ = task["object_pose"]["position"]
        u, v, _ = task["target_pose"]["position"]
        self.ways = [(x, y, ABOVE, -1), (x, y, GRASP, -1), (x, y, GRASP, 1), (x, y, LIFT, 1),
                     (u, v, LIFT, 1), (u, v, GRASP + 0.004, 1), (u, v, GRASP + 0.004, -1), (u, v, ABOVE, -1)]
        self.scale = scale
        self.waited = 0

    def act(self, observation):
        x, y, z, grip = self.ways[0]
        at = observation["tool_pose"]["position"]
        off = [goal - is_ for goal, is_ in zip((x, y, z), at)]
        if max(map(abs, off)) < NEAR:
            self.waited += 1
            # The fingers need half a second to close or open.
            moved = len(self.ways) > 1 and self.ways[1][3] == grip
            if len(self.ways) > 1 and self.waited > (2 if moved else 1):
                self.ways.pop(0)
                self.waited = 0 if moved else -15
        # Half of the way that is left, at most a unit: 0.02 m a period.
        return [unit(0.5 * d / self.scale) for d in off] + [0.0, 0.0, 0.0, float(grip)]


def episode(client, hello, index, parameters):
    start = client.reset(parameters, seed=1, index=index)
    controller = Controller(start["task"], hello["tool_delta"]["translation_m"])
    observation = start["observation"]
    for _ in range(round(hello["time_limit_s"] / hello["control_period_s"])):
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
    arguments.add_argument("-n", type=int, default=3, help="episodes")
    chosen = arguments.parse_args()
    with Client(chosen.address) as client:
        hello = client.hello()
        if "tool_delta" not in hello["action_spaces"]:
            sys.exit("this server takes no tool deltas")
        outcomes = []
        for index in range(chosen.n):
            parameters = {"mass_kg": 0.2 + 0.1 * index, "friction": 0.8, "offset_y_m": 0.05 * (index - 1)}
            outcomes.append(episode(client, hello, index, parameters))
            print(f"episode {index}: {outcomes[-1]}")
    sys.exit(any(outcome != "success" for outcome in outcomes))


if __name__ == "__main__":
    main()
