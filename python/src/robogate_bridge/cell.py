"""Helpers for servers that run RoboGate's cell: contacts between parts, and moving fixtures."""

from dataclasses import dataclass, fields
from math import inf, sqrt

from .errors import Problem

CONTROL_PERIOD_S = 0.05
TIME_LIMIT_S = 15.0


def physics_hello(server, engine, robot, time_step_s):
    """Returns the reply to `hello` of a server that computes physics for any task of RoboGate's cell.

    `server` and `engine` are the maps of the protocol. `robot` has a name, a hash and joints. No parameters are declared, because
    all of them act through the cell, which contains the values after all random draws.
    """
    return {
        "server": server,
        "engine": engine,
        "robot": {"name": robot.name, "sha256": robot.sha256},
        "time_step_s": time_step_s,
        "task": {
            "name": "cell",
            "instruction": "compute the physics of a cell",
            "control_period_s": CONTROL_PERIOD_S,
            "time_limit_s": TIME_LIMIT_S,
            "observation": {
                "vectors": [
                    {"name": "joint_positions", "length": len(robot.joints), "unit": "rad"},
                    {"name": "joint_velocities", "length": len(robot.joints), "unit": "rad/s"},
                    {"name": "gripper_opening", "length": 1, "unit": "m"},
                    {"name": "tool_pose", "length": 7},
                ]
            },
            "action": {"spaces": [{"kind": "joint_position", "joints": list(robot.joints)}], "gripper": "binary"},
        },
        "scores_itself": False,
        "deterministic": True,
    }


def arm_observation(time_s, joint_positions, joint_velocities, opening_m, tool_pose):
    """Returns an observation of an arm with a parallel gripper. `tool_pose` is a pose."""
    return {
        "time_s": time_s,
        "vectors": {
            "joint_positions": joint_positions,
            "joint_velocities": joint_velocities,
            "gripper_opening": [opening_m],
            "tool_pose": [*tool_pose["position"], *tool_pose["orientation"]],
        },
    }


@dataclass(frozen=True)
class Contact:
    """Contact constants, from the map `contact` of a cell."""

    # Radius of the disc, under uniform pressure, whose torsional friction is used.
    patch_radius_m: float
    rolling_m: float
    # Time constants of the objects' contacts and of joint end stops, at critical damping.
    time_constant_s: float
    # MuJoCo's constraint impedance (the first three numbers of solimp), of the objects' contacts and of joint end stops.
    impedance: list[float]
    limit_impedance: list[float]
    # Mass of a moving fixture.
    driven_mass_kg: float

    @classmethod
    def of(cls, cell):
        """Reads the constants of a cell."""
        return cls(**{field.name: cell["contact"][field.name] for field in fields(cls)})

    def torsional(self, friction):
        """Coefficient of torsional friction, in metres, of a contact with this sliding friction coefficient."""
        return friction * self.patch_radius_m * 2.0 / 3.0


@dataclass(frozen=True)
class Part:
    """The owner of a shape: the `robot` (its body, and finger if any), an `object` or a `fixture` (by its index).

    The fixed base of the robot has no contacts with fixtures: leave such contacts out.
    """

    kind: str
    body: str = ""
    finger: int | None = None
    index: int = -1


