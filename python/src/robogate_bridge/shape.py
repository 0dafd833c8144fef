"""Checks the return values of a simulator. Each function returns the value in plain numbers, or raises a `Problem`.

A number that is not finite is `diverged`. Any other error is `internal`: a mistake in the simulator's code.
"""

from math import isfinite

from . import codec
from .errors import Problem

KINDS = ("box", "cylinder", "sphere")


def wrong(where, due):
    return Problem("internal", f"the simulator's reply: {where} must be {due}")


def entry(value, key, where):
    try:
        return value[key]
    except (KeyError, TypeError, IndexError):
        raise wrong(f"{where}.{key}", "present") from None


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


def text(value, where, choices=None):
    if not isinstance(value, str) or len(value.encode()) > codec.MAX_STRING or (choices and value not in choices):
        raise wrong(where, f"one of {', '.join(choices)}" if choices else "a string of at most 4096 bytes")
    return value


def texts(value, where, most=codec.MAX_ENTRIES):
    if not isinstance(value, (list, tuple)) or len(value) > most:
        raise wrong(where, f"a list of up to {most} strings")
    return [text(item, f"{where}[{i}]") for i, item in enumerate(value)]


def integer(value, where, low=0, high=codec.MAX_NUMBER):
    try:
        n = int(value)
    except (TypeError, ValueError, OverflowError):
        raise wrong(where, "an integer") from None
    if n != value or not low <= n <= high:
        raise wrong(where, f"an integer from {low} to {high}, not {value!r}")
    return n


def plain(value, where):
    """Checks data of any structure that a header may contain."""
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, dict):
        return {text(key, where): plain(item, f"{where}.{key}") for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item, f"{where}[{i}]") for i, item in enumerate(value)]
    return value if isinstance(value, int) else number(value, where)


def pose(value, where):
    position = numbers(entry(value, "position", where), 3, f"{where}.position")
    w, x, y, z = orientation = numbers(entry(value, "orientation", where), 4, f"{where}.orientation")
    norm = w * w + x * x + y * y + z * z
    if abs(norm - 1.0) > 2e-6:
        raise wrong(f"{where}.orientation", f"a unit quaternion (w, x, y, z), not {orientation}")
    return {"position": position, "orientation": orientation}


def observation(value, task, time_s, where="observation"):
    """Checks an observation. `time_s` is optional."""
    time = number(value.get("time_s", time_s), f"{where}.time_s")
    if abs(time - time_s) > 1e-6:
        raise wrong(f"{where}.time_s", f"{time_s}, not {time}")
    given = entry(value, "vectors", where)
    at = f"{where}.vectors"
    vectors = {}
    for spec in task["observation"]["vectors"]:
        name = spec["name"]
        vectors[name] = numbers(entry(given, name, at), spec["length"], f"{at}.{name}")
    for name in given:
        if name not in vectors:
            raise wrong(at, f"those that the task declares, which does not declare {name!r}")
    if "tool_pose" in vectors:
        w, x, y, z = vectors["tool_pose"][3:]
        if abs(w * w + x * x + y * y + z * z - 1.0) > 2e-6:
            raise wrong(f"{at}.tool_pose", f"x, y, z and a unit quaternion (w, x, y, z), not {[w, x, y, z]}")
    return {"time_s": time, "vectors": vectors}


def primitive(value, where):
    kind = text(entry(value, "kind", where), f"{where}.kind", KINDS)
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
    out = {key: number(entry(value, key, w), f"{w}.{key}") for key in ("friction", "table_friction", "gravity_m_s2", "grip_force_n")}
    out |= {key: optional(entry(value, key, w), f"{w}.{key}") for key in ("pad_friction", "grip_threshold_m")}
    stiffness = entry(value, "stiffness_nm_rad", w)
    out["stiffness_nm_rad"] = [number(x, f"{w}.stiffness_nm_rad[{i}]") for i, x in enumerate(stiffness)]
    out["objects"] = []
    for i, thing in enumerate(entry(value, "objects", w)):
        at = f"{w}.objects[{i}]"
        out["objects"].append({
            "mass_kg": number(entry(thing, "mass_kg", at), f"{at}.mass_kg"),
            "centre_of_mass": numbers(entry(thing, "centre_of_mass", at), 3, f"{at}.centre_of_mass"),
            "parts": [primitive(part, f"{at}.parts[{k}]") for k, part in enumerate(entry(thing, "parts", at))],
            "pose": pose(entry(thing, "pose", at), f"{at}.pose"),
        })
    out["fixtures"] = []
    for i, fixture in enumerate(entry(value, "fixtures", w)):
        at = f"{w}.fixtures[{i}]"
        shape = fixture.get("primitive")
        out["fixtures"].append({
            "fixture": integer(entry(fixture, "fixture", at), f"{at}.fixture"),
            "primitive": None if shape is None else primitive(shape, f"{at}.primitive"),
            "pose": pose(entry(fixture, "pose", at), f"{at}.pose"),
            "motion": motion(fixture.get("motion"), f"{at}.motion"),
        })
    return out


