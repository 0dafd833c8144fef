"""RoboGate's cell in Newton, behind the bridge protocol."""

__version__ = "0.2.0"
