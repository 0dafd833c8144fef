"""Simulators with results that can be computed by hand, for tests of the protocol. They have no physics and are not evidence.

`Gantry` scores itself: three sliding joints carry a hand in a straight line; the object moves along while it is gripped. `Tank`
scores itself and has no robot: two valves fill a tank. `Still` computes physics only: its arm reaches any command immediately, and
its objects stay at rest.
"""

import argparse

from robogate_bridge import Image, Problem, Servo, Touches, arm_observation, serve, state_hash, table_friction

PERIOD = 0.05
DOWN = [0.0, 1.0, 0.0, 0.0]
UP = [1.0, 0.0, 0.0, 0.0]


def arm(joints):
    """The observation of an arm with these joints."""
    return [
        {"name": "joint_positions", "length": len(joints), "unit": "m"},
        {"name": "joint_velocities", "length": len(joints), "unit": "m/s"},
        {"name": "gripper_opening", "length": 1, "unit": "m"},
        {"name": "tool_pose", "length": 7},
    ]


class Gantry:
    """Success if the object is released within 3 cm of the target. Images have one colour, which depends on the time."""

    START = [0.5, 0.0, 0.3]
    TARGET = [0.4, 0.4, 0.025]

    def __init__(self, size=256):
        self.size = size

    def hello(self):
        return {
            "server": {"name": "toy", "version": "1"},
            "engine": {"name": "gantry", "version": "1"},
            "robot": {"name": "gantry"},
            "time_step_s": PERIOD,
            "task": {
                "name": "carry",
                "instruction": "carry the box to the target",
                "control_period_s": PERIOD,
                "time_limit_s": 10.0,
                "failure_modes": [{"name": "missed", "meaning": "The box was let go beside the target."}],
                "measures": [{"name": "target_distance_m", "unit": "m", "better": "lower"}],
                "parameters": [
                    {"name": "offset_x_m", "unit": "m", "kind": "continuous", "low": -0.1, "high": 0.1, "nominal": 0.0},
                    {"name": "mass_kg", "unit": "kg", "kind": "continuous", "low": 0.01, "high": 5.0, "nominal": 0.3},
                ],
                "observation": {
                    "vectors": arm("xyz"),
                    "cameras": [{"name": "front", "width": self.size, "height": self.size}],
                },
                "action": {
                    "spaces": [
                        {"kind": "joint_position", "joints": ["x", "y", "z"]},
                        {"kind": "tool_delta", "translation_m": 0.02, "rotation_rad": 0.05},
                    ],
                    "gripper": "binary",
                },
            },
            "scores_itself": True,
            "deterministic": True,
        }

    def reset(self, scenario):
        self.mass = float(scenario.values["mass_kg"])
        # All randomness depends on seed and index.
        jitter = 1e-3 * (scenario.random().random() - 0.5)
        self.object = [0.5 + float(scenario.values["offset_x_m"]), jitter, 0.025]
        self.hand, self.before, self.ticks, self.held = list(self.START), list(self.START), 0, False
        held = {"mass_kg": self.mass, "offset_x_m": self.object[0] - 0.5}
        instance = {"details": {"object": [self.object[0], 0.0, 0.025], "target": self.TARGET}}
        applied = {name: held[name] for name in scenario.parameters}
        return {"observation": self.observation(), "instance": instance, "applied": applied}

    def step(self, action):
        move = action.numbers if action.space == "joint_position" else None
        goal = move or [x + 0.02 * d for x, d in zip(self.hand, action.numbers)]
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
            ending = {"failure": None if off <= 0.03 else "missed"}
        return {
            "observation": self.observation(),
            "state_hash": self.state_hash(),
            "measures": {"target_distance_m": off},
            "ending": ending,
            "events": ["let go"] if released else [],
        }

    def observation(self):
        velocities = [(a - b) / PERIOD for a, b in zip(self.hand, self.before)]
        opening, tool = 0.05 if self.held else 0.08, {"position": self.hand, "orientation": DOWN}
        return arm_observation(self.ticks * PERIOD, list(self.hand), velocities, opening, tool)

    def state_hash(self):
        return state_hash(self.ticks, *self.hand, *self.object, self.held)

    def render(self, cameras):
        colour = bytes([self.ticks % 256]) * (3 * self.size * self.size)
        return [Image(name, self.size, self.size, colour) for name in cameras]


