"""Policies and options of `robogate_eval.run` and `gate`, without a command and without packages."""

import tempfile
import tomllib
import unittest
import zipfile
from pathlib import Path

from robogate_eval import judging, policies


class Options(unittest.TestCase):
    def test_dicts_become_files(self):
        table = {"vectors": {"eef_pos": ["observation[0:3]", 0.5], "q": {"from": "a", "scale": -1.0}}, "cameras": {"front": "corner\"2"}}
        with judging._tables_as_files({"map": table, "profile": "pi0-libero", "seed": 7}) as options:
            self.assertEqual(tomllib.loads(options["map"].read_text(encoding="utf-8")), table)
            self.assertEqual((options["profile"], options["seed"]), ("pi0-libero", 7))
            file = options["map"]
        self.assertFalse(file.exists())


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
