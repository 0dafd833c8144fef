"""Checks the declarations of a simulator in `hello`: its identity and its task.

Each function returns the declaration with its defaults filled in, or raises a `Problem`. An unknown key is an error, so a misspelt
key is reported when the server starts.
"""

import re

from . import codec
from .shape import entry, flag, integer, number, numbers, plain, text, texts, wrong

NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}\Z")
# These names have another meaning in the outcome column.
RESERVED = ("success", "invalid", "none")


def hello(value):
    """Checks the reply to `hello`."""
    w = "hello"
    known = ("server", "engine", "robot", "time_step_s", "task", "space", "policies", "scores_itself", "deterministic", "records_motion")
    _known(value, known, w)
    robot, step = value.get("robot"), value.get("time_step_s")
    out = {
        "server": {key: text(entry(value["server"], key, f"{w}.server"), f"{w}.server.{key}") for key in ("name", "version")},
        "engine": _engine(entry(value, "engine", w)),
        "robot": None if robot is None else {
            "name": text(entry(robot, "name", f"{w}.robot"), f"{w}.robot.name"),
            "sha256": None if robot.get("sha256") is None else text(robot["sha256"], f"{w}.robot.sha256"),
        },
        "time_step_s": None if step is None else number(step, f"{w}.time_step_s"),
        "task": task(entry(value, "task", w)),
        "space": plain(value.get("space"), f"{w}.space"),
        "policies": _unique([_policy(policy, f"{w}.policies[{i}]") for i, policy in enumerate(value.get("policies", []))], f"{w}.policies"),
        "quaternion_order": "wxyz",
        "image_origin": "top_left",
        "scores_itself": flag(entry(value, "scores_itself", w), f"{w}.scores_itself"),
        "deterministic": flag(entry(value, "deterministic", w), f"{w}.deterministic"),
        "records_motion": flag(value.get("records_motion", False), f"{w}.records_motion"),
    }  # fmt: skip
    period = out["task"]["control_period_s"]
    if step is not None:
        steps = period / out["time_step_s"] if out["time_step_s"] > 0 else 0
        if steps < 1 or abs(steps - round(steps)) > 1e-6:
            raise wrong("hello.task.control_period_s", "an integer multiple of time_step_s")
    if not out["scores_itself"]:
        spaces = out["task"]["action"]["spaces"]
        joints = [space["kind"] for space in spaces] == ["joint_position"] and "gripper" in out["task"]["action"]
        if step is None or not joints:
            raise wrong(w, "with time_step_s, joint_position only and a gripper, as it does not score itself")
    return out


def _engine(value):
    w = "hello.engine"
    engine = {
        "name": text(entry(value, "name", w), f"{w}.name"),
        "version": text(entry(value, "version", w), f"{w}.version"),
        "solver": None if value.get("solver") is None else text(value["solver"], f"{w}.solver"),
    }
    if value.get("sha256") is not None:
        engine["sha256"] = text(value["sha256"], f"{w}.sha256")
    return engine


