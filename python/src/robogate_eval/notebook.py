"""The command in a notebook: one progress bar below the cell in place of its output."""

from __future__ import annotations

import html
import os
import re
import subprocess
import sys
from collections import deque
from pathlib import Path
from typing import Any

from ._command import command

# Without a terminal, the command prints a line for each tenth of a stage: its name, the episodes so far, and their outcomes.
PROGRESS = re.compile(r"^\s*(?P<stage>\S.*?)\s+(?P<done>[\d,]+)/(?P<all>[\d,]+)\s+(?P<outcomes>.*)$")
# The last lines are shown if the command fails.
KEPT_LINES = 40


def in_notebook() -> bool:
    """Whether a notebook's kernel runs this process. IPython in a terminal is not one."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return getattr(shell, "kernel", None) is not None


def run(*arguments: "str | os.PathLike[str]", results: "tuple[int, ...]") -> int:
    """Run the command and return its exit code. Its output is shown only if the code is not one of `results`."""
    from IPython.display import HTML, display

    shown = display(HTML("<i>robogate starts</i>"), display_id=True)
    last: deque[str] = deque(maxlen=KEPT_LINES)
    words = [str(command()), *map(os.fspath, arguments)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace") as process:
        try:
            for line in process.stdout or ():
                last.append(line.rstrip())
                bar = progress(line)
                if bar is not None:
                    shown.update(HTML(bar))
        except BaseException:
            # An interrupted cell ends the command, which then can be resumed.
            process.terminate()
            raise
    if process.returncode in results:
        shown.update(HTML(""))
    else:
        shown.update(HTML(f"<pre>{html.escape(chr(10).join(last))}</pre>"))
    return process.returncode


def progress(line: str) -> str | None:
    """The bar of a line of progress, as HTML."""
    found = PROGRESS.match(line)
    if found is None:
        return None
    done, every = (int(found[name].replace(",", "")) for name in ("done", "all"))
    text = f"{found['stage']} {done:,} of {every:,}: {found['outcomes'].strip()}"
    return f"<progress value='{done}' max='{max(every, 1)}'></progress> {html.escape(text)}"


def relative(path: Path) -> str:
    """A path as a link of a notebook: relative to its folder where possible."""
    try:
        return path.resolve().relative_to(Path.cwd()).as_posix()
    except ValueError:
        return path.resolve().as_uri()


def axes_of(axes: Any) -> Any:
    """These axes, or those of a new figure of matplotlib."""
    if axes is not None:
        return axes
    try:
        from matplotlib import pyplot
    except ImportError as error:
        raise ImportError("plots need matplotlib. Hint: pip install matplotlib") from error
    return pyplot.subplots()[1]
