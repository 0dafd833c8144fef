"""`python -m robogate_eval.environments`: what `robogate run --env` and `robogate env` start."""

from __future__ import annotations

import argparse
import json
import sys

from . import UnknownEnvironment, families, find


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m robogate_eval.environments", description=__doc__)
    verbs = parser.add_subparsers(dest="verb", required=True)
    serve = verbs.add_parser("serve", help="serve an environment over the bridge protocol")
    serve.add_argument("name", help="FAMILY:NAME, gymnasium:ID, FILE.py:ATTRIBUTE or MODULE:ATTRIBUTE")
    serve.add_argument("--bind", default="tcp://127.0.0.1:5570", help="address; tcp://127.0.0.1:* takes a free port")
    serve.add_argument("--child", action="store_true", help="serve the parent process: take a free port, and end with the standard input")
    describe = verbs.add_parser("describe", help="print the declaration of an environment, as JSON")
    describe.add_argument("name")
    verbs.add_parser("list", help="print the bundled environments, as JSON")
    arguments = parser.parse_args()
    try:
        {"serve": _serve, "describe": _describe, "list": _list}[arguments.verb](arguments)
    except UnknownEnvironment as error:
        sys.exit(f"error: {error}")
    except ModuleNotFoundError as error:
        sys.exit(_missing(arguments, error))


def _serve(arguments: argparse.Namespace) -> None:
    from ..serving import process

    if arguments.child:
        process.serve_child(lambda: find(arguments.name))
    else:
        process.serve(find(arguments.name), bind=arguments.bind)


def _describe(arguments: argparse.Namespace) -> None:
    from ..serving.adapter import Adapter

    adapter = Adapter(find(arguments.name))
    print(json.dumps(adapter.hello() | {"not_offered": [{"name": name, "reason": why} for name, why in adapter.dropped]}))


def _list(arguments: argparse.Namespace) -> None:
    out = []
    for family in families().values():
        try:
            names, missing = family.names(), None
        except ImportError as error:
            names, missing = [], error.name
        out.append({"name": family.name, "summary": family.summary, "requirements": family.requirements, "names": names, "missing": missing})
    print(json.dumps(out))


def _missing(arguments: argparse.Namespace, error: ModuleNotFoundError) -> str:
    family = getattr(arguments, "name", "").partition(":")[0]
    hint = f"`robogate env setup {family}` creates a Python environment with all that it needs" if family in families() else f"install it for {sys.executable}"
    return f"error: the Python package {error.name} is missing in {sys.executable}\n  hint: {hint}"


if __name__ == "__main__":
    main()
