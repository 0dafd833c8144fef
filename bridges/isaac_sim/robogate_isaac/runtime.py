"""The only module that uses Isaac Sim: a stage with PhysX, step by step. Import it after `SimulationApp` was started."""

import numpy as np
import omni.usd
from isaacsim.core.api import World
from isaacsim.core.prims import SingleArticulation, SingleRigidPrim
from isaacsim.core.utils.types import ArticulationAction
from isaacsim.core.version import get_version
from omni.physx import get_physx_simulation_interface
from pxr import PhysicsSchemaTools

from .stage import ROBOT, SCENE, Cell, object_path


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
        self._objects = [
            SingleRigidPrim(object_path(i), name=f"object_{i}", reset_xform_properties=False)
            for i in range(len(cell["objects"]))
        ]
        self._tool = SingleRigidPrim(f"{ROBOT}/{tool_body}", name="tool", reset_xform_properties=False)
        # This runs a step, which is undone below.
        self._world.reset()
        for prim in (self._arm, *self._objects, self._tool):
            prim.initialize()
        drives, gripper = cell["robot"], cell["robot"]["gripper"]
        names = [*drives["joints"], *gripper["finger_joints"]]
        self._dofs = np.array([self._arm.get_dof_index(name) for name in names])
        start = [*drives["home_rad"], *[0.5 * gripper["opening_m"]] * len(gripper["finger_joints"])]
        self._arm.set_joint_positions(np.array(start), joint_indices=self._dofs)
        self._arm.set_joint_velocities(np.zeros(len(start)), joint_indices=self._dofs)
        for prim, thing in zip(self._objects, cell["objects"]):
            prim.set_world_pose(np.array(thing["pose"]["position"]), np.array(thing["pose"]["orientation"]))
            prim.set_linear_velocity(np.zeros(3))
            prim.set_angular_velocity(np.zeros(3))
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

    def objects(self):
        """For each object its pose, the velocity of its centre of mass, and its angular velocity."""
        return [
            (_pose(prim), prim.get_linear_velocity().tolist(), prim.get_angular_velocity().tolist())
            for prim in self._objects
        ]

    def tool_body(self):
        """Pose of the body that carries the tool centre point."""
        return _pose(self._tool)

    def contacts(self):
        """Pairs of paths of bodies in contact in the last step, the normal force between them (N), and the total force on the first
        one."""
        headers, points, anchors = self._physx.get_full_contact_report()
        for header in headers:
            first, count = header.contact_data_offset, header.num_contact_data
            normal, total = 0.0, np.zeros(3)
            for point in points[first : first + count]:
                push = _vector(point.impulse)
                normal += abs(float(_vector(point.normal) @ push))
                total += push
            first, count = header.friction_anchors_offset, header.num_friction_anchors_data
            for anchor in anchors[first : first + count]:
                total += _vector(anchor.impulse)
            # A contact within the margin that does not touch has no force.
            if normal > 0.0:
                force = (total / self._time_step).tolist()
                yield _path(header.actor0), _path(header.actor1), normal / self._time_step, force

    def masses(self):
        """Mass (kg) and centre of mass of each object in PhysX."""
        return [(float(prim.get_mass()), np.asarray(prim.get_com()[0]).reshape(3).tolist()) for prim in self._objects]

    def gravity(self):
        """Downward gravity (m/s^2) of the physics scene."""
        direction, magnitude = self._world.get_physics_context().get_gravity()
        return -float(direction[2]) * float(magnitude)


def _vector(three):
    return np.array([three.x, three.y, three.z])


def _pose(prim):
    position, orientation = prim.get_world_pose()
    return {"position": np.asarray(position).tolist(), "orientation": np.asarray(orientation).tolist()}


def _path(encoded):
    return str(PhysicsSchemaTools.intToSdfPath(encoded))
