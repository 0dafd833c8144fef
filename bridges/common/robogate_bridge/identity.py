"""The identity of a robot: a hash over its files."""

import hashlib
from pathlib import Path


def robot_sha256(folder):
    """SHA-256 over every file below `folder`, names and contents, as RoboGate computes it."""
    root = Path(folder)
    files = sorted((path.relative_to(root).as_posix().encode(), path) for path in root.rglob("*") if path.is_file())
    digest = hashlib.sha256()
    for name, path in files:
        content = path.read_bytes()
        for part in (name, content):
            digest.update(len(part).to_bytes(8, "little"))
            digest.update(part)
    return digest.hexdigest()
