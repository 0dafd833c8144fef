"""Episodes in several processes, whose policy answers in batches in this one."""

import io
import unittest
from contextlib import redirect_stderr
from pathlib import Path
from unittest import mock

import numpy as np

from robogate_bridge.client import Client
from robogate_eval import judging, stable_baselines
from robogate_eval.environments import find
from robogate_eval.in_flight import served

POINT = str(Path(__file__).parents[3] / "docs/examples/point/env.py")


def steer(observation):
    """Numbers of a vector that lead to the target."""
    place, speed, target = np.split(np.asarray(observation), 3, axis=-1)
    return np.tanh(3.0 * (target - place) - 1.5 * speed)


class Steers:
    """Answers with two actions for each request."""

    def predict_batch(self, observations):
        return [np.tile(action, (2, 1)) for action in steer(np.stack(observations))]


class Centred(Steers):
    """Its answers depend on the batch."""

    def predict_batch(self, observations):
        actions = steer(np.stack(observations))
        return list((actions - actions.mean(axis=0))[:, None])


class Draws(Steers):
    def predict_batch(self, observations):
        return [np.random.default_rng().uniform(-1.0, 1.0, (1, 2)) for _ in observations]


class Model:
    """What a model of Stable-Baselines3 offers."""

    def predict(self, observation, deterministic):
        return steer(observation), None


def drive(address, policy, periods=6):
    """The first actions that the policy proposes in an episode."""
    client = Client(address)
    reply = client._ask("reset", 1, index=3, seed=3, parameters={}, cell=None, policy=policy)[0]
    client.episode, proposed = 1, []
    for _ in range(periods):
        proposed.append(reply["proposed"]["action"])
        reply = client.step([reply["proposed"]["action"]], action_space="vector")[-1]
    return np.array(proposed)


class InFlight(unittest.TestCase):
    def test_episodes_are_those_of_one_process(self):
        environment, said = find(POINT), io.StringIO()
        with redirect_stderr(said), served(environment, "Steers", Steers(), 4) as addresses:
            self.assertEqual(len(set(addresses)), 4)
            versions = {Client(address).hello()["policies"][-1]["version"] for address in addresses}
            found = [drive(address, "Steers") for address in addresses]
        self.assertEqual(len(versions), 1)
        self.assertRegex(versions.pop(), "an answer in a batch of 4 differs by 0 from the answer alone")
        self.assertRegex(said.getvalue(), r"policy: \d+ requests, .* in a batch on average of at most 4, busy in")
        for actions in found:
            np.testing.assert_array_equal(actions, found[0])
        # Both actions of an answer are executed.
        np.testing.assert_array_equal(found[0][0::2], found[0][1::2])

    def test_dependent_answers_are_not_batched(self):
        with redirect_stderr(io.StringIO()), served(find(POINT), "Centred", Centred(), 3) as addresses:
            version = Client(addresses[0]).hello()["policies"][-1]["version"]
            self.assertIn("no batches: an answer in a batch of 3 differs by", version)
            np.testing.assert_array_equal(drive(addresses[1], "Centred"), 0.0)

    def test_policies_that_cannot_be_batched_are_refused(self):
        for policy, why in [(Draws(), "answers to one request vary by .* an episode must repeat"), (steer, "answers one request at a time")]:
            with self.assertRaisesRegex(ValueError, why), served(find(POINT), "own", policy, 2):
                pass
        class Wrong(Steers):
            def predict_batch(self, observations):
                raise KeyError("camera")

        # The user sees the error of the own code.
        with self.assertRaisesRegex(KeyError, "camera"), served(find(POINT), "own", Wrong(), 2):
            pass

    def test_models_of_stable_baselines_share_a_batch(self):
        found = []
        for policy in (Steers(), stable_baselines.Model(Model(), None, None, []), Model()):
            with redirect_stderr(io.StringIO()), served(find(POINT), "own", policy, 2) as addresses:
                found.append(drive(addresses[1], "own", periods=1))
        np.testing.assert_array_equal(found[0], found[1])
        np.testing.assert_array_equal(found[0], found[2])
        masked = type("MaskablePPO", (Model,), {})()
        self.assertIsNone(stable_baselines.batched(masked))

    def test_run_names_all_processes(self):
        with mock.patch.object(judging, "_run", return_value=0) as command, redirect_stderr(io.StringIO()):
            judging._command(POINT, Steers(), {"in_flight": 3}, ["run"])
        arguments = command.call_args.args
        self.assertEqual(arguments[1], "--simulator")
        self.assertEqual((len(arguments[2].split(",")), arguments[3:]), (3, ("--policy", "Steers")))


if __name__ == "__main__":
    unittest.main()
