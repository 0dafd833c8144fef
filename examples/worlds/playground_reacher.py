from mujoco_playground import registry
from robogate_eval import Environment, Task

environment = Environment(
    make=lambda: registry.load("ReacherEasy", config_overrides={"impl": "jax"}),
    task=Task(name="reacher", time_limit_s=4.0, success=lambda t: t.rewards[-1:] != [] and t.rewards[-1] > 0.99),
)
