"""Puts a simulator behind RoboGate's bridge protocol (bridges/PROTOCOL.md), or drives one that is.

A simulator is a class with the methods of `Simulator`; `serve` does the rest: the socket, the bounds, the checks of
everything that goes in and out, the typed errors. `Client` asks a server, `robogate serve` among them.
"""

from .client import Client, Refused, Unanswered
from .errors import Problem
from .identity import robot_sha256
from .server import Action, Image, Scenario, Server, Simulator, serve
from .servo import Fingers, Servo

__all__ = [
    "Action",
    "Client",
    "Fingers",
    "Image",
    "Problem",
    "Refused",
    "Scenario",
    "Server",
    "Servo",
    "Simulator",
    "Unanswered",
    "robot_sha256",
    "serve",
]
__version__ = "0.1.0"
