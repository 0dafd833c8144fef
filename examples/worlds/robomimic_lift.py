import robomimic.utils.obs_utils as obs
from robomimic.envs.env_robosuite import EnvRobosuite
from robogate_eval import Environment, Task

obs.initialize_obs_utils_with_obs_specs({"obs": {"low_dim": ["object"]}})
environment = Environment(
    make=lambda: EnvRobosuite("Lift", robots="Panda", horizon=100),
    task=Task(name="lift", instruction="lift the cube"),
)
