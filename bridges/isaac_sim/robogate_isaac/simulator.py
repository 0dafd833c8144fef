"""The cell in Isaac Sim as a simulator of the bridge: the server computes physics, and RoboGate scores the episode."""

import struct
from hashlib import blake2b

from robogate_bridge import (
    CONTROL_PERIOD_S,
    Fingers,
    Motion,
    Problem,
    Servo,
    Touches,
    arm_observation,
    combined,
    is_table,
    object_state,
    parallel_jaw,
    physics_hello,
    unit,
)

from . import __version__
from .stage import damped, drive_of

TIME_STEP_S = 0.0025


class Isaac:
    """A simulator for one robot, with a new stage for each episode. `runtime` creates its runtime: `runtime.Runtime`, after
    `SimulationApp`."""

    def __init__(self, robot, runtime, version):
        self._robot, self._make, self._version = robot, runtime, version
        self._steps = round(CONTROL_PERIOD_S / TIME_STEP_S)
        self._own = {body.joint.name: body.joint.damping for body in robot.bodies if body.joint}
        self._runtime = None

    def hello(self):
        server = {"name": "robogate-isaac-sim", "version": __version__}
        engine = {"name": "isaac-sim", "version": self._version, "solver": "physx TGS, CPU"}
        # PhysX documents determinism on one machine and build. This was not tested (README.md).
        return physics_hello(server, engine, self._robot, TIME_STEP_S)

    def reset(self, scenario):
        self._runtime = None
        self._cell = cell = scenario.cell
        try:
            drives = cell["robot"]
            if drives["joints"] != self._robot.joints:
                raise Problem("setup", f"this server's robot is {self._robot.name}, with {len(self._robot.joints)} joints")
            if drives["tcp_site"] not in self._robot.sites:
                raise Problem("setup", f"the robot's model has no site {drives['tcp_site']!r}")
            body, self._tcp = self._robot.sites[drives["tcp_site"]]
            if not any(is_table(fixture) for fixture in cell["fixtures"]):
                raise Problem("setup", "the cell has no table")
            runtime = self._make(self._robot, cell, TIME_STEP_S, body)
            self._servo = Servo(drives, CONTROL_PERIOD_S)
            self._fingers = Fingers(parallel_jaw(cell), TIME_STEP_S)
            self._movers = [(i, Motion(fixture)) for i, fixture in enumerate(cell["fixtures"]) if fixture["motion"]]
            names = [*drives["joints"], *parallel_jaw(cell)["finger_joints"]]
            self._damping = [(drive_of(name, drives)[1], self._own[name]) for name in names]
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as why:
            raise Problem("setup", f"Isaac Sim cannot build this cell: {type(why).__name__}: {why}") from why
        self._runtime, self._ticks, self._step_count = runtime, 0, 0
        # No force has acted yet.
        return {"observation": self._observation(), "readback": self._readback(), "sight": self._sight(0, Touches(len(cell["objects"])))}

    def step(self, action):
        self._servo.command(action.numbers)
        sights = []
        for k in range(1, self._steps + 1):
            positions, velocities = self._servo.targets(k / self._steps)
            fingers = [self._fingers.target(action.close, self._opening())] * 2
            wanted = [damped(v, *damping) for v, damping in zip([*velocities, 0.0, 0.0], self._damping)]
            self._step_count += 1
            for fixture, motion in self._movers:
                self._runtime.cell.move(fixture, motion.position(self._step_count * TIME_STEP_S))
            self._runtime.step([*positions, *fingers], wanted)
            touches = Touches(len(self._cell["objects"]))
            for one, two, force, push in self._runtime.contacts():
                touches.add(self._runtime.cell.part(one), self._runtime.cell.part(two), force, push)
            sights.append(self._sight(action.object, touches))
        self._ticks += 1
        return {
            "observation": self._observation(),
            "state_hash": self.state_hash(),
            "sights": sights,
            "clearance_m": None,
        }

    def state_hash(self):
        positions, velocities = self._runtime.joints()
        state = [*positions, *velocities]
        for pose, linear, angular in self._runtime.objects():
            state += [*pose["position"], *pose["orientation"], *linear, *angular]
        bits = blake2b(struct.pack(f"<{len(state)}d", *state), digest_size=8).digest()
        return int.from_bytes(bits, "little")

    def close(self):
        self._runtime = None

    def _opening(self):
        return sum(self._runtime.joints()[0][len(self._robot.joints) :])

    def _tool_pose(self):
        body = self._runtime.tool_body()
        return combined({**body, "orientation": unit(body["orientation"])}, self._tcp)

    def _observation(self):
        positions, velocities = self._runtime.joints()
        arm = len(self._robot.joints)
        time_s, opening = self._ticks * CONTROL_PERIOD_S, self._opening()
        return arm_observation(time_s, positions[:arm], velocities[:arm], opening, self._tool_pose())

    def _sight(self, index, touches):
        # PhysX stores the velocity of the centre of mass.
        objects = [
            object_state({**pose, "orientation": unit(pose["orientation"])}, linear, angular, thing["centre_of_mass"])
            for (pose, linear, angular), thing in zip(self._runtime.objects(), self._cell["objects"])
        ]
        return touches.sight(index) | {"objects": objects, "tool_pose": self._tool_pose(), "opening_m": self._opening()}

    def _readback(self):
        runtime = self._runtime
        friction, table, pads = runtime.cell.friction()
        arm, fingers = runtime.cell.stiffness()
        objects = [
            {
                "mass_kg": mass,
                "centre_of_mass": centre,
                "parts": runtime.cell.parts(i),
                "pose": {**pose, "orientation": unit(pose["orientation"])},
            }
            for i, ((mass, centre), (pose, _, _)) in enumerate(zip(runtime.masses(), runtime.objects()))
        ]
        return {
            "friction": friction,
            "table_friction": table,
            "pad_friction": pads,
            "gravity_m_s2": runtime.gravity(),
            "stiffness_nm_rad": arm,
            "grip_force_n": self._fingers.lead_m * sum(fingers) / len(fingers),
            "grip_threshold_m": None,
            "objects": objects,
            "fixtures": runtime.cell.fixtures(),
        }
