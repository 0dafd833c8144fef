"""Shapes of the protocol: each function takes what a simulator answered and returns it in plain numbers, or says what
is wrong. A number that is not finite is `diverged`; anything else is `internal`: the simulator's own mistake."""

from math import isfinite

from . import codec
from .errors import Problem

FAILURES = ("grasp_miss", "grip_loss", "collision", "timeout")
KINDS = ("box", "cylinder", "sphere")


def wrong(where, due):
    return Problem("internal", f"the simulator's answer: {where} must be {due}")


def entry(value, key, where):
    try:
        return value[key]
    except (KeyError, TypeError, IndexError):
        raise wrong(f"{where}.{key}", "there") from None


def number(value, where):
    try:
        x = float(value)
    except (TypeError, ValueError):
        raise wrong(where, f"a number, not {value!r}") from None
    if not isfinite(x):
        raise Problem("diverged", f"{where} is {x}")
    return x


def optional(value, where):
    return None if value is None else number(value, where)


def numbers(value, count, where):
    try:
        out = list(map(float, value))
    except (TypeError, ValueError):
        raise wrong(where, f"{count} numbers") from None
    if len(out) != count:
        raise wrong(where, f"{count} numbers, not {len(out)}")
    if not all(map(isfinite, out)):
        raise Problem("diverged", f"{where} is {out}")
    return out


def flag(value, where):
    if type(value) is not bool and type(value).__name__ not in ("bool", "bool_"):
        raise wrong(where, "true or false")
    return bool(value)


def word(value, where, choices=None):
    if not isinstance(value, str) or len(value.encode()) > codec.MAX_STRING or (choices and value not in choices):
        raise wrong(where, f"one of {', '.join(choices)}" if choices else "a string")
    return value


def words(value, where, most=codec.MAX_ENTRIES):
    if not isinstance(value, (list, tuple)) or len(value) > most:
        raise wrong(where, f"a list of up to {most} strings")
    return [word(item, f"{where}[{i}]") for i, item in enumerate(value)]


def whole(value, where, low=0, high=codec.MAX_NUMBER):
    try:
        n = int(value)
    except (TypeError, ValueError, OverflowError):
        raise wrong(where, "a whole number") from None
    if n != value or not low <= n <= high:
        raise wrong(where, f"a whole number from {low} to {high}, not {value!r}")
    return n


def pose(value, where):
    position = numbers(entry(value, "position", where), 3, f"{where}.position")
    w, x, y, z = orientation = numbers(entry(value, "orientation", where), 4, f"{where}.orientation")
    norm = w * w + x * x + y * y + z * z
    if abs(norm - 1.0) > 2e-6:
        raise wrong(f"{where}.orientation", f"a unit quaternion (w, x, y, z), not {orientation}")
    return {"position": position, "orientation": orientation}


def observation(value, joints, time_s, where="observation"):
    time = number(entry(value, "time_s", where), f"{where}.time_s")
    if abs(time - time_s) > 1e-6:
        raise wrong(f"{where}.time_s", f"{time_s}, not {time}")
    return {
        "time_s": time,
        "joint_positions": numbers(entry(value, "joint_positions", where), joints, f"{where}.joint_positions"),
        "joint_velocities": numbers(entry(value, "joint_velocities", where), joints, f"{where}.joint_velocities"),
        "gripper_opening_m": optional(entry(value, "gripper_opening_m", where), f"{where}.gripper_opening_m"),
        "tool_pose": pose(entry(value, "tool_pose", where), f"{where}.tool_pose"),
    }


