"""Results of runs and gates, as objects with a notebook view."""

from __future__ import annotations

import csv
import html
import json
import re
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from . import notebook
from ._command import run_command

# A number of a table, before a unit or an interval.
NUMBER = re.compile(r"^[-\N{MINUS SIGN}+]?\d[\d,]*(\.\d+)?([eE][-+]?\d+)?(?=$|\s*(%|\())")


class Run:
    """A finished run in its folder."""

    def __init__(self, folder: "str | Path"):
        self.folder = Path(folder)
        file = self.folder / "summary.json"
        if not file.is_file():
            raise FileNotFoundError(f"{self.folder}: not a finished run: it has no summary.json. Hint: robogate resume {self.folder}")
        self.summary: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))

    @property
    def episodes(self) -> int:
        """Number of episodes, the invalid ones included."""
        return self.summary["episodes"]

    @property
    def success_rate(self) -> float | None:
        """Estimate of the success rate of the population that `summary["estimate"]` names. None without a valid episode."""
        return (self.summary.get("estimate") or {}).get("success_rate")

    @property
    def interval_95(self) -> tuple[float, float] | None:
        """The 95 % confidence interval of `success_rate`."""
        interval = (self.summary.get("estimate") or {}).get("interval_95")
        return None if interval is None else tuple(interval)

    @property
    def report(self) -> Path:
        """The report page."""
        return self.folder / "report.html"

    def rows(self) -> Any:
        """The episodes as a pandas DataFrame, one row each. Needs pandas and pyarrow."""
        import pandas

        return pandas.read_parquet(self.folder / "dictionary.parquet")

    def table(self) -> Any:
        """The episodes as an Arrow table. Needs pyarrow."""
        import pyarrow.parquet

        return pyarrow.parquet.read_table(self.folder / "dictionary.parquet")

    def figures(self) -> dict[str, str]:
        """The figures of the report page: their names and titles."""
        lines = self._figure().splitlines()
        return {name: title.strip() for name, _, title in (line.partition(" ") for line in lines)}

    def figure(self, name: str, axes: Any = None) -> Any:
        """Draw the data of a figure of the report page with matplotlib, on `axes` or in a new figure. Return the axes.

        Numbers of the first column are the horizontal axis, and words are bars. `robogate figure DIR NAME` writes the figure as
        the page shows it.

        Raises:
            ValueError: The page has no figure of this name.
        """
        axes = notebook.axes_of(axes)
        with tempfile.TemporaryDirectory(prefix="robogate-") as folder:
            file = Path(folder) / "data.csv"
            self._figure(name, "--csv", str(file))
            with open(file, encoding="utf-8", newline="") as text:
                head, *rows = csv.reader(text)
        columns = [[_parsed(cell) for cell in column] for column in zip(*rows)]
        first, *others = columns or [[]]
        drawn = [(label, values) for label, values in zip(head[1:], others) if any(isinstance(value, float) for value in values)]
        if all(isinstance(value, float) for value in first):
            for label, values in drawn:
                axes.plot(first, [value if isinstance(value, float) else float("nan") for value in values], label=label)
            axes.set_xlabel(head[0])
        else:
            height = 0.8 / max(len(drawn), 1)
            for at, (label, values) in enumerate(drawn):
                places = [row + at * height for row in range(len(first))]
                axes.barh(places, [value if isinstance(value, float) else 0.0 for value in values], height, label=label)
            axes.set_yticks(range(len(first)), [str(value) for value in first])
            axes.invert_yaxis()
        if drawn:
            axes.legend()
        axes.set_title(self.figures().get(name, name))
        return axes

    def _figure(self, *arguments: str) -> str:
        done = run_command("figure", str(self.folder), *arguments, capture_output=True, text=True)
        if done.returncode != 0:
            raise ValueError(done.stderr.strip())
        return done.stdout

    def __repr__(self) -> str:
        return f"Run({str(self.folder)!r}: {self.episodes} episodes, success {_rate(self.success_rate, self.interval_95)})"

    def _repr_html_(self) -> str:
        # A page of a suite or a gate has stages too, and each names the population that it estimates.
        rows = [
            (stage["stage"], stage["valid"], stage["invalid"], _rate(stage.get("success_rate"), stage.get("interval_95")), _modes(stage))
            for stage in self.summary.get("stages", [])
        ]
        heads = ("stage", "valid episodes", "invalid", "success (95 % interval)", "failures")
        return f"<b>Run {html.escape(str(self.folder))}</b>{_table(heads, rows)}<a href='{_link(self.report)}'>report</a>"


