"""A knob: one quantity of an environment that can be varied, with its setter and its reader."""

from __future__ import annotations

import hashlib
import re
import unicodedata
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from numbers import Real
from typing import Any

# Longest name of a parameter.
MAX_NAME = 120


class DeclarationError(ValueError):
    """The declaration of an environment is wrong, or contradicts the environment."""


@dataclass(frozen=True)
class Knob:
    """A quantity that can be varied.

    The knob becomes a parameter of the task, under its name with `_` for every character that is no letter or digit. A
    categorical knob has `choices`; any other has `low` and `high`, the values that it accepts.

    `read` must return the value that acts, taken from the simulator and not copied from the request. RoboGate compares it with the
    request, and an episode in which they differ is invalid.
    """

    name: str
    # (env, value): makes the change. It is undone before the next episode, if the reset does not do that: see `Undoing`.
    set: Callable[[Any, Any], None]
    # (env) -> the value that acts.
    read: Callable[[Any], Any]
    low: float | int | None = None
    high: float | int | None = None
    choices: Sequence[str] = ()
    # Value without a request. None if there is no single value.
    nominal: float | int | str | None = None
    unit: str = ""
    meaning: str = ""
    # Where the value is read, in words.
    read_from: str = ""
    # The family of perturbations that the knob belongs to, such as "light". It needs a nominal value.
    family: str = ""
    # Only integers are accepted.
    integer: bool = False
    # Set before `env.reset`, for a value that the reset itself uses, such as the index of an initial state.
    before_reset: bool = False
    # The knob moves something that the observation contains, so the observation is taken again.
    moves: bool = False
    # (env) -> the value that acts now, or None; called after each step. A difference makes the episode invalid.
    watch: Callable[[Any], float | None] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise DeclarationError(f"the name of a knob is {self.name!r}. Expected a text")
        for field in ("unit", "meaning", "read_from", "family"):
            if not isinstance(getattr(self, field), str):
                raise self._wrong(field, "a text")
        for field in ("set", "read"):
            if not callable(getattr(self, field)):
                raise self._wrong(field, "a function")
        if isinstance(self.choices, str) or not all(isinstance(choice, str) for choice in self.choices):
            raise self._wrong("choices", "a list of texts")
        if self.choices:
            if not isinstance(self.nominal, (str, type(None))):
                raise self._wrong("nominal", "one of the choices")
            return
        for field in ("low", "high"):
            if not _is_number(getattr(self, field)):
                raise self._wrong(field, "a number (a categorical knob has `choices`)")
        if self.nominal is not None and not _is_number(self.nominal):
            raise self._wrong("nominal", "a number")

    def _wrong(self, field: str, expected: str) -> DeclarationError:
        return DeclarationError(f"knob {self.name}: `{field}` is {getattr(self, field)!r}. Expected {expected}")

    @property
    def parameter(self) -> str:
        """The name of the task's parameter."""
        return parameter_name(self.name)

    def declaration(self) -> dict:
        """The parameter in the form of the bridge protocol."""
        out: dict[str, Any] = {"name": self.parameter, "unit": self.unit, "meaning": self.meaning, "read_from": self.read_from}
        if self.choices:
            out |= {"kind": "categorical", "choices": list(self.choices)}
        else:
            out |= {"kind": "integer" if self.integer else "continuous", "low": self.low, "high": self.high}
        if self.nominal is not None:
            out["nominal"] = self.nominal
        if self.family:
            out["family"] = self.family
        return out


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def parameter_name(knob: str) -> str:
    """The name of the parameter that a knob becomes."""
    if not knob.isascii():
        # An accent is left out, and any other character becomes its code point, so that names stay different.
        plain = "".join(c for c in unicodedata.normalize("NFKD", knob) if not unicodedata.combining(c))
        knob = "".join(c if c.isascii() else f"_u{ord(c):x}_" for c in plain)
    name = re.sub(r"[^A-Za-z0-9]+", "_", knob).strip("_")
    if len(name) <= MAX_NAME:
        return name
    # Names that differ only after the limit stay different.
    return f"{name[: MAX_NAME - 9]}_{hashlib.blake2b(name.encode(), digest_size=4).hexdigest()}"


def differs(wanted: Any, found: Any) -> bool:
    """Whether a value that was read is another one than the requested, up to single precision."""
    if isinstance(wanted, str) or isinstance(found, str):
        return wanted != found
    return not abs(wanted - found) <= 1e-6 * max(abs(wanted), 0.1)


class Undoing:
    """Gives knobs back the values that they had before their first change.

    Most resets do that. Where one does not, the reset has also used the value of the episode before, for example for a start or an
    observation. Then it runs again, and from then on the first value is set before each reset.
    """

    def __init__(self) -> None:
        # By parameter. None where neither `read` nor `nominal` knows it.
        self._first: dict[str, Any] = {}
        self._kept: dict[str, Knob] = {}
        self._before: list[tuple[Knob, Any]] = []
        self._now: list[tuple[Knob, Any]] = []

    def learn(self, env: Any, knobs: Sequence[Knob], reset: Callable[[], Any]) -> None:
        """Find the knobs that a reset leaves as they are, before the first episode: each episode then has one reset."""
        try:
            for knob in knobs:
                other = _other(knob, _found(knob, env, knob.nominal))
                if other is not None:
                    self.set(knob, env, other)
            self._before, self._now = self._now, []
            reset()
            self.kept(env)
        except Exception:
            # What the environment does not accept outside of an episode is found in the episodes.
            for knob, _ in self._now:
                with suppress(Exception):
                    knob.set(env, self._first[knob.parameter])
            self._before, self._now = [], []
        reset()

    def begin(self, env: Any) -> None:
        """Before the reset of an episode."""
        self._before, self._now = self._now, []
        for parameter, knob in self._kept.items():
            knob.set(env, self._first[parameter])

    def set(self, knob: Knob, env: Any, value: Any) -> None:
        if knob.parameter not in self._first:
            self._first[knob.parameter] = _found(knob, env, knob.nominal)
        knob.set(env, value)
        self._now.append((knob, value))

    def kept(self, env: Any) -> bool:
        """Whether the reset that has just run left a knob as the episode before had set it. Then it must run again."""
        overridden = {knob.parameter for knob, _ in self._now}
        found = []
        for knob, value in self._before:
            first = self._first[knob.parameter]
            open_ = knob.parameter not in overridden and knob.parameter not in self._kept
            if open_ and first is not None and differs(first, value) and not differs(value, _found(knob, env, first)):
                found.append(knob)
        self._kept |= {knob.parameter: knob for knob in found}
        for knob in found:
            knob.set(env, self._first[knob.parameter])
        return bool(found)


def _other(knob: Knob, value: Any) -> Any:
    """A value that differs from this one. None if there is none."""
    if value is None:
        return None
    if knob.choices:
        return next((choice for choice in knob.choices if choice != value), None)
    if isinstance(value, str):
        return None
    return max((knob.low, knob.high), key=lambda end: abs(end - value))


def _found(knob: Knob, env: Any, otherwise: Any) -> Any:
    """The value that acts, if it can be read outside of an episode."""
    try:
        found = knob.read(env)
    except Exception:
        return otherwise
    return otherwise if found is None else found
