"""What a user can write to complete the declaration of an environment."""

from __future__ import annotations

import sys
from typing import Any

from .environment import innermost


def example_file(env: Any, name: str, field: str) -> str:
    """The text of a file that declares a Task with this field."""
    specification = getattr(env, "spec", None)
    identifier = getattr(specification, "id", None)
    first, make = "", type(innermost(env)).__name__
    if identifier:
        entry = getattr(specification, "entry_point", None)
        module = entry.partition(":")[0].partition(".")[0] if isinstance(entry, str) else ""
        registered = identifier if module in ("", "gymnasium") else f"{module}:{identifier}"
        arguments = "".join(f", {name}={value!r}" for name, value in _given(identifier, specification).items())
        first, make = "    import gymnasium\n", f'lambda: gymnasium.make("{registered}"{arguments})'
    task = f'Task(name="{name.rpartition(".")[2].lower()}", {field})'
    return f"{first}    from robogate_eval import Environment, Task\n    environment = Environment(make={make}, task={task})"


def _given(identifier: str, specification: Any) -> dict[str, Any]:
    """The arguments with which a registered environment was made, without those of its registration."""
    # An environment of the older gym does not need gymnasium.
    registry = getattr(sys.modules.get("gymnasium"), "registry", {})
    registered = getattr(registry.get(identifier), "kwargs", {})
    given = getattr(specification, "kwargs", None) or {}
    return {name: value for name, value in given.items() if name != "render_mode" and registered.get(name, ...) != value}


def unknown(env: Any, name: str, what: str, field: str) -> str:
    """The error for something that neither the environment nor its task says."""
    verb, it = ("are", "them") if " and the " in what else ("is", "it")
    return f"the {what} of {name} {verb} unknown. Declare {it} in a Task:\n{example_file(env, name, field)}"
