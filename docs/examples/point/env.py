"""A point that a policy steers to a target. The network returns numbers from -1 to 1, and an action goes to 2."""

import gymnasium, numpy as np
from robogate_eval import Environment, Knob, Task

class Point(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-10.0, 10.0, (6,))
    action_space = gymnasium.spaces.Box(-2.0, 2.0, (2,))
    drag = 1.0

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.place, self.speed = np.zeros(2), np.zeros(2)
        self.target = self.np_random.uniform(-1.0, 1.0, 2)
        return self.observation(), {}

    def observation(self):
        return np.concatenate([self.place, self.speed, self.target])

    def step(self, action):
        self.speed += 0.05 * (2.0 * action - self.drag * self.speed)
        self.place += 0.05 * self.speed
        done = np.linalg.norm(self.target - self.place) < 0.05 and np.linalg.norm(self.speed) < 0.2
        return self.observation(), 0.0, False, False, {"success": bool(done)}

def set_drag(env, value):
    env.drag = value

environment = Environment(
    make=Point,
    task=Task(name="point", instruction="move to the target", control_period_s=0.05, time_limit_s=8.0),
    knobs=[Knob("drag", set_drag, lambda env: env.drag, low=0.0, high=4.0, nominal=1.0)],
    space={"drag": (0.5, 2.0)},
)
