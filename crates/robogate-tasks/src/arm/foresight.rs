//! What the tasks know about an episode before it runs: encoder biases, and the displacement of the tool that they cause.
//!
//! The servo closes its loop on the encoders, so the true joint positions at a planned posture are q - b for the planned q and the
//! biases b. The displacement is the difference of both tool poses in the frame of the planned tool: x across the fingers, y
//! along their closing direction, z out of the tool (down).

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{Better, DrawSpec, FeatureSpec, Measures, Word};
use robogate_physics::{Chain, Gripper, GripperUnit, Robot};

use super::Stage;
use crate::settings::unit_of;

/// Position, then rotation vector of a displacement.
const TOOL: [(&str, &str, &str); 6] = [
    ("offset_x_m", "m", "across the fingers"),
    ("offset_y_m", "m", "along the closing direction of the fingers"),
    ("offset_z_m", "m", "out of the tool, which is down"),
    ("tilt_x_rad", "rad", "about the direction across the fingers"),
    ("tilt_y_rad", "rad", "about the closing direction of the fingers"),
    ("tilt_z_rad", "rad", "about the tool's axis"),
];

/// A posture of the arm in a plan.
#[derive(Debug, Clone)]
pub(crate) struct Posture {
    /// Planned joint positions, in radians.
    joints: Vec<f64>,
    /// Planned pose of the tool in the base frame.
    pub(crate) tool: Isometry3<f64>,
}

impl Posture {
    /// The posture with these joint positions (rad).
    pub(crate) fn new(chain: &Chain, joints: Vec<f64>) -> Self {
        let tool = chain.tcp_at(&joints);
        Self { joints, tool }
    }

    /// The postures in which a plan opens or closes the gripper, and the one at its end.
    pub(crate) fn of_plan(chain: &Chain, stages: &[Stage]) -> Vec<Self> {
        let last = stages.len().saturating_sub(1);
        let stops = stages.iter().enumerate().filter(|(index, stage)| stage.settles || *index == last);
        stops.filter_map(|(_, stage)| Some(Self::new(chain, stage.path.last()?.clone()))).collect()
    }

    /// Pose of the displaced tool in the frame of the planned one, with encoders of these biases (rad).
    pub(crate) fn displacement(&self, chain: &Chain, bias: &[f64]) -> Isometry3<f64> {
        let truly: Vec<f64> = self.joints.iter().zip(bias).map(|(q, bias)| q - bias).collect();
        self.tool.inverse() * chain.tcp_at(&truly)
    }

    /// Compliance of the arm with its own servos at the tool, in m/N.
    pub(crate) fn compliance(&self, robot: &Robot, chain: &Chain) -> Matrix3<f64> {
        compliance(robot, chain, &self.joints, 1.0)
    }
}

/// The compliance of an arm at its tool along the axes of the base frame, in m/N: J diag(1/k) J^T (Whitney 1982). `stiffness` is that
/// of the servos as a multiple of the robot's own.
pub(crate) fn compliance(robot: &Robot, chain: &Chain, joints: &[f64], stiffness: f64) -> Matrix3<f64> {
    const STEP_RAD: f64 = 1e-5;
    let at = chain.tcp_at(joints).translation.vector;
    let of_joint = |j: usize| {
        let mut moved = joints.to_vec();
        moved[j] += STEP_RAD;
        let lever = (chain.tcp_at(&moved).translation.vector - at) / STEP_RAD;
        lever * lever.transpose() / (robot.settings.arm.stiffness_nm_rad[j] * stiffness)
    };
    (0..joints.len()).map(of_joint).sum()
}

