"""Tests of the readers of LIBERO's files: task files and initial states. They need NumPy, but no LIBERO."""

import io
import os
import pickle
import sys
import tempfile
import unittest
import zipfile
from pathlib import Path
from unittest import mock

import numpy as np

from robogate_eval.libero import bddl, initial_states, installation
from robogate_eval.libero.suites import SUITES, suite, wording
from robogate_eval.libero.world import World

TASK = """
(define (problem LIBERO_Tabletop_Manipulation)
  (:domain robosuite)
  (:language Open the top layer of the drawer and put the bowl inside)  ; as in the file
  (:fixtures
    main_table - table
    wooden_cabinet_1 - wooden_cabinet
  )
  (:objects
    bowl_1 bowl_2 - akita_black_bowl
    plate_1 - plate
  )
  (:obj_of_interest
    bowl_1
  )
  (:init
    (On bowl_1 main_table_region)
  )
  (:goal
    (And (Open wooden_cabinet_1_top_region) (In bowl_1 wooden_cabinet_1_top_region))
  )
)
"""


class TheTaskFile(unittest.TestCase):
    def test_is_read(self):
        task = bddl.parse(TASK)
        self.assertEqual(task.instruction, "Open the top layer of the drawer and put the bowl inside")
        self.assertEqual(task.problem, "LIBERO_Tabletop_Manipulation")
        self.assertEqual(task.goal, (("open", "wooden_cabinet_1_top_region"), ("in", "bowl_1", "wooden_cabinet_1_top_region")))
        self.assertEqual(task.objects, {"akita_black_bowl": ("bowl_1", "bowl_2"), "plate": ("plate_1",)})
        self.assertEqual(task.interest, ("bowl_1",))

    def test_may_have_one_predicate(self):
        text = TASK.replace("(And (Open wooden_cabinet_1_top_region) (In bowl_1 wooden_cabinet_1_top_region))", "(Turnon stove_1)")
        self.assertEqual(bddl.parse(text).goal, (("turnon", "stove_1"),))

    def test_with_errors_is_explained(self):
        cases = {
            "": "not closed",
            "goal": "starts with",
            "(define": "not closed",
            "(problem x)": "expected (define",
            TASK.replace(":language", ":words"): ":language is missing",
            TASK.replace("(And (Open wooden_cabinet_1_top_region) (In bowl_1 wooden_cabinet_1_top_region))", "bowl_1"): "not a predicate",
            TASK.replace("plate_1 - plate", "plate_1"): "no category",
            "(" * 100: "nested deeper",
        }
        for text, expected in cases.items():
            with self.subTest(expected=expected), self.assertRaises(bddl.TaskFileError) as raised:
                bddl.parse(text)
            self.assertIn(expected, str(raised.exception))

    def test_with_random_damage_raises_nothing_else(self):
        random = np.random.default_rng(1)
        for _ in range(300):
            letters = list(TASK)
            for position in random.integers(len(letters), size=5):
                letters[position] = random.choice(list("() -;x\n"))
            try:
                bddl.parse("".join(letters))
            except bddl.TaskFileError:
                pass

    def test_that_is_missing_is_named(self):
        with self.assertRaisesRegex(bddl.TaskFileError, "absent.bddl"):
            bddl.read("/nowhere/absent.bddl")


def archive(raw):
    """A file of initial states with this pickle."""
    folder = tempfile.mkdtemp()
    path = Path(folder) / "task.pruned_init"
    with zipfile.ZipFile(path, "w") as out:
        out.writestr("archive/data.pkl", raw)
    return path


class Evil:
    def __reduce__(self):
        return os.system, ("false",)