def hello(value):
    w = "hello"
    joints = words(entry(value, "joints", w), "hello.joints", codec.MAX_JOINTS)
    judges = flag(entry(value, "judges", w), "hello.judges")
    spaces = words(entry(value, "action_spaces", w), "hello.action_spaces", 2)
    if not joints or not spaces or any(space not in ("joint_position", "tool_delta") for space in spaces):
        raise wrong(w, "with joints, and with action_spaces out of joint_position and tool_delta")
    if not judges and spaces != ["joint_position"]:
        raise wrong("hello.action_spaces", "joint_position alone, as the server does not judge")
    delta = value.get("tool_delta")
    if ("tool_delta" in spaces) != (delta is not None):
        raise wrong("hello.tool_delta", "there exactly where tool_delta is an action space")
    if delta is not None:
        delta = {key: number(entry(delta, key, "hello.tool_delta"), f"hello.tool_delta.{key}")
                 for key in ("translation_m", "rotation_rad")}
    engine, robot = entry(value, "engine", w), entry(value, "robot", w)
    cameras = [
        {
            "name": word(entry(camera, "name", "hello.cameras"), "hello.cameras.name"),
            "width": whole(entry(camera, "width", "hello.cameras"), "hello.cameras.width", 1, codec.MAX_PIXELS),
            "height": whole(entry(camera, "height", "hello.cameras"), "hello.cameras.height", 1, codec.MAX_PIXELS),
        }
        for camera in value.get("cameras", [])
    ]
    if len(cameras) > codec.MAX_CAMERAS:
        raise wrong("hello.cameras", f"{codec.MAX_CAMERAS} at most")
    out = {
        "server": {k: word(entry(value["server"], k, "hello.server"), f"hello.server.{k}") for k in ("name", "version")},
        "engine": {
            "name": word(entry(engine, "name", "hello.engine"), "hello.engine.name"),
            "version": word(entry(engine, "version", "hello.engine"), "hello.engine.version"),
            "solver": None if engine.get("solver") is None else word(engine["solver"], "hello.engine.solver"),
        },
        "robot": {
            "name": word(entry(robot, "name", "hello.robot"), "hello.robot.name"),
            "sha256": None if robot.get("sha256") is None else word(robot["sha256"], "hello.robot.sha256"),
        },
        "joints": joints,
        "action_spaces": spaces,
        "tool_delta": delta,
        "cameras": cameras,
        "quaternion_order": "wxyz",
        "image_origin": "top_left",
        "parameters": words(entry(value, "parameters", w), "hello.parameters", codec.MAX_PARAMETERS),
        "judges": judges,
        "deterministic": flag(entry(value, "deterministic", w), "hello.deterministic"),
    }
    for key in ("time_step_s", "control_period_s", "time_limit_s"):
        out[key] = number(entry(value, key, w), f"hello.{key}")
    steps = out["control_period_s"] / out["time_step_s"] if out["time_step_s"] > 0 else 0
    if steps < 1 or abs(steps - round(steps)) > 1e-6:
        raise wrong("hello.control_period_s", "a whole number of time steps")
    return out


def primitive(value, where):
    kind = word(entry(value, "kind", where), f"{where}.kind", KINDS)
    keys = {"box": (), "cylinder": ("radius", "half_height"), "sphere": ("radius",)}[kind]
    out = {"kind": kind} | {key: number(entry(value, key, where), f"{where}.{key}") for key in keys}
    if kind == "box":
        out["half"] = numbers(entry(value, "half", where), 3, f"{where}.half")
    return out


def motion(value, where):
    if value is None:
        return None
    return {
        "velocity_m_s": numbers(entry(value, "velocity_m_s", where), 3, f"{where}.velocity_m_s"),
        "starts_s": number(entry(value, "starts_s", where), f"{where}.starts_s"),
        "ends_s": number(entry(value, "ends_s", where), f"{where}.ends_s"),
    }


def readback(value):
    w = "readback"
    out = {
        key: number(entry(value, key, w), f"{w}.{key}")
        for key in ("friction", "table_friction", "gravity_m_s2", "mass_kg")
    }
    out["centre_of_mass"] = numbers(entry(value, "centre_of_mass", w), 3, f"{w}.centre_of_mass")
    out["parts"] = [primitive(part, f"{w}.parts[{i}]") for i, part in enumerate(entry(value, "parts", w))]
    out["object_pose"] = pose(entry(value, "object_pose", w), f"{w}.object_pose")
    out["fixtures"] = []
    for i, fixture in enumerate(entry(value, "fixtures", w)):
        at = f"{w}.fixtures[{i}]"
        shape = fixture.get("primitive")
        out["fixtures"].append({
            "fixture": whole(entry(fixture, "fixture", at), f"{at}.fixture"),
            "primitive": None if shape is None else primitive(shape, f"{at}.primitive"),
            "pose": pose(entry(fixture, "pose", at), f"{at}.pose"),
            "motion": motion(fixture.get("motion"), f"{at}.motion"),
        })
    return out


