//! The UR3e, UR5e and UR10e against the manufacturer's tables.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::f64::consts::{FRAC_PI_2, PI};

use mujoco_rs::prelude::*;
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use robogate_core::Seed;

/// One arm's tables: "DH parameters for calculations of kinematics and dynamics".
struct Table {
    name: &'static str,
    model: &'static str,
    a: [f64; 2],
    d: [f64; 4],
    mass: [f64; 6],
    centre: [[f64; 3]; 6],
    /// Of link 2, about its centre of mass.
    inertia: [f64; 3],
}

const TABLES: [Table; 3] = [
    Table {
        name: "ur3e",
        model: include_str!("../../../assets/robots/ur3e/ur3e.xml"),
        a: [-0.24355, -0.2132],
        d: [0.15185, 0.13105, 0.08535, 0.0921],
        mass: [1.98, 3.4445, 1.437, 0.871, 0.805, 0.261],
        centre: [
            [0.0, -0.02, 0.0],
            [0.13, 0.0, 0.1157],
            [0.05, 0.0, 0.0238],
            [0.0, 0.0, 0.01],
            [0.0, 0.0, 0.01],
            [0.0, 0.0, -0.02],
        ],
        inertia: [0.0042623, 0.0460284, 0.0448947],
    },
    Table {
        name: "ur5e",
        model: include_str!("../../../assets/robots/ur5e/ur5e.xml"),
        a: [-0.425, -0.3922],
        d: [0.1625, 0.1333, 0.0997, 0.0996],
        mass: [3.761, 8.058, 2.846, 1.37, 1.3, 0.365],
        centre: [
            [0.0, -0.02561, 0.00193],
            [0.2125, 0.0, 0.11336],
            [0.15, 0.0, 0.0265],
            [0.0, -0.0018, 0.01634],
            [0.0, 0.0018, 0.01634],
            [0.0, 0.0, -0.001159],
        ],
        inertia: [0.0150589, 0.3338809, 0.3324721],
    },
    Table {
        name: "ur10e",
        model: include_str!("../../../assets/robots/ur10e/ur10e.xml"),
        a: [-0.6127, -0.57155],
        d: [0.1807, 0.17415, 0.11985, 0.11655],
        mass: [7.369, 13.051, 3.989, 2.1, 1.98, 0.615],
        centre: [
            [0.021, 0.0, 0.027],
            [0.38, 0.0, 0.158],
            [0.24, 0.0, 0.068],
            [0.0, 0.007, 0.018],
            [0.0, 0.007, 0.018],
            [0.0, 0.0, -0.026],
        ],
        // A solid cylinder of 0.6127 m and 0.075 m radius: m r^2 / 2 along, m (3 r^2 + l^2) / 12 across.
        inertia: [0.036_705_937_5, 0.426_633_155_1, 0.426_633_155_1],
    },
];

const LINKS: [&str; 6] = ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"];
const ELBOW: usize = 2;

/// One row of the standard (Denavit and Hartenberg's) table, written out from the definition:
/// T = Rz(theta) Tz(d) Tx(a) Rx(alpha).
fn standard(theta: f64, d: f64, a: f64, alpha: f64) -> Isometry3<f64> {
    let turn = |axis: &nalgebra::Unit<Vector3<f64>>, angle| {
        Isometry3::from_parts(Translation3::identity(), UnitQuaternion::from_axis_angle(axis, angle))
    };
    turn(&Vector3::z_axis(), theta) * Isometry3::translation(a, 0.0, d) * turn(&Vector3::x_axis(), alpha)
}

/// The flange where the table puts it, the base turned by half a turn as the ROS description has it.
fn flange_by_table(table: &Table, q: &[f64]) -> Isometry3<f64> {
    let [d1, d4, d5, d6] = table.d;
    let d = [d1, 0.0, 0.0, d4, d5, d6];
    let a = [0.0, table.a[0], table.a[1], 0.0, 0.0, 0.0];
    let alpha = [FRAC_PI_2, 0.0, 0.0, FRAC_PI_2, -FRAC_PI_2, 0.0];
    (0..6).fold(standard(PI, 0.0, 0.0, 0.0), |frame, i| frame * standard(q[i], d[i], a[i], alpha[i]))
}

