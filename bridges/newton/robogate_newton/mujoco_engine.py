"""Newton's MuJoCo solver on the CPU, with the settings of RoboGate's MuJoCo engine."""

import warnings

import mujoco
import numpy as np
from newton.solvers import SolverMuJoCo
from robogate_bridge import Touches

from .engine import Engine


class MujocoEngine(Engine):
    """MuJoCo called through Newton: state and controls pass through Newton's single-precision arrays at every step."""

    name = "mujoco"
    time_step_s = 0.002
    friction_is_mean = False
    gap = 0.0

    @staticmethod
    def version():
        return f"mujoco {mujoco.__version__}, CPU"

    def start(self):
        self._solver = SolverMuJoCo(
            self.world.model,
            use_mujoco_cpu=True,
            integrator="implicitfast",
            cone="elliptic",
            impratio=10.0,
            iterations=100,
            ls_iterations=50,
            enable_multiccd=True,
            include_sites=False,
            kinematic_switchable_roots=False,
        )
        self._model, self._data = self._solver.mj_model, self._solver.mj_data
        shapes = self._solver.mjc_geom_to_newton_shape.numpy()[0]
        self._parts = [self.world.parts[shape] if shape >= 0 else None for shape in shapes]
        self._geom = {int(shape): geom for geom, shape in enumerate(shapes) if shape >= 0}
        self._force = np.zeros(6)

    def integrate(self):
        self._solver.step(self.state, self.after, self.control, None, self.time_step_s)

    def touches(self):
        touches, contact = Touches(len(self.world.object_bodies)), self._data.contact
        for i, ((one, two), row) in enumerate(zip(contact.geom.tolist(), contact.efc_address.tolist())):
            # A contact within the margin that does not touch has no constraint.
            if row >= 0:
                mujoco.mj_contactForce(self._model, self._data, i, self._force)
                # The rows of the frame are its axes. The force acts on the second shape.
                push = (-self._force[:3] @ contact.frame[i].reshape(3, 3)).tolist()
                touches.add(self._parts[one], self._parts[two], float(self._force[0]), push)
        return touches

    def friction(self):
        def held(shape):
            geom = self._geom[shape]
            return float(self._model.geom_friction[geom][0]), int(self._model.geom_priority[geom])

        own, own_priority = held(self.world.object_shapes[0][0])
        # The geometry with the higher priority determines the contact parameters.
        others = (held(shape) for shape in (self.world.table_shape, self.world.pad_shape))
        return own, *(other if priority > own_priority else own for other, priority in others)

    def trouble(self):
        for kind, warning in enumerate(self._data.warning):
            if warning.number:
                return f"{mujoco.mjtWarning(kind).name} at {warning.lastinfo}"
        return None


# Newton also validates the model with MuJoCo Warp, which has its own limits for friction.
warnings.filterwarnings("ignore", message=".*MJ_MINMU.*")
