#!/usr/bin/env python3
"""Writes assets/robots/ur3e, ur5e and ur10e from published data of Universal Robots.

Kinematics: standard Denavit-Hartenberg parameters; masses and centres of mass: "DH parameters for
calculations of kinematics and dynamics"; torques: "Max. joint torques"; speeds, reach and payload: the user
manuals; inertias of the UR3e and UR5e: the manufacturer's ROS 2 description (off-diagonals left out).
The UR10e's inertias are estimated as those of solid cylinders of the links' lengths, 0.075 m in radius
(0.045 m for the last). Needs only Python's standard library.
"""

import math
from pathlib import Path

ALPHA = (1, 0, 0, 1, -1, 0)  # in right angles
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
HOME = (0.0, -90.0, 90.0, -90.0, -90.0, 0.0)  # degrees

# The suction tool: a plate on the flange, a stem, the cup. RoboGate chose its size and mass.
TCP, CUP_LENGTH, CUP_RADIUS = 0.12, 0.02, 0.02
# The spring of the cup along its axis: how far the lip can be pressed back (m) and the stiffness (N/m).
# RoboGate chose both for a bellows cup of this size; the data sheet of a cup states its own.
STROKE, STIFFNESS = 0.01, 3000.0

ROBOTS = {
    "ur3e": dict(
        d=(0.15185, 0.0, 0.0, 0.13105, 0.08535, 0.0921),
        a=(0.0, -0.24355, -0.2132, 0.0, 0.0, 0.0),
        mass=(1.98, 3.4445, 1.437, 0.871, 0.805, 0.261),
        com=((0, -0.02, 0), (0.13, 0, 0.1157), (0.05, 0, 0.0238), (0, 0, 0.01), (0, 0, 0.01), (0, 0, -0.02)),
        inertia=((0.0027657, 0.0021501, 0.0025626), (0.0042623, 0.0460284, 0.0448947),
                 (0.0010511, 0.0113396, 0.0110895), (0.0008174, 0.0006844, 0.0005497),
                 (0.0006059, 0.0005837, 0.0003831), (0.0001080, 0.0001086, 0.0001371)),
        speed=(180, 180, 180, 360, 360, 360), torque=(56, 56, 28, 12, 12, 12),
        stiffness=(4500, 4500, 3500, 2000, 2000, 2000), damping=(300, 300, 250, 100, 100, 100),
        reach=0.5, payload=3.0,
        # Radii: base (the footprint), shoulder and elbow, upper arm, forearm, wrist; and the lateral
        # offsets of the middles of upper arm and forearm.
        base=0.064, joint=0.045, upper=0.037, fore=0.033, wrist=0.034, shoulder_offset=0.12, elbow_offset=0.027,
    ),
    "ur5e": dict(
        d=(0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996),
        a=(0.0, -0.425, -0.3922, 0.0, 0.0, 0.0),
        mass=(3.761, 8.058, 2.846, 1.37, 1.3, 0.365),
        com=((0, -0.02561, 0.00193), (0.2125, 0, 0.11336), (0.15, 0, 0.0265), (0, -0.0018, 0.01634),
             (0, 0.0018, 0.01634), (0, 0, -0.001159)),
        inertia=((0.0070021, 0.0064809, 0.0065729), (0.0150589, 0.3338809, 0.3324721),
                 (0.0039963, 0.0787925, 0.0784851), (0.0016549, 0.0013596, 0.0012628),
                 (0.0013562, 0.0012783, 0.0009661), (0.0001869, 0.0001891, 0.0002576)),
        speed=(180, 180, 180, 180, 180, 180), torque=(150, 150, 150, 28, 28, 28),
        stiffness=(10000, 10000, 10000, 3000, 3000, 3000), damping=(700, 700, 600, 150, 150, 150),
        reach=0.85, payload=5.0,
        base=0.0745, joint=0.06, upper=0.054, fore=0.045, wrist=0.04, shoulder_offset=0.138, elbow_offset=0.007,
    ),
    "ur10e": dict(
        d=(0.1807, 0.0, 0.0, 0.17415, 0.11985, 0.11655),
        a=(0.0, -0.6127, -0.57155, 0.0, 0.0, 0.0),
        mass=(7.369, 13.051, 3.989, 2.1, 1.98, 0.615),
        com=((0.021, 0, 0.027), (0.38, 0, 0.158), (0.24, 0, 0.068), (0, 0.007, 0.018), (0, 0.007, 0.018),
             (0, 0, -0.026)),
        inertia=None,
        speed=(120, 120, 180, 180, 180, 180), torque=(330, 330, 150, 56, 56, 56),
        stiffness=(30000, 30000, 20000, 5000, 5000, 5000), damping=(2500, 2500, 1500, 250, 250, 250),
        reach=1.3, payload=12.5,
        base=0.095, joint=0.075, upper=0.063, fore=0.05, wrist=0.047, shoulder_offset=0.1762, elbow_offset=0.0393,
    ),
}


