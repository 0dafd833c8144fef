"""The drives of RoboGate's world, for servers that run its cell: commands at the control rate become smooth targets."""


class Servo:
    """Follows joint commands through a quadratic B-spline with the commands as control points.

    Within a control period the target moves from the middle of the last two commands to the middle of the last and
    the new one. Commands beyond the joints' accelerations, speeds or positions are cut to them first.
    """

    def __init__(self, robot, period):
        """At rest at `robot["home_rad"]`; `robot` is the cell's, `period` the control period in seconds."""
        self._speed = [limit * period for limit in robot["velocity_limit_rad_s"]]
        self._change = [limit * period * period for limit in robot["acceleration_limit_rad_s2"]]
        self._range = robot["position_limit_rad"]
        self._period = period
        home = [float(q) for q in robot["home_rad"]]
        self._older, self._newer, self._newest = home, home, home

    def command(self, joints):
        """Takes the joint positions (rad) that the arm shall have at the end of the next control period."""
        newest = []
        for i, wanted in enumerate(joints):
            last, before = self._newest[i], self._newer[i]
            step = last - before
            step += _cut((wanted - last) - step, -self._change[i], self._change[i])
            low, high = self._range[i]
            newest.append(_cut(last + _cut(step, -self._speed[i], self._speed[i]), low, high))
        self._older, self._newer, self._newest = self._newer, self._newest, newest

    def targets(self, share):
        """Positions (rad) and velocities (rad/s) at this share, above 0 and up to 1, of the control period."""
        a, b, c = 0.5 * (1.0 - share) ** 2, 0.5 + share * (1.0 - share), 0.5 * share * share
        points = list(zip(self._older, self._newer, self._newest))
        positions = [a * older + b * newer + c * newest for older, newer, newest in points]
        velocities = [
            ((1.0 - share) * (newer - older) + share * (newest - newer)) / self._period
            for older, newer, newest in points
        ]
        return positions, velocities


class Fingers:
    """Targets of a parallel gripper's fingers: how far each is from the closed position, in metres.

    Closing drives past the closed position: what stops the fingers is the object or each other. The target runs ahead of
    the finger by no more than the way on which its spring builds up the grip force.
    """

    def __init__(self, gripper, time_step):
        """Open; `gripper` is that of the cell's robot, `time_step` in seconds."""
        self._goal = 0.5 * gripper["opening_m"]
        self._lead = gripper["force_n"] / gripper["stiffness_n_m"]
        self._step = gripper["finger_speed_m_s"] * time_step
        self._target = self._goal

    def target(self, close, opening):
        """The next time step's target, told to close or not, the pads `opening` (m) apart."""
        goal = -self._goal if close else self._goal
        finger = 0.5 * opening
        moved = self._target + _cut(goal - self._target, -self._step, self._step)
        self._target = _cut(moved, finger - self._lead, finger + self._lead)
        return self._target


def _cut(value, low, high):
    return min(max(value, low), high)
