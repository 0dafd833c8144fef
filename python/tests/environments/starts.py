"""Whether a seed fixes the start of an environment in any process and after any earlier episodes.

Run as a program, it resets environments with seeds in an order, and prints a digest of each start and of the first steps.
"""

import hashlib
import json
import subprocess
import sys

import numpy as np
from robogate_eval.environments import find
from robogate_eval.serving.model import find as find_model

SEEDS = (1, 2, 3)
# Another order, with other episodes in between.
OTHER = (9, 3, 1, 8, 2)
STEPS = 10
STATE = ("time", "qpos", "qvel", "act", "ctrl", "mocap_pos", "mocap_quat", "qacc_warmstart")
# Where the reset of an environment may put something.
MODEL = ("body_pos", "body_quat", "body_mass", "site_pos", "geom_pos", "geom_size", "geom_rgba", "cam_pos", "cam_quat", "light_pos", "eq_data")


def assert_seeds_fix_starts(test, names):
    """Fail unless each start and its first steps are the same bytes in two processes with different orders."""
    digests = [_digests(names, order) for order in (SEEDS, OTHER)]
    for name in names:
        for seed in map(str, SEEDS):
            one, other = (of[name][seed] for of in digests)
            test.assertEqual([key for key in one if one[key] != other.get(key)], [], f"{name}, seed {seed}: what differs")
        test.assertEqual(len({json.dumps(digests[0][name][str(seed)]) for seed in SEEDS}), len(SEEDS), f"{name}: seeds have no effect")


def _digests(names, order):
    command = [sys.executable, __file__, json.dumps([list(names), list(order)])]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    if ran.returncode != 0:
        raise AssertionError(ran.stderr)
    # Packages print when they are imported.
    return json.loads(ran.stdout.splitlines()[-1])


def _episode(env, seed):
    """Digests of the start and of the steps after it, by name."""
    values = {}

    def see(moment, observation):
        model, data = find_model(env)
        values.update({f"{moment} {field}": getattr(data, field) for field in STATE})
        if moment == "start":
            values.update({f"model {field}": getattr(model, field) for field in MODEL})
        parts = observation if isinstance(observation, dict) else {"observation": observation}
        values.update({f"{moment} {key}": part for key, part in parts.items()})

    observation, _ = env.reset(seed=seed)
    see("start", observation)
    digests = {name: _digest(value) for name, value in values.items()}
    random = np.random.default_rng(seed)
    low, high = env.action_space.low, env.action_space.high
    for step in range(STEPS):
        values.clear()
        see(f"step {step}", env.step(random.uniform(low, high).astype(env.action_space.dtype))[0])
        digests |= {name: _digest(value) for name, value in values.items()}
    return digests


def _digest(value):
    return hashlib.blake2b(np.ascontiguousarray(value).tobytes(), digest_size=8).hexdigest()


def main():
    names, order = json.loads(sys.argv[1])
    out = {}
    for name in names:
        env = find(name).make()
        out[name] = {seed: _episode(env, seed) for seed in order}
    print(json.dumps(out))


if __name__ == "__main__":
    main()
