//! Compares the UR3e, UR5e and UR10e with the manufacturer's tables.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::f64::consts::{FRAC_PI_2, PI};

use mujoco_rs::prelude::*;
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use robogate_core::Seed;
use robogate_physics::{Chain, ChainJoint, load_mujoco};

/// The table of one arm: "DH parameters for calculations of kinematics and dynamics".
struct Table {
    name: &'static str,
    model: &'static str,
    a: [f64; 2],
    d: [f64; 4],
    mass: [f64; 6],
    centre: [[f64; 3]; 6],
    /// Inertia of link 2 about its centre of mass.
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
/// Distance from flange to lip, in metres.
const TOOL_M: f64 = 0.12;
const HOME: [f64; 6] = [0.0, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, -FRAC_PI_2, 0.0];

/// One row of the standard Denavit-Hartenberg table: T = Rz(theta) Tz(d) Tx(a) Rx(alpha).
fn standard(theta: f64, d: f64, a: f64, alpha: f64) -> Isometry3<f64> {
    let rotation = |axis: &nalgebra::Unit<Vector3<f64>>, angle| {
        Isometry3::from_parts(Translation3::identity(), UnitQuaternion::from_axis_angle(axis, angle))
    };
    rotation(&Vector3::z_axis(), theta) * Isometry3::translation(a, 0.0, d) * rotation(&Vector3::x_axis(), alpha)
}

/// The rows (d, a, alpha) of joints 1 to 6.
fn rows(table: &Table) -> [(f64, f64, f64); 6] {
    let [d1, d4, d5, d6] = table.d;
    let [a2, a3] = table.a;
    [(d1, 0.0, FRAC_PI_2), (0.0, a2, 0.0), (0.0, a3, 0.0), (d4, 0.0, FRAC_PI_2), (d5, 0.0, -FRAC_PI_2), (d6, 0.0, 0.0)]
}

/// The frames of links 1 to 6 from the table, with the base rotated by half a turn as in the ROS description. The last
/// frame is the flange.
fn frames_by_table(table: &Table, q: &[f64]) -> Vec<Isometry3<f64>> {
    let mut frame = standard(PI, 0.0, 0.0, 0.0);
    let link = |((d, a, alpha), theta): ((f64, f64, f64), &f64)| {
        frame *= standard(*theta, d, a, alpha);
        frame
    };
    rows(table).into_iter().zip(q).map(link).collect()
}

/// The arm as a chain, computed only from the table.
fn chain(table: &Table) -> Chain {
    let mut placement = standard(PI, 0.0, 0.0, 0.0);
    let joints = rows(table).into_iter().enumerate().map(|(i, (d, a, alpha))| {
        let limit = if i == ELBOW { PI } else { 2.0 * PI };
        let joint = ChainJoint { placement, axis: Vector3::z_axis(), range: [-limit, limit] };
        placement = standard(0.0, d, a, alpha);
        joint
    });
    let joints = joints.collect();
    Chain { joints, flange: placement, tcp: placement * Isometry3::translation(0.0, 0.0, TOOL_M) }
}

fn model(xml: &str) -> MjModel {
    load_mujoco().unwrap();
    MjModel::from_xml_string(xml).unwrap()
}

fn site(data: &MjData<Box<MjModel>>, name: &str) -> Isometry3<f64> {
    let id = data.model().name_to_id(MjtObjBase::mjOBJ_SITE, name).unwrap();
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_row_slice(&data.site_xmat()[id]));
    let at = Translation3::from(Vector3::from(data.site_xpos()[id]));
    Isometry3::from_parts(at, UnitQuaternion::from_rotation_matrix(&rotation))
}

fn assert_same(name: &str, a: &Isometry3<f64>, b: &Isometry3<f64>) {
    let off = a.inverse() * b;
    assert!(off.translation.vector.norm() < 1e-6, "{name}: {} m apart", off.translation.vector.norm());
    assert!(off.rotation.angle() < 1e-6, "{name}: {} rad apart", off.rotation.angle());
}

