"""Shards that one process runs one after the other. The start of a process takes as long as an episode or more."""

from collections import deque
from collections.abc import Container
from dataclasses import dataclass

from robogate_eval.cluster.shards import Item

# The most episodes of several shards in one process: beside more, its start costs little, and their results would come late.
MOST_EPISODES = 100
# A process gets at most one in PARTS of the shards that are left for its slot, so that no slot waits long for the others at the end.
PARTS = 2


def ranges(numbers: "list[int]") -> str:
    """Numbers as `robogate run --shard` reads them, such as `0-3,7`."""
    parts: "list[list[int]]" = []
    for number in sorted(numbers):
        if parts and number == parts[-1][1] + 1:
            parts[-1][1] = number
        else:
            parts.append([number, number])
    return ",".join(str(first) if first == last else f"{first}-{last}" for first, last in parts)


@dataclass(frozen=True)
class Batch:
    """At least one shard of one round of a campaign."""

    items: "tuple[Item, ...]"

    @property
    def _shards(self) -> str:
        if len(self.items) == 1:
            return self.items[0].shard
        names = [item.shard.split("/") for item in self.items]
        return f"{ranges([int(index) for index, _ in names])}/{names[0][1]}"

    @property
    def name(self) -> str:
        """The name in messages."""
        first = self.items[0]
        return f"shard{'s' if len(self.items) > 1 else ''} {self._shards} of round {first.round} in {first.folder}"

    @property
    def arguments(self) -> "list[str]":
        """The arguments of `robogate`."""
        first = self.items[0]
        return [self._shards if word == first.shard else word for word in first.arguments]


def take(waiting: "deque[Item]", slots: int, alone: "Container[Item]") -> Batch:
    """Remove the next shards from `waiting`, which is not empty. Shards in `alone` get a process of their own."""
    most = max(1, -(-len(waiting) // (PARTS * max(slots, 1))))
    items = [waiting.popleft()]
    episodes = items[0].episodes
    while waiting and len(items) < most and items[0] not in alone:
        item = waiting[0]
        episodes += item.episodes
        if (item.folder, item.round) != (items[0].folder, items[0].round) or item in alone or episodes > MOST_EPISODES:
            break
        items.append(waiting.popleft())
    return Batch(tuple(items))
