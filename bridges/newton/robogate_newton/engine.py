"""The common part of the solvers: a world during an episode, one time step at a time."""

from hashlib import blake2b

import newton
import numpy as np
from robogate_bridge import Motion, Problem, Touches, combined, object_state

from .world import pose, primitive


class Engine:
    """A world during an episode. Each solver's class implements the step, the contacts and the read-back."""

    # The solver's name on the command line, its default time step (s), whether it uses the mean of two shapes' friction
    # coefficients, and the distance below which it considers two shapes (m).
    name: str
    time_step_s: float
    friction_is_mean: bool
    gap: float

    def __init__(self, world, geometry, cell, time_step_s):
        self.world, self.time_step_s = world, time_step_s
        self._geometry = geometry
        self._cell = cell
        model = world.model
        self.state, self.after = model.state(), model.state()
        self.control = model.control()
        self.steps = 0
        # Views of Newton's arrays, which never move: on the CPU nothing is copied.
        self._target_q, self._target_qd = self.control.joint_target_q.numpy(), self.control.joint_target_qd.numpy()
        self._views = {id(state): _views(state) for state in (self.state, self.after)}
        newton.eval_fk(model, model.joint_q, model.joint_qd, self.state)
        self._movers = [(mover, Motion(cell["fixtures"][mover.fixture])) for mover in world.movers]
        self._place_movers()
        self.start()

    def start(self):
        """Creates the solver for the world."""
        raise NotImplementedError

    def integrate(self):
        """One time step from `state` to `after`."""
        raise NotImplementedError

    def touches(self):
        """The contacts of the last step."""
        raise NotImplementedError

    def friction(self):
        """Friction coefficients of the objects with everything but the table and the pads, with the table, and with the pads."""
        raise NotImplementedError

    def trouble(self):
        """Why the state is invalid, if the solver reports it."""
        raise NotImplementedError

    def advance(self, positions, velocities, finger):
        """Runs one time step towards these targets: rad, rad/s, and each finger's distance from closed (m)."""
        world = self.world
        self._target_q[world.arm], self._target_qd[world.arm] = positions, velocities
        self._target_q[world.fingers] = finger
        self.integrate()
        self.state, self.after = self.after, self.state
        self.steps += 1
        views = self._views[id(self.state)]
        if not (np.isfinite(views["joint_q"]).all() and np.isfinite(views["joint_qd"]).all()):
            raise Problem("diverged", f"Newton ({self.name}): the state is not finite")
        self._place_movers()

    def check(self):
        """Raises a `Problem` if the solver reports an invalid state."""
        if trouble := self.trouble():
            raise Problem("diverged", f"Newton ({self.name}): {trouble}")

    def joint_positions(self):
        return self._views[id(self.state)]["joint_q"][self.world.arm].tolist()

    def joint_velocities(self):
        return self._views[id(self.state)]["joint_qd"][self.world.arm].tolist()

    def opening(self):
        return float(self._views[id(self.state)]["joint_q"][self.world.fingers].sum())

    def tool_pose(self):
        return combined(self._pose(self.world.tcp_body), self.world.tcp_pose)

    def sight(self, index, touches=None):
        """The sight of this time step, for a gripper that acts on this object."""
        touches = touches or self.touches()
        twists = self._views[id(self.state)]["body_qd"]
        objects = []
        for body, thing in zip(self.world.object_bodies, self._cell["objects"]):
            # Newton stores the velocity of the centre of mass.
            twist = twists[body].tolist()
            objects.append(object_state(self._pose(body), twist[:3], twist[3:], thing["centre_of_mass"]))
        return touches.sight(index) | {"objects": objects, "tool_pose": self.tool_pose(), "opening_m": self.opening()}

    def first_sight(self):
        """The sight of the start, before any force has acted."""
        self._move_geometry()
        touches = Touches(len(self.world.object_bodies))
        for one, two in self._geometry.touching():
            touches.add(one, two, 0.0)
        return self.sight(0, touches)

    def clearance(self):
        self._move_geometry()
        return self._geometry.clearance()

    def readback(self, lead_m):
        """The readback: Newton's values of the cell. The targets of the fingers are ahead of them by at most `lead_m` metres."""
        model, world = self.world.model, self.world
        friction, table_friction, pad_friction = self.friction()
        stiffness = model.joint_target_ke.numpy()
        objects = [
            {
                "mass_kg": float(model.body_mass.numpy()[body]),
                "centre_of_mass": model.body_com.numpy()[body].tolist(),
                "parts": [primitive(model, shape) for shape in shapes],
                "pose": self._pose(body),
            }
            for body, shapes in zip(world.object_bodies, world.object_shapes)
        ]
        fixtures = []
        for i, shape in enumerate(world.fixture_shapes):
            held = int(model.shape_body.numpy()[shape])
            place = pose(model.shape_transform.numpy()[shape])
            motion = next((mover.motion for mover in world.movers if mover.fixture == i), None)
            if held >= 0:
                place = combined(self._pose(held), place)
            fixtures.append({"fixture": i, "primitive": primitive(model, shape), "pose": place, "motion": motion})
        return {
            "friction": friction,
            "table_friction": table_friction,
            "pad_friction": pad_friction,
            "gravity_m_s2": -float(model.gravity.numpy()[0][2]),
            "stiffness_nm_rad": stiffness[world.arm].tolist(),
            "grip_force_n": lead_m * float(stiffness[world.fingers].mean()),
            "grip_threshold_m": None,
            "objects": objects,
            "fixtures": fixtures,
        }

    def state_hash(self):
        views = self._views[id(self.state)]
        bits = blake2b(views["joint_q"].tobytes(), digest_size=8)
        bits.update(views["joint_qd"].tobytes())
        return int.from_bytes(bits.digest(), "little")

    def _pose(self, body):
        return pose(self._views[id(self.state)]["body_q"][body])

    def _place_movers(self):
        """Sets every moving fixture to its current position and velocity."""
        time = self.steps * self.time_step_s
        views = self._views[id(self.state)]
        for mover, motion in self._movers:
            place, speed = motion.position(time), motion.velocity(time)
            views["joint_q"][mover.q : mover.q + 3] = views["body_q"][mover.body, :3] = place
            views["joint_qd"][mover.qd : mover.qd + 3] = views["body_qd"][mover.body, :3] = speed

    def _move_geometry(self):
        views = self._views[id(self.state)]
        joints = views["joint_q"][[*self.world.arm, *self.world.fingers]]
        movers = [(mover.fixture, views["body_q"][mover.body, :3]) for mover, _ in self._movers]
        self._geometry.move(joints, movers)


def _views(state):
    return {name: getattr(state, name).numpy() for name in ("joint_q", "joint_qd", "body_q", "body_qd", "body_f")}