def text(*values):
    return " ".join(f"{value:.10g}" for value in values)


def cylinder_inertia(mass, length, radius, axis):
    """Principal moments of a solid cylinder along x (0), y (1) or z (2)."""
    along, across = 0.5 * mass * radius**2, mass * (3 * radius**2 + length**2) / 12
    return tuple(along if i == axis else across for i in range(3))


def estimated_inertia(robot):
    """Estimates the inertias as solid cylinders. The long axes of the links in their frames are y, x, x, y, y, z."""
    d, a = robot["d"], robot["a"]
    length = (d[0], -a[1], -a[2], d[3], d[4], d[5])
    return [
        cylinder_inertia(mass, length[i], 0.045 if i == 5 else 0.075, (1, 0, 0, 1, 1, 2)[i])
        for i, mass in enumerate(robot["mass"])
    ]


def tube(kind, name, start, end, radius):
    return f'<geom name="{name}" type="{kind}" fromto="{text(*start, *end)}" size="{text(radius)}"/>'


def shapes(robot, link):
    """Collision shapes of a link in its Denavit-Hartenberg frame, which is at the far end of the link."""
    d, a = robot["d"], robot["a"]
    joint, wrist = robot["joint"], robot["wrist"]
    side, near = robot["shoulder_offset"], robot["elbow_offset"]
    upper, fore = -a[1], -a[2]
    return {
        "shoulder": [
            tube("cylinder", "shoulder", (0, -joint, 0), (0, joint, 0), joint),
            tube("cylinder", "shoulder_side", (0, 0, 0), (0, 0, side - joint), joint),
        ],
        "upper_arm": [
            tube("capsule", "upper_arm_shoulder", (upper, 0, side - 0.2 * joint), (upper, 0, side + 0.2 * joint), joint),
            tube("capsule", "upper_arm", (upper, 0, side), (0, 0, side), robot["upper"]),
            tube("cylinder", "upper_arm_elbow", (0, 0, side - joint), (0, 0, side + joint), robot["upper"]),
        ],
        "forearm": [
            tube("capsule", "forearm", (fore, 0, near), (0, 0, near), robot["fore"]),
        ],
        # The lateral part, then the housing along the axis of the next joint.
        "wrist_1": [
            tube("capsule", "wrist_1", (0, -(d[3] - near), 0), (0, 0, 0), wrist),
        ],
        "wrist_2": [
            tube("capsule", "wrist_2", (0, 0.5 * d[4], 0), (0, 0, 0), wrist),
        ],
        "wrist_3": [
            tube("cylinder", "wrist_3", (0, 0, -d[5] + wrist), (0, 0, 0), min(wrist, 0.0375)),
        ],
    }[link]