/// Displacement of a part in the hand, in the frame of the tool. `tool` is the planned pose of the tool in the grasp, `off` its
/// displacement, and `part` the motion of the part from its nominal to its true pose in the base frame.
///
/// A cup keeps the whole displacement. Fingers centre the part between them and align their pads with its faces, so that only the
/// displacement along the pads and the rotation about the closing direction remain.
pub(crate) fn in_hand(
    tool: &Isometry3<f64>,
    off: &Isometry3<f64>,
    part: &Isometry3<f64>,
    gripper: &Gripper,
) -> Isometry3<f64> {
    let kept = off.inverse() * tool.inverse() * part * tool;
    if matches!(gripper, Gripper::Suction(_)) {
        return kept;
    }
    let [x, _, z] = kept.translation.vector.into();
    let about_y = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, kept.rotation.scaled_axis().y, 0.0));
    Isometry3::from_parts(Translation3::new(x, 0.0, z), about_y)
}

/// A rotation about the vertical (rad) of a part that is equal after a quarter of a turn: from -45 to 45 degrees.
pub(crate) fn within_quarter(yaw: f64) -> f64 {
    const QUARTER: f64 = std::f64::consts::FRAC_PI_2;
    yaw - QUARTER * (yaw / QUARTER).round()
}

/// A draw. `None` if the name is not a valid word.
pub(crate) fn draw(name: &str, unit: &str, meaning: impl Into<String>) -> Option<DrawSpec> {
    Word::new(name).ok().map(|name| DrawSpec { name, unit: unit.to_owned(), meaning: meaning.into() })
}

/// The bias of each encoder of an arm with this number of joints.
pub(crate) fn bias_draws(joints: usize) -> impl Iterator<Item = DrawSpec> {
    (1..=joints).filter_map(|joint| {
        let meaning = format!("Encoder bias of joint {joint}: measured minus true position.");
        draw(&format!("encoder_bias_{joint}_rad"), "rad", meaning)
    })
}

/// The components of a displacement of the tool, in the order of [`components`]. `place` says where the tool is: "the planned grasp".
pub(crate) fn tool_draws(prefix: &str, place: &str) -> Vec<DrawSpec> {
    let one = |(name, unit, direction): &(&str, &str, &str)| {
        let meaning = format!("Displacement of the tool by the encoder biases at {place}, {direction}.");
        draw(&format!("{prefix}_{name}"), unit, meaning)
    };
    TOOL.iter().filter_map(one).collect()
}

/// Position (m) and rotation vector (rad) of a displacement. Six times `None` without a displacement.
pub(crate) fn components(displacement: Option<&Isometry3<f64>>) -> [Option<f64>; 6] {
    let mut six = [None; 6];
    if let Some(off) = displacement {
        let tilt = off.rotation.scaled_axis();
        let values = off.translation.vector.iter().chain(tilt.iter());
        six.iter_mut().zip(values).for_each(|(to, value)| *to = Some(*value));
    }
    six
}

/// The values of draws, in the order of their names. Adding 0 turns a negative zero into zero.
pub(crate) fn drawn(specs: &[DrawSpec], values: impl IntoIterator<Item = Option<f64>>) -> Measures {
    specs.iter().map(|spec| spec.name).zip(values.into_iter().map(|value| value.map(|x| x + 0.0))).collect()
}

/// A feature, whose name ends with its unit.
pub(crate) const fn feature(name: &'static str, better: Better, meaning: &'static str) -> FeatureSpec {
    FeatureSpec { name, unit: unit_of(name), meaning, better }
}

/// The features of a task, then those of its gripper.
pub(crate) const fn joined<const A: usize, const B: usize, const N: usize>(
    task: &[FeatureSpec; A],
    gripper: &[FeatureSpec; B],
) -> [FeatureSpec; N] {
    let mut all = [const { feature("", Better::Neither, "") }; N];
    let mut i = 0;
    while i < N {
        let FeatureSpec { name, better, meaning, .. } = if i < A { &task[i] } else { &gripper[i - A] };
        all[i] = feature(name, *better, meaning);
        i += 1;
    }
    all
}

/// Features of a grasp that every task has.
pub(crate) const OPENING_CLEARANCE: FeatureSpec = feature(
    "opening_clearance_m",
    Better::Higher,
    "Smallest free space on the tighter side of a part between the open fingers.",
);
pub(crate) const LIP_MARGIN: FeatureSpec =
    feature("lip_margin_m", Better::Higher, "Smallest distance from the lip of the cup to the nearer edge of a part.");
