"""What happens on the device in each time step around MuJoCo Warp: drives before it, contacts and reports after it."""

import warp as wp

from .tables import BODY_ON_OBJECT, NOT_FINITE, OBJECT_ON_FIXTURE

wp.set_module_options({"enable_backward": False})

# Roles of shapes.
ROBOT, OBJECT, FIXTURE = wp.constant(0), wp.constant(1), wp.constant(2)
# Forces are added as integers, so that a sum does not depend on the order: 2^-20 N times 2^8. The lowest eight bits count the
# contacts.
UNIT = wp.constant(1048576.0)
COUNT = wp.constant(wp.int64(256))
# MuJoCo considers a state with larger numbers as diverged.
LARGEST = wp.constant(1.0e10)
ON_OBJECT, ON_FIXTURE = wp.constant(BODY_ON_OBJECT), wp.constant(OBJECT_ON_FIXTURE)
DIVERGED = wp.constant(NOT_FINITE)


@wp.kernel
def drive(
    clock: wp.array(dtype=int),
    steps: int,
    period: float,
    joints: int,
    first: int,
    lag: wp.array(dtype=float),
    fingers: wp.array(dtype=int),
    command: wp.array2d(dtype=float),
    qpos: wp.array2d(dtype=float),
    target: wp.array(dtype=float),
    ctrl: wp.array2d(dtype=float),
):
    """Sets the controls: a quadratic B-spline through the commands, and fingers whose target is at most so far ahead of them
    that they press with the grip force."""
    w = wp.tid()
    share = float(clock[0] + 1) / float(steps)
    a = 0.5 * (1.0 - share) * (1.0 - share)
    b = 0.5 + share * (1.0 - share)
    c = 0.5 * share * share
    softness = command[w, 3 * joints + 3]
    for i in range(joints):
        older, newer, newest = command[w, i], command[w, joints + i], command[w, 2 * joints + i]
        position = a * older + b * newer + c * newest
        velocity = ((1.0 - share) * (newer - older) + share * (newest - newer)) / period
        ctrl[w, first + i] = position + velocity * lag[i] / softness
    count = fingers.shape[0]
    if count > 0:
        opening = float(0.0)
        for i in range(count):
            opening += qpos[w, fingers[i]]
        goal, lead, speed = command[w, 3 * joints], command[w, 3 * joints + 1], command[w, 3 * joints + 2]
        finger = 0.5 * opening
        wanted = target[w] + wp.clamp(goal - target[w], -speed, speed)
        wanted = wp.clamp(wanted, finger - lead, finger + lead)
        target[w] = wanted
        for i in range(count):
            ctrl[w, first + joints + i] = wanted


