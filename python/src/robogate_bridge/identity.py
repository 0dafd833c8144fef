"""Hashes of a robot's files and of a simulator's state."""

import hashlib
import re
import struct
from pathlib import Path

# Attributes of MJCF and URDF that name files.
_NAMES = re.compile(rb"""(?<![\w-])(?:file(?:right|left|up|down|front|back|name)?)\s*=\s*(["'])(.*?)\1""", re.DOTALL)
_LICENCE = re.compile(r"(?:licen[cs]e|copying|notice)[^/]*$", re.IGNORECASE)
_COMMENT = re.compile(rb"<!--.*?(?:-->|$)", re.DOTALL)


def _last(path):
    return re.split(r"[/\\]", path.strip())[-1].lower()


def _robot_files(root):
    """robot.toml, the model, each file whose name a model among them contains, and licences, as RoboGate finds them."""
    import tomllib  # From Python 3.11 on, which simulators with robots have.

    by_name = {}
    with (root / "robot.toml").open("rb") as file:
        # These settings and the licences have a key of their own: their places count, not only their names.
        wanted = ["", _last(tomllib.load(file)["model"])]
    for path in root.rglob("*"):
        name = path.relative_to(root).as_posix()
        if not path.is_dir():
            key = "" if name == "robot.toml" or _LICENCE.match(name) else _last(name)
            by_name.setdefault(key, []).append(name)
    found = {}
    while wanted:
        for name in by_name.pop(wanted.pop(), []):
            content = found[name] = (root / name).read_bytes()
            if not content.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<"):
                continue
            for value in (value.decode(errors="replace") for _, value in _NAMES.findall(_COMMENT.sub(b"", content))):
                # A name that the text alone does not show could be any.
                wanted += list(by_name) if "&" in value else [_last(value)]
    return found


def robot_sha256(folder):
    """SHA-256 over the names and contents of the files that define a robot, as RoboGate computes it."""
    digest = hashlib.sha256()
    for name, content in sorted((name.encode(), content) for name, content in _robot_files(Path(folder)).items()):
        for part in (name, content):
            digest.update(len(part).to_bytes(8, "little"))
            digest.update(part)
    return digest.hexdigest()


def state_hash(*numbers):
    """A 64-bit hash of these numbers, which must be the full state of a simulator."""
    state = struct.pack(f"<{len(numbers)}d", *numbers)
    return int.from_bytes(hashlib.blake2b(state, digest_size=8).digest(), "little")
