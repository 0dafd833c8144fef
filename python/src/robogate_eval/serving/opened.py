"""The files that an environment opens in its own folder beside its modules: models, meshes, arrays, weights.

They are part of the environment: with another one, it is another environment.
"""

from __future__ import annotations

import functools
import importlib.abc
import importlib.util
import os
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from .watch import Watch

# Most files that are recorded. Weights and meshes of an environment are far fewer.
MOST = 10_000
# Attributes of MJCF with the name of a file, and with a folder for such names.
FILE = re.compile(r"""\bfile(?:up|down|left|right|front|back)?\s*=\s*["']([^"']+)["']""")
FOLDER = re.compile(r"""\b(?:meshdir|texturedir|assetdir)\s*=\s*["']([^"']+)["']""")
WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


class Opened:
    """The files below a folder that this process opens to read, from now on."""

    def __init__(self, folder: Path):
        self.folder = os.path.realpath(folder)
        self._as_named = os.path.abspath(folder)
        self._read: set[str] = set()
        self._written: set[str] = set()
        self._watch = Watch(self.folder)
        # Files that only the kernel has seen, because Python did not open them.
        self.only_watched: set[str] = set()
        sys.addaudithook(self._hook)
        sys.meta_path.insert(0, _AfterImport("mujoco", self._watch_mujoco))

    def files(self) -> list[str]:
        """The paths of the files that were read and not written. A file that the environment writes is not part of it. Ends the watch."""
        opened, written = self._watch.end()
        opened = {path for path in opened if not path.endswith(".pyc")}
        self.only_watched |= opened - self._read
        found = (self._read | opened) - self._written - written
        return sorted(path for path in found if os.path.isfile(path))[:MOST]

    @property
    def complete(self) -> bool:
        """Whether files that other libraries opened are among them."""
        return self._watch.complete

    def name(self, path: str) -> str:
        """The path relative to the folder."""
        return os.path.relpath(path, self.folder).replace(os.sep, "/")

    def _hook(self, event: str, arguments: tuple) -> None:
        if event == "open" and isinstance(arguments[0], (str, bytes)):
            self._note(os.fsdecode(arguments[0]), bool(arguments[2] & WRITES))

    def _note(self, path: str, writes: bool) -> None:
        full = self._inside(path)
        if full is not None and not full.endswith(".pyc") and len(self._read) < MOST:
            (self._written if writes else self._read).add(full)

    def _inside(self, path: str) -> str | None:
        """The path in the folder. None for a file elsewhere. A link in the folder may name a file elsewhere: it is part of the folder."""
        for full in (os.path.abspath(path), os.path.realpath(path)):
            for folder in (self.folder, self._as_named):
                if full.startswith(folder + os.sep):
                    return self.folder + full[len(folder) :]
        return None

    def _watch_mujoco(self, mujoco: ModuleType) -> None:
        """MuJoCo opens files in C++, which Python does not see, and the kernel may not report."""
        for owner, name in ((mujoco.MjModel, "from_xml_path"), (mujoco.MjSpec, "from_file")):
            setattr(owner, name, staticmethod(self._noting(getattr(owner, name))))

    def _noting(self, load: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(load)
        def loads(filename: Any, *arguments: Any, **named: Any) -> Any:
            self._note_model(os.fspath(filename), os.path.dirname(os.fspath(filename)), set())
            return load(filename, *arguments, **named)

        return loads

    def _note_model(self, path: str, base: str, seen: set[str]) -> None:
        """Note a model with all files that it names. Names are relative to the first model, or to the folders that it declares."""
        if path in seen or not os.path.isfile(path):
            return
        seen.add(path)
        self._note(path, writes=False)
        if not path.lower().endswith((".xml", ".mjcf", ".urdf")):
            return
        with open(path, errors="replace") as file:
            text = file.read()
        folders = [base, os.path.dirname(path), *(os.path.join(base, folder) for folder in FOLDER.findall(text))]
        for named in FILE.findall(text):
            for folder in folders:
                self._note_model(os.path.join(folder, named), base, seen)


class _AfterImport(importlib.abc.MetaPathFinder):
    """Calls a function with a module as soon as it is imported."""

    def __init__(self, name: str, then: Callable[[ModuleType], None]):
        self._name, self._then = name, then

    def find_spec(self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> Any:
        if name != self._name:
            return None
        sys.meta_path.remove(self)
        found = importlib.util.find_spec(name)
        if found is None or found.loader is None:
            return found
        run = found.loader.exec_module

        def exec_module(module: ModuleType) -> None:
            run(module)
            self._then(module)

        found.loader.exec_module = exec_module
        return found
