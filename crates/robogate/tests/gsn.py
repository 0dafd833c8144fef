"""Reads a safety case as a tool for Goal Structuring Notation does, and prints the status of each element as JSON.

Usage: gsn.py ARGUMENT.yaml

The rules are the checks that gsn2x documents (V01 to V13, C01 to C16), as far as they apply to one file. Where the environment variable
GSN2X names the program itself, it checks the file too: it is in no package registry.
"""

import json
import os
import pathlib
import subprocess
import sys

from ruamel.yaml import YAML

# A longer prefix is tried first.
KINDS = {"CSn": "CounterSolution", "CG": "CounterGoal", "Sn": "Solution", "G": "Goal", "S": "Strategy", "A": "Assumption",
         "J": "Justification", "C": "Context"}
SUPPORTS = {"Goal": {"Goal", "Strategy", "Solution"}, "Strategy": {"Goal", "Strategy", "Solution"},
            "CounterGoal": {"CounterGoal", "Strategy", "CounterSolution"}}

path = pathlib.Path(sys.argv[1])
elements = YAML(typ="safe").load(path.read_text(encoding="utf-8"))


def kind(name):
    return next(KINDS[prefix] for prefix in KINDS if name.startswith(prefix + "-"))


challenged = {element["challenges"] for element in elements.values() if "challenges" in element}
referred = set()
for name, element in elements.items():
    assert element["text"], name
    support, context = element.get("supportedBy", []), element.get("inContextOf", [])
    for others in support, context:
        assert len(set(others)) == len(others) and name not in others, name
        assert all(other in elements for other in others), (name, others)
        referred.update(others)
    assert all(kind(other) in SUPPORTS.get(kind(name), set()) for other in support), (name, support)
    assert all(kind(other) in {"Context", "Assumption", "Justification"} for other in context), (name, context)
    if kind(name) in {"Goal", "Strategy"}:
        assert bool(support) != element.get("undeveloped", False), name
    if "challenges" in element:
        assert kind(name) in {"CounterGoal", "CounterSolution"} and element["challenges"] in elements, name
    if element.get("defeated"):
        assert name in challenged, name
tops = [name for name in elements if name not in referred and not kind(name).startswith("Counter")]
assert tops == ["G-may-run"], tops


def below(name, seen=()):
    assert name not in seen, f"circular: {name}"
    return {name}.union(*(below(other, (*seen, name)) for other in elements[name].get("supportedBy", [])))


below("G-may-run")
if program := os.environ.get("GSN2X"):
    checked = subprocess.run([program, "-c", path.name], cwd=path.parent, capture_output=True, text=True, check=True)
    assert not checked.stderr, checked.stderr
print(json.dumps({name: {"status": element.get("status"), "defeated": element.get("defeated", False),
                         "sha256": element.get("sha256"), "path": element.get("url"), "text": element["text"],
                         "challenges": element.get("challenges")} for name, element in elements.items()}))