class InitialStates(unittest.TestCase):
    states = np.arange(12.0).reshape(3, 4)

    def test_are_read(self):
        for protocol in (2, 3):
            found = initial_states.read(archive(pickle.dumps(self.states, protocol=protocol)))
            np.testing.assert_array_equal(found, self.states)

    def test_are_read_from_a_converted_file(self):
        states = np.arange(6.0).reshape(2, 3)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "open_it.pruned_init"
            np.savez_compressed(f"{path}.npz", states=states)
            np.testing.assert_array_equal(initial_states.read(path), states)
            np.savez_compressed(f"{path}.npz", states=np.array([[object()]]))
            with self.assertRaisesRegex(initial_states.InitialStatesError, "open_it.pruned_init.npz"):
                initial_states.read(path)
            np.savez_compressed(f"{path}.npz", other=states)
            with self.assertRaisesRegex(initial_states.InitialStatesError, "states.npy"):
                initial_states.read(path)

    def test_run_no_code(self):
        with self.assertRaisesRegex(initial_states.InitialStatesError, "Only an array"):
            initial_states.decode(pickle.dumps(Evil(), protocol=2))

    def test_with_another_content_are_rejected(self):
        for value in ([1.0], np.arange(3.0), np.array([[np.nan]]), np.array([[1, 2]]), np.array([[None]], dtype=object)):
            with self.subTest(value=value), self.assertRaises(initial_states.InitialStatesError):
                initial_states.decode(pickle.dumps(value, protocol=2))

    def test_with_damage_raise_nothing_else(self):
        raw = pickle.dumps(self.states, protocol=2)
        random = np.random.default_rng(2)
        for _ in range(500):
            damaged = bytearray(raw[: random.integers(1, len(raw) + 1)])
            for position in random.integers(len(damaged), size=3):
                damaged[position] = random.integers(256)
            try:
                initial_states.decode(bytes(damaged))
            except initial_states.InitialStatesError:
                pass

    def test_in_no_archive_are_explained(self):
        with tempfile.NamedTemporaryFile() as file, self.assertRaisesRegex(initial_states.InitialStatesError, file.name):
            initial_states.read(file.name)


class Installation(unittest.TestCase):
    def test_inner_folder_on_the_path_is_reported(self):
        # The first import of LIBERO's inner package asks a question, which would block a server.
        with tempfile.TemporaryDirectory() as folder:
            inner = Path(folder) / "libero"
            inner.mkdir()
            (inner / "__init__.py").write_text("raise AssertionError('imported')")
            (inner / "envs").mkdir()
            sys.path.insert(0, folder)
            try:
                with self.assertRaisesRegex(installation.LiberoMissing, "no folder `libero`"):
                    installation.folder()
            finally:
                sys.path.remove(folder)


class Suites(unittest.TestCase):
    def test_have_the_limits_of_the_benchmark(self):
        self.assertEqual({name: suite.steps for name, suite in SUITES.items()}, {"spatial": 220, "object": 280, "goal": 300, "10": 520})

    def test_variants_have_the_limit_of_their_original(self):
        order = {"libero_goal": [], "libero_goal_swap": []}
        found = suite("goal_swap", order)
        self.assertEqual((found.folder, found.steps, found.original), ("libero_goal_swap", 300, "libero_goal"))
        self.assertIsNone(suite("goal", order).original)
        self.assertIsNone(suite("goal_lan", order))
        self.assertIsNone(suite("swap", order))

    def test_variants_of_the_instruction_send_it(self):
        with tempfile.TemporaryDirectory() as folder:
            for place, text in (("libero_goal", "Open it"), ("libero_goal_lan", "Pull it open"), ("libero_goal_swap", "Open it")):
                (Path(folder) / "bddl_files" / place).mkdir(parents=True)
                (Path(folder) / "bddl_files" / place / "open_it.bddl").write_text(
                    TASK.replace("Open the top layer of the drawer and put the bowl inside", text)
                )
            told = {}
            for name in ("goal", "goal_lan", "goal_swap"):
                world = World.__new__(World)
                world.suite = suite(name, {"libero_goal_lan": [], "libero_goal_swap": []})
                with mock.patch.object(installation, "folder", lambda: Path(folder)):
                    told[name] = world.told("open_it")
        self.assertEqual(told, {"goal": "open it", "goal_lan": "Pull it open", "goal_swap": "open it"})

    def test_name_the_wording_of_file_names(self):
        self.assertEqual(wording("put_the_bowl_on_the_stove"), "put the bowl on the stove")
        self.assertEqual(wording("KITCHEN_SCENE3_turn_on_the_stove"), "turn on the stove")
        self.assertEqual(wording("KITCHEN_SCENE10_close_the_drawer"), "close the drawer")


if __name__ == "__main__":
    unittest.main()
