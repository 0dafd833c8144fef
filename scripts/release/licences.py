#!/usr/bin/env python3
"""Writes the licences of the Rust crates in the command, of Rust's standard library, and of zig's run-time parts, into the folder of
the Python package.

Usage: scripts/release/licences.py ARCHITECTURE (x86_64 or aarch64)

The crates are those that the command contains with all features on that architecture, from Cargo.lock. A text that several crates
share is written once.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import ziglang

ROOT = Path(__file__).resolve().parents[2]
LICENCES = ROOT / "python/licenses"
TITLES = ("LICENSE", "LICENCE", "COPYING", "COPYRIGHT", "UNLICENSE")


def crates(architecture: str) -> "list[dict]":
    """The packages of cargo metadata that the command contains, without those of this workspace, sorted by name and version."""
    metadata = json.loads(
        subprocess.run(
            ["cargo", "metadata", "--format-version=1", "--locked", "--features=robogate/full"]
            + [f"--filter-platform={architecture}-unknown-linux-gnu"],
            cwd=ROOT,
            check=True,
            stdout=subprocess.PIPE,
        ).stdout
    )
    packages = {package["id"]: package for package in metadata["packages"]}
    dependencies = {node["id"]: node["deps"] for node in metadata["resolve"]["nodes"]}
    seen: "set[str]" = set()
    open_ids = [package["id"] for package in packages.values() if package["name"] == "robogate"]
    while open_ids:
        this = open_ids.pop()
        if this not in seen:
            seen.add(this)
            # Build scripts and tests are not in the command.
            used = (d for d in dependencies[this] if any(kind["kind"] is None for kind in d["dep_kinds"]))
            open_ids += [dependency["pkg"] for dependency in used]
    foreign = (packages[this] for this in seen if packages[this]["source"])
    return sorted(foreign, key=lambda package: (package["name"], package["version"]))


def texts(package: dict) -> "list[str]":
    """The licence texts and notices in the folder of a crate."""
    folder = Path(package["manifest_path"]).parent
    files = [file for file in sorted(folder.iterdir()) if file.is_file() and file.name.upper().startswith((*TITLES, "NOTICE"))]
    licences = [file for file in files if not file.name.upper().startswith("NOTICE")]
    found = [file.read_text(encoding="utf-8", errors="replace").strip() for file in files]
    if not licences:
        # The text of the Apache licence does not name the authors, so it is the same for every crate.
        if "Apache-2.0" not in (package["license"] or ""):
            sys.exit(f"error: {package['name']} {package['version']}: no licence file, and its licence is {package['license']}. Expected Apache-2.0")
        found.append((LICENCES / "mujoco-LICENSE").read_text(encoding="utf-8").strip())
    return found


def main() -> None:
    if len(sys.argv) != 2 or sys.argv[1] not in ("x86_64", "aarch64"):
        sys.exit(__doc__)
    users: "dict[str, list[str]]" = {}
    lines = ["Licences of the Rust crates in the command `robogate`. Each crate is listed with its licence; the texts follow.", ""]
    for package in crates(sys.argv[1]):
        name = f"{package['name']} {package['version']}"
        lines.append(f"{name}: {package['license']} {package['repository'] or ''}".rstrip())
        for text in dict.fromkeys(texts(package)):
            users.setdefault(text, []).append(name)
    for text, names in users.items():
        lines += ["", "=" * 100, ", ".join(names), "=" * 100, "", text]
    LICENCES.mkdir(exist_ok=True)
    (LICENCES / "rust-crates-LICENSES.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    sysroot = subprocess.run(["rustc", "--print", "sysroot"], check=True, stdout=subprocess.PIPE, text=True).stdout.strip()
    shutil.copy(Path(sysroot) / "share/doc/rust/COPYRIGHT-library.html", LICENCES / "rust-library-COPYRIGHT.html")
    # zig links its compiler-rt and LLVM's libunwind.
    zig = Path(ziglang.__file__).parent
    shutil.copy(zig / "LICENSE", LICENCES / "zig-LICENSE")
    shutil.copy(zig / "lib/libunwind/LICENSE.TXT", LICENCES / "zig-libunwind-LICENSE.TXT")


if __name__ == "__main__":
    main()
