"""Repeats an episode of RoboGate in plain MuJoCo, and compares the motion with the recorded one.

scene.xml is the whole scene; its keyframe `start` is the state at the start. inputs.csv has a row for each time step: the controls of
the actuators; position and speed of the joints of fixtures that move, which are prescribed; and the welds of a suction cup.
trajectory.csv has the positions of all joints at the start and after each step.

    pip install mujoco==@VERSION@ numpy
    python play.py          # prints the largest difference
    python play.py --view   # shows the episode
"""

import argparse
import csv
import pathlib
import time

import mujoco
import numpy

HERE = pathlib.Path(__file__).resolve().parent


def table(name):
    with open(HERE / name, newline="") as file:
        header, *rows = csv.reader(file)
    return header, numpy.array(rows, dtype=float)


def apply(model, data, header, row):
    """Sets the inputs of one time step."""
    for column, value in zip(header, row):
        kind, name = column.split(":", 1)
        if kind == "control":
            data.actuator(name).ctrl = value
        elif kind == "position":
            data.joint(name).qpos = value
        elif kind == "speed":
            data.joint(name).qvel = value
        elif kind == "closed":
            data.eq_active[model.equality(name).id] = value > 0.0
        else:
            model.eq_data[model.equality(name).id, int(kind.removeprefix("weld"))] = value


def play(viewer=None):
    """Returns the largest difference of a joint's position from the recorded one, in metres or radians."""
    model = mujoco.MjModel.from_xml_path(str(HERE / "scene.xml"))
    data = mujoco.MjData(model)
    header, inputs = table("inputs.csv")
    _, trajectory = table("trajectory.csv")
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_forward(model, data)
    shown = viewer(model, data) if viewer else None
    # Fixtures that move are set before each step.
    free = numpy.ones(model.nq, dtype=bool)
    for column in header:
        if column.startswith("position:"):
            free[model.joint(column.split(":", 1)[1]).qposadr] = False
    worst = 0.0
    for step, row in enumerate(inputs):
        apply(model, data, header, row)
        mujoco.mj_step(model, data)
        worst = max(worst, numpy.abs(data.qpos - trajectory[step + 1])[free].max())
        if shown and shown.is_running():
            shown.sync()
            time.sleep(model.opt.timestep)
    return worst, len(inputs)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--view", action="store_true", help="show the episode in MuJoCo's viewer")
    arguments = parser.parse_args()
    if mujoco.__version__ != "@VERSION@":
        print(f"note: this is MuJoCo {mujoco.__version__}, the episode ran in @VERSION@: the motion may differ")
    viewer = None
    if arguments.view:
        import mujoco.viewer

        viewer = mujoco.viewer.launch_passive
    worst, steps = play(viewer)
    print(f"{steps} steps, largest difference of a joint {worst:.3g} m or rad")
