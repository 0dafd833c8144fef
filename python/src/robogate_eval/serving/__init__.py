"""Serves any Gymnasium environment over the bridge protocol, as a simulator that scores itself."""

from .environment import Camera, Environment, FailureMode, Measure, Policy, Task
from .knobs import Knob
from .trajectory import Trajectory

__all__ = ["Camera", "Environment", "FailureMode", "Knob", "Measure", "Policy", "Task", "Trajectory"]
