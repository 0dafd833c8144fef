#!/usr/bin/env python3
"""Completes the SBOM in a wheel and writes it to a file.

Usage: scripts/release/sbom.py WHEEL OUTPUT

maturin puts an SBOM of the Rust crates into the wheel (CycloneDX 1.5). This script adds what the wheel contains beyond them (the
MuJoCo library, and the run-time parts that zig links), replaces the path of the source folder, validates the result, and packs the
wheel again.
"""

import hashlib
import json
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator

ROOT = Path(__file__).resolve().parents[2]


def bundled(library: Path) -> "list[dict]":
    """Components that are not Rust crates."""
    mujoco = library.name.removeprefix("libmujoco.so.")
    zig = version("ziglang")
    return [
        {
            "type": "library",
            "bom-ref": f"pkg:pypi/mujoco@{mujoco}",
            "name": "mujoco",
            "version": mujoco,
            "description": f"Physics engine; the file {library.name} of this Python package",
            "scope": "required",
            "hashes": [{"alg": "SHA-256", "content": hashlib.sha256(library.read_bytes()).hexdigest()}],
            "licenses": [{"license": {"id": "Apache-2.0"}}],
            "purl": f"pkg:pypi/mujoco@{mujoco}",
            "externalReferences": [{"type": "vcs", "url": "https://github.com/google-deepmind/mujoco"}],
        },
        {
            "type": "library",
            "bom-ref": f"pkg:pypi/ziglang@{zig}",
            "name": "ziglang",
            "version": zig,
            "description": "C compiler; its libunwind and compiler-rt are linked statically",
            "scope": "required",
            "licenses": [{"expression": "MIT AND Apache-2.0 WITH LLVM-exception"}],
            "purl": f"pkg:pypi/ziglang@{zig}",
        },
    ]


def main() -> None:
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    wheel, output = Path(sys.argv[1]), Path(sys.argv[2])
    pack = [sys.executable, "-m", "wheel"]
    with tempfile.TemporaryDirectory() as work:
        subprocess.run([*pack, "unpack", f"--dest={work}", str(wheel)], check=True, stdout=subprocess.DEVNULL)
        (tree,) = Path(work).iterdir()
        (file,) = tree.glob("*.dist-info/sboms/*.cyclonedx.json")
        (library,) = tree.glob("*.data/data/lib/robogate/libmujoco.so.*")
        sbom = json.loads(file.read_text(encoding="utf-8").replace(f"path+file://{ROOT}/", "path+file:///robogate/"))
        added = bundled(library)
        sbom["components"] += added
        for node in sbom["dependencies"]:
            if node["ref"] == sbom["metadata"]["component"]["bom-ref"]:
                node["dependsOn"] += [component["bom-ref"] for component in added]
        sbom["dependencies"] += [{"ref": component["bom-ref"]} for component in added]
        text = json.dumps(sbom, indent=2) + "\n"
        if str(ROOT) in text:
            sys.exit(f"error: {file.name} contains the path {ROOT} of this machine")
        problem = JsonStrictValidator(SchemaVersion.V1_5).validate_str(text)
        if problem is not None:
            sys.exit(f"error: {file.name} is not valid CycloneDX 1.5: {problem}")
        file.write_text(text, encoding="utf-8")
        output.write_text(text, encoding="utf-8")
        subprocess.run([*pack, "pack", f"--dest-dir={wheel.parent}", str(tree)], check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    main()
