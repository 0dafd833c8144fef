"""Reads the parts of a robot's folder that the server needs before the first episode."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

from robogate_bridge import Problem, robot_sha256


@dataclass(frozen=True)
class Robot:
    """A robot's folder: the file of the model, and the names of the joints."""

    name: str
    sha256: str
    model: Path
    joints: list[str]

    @classmethod
    def read(cls, folder):
        """Reads the robot of this folder. Raises a `Problem` if it cannot be used."""
        folder = Path(folder)
        file = folder / "robot.toml"
        try:
            settings = tomllib.loads(file.read_text(encoding="utf-8"))
            gripper = settings["gripper"]["kind"]
            robot = cls(settings["name"], robot_sha256(folder), folder / settings["model"], settings["arm"]["joints"])
        except OSError as why:
            raise Problem("setup", f"{file}: {why.strerror}. Expected a folder with robot.toml and the model of the robot") from why
        except (tomllib.TOMLDecodeError, KeyError) as why:
            raise Problem("setup", f"{file}: {type(why).__name__}: {why}") from why
        if gripper != "parallel_jaw":
            raise Problem("setup", f"{file}: expected a parallel gripper, found {gripper}")
        if settings.get("site"):
            raise Problem("setup", f"{file}: [[site]] is not supported. Define the sites in the model")
        if robot.model.suffix != ".xml":
            raise Problem("setup", f"{file}: expected an MJCF model, found {robot.model.name}")
        return robot
