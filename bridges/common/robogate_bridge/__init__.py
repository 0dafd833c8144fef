"""Puts a simulator behind RoboGate's bridge protocol (bridges/PROTOCOL.md), or drives one that is.

A simulator is a class with the methods of `Simulator`; `serve` does the rest: the socket, the bounds, the checks of
everything that goes in and out, the typed errors. `Client` asks a server, `robogate serve` among them.
"""

from .cell import CONTROL_PERIOD_S, Contact, Motion, Part, Touches, combined, physics_hello, turned, unit
from .client import Client, Refused, Unanswered
from .errors import Problem
from .identity import robot_sha256
from .server import Action, Image, Scenario, Server, Simulator, serve
from .servo import Fingers, Servo

__all__ = [
    "CONTROL_PERIOD_S",
    "Action",
    "Client",
    "Contact",
    "Fingers",
    "Image",
    "Motion",
    "Part",
    "Problem",
    "Refused",
    "Scenario",
    "Server",
    "Servo",
    "Simulator",
    "Touches",
    "Unanswered",
    "combined",
    "physics_hello",
    "robot_sha256",
    "serve",
    "turned",
    "unit",
]
__version__ = "0.1.0"
