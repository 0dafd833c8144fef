//! Meshes as bodies: what is read and refused, mass properties against formulas, and the behaviour of their pieces in the engines.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use nalgebra::{Isometry3, Matrix3, UnitQuaternion, Vector3};
use robogate_physics::{
    Engine, Fixture, FixtureKind, GRAVITY, GripperUnit, JointTargets, MassProperties, Mesh, MujocoEngine, Object, Part,
    Pieces, Primitive, RapierEngine, Scene, Triangles, Visual, built_in_robot,
};

/// A prism along y over an outline that is counter-clockwise seen along y: x and z in millimetres.
fn prism(outline: &[[f64; 2]], depth: f64) -> String {
    let n = outline.len();
    let ring = |y: f64| outline.iter().map(move |[x, z]| format!("v {x} {y} {z}\n"));
    let mut text: String = ring(-0.5 * depth).chain(ring(0.5 * depth)).collect();
    let face =
        |corners: Vec<usize>| corners.iter().fold("f".to_owned(), |text, corner| format!("{text} {corner}")) + "\n";
    text += &face((1..=n).collect());
    text += &face((n + 1..=2 * n).rev().collect());
    text.extend((0..n).map(|i| face(vec![i + 1, n + i + 1, n + (i + 1) % n + 1, (i + 1) % n + 1])));
    text
}

fn rectangle([x, z]: [f64; 2]) -> [[f64; 2]; 4] {
    [[-0.5 * x, -0.5 * z], [0.5 * x, -0.5 * z], [0.5 * x, 0.5 * z], [-0.5 * x, 0.5 * z]]
}

const L: [[f64; 2]; 6] = [[0.0, 0.0], [60.0, 0.0], [60.0, 20.0], [20.0, 20.0], [20.0, 80.0], [0.0, 80.0]];

/// An arch on two legs, which fits over a pipe of 32 mm. Its origin is in the middle of its underside.
fn arch() -> Vec<[f64; 2]> {
    let inner = (0..=12).map(|k| (f64::from(k) * std::f64::consts::PI / 12.0).sin_cos());
    let inner = inner.map(|(sin, cos)| [-20.0 * cos, 20.0 + 20.0 * sin]);
    let mut outline = vec![[-40.0, 0.0], [-20.0, 0.0]];
    outline.extend(inner);
    outline.extend([[20.0, 0.0], [40.0, 0.0], [40.0, 50.0], [-40.0, 50.0]]);
    outline
}

fn solid(text: &str, unit_m: f64) -> Result<Mesh, String> {
    Mesh::new(&Triangles::read(text.as_bytes(), 10_000).unwrap(), unit_m)
}

fn mesh(text: &str) -> Mesh {
    solid(text, 1e-3).unwrap()
}

fn cuboid(half: [f64; 3], at: [f64; 3]) -> Part {
    Part { primitive: Primitive::Box { half }, pose: Isometry3::translation(at[0], at[1], at[2]) }
}

fn assert_near(one: &Matrix3<f64>, other: &Matrix3<f64>) {
    assert!((one - other).norm() < 1e-6 * other.norm(), "{one} {other}");
}

#[test]
fn mass_properties_are_those_of_solids() {
    let block = mesh(&prism(&rectangle([60.0, 40.0]), 50.0));
    let (x, y, z) = (0.06_f64, 0.05_f64, 0.04_f64);
    assert!((block.bulk().volume_m3 - x * y * z).abs() < 1e-15);
    let [x2, y2, z2] = [x * x, y * y, z * z];
    let expected = Matrix3::from_diagonal(&Vector3::new(y2 + z2, x2 + z2, x2 + y2)) / 12.0;
    assert_near(&block.bulk().inertia_m2, &expected);
    // An L of two boxes, turned in its body.
    let angle = mesh(&prism(&L, 30.0));
    let boxes = [cuboid([0.03, 0.015, 0.01], [0.03, 0.0, 0.01]), cuboid([0.01, 0.015, 0.03], [0.01, 0.0, 0.05])];
    let turn = Isometry3::new(Vector3::new(0.1, 0.2, 0.3), Vector3::new(0.4, -0.3, 0.2));
    let turned = |parts: &[Part]| -> Vec<Part> {
        parts.iter().map(|part| Part { pose: turn * part.pose, ..part.clone() }).collect()
    };
    let pieces = Pieces::of(&angle, 16).unwrap();
    let [found, wanted] = [&pieces.parts[..], &boxes].map(|parts| MassProperties::homogeneous(&turned(parts), 0.7));
    assert!((found.centre - wanted.centre).norm() < 1e-9, "{} {}", found.centre, wanted.centre);
    assert_near(&found.inertia, &wanted.inertia);
}

