"""What this process has imported: the files of modules by digest, and installed packages by version.

A run records both, so that another helper module or another version of a library is another environment.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import site
import sys
import sysconfig
from pathlib import Path

from .opened import Opened

# The folder of this package where the command unpacked it. The command identifies these files itself.
EMBEDDED = "ROBOGATE_EMBEDDED_PACKAGE"


def imported(opened: Opened | None = None) -> dict:
    """The imported `files` outside of the standard library and of installed packages, with those that were `opened`, and the `packages`.

    A file has the `name` of its module as a path (`helpers.py`, `cell/__init__.py`), or its path in the folder of the environment
    (`meshes/link.stl`), which is the same on every machine, its `path`, and its `sha256`. A package has name and version. Files that were
    opened by other libraries than Python are `only_watched`, and the list is `complete` where the kernel reports them.
    """
    installed = _folders(
        site.getsitepackages() if hasattr(site, "getsitepackages") else [],
        site.getusersitepackages(),
        *_paths("purelib", "platlib"),
        # A Python environment can contain the packages of another one.
        [folder for folder in sys.path if os.path.basename(folder) in ("site-packages", "dist-packages")],
    )
    skipped = (*_folders(*_paths("stdlib", "platstdlib")), *_folders(os.environ.get(EMBEDDED, "")))
    files, tops = [], set()
    for name, module in sorted(sys.modules.items()):
        path = _file(module)
        if path is None or name == "__main__":
            continue
        # Installed packages are often inside the folder of the standard library.
        if _is_below(path, installed):
            tops.add(name.partition(".")[0])
        elif not _is_below(path, skipped):
            files.append({"name": _name(name, module, path), "path": str(path), "sha256": _digest(path)})
    known = {file["path"] for file in files}
    for path in opened.files() if opened else []:
        if path not in known and not _is_below(Path(path), (*installed, *skipped)):
            file = {"name": opened.name(path), "path": path, "sha256": _digest(path)}
            files.append(file | ({"only_watched": True} if path in opened.only_watched else {}))
    return {"files": files, "packages": _packages(tops), "complete": opened is None or opened.complete}


def _digest(path: str | Path) -> str:
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while part := file.read(1 << 20):
            digest.update(part)
    return digest.hexdigest()


def _paths(*names: str) -> list[str]:
    return [sysconfig.get_paths()[name] for name in names]


def _folders(*folders: str | list[str]) -> tuple[str, ...]:
    flat = [one for folder in folders for one in ([folder] if isinstance(folder, str) else folder)]
    return tuple(os.path.realpath(folder) + os.sep for folder in flat if folder)


def _is_below(path: Path, folders: tuple[str, ...]) -> bool:
    return os.path.realpath(path).startswith(folders)


def _file(module: object) -> Path | None:
    """The source of a module, or its compiled library. None for one that is built in."""
    specification = getattr(module, "__spec__", None)
    origin = getattr(specification, "origin", None) or getattr(module, "__file__", None)
    if not isinstance(origin, str):
        return None
    path = Path(origin)
    return path.resolve() if path.is_file() else None


def _name(name: str, module: object, path: Path) -> str:
    suffix = ".".join(["", *path.name.split(".")[1:]])
    below = name.replace(".", "/")
    return f"{below}/{path.name}" if hasattr(module, "__path__") else f"{below}{suffix}"


def _packages(tops: set[str]) -> dict[str, str]:
    """The versions of the distributions that contain these top-level modules. One of a folder that another one hides is left out."""
    if not tops:
        return {}
    owners_of = importlib.metadata.packages_distributions()
    names = {name for top in tops for name in owners_of.get(top, []) if len(owners_of[top]) == 1 or _is_used(name, top)}
    return {name: importlib.metadata.version(name) for name in sorted(names)}


def _is_used(name: str, top: str) -> bool:
    """Whether this top-level module comes from the folder of this distribution."""
    path = _file(sys.modules.get(top))
    return path is None or _is_below(path, _folders(str(importlib.metadata.distribution(name).locate_file(""))))
