"""The drives of RoboGate's cell, for servers that simulate it: smooth targets from commands at the control rate."""


class Servo:
    """Follows joint commands through a quadratic B-spline with the commands as control points.

    Within a control period, the target moves from the midpoint of the last two commands to the midpoint of the last and
    the new one. Commands are first clipped to the limits of acceleration, velocity and position of the joints.
    """

    def __init__(self, robot, period):
        """Creates a servo at rest at `robot["home_rad"]`. `robot` is that of the cell, `period` the control period in seconds."""
        self._speed = [limit * period for limit in robot["velocity_limit_rad_s"]]
        self._change = [limit * period * period for limit in robot["acceleration_limit_rad_s2"]]
        self._range = robot["position_limit_rad"]
        self._period = period
        home = [float(q) for q in robot["home_rad"]]
        self._older, self._newer, self._newest = home, home, home

    def command(self, joints):
        """Sets the commanded joint positions (rad) for the end of the next control period."""
        newest = []
        for i, command in enumerate(joints):
            last, before = self._newest[i], self._newer[i]
            step = last - before
            step += _cut((command - last) - step, -self._change[i], self._change[i])
            low, high = self._range[i]
            newest.append(_cut(last + _cut(step, -self._speed[i], self._speed[i]), low, high))
        self._older, self._newer, self._newest = self._newer, self._newest, newest

    def targets(self, share):
        """Positions (rad) and velocities (rad/s) at this fraction, above 0 and up to 1, of the control period."""
        a, b, c = 0.5 * (1.0 - share) ** 2, 0.5 + share * (1.0 - share), 0.5 * share * share
        points = list(zip(self._older, self._newer, self._newest))
        positions = [a * older + b * newer + c * newest for older, newer, newest in points]
        velocities = [
            ((1.0 - share) * (newer - older) + share * (newest - newer)) / self._period
            for older, newer, newest in points
        ]
        return positions, velocities


class Fingers:
    """Targets of the fingers of a parallel gripper: the distance of each from the closed position, in metres.

    Closing drives past the closed position, until the object or the other finger stops the finger. The target is ahead of
    the finger by at most the distance at which its spring exerts the grip force.
    """

    def __init__(self, gripper, time_step):
        """Creates open fingers. `gripper` is that of the cell's robot, `time_step` in seconds."""
        self._goal = 0.5 * gripper["opening_m"]
        self._lead = gripper["force_n"] / gripper["stiffness_n_m"]
        self._step = gripper["finger_speed_m_s"] * time_step
        self._target = self._goal

    @property
    def lead_m(self):
        """Distance by which a target is ahead of a finger that presses, in metres."""
        return self._lead

    def target(self, close, opening):
        """Computes the target of the next time step, for an open or close command, with the pads `opening` (m) apart."""
        goal = -self._goal if close else self._goal
        finger = 0.5 * opening
        moved = self._target + _cut(goal - self._target, -self._step, self._step)
        self._target = _cut(moved, finger - self._lead, finger + self._lead)
        return self._target


def _cut(value, low, high):
    return min(max(value, low), high)
