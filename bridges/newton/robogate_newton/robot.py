"""A robot's folder, as far as the server needs it before an episode tells it the rest."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

from robogate_bridge import Problem, robot_sha256


@dataclass(frozen=True)
class Robot:
    """The robot of a folder: its model's file and what its joints are called."""

    name: str
    sha256: str
    model: Path
    joints: list[str]

    @classmethod
    def read(cls, folder):
        """The robot of this folder, or a `Problem` that says what is wrong with it."""
        folder = Path(folder)
        file = folder / "robot.toml"
        try:
            settings = tomllib.loads(file.read_text(encoding="utf-8"))
            gripper = settings["gripper"]["kind"]
            robot = cls(settings["name"], robot_sha256(folder), folder / settings["model"], settings["arm"]["joints"])
        except OSError as why:
            raise Problem("setup", f"{file}: {why.strerror}; a robot is a folder with robot.toml and its model") from why
        except (tomllib.TOMLDecodeError, KeyError) as why:
            raise Problem("setup", f"{file}: {type(why).__name__}: {why}") from why
        if gripper != "parallel_jaw":
            raise Problem("setup", f"{file}: this server grips with fingers; the gripper is a {gripper}")
        if settings.get("site"):
            raise Problem("setup", f"{file}: sites must be in the model itself; this server does not read [[site]]")
        if robot.model.suffix != ".xml":
            raise Problem("setup", f"{file}: this server reads MJCF, not {robot.model.name}")
        return robot