#[test]
fn kinematics_match_dh_table() {
    for table in &TABLES {
        let mut data = MjData::new(Box::new(model(table.model)));
        for index in 0..1000 {
            let mut stream = Seed::campaign(13).episode(index).stream("joints");
            let q: Vec<f64> = (0..6)
                .map(|joint| if joint == ELBOW { PI } else { 2.0 * PI })
                .map(|limit| stream.between(-limit, limit))
                .collect();
            data.qpos_mut().copy_from_slice(&q);
            data.forward();
            let flange = frames_by_table(table, &q)[5];
            assert_same(table.name, &site(&data, "flange"), &flange);
            assert_same(table.name, &site(&data, "tcp"), &(flange * Isometry3::translation(0.0, 0.0, TOOL_M)));
        }
    }
}

#[test]
fn masses_and_inertias_match_table() {
    for table in &TABLES {
        let model = model(table.model);
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
fn joint_ranges_match_data_sheet() {
    for table in &TABLES {
        let model = model(table.model);
        for (joint, range) in model.jnt_range().iter().enumerate() {
            let limit = if joint == ELBOW { PI } else { 2.0 * PI };
            assert!((range[0] + limit).abs() < 1e-12 && (range[1] - limit).abs() < 1e-12, "{}: {range:?}", table.name);
        }
    }
}

#[test]
fn home_pose_is_free() {
    for table in &TABLES {
        let floor = "<worldbody><geom name=\"table\" type=\"box\" size=\"0.4 0.7 0.02\" pos=\"0.55 0 -0.02\"/>";
        let model = model(&table.model.replace("<worldbody>", floor));
        let mut data = MjData::new(Box::new(model));
        data.qpos_mut().copy_from_slice(&HOME);
        data.forward();
        assert!(data.contact().is_empty(), "{}: {} contacts", table.name, data.contact().len());
        let tcp = site(&data, "tcp");
        assert!((tcp * Vector3::z() + Vector3::z()).norm() < 1e-9, "{}", table.name);
        let at = tcp.translation;
        assert!(at.x > 0.25 && at.y.abs() < 0.2 && at.z > 0.15, "{}: {at}", table.name);
    }
}

/// The stretch of the arm with the tool down at this point, as a fraction of the length of upper arm and forearm. The
/// arm's plane passes the base's axis at the distance d4. The wrist's centre is d5 nearer to the base than the tool and
/// d6 above the flange.
fn stretch(table: &Table, at: &Vector3<f64>) -> f64 {
    let [d1, d4, d5, d6] = table.d;
    let along = (at.x * at.x + at.y * at.y - d4 * d4).sqrt() - d5;
    along.hypot(at.z + TOOL_M + d6 - d1) / (table.a[0].abs() + table.a[1].abs())
}

/// The tool at this point, pointing down, rotated by `yaw` from its orientation at home.
fn down(chain: &Chain, at: &Vector3<f64>, yaw: f64) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
    Isometry3::from_parts(Translation3::from(*at), rotation * chain.tcp_at(&HOME).rotation)
}

/// The grid of tool positions: 5 cm apart across the table and over it.
fn grid() -> impl Iterator<Item = (i32, i32, i32)> {
    (5..18).flat_map(|x| (-8..10).flat_map(move |y| (0..6).map(move |z| (x, y, z))))
}

fn point((x, y, z): (i32, i32, i32)) -> Vector3<f64> {
    Vector3::new(0.05 * f64::from(x), 0.05 * f64::from(y), 0.02 + 0.05 * f64::from(z))
}

#[test]
fn workspace_matches_link_lengths() {
    for table in &TABLES {
        let chain = chain(table);
        for cell in grid() {
            let at = point(cell);
            for yaw in [-2.0, 0.0, 3.0] {
                let goal = down(&chain, &at, yaw);
                let found = chain.reach(&goal, &HOME);
                let stretch = stretch(table, &at);
                if stretch > 1.001 {
                    assert!(found.is_err(), "{} reaches {at} at {stretch}", table.name);
                } else if stretch < 0.999 {
                    let q = found.unwrap();
                    assert_same(table.name, &chain.tcp_at(&q), &goal);
                    for (i, (q, joint)) in q.iter().zip(&chain.joints).enumerate() {
                        assert!((joint.range[0]..=joint.range[1]).contains(q));
                        assert!((q - HOME[i]).abs() < PI + 1e-6, "{} turns joint {i} to {q} at {at}", table.name);
                    }
                    let frames = frames_by_table(table, &q);
                    let [shoulder, elbow, wrist] = [0, 1, 2].map(|i| frames[i].translation.z);
                    // Height of the elbow relative to the middle of the line from shoulder to wrist.
                    assert!(elbow > 0.5 * (shoulder + wrist), "{}: elbow down at {at}: {q:?}", table.name);
                    assert!((q[4] - HOME[4]).abs() < 1e-4, "{}: the wrist is turned over at {at}: {q:?}", table.name);
                }
            }
        }
    }
}

#[test]
fn postures_are_continuous() {
    for table in &TABLES {
        let chain = chain(table);
        let posture = |cell| {
            let at = point(cell);
            (stretch(table, &at) < 0.98).then(|| chain.reach(&down(&chain, &at, 0.0), &HOME).unwrap())
        };
        let mut widest: f64 = 0.0;
        for (x, y, z) in grid() {
            let Some(q) = posture((x, y, z)) else { continue };
            for other in [(x + 1, y, z), (x, y + 1, z), (x, y, z + 1)] {
                let Some(near) = posture(other) else { continue };
                widest = q.iter().zip(near).map(|(a, b)| (a - b).abs()).fold(widest, f64::max);
            }
        }
        // A different posture is more than a quarter turn away.
        assert!(widest < 0.8, "{}: a joint jumps by {widest} rad over 5 cm", table.name);
    }
}

#[test]
fn out_of_reach_is_an_error() {
    for table in &TABLES {
        let chain = chain(table);
        for step in 0..50 {
            let at = Vector3::new(1.35 + 0.05 * f64::from(step), 0.1, 0.3);
            let unreachable = chain.reach(&down(&chain, &at, 0.0), &HOME).unwrap_err();
            assert!(unreachable.position_error_m > 0.02 || unreachable.angle_error_rad > 0.02, "{unreachable}");
        }
    }
}

/// Unimation's Puma 560, an arm with a spherical wrist, unlike the three above. Parameters as in Corke, "Robotics,
/// Vision and Control".
fn puma() -> (Chain, [f64; 6]) {
    let rows = [
        (0.0, 0.0, FRAC_PI_2),
        (0.0, 0.4318, 0.0),
        (0.15005, 0.0203, -FRAC_PI_2),
        (0.4318, 0.0, FRAC_PI_2),
        (0.0, 0.0, -FRAC_PI_2),
        (0.0, 0.0, 0.0),
    ];
    let mut placement = Isometry3::translation(0.0, 0.0, 0.672);
    let joints = rows.into_iter().map(|(d, a, alpha)| {
        let joint = ChainJoint { placement, axis: Vector3::z_axis(), range: [-4.6, 4.6] };
        placement = standard(0.0, d, a, alpha);
        joint
    });
    let joints = joints.collect();
    (
        Chain { joints, flange: placement, tcp: placement * Isometry3::translation(0.0, 0.0, 0.2) },
        [0.0, 0.8, -2.4, 0.0, 1.2, 0.0],
    )
}

#[test]
fn posture_is_near_home() {
    let arms = TABLES.iter().map(|table| (table.name, chain(table), HOME)).chain([("puma", puma().0, puma().1)]);
    for (name, chain, home) in arms {
        let n = 400;
        let mut farther = 0;
        for index in 0..n {
            let mut stream = Seed::campaign(14).episode(index).stream("joints");
            let known: Vec<f64> = home.iter().map(|home| home + stream.between(-1.5, 1.5)).collect();
            let goal = chain.tcp_at(&known);
            let q = chain.reach(&goal, &home).unwrap();
            assert_same(name, &chain.tcp_at(&q), &goal);
            let turns = |q: &[f64]| (1..5).map(|i| (q[i] - home[i]).abs()).collect::<Vec<_>>();
            let sum = |q: &[f64]| turns(q).iter().map(|turn| turn * turn).sum::<f64>();
            let near = turns(&q).iter().all(|turn| *turn < FRAC_PI_2);
            // The first and the last joint have a weight of 0.1.
            farther += u64::from(!near && sum(&q) > sum(&known) + 0.1 * 2.0 * PI * PI);
        }
        assert!(100 * farther <= 3 * n, "{name}: {farther} of {n} farther");
    }
}