#[test]
fn pieces_fill_the_solid() {
    // A prism with a notch is divided without an error.
    let angle = Pieces::of(&mesh(&prism(&L, 30.0)), 16).unwrap();
    assert_eq!(angle.parts.len(), 2);
    assert!((angle.volume - 1.0).abs() < 1e-9 && angle.distance_m < 1e-6, "{angle:?}");
    // Convex surfaces are pieces as they are, also where they touch.
    let stacked = prism(&rectangle([60.0, 40.0]), 50.0)
        + &prism(&rectangle([20.0, 20.0]).map(|[x, z]| [x, z + 30.0]), 50.0)
            .lines()
            .map(|line| match line.strip_prefix("f ") {
                Some(corners) => corners
                    .split(' ')
                    .fold("f".to_owned(), |text, corner| format!("{text} {}", corner.parse::<usize>().unwrap() + 8)),
                None => line.to_owned(),
            })
            .collect::<Vec<_>>()
            .join("\n");
    let stacked = Pieces::of(&mesh(&stacked), 16).unwrap();
    assert_eq!((stacked.parts.len(), stacked.distance_m < 1e-9), (2, true), "{stacked:?}");
    // Bodies that share an edge are a closed surface, of which no half of an edge belongs to one triangle.
    let touching = "v 0 0 0\nv 10 0 0\nv 0 10 0\nv 0 0 10\nv 0 -10 0\nv -10 0 0\n".to_owned()
        + "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\nf 1 5 6\nf 1 6 4\nf 6 5 4\nf 1 4 5\n";
    let touching = Pieces::of(&mesh(&touching), 16).unwrap();
    assert!((1..=2).contains(&touching.parts.len()) && touching.distance_m < 1e-3, "{touching:?}");
    // The error of an arch falls with the number of pieces, and one piece is the hull.
    let arch = mesh(&prism(&arch(), 30.0));
    let [hull, few, many] = [1, 4, 16].map(|most| Pieces::of(&arch, most).unwrap());
    assert_eq!([hull.parts.len(), few.parts.len()], [1, 4]);
    assert!(many.parts.len() <= 16);
    assert!(hull.distance_m > 0.019 && many.distance_m < few.distance_m && many.distance_m < 1e-3, "{many:?}");
    assert!(many.volume > 0.999 && many.volume < 1.02, "{}", many.volume);
}

/// The corners of pieces are the same on every machine: evidence is recomputed elsewhere.
#[test]
fn pieces_do_not_depend_on_the_machine() {
    let pieces = Pieces::of(&mesh(&prism(&arch(), 30.0)), 16).unwrap();
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for part in &pieces.parts {
        let Primitive::Hull(hull) = &part.primitive else { panic!("{part:?}") };
        for x in hull.corners().iter().flat_map(|corner| corner.iter()) {
            // In nanometres: the outline of this test is from functions that differ between machines.
            hash = (hash ^ (x * 1e9).round() as i64 as u64).wrapping_mul(0x0100_0000_01b3);
        }
    }
    assert_eq!(hash, 17_383_400_005_052_312_642);
}

#[test]
fn shapes_that_are_no_solids_are_refused() {
    let block = prism(&rectangle([60.0, 40.0]), 50.0);
    let without_last = block.lines().take(13).collect::<Vec<_>>().join("\n");
    let flipped = block.replacen("f 1 2 3 4", "f 4 3 2 1", 1);
    let flat = prism(&rectangle([60.0, 1e-6]), 50.0);
    let inner = prism(&rectangle([20.0, 20.0]), 20.0);
    let cavity = block.clone()
        + &inner
            .lines()
            .map(|line| match line.strip_prefix("f ") {
                Some(corners) => corners
                    .split(' ')
                    .rev()
                    .fold("f".to_owned(), |text, corner| format!("{text} {}", corner.parse::<usize>().unwrap() + 8)),
                None => line.to_owned(),
            })
            .collect::<Vec<_>>()
            .join("\n");
    for (text, unit_m, message) in [
        (without_last.as_str(), 1e-3, "not closed: 4 edges do not join two triangles"),
        (&flipped, 1e-3, "not closed: 4 edges"),
        (&flat, 1e-3, "it has no volume"),
        (&cavity, 1e-3, "faces inwards and others face outwards"),
        (&block, 1.0, "its largest extent is 60.000 m. Is the file in mm? Then write `unit = \"mm\"`"),
        (&block, 1e-6, "Is the file in mm?"),
        ("v 0 0 0\n", 1.0, "it has vertices but no faces"),
    ] {
        let found = solid(text, unit_m).unwrap_err();
        assert!(found.contains(message), "{found}");
    }
    // A surface that faces inwards as a whole is turned.
    let inside_out: String = block
        .lines()
        .map(|line| match line.strip_prefix("f ") {
            Some(corners) => corners.split(' ').rev().fold("f".to_owned(), |text, of| format!("{text} {of}")) + "\n",
            None => line.to_owned() + "\n",
        })
        .collect();
    assert!((mesh(&inside_out).bulk().volume_m3 - mesh(&block).bulk().volume_m3).abs() < 1e-15);
}

