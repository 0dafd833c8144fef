"""Makes a simulator available over RoboGate's bridge protocol (bridges/PROTOCOL.md), and controls such simulators.

A simulator is a class with the methods of `Simulator`. `serve` does the rest: the socket, the limits, the checks of all requests
and replies, and the typed errors. `Client` sends requests to a server, such as `robogate serve`.
"""

from .cell import (
    CONTROL_PERIOD_S,
    Contact,
    Motion,
    Part,
    Touches,
    arm_observation,
    combined,
    is_table,
    object_state,
    parallel_jaw,
    physics_hello,
    table_friction,
    turned,
    unit,
)
from .client import Client, Refused, Unanswered
from .errors import Problem
from .identity import robot_sha256, state_hash
from .server import Action, FreeRun, Image, Recording, Scenario, Server, Simulator, serve
from .servo import Fingers, Servo

__all__ = [
    "CONTROL_PERIOD_S",
    "Action",
    "Client",
    "Contact",
    "Fingers",
    "FreeRun",
    "Image",
    "Motion",
    "Part",
    "Problem",
    "Recording",
    "Refused",
    "Scenario",
    "Server",
    "Servo",
    "Simulator",
    "Touches",
    "Unanswered",
    "arm_observation",
    "combined",
    "is_table",
    "object_state",
    "parallel_jaw",
    "physics_hello",
    "robot_sha256",
    "serve",
    "state_hash",
    "table_friction",
    "turned",
    "unit",
]
__version__ = "0.3.0"
