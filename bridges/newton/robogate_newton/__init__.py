"""RoboGate's cell in Newton, behind the bridge protocol."""

__version__ = "0.1.0"
