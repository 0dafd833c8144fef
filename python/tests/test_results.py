"""Results as objects, their figures, and the view of a notebook."""

import os
import sys
import tempfile
import types
import unittest
from pathlib import Path
from unittest import mock

import robogate_eval
from robogate_eval import notebook

# Writes the CSV file of a figure, or lists the figures.
FIGURES = """
if [ $# -eq 2 ]; then
    echo "rates-by-mass        Success rate by mass"
    echo "failures             Failure modes"
    exit 0
fi
case $3 in
    rates-by-mass) printf 'mass (kg),rate,low,high\\n0.1,95.0 %%,90.0 %%,98.0 %%\\n"1,000.5",-,10,20\\n' > "$5" ;;
    failures) printf 'mode,episodes,note\\nslip,12,a\\njam,3,b\\n' > "$5" ;;
    *) echo "error: $3: no such figure" >&2; exit 2 ;;
esac
"""


class Axes:
    """Records what is drawn."""

    def __init__(self) -> None:
        self.calls: list = []

    def __getattr__(self, name: str):
        return lambda *arguments, **named: self.calls.append((name, arguments, named))

    def of(self, name: str) -> list:
        return [(arguments, named) for called, arguments, named in self.calls if called == name]


class WithCommand(unittest.TestCase):
    def setUp(self) -> None:
        work = tempfile.TemporaryDirectory()
        self.addCleanup(work.cleanup)
        self.work = Path(work.name)

    def command(self, text: str) -> None:
        file = self.work / "robogate"
        file.write_text(f"#!/bin/sh\n{text}\n")
        file.chmod(0o755)
        patched = mock.patch.dict(os.environ, {"ROBOGATE_COMMAND": str(file)})
        patched.start()
        self.addCleanup(patched.stop)


class Figures(WithCommand):
    def setUp(self) -> None:
        super().setUp()
        self.command(FIGURES)
        (self.work / "run").mkdir()
        (self.work / "run/summary.json").write_text('{"episodes": 3}')
        self.run_folder = robogate_eval.load(self.work / "run")

    def test_figures_are_listed(self) -> None:
        self.assertEqual(self.run_folder.figures(), {"rates-by-mass": "Success rate by mass", "failures": "Failure modes"})

    def test_numbers_are_lines(self) -> None:
        axes = Axes()
        self.assertIs(self.run_folder.figure("rates-by-mass", axes), axes)
        (first, rates), named = axes.of("plot")[0]
        self.assertEqual((first, named), ([0.1, 1000.5], {"label": "rate"}))
        self.assertEqual(rates[0], 95.0)
        self.assertNotEqual(rates[1], rates[1], "a missing value is not a number")
        self.assertEqual(axes.of("set_xlabel"), [(("mass (kg)",), {})])
        self.assertEqual(axes.of("set_title"), [(("Success rate by mass",), {})])

    def test_words_are_bars(self) -> None:
        axes = Axes()
        self.run_folder.figure("failures", axes)
        self.assertEqual([named for _, named in axes.of("barh")], [{"label": "episodes"}])
        self.assertEqual(axes.of("barh")[0][0][1], [12.0, 3.0])

    def test_unknown_figure_is_an_error(self) -> None:
        with self.assertRaisesRegex(ValueError, "no such figure"):
            self.run_folder.figure("other", Axes())


class Notebook(WithCommand):
    """The kernel of a notebook is imitated: IPython is not installed here."""

    def setUp(self) -> None:
        super().setUp()
        self.shown: list[str] = []
        handle = types.SimpleNamespace(update=lambda html: self.shown.append(html))
        display = types.SimpleNamespace(HTML=str, display=lambda html, display_id: handle)
        shell = types.SimpleNamespace(kernel=object())
        modules = {"IPython": types.SimpleNamespace(get_ipython=lambda: shell), "IPython.display": display}
        patched = mock.patch.dict(sys.modules, modules)
        patched.start()
        self.addCleanup(patched.stop)
        here = os.getcwd()
        os.chdir(self.work)
        self.addCleanup(os.chdir, here)

    def test_terminal_is_no_notebook(self) -> None:
        self.assertTrue(notebook.in_notebook())
        with mock.patch.dict(sys.modules, {"IPython": types.SimpleNamespace(get_ipython=lambda: object())}):
            self.assertFalse(notebook.in_notebook())

    def test_progress_replaces_output(self) -> None:
        self.command('echo "error: hidden"; echo "uniform  1,200/3,000  1,000 success, 200 <slip>" >&2; exit 3')
        self.assertEqual(notebook.run("gate", results=(0, 3)), 3)
        bar = "<progress value='1200' max='3000'></progress> uniform 1,200 of 3,000: 1,000 success, 200 &lt;slip&gt;"
        self.assertEqual(self.shown, [bar, ""])

    def test_error_shows_output(self) -> None:
        self.command('echo "error: no <such> environment"; exit 2')
        self.assertEqual(notebook.run("gate", results=(0, 3)), 2)
        self.assertEqual(self.shown, ["<pre>error: no &lt;such&gt; environment</pre>"])

    def test_results_are_beside_the_notebook(self) -> None:
        self.command('while [ "$1" != --out ]; do shift; done; mkdir -p "$2"; echo \'{"episodes": 3}\' > "$2/summary.json"')
        run = robogate_eval.run("metaworld:push-v3")
        folder = run.folder.resolve().relative_to(self.work.resolve())
        self.assertEqual(folder.parts[0], "runs")
        self.assertIn(f"href='{folder.as_posix()}/report.html'", run._repr_html_())


class Names(unittest.TestCase):
    def test_every_name_exists_and_has_a_description(self) -> None:
        for name in robogate_eval.__all__:
            self.assertTrue(getattr(robogate_eval, name).__doc__, name)
        self.assertLessEqual(set(robogate_eval.__all__), set(dir(robogate_eval)))


if __name__ == "__main__":
    unittest.main()
