"""MuJoCo Warp: no environment, but the engine `warp` of the built-in tasks, which steps many worlds at once."""

from __future__ import annotations

from ..serving.environment import Environment
from .family import Family, UnknownEnvironment


def names() -> list[str]:
    return []


def environment(name: str) -> Environment:
    raise UnknownEnvironment(f"warp:{name}: warp is an engine of the built-in tasks. Expected --engine warp, without --env")


FAMILY = Family(
    name="warp",
    summary="MuJoCo Warp, the engine of many worlds on a GPU (robogate run --engine warp)",
    package="mujoco_warp",
    requirements=["warp-lang==1.19.0", "mujoco==3.17.0", "mujoco-warp==3.17.0", "numpy==2.4.6"],
    names=names,
    environment=environment,
)
