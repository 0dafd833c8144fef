"""`python -m robogate_eval.environments`: what `robogate run --env` and `robogate env` start."""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import sys
import traceback
from pathlib import Path

from ..serving.environment import DeclarationError
from . import UnknownEnvironment, families, find, with_policy

# What a server needs in addition to the environment: module and pinned requirement.
SERVER = {"zmq": "pyzmq==27.1.0", "msgpack": "msgpack==1.1.2"}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m robogate_eval.environments", description=__doc__)
    verbs = parser.add_subparsers(dest="verb", required=True)
    serve = verbs.add_parser("serve", help="serve an environment over the bridge protocol")
    serve.add_argument("name", help="FAMILY:NAME, gymnasium:ID, FILE.py:ATTRIBUTE or MODULE:ATTRIBUTE")
    serve.add_argument("--bind", default="tcp://127.0.0.1:5570", help="address; tcp://127.0.0.1:* takes a free port")
    serve.add_argument("--policy", help="NAME=lerobot:FOLDER or NAME=sb3:FILE: a policy to load beside the environment's own")
    serve.add_argument("--child", action="store_true", help="serve the parent process: take a free port, and end with the standard input")
    serve.add_argument("--first", action="store_true", help="run one episode before, which shows what the environment imports and opens")
    serve.add_argument("--probe", help="folder for a file with contacts, motion and solver of each episode")
    describe = verbs.add_parser("describe", help="print the declaration of an environment to the parent process, as JSON after lines about progress")
    describe.add_argument("name")
    requirements = verbs.add_parser("requirements", help="print the pinned requirements of a family, as pip reads them")
    requirements.add_argument("name", help="name of the family")
    verbs.add_parser("list", help="print the bundled environments, as JSON")
    arguments = parser.parse_args()
    try:
        {"serve": _serve, "describe": _describe, "list": _list, "requirements": _requirements}[arguments.verb](arguments)
    except UnknownEnvironment as error:
        _refuse(str(error))
    except ModuleNotFoundError as error:
        _refuse(_missing(arguments, error))
    except DeclarationError as error:
        _refuse(f"{arguments.name}: {error}")
    except Exception as error:
        _report(error)


def _report(error: Exception) -> None:
    """End with the traceback of an error in the environment, without the frames of this package that called it."""
    own = str(Path(__file__).parents[1])
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None and trace.tb_frame.f_code.co_filename.startswith(own):
        trace = trace.tb_next
    text = "".join(traceback.format_exception(type(error), error, trace))
    print(text, end="", file=sys.stderr)
    if not os.environ.get("MUJOCO_GL") and any(word in text for word in ("OpenGL", "GLFW", "gladLoadGL")):
        print("Hint: without a display, MuJoCo renders with MUJOCO_GL=egl", file=sys.stderr)
    sys.exit(1)


def _refuse(message: str) -> None:
    """End with the exit code for errors that the user can correct."""
    print(f"error: {message}", file=sys.stderr)
    sys.exit(2)


def _serve(arguments: argparse.Namespace) -> None:
    from ..serving import process

    if arguments.child:
        process.serve_child(arguments.name, arguments.policy, arguments.first, arguments.probe)
    else:
        environment = find(arguments.name)
        process.serve_adapter(environment if arguments.policy is None else with_policy(environment, arguments.policy), arguments.bind)


def _describe(arguments: argparse.Namespace) -> None:
    from robogate_bridge import declaration

    from ..serving.process import Child, child_adapter

    child = Child()
    adapter = child_adapter(child, arguments.name)
    declared = declaration.hello(adapter.hello())
    child.answer(json.dumps(declared | {"not_offered": [{"name": name, "reason": why} for name, why in adapter.dropped]}))


def _list(arguments: argparse.Namespace) -> None:
    out = []
    for family in families().values():
        missing = [package for package in (family.package, *SERVER) if importlib.util.find_spec(package) is None]
        out.append({
            "name": family.name,
            "summary": family.summary,
            "package": family.package,
            "requirements": [*family.requirements, *SERVER.values()],
            "names": [] if missing else family.names(),
            "missing": missing[0] if missing else None,
            "yours": family.yours,
        })  # fmt: skip
    print(json.dumps(out))


def _requirements(arguments: argparse.Namespace) -> None:
    family = families().get(arguments.name)
    if family is None:
        raise UnknownEnvironment(f"{arguments.name}: unknown family. Expected one of: {', '.join(families())}")
    print("\n".join([*family.requirements, *SERVER.values()]))


def _missing(arguments: argparse.Namespace, error: ModuleNotFoundError) -> str:
    family = getattr(arguments, "name", "").partition(":")[0]
    # What any environment needs, by the names that pip knows.
    basis = {"numpy": "numpy", "gymnasium": "gymnasium", "zmq": "pyzmq", "msgpack": "msgpack"}
    if family in families():
        hint = f"`robogate env setup {family}` creates a Python environment with all that it needs"
    elif error.name in basis:
        hint = f"{sys.executable} -m pip install {' '.join(basis.values())}, or choose another interpreter with --python"
    else:
        hint = f"{sys.executable} -m pip install {error.name}, if the package has this name, or choose another interpreter with --python"
    return f"the Python package {error.name} is missing in {sys.executable}\nHint: {hint}"


if __name__ == "__main__":
    main()