def task(value):
    """Checks a task."""
    w = "hello.task"
    _known(value, ("name", "version", "instruction", "control_period_s", "time_limit_s", "failure_modes", "measures", "phases",
                   "parameters", "observation", "action", "details"), w)  # fmt: skip
    name = _name(entry(value, "name", w), f"{w}.name")
    modes = [_mode(mode, f"{w}.failure_modes[{i}]") for i, mode in enumerate(value.get("failure_modes", []))]
    measures = [_measure(measure, f"{w}.measures[{i}]") for i, measure in enumerate(value.get("measures", []))]
    parameters = [_parameter(spec, f"{w}.parameters[{i}]") for i, spec in enumerate(value.get("parameters", []))]
    if len(parameters) > codec.MAX_PARAMETERS:
        raise wrong(f"{w}.parameters", f"at most {codec.MAX_PARAMETERS}")
    out = {
        "name": name,
        "version": integer(value.get("version", 1), f"{w}.version", 0, 2**32 - 1),
        "instruction": text(value.get("instruction", name), f"{w}.instruction"),
        "control_period_s": number(entry(value, "control_period_s", w), f"{w}.control_period_s"),
        "time_limit_s": number(entry(value, "time_limit_s", w), f"{w}.time_limit_s"),
        "failure_modes": _unique(modes, f"{w}.failure_modes"),
        "measures": _unique(measures, f"{w}.measures"),
        "phases": [_name(phase, f"{w}.phases[{i}]") for i, phase in enumerate(value.get("phases", []))],
        "parameters": _unique(parameters, f"{w}.parameters"),
        "observation": _observation(value.get("observation", {}), f"{w}.observation"),
        "action": _action(entry(value, "action", w), f"{w}.action"),
    }
    if value.get("details") is not None:
        out["details"] = plain(value["details"], f"{w}.details")
    period, limit = out["control_period_s"], out["time_limit_s"]
    if not (period > 0 and 1 <= round(limit / period) <= codec.MAX_TICKS):
        raise wrong(f"{w}.time_limit_s", f"1 to {codec.MAX_TICKS} control periods")
    return out


def _mode(value, where):
    value = {"name": value} if isinstance(value, str) else value
    _known(value, ("name", "meaning", "severity"), where)
    name = _name(entry(value, "name", where), f"{where}.name")
    if name.lower() in RESERVED:
        raise wrong(f"{where}.name", f"another name than {', '.join(RESERVED)}")
    severity = text(value.get("severity", "major"), f"{where}.severity", ("minor", "major", "critical"))
    return {"name": name, "meaning": text(value.get("meaning", ""), f"{where}.meaning"), "severity": severity}


def _policy(value, where):
    value = {"name": value} if isinstance(value, str) else value
    _known(value, ("name", "meaning", "version"), where)
    name = _name(entry(value, "name", where), f"{where}.name")
    return {"name": name, **{key: text(value.get(key, ""), f"{where}.{key}") for key in ("meaning", "version")}}


def _measure(value, where):
    value = {"name": value} if isinstance(value, str) else value
    _known(value, ("name", "unit", "meaning", "better"), where)
    return {
        "name": _name(entry(value, "name", where), f"{where}.name"),
        "unit": text(value.get("unit", ""), f"{where}.unit"),
        "meaning": text(value.get("meaning", ""), f"{where}.meaning"),
        "better": text(value.get("better", "neither"), f"{where}.better", ("lower", "higher", "neither")),
    }


def _parameter(value, where):
    kind = text(entry(value, "kind", where), f"{where}.kind", ("continuous", "integer", "categorical"))
    keys = ("choices", "open") if kind == "categorical" else ("low", "high")
    _known(value, ("name", "unit", "meaning", "kind", "nominal", "read_from", "family", *keys), where)
    name = text(entry(value, "name", where), f"{where}.name")
    if not re.fullmatch(r"[A-Za-z0-9_]+", name):
        raise wrong(f"{where}.name", "letters, digits and underscores")
    out = {"name": name, "kind": kind}
    for key in ("unit", "meaning", "read_from"):
        out[key] = text(value.get(key, ""), f"{where}.{key}")
    if kind == "categorical":
        out["choices"] = texts(entry(value, "choices", where), f"{where}.choices")
        out["open"] = flag(value.get("open", False), f"{where}.open")
    else:
        convert = number if kind == "continuous" else _signed
        out["low"], out["high"] = (convert(entry(value, key, where), f"{where}.{key}") for key in ("low", "high"))
        if out["low"] > out["high"]:
            raise wrong(where, "with low at most high")
    if value.get("nominal") is not None:
        out["nominal"] = plain(value["nominal"], f"{where}.nominal")
        if (why := refusal(out, out["nominal"])) is not None:
            raise wrong(f"{where}.nominal", why)
    if value.get("family") is not None:
        out["family"] = _name(value["family"], f"{where}.family")
        if "nominal" not in out:
            raise wrong(where, "with a nominal value, because it has a family")
    return out