@wp.kernel
def add_contacts(
    joints: int,
    columns: int,
    fixtures: int,
    role: wp.array(dtype=int),
    index: wp.array(dtype=int),
    finger: wp.array(dtype=int),
    object_body: wp.array(dtype=int),
    command: wp.array2d(dtype=float),
    nacon: wp.array(dtype=int),
    geom: wp.array(dtype=wp.vec2i),
    world: wp.array(dtype=int),
    address: wp.array2d(dtype=int),
    dim: wp.array(dtype=int),
    position: wp.array(dtype=wp.vec3),
    frame: wp.array(dtype=wp.mat33),
    force: wp.array2d(dtype=float),
    xipos: wp.array2d(dtype=wp.vec3),
    pressed: wp.array2d(dtype=wp.int64),
    pairs: wp.array2d(dtype=wp.int64),
    support: wp.array2d(dtype=wp.int64),
    flags: wp.array(dtype=int),
):
    """Adds each contact of the last step to the sums of its world."""
    contact = wp.tid()
    if contact >= wp.min(nacon[0], geom.shape[0]):
        return
    row = address[contact, 0]
    if row < 0:
        return
    w = world[contact]
    one, two = geom[contact][0], geom[contact][1]
    if one < 0 or two < 0:
        return
    first, second = role[one], role[two]
    if first < 0 or second < 0:
        return
    selected = int(command[w, 3 * joints + 4])
    normal = force[w, row]
    amount = wp.int64(normal * UNIT) * COUNT + wp.int64(1)
    if first == OBJECT or second == OBJECT:
        if first == ROBOT or second == ROBOT:
            body, thing, which = int(index[one]), int(index[two]), int(finger[one])
            if second == ROBOT:
                body = index[two]
                thing = index[one]
                which = finger[two]
            if thing == selected:
                if which >= 0:
                    wp.atomic_add(pressed, w, which, amount)
                else:
                    wp.atomic_or(flags, w, ON_OBJECT)
            wp.atomic_add(pairs, w, body * columns, amount)
            return
        mine_first = first == OBJECT and index[one] == selected
        mine_second = second == OBJECT and index[two] == selected
        if mine_first or mine_second:
            wp.atomic_or(flags, w, ON_FIXTURE)
            sign = float(1.0)
            if mine_first:
                sign = -1.0
            # The rows of the frame are its axes. In an elliptic cone the rows are the components of the force, and MuJoCo
            # scales none of them.
            axes = frame[contact]
            local = wp.vec3(normal, 0.0, 0.0)
            spin = wp.vec3(0.0, 0.0, 0.0)
            if dim[contact] > 1:
                local = wp.vec3(normal, force[w, address[contact, 1]], force[w, address[contact, 2]])
            if dim[contact] > 3:
                spin[0] = force[w, address[contact, 3]]
            if dim[contact] > 4:
                spin[1] = force[w, address[contact, 4]]
                spin[2] = force[w, address[contact, 5]]
            total = wp.transpose(axes) @ local * sign
            arm = position[contact] - xipos[w, object_body[selected]]
            torque = wp.transpose(axes) @ spin * sign + wp.cross(arm, total)
            for i in range(3):
                wp.atomic_add(support, w, i, wp.int64(total[i] * UNIT))
                wp.atomic_add(support, w, 3 + i, wp.int64(torque[i] * UNIT))
        return
    if first == ROBOT and second == ROBOT:
        near, far = wp.max(index[one], index[two]), wp.min(index[one], index[two])
        wp.atomic_add(pairs, w, near * columns + 1 + fixtures + far, amount)
    elif first == ROBOT:
        wp.atomic_add(pairs, w, index[one] * columns + 1 + index[two], amount)
    elif second == ROBOT:
        wp.atomic_add(pairs, w, index[two] * columns + 1 + index[one], amount)


@wp.func
def newtons(amount: wp.int64) -> float:
    return float(amount / COUNT) / UNIT


@wp.kernel
def report(
    clock: wp.array(dtype=int),
    time_step: float,
    joints: int,
    columns: int,
    tcp: int,
    fingers: wp.array(dtype=int),
    free: wp.array2d(dtype=int),
    movers: wp.array2d(dtype=int),
    motion: wp.array3d(dtype=float),
    command: wp.array2d(dtype=float),
    site_xpos: wp.array2d(dtype=wp.vec3),
    site_xmat: wp.array2d(dtype=wp.mat33),
    pressed: wp.array2d(dtype=wp.int64),
    pairs: wp.array2d(dtype=wp.int64),
    support: wp.array2d(dtype=wp.int64),
    flags: wp.array(dtype=int),
    qpos: wp.array2d(dtype=float),
    qvel: wp.array2d(dtype=float),
    out: wp.array3d(dtype=float),
):
    """Writes the report of a step, clears the sums, and moves the fixtures that move."""
    w = wp.tid()
    k = clock[0]
    opening = float(0.0)
    for i in range(fingers.shape[0]):
        opening += qpos[w, fingers[i]]
    out[w, k, 0] = opening
    for i in range(2):
        amount = pressed[w, i]
        if amount != wp.int64(0):
            out[w, k, 1 + i] = newtons(amount)
        else:
            out[w, k, 1 + i] = -1.0
        pressed[w, i] = wp.int64(0)
    peak, hardest = float(-1.0), float(-1.0)
    hit_body, hit_other = int(-1), int(-1)
    for pair in range(pairs.shape[1]):
        amount = pairs[w, pair]
        if amount != wp.int64(0):
            force = newtons(amount)
            peak = wp.max(peak, force)
            other = pair % columns
            if other > 0 and force > hardest:
                hardest = force
                hit_body = pair / columns
                hit_other = other - 1
            pairs[w, pair] = wp.int64(0)
    out[w, k, 4] = float(hit_body)
    out[w, k, 5] = float(hit_other)
    out[w, k, 6] = hardest
    out[w, k, 7] = peak
    place, turn = site_xpos[w, tcp], site_xmat[w, tcp]
    for i in range(3):
        out[w, k, 8 + i] = place[i]
        for j in range(3):
            out[w, k, 11 + 3 * i + j] = turn[i, j]
    for i in range(6):
        out[w, k, 20 + i] = float(support[w, i]) / UNIT
        support[w, i] = wp.int64(0)
    out[w, k, 26] = 0.0
    out[w, k, 27] = 0.0
    state = flags[w]
    flags[w] = 0
    for i in range(qpos.shape[1]):
        if not (wp.abs(qpos[w, i]) < LARGEST):
            state = state | DIVERGED
    for i in range(qvel.shape[1]):
        if not (wp.abs(qvel[w, i]) < LARGEST):
            state = state | DIVERGED
    out[w, k, 3] = float(state)
    for body in range(free.shape[0]):
        at, q, v = 28 + 13 * body, free[body, 1], free[body, 2]
        for i in range(7):
            out[w, k, at + i] = qpos[w, q + i]
        for i in range(6):
            out[w, k, at + 7 + i] = qvel[w, v + i]
    time = (command[w, 3 * joints + 5] + float(k + 1)) * time_step
    for i in range(movers.shape[0]):
        speed, starts, ends = motion[w, i, 0], motion[w, i, 1], motion[w, i, 2]
        qpos[w, movers[i, 0]] = speed * (wp.clamp(time, starts, wp.max(ends, starts)) - starts)
        if time >= starts and time < ends:
            qvel[w, movers[i, 1]] = speed
        else:
            qvel[w, movers[i, 1]] = 0.0


