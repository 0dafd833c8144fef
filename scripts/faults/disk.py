"""What a disk may hold after a power failure, from the log of all calls that changed a folder (`shim.c`).

A file's bytes are safe once the file was synced. An entry of a folder (a new name, a rename, a link, a removal) is safe once the
folder was synced. Of everything else, any part may be lost, in any order.
"""

from __future__ import annotations

import os
import random
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

HEAD = struct.Struct("<cIQII")
# Operations after which a power failure differs from one before them.
CHANGES = frozenset("OWTFRLMU")


@dataclass
class Node:
    """A file or a folder."""

    entries: dict[str, Node] | None = None
    content: bytearray = field(default_factory=bytearray)
    rights: int = 0o644
    # What is safe on disk, and what has changed since, in order.
    safe_entries: dict[str, Node] = field(default_factory=dict)
    safe_content: bytearray = field(default_factory=bytearray)
    pending: list[Any] = field(default_factory=list)


@dataclass
class Entries:
    """A change of entries: names of folders with their new nodes. All of them happen, or none."""

    names: list[tuple[Node, str, Node | None]]
    safe: bool = False

    def keep(self) -> None:
        if not self.safe:
            self.safe = True
            for folder, name, node in self.names:
                if node is None:
                    folder.safe_entries.pop(name, None)
                else:
                    folder.safe_entries[name] = node


def operations(log: Path) -> list[tuple]:
    """The records of a log that change something, with the opened files."""
    text, at, found = log.read_bytes(), 0, []
    while at + HEAD.size <= len(text):
        operation, handle, number, n, m = HEAD.unpack_from(text, at)
        at += HEAD.size
        found.append((operation.decode(), handle, number, text[at : at + n], text[at + n : at + n + m]))
        at += n + m
    return found


def write(content: bytearray, at: int, data: bytes) -> None:
    if len(content) < at:
        content.extend(bytes(at - len(content)))
    content[at : at + len(data)] = data


def resize(content: bytearray, size: int) -> None:
    del content[size:]
    content.extend(bytes(size - len(content)))


class Disk:
    """A folder, as it is and as it would be after a power failure. Everything in it is safe at first."""

    def __init__(self, folder: Path, template: Path):
        self.folder = str(folder)
        self.root = self._load(template)
        self.handles: dict[int, Node] = {}
        self.changes: list[Entries] = []

    def _load(self, path: Path) -> Node:
        if path.is_file():
            content = bytearray(path.read_bytes())
            return Node(content=content, safe_content=bytearray(content), rights=path.stat().st_mode & 0o7777)
        entries = {child.name: self._load(child) for child in path.iterdir()}
        return Node(entries=entries, safe_entries=dict(entries))

    def _place(self, path: bytes) -> tuple[Node, str]:
        """The folder of a path, and the name in it. The name of the folder itself is empty."""
        names = [part for part in os.fsdecode(path)[len(self.folder) :].split("/") if part]
        node = self.root
        for name in names[:-1]:
            node = node.entries[name]
        return node, names[-1] if names else ""

    def _change(self, *names: tuple[Node, str, Node | None]) -> None:
        change = Entries(list(names))
        self.changes.append(change)
        for folder, name, node in names:
            folder.pending.append(change)
            if node is None:
                folder.entries.pop(name, None)
            else:
                folder.entries[name] = node

    def do(self, operation: str, handle: int, number: int, a: bytes, b: bytes) -> None:
        """Repeats one call."""
        if operation == "O":
            folder, name = self._place(a)
            node = folder.entries.get(name) if name else folder
            if node is None:
                node = Node(rights=int.from_bytes(b, "little"))
                self._change((folder, name, node))
            elif number & os.O_TRUNC and node.entries is None:
                self._data(node, resize, 0)
            self.handles[handle] = node
        elif operation == "W":
            self._data(self.handles[handle], write, number, a)
        elif operation == "T":
            self._data(self.handles[handle], resize, number)
        elif operation == "F":
            self._sync(self.handles[handle])
        elif operation == "M":
            self._change((*self._place(a), Node(entries={})))
        elif operation == "U":
            self._change((*self._place(a), None))
        elif operation in "RL":
            (source, name), target = self._place(a), self._place(b)
            node = source.entries[name]
            self._change((*target, node), *([(source, name, None)] if operation == "R" else []))

    def _data(self, node: Node, change: Any, *arguments: Any) -> None:
        change(node.content, *arguments)
        node.pending.append((change, arguments))

    def _sync(self, node: Node) -> None:
        for pending in node.pending:
            self._keep(node, pending)
        node.pending.clear()

    @staticmethod
    def _keep(node: Node, pending: Any) -> None:
        if isinstance(pending, Entries):
            pending.keep()
        else:
            change, arguments = pending
            change(node.safe_content, *arguments)

    def lose(self, draw: random.Random | None) -> None:
        """A power failure. With `draw`, a random half of what is not safe survives."""
        nodes = [self.root]
        seen: set[int] = set()
        while nodes:
            node = nodes.pop()
            if id(node) in seen:
                continue
            seen.add(id(node))
            for pending in node.pending:
                if draw is not None and draw.random() < 0.5:
                    self._keep(node, pending)
            # Also files whose names were lost, or come back.
            nodes.extend([*(node.entries or {}).values(), *node.safe_entries.values()])

    def store(self, folder: Path) -> None:
        """Writes what is left into an empty folder."""
        self._store(self.root, folder)

    def _store(self, node: Node, path: Path) -> None:
        if node.entries is None:
            path.write_bytes(node.safe_content)
            path.chmod(node.rights)
            return
        path.mkdir(exist_ok=True)
        for name, child in node.safe_entries.items():
            self._store(child, path / name)


def after_power_failure(log: list[tuple], calls: int, folder: Path, template: Path, draw: random.Random | None) -> Disk:
    """The disk after a power failure behind the first `calls` calls of a log."""
    disk = Disk(folder, template)
    for one in log[:calls]:
        disk.do(*one)
    disk.lose(draw)
    return disk
