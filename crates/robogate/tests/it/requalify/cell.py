"""The user's environment, with a package that has several versions."""

import numpy as np
import standin
from robogate_eval import Environment, Policy, Task

environment = Environment(
    make=standin.Push,
    task=Task(name="push", control_period_s=0.04, time_limit_s=1.6),
    policies={"push": Policy(lambda env: lambda observation: np.array([1.0]), "Pushes.")},
    observe=lambda env: env.observe(),
)
