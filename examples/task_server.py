"""A complete task of your own for RoboGate: swing a pendulum up and keep it upright. No robot, no cameras.

    bridges/common/setup.sh .venv                  # once: a Python environment with robogate_bridge
    .venv/bin/python examples/task_server.py       # prints its address; then: robogate check bridge tcp://127.0.0.1:5570
"""

from math import atan2, cos, sin

from robogate_bridge import serve, state_hash

PERIOD, STEPS = 0.05, 10  # control period in s, time steps in it

TASK = {
    "name": "swing_up", "version": 1, "instruction": "swing the pendulum up and keep it upright",
    "control_period_s": PERIOD, "time_limit_s": 10.0,
    "failure_modes": [{"name": "overspeed", "meaning": "The pendulum spun faster than 12 rad/s.", "severity": "critical"}],
    "measures": [{"name": "peak_speed_rad_s", "unit": "rad/s", "meaning": "Largest speed so far.", "better": "lower"}],
    "parameters": [
        {"name": "mass_kg", "unit": "kg", "kind": "continuous", "low": 0.2, "high": 2.0, "nominal": 1.0, "read_from": "the integrator"},
        {"name": "start", "kind": "categorical", "choices": ["hanging", "tilted"], "nominal": "hanging"},
    ],
    "observation": {"vectors": [{"name": "direction", "length": 2}, {"name": "speed", "length": 1, "unit": "rad/s"}]},
    "action": {"spaces": [{"kind": "vector", "names": ["torque_nm"], "low": [-5.0], "high": [5.0]}]},
}  # fmt: skip


class Pendulum:
    def hello(self):
        me = {"name": "pendulum", "version": "1"}
        return {"server": me, "engine": me, "task": TASK, "scores_itself": True, "deterministic": True}

    def reset(self, scenario):
        # `values` has each declared parameter: as requested, otherwise nominal.
        self.mass, self.start = scenario.values["mass_kg"], scenario.values["start"]
        # The angle is 0 when upright. All randomness comes from the seed and the index of the scenario.
        self.angle = (2.1 if self.start == "tilted" else 3.14159) + scenario.random().uniform(-0.05, 0.05)
        self.speed, self.peak, self.upright = 0.0, 0.0, 0
        return {"observation": self.observation(), "applied": {"mass_kg": self.mass, "start": self.start}}

    def step(self, action):
        for _ in range(STEPS):  # a rod of 1 m with its mass at the end
            self.speed += (9.81 * sin(self.angle) + action.numbers[0] / self.mass) * PERIOD / STEPS
            self.angle += self.speed * PERIOD / STEPS
        self.peak = max(self.peak, abs(self.speed))
        near = abs(atan2(sin(self.angle), cos(self.angle))) < 0.2
        self.upright = self.upright + 1 if near else 0
        failure = "overspeed" if self.peak > 12.0 else None
        over = failure or self.upright >= 20  # success: upright for 1 s
        return {"observation": self.observation(), "measures": {"peak_speed_rad_s": self.peak},
                "ending": {"failure": failure} if over else None}  # fmt: skip

    def observation(self):
        return {"vectors": {"direction": [sin(self.angle), cos(self.angle)], "speed": [self.speed]}}

    def state_hash(self):
        return state_hash(self.angle, self.speed, self.peak, self.upright)


if __name__ == "__main__":
    serve(Pendulum(), "tcp://127.0.0.1:5570")
