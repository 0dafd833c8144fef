#!/usr/bin/env python3
"""Writes the source distribution: the committed files that `pip install` needs to build the command, in the layout of this repository.

usage: scripts/release/sdist.py OUT

A source distribution of maturin would lack `assets/` and the places from which the crates read them. The layout is kept, so the hash
of the sources that a build records is that of a build from the repository. Needs maturin. SOURCE_DATE_EPOCH is the date of the files.
"""

import gzip
import io
import os
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PARTS = [".cargo", "Cargo.lock", "Cargo.toml", "LICENSE", "README.md", "assets", "crates", "native", "python", "rust-toolchain.toml"]
# The paths of python/pyproject.toml, from the root.
PATHS = {
    'readme = "README.md"': 'readme = "python/README.md"',
    'license-files = ["LICENSE", "licenses/*"]': 'license-files = ["LICENSE"]',
    'manifest-path = "../crates/robogate/Cargo.toml"': 'manifest-path = "crates/robogate/Cargo.toml"',
    'python-source = "src"': 'python-source = "python/src"',
    'data = "robogate_eval.data"': 'data = "python/robogate_eval.data"',
}


def project() -> str:
    text = (ROOT / "python/pyproject.toml").read_text()
    for path, moved in PATHS.items():
        if path not in text:
            sys.exit(f"error: python/pyproject.toml has no line `{path}`")
        text = text.replace(path, moved)
    return text


def metadata() -> str:
    with tempfile.TemporaryDirectory() as folder:
        command = ["maturin", "pep517", "write-dist-info", "--metadata-directory", folder]
        subprocess.run(command, cwd=ROOT / "python", check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        return next(Path(folder).glob("*.dist-info/METADATA")).read_text()


def main() -> None:
    if len(sys.argv) != 2:
        sys.exit(__doc__.split("\n\n")[1])
    about = metadata()
    version = next(line.split()[1] for line in about.splitlines() if line.startswith("Version:"))
    name = f"robogate_eval-{version}"
    date = int(os.environ.get("SOURCE_DATE_EPOCH", "0"))
    archive = subprocess.run(["git", "archive", "HEAD", *PARTS], cwd=ROOT, check=True, capture_output=True).stdout
    out = Path(sys.argv[1]) / f"{name}.tar.gz"
    with out.open("wb") as file, gzip.GzipFile(filename="", fileobj=file, mode="wb", mtime=date) as packed, tarfile.open(
        fileobj=packed, mode="w", format=tarfile.PAX_FORMAT
    ) as target:

        def add(path: str, content: bytes, mode: int = 0o644) -> None:
            entry = tarfile.TarInfo(f"{name}/{path}")
            entry.size, entry.mtime, entry.mode = len(content), date, mode
            target.addfile(entry, io.BytesIO(content))

        add("PKG-INFO", about.encode())
        add("pyproject.toml", project().encode())
        with tarfile.open(fileobj=io.BytesIO(archive)) as source:
            for entry in source:
                if entry.isfile():
                    add(entry.name, source.extractfile(entry).read(), entry.mode)
                elif entry.issym():
                    link = tarfile.TarInfo(f"{name}/{entry.name}")
                    link.type, link.linkname, link.mtime = tarfile.SYMTYPE, entry.linkname, date
                    target.addfile(link)
    print(out)


main()