pub(crate) const GAP_MARGIN: FeatureSpec =
    feature("gap_margin_m", Better::Higher, "Grip threshold minus the largest gap between the lip and a part.");
pub(crate) const PRESS_MARGIN: FeatureSpec =
    feature("press_margin_m", Better::Higher, "Smallest gap between the lip and a part.");

/// The largest force with which a gripper holds a part against its weight, in newtons: the friction of two pads with this coefficient,
/// or the suction of a cup, with the deviations of this unit.
pub(crate) fn holding_n(gripper: &Gripper, friction: f64, grip_force_n: f64, unit: &GripperUnit) -> f64 {
    match gripper {
        Gripper::ParallelJaw(_) => 2.0 * (friction * unit.pad_friction_scale) * (grip_force_n * unit.force_scale),
        Gripper::Suction(cup) => cup.force_n() * unit.force_scale,
    }
}

/// The logarithm of a ratio of positive numbers, within bounds.
pub(crate) fn log_ratio(a: f64, b: f64) -> f64 {
    (a.max(1e-9) / b.max(1e-9)).ln().clamp(-6.0, 8.0)
}

/// Values of a function, each computed once.
#[derive(Debug)]
pub(crate) struct Memo<K, V>(Mutex<BTreeMap<K, V>>);

impl<K: Ord, V: Clone> Memo<K, V> {
    /// Maximum number of values that are kept.
    const MOST: usize = 4096;

    pub(crate) fn new() -> Self {
        Self(Mutex::new(BTreeMap::new()))
    }

    /// The value of the function at `key`.
    pub(crate) fn get(&self, key: K, compute: impl FnOnce() -> V) -> V {
        let lock = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let known = lock().get(&key).cloned();
        known.unwrap_or_else(|| {
            let found = compute();
            let mut values = lock();
            if values.len() < Self::MOST {
                values.insert(key, found.clone());
            }
            found
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::tool_down;
    use robogate_physics::built_in_robot;
    use std::f64::consts::FRAC_PI_2;

    /// A part that lies beside its nominal place is centred along the closing direction (base y at yaw 0) only.
    #[test]
    fn fingers_centre_a_part_and_a_cup_does_not() {
        let tool = tool_down([0.4, 0.1, 0.2], 0.0);
        let part = Isometry3::translation(0.003, 0.002, 0.0);
        let none = Isometry3::identity();
        let gripper = |robot: &str| built_in_robot(robot).unwrap().settings.gripper;
        let (fingers, cup) = (gripper("franka"), gripper("ur5e"));
        let at = |held: Isometry3<f64>| {
            let moved = tool * held * tool.inverse();
            let off = moved * nalgebra::Point3::from(tool.translation.vector)
                - nalgebra::Point3::from(tool.translation.vector);
            [off.x, off.y]
        };
        let close = |a: [f64; 2], b: [f64; 2]| assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 1e-12, "{a:?} {b:?}");
        close(at(in_hand(&tool, &none, &part, &cup)), [0.003, 0.002]);
        close(at(in_hand(&tool, &none, &part, &fingers)), [0.003, 0.0]);
        // A tool that is displaced with the part holds it as planned.
        let off = tool.inverse() * part * tool;
        close(at(in_hand(&tool, &off, &part, &cup)), [0.0, 0.0]);
    }

    #[test]
    fn quarters_of_a_turn_are_equal() {
        for (yaw, expected) in
            [(0.1, 0.1), (FRAC_PI_2 + 0.1, 0.1), (-FRAC_PI_2 - 0.1, -0.1), (3.0, 3.0 - 2.0 * FRAC_PI_2)]
        {
            assert!((within_quarter(yaw) - expected).abs() < 1e-12, "{yaw}");
        }
    }

    #[test]
    fn values_are_computed_once() {
        let memo = Memo::new();
        assert_eq!(memo.get(1, || "first"), "first");
        assert_eq!(memo.get(1, || "second"), "first");
        assert_eq!(memo.get(2, || "third"), "third");
    }
}
