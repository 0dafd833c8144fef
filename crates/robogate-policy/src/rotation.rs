//! Rotation representations of models. Quaternions are (w, x, y, z), angles in radians.

use robogate_core::Pose;

type Quaternion = [f64; 4];

/// The rotation vector (axis times angle) of a unit quaternion, with the angle in [0, 2 pi] as in robosuite's
/// `quat2axisangle`. The vectors of q and -q differ. openpi and OpenVLA-OFT were trained on these.
pub(crate) fn axis_angle([w, x, y, z]: Quaternion) -> [f64; 3] {
    let sine = (1.0 - w.clamp(-1.0, 1.0).powi(2)).sqrt();
    if sine < 1e-9 {
        return [0.0; 3];
    }
    let scale = 2.0 * w.clamp(-1.0, 1.0).acos() / sine;
    [x * scale, y * scale, z * scale]
}

/// Roll, pitch and yaw: rotations about the fixed axes x, y, z, in this order (R = Rz Ry Rx).
pub(crate) fn euler([w, x, y, z]: Quaternion) -> [f64; 3] {
    let roll = (2.0 * (w * x + y * z)).atan2(1.0 - 2.0 * (x * x + y * y));
    let pitch = (2.0 * (w * y - z * x)).clamp(-1.0, 1.0).asin();
    let yaw = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
    [roll, pitch, yaw]
}

/// The quaternion of roll, pitch and yaw.
pub(crate) fn from_euler([roll, pitch, yaw]: [f64; 3]) -> Quaternion {
    let about = |axis: usize, angle: f64| {
        let mut q = [(0.5 * angle).cos(), 0.0, 0.0, 0.0];
        q[axis] = (0.5 * angle).sin();
        q
    };
    product(product(about(3, yaw), about(2, pitch)), about(1, roll))
}

/// The shortest rotation vector of roll, pitch and yaw.
pub(crate) fn euler_to_vector(angles: [f64; 3]) -> [f64; 3] {
    let q = from_euler(angles);
    axis_angle(if q[0] < 0.0 { q.map(|n| -n) } else { q })
}

/// The rotation `b` followed by `a`.
pub(crate) fn product(a: Quaternion, b: Quaternion) -> Quaternion {
    let ([aw, ax, ay, az], [bw, bx, by, bz]) = (a, b);
    [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]
}

/// The pose in the conventions of the model: with its position offset and tool frame (roll, pitch, yaw).
pub(crate) fn model_pose(pose: &Pose, shift_m: [f64; 3], tool_frame: [f64; 3]) -> Pose {
    let mut position = pose.position;
    position.iter_mut().zip(shift_m).for_each(|(p, s)| *p += s);
    Pose { position, orientation: product(pose.orientation, from_euler(tool_frame)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: [f64; 3], b: [f64; 3]) {
        a.iter().zip(b).for_each(|(a, b)| assert!((a - b).abs() < 1e-12, "{a} differs from {b}"));
    }

    /// scipy 1.17.1: `Rotation.from_euler("xyz", [0.1, -0.2, 0.3])`, its `as_rotvec` and `as_quat`.
    #[test]
    fn euler_angles_agree_with_scipy() {
        let q = from_euler([0.1, -0.2, 0.3]);
        close([q[1], q[2], q[3]], [0.064_071_347_706_071_16, -0.091_157_549_342_990_71, 0.153_439_302_024_222_57]);
        close(euler(q), [0.1, -0.2, 0.3]);
        close(
            euler_to_vector([0.1, -0.2, 0.3]),
            [0.128_923_363_725_904_04, -0.183_425_795_009_378_72, 0.308_748_163_617_030_2],
        );
    }

    /// robosuite's formula for a tool that points down: the angle is positive for both signs of the quaternion.
    #[test]
    fn rotation_vectors_depend_on_the_quaternion_sign() {
        let angle = 3.0_f64;
        let q = [(0.5 * angle).cos(), (0.5 * angle).sin(), 0.0, 0.0];
        close(axis_angle(q), [angle, 0.0, 0.0]);
        close(axis_angle(q.map(|n| -n)), [-(2.0 * std::f64::consts::PI - angle), 0.0, 0.0]);
        close(axis_angle([1.0, 0.0, 0.0, 0.0]), [0.0; 3]);
    }
}
