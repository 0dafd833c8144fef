"""The files that describe the packages agree."""

import re
import unittest
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def read(path: str) -> str:
    return (ROOT / path).read_text(encoding="utf-8")


def only(pattern: str, path: str) -> str:
    """The single match of a pattern in a file."""
    found = re.findall(pattern, read(path), re.MULTILINE)
    assert len(found) == 1, f"{path}: {pattern}: {found}"
    return found[0]


class Packaging(unittest.TestCase):
    def test_glibc_floor_agrees(self) -> None:
        floor = only(r"^glibc=(.+)$", "scripts/release.sh")
        self.assertEqual(only(r"libc6 \(>= (.+)\)", "crates/robogate/Cargo.toml"), floor)
        self.assertEqual(only(r"glibc (\d\.\d+) or later", "python/README.md"), floor)
        self.assertEqual(only(r"glibc (\d\.\d+) or later", "docs/guides/installing.md"), floor)

    def test_python_floor_agrees(self) -> None:
        floor = only(r'^requires-python = ">=(.+)"$', "python/pyproject.toml")
        self.assertEqual(only(r"Python (\d\.\d+) or later", "docs/guides/installing.md"), floor)

    def test_pages_name_the_current_files(self) -> None:
        version = only(r'^version = "(.+)"$', "Cargo.toml")
        for page in ("README.md", "docs/guides/installing.md"):
            named = re.findall(r"robogate(?:_eval-|_)(\d+\.\d+\.\d+)", read(page))
            self.assertTrue(named, page)
            self.assertEqual(set(named), {version}, page)

    def test_package_installs_what_the_scripts_write(self) -> None:
        data = only(r'^data = "(.+)"$', "python/pyproject.toml")
        self.assertIn(f'ROOT / "python/{data}"', read("scripts/release/mujoco.py"))
        self.assertIn(f"../../python/{data}/data/lib/robogate/*", read("crates/robogate/Cargo.toml"))

    def test_image_installs_the_package(self) -> None:
        self.assertRegex(read("deploy/Containerfile"), r'dpkg --install "/release/robogate_"\*"_\$\{TARGETARCH')


if __name__ == "__main__":
    unittest.main()
