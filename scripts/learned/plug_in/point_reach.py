"""A point that a policy moves to a goal, observed as hindsight replay needs it. Registered as PointReach-v0."""

import gymnasium
import numpy as np

STEP, NEAR = 0.1, 0.1


class PointReach(gymnasium.Env):
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,))
    metadata = {"render_modes": [], "render_fps": 10}

    def __init__(self):
        # One for each: the wrapper of the time feature changes it.
        self.observation_space = gymnasium.spaces.Dict({name: self.action_space for name in ("observation", "achieved_goal", "desired_goal")})

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.point, self.goal = self.np_random.uniform(-1.0, 1.0, (2, 2)).astype(np.float32)
        return self._seen(), {"is_success": False}

    def step(self, action):
        self.point = np.clip(self.point + np.float32(STEP) * np.asarray(action, np.float32), -1.0, 1.0)
        reward = float(self.compute_reward(self.point, self.goal, {}))
        return self._seen(), reward, False, False, {"is_success": reward == 0.0}

    def compute_reward(self, achieved, desired, _):
        return -(np.abs(achieved - desired).max(axis=-1) >= NEAR).astype(np.float32)

    def _seen(self):
        return {"observation": self.point, "achieved_goal": self.point, "desired_goal": self.goal}


gymnasium.register("PointReach-v0", entry_point=PointReach, max_episode_steps=30)
