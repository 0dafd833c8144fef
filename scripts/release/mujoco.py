#!/usr/bin/env python3
"""Puts the MuJoCo library and its licences into the folder of the Python package.

Usage: scripts/release/mujoco.py ARCHITECTURE (x86_64 or aarch64)

The library comes from the `mujoco` wheel that crates/mujoco-loader pins; pip checks the digest of the wheel.
"""

import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LOADER = ROOT / "crates/mujoco-loader/src"


def library_name() -> str:
    """The file name that the loader expects."""
    found = re.search(r'pub const LIBRARY: &str = "(.+)";', (LOADER / "lib.rs").read_text(encoding="utf-8"))
    if found is None:
        sys.exit(f"error: {LOADER / 'lib.rs'}: no constant LIBRARY")
    return found[1]


def main() -> None:
    if len(sys.argv) != 2 or sys.argv[1] not in ("x86_64", "aarch64"):
        sys.exit(__doc__)
    folder = ROOT / "python/robogate_eval.data"
    licences = ROOT / "python/licenses"
    shutil.rmtree(folder / "data", ignore_errors=True)
    library = folder / "data/lib/robogate" / library_name()
    library.parent.mkdir(parents=True)
    licences.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as work:
        platforms = [f"--platform=manylinux_2_{minor}_{sys.argv[1]}" for minor in (27, 28)]
        subprocess.run(
            [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
            + ["--only-binary=:all:", "--require-hashes", "--python-version=3.11", "--implementation=cp", "--abi=cp311"]
            + [*platforms, f"--dest={work}", f"--requirement={LOADER / 'requirement.txt'}"],
            check=True,
        )
        (wheel,) = Path(work).glob("mujoco-*.whl")
        with zipfile.ZipFile(wheel) as archive:
            library.write_bytes(archive.read(f"mujoco/{library.name}"))
            names = [name for name in archive.namelist() if ".dist-info/licenses/" in name and not name.endswith("/")]
            if not names:
                sys.exit(f"error: {wheel.name}: no licence files")
            for name in names:
                (licences / f"mujoco-{Path(name).name}").write_bytes(archive.read(name))


if __name__ == "__main__":
    main()
