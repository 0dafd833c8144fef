"""RoboGate's cell in Newton, served over the bridge protocol."""

__version__ = "0.2.0"
