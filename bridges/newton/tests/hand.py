"""Drives a simulator of RoboGate's cell: grasps from above, lifts, and records the reports."""

import mujoco
import numpy as np
from robogate_bridge import Action, Scenario

DOWN = np.diag([1.0, -1.0, -1.0])


class Chain:
    """The robot's kinematics, computed by MuJoCo from the robot's file, independently of Newton."""

    def __init__(self, robot):
        self.model = mujoco.MjModel.from_xml_path(str(robot.model))
        self.data = mujoco.MjData(self.model)
        self.site = self.model.site("tcp").id
        self.joints = [self.model.joint(name).qposadr[0] for name in robot.joints]

    def tool(self, joints):
        self.data.qpos[self.joints] = joints
        mujoco.mj_kinematics(self.model, self.data)
        return self.data.site_xpos[self.site].copy(), self.data.site_xmat[self.site].reshape(3, 3).copy()

    def reach(self, position, near):
        """Joint positions with the tool at a position, pointing down."""
        joints = np.array(near, dtype=float)
        jacobian = np.zeros((6, self.model.nv))
        for _ in range(100):
            at, turn = self.tool(joints)
            mujoco.mj_comPos(self.model, self.data)
            mujoco.mj_jacSite(self.model, self.data, jacobian[:3], jacobian[3:], self.site)
            off = DOWN @ turn.T
            spin = 0.5 * np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]])
            error = np.concatenate([np.asarray(position) - at, spin])
            if np.abs(error).max() < 1e-9:
                return joints
            a = jacobian[:, : len(joints)]
            joints += a.T @ np.linalg.solve(a @ a.T + 1e-9 * np.eye(6), error)
        raise ValueError(f"{position} is out of reach")


class Hand:
    """One episode of a simulator, with everything that it reported."""

    def __init__(self, simulator, chain, cell):
        self.simulator, self.chain, self.cell = simulator, chain, cell
        self.start = simulator.reset(Scenario(index=0, seed=0, parameters={}, cell=cell))
        self.observation = self.start["observation"]
        self.joints = np.array(cell["robot"]["home_rad"])
        self.closed = False
        self.steps = []

    def run(self, joints=None):
        arm = list(self.joints if joints is None else joints)
        self.steps.append(self.simulator.step(Action("joint_position", arm, 1.0 if self.closed else -1.0)))
        self.observation = self.steps[-1]["observation"]

    def wait(self, seconds):
        for _ in range(round(seconds / 0.05)):
            self.run()

    def go(self, position, seconds):
        """Moves the tool in a straight line, from rest to rest."""
        origin, near = self.chain.tool(self.joints)[0], self.joints
        count = round(seconds / 0.05)
        for k in range(1, count + 1):
            u = k / count
            share = u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
            near = self.chain.reach(origin + share * (np.asarray(position) - origin), near)
            self.run(near)
        self.joints = near

    def grasp(self, height=None):
        """Moves from home to the object and closes the gripper."""
        x, y, z = self.cell["objects"][0]["pose"]["position"]
        self.go([x, y, 0.2], 1.0)
        self.go([x, y, z if height is None else height], 0.8)
        self.closed = True
        self.wait(1.0)

    def lift(self, seconds=1.0):
        x, y, _ = self.cell["objects"][0]["pose"]["position"]
        self.go([x, y, 0.2], seconds)
        self.wait(0.5)

    @property
    def sight(self):
        return self.steps[-1]["sights"][-1]

    @property
    def object(self):
        return np.array(self.sight["objects"][0]["pose"]["position"])
