"""Hashes of a robot's files and of a simulator's state."""

import hashlib
import struct
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


def state_hash(*numbers):
    """A 64-bit hash of these numbers, which must be the full state of a simulator."""
    state = struct.pack(f"<{len(numbers)}d", *numbers)
    return int.from_bytes(hashlib.blake2b(state, digest_size=8).digest(), "little")
