#!/usr/bin/env python3
"""Put the MuJoCo library and its licences into the folders of the Python package.

Usage: scripts/release/mujoco.py ARCHITECTURE (x86_64 or aarch64). pip checks the digest of the downloaded wheel.
"""

import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
REQUIREMENT = ROOT / "crates/mujoco-loader/src/requirement.txt"
LIBRARY = "libmujoco.so.3.17.0"


def main() -> None:
    if len(sys.argv) != 2 or sys.argv[1] not in ("x86_64", "aarch64"):
        sys.exit(__doc__)
    library = ROOT / "python/robogate_eval.data/data/lib/robogate" / LIBRARY
    licences = ROOT / "python/licenses"
    for folder in (library.parent, licences):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
    with tempfile.TemporaryDirectory() as work:
        platforms = [f"--platform=manylinux_2_{minor}_{sys.argv[1]}" for minor in (27, 28)]
        subprocess.run(
            [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
            + ["--only-binary=:all:", "--require-hashes", "--python-version=3.11", "--implementation=cp", "--abi=cp311"]
            + [*platforms, f"--dest={work}", f"--requirement={REQUIREMENT}"],
            check=True,
        )
        (wheel,) = Path(work).glob("mujoco-*.whl")
        with zipfile.ZipFile(wheel) as archive:
            library.write_bytes(archive.read(f"mujoco/{LIBRARY}"))
            for name in archive.namelist():
                if ".dist-info/licenses/" in name and not name.endswith("/"):
                    (licences / f"mujoco-{Path(name).name}").write_bytes(archive.read(name))
    shutil.copy(ROOT / "LICENSE", ROOT / "python/LICENSE")


if __name__ == "__main__":
    main()
