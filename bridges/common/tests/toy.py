"""Two simulators that can be reckoned by hand, for tests of the protocol. No physics: never evidence of anything.

`Gantry` judges: three sliding joints carry a hand straight to where it is sent; the object goes along while it is gripped.
`Still` does not judge: its arm is where it was sent to, its object lies where the cell has it.
"""

import argparse
import struct
import zlib

from robogate_bridge import Image, Problem, Servo, serve

PERIOD = 0.05
DOWN = [0.0, 1.0, 0.0, 0.0]
UP = [1.0, 0.0, 0.0, 0.0]


def state_hash(*numbers):
    data = struct.pack(f"<{len(numbers)}d", *numbers)
    return zlib.crc32(data) << 32 | zlib.adler32(data)


class Gantry:
    """Done when the object was let go within 3 cm of the target. Cameras show one colour, that of the time."""

    START = [0.5, 0.0, 0.3]
    TARGET = [0.4, 0.4, 0.025]

    def __init__(self, size=256):
        self.size = size

    def hello(self):
        return {
            "server": {"name": "toy", "version": "1"},
            "engine": {"name": "gantry", "version": "1", "solver": None},
            "robot": {"name": "gantry", "sha256": None},
            "time_step_s": PERIOD,
            "control_period_s": PERIOD,
            "time_limit_s": 10.0,
            "joints": ["x", "y", "z"],
            "action_spaces": ["joint_position", "tool_delta"],
            "tool_delta": {"translation_m": 0.02, "rotation_rad": 0.05},
            "cameras": [{"name": "front", "width": self.size, "height": self.size}],
            "parameters": ["offset_x_m", "mass_kg"],
            "judges": True,
            "deterministic": True,
        }

    def reset(self, scenario):
        asked = scenario.parameters
        self.mass = float(asked.get("mass_kg", 0.3))
        if self.mass <= 0.0:
            raise Problem("setup", f"an object of {self.mass} kg")
        # All that is random depends on seed and index.
        jitter = 1e-3 * (zlib.crc32(f"{scenario.seed}/{scenario.index}".encode()) / 2**32 - 0.5)
        self.object = [0.5 + float(asked.get("offset_x_m", 0.0)), jitter, 0.025]
        self.hand, self.before, self.ticks, self.held = list(self.START), list(self.START), 0, False
        held = {"mass_kg": self.mass, "offset_x_m": self.object[0] - 0.5}
        task = {
            "instruction": "carry the box to the target",
            "control_period_s": PERIOD,
            "time_limit_s": 10.0,
            "shape": "box",
            "object_extent_m": [0.05] * 3,
            "object_pose": {"position": [self.object[0], 0.0, 0.025], "orientation": UP},
            "target_pose": {"position": self.TARGET, "orientation": UP},
            "tolerance_m": 0.03,
            "approach_speed_m_s": None,
        }
        applied = {name: held[name] for name in asked}
        return {"observation": self.observation(), "task": task, "applied": applied}

    def step(self, action):
        move = action.arm if action.space == "joint_position" else None
        goal = move or [x + 0.02 * d for x, d in zip(self.hand, action.arm)]
        self.before, self.hand = self.hand, [float(x) for x in goal]
        self.ticks += 1
        near = sum((a - b) ** 2 for a, b in zip(self.before, self.object)) < 0.01**2
        released = self.held and not action.close
        self.held = action.close and (self.held or near)
        if self.held:
            self.object = list(self.hand)
        off = ((self.object[0] - self.TARGET[0]) ** 2 + (self.object[1] - self.TARGET[1]) ** 2) ** 0.5
        ending = None
        if released:
            failure = None if off <= 0.03 else "grip_loss"
            ending = {"failure": failure, "time_s": self.ticks * PERIOD, "contact": None}
        measures = {"slip_m": None, "peak_contact_force_n": None, "min_clearance_m": None, "target_distance_m": off}
        return {
            "observation": self.observation(),
            "state_hash": self.state_hash(),
            "measures": measures,
            "ending": ending,
            "events": ["let go"] if released else [],
        }

    def observation(self):
        return {
            "time_s": self.ticks * PERIOD,
            "joint_positions": self.hand,
            "joint_velocities": [(a - b) / PERIOD for a, b in zip(self.hand, self.before)],
            "gripper_opening_m": 0.05 if self.held else 0.08,
            "tool_pose": {"position": self.hand, "orientation": DOWN},
        }

    def state_hash(self):
        return state_hash(self.ticks, *self.hand, *self.object, self.held)

    def render(self, cameras):
        colour = bytes([self.ticks % 256]) * (3 * self.size * self.size)
        return [Image(name, self.size, self.size, colour) for name in cameras]

    def close(self):
        pass


class Still:
    """A sliding joint in x, a step of 10 ms, an object that lies."""

    def hello(self):
        return Gantry().hello() | {
            "time_step_s": 0.01,
            "joints": ["x"],
            "action_spaces": ["joint_position"],
            "tool_delta": None,
            "cameras": [],
            "parameters": ["friction"],
            "judges": False,
        }

    def reset(self, scenario):
        self.cell = scenario.cell
        self.servo = Servo(self.cell["robot"], PERIOD)
        self.x, self.v, self.ticks = self.cell["robot"]["home_rad"][0], 0.0, 0
        thing = self.cell["object"]
        readback = {key: self.cell[key] for key in ("friction", "table_friction", "gravity_m_s2")} | {
            "mass_kg": thing["mass_kg"],
            "centre_of_mass": thing["centre_of_mass"],
            "parts": [part["primitive"] for part in thing["parts"]],
            "object_pose": thing["pose"],
            "fixtures": [
                {"fixture": i, "primitive": fixture["primitive"], "pose": fixture["pose"], "motion": fixture["motion"]}
                for i, fixture in enumerate(self.cell["fixtures"])
            ],
        }
        return {"observation": self.observation(), "readback": readback, "sight": self.sight()}

    def step(self, action):
        self.servo.command(action.arm)
        sights = []
        for k in range(1, 6):
            (self.x,), (self.v,) = self.servo.targets(k / 5)
            sights.append(self.sight())
        self.ticks += 1
        return {
            "observation": self.observation(),
            "state_hash": self.state_hash(),
            "sights": sights,
            "clearance_m": None,
        }

    def tool(self):
        return {"position": [self.x, 0.0, 0.3], "orientation": DOWN}

    def observation(self):
        return {
            "time_s": self.ticks * PERIOD,
            "joint_positions": [self.x],
            "joint_velocities": [self.v],
            "gripper_opening_m": 0.08,
            "tool_pose": self.tool(),
        }

    def sight(self):
        return {
            "fingers": [None, None],
            "body_on_object": False,
            "object_on_fixture": True,
            "collision": None,
            "peak_force_n": None,
            "object_pose": self.cell["object"]["pose"],
            "object_velocity": {"linear_m_s": [0.0] * 3, "angular_rad_s": [0.0] * 3},
            "tool_pose": self.tool(),
            "opening_m": 0.08,
        }

    def state_hash(self):
        return state_hash(self.ticks, self.x, self.v)

    def close(self):
        pass


if __name__ == "__main__":
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--bind", default="tcp://127.0.0.1:*")
    arguments.add_argument("--kind", choices=["gantry", "still"], default="gantry")
    chosen = arguments.parse_args()
    serve(Gantry() if chosen.kind == "gantry" else Still(), chosen.bind)
