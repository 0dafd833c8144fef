"""Distances between shapes, computed with MuJoCo because Newton's solvers do not report them."""

import mujoco
from robogate_bridge import Part

# Larger clearances are not measured, in metres.
LIMIT_M = 0.25


class Geometry:
    """Robot, fixtures and objects as shapes without physics."""

    def __init__(self, robot, cell):
        spec = mujoco.MjSpec.from_file(str(robot.model))
        fingers = cell["robot"]["gripper"]["finger_bodies"]
        for i, fixture in enumerate(cell["fixtures"]):
            self._shape(spec.worldbody.add_geom(name=f"robogate/fixture/{i}"), fixture)
        for i, thing in enumerate(cell["objects"]):
            body = spec.worldbody.add_body(name=f"robogate/object/{i}")
            body.pos, body.quat = thing["pose"]["position"], thing["pose"]["orientation"]
            for k, part in enumerate(thing["parts"]):
                self._shape(body.add_geom(name=f"robogate/object/{i}/{k}"), part)
        self._model = model = spec.compile()
        self._data = mujoco.MjData(model)
        self._robot, self._fixtures, self._objects = [], [], []
        for geom in range(model.ngeom):
            name, body = model.geom(geom).name, int(model.geom_bodyid[geom])
            if name.startswith("robogate/fixture/"):
                self._fixtures.append((geom, Part("fixture", index=int(name.rsplit("/", 1)[-1]))))
            elif name.startswith("robogate/object/"):
                self._objects.append((geom, Part("object", index=int(name.split("/")[2]))))
            elif model.geom_contype[geom] or model.geom_conaffinity[geom]:
                word = model.body(body).name
                finger = fingers.index(word) if word in fingers else None
                # The part of the base that stands on the table has no clearance.
                self._robot.append((geom, Part("robot", word, finger), model.body_weldid[body] != 0))
        names = [*cell["robot"]["joints"], *cell["robot"]["gripper"]["finger_joints"]]
        self._addresses = [model.joint(name).qposadr[0] for name in names]

    @staticmethod
    def _shape(geom, thing):
        shape = thing["primitive"]
        geom.pos, geom.quat = thing["pose"]["position"], thing["pose"]["orientation"]
        match shape["kind"]:
            case "box":
                geom.type, geom.size = mujoco.mjtGeom.mjGEOM_BOX, shape["half"]
            case "cylinder":
                geom.type, geom.size = mujoco.mjtGeom.mjGEOM_CYLINDER, [shape["radius"], shape["half_height"], 0.0]
            case "sphere":
                geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, [shape["radius"], 0.0, 0.0]

    def move(self, joints, movers):
        """Sets the joints of arm and fingers, and the positions of moving fixtures by their index."""
        self._data.qpos[self._addresses] = joints
        for fixture, position in movers:
            self._model.geom_pos[self._fixtures[fixture][0]] = position
        mujoco.mj_kinematics(self._model, self._data)

    def clearance(self):
        """Smallest distance (m) between the robot, without its base, and a fixture. None beyond the limit."""
        best = LIMIT_M
        for geom, _, moves in self._robot:
            for other, _ in self._fixtures if moves else ():
                if self._apart(geom, other) < best:
                    best = min(best, mujoco.mj_geomDistance(self._model, self._data, geom, other, best, None))
        return max(best, 0.0) if best < LIMIT_M else None

    def touching(self):
        """Pairs of parts that overlap, one of which belongs to the robot."""
        for geom, part, moves in self._robot:
            for other, met in [*self._objects, *(self._fixtures if moves else ())]:
                if self._apart(geom, other) <= 0.0:
                    if mujoco.mj_geomDistance(self._model, self._data, geom, other, 1e-3, None) <= 0.0:
                        yield part, met

    def _apart(self, geom, other):
        """A lower bound of the distance between a shape and a fixture or part of an object."""
        model, data = self._model, self._data
        away = data.geom_xpos[geom] - data.geom_xpos[other]
        x, y, z = (away @ data.geom_xmat[other].reshape(3, 3)).tolist()
        a, b, c = model.geom_size[other].tolist()
        if model.geom_type[other] == mujoco.mjtGeom.mjGEOM_CYLINDER:
            a, b, c = a, a, b
        elif model.geom_type[other] == mujoco.mjtGeom.mjGEOM_SPHERE:
            b = c = a
        beyond = (max(abs(x) - a, 0.0) ** 2 + max(abs(y) - b, 0.0) ** 2 + max(abs(z) - c, 0.0) ** 2) ** 0.5
        return beyond - float(model.geom_rbound[geom])