fn site(data: &MjData<Box<MjModel>>, name: &str) -> Isometry3<f64> {
    let id = data.model().name_to_id(MjtObjBase::mjOBJ_SITE, name).unwrap();
    let turn = Rotation3::from_matrix_unchecked(Matrix3::from_row_slice(&data.site_xmat()[id]));
    let at = Translation3::from(Vector3::from(data.site_xpos()[id]));
    Isometry3::from_parts(at, UnitQuaternion::from_rotation_matrix(&turn))
}

fn assert_same(name: &str, a: &Isometry3<f64>, b: &Isometry3<f64>) {
    let off = a.inverse() * b;
    assert!(off.translation.vector.norm() < 1e-6, "{name}: {} m apart", off.translation.vector.norm());
    assert!(off.rotation.angle() < 1e-6, "{name}: {} rad apart", off.rotation.angle());
}

#[test]
fn the_models_stand_where_the_denavit_hartenberg_table_puts_them() {
    for table in &TABLES {
        let mut data = MjData::new(Box::new(MjModel::from_xml_string(table.model).unwrap()));
        for index in 0..1000 {
            let mut stream = Seed::campaign(13).episode(index).stream("joints");
            let q: Vec<f64> = (0..6)
                .map(|joint| if joint == ELBOW { PI } else { 2.0 * PI })
                .map(|limit| stream.between(-limit, limit))
                .collect();
            data.qpos_mut().copy_from_slice(&q);
            data.forward();
            let flange = flange_by_table(table, &q);
            assert_same(table.name, &site(&data, "flange"), &flange);
            assert_same(table.name, &site(&data, "tcp"), &(flange * Isometry3::translation(0.0, 0.0, 0.12)));
        }
    }
}

#[test]
fn the_links_weigh_and_turn_as_the_table_says() {
    for table in &TABLES {
        let model = MjModel::from_xml_string(table.model).unwrap();
        for (i, link) in LINKS.iter().enumerate() {
            let body = model.name_to_id(MjtObjBase::mjOBJ_BODY, link).unwrap();
            assert!((model.body_mass()[body] - table.mass[i]).abs() < 1e-12, "{} {link}", table.name);
            let centre = Vector3::from(model.body_ipos()[body]);
            assert!((centre - Vector3::from(table.centre[i])).norm() < 1e-12, "{} {link}", table.name);
        }
        let body = model.name_to_id(MjtObjBase::mjOBJ_BODY, "upper_arm").unwrap();
        let [w, x, y, z] = model.body_iquat()[body];
        let axes = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z)).to_rotation_matrix();
        let principal = Matrix3::from_diagonal(&Vector3::from(model.body_inertia()[body]));
        let inertia = axes.matrix() * principal * axes.matrix().transpose();
        let expected = Matrix3::from_diagonal(&Vector3::from(table.inertia));
        assert!((inertia - expected).amax() < 1e-9, "{}: {inertia}", table.name);
    }
}

#[test]
fn joints_turn_all_the_way_round_twice_but_the_elbow_once() {
    for table in &TABLES {
        let model = MjModel::from_xml_string(table.model).unwrap();
        for (joint, range) in model.jnt_range().iter().enumerate() {
            let limit = if joint == ELBOW { PI } else { 2.0 * PI };
            assert!((range[0] + limit).abs() < 1e-12 && (range[1] - limit).abs() < 1e-12, "{}: {range:?}", table.name);
        }
    }
}

#[test]
fn at_home_the_tool_points_down_in_front_and_nothing_touches() {
    for table in &TABLES {
        let floor = "<worldbody><geom name=\"table\" type=\"box\" size=\"0.4 0.7 0.02\" pos=\"0.55 0 -0.02\"/>";
        let model = MjModel::from_xml_string(&table.model.replace("<worldbody>", floor)).unwrap();
        let mut data = MjData::new(Box::new(model));
        data.qpos_mut().copy_from_slice(&[0.0, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, -FRAC_PI_2, 0.0]);
        data.forward();
        assert!(data.contact().is_empty(), "{}: {} contacts", table.name, data.contact().len());
        let tcp = site(&data, "tcp");
        assert!((tcp * Vector3::z() + Vector3::z()).norm() < 1e-9, "{}", table.name);
        let at = tcp.translation;
        assert!(at.x > 0.25 && at.y.abs() < 0.2 && at.z > 0.15, "{}: {at}", table.name);
    }
}
