"""RoboGate's cell in Isaac Sim, served over the bridge protocol."""

__version__ = "0.2.0"
