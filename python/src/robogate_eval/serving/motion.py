"""The motion of all bodies of a MuJoCo model during an episode, for a 3-D replay."""

from __future__ import annotations

from typing import Any

import numpy as np
from robogate_bridge import Recording

from .model import Model, layers

# Geoms and sites of these groups are visible by default, as in MuJoCo's own viewer.
VISIBLE_GROUPS = (0, 1, 2)
# The protocol allows this many triangles. A mesh beyond it is shown as its bounding box.
MAX_TRIANGLES = 1_000_000
# Half the thickness of a plane, in m.
PLANE_M = 0.001
# A height field is shown with at most this many points along each side.
MAX_FIELD = 64
# The largest number of contacts of a frame, those with the largest forces.
MAX_CONTACTS = 8
# A body that moved less than this is at rest, in m.
LEAST_WAY_M = 0.005
# The sum of the numbers of all frames: at most 40 MB.
MAX_NUMBERS = 10_000_000


class Recorder:
    """Records an episode from its start, with at most one frame in `period_s` seconds. Reads the state and does not change it."""

    def __init__(self, env: Any, model: Model, period_s: float):
        self._model = model
        self._period = period_s
        _show_targets(env, model)
        self._scene = Scene(model.model, _visible_groups(env))
        self._sides = sides(model.model)
        self._rows: list[np.ndarray] = []
        self._contacts: list[list[float]] = []
        self._most = max(2, MAX_NUMBERS // (1 + 7 * len(self._scene.bodies)))
        self._take(0.0)

    def advance(self, time_s: float) -> None:
        """Record the state after a control period, if a frame is due."""
        if time_s - self._last >= self._period - 1e-9 and len(self._rows) < self._most - 1:
            self._take(time_s)

    def recording(self, time_s: float) -> Recording:
        """What was recorded, and the present state as last frame."""
        if time_s > self._last:
            self._take(time_s)
        scene = self._scene
        rows = np.asarray(self._rows, dtype="<f4")
        poses = rows[:, 1:].reshape(len(rows), -1, 7)
        order = self._order(poses)
        solids = [{**solid, "body": order.index(solid["body"])} for solid in scene.solids]
        return Recording(
            bodies=[scene.names[body] for body in order],
            solids=solids,
            frames=len(rows),
            motion=np.hstack([rows[:, :1], poses[:, order].reshape(len(rows), -1)]),
            triangles=scene.triangles(),
            contacts=np.asarray(self._contacts, dtype="<f4"),
        )

    def _order(self, poses: np.ndarray) -> list[int]:
        """The bodies, and as the last one that whose path a viewer draws: the object that moved most, otherwise any body that did."""
        order = list(range(poses.shape[1]))
        objects = [body for body in order if self._sides[self._scene.bodies[body]] == "object"]
        ways = np.linalg.norm(np.diff(poses[:, :, :3].astype(float), axis=0), axis=2).sum(axis=0)
        if len(objects) == 0 or max(ways[objects]) < LEAST_WAY_M:
            objects = order
        if objects:
            order.append(order.pop(max(objects, key=lambda body: ways[body])))
        return order

    def _take(self, time_s: float) -> None:
        data, bodies = self._model.data, self._scene.bodies
        self._last = time_s
        self._contacts += [[len(self._rows), *contact] for contact in self._touching()]
        poses = np.hstack([data.xpos[bodies], data.xquat[bodies]])
        self._rows.append(np.concatenate([[time_s], poses.ravel()]))

    def _touching(self) -> list[list[float]]:
        """Kind, position and normal force of the largest contacts."""
        import mujoco

        model, data = self._model.model, self._model.data
        found, force = [], np.zeros(6)
        for at in range(data.ncon):
            contact = data.contact[at]
            pair = [self._sides[model.geom_bodyid[geom]] if geom >= 0 else None for geom in (contact.geom1, contact.geom2)]
            if None in pair or contact.efc_address < 0:
                continue
            kind = KINDS.get(frozenset(pair))
            if kind is None:
                continue
            mujoco.mj_contactForce(model, data, at, force)
            # The normal points from the first geom to the second one, which it pushes. The force is that on the object, or on the robot.
            upon = "object" if "object" in pair else "robot"
            sign = 1.0 if pair[1] == upon else -1.0
            found.append([float(kind), *contact.pos, *(sign * force[0] * contact.frame[:3])])
        found.sort(key=lambda one: -(one[4] ** 2 + one[5] ** 2 + one[6] ** 2))
        return found[:MAX_CONTACTS]


# The kind of a contact by what touches.
KINDS = {
    frozenset(("robot", "object")): 0,
    frozenset(("robot", "surroundings")): 1,
    frozenset(("object", "surroundings")): 2,
    frozenset(("object",)): 2,
}


def sides(model: Any) -> list[str]:
    """Of each body whether it belongs to the robot, to an object or to the surroundings.

    A kinematic tree with an actuator is a robot. Other bodies that move are objects, and those that do not are surroundings.
    """
    import mujoco

    roots = set()
    for actuator in range(model.nu):
        # From MuJoCo 3.17 on, an enumerator equals an integer of Python, and not always one of NumPy.
        kind, target = int(model.actuator_trntype[actuator]), int(model.actuator_trnid[actuator, 0])
        if kind in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
            bodies = [model.jnt_bodyid[target]]
        elif kind == mujoco.mjtTrn.mjTRN_TENDON:
            start = model.tendon_adr[target]
            wraps = range(start, start + model.tendon_num[target])
            bodies = [model.jnt_bodyid[model.wrap_objid[i]] for i in wraps if model.wrap_type[i] == mujoco.mjtWrap.mjWRAP_JOINT]
        elif kind in (mujoco.mjtTrn.mjTRN_SITE, mujoco.mjtTrn.mjTRN_SLIDERCRANK):
            bodies = [model.site_bodyid[target]]
        else:
            bodies = [target]
        roots.update(int(model.body_rootid[body]) for body in bodies)
    found = []
    for body in range(model.nbody):
        if int(model.body_rootid[body]) in roots:
            found.append("robot")
        else:
            found.append("surroundings" if model.body_weldid[body] == 0 else "object")
    return found


def _visible_groups(env: Any) -> tuple[int, ...]:
    # robosuite has the geoms of collisions in group 0 and those of pictures in group 1.
    hidden = any(getattr(layer, "render_collision_mesh", None) is False for layer in layers(env))
    return VISIBLE_GROUPS[1:] if hidden else VISIBLE_GROUPS


def _show_targets(env: Any, model: Model) -> None:
    """Let the environment place what it places before it renders, such as the mark of a target. The state stays as it is."""
    import mujoco

    place = getattr(env.unwrapped, "_render_callback", None)
    if not callable(place):
        return
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model.model, kind))
    mujoco.mj_getState(model.model, model.data, state, kind)
    place()
    mujoco.mj_setState(model.model, model.data, state, kind)


