"""Newton's Steel solver: joint coordinates, hard contacts, projected Gauss-Seidel, persistent friction patches.

It shares nothing with MuJoCo: contact model, solver and collision detection are different.
"""

import newton
import numpy as np
import warp as wp
from newton.solvers import SolverSteel
from robogate_bridge import Contact, Touches

from .engine import Engine

# Maximum numbers of contacts and constraint rows per step. An episode with more is diverged, never silently wrong.
CONTACTS = 128
ROWS = 192

# Distance to a joint's end stop at which its constraint rows are created, in rad or m.
STOP_GAP = 0.05


class SteelEngine(Engine):
    """Both steps, from one state to the other and back, are captured once and replayed. The results are identical, and
    eight times as fast."""

    name = "steel"
    time_step_s = 0.0025
    friction_is_mean = True
    gap = 0.002

    @staticmethod
    def version():
        return "steel (experimental), CPU"

    def start(self):
        model, world = self.world.model, self.world
        model.shape_contact_pairs = wp.array(np.array(world.pairs, dtype=np.int32), dtype=wp.vec2i, device="cpu")
        self._pipeline = newton.CollisionPipeline(
            model,
            broad_phase="explicit",
            rigid_contact_max=CONTACTS,
            max_triangle_pairs=1,
            deterministic=True,
            verify_buffers=False,
        )
        self._contacts = self._pipeline.contacts()
        self._solver = SolverSteel(
            model,
            iterations=24,
            enable_joint_limits=True,
            joint_limit_activation_gap=STOP_GAP,
            articulation_constraint_max=ROWS,
            free_body_constraint_max=ROWS,
            warn_constraint_overflow=False,
        )
        self._seen = self._solver.observables({self._solver.ObservableKind.CONTACT_F}, contacts=self._contacts)
        self._overflow = self._solver.constraint_overflow.numpy()
        self._count = self._contacts.rigid_contact_count.numpy()
        self._pair = (self._contacts.rigid_contact_shape0.numpy(), self._contacts.rigid_contact_shape1.numpy())
        self._normal, self._force = self._contacts.rigid_contact_normal.numpy(), self._seen.contact_f.numpy()
        mass, gravity = model.body_mass.numpy(), model.gravity.numpy()[0]
        for views in self._views.values():
            # The weight of the arm itself is compensated, as in the controller of a real arm.
            views["body_f"][world.robot_bodies, :3] = -mass[world.robot_bodies, None] * gravity
        inertia = model.body_inertia.numpy()
        # Index, body and moment of inertia of each ball.
        self._balls = [
            (i, body, float(inertia[body][0, 0])) for i, body in enumerate(world.object_bodies) if world.balls[i]
        ]
        self._rolling = Contact.of(self._cell).rolling_m
        self._pressed = [0.0] * len(world.object_bodies)
        self._graphs = []

    def integrate(self):
        if not self._graphs:
            for before, after in ((self.state, self.after), (self.after, self.state)):
                with wp.ScopedCapture(device="cpu") as capture:
                    self._pipeline.collide(before, self._contacts)
                    self._solver.step(
                        before, after, self.control, self._contacts, self.time_step_s, observables=self._seen
                    )
                self._graphs.append(capture.graph)
        self._resist_rolling()
        wp.capture_launch(self._graphs[self.steps % 2])

    def touches(self):
        touches, parts = Touches(len(self.world.object_bodies)), self.world.parts
        n = min(int(self._count[0]), CONTACTS)
        one, two = (shapes[:n].tolist() for shapes in self._pair)
        pushes = self._force[:n, :3]
        normal_forces = np.abs((self._normal[:n] * pushes).sum(axis=1)).tolist()
        for a, b, force, push in zip(one, two, normal_forces, pushes.astype(float).tolist()):
            # A contact within the margin that does not touch has no force.
            if force > 0.0:
                touches.add(parts[a], parts[b], force, push)
        self._pressed = touches.on_object_n
        return touches

    def friction(self):
        # Steel uses the mean of the two shapes' coefficients.
        held, world = self.world.model.shape_material_mu.numpy().astype(float), self.world
        own = float(held[world.object_shapes[0][0]])
        return own, *(0.5 * (own + float(held[shape])) for shape in (world.table_shape, world.pad_shape))

    def trouble(self):
        return f"more than {CONTACTS} contacts or {ROWS} rows" if self._overflow.any() else None

    def _resist_rolling(self):
        """Rolling friction of spheres, which Steel lacks: a moment against the rotation, at most the one that stops it."""
        views = self._views[id(self.state)]
        for i, body, inertia in self._balls:
            turning = views["body_qd"][body, 3:].astype(float)
            speed = float(np.linalg.norm(turning))
            moment = np.zeros(3)
            if self._pressed[i] > 0.0 and speed > 0.0:
                most = inertia * speed / self.time_step_s
                moment = turning * (-min(self._rolling * self._pressed[i], most) / speed)
            views["body_f"][body, 3:] = moment
