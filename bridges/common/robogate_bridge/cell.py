"""What a server that runs RoboGate's cell needs beside the drives: who touches whom, and what moves by itself."""

from dataclasses import dataclass, fields
from math import inf, sqrt

from .errors import Problem

CONTROL_PERIOD_S = 0.05
TIME_LIMIT_S = 15.0


def physics_hello(server, engine, robot, time_step_s):
    """The reply to `hello` of a server that computes physics for RoboGate's pick-and-place cell.

    `server` and `engine` are the maps of the protocol. `robot` has a name, a hash and joints. No parameters are declared: all
    of them act through the cell, which has the values after all random draws.
    """
    return {
        "server": server,
        "engine": engine,
        "robot": {"name": robot.name, "sha256": robot.sha256},
        "time_step_s": time_step_s,
        "task": {
            "name": "pick_place",
            "instruction": "compute the physics of a pick-and-place cell",
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
    """An observation of an arm with a parallel gripper; `tool_pose` is a pose."""
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
    """Constants of contacts, from the map `contact` of a cell."""

    # Torsional friction is that of a disc of this radius under uniform pressure.
    patch_radius_m: float
    rolling_m: float
    # Of the object's contacts and of joint end stops, at critical damping.
    time_constant_s: float
    # MuJoCo's constraint impedance (the first three numbers of solimp), of the object's contacts and of joint end stops.
    impedance: list[float]
    limit_impedance: list[float]
    # Of a fixture that moves.
    driven_mass_kg: float

    @classmethod
    def of(cls, cell):
        """The constants of a cell."""
        return cls(**{field.name: cell["contact"][field.name] for field in fields(cls)})

    def torsional(self, friction):
        """Torsional friction in metres of a contact with this sliding friction coefficient."""
        return friction * self.patch_radius_m * 2.0 / 3.0


@dataclass(frozen=True)
class Part:
    """What a shape is of: the `robot` (which body; which finger, if one), the `object`, or a `fixture` (by its number).

    The robot's base, which nothing moves, does not meet fixtures: leave such contacts out.
    """

    kind: str
    body: str = ""
    finger: int | None = None
    fixture: int = -1


class Touches:
    """Sums up the contacts of one time step: two bodies may touch at several points, and it is their force together
    that counts."""

    def __init__(self):
        self._fingers = [None, None]
        self._body_on_object = False
        self._object_on_fixture = False
        self._forces = {}
        self.on_object_n = 0.0

    def add(self, one, two, force):
        """A contact of two parts (either may be None: it counts for nothing), and its normal force in newtons."""
        if one is None or two is None or one.kind == two.kind:
            return
        if two.kind == "robot" or (one.kind == "fixture" and two.kind == "object"):
            one, two = two, one
        if "object" in (one.kind, two.kind):
            self.on_object_n += force
        if one.kind == "object":
            self._object_on_fixture = True
            return
        fixture = None
        if two.kind == "fixture":
            fixture = two.fixture
        elif one.finger is None:
            self._body_on_object = True
        else:
            self._fingers[one.finger] = (self._fingers[one.finger] or 0.0) + force
        pair = (one.body, fixture)
        self._forces[pair] = self._forces.get(pair, 0.0) + force

    def sight(self):
        """The part of a sight that contacts make."""
        hits = [(force, pair) for pair, force in self._forces.items() if pair[1] is not None]
        collision = None
        if hits:
            force, (body, fixture) = max(hits, key=lambda hit: hit[0])
            collision = {"robot_body": body, "fixture": fixture, "force_n": force}
        return {
            "fingers": list(self._fingers),
            "body_on_object": self._body_on_object,
            "object_on_fixture": self._object_on_fixture,
            "collision": collision,
            "peak_force_n": max(self._forces.values(), default=None),
        }


class Motion:
    """How a fixture moves: it stands, goes straight at constant speed in a window of time, and stands again."""

    def __init__(self, fixture):
        """Of a fixture of the cell that has a motion."""
        motion = fixture["motion"]
        self._start = fixture["pose"]["position"]
        self._velocity = motion["velocity_m_s"]
        self._window = (motion["starts_s"], max(motion["starts_s"], motion["ends_s"]))

    def position(self, time):
        """Where its middle is then (m)."""
        low, high = self._window
        gone = min(max(time, low), high) - low
        return [x + v * gone for x, v in zip(self._start, self._velocity)]

    def velocity(self, time):
        """Its velocity then (m/s)."""
        low, high = self._window
        return list(self._velocity) if low <= time < high else [0.0, 0.0, 0.0]


def turned(quaternion, vector):
    """A vector turned by a unit quaternion (w, x, y, z)."""
    w, x, y, z = quaternion
    a, b, c = vector
    tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return [a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx]


def combined(one, two):
    """The pose `two`, given in the frame of the pose `one`, where `one` is given."""
    (w, x, y, z), (a, b, c, d) = one["orientation"], two["orientation"]
    position = [p + q for p, q in zip(one["position"], turned(one["orientation"], two["position"]))]
    turn = [
        w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a,
    ]  # fmt: skip
    return {"position": position, "orientation": unit(turn)}


def unit(quaternion):
    """A quaternion of norm 1, out of one that single precision rounded."""
    norm = sqrt(sum(x * x for x in quaternion))
    if not 0.0 < norm < inf:
        raise Problem("diverged", f"an orientation is {list(quaternion)}")
    return [x / norm for x in quaternion]
