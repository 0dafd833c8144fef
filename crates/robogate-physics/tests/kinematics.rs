//! Tests of inverse kinematics, and of mass properties against MuJoCo.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use robogate_core::Seed;
use robogate_physics::{Engine, MassProperties, MujocoEngine, Part, Primitive, built_in_robot, load_mujoco};

fn assert_same(a: &Isometry3<f64>, b: &Isometry3<f64>) {
    let off = a.inverse() * b;
    assert!(off.translation.vector.norm() < 1e-6, "{} m apart", off.translation.vector.norm());
    assert!(off.rotation.angle() < 1e-6, "{} rad apart", off.rotation.angle());
}

fn engine() -> MujocoEngine {
    MujocoEngine::new(built_in_robot("franka").unwrap(), MujocoEngine::TIME_STEP_S).unwrap()
}

#[test]
fn inverse_kinematics_inverts_forward() {
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
fn unreachable_pose_is_an_error() {
    let engine = engine();
    let home = &engine.robot().settings.arm.home_rad;
    let goal = Isometry3::translation(1.2, 0.0, 0.3);
    let unreachable = engine.chain().inverse(&goal, home, home).unwrap_err();
    assert!(unreachable.position_error_m > 0.2, "{unreachable}");
}

/// Bodies with one part, and with several parts that do not overlap.
fn bodies() -> Vec<Vec<Part>> {
    let part = |primitive: &Primitive, x: f64, z: f64, yaw: f64| Part {
        primitive: primitive.clone(),
        pose: Isometry3::new(Vector3::new(x, 0.0, z), Vector3::new(0.0, 0.0, yaw)),
    };
    let (cuboid, ball) = (Primitive::Box { half: [0.03, 0.02, 0.01] }, Primitive::Sphere { radius: 0.02 });
    let cylinder = Primitive::Cylinder { radius: 0.02, half_height: 0.03 };
    vec![
        vec![part(&cuboid, 0.0, 0.0, 0.0)],
        vec![part(&cylinder, 0.0, 0.0, 0.0)],
        vec![part(&ball, 0.0, 0.0, 0.0)],
        vec![part(&cuboid, 0.0, -0.01, 0.0), part(&cuboid, 0.01, 0.01, 0.26), part(&ball, 0.06, 0.0, 0.0)],
    ]
}

#[test]
fn mass_properties_match_mujoco() {
    use mujoco_rs::prelude::MjModel;
    for parts in bodies() {
        let mass = MassProperties::homogeneous(&parts, 0.6);
        let mut geoms = String::new();
        for part in &parts {
            let (kind, size) = match part.primitive {
                Primitive::Box { half: [x, y, z] } => ("box", format!("{x} {y} {z}")),
                Primitive::Cylinder { radius, half_height } => ("cylinder", format!("{radius} {half_height}")),
                Primitive::Sphere { radius } => ("sphere", radius.to_string()),
                Primitive::Hull(_) => panic!("tests/meshes.rs tests pieces of meshes"),
            };
            let (at, turn) = (part.pose.translation, part.pose.rotation);
            geoms += &format!(
                "<geom type='{kind}' size='{size}' pos='{} {} {}' quat='{} {} {} {}'/>",
                at.x, at.y, at.z, turn.w, turn.i, turn.j, turn.k
            );
        }
        let volume: f64 = parts.iter().map(|part| part.primitive.volume()).sum();
        let density = mass.mass_kg / volume;
        let xml = format!(
            "<mujoco><default><geom density='{density}'/></default><worldbody><body><freejoint/>{geoms}</body></worldbody></mujoco>"
        );
        load_mujoco().unwrap();
        let model = MjModel::from_xml_string(&xml).unwrap();
        assert!((model.body_mass()[1] - mass.mass_kg).abs() < 1e-12);
        let centre = Vector3::from(model.body_ipos()[1]);
        assert!((centre - mass.centre).norm() < 1e-12, "{parts:?}");
        let [w, x, y, z] = model.body_iquat()[1];
        let axes = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z)).to_rotation_matrix();
        let principal = Matrix3::from_diagonal(&Vector3::from(model.body_inertia()[1]));
        let inertia = axes * Rotation3::identity() * principal * axes.transpose();
        let scale = mass.inertia.amax();
        assert!((inertia - mass.inertia).amax() < 1e-9 * scale, "{parts:?}: {inertia} {}", mass.inertia);
    }
}
