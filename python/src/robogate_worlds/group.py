"""Worlds of one topology: the same shapes and joints. Masses, sizes, friction, poses and gains differ between worlds."""

import contextlib

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from . import kernels
from .tables import BODY, COMMAND, FIELDS, REPORT, Tables

# Room for contacts and for rows of constraints in a world. The contacts of all worlds share one buffer.
CONTACTS, ROWS = 48, 256
# What makes an episode invalid. Reaching the iteration limit of the solver is as in MuJoCo: no error.
LOSSES = int(mjw.OverflowType.ALL) & ~int(mjw.OverflowType.ITERATIONS | mjw.OverflowType.LS_ITERATIONS)


class Group:
    """Worlds that are stepped together."""

    def __init__(self, path, model, plan, worlds, deterministic):
        self.worlds = worlds
        self._plan = plan
        self._mjm = mjm = mujoco.MjModel.from_binary_path(model)
        batched = {name: worlds for name in FIELDS if not name.startswith("opt.")}
        self._m = mjw.put_model(mjm, batch_sizes=batched)
        self._m.opt.deterministic = bool(deterministic)
        self._m.opt.warn_overflow = 0
        gravity = wp.array(np.tile(mjm.opt.gravity, (worlds, 1)), dtype=wp.vec3)
        gravity._is_batched = True
        self._m.opt.gravity = gravity
        self._d = mjw.make_data(mjm, nworld=worlds, nconmax=CONTACTS, njmax=ROWS)
        self._names, self._flat = [], []
        for name in FIELDS:
            array = gravity if name == "opt.gravity" else getattr(self._m, name)
            size = array.size * wp.types.type_size_in_bytes(array.dtype) // 4 // worlds
            if size:
                self._names.append(name)
                self._flat.append(self._as_floats(array, size))
        movers = np.array(plan["movers"], dtype=np.int32).reshape(-1, 2)
        self._motion = wp.zeros((worlds, max(1, len(movers)), 3), dtype=float)
        if len(movers):
            self._names.append("motion")
            self._flat.append(self._as_floats(self._motion, 3 * len(movers)))
        self._names.append("qpos")
        self._flat.append(self._d.qpos)
        widths = [flat.shape[1] for flat in self._flat]
        self._offsets = np.concatenate([[0], np.cumsum(widths)]).astype(int).tolist()

        joints, steps = len(plan["lag"]), plan["steps"]
        report = len(REPORT) + BODY * len(plan["free"])
        self.tables = Tables(path, {
            "numbers": (worlds, self._offsets[-1]),
            "held": (worlds, self._offsets[-1]),
            "command": (worlds, 3 * joints + len(COMMAND)),
            "reports": (worlds, steps, report),
            "qpos": (worlds, mjm.nq),
            "qvel": (worlds, mjm.nv),
            "lost": (worlds, 1),
        })
        ints = lambda values: wp.array(np.array(values, dtype=np.int32), dtype=int)
        self._role, self._index, self._finger = (ints(plan[name]) for name in ("role", "index", "finger"))
        self._lag = wp.array(np.array(plan["lag"], dtype=np.float32), dtype=float)
        self._fingers = ints(plan["fingers"])
        self._free = ints(np.array(plan["free"], dtype=np.int32).reshape(-1, 3))
        self._object_body = ints([body for body, _, _ in plan["free"]])
        self._movers = ints(movers)
        # Shapes of the world itself.
        self._still = ints(np.flatnonzero(mjm.geom_bodyid == 0))
        self._columns = 1 + plan["fixtures"] + mjm.nbody
        self._pressed = wp.zeros((worlds, 2), dtype=wp.int64)
        self._pairs = wp.zeros((worlds, mjm.nbody * self._columns), dtype=wp.int64)
        self._support = wp.zeros((worlds, 6), dtype=wp.int64)
        self._flags = wp.zeros(worlds, dtype=int)
        self._target = wp.zeros(worlds, dtype=float)
        self._command = wp.zeros(self.tables.command.shape, dtype=float)
        self._reports = wp.zeros(self.tables.reports.shape, dtype=float)
        # What the host reads after each period. Copies to such memory wait for nothing but the device.
        pinned = wp.get_device().is_cuda
        host = lambda array: wp.empty(array.shape, dtype=array.dtype, device="cpu", pinned=pinned)
        self._results = [(array, host(array)) for array in (self._reports, self._d.qpos, self._d.qvel, self._d.overflow)]
        self._clock = wp.zeros(1, dtype=int)
        self._graph = None
        # Groups run beside each other on a GPU.
        self._stream = wp.Stream() if wp.get_device().is_cuda else None
        wp.synchronize()

    def _own_stream(self):
        return wp.ScopedStream(self._stream) if self._stream else contextlib.nullcontext()

    @staticmethod
    def _as_floats(array, width):
        """The same memory as a table of floats with one row for each world."""
        flat = wp.array(ptr=array.ptr, dtype=float, shape=(array.shape[0], width), device=array.device)
        flat._owner = array
        return flat

    @property
    def fields(self):
        """The names and widths of the per-world numbers, in their order."""
        return [[name, flat.shape[1]] for name, flat in zip(self._names, self._flat)]

    def reset(self, worlds):
        """Sets these worlds up from their rows of `numbers`, and writes what the device has to `held`."""
        with self._own_stream():
            self._reset(worlds)

    def _reset(self, worlds):
        rows = wp.array(np.ascontiguousarray(self.tables.numbers[worlds]), dtype=float)
        index = wp.array(np.array(worlds, dtype=np.int32), dtype=int)
        back = wp.zeros(rows.shape, dtype=float)
        d = self._d
        wp.launch(kernels.start, dim=len(worlds), inputs=[
            index, self._plan["open_finger"], d.qvel, d.qacc, d.qacc_warmstart, d.ctrl, d.time, d.overflow, self._target,
        ])
        for flat, offset in zip(self._flat, self._offsets):
            wp.launch(kernels.scatter, dim=(len(worlds), flat.shape[1]), inputs=[rows, index, offset, flat])
        wp.launch(kernels.place_fixtures, dim=(len(worlds), self._still.shape[0]), inputs=[
            index, self._still, self._m.geom_pos, self._m.geom_quat, d.geom_xpos, d.geom_xmat,
        ])
        for flat, offset in zip(self._flat, self._offsets):
            wp.launch(kernels.gather, dim=(len(worlds), flat.shape[1]), inputs=[flat, index, offset, back])
        self.tables.held[worlds] = back.numpy()

    def _one(self):
        """One time step."""
        plan, d = self._plan, self._d
        joints, steps = len(plan["lag"]), plan["steps"]
        wp.launch(kernels.drive, dim=self.worlds, inputs=[
            self._clock, steps, steps * plan["time_step"], joints, plan["first"], self._lag, self._fingers, self._command,
            d.qpos, self._target, d.ctrl,
        ])
        mjw.step(self._m, d)
        contact = d.contact
        wp.launch(kernels.add_contacts, dim=contact.geom.shape[0], inputs=[
            joints, self._columns, plan["fixtures"], self._role, self._index, self._finger, self._object_body, self._command,
            d.nacon, contact.geom, contact.worldid, contact.efc_address, contact.dim, contact.pos, contact.frame,
            d.efc.force, d.xipos, self._pressed, self._pairs, self._support, self._flags,
        ])
        wp.launch(kernels.report, dim=self.worlds, inputs=[
            self._clock, plan["time_step"], joints, self._columns, plan["tcp"], self._fingers, self._free, self._movers,
            self._motion, self._command, d.site_xpos, d.site_xmat, self._pressed, self._pairs, self._support, self._flags,
            d.qpos, d.qvel, self._reports,
        ])
        wp.launch(kernels.tick, dim=1, inputs=[self._clock])

    def begin(self):
        """Starts one control period of all worlds, towards their commands."""
        with self._own_stream():
            self._begin()

    def _begin(self):
        self._command.assign(self.tables.command)
        if wp.get_device().is_cuda and self._graph is None:
            # A capture cannot load kernels: one step does, and is undone.
            self._clock.zero_()
            self._one()
            self._reload()
            with wp.ScopedCapture() as capture:
                self._one()
            self._graph = capture.graph
        self._clock.zero_()
        for _ in range(self._plan["steps"]):
            if self._graph is None:
                self._one()
            else:
                wp.capture_launch(self._graph)
        for array, host in self._results:
            wp.copy(host, array)

    def _reload(self):
        """Undoes a step."""
        self._reset(list(range(self.worlds)))
        for sums in (self._pressed, self._pairs, self._support, self._flags):
            sums.zero_()

    def finish(self):
        """Waits for the control period and writes its reports."""
        tables = self.tables
        if self._stream:
            wp.synchronize_stream(self._stream)
        reports, qpos, qvel, overflow = (host.numpy() for _, host in self._results)
        tables.reports[:] = reports
        tables.qpos[:] = qpos
        tables.qvel[:] = qvel
        tables.lost[:, 0] = overflow & LOSSES
