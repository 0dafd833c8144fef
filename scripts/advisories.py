"""Checks Cargo.lock against a copy of the RustSec advisory database, without a network.

    git clone https://github.com/rustsec/advisory-db      # or any copy, also a bare one
    python3 scripts/advisories.py advisory-db

The hosted checks run `cargo deny check advisories`, which downloads the database. `.ci/run` needs no network beside the package
registries, so it leaves this out. Prints each advisory for a locked version and exits with 1 if there is a vulnerability.
Notices about unmaintained crates do not count.
"""

import pathlib
import re
import subprocess
import sys
import tomllib


def advisories(database):
    """The TOML part of each advisory about a crate."""
    folder = pathlib.Path(database)
    if (folder / "crates").is_dir():
        texts = [path.read_text(encoding="utf-8") for path in sorted(folder.glob("crates/*/*.md"))]
    else:
        git = ["git", "-C", str(folder)]
        names = subprocess.run([*git, "ls-tree", "-r", "--name-only", "HEAD", "crates"], check=True, capture_output=True, text=True)
        names = [name for name in names.stdout.splitlines() if name.endswith(".md")]
        batch = subprocess.run([*git, "cat-file", "--batch"], check=True, capture_output=True,
                               input="".join(f"HEAD:{name}\n" for name in names).encode())
        texts, rest = [], batch.stdout
        for _ in names:
            head, rest = rest.split(b"\n", 1)
            size = int(head.split()[-1])
            texts.append(rest[:size].decode())
            rest = rest[size + 1:]
    for text in texts:
        found = re.search(r"```toml\n(.*?)```", text, re.DOTALL)
        if found:
            yield tomllib.loads(found.group(1))


def version(text):
    """A version as a tuple that compares like SemVer: a pre-release is smaller than its release."""
    core, _, pre = text.split("+")[0].partition("-")
    numbers = tuple(int(part) for part in core.split("."))
    numbers += (0,) * (3 - len(numbers))
    parts = tuple((0, int(p), "") if p.isdigit() else (1, 0, p) for p in pre.split(".")) if pre else ()
    return numbers, not pre, parts


def matches(found, requirement):
    """Whether a version fulfils a requirement such as `>= 1.2, < 2` or `^0.3.1`."""
    for part in requirement.split(","):
        operator, wanted = re.fullmatch(r"\s*(>=|<=|>|<|=|\^|~)?\s*(\S+)\s*", part).groups()
        if wanted == "*":
            continue
        least = version(wanted)
        if operator in (None, "^", "~"):
            major, minor, patch = least[0]
            if operator == "~":
                next_one = (major, minor + 1, 0)
            else:
                next_one = (major + 1, 0, 0) if major else (0, minor + 1, 0) if minor else (0, 0, patch + 1)
            holds = least <= found and found[0] < next_one
        else:
            holds = {">=": found >= least, "<=": found <= least, ">": found > least, "<": found < least, "=": found == least}[operator]
        if not holds:
            return False
    return True


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    lock = tomllib.loads(pathlib.Path(__file__).parent.parent.joinpath("Cargo.lock").read_text(encoding="utf-8"))
    packages = {}
    for package in lock["package"]:
        if "source" in package:
            packages.setdefault(package["name"], []).append(package["version"])
    read = vulnerable = 0
    for document in advisories(sys.argv[1]):
        read += 1
        about, versions = document["advisory"], document.get("versions", {})
        if "withdrawn" in about:
            continue
        for locked in packages.get(about["package"], []):
            fine = versions.get("patched", []) + versions.get("unaffected", [])
            if any(matches(version(locked), requirement) for requirement in fine):
                continue
            kind = about.get("informational")
            print(f"{about['id']}: {about['package']} {locked}: {kind or 'vulnerability'} ({about['date']})")
            vulnerable += kind is None or kind == "unsound"
    if read == 0:
        sys.exit(f"{sys.argv[1]} has no advisories. Expected a copy of https://github.com/rustsec/advisory-db")
    print(f"{read} advisories, {sum(map(len, packages.values()))} locked packages, {vulnerable} vulnerable")
    sys.exit(1 if vulnerable else 0)


if __name__ == "__main__":
    main()
