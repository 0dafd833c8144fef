//! Rotation representations of models. Quaternions are (w, x, y, z), angles in radians.

use robogate_core::Pose;

use super::profile::Rotation;

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
    shortest(from_euler(angles))
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

/// The quaternion of the same rotation whose x is not negative. A tool that points down has the quaternion
/// (0, cos(yaw / 2), sin(yaw / 2), 0), so this sign is continuous for yaws between -180 and 180 degrees.
pub(crate) fn downwards(q: Quaternion) -> Quaternion {
    if q[1] < 0.0 { q.map(|n| -n) } else { q }
}

/// The inverse of a rotation.
pub(crate) fn inverse([w, x, y, z]: Quaternion) -> Quaternion {
    [w, -x, -y, -z]
}

/// The unit quaternion of a rotation vector.
pub(crate) fn from_axis_angle(vector: [f64; 3]) -> Quaternion {
    let angle = vector.iter().map(|n| n * n).sum::<f64>().sqrt();
    // sin(a / 2) / a, also for small angles.
    let scale = if angle < 1e-9 { 0.5 } else { (0.5 * angle).sin() / angle };
    [(0.5 * angle).cos(), vector[0] * scale, vector[1] * scale, vector[2] * scale]
}

/// The shortest rotation vector of a unit quaternion.
pub(crate) fn shortest([w, x, y, z]: Quaternion) -> [f64; 3] {
    let sine = (x * x + y * y + z * z).sqrt();
    let (w, sign) = if w < 0.0 { (-w, -1.0) } else { (w, 1.0) };
    // The angle divided by the sine of its half, also for small angles.
    let scale = sign * if sine < 1e-9 { 2.0 } else { 2.0 * sine.atan2(w) / sine };
    [x * scale, y * scale, z * scale]
}

/// The vector after the rotation.
pub(crate) fn rotate(q: Quaternion, [x, y, z]: [f64; 3]) -> [f64; 3] {
    let [_, x, y, z] = product(product(q, [0.0, x, y, z]), inverse(q));
    [x, y, z]
}

/// The unit quaternion with this direction. `None` for a quaternion without direction.
pub(crate) fn unit(q: Quaternion) -> Option<Quaternion> {
    let norm = q.iter().map(|n| n * n).sum::<f64>().sqrt();
    (norm > 1e-6 && norm.is_finite()).then(|| q.map(|n| n / norm))
}

/// The columns of the rotation matrix.
pub(crate) fn columns(q: Quaternion) -> [[f64; 3]; 3] {
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| rotate(q, axis))
}

/// The unit quaternion of the rotation whose first two columns point along `a` and, made perpendicular, `b`.
fn from_columns(a: [f64; 3], b: [f64; 3]) -> Option<Quaternion> {
    let normal = |v: [f64; 3]| {
        let norm = v.iter().map(|n| n * n).sum::<f64>().sqrt();
        (norm > 1e-6 && norm.is_finite()).then(|| v.map(|n| n / norm))
    };
    let a = normal(a)?;
    let along: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
    let b = normal([b[0] - along * a[0], b[1] - along * a[1], b[2] - along * a[2]])?;
    let c = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    // Shepperd's method (1978): divide by the largest of the four numbers.
    let (xx, yy, zz) = (a[0], b[1], c[2]);
    let squares = [1.0 + xx + yy + zz, 1.0 + xx - yy - zz, 1.0 - xx + yy - zz, 1.0 - xx - yy + zz];
    let largest = (0..4).fold(0, |best, i| if squares[i] > squares[best] { i } else { best });
    let (wx, wy, wz) = (b[2] - c[1], c[0] - a[2], a[1] - b[0]);
    let (xy, xz, yz) = (b[0] + a[1], c[0] + a[2], c[1] + b[2]);
    unit(match largest {
        0 => [squares[0], wx, wy, wz],
        1 => [wx, squares[1], xy, xz],
        2 => [wy, xy, squares[2], yz],
        _ => [wz, xz, yz, squares[3]],
    })
}

/// The numbers of a rotation in this representation.
pub(crate) fn write(form: Rotation, q: Quaternion) -> Vec<f64> {
    let [w, x, y, z] = q;
    match form {
        Rotation::AxisAngle => shortest(q).to_vec(),
        Rotation::Euler => euler(q).to_vec(),
        Rotation::QuaternionXyzw => vec![x, y, z, w],
        Rotation::QuaternionWxyz => vec![w, x, y, z],
        Rotation::Rot6dColumns => columns(q)[..2].concat(),
        Rotation::Rot6dInterleaved => {
            let [a, b, _] = columns(q);
            (0..3).flat_map(|row| [a[row], b[row]]).collect()
        }
        // The rows of a rotation matrix are the columns of its inverse.
        Rotation::Rot6dRows => columns(inverse(q))[..2].concat(),
    }
}

/// The rotation of numbers in this representation. `None` if they are not a rotation.
pub(crate) fn read(form: Rotation, numbers: &[f64]) -> Option<Quaternion> {
    match (form, numbers) {
        (Rotation::AxisAngle, [x, y, z]) => Some(from_axis_angle([*x, *y, *z])),
        (Rotation::Euler, [x, y, z]) => Some(from_euler([*x, *y, *z])),
        (Rotation::QuaternionXyzw, [x, y, z, w]) | (Rotation::QuaternionWxyz, [w, x, y, z]) => unit([*w, *x, *y, *z]),
        (Rotation::Rot6dColumns, [a, b, c, d, e, f]) => from_columns([*a, *b, *c], [*d, *e, *f]),
        (Rotation::Rot6dInterleaved, [a, d, b, e, c, f]) => from_columns([*a, *b, *c], [*d, *e, *f]),
        (Rotation::Rot6dRows, [a, b, c, d, e, f]) => from_columns([*a, *b, *c], [*d, *e, *f]).map(inverse),
        _ => None,
    }
}

/// The pose in the base frame of the cell, for a pose in the conventions of the model: the inverse of [`model_pose`].
pub(crate) fn cell_pose(pose: &Pose, shift_m: [f64; 3], tool_frame: [f64; 3]) -> Pose {
    let mut position = pose.position;
    position.iter_mut().zip(shift_m).for_each(|(p, s)| *p -= s);
    Pose { position, orientation: product(pose.orientation, inverse(from_euler(tool_frame))) }
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

    /// Every representation returns the rotation that was written.
    #[test]
    fn representations_are_inverted() {
        for q in [[1.0, 0.0, 0.0, 0.0], [0.01, 0.99, -0.1, 0.05], [0.3, -0.5, 0.7, 0.4], [-0.6, 0.1, 0.2, 0.77]] {
            let q = unit(q).unwrap();
            for form in [
                Rotation::AxisAngle,
                Rotation::Euler,
                Rotation::QuaternionXyzw,
                Rotation::QuaternionWxyz,
                Rotation::Rot6dColumns,
                Rotation::Rot6dInterleaved,
                Rotation::Rot6dRows,
            ] {
                let numbers = write(form, q);
                assert_eq!(numbers.len(), form.size());
                let again = read(form, &numbers).unwrap();
                let same: f64 = q.iter().zip(again).map(|(a, b)| a * b).sum();
                assert!((same.abs() - 1.0).abs() < 1e-12, "{form:?}: {q:?} became {again:?}");
            }
        }
        assert_eq!(read(Rotation::QuaternionXyzw, &[0.0; 4]), None);
        assert_eq!(read(Rotation::Rot6dRows, &[1.0, 0.0, 0.0, 2.0, 0.0, 0.0]), None);
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