class Scene:
    """The visible solids of a model, and the bodies that carry them."""

    def __init__(self, model: Any, groups: tuple[int, ...]):
        self._model = model
        self.bodies: list[int] = []
        self.names: list[str] = []
        self.solids: list[dict] = []
        self._meshes: dict[Any, tuple[int, int]] = {}
        self._triangles: list[np.ndarray] = []
        # Triangles in the array, and those of all solids, which may share them.
        self._stored = self._shown = 0
        for geom in range(model.ngeom):
            color = self._color(model.geom_rgba[geom], int(model.geom_matid[geom]))
            if model.geom_group[geom] in groups and color[3] > 0.0:
                shape, offset = self._shape(geom)
                self._add(int(model.geom_bodyid[geom]), shape, model.geom_pos[geom], model.geom_quat[geom], color, offset)
        for site in range(model.nsite):
            color = self._color(model.site_rgba[site], int(model.site_matid[site]))
            if model.site_group[site] in groups and color[3] > 0.0:
                shape = self._primitive(int(model.site_type[site]), model.site_size[site])
                self._add(int(model.site_bodyid[site]), shape, model.site_pos[site], model.site_quat[site], color)

    def triangles(self) -> np.ndarray:
        return np.concatenate(self._triangles) if self._triangles else np.zeros((0, 9), dtype="<f4")

    def _add(self, body: int, shape: dict, position: Any, orientation: Any, color: Any, offset: Any = (0.0, 0.0, 0.0)) -> None:
        import mujoco

        if body not in self.bodies:
            self.bodies.append(body)
            name = mujoco.mj_id2name(self._model, mujoco.mjtObj.mjOBJ_BODY, body) or f"body {body}"
            self.names.append(name.encode()[:256].decode(errors="ignore"))
        moved = np.zeros(3)
        mujoco.mju_rotVecQuat(moved, np.asarray(offset, dtype=float), np.asarray(orientation, dtype=float))
        self.solids.append(
            {
                "body": self.bodies.index(body),
                "pose": {"position": (position + moved).tolist(), "orientation": np.asarray(orientation).tolist()},
                "shape": shape,
                "color": [int(round(255.0 * min(1.0, max(0.0, float(x))))) for x in color[:3]],
                "opacity": min(1.0, float(color[3])),
            }
        )

    def _color(self, own: Any, material: int) -> np.ndarray:
        """As MuJoCo's renderer: the colour of the material, unless the geom has one of its own. Textures have their mean colour."""
        color = np.array(own, dtype=float)
        if material < 0:
            return color
        if np.all(color == np.array([0.5, 0.5, 0.5, 1.0], dtype=np.float32)):
            color = np.array(self._model.mat_rgba[material], dtype=float)
        color[:3] *= self._texture(material)
        return color

    def _texture(self, material: int) -> np.ndarray:
        model = self._model
        for texture in np.atleast_1d(model.mat_texid[material]):
            if texture >= 0:
                channels = int(model.tex_nchannel[texture]) if hasattr(model, "tex_nchannel") else 3
                pixels = model.tex_data if hasattr(model, "tex_data") else model.tex_rgb
                start = int(model.tex_adr[texture])
                count = int(model.tex_height[texture]) * int(model.tex_width[texture])
                values = np.asarray(pixels[start : start + channels * count]).reshape(count, channels)
                mean = values.mean(axis=0) / 255.0
                return mean[:3] if channels >= 3 else np.repeat(mean[:1], 3)
        return np.ones(3)

    def _shape(self, geom: int) -> tuple[dict, Any]:
        """The shape of a geom, and its centre in the frame of the geom."""
        import mujoco

        model, kind, size = self._model, int(self._model.geom_type[geom]), self._model.geom_size[geom]
        centre = (0.0, 0.0, 0.0)
        data = int(model.geom_dataid[geom])
        if kind == mujoco.mjtGeom.mjGEOM_PLANE:
            # A plane without a size is infinite.
            wide = max(1.0, float(model.stat.extent))
            half = [float(x) if x > 0 else wide for x in size[:2]]
            return {"kind": "box", "half": [*half, PLANE_M]}, (0.0, 0.0, -PLANE_M)
        if kind == mujoco.mjtGeom.mjGEOM_HFIELD:
            return self._mesh(("field", data), lambda: _field(model, data)) or self._bounds(geom), centre
        if kind in (mujoco.mjtGeom.mjGEOM_MESH, getattr(mujoco.mjtGeom, "mjGEOM_SDF", None)) and data >= 0:
            found = self._mesh(("mesh", data), lambda: _mesh(model, data))
            return (found, centre) if found else (self._bounds(geom), model.geom_aabb[geom, :3])
        return self._primitive(kind, size), centre

    def _bounds(self, geom: int) -> dict:
        return {"kind": "box", "half": self._model.geom_aabb[geom, 3:].tolist()}

    def _primitive(self, kind: int, size: Any) -> dict:
        import mujoco

        if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
            return {"kind": "sphere", "radius": float(size[0])}
        if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            return {"kind": "capsule", "radius": float(size[0]), "half_height": float(size[1])}
        if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
            return {"kind": "cylinder", "radius": float(size[0]), "half_height": float(size[1])}
        if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            found = self._mesh(("ellipsoid", *map(float, size)), lambda: _ellipsoid(size))
            if found:
                return found
        return {"kind": "box", "half": [float(x) for x in size]}

    def _mesh(self, key: Any, make: Any) -> dict | None:
        """A mesh, stored once for each key. None if there is no room for it."""
        if key not in self._meshes:
            made = np.asarray(make(), dtype="<f4").reshape(-1, 9)
            self._meshes[key] = (self._stored, len(made))
            self._triangles.append(made)
            self._stored += len(made)
        first, count = self._meshes[key]
        if self._shown + count > MAX_TRIANGLES:
            return None
        self._shown += count
        return {"kind": "mesh", "first": first, "count": count}


