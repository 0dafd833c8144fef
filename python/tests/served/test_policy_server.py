"""Policies behind a server: batches of several episodes, and openpi's own client. Needs numpy, msgpack, websockets and openpi-client."""

import contextlib
import io
import json
import subprocess
import sys
import threading
import time
import unittest

import numpy as np
from openpi_client.websocket_client_policy import WebsocketClientPolicy

from robogate_eval.policy_server import Batcher, as_batch

SERVED = """
import numpy as np
import robogate_eval

class Doubles:
    def predict_batch(self, observations):
        if any("fail" in observation for observation in observations):
            raise ValueError("no such camera")
        return [np.tile(2.0 * observation["state"], (3, 1)) for observation in observations]

robogate_eval.serve(Doubles(), bind="ws://127.0.0.1:*", batch=8, metadata={"model": "doubles"})
"""


class Slow:
    """Takes the same time for any number of requests, as a large model does."""

    def predict_batch(self, observations):
        time.sleep(0.02)
        return [observation["state"] for observation in observations]


def ask(batcher, episodes, requests):
    """The answers of so many episodes that run at once, by episode."""
    answers = [[] for _ in range(episodes)]

    def run(episode):
        with batcher.episode():
            for number in range(requests):
                state = np.array([float(episode), float(number)])
                try:
                    answers[episode].append(batcher.ask({"state": state})[0])
                except ValueError as error:
                    answers[episode].append(str(error))

    threads = [threading.Thread(target=run, args=(episode,)) for episode in range(episodes)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return answers


class Batches(unittest.TestCase):
    def test_requests_of_all_episodes_are_answered_together(self):
        batcher = Batcher(as_batch(Slow())[0], most=16)
        with contextlib.redirect_stdout(io.StringIO()):
            answers = ask(batcher, 8, 12)
        for episode, own in enumerate(answers):
            np.testing.assert_array_equal(np.concatenate(own), [[episode, number] for number in range(12)])
        self.assertGreater(batcher.requests / batcher.batches, 0.8 * 8)

    def test_dependent_answers_are_not_batched(self):
        class Centred:
            def predict_batch(self, observations):
                time.sleep(0.01)
                states = np.array([observation["state"] for observation in observations])
                return states - states.mean(axis=0) + 1.0

        batcher, said = Batcher(as_batch(Centred())[0], most=16), io.StringIO()
        with contextlib.redirect_stdout(said):
            answers = ask(batcher, 4, 6)
        self.assertIn("no batches: an answer in a batch of", said.getvalue())
        np.testing.assert_array_equal(np.concatenate(sum(answers, [])), 1.0)

    def test_one_bad_request_fails_alone(self):
        class Picky:
            def predict_batch(self, observations):
                time.sleep(0.01)
                if any(observation["state"][0] == 2.0 for observation in observations):
                    raise ValueError("no such episode")
                return [observation["state"] for observation in observations]

        with contextlib.redirect_stdout(io.StringIO()):
            answers = ask(Batcher(as_batch(Picky())[0], most=16), 4, 3)
        self.assertEqual(answers[2], ["no such episode"] * 3)
        np.testing.assert_array_equal(np.concatenate(answers[3]), [[3.0, number] for number in range(3)])

    def test_functions_are_answered_one_by_one(self):
        answer, together = as_batch(lambda observation: observation["state"])
        self.assertFalse(together)
        self.assertEqual(answer([{"state": 1}, {"state": 2}]), [1, 2])
        with self.assertRaisesRegex(TypeError, "int: not a policy. Expected an object with `predict_batch"):
            as_batch(3)


class Server(unittest.TestCase):
    def test_client_of_openpi_is_answered(self):
        with subprocess.Popen([sys.executable, "-c", SERVED], stdout=subprocess.PIPE, text=True) as process:
            try:
                declared = json.loads(process.stdout.readline())
                host, port = declared["address"].removeprefix("ws://").rsplit(":", 1)
                client = WebsocketClientPolicy(host, int(port))
                self.assertEqual(client.get_server_metadata(), {"model": "doubles", "batch": 8})
                answer = client.infer({"state": np.array([0.5, -1.0]), "image": np.zeros((4, 4, 3), np.uint8)})
                np.testing.assert_array_equal(answer["actions"], [[1.0, -2.0]] * 3)
                self.assertEqual(answer["server_timing"]["batch"], 1)
                with self.assertRaisesRegex(RuntimeError, "ValueError: no such camera"):
                    client.infer({"fail": 1, "state": np.zeros(2)})
                again = WebsocketClientPolicy(host, int(port))
                np.testing.assert_array_equal(again.infer({"state": np.ones(1)})["actions"], [[2.0]] * 3)
            finally:
                process.kill()


if __name__ == "__main__":
    unittest.main()
