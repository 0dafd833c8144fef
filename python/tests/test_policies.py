"""Policies and options of `robogate_eval.run` and `gate`, without a command and without packages."""

import tempfile
import tomllib
import unittest
import zipfile
from pathlib import Path
from unittest import mock

from robogate_eval import judging, policies
from robogate_eval.serving.environment import DeclarationError
from robogate_eval.serving.knobs import Knob


class Options(unittest.TestCase):
    def test_dicts_become_files(self):
        table = {"vectors": {"eef_pos": ["observation[0:3]", 0.5], "q": {"from": "a", "scale": -1.0}}, "cameras": {"front": "corner\"2"}}
        with judging._tables_as_files({"map": table, "profile": "pi0-libero", "seed": 7}) as options:
            self.assertEqual(tomllib.loads(options["map"].read_text(encoding="utf-8")), table)
            self.assertEqual((options["profile"], options["seed"]), ("pi0-libero", 7))
            file = options["map"]
        self.assertFalse(file.exists())


class Folders(unittest.TestCase):
    def test_failed_calls_leave_no_empty_folder(self):
        with tempfile.TemporaryDirectory() as folder, mock.patch.object(tempfile, "tempdir", folder):
            with self.assertRaises(RuntimeError), judging._folder(None, "run"):
                raise RuntimeError
            self.assertEqual(list(Path(folder).iterdir()), [])
            with self.assertRaises(RuntimeError), judging._folder(None, "run") as out:
                out.mkdir()
                raise RuntimeError
            self.assertTrue(out.is_dir())


class Knobs(unittest.TestCase):
    def test_values_of_wrong_kind_are_named(self):
        def knob(**values):
            return Knob("drag", lambda env, value: None, lambda env: 0.0, **values)

        self.assertEqual(knob(low=0, high=4.0, nominal=1).high, 4.0)
        self.assertEqual(knob(choices=["wet", "dry"], nominal="wet").low, None)
        wrong = [
            ("high", {"low": 0.0, "high": "x"}),
            ("high", {"low": 0.0}),
            ("low", {"low": True, "high": 1}),
            ("nominal", {"low": 0.0, "high": 1.0, "nominal": "x"}),
            ("nominal", {"choices": ["wet"], "nominal": 1}),
            ("choices", {"choices": "wet"}),
            ("unit", {"low": 0.0, "high": 1.0, "unit": None}),
        ]
        for field, values in wrong:
            with self.assertRaisesRegex(DeclarationError, f"knob drag: `{field}` is .*Expected"):
                knob(**values)
        with self.assertRaisesRegex(DeclarationError, "knob drag: `read` is 0.0"):
            Knob("drag", lambda env, value: None, 0.0, 0.0, 1.0)


class Policies(unittest.TestCase):
    def test_functions_and_models(self):
        class Model:
            def predict(self, observation, deterministic):
                return observation + deterministic, None

        class Stateful:
            count = 0

            def reset(self):
                self.count = 0

            def __call__(self, observation):
                self.count += 1
                return self.count

        self.assertEqual(policies.as_function(Model())(1), 2)
        policy = Stateful()
        for _ in range(2):
            act = policies.as_function(policy)
            self.assertEqual([act(None), act(None)], [1, 2])
        with self.assertRaisesRegex(TypeError, "int: not a policy"):
            policies.as_function(3)

    def test_other_archives_are_refused(self):
        self.assertTrue(policies.is_model_file("a/model.zip"))
        self.assertFalse(policies.is_model_file("model.onnx"))
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "model.zip"
            path.write_text("no archive")
            with self.assertRaisesRegex(ValueError, "not a model of Stable-Baselines3"):
                policies.load(path)
            with zipfile.ZipFile(path, "w") as archive:
                archive.writestr("other", "{}")
            with self.assertRaisesRegex(ValueError, "not a model of Stable-Baselines3"):
                policies.load(path)


if __name__ == "__main__":
    unittest.main()
