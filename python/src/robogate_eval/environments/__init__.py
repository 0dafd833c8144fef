"""Environments under the gate: the bundled ones, and those of a user.

A **bundled environment** is one Python file of this folder that defines `FAMILY`:

    FAMILY = Family(
        name="metaworld",                                # the part of a name before the colon
        summary="50 table-top tasks with scripted experts",
        package="metaworld",                                 # must be importable
        requirements=["metaworld==3.1.1", "mujoco==3.3.0"],   # pinned; `robogate env setup` installs them
        names=names,                                     # () -> list of str: what may follow the colon
        environment=environment,                         # (str) -> Environment: the environment of such a name
    )

The file must import on any Python 3.10 without the packages it is about: import them inside the functions. List the module in
`FAMILIES`. A user names an environment as `FAMILY:NAME`, for example `metaworld:drawer-open-v3`, `fetch:FetchPickAndPlace-v4`,
`robosuite:Lift`, `libero:spatial/3` or `dm_control:reach_site`.

`Environment` says all that there is to say about an environment: how it is made, its task, its knobs, and its policies. See its
documentation.
"""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import importlib
import importlib.metadata
import importlib.util
import os
import sys
from pathlib import Path

from ..serving.environment import Environment, as_environment
from .family import Family, UnknownEnvironment, installed
from .family import arguments as given
from .family import widened

__all__ = ["Family", "UnknownEnvironment", "families", "find", "with_policy"]

# The modules of this folder that define a `FAMILY`.
FAMILIES = ("metaworld", "fetch", "robosuite", "libero", "dm_control", "warp")


def families() -> dict[str, Family]:
    """The bundled families, by name."""
    modules = (importlib.import_module(f"{__name__}.{module}") for module in FAMILIES)
    return {module.FAMILY.name: module.FAMILY for module in modules}


def find(name: str) -> Environment:
    """Find an environment by its name.

    A name is `FAMILY:NAME` of a bundled family, `gymnasium:ID` for a registered Gymnasium environment (`gymnasium:MODULE:ID` if the
    import of a module registers it; `?key=value&...` gives its arguments), `lerobot:TYPE/TASK` for an environment of LeRobot (its fields in
    the same way), or `FILE.py:ATTRIBUTE` or `MODULE:ATTRIBUTE` for your own. The attribute is an `Environment`, or a function that returns one or a `gymnasium.Env`.

    Raises:
        UnknownEnvironment: There is no such environment.
    """
    first, _, rest = name.rpartition(":") if ".py:" in name else name.partition(":")
    if not first and rest.endswith(".py"):
        first, rest = rest, ""
    if first == "gymnasium":
        return _registered(rest)
    if first == "lerobot":
        from ..lerobot.world import environment

        return environment(rest)
    known = families()
    if first in known:
        if not rest:
            raise UnknownEnvironment(f"{name}: the name of the environment is missing. Expected {first}:NAME")
        return known[first].environment(rest)
    if first.endswith(".py"):
        file = Path(first)
        environment = _own(_load(file), rest, name)
        digest = hashlib.sha256(file.read_bytes()).hexdigest()[:12]
        return environment if environment.source else dataclasses.replace(environment, source=f"{file.name} sha256:{digest}")
    _from_here()
    try:
        module = importlib.import_module(first)
    except ModuleNotFoundError as error:
        if error.name is None or not (first == error.name or first.startswith(f"{error.name}.")):
            raise
        bundled = ", ".join(known)
        nearest = difflib.get_close_matches(first, known, n=1)
        meant = f" Did you mean {nearest[0]}:{rest}?" if nearest else ""
        raise UnknownEnvironment(
            f"{name}: no such environment.{meant} Expected FAMILY:NAME (families: {bundled}), gymnasium:ID, FILE.py:ATTRIBUTE or MODULE:ATTRIBUTE"
        ) from None
    return _own(module, rest, name)


def own_folder(name: str) -> Path | None:
    """The folder of the user's own environment of this name: that of its file or module. None for a bundled or registered one."""
    if ".py" in name and (file := Path(name[: name.index(".py") + 3])).is_file():
        return file.resolve().parent
    first = name.removeprefix("gymnasium:").partition(":")[0]
    if ":" not in name.removeprefix("gymnasium:") or first in families() or first == "lerobot":
        return None
    _from_here()
    try:
        found = importlib.util.find_spec(first)
    except (ImportError, ValueError):
        return None
    return Path(found.origin).resolve().parent if found and found.origin and Path(found.origin).is_file() else None


