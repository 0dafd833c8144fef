"""An environment for LeRobot, as a plug-in: a point that a policy moves to a goal. `agreement.py` installs it beside LeRobot."""

from dataclasses import dataclass, field

import gymnasium
import numpy as np
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig

SIDE, STEPS, FPS = 32, 30, 10
# Motion of an action of 1, and the distance from the goal that counts as success.
STEP, NEAR = 0.1, 0.1


class Reach(gymnasium.Env):
    """Observes the point and the goal as four numbers, and the point in a small image."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": FPS}
    observation_space = gymnasium.spaces.Dict({
        "agent_pos": gymnasium.spaces.Box(-1.0, 1.0, (4,)),
        "pixels": gymnasium.spaces.Dict(front=gymnasium.spaces.Box(0, 255, (SIDE, SIDE, 3), np.uint8)),
    })  # fmt: skip
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,))
    render_mode = "rgb_array"
    task_description = "move the point to the goal"

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.point, self.goal = self.np_random.uniform(-1.0, 1.0, (2, 2)).astype(np.float32)
        return self._seen(), {"is_success": False}

    def step(self, action):
        self.point = np.clip(self.point + np.float32(STEP) * np.clip(action, -1.0, 1.0), -1.0, 1.0).astype(np.float32)
        success = bool(np.abs(self.point - self.goal).max() < NEAR)
        return self._seen(), float(success), success, False, {"is_success": success}

    def render(self):
        return picture(self.point)

    def _seen(self):
        return {"agent_pos": np.concatenate([self.point, self.goal]), "pixels": {"front": self.render()}}


def picture(point):
    """The point as a red square on a gradient."""
    image = np.full((SIDE, SIDE, 3), 40, np.uint8)
    image[:, :, 2] = np.arange(SIDE) * 4
    row, column = ((np.asarray(point) + 1.0) / 2.0 * (SIDE - 4)).astype(int)
    image[row : row + 4, column : column + 4, 0] = 255
    return image


def demonstrations(count, length, generator):
    """States, images and chunks of actions straight to the goal, at a speed of at most one step in each direction."""
    states = generator.uniform(-1.0, 1.0, (count, 4)).astype(np.float32)
    chunks, points = np.zeros((count, length, 2), np.float32), states[:, :2].copy()
    for step in range(length):
        chunks[:, step] = np.clip((states[:, 2:] - points) / STEP, -1.0, 1.0)
        points += STEP * chunks[:, step]
    return states, np.stack([picture(state[:2]) for state in states]), chunks


gymnasium.register("lerobot_env_reach/Reach-v0", entry_point=Reach, max_episode_steps=STEPS)


@EnvConfig.register_subclass("reach")
@dataclass
class ReachConfig(EnvConfig):
    task: str | None = "Reach-v0"
    fps: int = FPS
    features: dict = field(default_factory=lambda: {
        "action": PolicyFeature(FeatureType.ACTION, (2,)),
        "agent_pos": PolicyFeature(FeatureType.STATE, (4,)),
        "pixels/front": PolicyFeature(FeatureType.VISUAL, (SIDE, SIDE, 3)),
    })  # fmt: skip
    features_map: dict = field(default_factory=lambda: {
        "action": "action", "agent_pos": "observation.state", "pixels/front": "observation.images.front",
    })  # fmt: skip

    @property
    def package_name(self):
        return "lerobot_env_reach"

    @property
    def gym_kwargs(self):
        return {}