/// A scene with an object far from the robot's posture.
fn scene(parts: Vec<Part>, pose: Isometry3<f64>, fixtures: Vec<Part>) -> Scene {
    let fixture = |(index, part)| Fixture {
        name: format!("fixture{index}"),
        kind: FixtureKind::Receptacle,
        part,
        motion: None,
        friction: None,
        color: None,
    };
    Scene {
        object: Object { mass: MassProperties::homogeneous(&parts, 0.3), parts, joint: None, friction: None },
        object_pose: pose,
        others: Vec::new(),
        friction: 0.6,
        table_friction: None,
        arm_stiffness: 1.0,
        gripper: GripperUnit::default(),
        fixtures: std::iter::once(Fixture::table()).chain(fixtures.into_iter().enumerate().map(fixture)).collect(),
        gravity: GRAVITY,
        marker: None,
        visual: Visual::default(),
    }
}

fn engines() -> [Box<dyn Engine>; 2] {
    let robot = || built_in_robot("franka").unwrap();
    [
        Box::new(MujocoEngine::new(robot(), MujocoEngine::TIME_STEP_S).unwrap()),
        Box::new(RapierEngine::new(robot(), RapierEngine::TIME_STEP_S).unwrap()),
    ]
}

/// The pose of the object after some seconds.
fn after(engine: &mut dyn Engine, scene: &Scene, seconds: f64) -> Isometry3<f64> {
    let home = engine.robot().settings.arm.home_rad.clone();
    engine.load(scene, &home).unwrap();
    let targets = JointTargets { velocities: vec![0.0; home.len()], positions: home, finger: 0.04 };
    for _ in 0..(seconds / engine.time_step()) as usize {
        engine.advance(&targets);
    }
    engine.health().unwrap();
    engine.object()
}

#[test]
fn mesh_box_behaves_like_a_box() {
    let pieces = Pieces::of(&mesh(&prism(&rectangle([60.0, 40.0]), 50.0)), 16).unwrap();
    let turn = UnitQuaternion::from_euler_angles(0.15, -0.1, 0.3);
    let pose = Isometry3::from_parts(nalgebra::Translation3::new(0.5, 0.3, 0.06), turn);
    for mut engine in engines() {
        let of_mesh = after(&mut *engine, &scene(pieces.parts.clone(), pose, Vec::new()), 1.5);
        let read = engine.read_back().unwrap();
        assert!((read.mass_kg - 0.3).abs() < 1e-12 && read.centre_of_mass.norm() < 1e-9, "{read:?}");
        let cuboid = vec![cuboid([0.03, 0.025, 0.02], [0.0; 3])];
        let of_box = after(&mut *engine, &scene(cuboid, pose, Vec::new()), 1.5);
        let (off, turned) = (of_mesh.inverse() * of_box, of_mesh.rotation.angle_to(&of_box.rotation));
        let name = engine.build().name;
        println!("{name}: {:.2} mm, {turned:.4} rad apart", 1e3 * off.translation.vector.norm());
        assert!((of_mesh.translation.z - 0.02).abs() < 5e-4, "{name}: {of_mesh}");
        assert!(off.translation.vector.norm() < 3e-3 && turned < 0.05, "{name}: {of_mesh} {of_box}");
    }
}

/// A part with a notch falls over what fits into the notch, and its convex hull does not.
#[test]
fn arch_falls_over_a_pipe() {
    let arch = mesh(&prism(&arch(), 30.0));
    let turned = UnitQuaternion::from_euler_angles(std::f64::consts::FRAC_PI_2, 0.0, 0.0);
    let pipe = Part {
        primitive: Primitive::Cylinder { radius: 0.016, half_height: 0.08 },
        pose: Isometry3::from_parts(nalgebra::Translation3::new(0.5, 0.3, 0.016), turned),
    };
    for mut engine in engines() {
        for most in [16, 1] {
            let parts = Pieces::of(&arch, most).unwrap().parts;
            let start = Isometry3::translation(0.502, 0.3, 0.05);
            let at = after(&mut *engine, &scene(parts, start, vec![pipe.clone()]), 1.0);
            let name = engine.build().name;
            let upright = (at.rotation * Vector3::z()).z > 0.99;
            assert_eq!(upright && at.translation.z.abs() < 1e-3, most > 1, "{name}, {most} pieces: {at}");
        }
    }
}

/// The compiler of MuJoCo moves the frame of a mesh. The engine reports that of the scene.
#[test]
fn engines_report_poses_of_mesh_fixtures() {
    let mut pieces = Pieces::of(&mesh(&prism(&L, 30.0)), 16).unwrap().parts;
    let place = Isometry3::new(Vector3::new(0.5, 0.3, 0.1), Vector3::new(0.3, 0.2, -0.5));
    pieces.iter_mut().for_each(|piece| piece.pose = place * piece.pose);
    let block = vec![cuboid([0.01; 3], [0.0; 3])];
    let scene = scene(block, Isometry3::translation(0.5, -0.3, 0.01), pieces.clone());
    for mut engine in engines() {
        after(&mut *engine, &scene, 0.01);
        let read = engine.read_back().unwrap();
        for (index, piece) in pieces.iter().enumerate() {
            let found = read.fixtures.iter().find(|read| read.fixture == index + 1).unwrap();
            let off = found.pose.inverse() * piece.pose;
            assert!(
                off.translation.vector.norm() < 1e-9 && off.rotation.angle() < 1e-7,
                "{}: {off}",
                engine.build().name
            );
        }
    }
}
