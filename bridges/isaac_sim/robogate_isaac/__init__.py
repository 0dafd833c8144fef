"""RoboGate's cell in Isaac Sim, behind the bridge protocol."""

__version__ = "0.2.0"