class Touches:
    """Sums the contacts of one time step. Two bodies may touch at several points; the total force between them
    counts."""

    def __init__(self, objects):
        """Creates sums without a contact, for this number of objects."""
        self._fingers = [[None, None] for _ in range(objects)]
        self._body_on_object = [False] * objects
        self._supported = [False] * objects
        self._support = [[0.0, 0.0, 0.0] for _ in range(objects)]
        self._forces = {}
        # Sum of the normal forces on each object, in newtons.
        self.on_object_n = [0.0] * objects

    def add(self, one, two, force, push=(0.0, 0.0, 0.0)):
        """Adds a contact of two parts with its normal force in newtons, and the total force `push` on the first part along the
        axes of the base frame. It is ignored if a part is None."""
        if one is None or two is None or one == two or (one.kind == two.kind and one.kind != "object"):
            return
        for part, other, sign in ((one, two, 1.0), (two, one, -1.0)):
            if part.kind != "object":
                continue
            self.on_object_n[part.index] += force
            if other.kind != "robot":
                self._supported[part.index] = True
                self._support[part.index] = [s + sign * p for s, p in zip(self._support[part.index], push)]
        if two.kind == "robot":
            one, two = two, one
        if one.kind != "robot":
            return
        if two.kind == "object":
            if one.finger is None:
                self._body_on_object[two.index] = True
            else:
                fingers = self._fingers[two.index]
                fingers[one.finger] = (fingers[one.finger] or 0.0) + force
        pair = (one.body, two)
        self._forces[pair] = self._forces.get(pair, 0.0) + force

    def sight(self, index=0):
        """The part of a sight that depends on contacts, for a gripper that acts on this object."""
        hits = [(force, pair) for pair, force in self._forces.items() if pair[1].kind == "fixture"]
        collision = None
        if hits:
            force, (body, fixture) = max(hits, key=lambda hit: hit[0])
            collision = {"robot_body": body, "fixture": fixture.index, "force_n": force}
        return {
            "object": index,
            "fingers": list(self._fingers[index]),
            "body_on_object": self._body_on_object[index],
            "object_on_fixture": self._supported[index],
            "support_n": list(self._support[index]),
            "collision": collision,
            "peak_force_n": max(self._forces.values(), default=None),
        }


class Motion:
    """The motion of a fixture: at rest, then straight at constant speed during an interval of time, then at rest."""

    def __init__(self, fixture):
        """Creates the motion of a fixture of the cell."""
        motion = fixture["motion"]
        self._start = fixture["pose"]["position"]
        self._velocity = motion["velocity_m_s"]
        self._window = (motion["starts_s"], max(motion["starts_s"], motion["ends_s"]))

    def position(self, time):
        """Position of its centre at this time (m)."""
        low, high = self._window
        gone = min(max(time, low), high) - low
        return [x + v * gone for x, v in zip(self._start, self._velocity)]

    def velocity(self, time):
        """Its velocity at this time (m/s)."""
        low, high = self._window
        return list(self._velocity) if low <= time < high else [0.0, 0.0, 0.0]


def turned(quaternion, vector):
    """Rotates a vector by a unit quaternion (w, x, y, z)."""
    w, x, y, z = quaternion
    a, b, c = vector
    tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return [a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx]


def object_state(pose, velocity, spin, centre):
    """The state of an object, from the velocity of its centre of mass (m/s) and its angular velocity (rad/s), both along the axes
    of the base frame. `centre` is the centre of mass in the object's frame."""
    x, y, z = turned(pose["orientation"], centre)
    (u, v, w), (a, b, c) = velocity, spin
    return {
        "pose": pose,
        "linear_m_s": [u - (b * z - c * y), v - (c * x - a * z), w - (a * y - b * x)],
        "angular_rad_s": [a, b, c],
    }


def table_friction(cell):
    """Friction coefficient of the objects against the table and the receptacles."""
    return cell["friction"] if cell["table_friction"] is None else cell["table_friction"]


def is_table(fixture):
    """Whether the objects have the table's friction coefficient against a fixture."""
    return fixture["kind"] in ("table", "receptacle")


def parallel_jaw(cell):
    """The gripper of a cell for a server that supports two sliding fingers only. Raises a `Problem` for any other."""
    gripper = cell["robot"]["gripper"]
    if gripper["kind"] != "parallel_jaw" or gripper["finger_joints"] is None:
        raise Problem("setup", "this server supports grippers with two sliding fingers only")
    return gripper


def combined(one, two):
    """Converts the pose `two` from the frame of the pose `one` to the frame of `one`'s parent."""
    (w, x, y, z), (a, b, c, d) = one["orientation"], two["orientation"]
    position = [p + q for p, q in zip(one["position"], turned(one["orientation"], two["position"]))]
    turn = [
        w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a,
    ]  # fmt: skip
    return {"position": position, "orientation": unit(turn)}


def unit(quaternion):
    """Normalises a quaternion that was rounded to single precision."""
    norm = sqrt(sum(x * x for x in quaternion))
    if not 0.0 < norm < inf:
        raise Problem("diverged", f"an orientation is {list(quaternion)}")
    return [x / norm for x in quaternion]