def sight(value, where="sight"):
    fingers = entry(value, "fingers", where)
    if len(fingers) != 2:
        raise wrong(f"{where}.fingers", "two entries")
    return {
        "object": integer(entry(value, "object", where), f"{where}.object"),
        "fingers": [optional(force, f"{where}.fingers") for force in fingers],
        "body_on_object": flag(entry(value, "body_on_object", where), f"{where}.body_on_object"),
        "object_on_fixture": flag(entry(value, "object_on_fixture", where), f"{where}.object_on_fixture"),
        "support_n": numbers(entry(value, "support_n", where), 3, f"{where}.support_n"),
        "collision": _collision(entry(value, "collision", where), f"{where}.collision"),
        "peak_force_n": optional(entry(value, "peak_force_n", where), f"{where}.peak_force_n"),
        "objects": [_state(state, f"{where}.objects[{i}]") for i, state in enumerate(entry(value, "objects", where))],
        "tool_pose": pose(entry(value, "tool_pose", where), f"{where}.tool_pose"),
        "opening_m": optional(entry(value, "opening_m", where), f"{where}.opening_m"),
        "cup": _cup(value.get("cup"), f"{where}.cup"),
    }


def _collision(value, where):
    if value is None:
        return None
    fixture, other = value.get("fixture"), value.get("other_body")
    return {
        "robot_body": text(entry(value, "robot_body", where), f"{where}.robot_body"),
        "fixture": None if fixture is None else integer(fixture, f"{where}.fixture"),
        "other_body": None if other is None else text(other, f"{where}.other_body"),
        "force_n": number(entry(value, "force_n", where), f"{where}.force_n"),
    }


def _state(value, where):
    return {
        "pose": pose(entry(value, "pose", where), f"{where}.pose"),
        "linear_m_s": numbers(entry(value, "linear_m_s", where), 3, f"{where}.linear_m_s"),
        "angular_rad_s": numbers(entry(value, "angular_rad_s", where), 3, f"{where}.angular_rad_s"),
    }


def _cup(value, where):
    if value is None:
        return None
    return {
        "holding": flag(entry(value, "holding", where), f"{where}.holding"),
        "travel_m": number(entry(value, "travel_m", where), f"{where}.travel_m"),
    }


def instance(value, task):
    """Checks instruction and details of an episode. The default instruction is that of the task."""
    value = value or {}
    out = {"instruction": text(value.get("instruction", task["instruction"]), "instance.instruction")}
    if value.get("details") is not None:
        out["details"] = plain(value["details"], "instance.details")
    return out


def applied(value):
    if not isinstance(value, dict) or len(value) > codec.MAX_PARAMETERS:
        raise wrong("applied", f"a map of up to {codec.MAX_PARAMETERS} parameters")
    out = {}
    for name, item in value.items():
        if isinstance(item, bool):
            raise wrong(f"applied.{name}", "a number or a string")
        out[text(name, "applied")] = item if isinstance(item, (str, int)) else number(item, f"applied.{name}")
    return out


def measures(value, where):
    if not isinstance(value, dict):
        raise wrong(where, "a map from name to number or None")
    return {text(name, where): optional(item, f"{where}.{name}") for name, item in value.items()}


def ending(value, time_s, where):
    """Checks an ending. `failure` is None for a success; any other value is a failure, declared or not."""
    if value is None:
        return None
    failure, contact = entry(value, "failure", where), value.get("contact")
    if contact is not None:
        at = f"{where}.contact"
        contact = {
            "robot_body": text(entry(contact, "robot_body", at), f"{at}.robot_body"),
            "other_body": text(entry(contact, "other_body", at), f"{at}.other_body"),
            "force_n": number(entry(contact, "force_n", at), f"{at}.force_n"),
        }
    return {
        "failure": None if failure is None else str(failure)[:200],
        "time_s": number(value.get("time_s", time_s), f"{where}.time_s"),
        "contact": contact,
    }


def action_length(task, kind):
    """How many numbers an action of this kind has, that of the gripper included. None if the task accepts no such actions."""
    for space in task["action"]["spaces"]:
        if space["kind"] == kind:
            count = 6 if kind == "tool_delta" else len(space["names" if kind == "vector" else "joints"])
            return count + (task["action"].get("gripper") is not None)
    return None


def proposed(value, task, where):
    """Checks the action that a policy of the server proposes."""
    at = f"{where}.proposed"
    kind = entry(value, "action_space", at)
    count = action_length(task, kind)
    if count is None:
        raise wrong(f"{at}.action_space", f"one of {', '.join(space['kind'] for space in task['action']['spaces'])}")
    try:
        return {"action_space": kind, "action": numbers(entry(value, "action", at), count, f"{at}.action")}
    except Problem as problem:
        if problem.kind != "diverged":
            raise
        # The number comes from the policy and not from the physics.
        raise Problem("bad_action", f"the policy proposes an action that is not finite: {problem.detail}") from None


def step(value, hello, time_s, sights, where):
    """Checks one entry of the reply to `step`, without its `state_hash`."""
    out = {"observation": observation(entry(value, "observation", where), hello["task"], time_s, f"{where}.observation")}
    if hello["scores_itself"]:
        out["measures"] = measures(value.get("measures", {}), f"{where}.measures")
        out["ending"] = ending(value.get("ending"), time_s, f"{where}.ending")
        out["events"] = texts(value.get("events", []), f"{where}.events")
    else:
        seen = entry(value, "sights", where)
        if len(seen) != sights:
            raise wrong(f"{where}.sights", f"{sights} entries, one for each time step, not {len(seen)}")
        out["sights"] = [sight(one, f"{where}.sights[{i}]") for i, one in enumerate(seen)]
        out["clearance_m"] = optional(entry(value, "clearance_m", where), f"{where}.clearance_m")
    return out
