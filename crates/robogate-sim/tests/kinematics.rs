//! The Franka's model against the manufacturer's Denavit-Hartenberg table.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use robogate_core::Seed;
use robogate_sim::{Engine, MujocoEngine, ObjectModel, Placement, Scene, SceneParameters, Shape, built_in_robot};

/// Modified (Craig) parameters (a, alpha, d) of joints 1 to 7 and the flange: Franka Control Interface
/// documentation, "Denavit-Hartenberg parameters".
const FRANKA_DH: [(f64, f64, f64); 8] = [
    (0.0, 0.0, 0.333),
    (0.0, -FRAC_PI_2, 0.0),
    (0.0, FRAC_PI_2, 0.316),
    (0.0825, FRAC_PI_2, 0.0),
    (-0.0825, -FRAC_PI_2, 0.384),
    (0.0, FRAC_PI_2, 0.0),
    (0.088, FRAC_PI_2, 0.0),
    (0.0, 0.0, 0.107),
];

/// One row of the table as a matrix product, written out from the definition:
/// T = Rx(alpha) Tx(a) Rz(theta) Tz(d).
fn craig((a, alpha, d): (f64, f64, f64), theta: f64) -> Isometry3<f64> {
    let turn = |axis: &nalgebra::Unit<Vector3<f64>>, angle| {
        Isometry3::from_parts(Translation3::identity(), UnitQuaternion::from_axis_angle(axis, angle))
    };
    turn(&Vector3::x_axis(), alpha)
        * Isometry3::translation(a, 0.0, 0.0)
        * turn(&Vector3::z_axis(), theta)
        * Isometry3::translation(0.0, 0.0, d)
}

fn flange_by_table(q: &[f64]) -> Isometry3<f64> {
    FRANKA_DH
        .iter()
        .zip(q.iter().copied().chain([0.0]))
        .fold(Isometry3::identity(), |frame, (row, theta)| frame * craig(*row, theta))
}

fn assert_same(a: &Isometry3<f64>, b: &Isometry3<f64>) {
    let off = a.inverse() * b;
    assert!(off.translation.vector.norm() < 1e-6, "{} m apart", off.translation.vector.norm());
    assert!(off.rotation.angle() < 1e-6, "{} rad apart", off.rotation.angle());
}

fn engine() -> MujocoEngine {
    MujocoEngine::new(built_in_robot("franka").unwrap(), MujocoEngine::TIME_STEP_S).unwrap()
}

fn random_joints(engine: &MujocoEngine, index: u64) -> Vec<f64> {
    let mut stream = Seed::campaign(11).episode(index).stream("joints");
    engine.chain().joints.iter().map(|joint| stream.between(joint.range[0], joint.range[1])).collect()
}

fn scene() -> Scene {
    let placement = Placement::from_name("center_0").unwrap();
    Scene::new(&SceneParameters::default(), &placement, &mut Seed::campaign(0).stream("obstacles")).unwrap()
}

#[test]
fn chain_and_engine_agree_with_the_manufacturers_table() {
    let mut engine = engine();
    // The hand is turned by -45 degrees about the flange's z, the tool centre point 0.1034 m beyond it.
    let hand = Isometry3::from_parts(
        Translation3::new(0.0, 0.0, 0.1034),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -FRAC_PI_4),
    );
    for index in 0..1000 {
        let q = random_joints(&engine, index);
        let flange = flange_by_table(&q);
        assert_same(&engine.chain().flange_at(&q), &flange);
        assert_same(&engine.chain().tcp_at(&q), &(flange * hand));
        if index < 50 {
            engine.load(&scene(), &q).unwrap();
            assert_same(&engine.tcp(), &(flange * hand));
        }
    }
}

#[test]
fn inverse_kinematics_finds_what_forward_kinematics_reached() {
    let engine = engine();
    let home = &engine.robot().settings.arm.home_rad;
    let mut found = 0;
    for index in 0..500 {
        let mut stream = Seed::campaign(12).episode(index).stream("goal");
        // Tool-down poses over the workspace.
        let at = Translation3::new(stream.between(0.35, 0.6), stream.between(-0.3, 0.4), stream.between(0.02, 0.3));
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), stream.between(-1.0, 1.0));
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let goal = Isometry3::from_parts(at, yaw * down);
        if let Ok(q) = engine.chain().inverse(&goal, home, home) {
            assert_same(&engine.chain().tcp_at(&q), &goal);
            assert!(
                q.iter().zip(&engine.chain().joints).all(|(q, joint)| (joint.range[0]..=joint.range[1]).contains(q))
            );
            found += 1;
        }
    }
    assert_eq!(found, 500);
}

#[test]
fn a_pose_out_of_reach_is_said_to_be() {
    let engine = engine();
    let home = &engine.robot().settings.arm.home_rad;
    let goal = Isometry3::translation(1.2, 0.0, 0.3);
    let unreachable = engine.chain().inverse(&goal, home, home).unwrap_err();
    assert!(unreachable.position_error_m > 0.2, "{unreachable}");
}

/// MuJoCo computes mass properties of homogeneous shapes on its own: ours must be the same.
#[test]
fn mass_properties_agree_with_mujocos_own() {
    use mujoco_rs::prelude::MjModel;
    use robogate_sim::Primitive;
    for shape in Shape::ALL {
        let object = ObjectModel::new(shape, 0.07, 0.6, 0.0);
        let mut geoms = String::new();
        for part in &object.parts {
            let (kind, size) = match part.primitive {
                Primitive::Box { half: [x, y, z] } => ("box", format!("{x} {y} {z}")),
                Primitive::Cylinder { radius, half_height } => ("cylinder", format!("{radius} {half_height}")),
                Primitive::Sphere { radius } => ("sphere", radius.to_string()),
            };
            let (at, turn) = (part.pose.translation, part.pose.rotation);
            geoms += &format!(
                "<geom type='{kind}' size='{size}' pos='{} {} {}' quat='{} {} {} {}'/>",
                at.x, at.y, at.z, turn.w, turn.i, turn.j, turn.k
            );
        }
        let volume: f64 = object.parts.iter().map(|part| part.primitive.volume()).sum();
        let density = object.mass.mass_kg / volume;
        let xml = format!(
            "<mujoco><default><geom density='{density}'/></default><worldbody><body><freejoint/>{geoms}</body></worldbody></mujoco>"
        );
        let model = MjModel::from_xml_string(&xml).unwrap();
        assert!((model.body_mass()[1] - object.mass.mass_kg).abs() < 1e-12);
        let centre = Vector3::from(model.body_ipos()[1]);
        assert!((centre - object.mass.centre).norm() < 1e-12, "{shape:?}");
        let [w, x, y, z] = model.body_iquat()[1];
        let axes = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z)).to_rotation_matrix();
        let principal = Matrix3::from_diagonal(&Vector3::from(model.body_inertia()[1]));
        let inertia = axes * Rotation3::identity() * principal * axes.transpose();
        let scale = object.mass.inertia.amax();
        assert!((inertia - object.mass.inertia).amax() < 1e-9 * scale, "{shape:?}: {inertia} {}", object.mass.inertia);
    }
}