def sight(value, where="sight"):
    fingers = entry(value, "fingers", where)
    if len(fingers) != 2:
        raise wrong(f"{where}.fingers", "two entries")
    collision = entry(value, "collision", where)
    if collision is not None:
        at = f"{where}.collision"
        collision = {
            "robot_body": word(entry(collision, "robot_body", at), f"{at}.robot_body"),
            "fixture": whole(entry(collision, "fixture", at), f"{at}.fixture"),
            "force_n": number(entry(collision, "force_n", at), f"{at}.force_n"),
        }
    velocity = entry(value, "object_velocity", where)
    at = f"{where}.object_velocity"
    return {
        "fingers": [optional(force, f"{where}.fingers") for force in fingers],
        "body_on_object": flag(entry(value, "body_on_object", where), f"{where}.body_on_object"),
        "object_on_fixture": flag(entry(value, "object_on_fixture", where), f"{where}.object_on_fixture"),
        "collision": collision,
        "peak_force_n": optional(entry(value, "peak_force_n", where), f"{where}.peak_force_n"),
        "object_pose": pose(entry(value, "object_pose", where), f"{where}.object_pose"),
        "object_velocity": {
            "linear_m_s": numbers(entry(velocity, "linear_m_s", at), 3, f"{at}.linear_m_s"),
            "angular_rad_s": numbers(entry(velocity, "angular_rad_s", at), 3, f"{at}.angular_rad_s"),
        },
        "tool_pose": pose(entry(value, "tool_pose", where), f"{where}.tool_pose"),
        "opening_m": optional(entry(value, "opening_m", where), f"{where}.opening_m"),
    }


def task(value):
    w = "task"
    out = {key: word(entry(value, key, w), f"{w}.{key}") for key in ("instruction", "shape")}
    for key in ("control_period_s", "time_limit_s", "tolerance_m"):
        out[key] = number(entry(value, key, w), f"{w}.{key}")
    out["object_extent_m"] = numbers(entry(value, "object_extent_m", w), 3, f"{w}.object_extent_m")
    for key in ("object_pose", "target_pose"):
        out[key] = pose(entry(value, key, w), f"{w}.{key}")
    out["approach_speed_m_s"] = optional(value.get("approach_speed_m_s"), f"{w}.approach_speed_m_s")
    return out


def applied(value):
    if not isinstance(value, dict) or len(value) > codec.MAX_PARAMETERS:
        raise wrong("applied", f"a map of up to {codec.MAX_PARAMETERS} parameters")
    out = {}
    for name, item in value.items():
        if isinstance(item, bool):
            raise wrong(f"applied.{name}", "a number or a string")
        out[word(name, "applied")] = item if isinstance(item, (str, int)) else number(item, f"applied.{name}")
    return out


def ending(value, where):
    if value is None:
        return None
    failure, contact = entry(value, "failure", where), entry(value, "contact", where)
    if contact is not None:
        at = f"{where}.contact"
        contact = {
            "robot_body": word(entry(contact, "robot_body", at), f"{at}.robot_body"),
            "other_body": word(entry(contact, "other_body", at), f"{at}.other_body"),
            "force_n": number(entry(contact, "force_n", at), f"{at}.force_n"),
        }
    return {
        "failure": None if failure is None else word(failure, f"{where}.failure", FAILURES),
        "time_s": number(entry(value, "time_s", where), f"{where}.time_s"),
        "contact": contact,
    }


def step(value, joints, time_s, judges, sights, where):
    out = {
        "observation": observation(entry(value, "observation", where), joints, time_s, f"{where}.observation"),
        "state_hash": whole(entry(value, "state_hash", where), f"{where}.state_hash"),
    }
    if judges:
        measures = entry(value, "measures", where)
        out["measures"] = {
            key: optional(measures.get(key), f"{where}.measures.{key}")
            for key in ("peak_contact_force_n", "slip_m", "min_clearance_m", "target_distance_m")
        }
        out["ending"] = ending(entry(value, "ending", where), f"{where}.ending")
        out["events"] = words(value.get("events", []), f"{where}.events")
    else:
        seen = entry(value, "sights", where)
        if len(seen) != sights:
            raise wrong(f"{where}.sights", f"{sights} entries, one for each time step, not {len(seen)}")
        out["sights"] = [sight(one, f"{where}.sights[{i}]") for i, one in enumerate(seen)]
        out["clearance_m"] = optional(entry(value, "clearance_m", where), f"{where}.clearance_m")
    return out
