"""An environment that breaks on purpose, for scripts/environments_faults.sh: FAULT is raise, hang, nan, kill or start."""

import os
import signal
import time

import gymnasium
import numpy as np
from robogate_eval import Environment, Policy, Task


class Faulty(gymnasium.Env):
    """A point moves to a target. In a few steps, the environment breaks. Its chance does not depend on the seed."""

    observation_space = gymnasium.spaces.Box(-10.0, 10.0, (2,), dtype=np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), dtype=np.float64)

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        if os.environ.get("FAULT") == "start":
            time.sleep(3600)
        self.state = np.array([0.0, self.np_random.uniform(1.0, 2.0)])
        return self.state.copy(), {}

    def step(self, action):
        self.state[0] += 0.05 * action[0]
        if self.state[0] > 0.5 and int.from_bytes(os.urandom(2), "little") < 65:
            self.breaks(os.environ.get("FAULT"))
        return self.state.copy(), 0.0, False, False, {"success": bool(abs(self.state[1] - self.state[0]) < 0.03)}

    def breaks(self, how):
        if how == "raise":
            raise RuntimeError("the simulation licence has expired")
        if how == "hang":
            time.sleep(3600)
        if how == "nan":
            self.state[0] = np.nan
        if how == "kill":
            os.kill(os.getpid(), signal.SIGKILL)


environment = Environment(
    make=Faulty,
    task=Task(name="faulty", control_period_s=0.05, time_limit_s=5.0),
    knobs=["action_delay"],
    space={"action_delay": (0, 4)},
    policies={"go": Policy(lambda env: lambda o: np.clip(10.0 * (o[1:] - o[:1]), -1.0, 1.0))},
)