def refusal(spec, value):
    """The values that a declared parameter expects instead of this value. None if it accepts the value."""
    if spec["kind"] == "categorical":
        if isinstance(value, str) and (spec["open"] or value in spec["choices"]):
            return None
        return f"one of {', '.join(spec['choices'])}"
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if is_number and spec["low"] <= value <= spec["high"] and (spec["kind"] == "continuous" or value == int(value)):
        return None
    kind = "a number" if spec["kind"] == "continuous" else "an integer"
    return f"{kind} from {spec['low']} to {spec['high']}"


def _observation(value, where):
    _known(value, ("vectors", "cameras"), where)
    vectors, cameras = [], []
    for i, vector in enumerate(value.get("vectors", [])):
        at = f"{where}.vectors[{i}]"
        _known(vector, ("name", "length", "unit"), at)
        vectors.append({
            "name": _name(entry(vector, "name", at), f"{at}.name"),
            "length": integer(entry(vector, "length", at), f"{at}.length", 0, codec.MAX_NUMBERS),
            "unit": text(vector.get("unit", ""), f"{at}.unit"),
        })
    for i, camera in enumerate(value.get("cameras", [])):
        at = f"{where}.cameras[{i}]"
        size = {key: integer(entry(camera, key, at), f"{at}.{key}", 1, codec.MAX_PIXELS) for key in ("width", "height")}
        cameras.append({"name": text(entry(camera, "name", at), f"{at}.name"), **size})
    if len(cameras) > codec.MAX_CAMERAS:
        raise wrong(f"{where}.cameras", f"at most {codec.MAX_CAMERAS}")
    return {"vectors": _unique(vectors, f"{where}.vectors"), "cameras": _unique(cameras, f"{where}.cameras")}


def _action(value, where):
    _known(value, ("spaces", "gripper"), where)
    spaces = [_space(space, f"{where}.spaces[{i}]") for i, space in enumerate(entry(value, "spaces", where))]
    if not spaces or len({space["kind"] for space in spaces}) != len(spaces):
        raise wrong(f"{where}.spaces", "at least one, each of another kind")
    out = {"spaces": spaces}
    if value.get("gripper") is not None:
        out["gripper"] = text(value["gripper"], f"{where}.gripper", ("binary", "continuous"))
    return out


def _space(value, where):
    kind = text(entry(value, "kind", where), f"{where}.kind", ("joint_position", "tool_delta", "vector"))
    if kind == "joint_position":
        joints = texts(entry(value, "joints", where), f"{where}.joints", codec.MAX_JOINTS)
        if not joints:
            raise wrong(f"{where}.joints", "at least one")
        return {"kind": kind, "joints": joints}
    if kind == "tool_delta":
        scale = {key: number(entry(value, key, where), f"{where}.{key}") for key in ("translation_m", "rotation_rad")}
        if min(scale.values()) <= 0.0:
            raise wrong(where, "with a positive translation_m and rotation_rad")
        return {"kind": kind, **scale}
    names = texts(entry(value, "names", where), f"{where}.names")
    low, high = (numbers(entry(value, key, where), len(names), f"{where}.{key}") for key in ("low", "high"))
    if not names or any(a >= b for a, b in zip(low, high)):
        raise wrong(where, "a name, a low and a greater high for each number")
    return {"kind": kind, "names": names, "low": low, "high": high}


def _signed(value, where):
    return integer(value, where, -(2**63), 2**63 - 1)


def _name(value, where):
    if not isinstance(value, str) or not NAME.match(value):
        raise wrong(where, f"1 to 64 letters, digits, '_', '-' and '.', not {value!r}")
    return value


def _known(value, keys, where):
    if not isinstance(value, dict):
        raise wrong(where, "a map")
    for key in value:
        if key not in keys:
            raise wrong(where, f"without the key {key!r}; its keys are {', '.join(keys)}")


def _unique(items, where):
    names = [item["name"].lower() for item in items]
    for i, name in enumerate(names):
        if name in names[:i]:
            raise wrong(where, f"without {items[i]['name']!r} twice")
    return items