def model(name, robot):
    inertia = robot["inertia"] or estimated_inertia(robot)
    lines, depth = [], 2

    def put(line):
        lines.append("  " * depth + line)

    put('<body name="base" quat="0 0 0 1" childclass="arm">')
    depth += 1
    top = robot["d"][0] - robot["joint"]
    put(f'<geom name="base" type="cylinder" fromto="{text(0, 0, 0, 0, 0, top)}" size="{text(robot["base"])}" mass="0"/>')
    for i, link in enumerate(LINKS):
        d, a, right = robot["d"][i], robot["a"][i], ALPHA[i]
        quat = f' quat="1 {right} 0 0"' if right else ""
        put(f'<body name="{link}" pos="{text(a, 0, d)}"{quat}>')
        depth += 1
        put(f'<inertial mass="{text(robot["mass"][i])}" pos="{text(*robot["com"][i])}" diaginertia="{text(*inertia[i])}"/>')
        # The joint rotates about the z axis of the previous frame, Rx(-alpha) z, through its origin.
        axis, at = ((0, right, 0), (-a, -d * right, 0)) if right else ((0, 0, 1), (-a, 0, -d))
        limit = "elbow" if JOINTS[i] == "elbow" else "turn"
        put(f'<joint name="{JOINTS[i]}" class="{limit}" pos="{text(*(x + 0.0 for x in at))}" axis="{text(*axis)}"/>')
        for shape in shapes(robot, link):
            put(shape)
    put('<site name="flange"/>')
    put('<body name="suction_tool" childclass="tool">')
    depth += 1
    put('<inertial mass="0.2" pos="0 0 0.04" diaginertia="0.0002 0.0002 0.00005"/>')
    put('<geom name="suction_plate" type="cylinder" fromto="0 0 0 0 0 0.014" size="0.0315"/>')
    put(f'<geom name="suction_stem" type="cylinder" fromto="{text(0, 0, 0.014, 0, 0, TCP - CUP_LENGTH)}" size="0.012"/>')
    put(f'<body name="suction_cup" pos="{text(0, 0, TCP - CUP_LENGTH)}">')
    depth += 1
    put('<inertial mass="0.03" pos="0 0 0.01" diaginertia="0.000005 0.000005 0.000006"/>')
    put(f'<geom name="suction_cup" type="cylinder" fromto="{text(0, 0, 0, 0, 0, CUP_LENGTH)}" size="{text(CUP_RADIUS)}" rgba="0.15 0.15 0.16 1"/>')
    put(f'<site name="tcp" pos="{text(0, 0, CUP_LENGTH)}"/>')
    while depth > 2:
        depth -= 1
        put("</body>")
    body = "\n".join(lines)
    inertias = (
        "the manufacturer's ROS 2 description, off-diagonals left out"
        if robot["inertia"]
        else "estimated as solid cylinders of the links' lengths, 0.075 m in radius (0.045 m for the last)"
    )
    return f"""<!--
  Universal Robots {name.upper()[:-1]}e with a suction cup. Written by scripts/ur_robots.py; change it there.

  Kinematics: the manufacturer's standard Denavit-Hartenberg parameters. A link's frame is its DH frame: its body
  stands in the parent's at Tz(d) Tx(a) Rx(alpha), and its joint turns about the parent's z. The base is turned by
  half a turn about z, as in the manufacturer's ROS description, so that at joint angle 0 the arm faces +x.
  Masses, centres of mass: "DH parameters for calculations of kinematics and dynamics".
  Inertias: {inertias}.
  The base does not move: its mass is left out. Collision shapes are capsules and cylinders along the links,
  their radii rounded from the arm's outline; the base's is the footprint. The cup's lip is at the site tcp.

  Drives are not here: gains, speeds and limits that MJCF cannot say stand in robot.toml.
-->
<mujoco model="{name}">
  <compiler angle="radian"/>

  <default>
    <default class="arm">
      <joint type="hinge" armature="0.1" damping="1"/>
      <geom rgba="0.75 0.77 0.8 1"/>
      <default class="turn">
        <joint range="-6.283185307179586 6.283185307179586"/>
      </default>
      <default class="elbow">
        <joint range="-3.141592653589793 3.141592653589793"/>
      </default>
    </default>
    <default class="tool">
      <geom rgba="0.35 0.35 0.38 1"/>
    </default>
  </default>

  <worldbody>
{body}
  </worldbody>
</mujoco>
"""


def array(values):
    return "[" + ", ".join(repr(float(value)) for value in values) + "]"


def settings(name, robot):
    radians = lambda degrees: [round(math.radians(x), 6) for x in degrees]
    joints = ", ".join(f'"{joint}"' for joint in JOINTS)
    return f"""# What MJCF cannot say about the {name.upper()[:-1]}e. Arrays have one entry per arm joint, base to tip.
# Written by scripts/ur_robots.py; change it there.
name = "{name}"
model = "{name}.xml"

[arm]
joints = [{joints}]
# The elbow up, the tool down.
home_rad = {array(radians(HOME))}
velocity_limit_rad_s = {array(radians(robot["speed"]))}
# The manufacturer states none; this is what its MoveIt configuration plans with.
acceleration_limit_rad_s2 = {array([5.0] * 6)}
torque_limit_nm = {array(robot["torque"])}
# The joint servo: torque = stiffness (q_ref - q) + damping (dq_ref - dq). The arm's own weight is compensated.
stiffness_nm_rad = {array(robot["stiffness"])}
damping_nms_rad = {array(robot["damping"])}
flange_site = "flange"
tcp_site = "tcp"
reach_m = {robot["reach"]}
payload_kg = {robot["payload"]}

[gripper]
kind = "suction"
# The body that carries the cup; the cup's lip is at tcp_site.
cup_body = "suction_cup"
cup_diameter_m = {2 * CUP_RADIUS}
vacuum_pa = 60000.0

# The spring of the cup along its axis. RoboGate chose both figures; the data sheet of your cup states its own.
[gripper.bellows]
stroke_m = {STROKE}
stiffness_n_m = {STIFFNESS}
"""


def main():
    robots = Path(__file__).resolve().parent.parent / "assets" / "robots"
    for name, robot in ROBOTS.items():
        folder = robots / name
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.xml").write_text(model(name, robot), encoding="utf-8")
        (folder / "robot.toml").write_text(settings(name, robot), encoding="utf-8")


if __name__ == "__main__":
    main()
