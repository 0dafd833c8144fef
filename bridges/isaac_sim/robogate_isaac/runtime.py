"""The only module that uses Isaac Sim: a stage with PhysX, step by step. Import it after `SimulationApp` was started."""

import numpy as np
import omni.usd
from isaacsim.core.api import World
from isaacsim.core.prims import SingleArticulation, SingleRigidPrim
from isaacsim.core.utils.types import ArticulationAction
from isaacsim.core.version import get_version
from omni.physx import get_physx_simulation_interface
from pxr import PhysicsSchemaTools

from .stage import OBJECT, ROBOT, SCENE, Cell


def version():
    """The version of Isaac Sim."""
    return get_version()[0]


class Runtime:
    """A cell in Isaac Sim."""

    def __init__(self, robot, cell, time_step_s, tool_body):
        World.clear_instance()
        omni.usd.get_context().new_stage()
        stage = omni.usd.get_context().get_stage()
        self.cell = Cell(stage, robot, cell, time_step_s)
        # `set_defaults` would replace gravity and settings of the authored scene by Isaac Sim's.
        self._world = World(
            physics_dt=time_step_s,
            rendering_dt=cell["control_period_s"],
            stage_units_in_meters=1.0,
            physics_prim_path=SCENE,
            set_defaults=False,
            backend="numpy",
        )
        self._time_step = time_step_s
        self._arm = SingleArticulation(ROBOT, name="robot", reset_xform_properties=False)
        self._object = SingleRigidPrim(OBJECT, name="object", reset_xform_properties=False)
        self._tool = SingleRigidPrim(f"{ROBOT}/{tool_body}", name="tool", reset_xform_properties=False)
        # This runs a step, which is undone below.
        self._world.reset()
        for prim in (self._arm, self._object, self._tool):
            prim.initialize()
        drives, gripper = cell["robot"], cell["robot"]["gripper"]
        names = [*drives["joints"], *gripper["finger_joints"]]
        self._dofs = np.array([self._arm.get_dof_index(name) for name in names])
        start = [*drives["home_rad"], *[0.5 * gripper["opening_m"]] * len(gripper["finger_joints"])]
        self._arm.set_joint_positions(np.array(start), joint_indices=self._dofs)
        self._arm.set_joint_velocities(np.zeros(len(start)), joint_indices=self._dofs)
        place = cell["object"]["pose"]
        self._object.set_world_pose(np.array(place["position"]), np.array(place["orientation"]))
        self._object.set_linear_velocity(np.zeros(3))
        self._object.set_angular_velocity(np.zeros(3))
        self._physx = get_physx_simulation_interface()

    def step(self, positions, velocities):
        """Runs one time step towards these targets of the drives of arm and fingers."""
        self._arm.apply_action(ArticulationAction(np.array(positions), np.array(velocities), joint_indices=self._dofs))
        self._world.step(render=False)

    def joints(self):
        """Positions and velocities of the joints of arm and fingers."""
        return (
            self._arm.get_joint_positions(joint_indices=self._dofs).tolist(),
            self._arm.get_joint_velocities(joint_indices=self._dofs).tolist(),
        )

    def object(self):
        """Pose, velocity of the centre of mass, angular velocity."""
        return _pose(self._object), self._object.get_linear_velocity().tolist(), self._object.get_angular_velocity().tolist()

    def tool_body(self):
        """Pose of the body that carries the tool centre point."""
        return _pose(self._tool)

    def contacts(self):
        """Pairs of paths of bodies in contact in the last step, and the normal force between them (N)."""
        headers, points = self._physx.get_contact_report()
        for header in headers:
            first, count = header.contact_data_offset, header.num_contact_data
            impulse = 0.0
            for point in points[first : first + count]:
                n, push = point.normal, point.impulse
                impulse += abs(n.x * push.x + n.y * push.y + n.z * push.z)
            # A contact within the margin that does not touch has no force.
            if impulse > 0.0:
                yield _path(header.actor0), _path(header.actor1), impulse / self._time_step

    def mass(self):
        """Mass (kg) and centre of mass of the object in PhysX."""
        position, _ = self._object.get_com()
        return float(self._object.get_mass()), np.asarray(position).reshape(3).tolist()

    def gravity(self):
        """Downward gravity (m/s^2) of the physics scene."""
        direction, magnitude = self._world.get_physics_context().get_gravity()
        return -float(direction[2]) * float(magnitude)


def _pose(prim):
    position, orientation = prim.get_world_pose()
    return {"position": np.asarray(position).tolist(), "orientation": np.asarray(orientation).tolist()}


def _path(encoded):
    return str(PhysicsSchemaTools.intToSdfPath(encoded))