class Verdict:
    """The verdict of a gate."""

    def __init__(self, folder: "str | Path"):
        self.folder = Path(folder)
        file = self.folder / "gate.json"
        if not file.is_file():
            raise FileNotFoundError(f"{self.folder}: not a finished gate: it has no gate.json. Hint: robogate resume {self.folder}")
        self.evaluation: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))

    @property
    def verdict(self) -> str:
        """pass, fail, inconclusive or invalid."""
        return self.evaluation["verdict"]

    @property
    def because(self) -> str:
        """The reason in a few words."""
        return self.evaluation["because"]

    @property
    def results(self) -> list[dict[str, Any]]:
        """The result of each requirement."""
        return self.evaluation["results"]

    @property
    def run(self) -> Run:
        """The episodes of the gate."""
        return Run(self.folder)

    def __bool__(self) -> bool:
        """Whether the verdict is pass. So `assert gate(...)` is a test."""
        return self.verdict == "pass"

    def __repr__(self) -> str:
        return f"Verdict({self.verdict}: {self.because})"

    def _repr_html_(self) -> str:
        rows = [
            (one["id"], one["status"], _number((one.get("figure") or {}).get("observed")), _interval(one.get("interval")))
            for one in self.results
        ]
        heads = ("requirement", "status", "observed", "confidence interval")
        title = f"<b>{html.escape(self.verdict.upper())}</b> {html.escape(self.because)}"
        note = f"<p>{html.escape(self.evaluation.get('estimand', ''))}</p>"
        return f"{title}{_table(heads, rows)}{note}<a href='{_link(self.run.report)}'>report</a>"


def load(folder: "str | Path") -> "Run | Verdict":
    """Load a folder of `robogate run` or `robogate gate`.

    Raises:
        FileNotFoundError: The folder contains no finished run.
    """
    return Verdict(folder) if (Path(folder) / "gate.json").is_file() else Run(folder)


def _link(path: Path) -> str:
    return html.escape(notebook.relative(path), quote=True)


def _parsed(cell: str) -> "float | str":
    """A number where the cell is one. A thousands separator and a unit do not make it a word."""
    found = NUMBER.match(cell)
    return float(found[0].replace(",", "").replace("\N{MINUS SIGN}", "-")) if found else cell


def _table(heads: Iterable[str], rows: Iterable[tuple]) -> str:
    head = "".join(f"<th>{html.escape(text)}</th>" for text in heads)
    body = "".join(f"<tr>{''.join(f'<td>{html.escape(str(cell))}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _rate(rate: float | None, interval: Any) -> str:
    return "-" if rate is None else f"{100 * rate:.1f} % {_interval(interval, percent=True)}".rstrip()


def _interval(interval: Any, percent: bool = False) -> str:
    if not interval or None in interval:
        return ""
    low, high = interval
    return f"({100 * low:.1f} to {100 * high:.1f} %)" if percent else f"{_number(low)} to {_number(high)}"


def _number(x: float | None) -> str:
    return "-" if x is None else f"{x:.3g}"


def _modes(stage: dict[str, Any]) -> str:
    return ", ".join(f"{mode['mode']} {mode['episodes']}" for mode in stage.get("failure_modes", []) if mode["episodes"])