def _mesh(model: Any, mesh: int) -> np.ndarray:
    vertex, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
    corners = model.mesh_vert[vertex : vertex + int(model.mesh_vertnum[mesh])]
    return corners[model.mesh_face[face : face + int(model.mesh_facenum[mesh])]]


def _field(model: Any, field: int) -> np.ndarray:
    rows, columns, start = int(model.hfield_nrow[field]), int(model.hfield_ncol[field]), int(model.hfield_adr[field])
    x, y, top, _ = model.hfield_size[field]
    heights = np.asarray(model.hfield_data[start : start + rows * columns]).reshape(rows, columns)
    down, across = (np.unique(np.linspace(0, count - 1, min(count, MAX_FIELD)).astype(int)) for count in (rows, columns))
    grid = np.stack(
        np.broadcast_arrays(
            (2.0 * x * across / max(1, columns - 1) - x)[None, :],
            (2.0 * y * down / max(1, rows - 1) - y)[:, None],
            top * heights[np.ix_(down, across)],
        ),
        axis=-1,
    )
    return _faces(grid)


def _ellipsoid(size: Any) -> np.ndarray:
    latitude, longitude = np.linspace(-np.pi / 2, np.pi / 2, 9), np.linspace(0.0, 2.0 * np.pi, 17)
    up, round_ = np.meshgrid(latitude, longitude, indexing="ij")
    unit = np.stack([np.cos(up) * np.cos(round_), np.cos(up) * np.sin(round_), np.sin(up)], axis=-1)
    return _faces(unit * np.asarray(size[:3]))


def _faces(grid: np.ndarray) -> np.ndarray:
    """The triangles of a grid of points, counter-clockwise if rows go up and columns to the right."""
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    return np.stack([np.stack([a, b, c], axis=-2), np.stack([a, c, d], axis=-2)], axis=-3).reshape(-1, 9)
