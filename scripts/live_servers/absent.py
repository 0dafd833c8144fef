"""Stands in for packages that a server imports only for its model, such as PyTorch and JAX.

The serving code of a model imports the model's framework at the top of its files. Here no model runs, so `without("torch")`
puts a placeholder in the framework's place. Any name of a placeholder exists, can be called, derived from, used as a
decorator and entered with `with`. Nothing can be computed with it.
"""

from __future__ import annotations

import importlib
import importlib.abc
import importlib.machinery
import sys
import types


class _Anything(type):
    """The metaclass of the placeholder: all its attributes are the placeholder."""

    def __getattr__(cls, name):
        if name.startswith("__") and name.endswith("__"):
            raise AttributeError(name)
        return Placeholder

    def __getitem__(cls, _):
        return Placeholder

    def __or__(cls, _):
        return object

    __ror__ = __or__

    def __iter__(cls):
        return iter(())

    def __call__(cls, *arguments, **_):
        if cls is not Placeholder:
            return super().__call__(*arguments, **_)
        # As a decorator it returns what it decorates.
        return arguments[0] if len(arguments) == 1 and callable(arguments[0]) else Placeholder

    def __enter__(cls):
        return Placeholder

    def __exit__(cls, *_):
        return False


class Placeholder(metaclass=_Anything):
    """Any class, function, module or number of an absent package."""

    def __init_subclass__(cls, **_):
        super().__init_subclass__()


class _Module(types.ModuleType):
    __path__: list[str] = []

    def __getattr__(self, name):
        if name.startswith("__") and name.endswith("__"):
            raise AttributeError(name)
        return Placeholder


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    def __init__(self, names):
        self.names = set(names)

    def find_spec(self, name, _path=None, _target=None):
        parts = name.split(".")
        if any(".".join(parts[:count]) in self.names for count in range(1, len(parts) + 1)):
            return importlib.machinery.ModuleSpec(name, self, is_package=True)
        return None

    def create_module(self, spec):
        return _Module(spec.name)

    def exec_module(self, _):
        pass


def without(*names: str) -> None:
    """Put a placeholder in the place of these packages and modules, and of all that is in them."""
    sys.meta_path.insert(0, _Finder(names))


def module(name: str, **content) -> None:
    """Put a module with this content in place."""
    made = types.ModuleType(name)
    made.__dict__.update(content)
    sys.modules[name] = made
    parent, _, last = name.rpartition(".")
    if parent:
        setattr(importlib.import_module(parent), last, made)
