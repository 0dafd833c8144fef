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

    listed = {path.relative_to(root).as_posix(): path for path in root.rglob("*") if not path.is_dir()}
    with (root / "robot.toml").open("rb") as file:
        wanted = {_last(tomllib.load(file)["model"])}
    found, unknown = {}, False
    while True:
        name = next((n for n in sorted(listed) if unknown or n == "robot.toml" or _LICENCE.match(n) or _last(n) in wanted), None)
        if name is None:
            return found
        content = found[name] = listed.pop(name).read_bytes()
        if content.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<"):
            names = [value.decode(errors="replace") for _, value in _NAMES.findall(_COMMENT.sub(b"", content))]
            # A name that the text alone does not show could be any.
            unknown = unknown or any("&" in value for value in names)
            wanted.update(map(_last, names))


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
