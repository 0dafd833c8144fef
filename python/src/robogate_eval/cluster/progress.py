"""The progress of a round on stderr: one line that is drawn again in a terminal, otherwise a line for each tenth of the round."""

import sys
import time
from typing import Any, TextIO


def grouped(number: int) -> str:
    """An integer with thousands separators."""
    return f"{number:,}"


def duration(seconds: float) -> str:
    """A time such as `40 s`, `12 min` or `3.5 h`."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


class Progress:
    """Counts the committed shards and the outcomes of one round."""

    def __init__(self, status: "dict[str, Any]", stream: TextIO = sys.stderr) -> None:
        """`status` is the value of `shards.open_status`."""
        self._stream = stream
        self.name: str = status["round"]
        self.episodes: int = status["episodes"]
        self.done: int = status["done"]
        self.committed: int = status["committed"]
        self.shards: int = status["committed"] + len(status["missing"])
        self.outcomes: "dict[str, int]" = dict(status["outcomes"])
        self._done_before = self.done
        self._begin = time.monotonic()
        self._drawn = False

    def add(self, document: "dict[str, Any]") -> None:
        """Count a committed shard: the document that `robogate run --shard --json` prints for it."""
        outcomes: "dict[str, int]" = document.get("outcomes") or {}
        for name, count in outcomes.items():
            self.outcomes[name] = self.outcomes.get(name, 0) + count
        self.add_unseen(sum(outcomes.values()))

    def add_unseen(self, episodes: int) -> None:
        """Count a committed shard whose outcomes are unknown."""
        before = self.done
        self.committed += 1
        self.done += episodes
        tenth = max(self.episodes, 1) / 10
        if self._stream.isatty():
            self.draw()
        elif self.done // tenth > before // tenth:
            self._stream.write(self.text() + "\n")
            self._stream.flush()

    def draw(self) -> None:
        """Draw the line again."""
        self._stream.write("\r\x1b[K" + self.text())
        self._stream.flush()
        self._drawn = True

    def note(self, text: str) -> None:
        """Print a message above the line."""
        if self._drawn:
            self._stream.write("\r\x1b[K")
        self._stream.write(text + "\n")
        if self._drawn:
            self.draw()
        self._stream.flush()

    def end(self) -> None:
        """Leave the line as it is."""
        if self._drawn:
            self._stream.write("\n")
            self._stream.flush()
            self._drawn = False

    def text(self) -> str:
        """The line."""
        parts = [
            f"{self.committed} of {grouped(self.shards)} shards",
            f"{grouped(self.done)} of {grouped(self.episodes)} episodes",
        ]
        valid = sum(self.outcomes.values()) - self.outcomes.get("invalid", 0)
        if valid:
            parts.append(f"success {100 * self.outcomes.get('success', 0) / valid:.1f} %")
        if self.outcomes.get("invalid"):
            parts.append(f"{grouped(self.outcomes['invalid'])} invalid")
        seconds = time.monotonic() - self._begin
        rate = (self.done - self._done_before) / seconds if seconds > 0 else 0.0
        if rate > 0:
            parts.append(f"{rate:.3g} episodes/s")
            if self.done < self.episodes:
                parts.append(f"{duration((self.episodes - self.done) / rate)} left")
        return f"{self.name:<9} {', '.join(parts)}"