@wp.kernel
def tick(clock: wp.array(dtype=int)):
    """Counts the time steps of a control period."""
    clock[0] = clock[0] + 1


@wp.kernel
def scatter(
    rows: wp.array2d(dtype=float),
    worlds: wp.array(dtype=int),
    offset: int,
    out: wp.array2d(dtype=float),
):
    """Writes columns of `rows`, from `offset` on, to these worlds."""
    i, j = wp.tid()
    out[worlds[i], j] = rows[i, offset + j]


@wp.kernel
def gather(
    source: wp.array2d(dtype=float),
    worlds: wp.array(dtype=int),
    offset: int,
    rows: wp.array2d(dtype=float),
):
    """The inverse of `scatter`."""
    i, j = wp.tid()
    rows[i, offset + j] = source[worlds[i], j]


@wp.kernel
def place_fixtures(
    worlds: wp.array(dtype=int),
    geoms: wp.array(dtype=int),
    geom_pos: wp.array2d(dtype=wp.vec3),
    geom_quat: wp.array2d(dtype=wp.quat),
    geom_xpos: wp.array2d(dtype=wp.vec3),
    geom_xmat: wp.array2d(dtype=wp.mat33),
):
    """Places the shapes of the world itself. MuJoCo Warp does this once, for the model that it was given."""
    i, j = wp.tid()
    w, geom = worlds[i], geoms[j]
    geom_xpos[w, geom] = geom_pos[w, geom]
    turn = geom_quat[w, geom]
    # MuJoCo's quaternions begin with the scalar, those of Warp end with it.
    geom_xmat[w, geom] = wp.quat_to_matrix(wp.quat(turn[1], turn[2], turn[3], turn[0]))


@wp.kernel
def start(
    worlds: wp.array(dtype=int),
    open_finger: float,
    qvel: wp.array2d(dtype=float),
    qacc: wp.array2d(dtype=float),
    qacc_warmstart: wp.array2d(dtype=float),
    ctrl: wp.array2d(dtype=float),
    time: wp.array(dtype=float),
    overflow: wp.array(dtype=int),
    target: wp.array(dtype=float),
):
    """Sets these worlds to rest, with an open gripper."""
    w = worlds[wp.tid()]
    for i in range(qvel.shape[1]):
        qvel[w, i] = 0.0
        qacc[w, i] = 0.0
        qacc_warmstart[w, i] = 0.0
    for i in range(ctrl.shape[1]):
        ctrl[w, i] = 0.0
    time[w] = 0.0
    overflow[w] = 0
    target[w] = open_finger