def with_policy(environment: Environment, named: str) -> Environment:
    """The environment with a further policy, `NAME=lerobot:FOLDER` or `NAME=sb3:FILE`, as its first."""
    from ..policies import declared

    name, _, path = named.partition("=")
    return dataclasses.replace(environment, policies={name: declared(path), **environment.policies})


def _registered(identifier: str) -> Environment:
    """An environment that is registered with Gymnasium: `ID`, or `MODULE:ID` if the import of a module registers it."""
    import gymnasium

    named, _, query = identifier.partition("?")
    try:
        arguments = given(query)
    except ValueError as why:
        raise UnknownEnvironment(f"gymnasium:{identifier}: {why}") from None
    module, _, own = named.rpartition(":")
    if module:
        _from_here()
        importlib.import_module(module)
    try:
        specification = gymnasium.spec(own)
    except gymnasium.error.Error as error:
        hint = "" if module else "\nHint: if another package registers it, gymnasium:MODULE:ID, for example gymnasium:gymnasium_robotics:HandReach-v3"
        raise UnknownEnvironment(f"gymnasium:{identifier}: {error}{hint}") from None
    return dataclasses.replace(as_environment(lambda: _make(own, arguments), own), source=_package(specification.entry_point))


def _from_here() -> None:
    """Let a module that the user names be in the current folder, after all installed packages.

    The command starts Python without the current folder: a file in it must not replace a package.
    """
    here = os.getcwd()
    if here not in sys.path:
        sys.path.append(here)


def _make(identifier: str, arguments: dict):
    """The environment of this identifier. One without a MuJoCo model is made for images, if it can render them."""
    import gymnasium

    from ..serving.model import NoModel
    from ..serving.model import find as find_model

    env = widened(gymnasium.make(identifier, **arguments))
    if "render_mode" in arguments or env.render_mode is not None or "rgb_array" not in env.metadata.get("render_modes", []):
        return env
    try:
        find_model(env)
        return env
    except (NoModel, ImportError):
        env.close()
        return widened(gymnasium.make(identifier, render_mode="rgb_array", **arguments))


def _package(entry_point: object) -> str:
    """Name and version of the package that has this entry point, or nothing if no installed package has it."""
    module = entry_point if isinstance(entry_point, str) else getattr(entry_point, "__module__", None) or ""
    top = module.partition(":")[0].partition(".")[0]
    try:
        return installed(top) if top else ""
    except importlib.metadata.PackageNotFoundError:
        packages = importlib.metadata.packages_distributions().get(top, [])
        return installed(packages[0]) if packages else ""


def _load(file: Path):
    if not file.is_file():
        raise UnknownEnvironment(f"{file}: no such file")
    specification = importlib.util.spec_from_file_location(file.stem, file)
    module = importlib.util.module_from_spec(specification)
    # Modules beside the file can be imported, as if Python ran it.
    sys.path.insert(0, str(file.resolve().parent))
    sys.modules[file.stem] = module
    specification.loader.exec_module(module)
    return module


def _own(module, attribute: str, name: str) -> Environment:
    classes = _classes(module)
    if not attribute and not hasattr(module, "environment") and len(classes) == 1:
        # The only class of an environment in the file.
        attribute = classes[0]
    attribute = attribute or "environment"
    value = getattr(module, attribute, None)
    if value is None:
        found = f" It has the environments {', '.join(classes)}: name one after a colon, for example :{classes[0]}" if classes else ""
        raise UnknownEnvironment(
            f"{name}: the module has no attribute {attribute!r}. Expected an Environment, or a function or class that makes one.{found}"
        )
    return as_environment(value, f"{module.__name__}.{attribute}")


def _classes(module) -> list[str]:
    """The names of the classes of Gymnasium environments that a module defines."""
    gymnasium = sys.modules.get("gymnasium")
    if gymnasium is None:
        return []
    found = vars(module).items()
    return [name for name, value in found if isinstance(value, type) and issubclass(value, gymnasium.Env) and value.__module__ == module.__name__]
