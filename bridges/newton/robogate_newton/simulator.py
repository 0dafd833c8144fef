"""The cell in Newton as a simulator of the bridge: the server computes physics, and RoboGate scores the episode."""

import newton
from robogate_bridge import CONTROL_PERIOD_S, Action, Fingers, Problem, Scenario, Servo, arm_observation, parallel_jaw, physics_hello

from . import __version__
from .geometry import Geometry
from .mujoco_engine import MujocoEngine
from .steel_engine import SteelEngine
from .world import Workshop

ENGINES = {engine.name: engine for engine in (MujocoEngine, SteelEngine)}


class Newton:
    """A simulator for one robot and one solver. It builds a world for each episode."""

    def __init__(self, robot, solver, time_step_s=None):
        self._robot = robot
        self._kind = ENGINES[solver]
        self._time_step = self._kind.time_step_s if time_step_s is None else time_step_s
        self._steps = round(CONTROL_PERIOD_S / self._time_step)
        self._workshop = Workshop(robot, self._kind.friction_is_mean, self._kind.gap)
        self._engine = None

    def try_out(self, cell):
        """Runs one control period, so that Newton compiles its kernels and unsupported features are reported early."""
        self.reset(Scenario(index=0, seed=0, parameters={}, cell=cell))
        self.step(Action("joint_position", cell["robot"]["home_rad"], gripper=1.0))
        self.close()

    def hello(self):
        server = {"name": "robogate-newton", "version": __version__}
        engine = {"name": "newton", "version": newton.__version__, "solver": self._kind.version()}
        return physics_hello(server, engine, self._robot, self._time_step)

    def reset(self, scenario):
        self._engine = None
        cell = scenario.cell
        try:
            if cell["robot"]["joints"] != self._robot.joints:
                raise Problem("setup", f"this server's robot is {self._robot.name}, with {len(self._robot.joints)} joints")
            world = self._workshop.build(cell)
            engine = self._kind(world, Geometry(self._robot, cell), cell, self._time_step)
            self._servo = Servo(cell["robot"], CONTROL_PERIOD_S)
            self._fingers = Fingers(parallel_jaw(cell), self._time_step)
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as why:
            raise Problem("setup", f"Newton cannot build this cell: {type(why).__name__}: {why}") from why
        self._ticks = 0
        self._engine = engine
        return {"observation": self._observation(), "readback": engine.readback(self._fingers.lead_m), "sight": engine.first_sight()}

    def step(self, action):
        engine = self._engine
        self._servo.command(action.numbers)
        sights = []
        for k in range(1, self._steps + 1):
            positions, velocities = self._servo.targets(k / self._steps)
            engine.advance(positions, velocities, self._fingers.target(action.close, engine.opening()))
            sights.append(engine.sight(action.object))
        self._ticks += 1
        engine.check()
        return {
            "observation": self._observation(),
            "state_hash": engine.state_hash(),
            "sights": sights,
            "clearance_m": engine.clearance(),
        }

    def state_hash(self):
        return self._engine.state_hash()

    def close(self):
        self._engine = None

    def _observation(self):
        engine = self._engine
        time_s, positions, velocities = self._ticks * CONTROL_PERIOD_S, engine.joint_positions(), engine.joint_velocities()
        return arm_observation(time_s, positions, velocities, engine.opening(), engine.tool_pose())
