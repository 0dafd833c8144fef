"""A campaign in shards, seen through the command `robogate`."""

import json
import subprocess
from dataclasses import dataclass, field
from typing import Any

import robogate_eval
from robogate_eval.cluster import leash

# The exit codes of `robogate`.
DONE, FAIL, USAGE, INCONCLUSIVE, INVALID, INFRASTRUCTURE, INTERRUPTED = 0, 1, 2, 3, 4, 5, 130


class CommandError(Exception):
    """A command failed. The message contains its stderr; `code` is its exit code."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True)
class Result:
    """The result of one call of `robogate`."""

    code: int
    output: str
    errors: str

    @property
    def documents(self) -> "list[dict[str, Any]]":
        """The JSON documents on stdout: one on each line, or a single one on several lines."""
        try:
            found = [json.loads(self.output)]
        except ValueError:
            found = [value for value in map(_value, self.output.splitlines()) if value is not None]
        return [document for document in found if isinstance(document, dict)]

    @property
    def reason(self) -> str:
        """The error message on stderr, or the last line of stderr."""
        lines = self.errors.strip().splitlines()
        starts = [i for i, line in enumerate(lines) if line.startswith("error:")]
        text = lines[starts[-1] :] if starts else lines[-1:]
        return "\n".join(text).removeprefix("error: ") or f"exit code {self.code}"


def _value(line: str) -> Any:
    try:
        return json.loads(line)
    except ValueError:
        return None


def call(arguments: "list[str]") -> Result:
    """Run `robogate` with these arguments. It dies with this process."""
    process = leash.start([str(robogate_eval.command()), *arguments], subprocess.PIPE, subprocess.PIPE)
    try:
        output, errors = process.communicate()
    except BaseException:
        process.terminate()
        process.wait()
        raise
    return Result(process.returncode, output.decode(errors="replace"), errors.decode(errors="replace"))


def _document(arguments: "list[str]") -> "dict[str, Any]":
    result = call(arguments)
    documents = result.documents
    if result.code != DONE:
        raise CommandError(result.code, result.reason)
    if len(documents) != 1:
        raise CommandError(INFRASTRUCTURE, f"`robogate {' '.join(arguments)}` printed no JSON document")
    return documents[0]


@dataclass(frozen=True)
class Item:
    """A shard that can run now."""

    # Its name, such as `3/16`.
    shard: str
    round: str
    folder: str
    episodes: int
    # The arguments of `robogate`.
    arguments: "tuple[str, ...]"


@dataclass(frozen=True)
class Round:
    """The open round. It has no name when all rounds are complete."""

    name: "str | None"
    shards: int
    items: "list[Item]" = field(default_factory=list)


def next_round(folder: str) -> Round:
    """The missing shards of the open round; for a sweep, those of all its runs."""
    document = _document(["plan", folder, "--next", "--json"])
    items = [
        Item(item["shard"], item["round"], item["dir"], item["episodes"], tuple(item["command"][1:])) for item in document["items"]
    ]
    return Round(document["round"], document["shards"], items)


def open_status(folder: str) -> "dict[str, Any]":
    """The progress of the open round, as an element of `rounds` in the document of `robogate plan --json`.

    For a sweep, it is the sum over the open rounds of its runs.
    """
    document = _document(["plan", folder, "--json"])
    statuses = [run["status"] for run in document["runs"]] if "runs" in document else [document]
    rounds = [entry for status in statuses for entry in status["rounds"] if entry["state"] == "open"]
    total = {"round": "sweep", "episodes": 0, "done": 0, "committed": 0, "missing": [], "outcomes": {}}
    if len(rounds) == 1:
        total["round"] = rounds[0]["round"]
    for entry in rounds:
        for name in ("episodes", "done", "committed", "missing"):
            total[name] += entry[name]
        for name, count in entry["outcomes"].items():
            total["outcomes"][name] = total["outcomes"].get(name, 0) + count
    return total


# The folders of the arms of a campaign with nominal twins, below its own.
ARMS = ("nominal", "families")


def open_arms(folder: str) -> "list[str]":
    """The arms with missing shards. The merge of their campaign writes their plans."""
    found = []
    for arm in (f"{folder}/{name}" for name in ARMS):
        try:
            if next_round(arm).name is not None:
                found.append(arm)
        except CommandError as error:
            # There is no such arm.
            if error.code != USAGE:
                raise
    return found


def merge(folder: str, merged: "str | None", as_json: bool) -> "tuple[int, str]":
    """Merge all shards into `merged`, or into their own folder. Returns the exit code, and the document if `as_json` is set.

    Other output goes to the terminal.
    """
    arguments = ["merge", folder, *(["--out", merged] if merged else []), *(["--json"] if as_json else [])]
    process = leash.start([str(robogate_eval.command()), *arguments], subprocess.PIPE if as_json else None, None)
    try:
        output, _ = process.communicate()
    except BaseException:
        process.terminate()
        process.wait()
        raise
    return process.returncode, (output or b"").decode(errors="replace")
