"""Reads LIBERO's task files, which are PDDL-like S-expressions.

Only what RoboGate needs is read: the instruction, the goal, and the objects. LIBERO itself reads the rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

# A task file is a few kilobytes. The bounds protect against a file that is not one.
MAX_BYTES = 1 << 20
MAX_DEPTH = 64


class TaskFileError(ValueError):
    """A task file cannot be read. The message names the file and says what is wrong."""


@dataclass(frozen=True)
class TaskFile:
    """What a task file says."""

    # The name of the problem class, as written: `LIBERO_Tabletop_Manipulation`.
    problem: str
    # The instruction in words, from `:language`, as written.
    instruction: str
    # The predicates of the goal, all of which must hold: ("on", "bowl_1", "plate_1"). Predicates are in lower case.
    goal: tuple[tuple[str, ...], ...]
    # Names of objects that move, and of fixtures, by category.
    objects: dict[str, tuple[str, ...]]
    fixtures: dict[str, tuple[str, ...]]
    # The objects that the instruction is about.
    interest: tuple[str, ...]


def read(path) -> TaskFile:
    """Reads a task file."""
    path = Path(path)
    try:
        raw = path.read_bytes()[: MAX_BYTES + 1]
    except OSError as why:
        raise TaskFileError(f"{path}: {why.strerror}") from None
    if len(raw) > MAX_BYTES:
        raise TaskFileError(f"{path}: larger than {MAX_BYTES} bytes. Expected a task file")
    try:
        return parse(raw.decode("utf-8"))
    except (UnicodeDecodeError, TaskFileError) as why:
        raise TaskFileError(f"{path}: {why}") from None


def parse(text) -> TaskFile:
    """Reads the text of a task file."""
    tree = _tree(text)
    if len(tree) < 2 or tree[0] != "define":
        raise TaskFileError("expected (define (problem ...) ...)")
    sections = {part[0].lower(): part[1:] for part in tree[1:] if isinstance(part, list) and part and isinstance(part[0], str)}
    for name in ("problem", ":language", ":goal"):
        if not sections.get(name):
            raise TaskFileError(f"the section {name} is missing or empty")
    goal = sections[":goal"][0]
    if not isinstance(goal, list) or not goal:
        raise TaskFileError("the goal is not a predicate")
    parts = goal[1:] if str(goal[0]).lower() == "and" else [goal]
    predicates = []
    for part in parts:
        if not isinstance(part, list) or not part or not all(isinstance(word, str) for word in part):
            raise TaskFileError(f"the goal has the part {part!r}. Expected predicates joined by And")
        predicates.append((part[0].lower(), *part[1:]))
    if not predicates:
        raise TaskFileError("the goal has no predicate")
    return TaskFile(
        problem=str(sections["problem"][0]),
        instruction=" ".join(_words(sections[":language"], ":language")),
        goal=tuple(predicates),
        objects=_typed(sections.get(":objects", []), ":objects"),
        fixtures=_typed(sections.get(":fixtures", []), ":fixtures"),
        interest=tuple(_words(sections.get(":obj_of_interest", []), ":obj_of_interest")),
    )


def _words(items, where):
    if not all(isinstance(item, str) for item in items):
        raise TaskFileError(f"{where}: expected words")
    return items


def _typed(items, where):
    """Reads `a b - kind c - other`: names by kind."""
    out, names, kind_next = {}, [], False
    for word in _words(items, where):
        if word == "-":
            kind_next = True
        elif kind_next:
            out[word] = out.get(word, ()) + tuple(names)
            names, kind_next = [], False
        else:
            names.append(word)
    if names or kind_next:
        raise TaskFileError(f"{where}: the last names have no category")
    return out


def _tree(text):
    """The first S-expression of a text, as nested lists of words. A semicolon starts a comment."""
    stack, current = [], None
    for line in text.splitlines():
        for word in line.split(";", 1)[0].replace("(", " ( ").replace(")", " ) ").split():
            if word == "(":
                if len(stack) >= MAX_DEPTH:
                    raise TaskFileError(f"parentheses are nested deeper than {MAX_DEPTH}")
                stack.append(current)
                current = []
            elif current is None:
                raise TaskFileError(f"the text starts with {word[:40]!r}. Expected (")
            elif word == ")":
                done, current = current, stack.pop()
                if current is None:
                    return done
                current.append(done)
            else:
                current.append(word)
    raise TaskFileError("a parenthesis is not closed")