class Tank:
    """Fill the tank to a level and keep it there for half a second. The failure of a negative level cannot occur."""

    def hello(self):
        me = {"name": "tank", "version": "1"}
        parameters = [
            {"name": "goal_m", "unit": "m", "kind": "continuous", "low": 0.2, "high": 0.8},
            {"name": "leaks", "kind": "integer", "low": 0, "high": 3, "nominal": 0},
            {"name": "liquid", "kind": "categorical", "choices": ["water", "oil"], "nominal": "water"},
        ]
        task = {
            "name": "tank",
            "version": 3,
            "instruction": "fill the tank",
            "control_period_s": 0.1,
            "time_limit_s": 20.0,
            "failure_modes": ["overflow", {"name": "dry", "severity": "minor"}],
            "measures": ["spilled_l", {"name": "level_m", "unit": "m"}],
            "phases": ["fill", "hold"],
            "parameters": parameters,
            "observation": {"vectors": [{"name": "levels", "length": 2, "unit": "m"}]},
            "action": {"spaces": [{"kind": "vector", "names": ["in", "out"], "low": [0, 0], "high": [1, 0.5]}]},
        }
        space = {"name": "tank", "parameter": [{"name": "goal_m", "kind": "continuous", "low": 0.3, "high": 0.6}]}
        return {
            "server": me, "engine": me, "task": task, "space": space, "scores_itself": True, "deterministic": True,
        }  # fmt: skip

    def reset(self, scenario):
        if "goal_m" not in scenario.parameters:
            raise Problem("setup", "goal_m is required: it has no nominal value")
        self.values, self.level, self.ticks, self.held = scenario.values, 0.0, 0, 0
        instruction = f"fill the tank with {self.values['liquid']}"
        applied = {name: self.values[name] for name in scenario.parameters}
        return {"observation": self.observation(), "instance": {"instruction": instruction}, "applied": applied}

    def step(self, action):
        flow_in, flow_out = action.numbers
        self.level = max(0.0, self.level + 0.05 * (flow_in - flow_out) - 0.005 * self.values["leaks"])
        self.ticks += 1
        self.held = self.held + 1 if abs(self.level - self.values["goal_m"]) < 0.05 else 0
        ending = None
        if self.level > 1.0:
            ending = {"failure": "overflow"}
        elif self.held == 5:
            ending = {"failure": None}
        # The spilled volume has no value until something is spilled.
        spilled = self.level - 1.0 if self.level > 1.0 else None
        return {
            "observation": self.observation(),
            "measures": {"spilled_l": spilled, "level_m": self.level},
            "ending": ending,
        }

    def observation(self):
        return {"vectors": {"levels": [self.level, self.values["goal_m"]]}}

    def state_hash(self):
        return state_hash(self.level, self.ticks, self.held)


class Still:
    """A sliding joint in x, a time step of 10 ms, and an object at rest."""

    def hello(self):
        me = {"name": "still", "version": "1"}
        return {
            "server": me,
            "engine": me,
            "robot": {"name": "still"},
            "time_step_s": 0.01,
            "task": {
                "name": "cell",
                "control_period_s": PERIOD,
                "time_limit_s": 10.0,
                "observation": {"vectors": arm("x")},
                "action": {"spaces": [{"kind": "joint_position", "joints": ["x"]}], "gripper": "binary"},
            },
            "scores_itself": False,
            "deterministic": True,
        }

    def reset(self, scenario):
        self.cell = scenario.cell
        self.servo = Servo(self.cell["robot"], PERIOD)
        self.x, self.v, self.ticks = self.cell["robot"]["home_rad"][0], 0.0, 0
        readback = {
            "friction": self.cell["friction"],
            "table_friction": table_friction(self.cell),
            "pad_friction": self.cell["friction"],
            "gravity_m_s2": self.cell["gravity_m_s2"],
            "stiffness_nm_rad": self.cell["robot"]["stiffness_nm_rad"],
            "grip_force_n": 30.0,
            "grip_threshold_m": None,
            "objects": [
                {key: thing[key] for key in ("mass_kg", "centre_of_mass", "pose")}
                | {"parts": [part["primitive"] for part in thing["parts"]]}
                for thing in self.cell["objects"]
            ],
            "fixtures": [
                {"fixture": i, "primitive": fixture["primitive"], "pose": fixture["pose"], "motion": fixture["motion"]}
                for i, fixture in enumerate(self.cell["fixtures"])
            ],
        }
        return {"observation": self.observation(), "readback": readback, "sight": self.sight(0)}

    def step(self, action):
        self.servo.command(action.numbers)
        sights = []
        for k in range(1, 6):
            (self.x,), (self.v,) = self.servo.targets(k / 5)
            sights.append(self.sight(action.object))
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
        return arm_observation(self.ticks * PERIOD, [self.x], [self.v], 0.08, self.tool())

    def sight(self, index):
        still = {"linear_m_s": [0.0] * 3, "angular_rad_s": [0.0] * 3}
        return Touches(len(self.cell["objects"])).sight(index) | {
            "objects": [{"pose": thing["pose"]} | still for thing in self.cell["objects"]],
            "tool_pose": self.tool(),
            "opening_m": 0.08,
        }

    def state_hash(self):
        return state_hash(self.ticks, self.x, self.v)


SIMULATORS = {"gantry": Gantry, "tank": Tank, "still": Still}

if __name__ == "__main__":
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--bind", default="tcp://127.0.0.1:*")
    arguments.add_argument("--kind", choices=sorted(SIMULATORS), default="gantry")
    chosen = arguments.parse_args()
    serve(SIMULATORS[chosen.kind](), chosen.bind)
