//! Tests of the images of a scene, without an engine.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use nalgebra::{Isometry3, Point3};
use robogate_camera::{CAMERAS, Cameras, Posture};
use robogate_core::Image;
use robogate_physics::{
    Color, Fixture, FixtureKind, GRAVITY, GripperUnit, MassProperties, Motion, Object, Part, Primitive, Robot, Scene,
    TableMaterial, Visual, built_in_robot,
};

/// A scene with a 5 cm cube on the table at (x, y), and a marker at (0.4, 0.4).
fn cube_at([x, y]: [f64; 2]) -> Scene {
    let parts = vec![Part { primitive: Primitive::Box { half: [0.025; 3] }, pose: Isometry3::identity() }];
    Scene {
        object: Object { mass: MassProperties::homogeneous(&parts, 0.3), parts, joint: None, friction: None },
        object_pose: Isometry3::translation(x, y, 0.025),
        others: Vec::new(),
        friction: 0.8,
        table_friction: None,
        arm_stiffness: 1.0,
        gripper: GripperUnit::default(),
        fixtures: vec![Fixture::table()],
        gravity: GRAVITY,
        marker: Some([0.4, 0.4]),
        visual: Visual::default(),
    }
}

/// A scene with a cube at the workspace centre and this appearance.
fn looking(change: impl FnOnce(&mut Visual)) -> Scene {
    let mut scene = cube_at([0.5, 0.0]);
    change(&mut scene.visual);
    scene
}

fn fixture(kind: FixtureKind, primitive: Primitive, [x, y]: [f64; 2]) -> Fixture {
    let pose = Isometry3::translation(x, y, primitive.half_extent()[2]);
    Fixture {
        name: format!("{kind:?} at {x}, {y}"),
        kind,
        part: Part { primitive, pose },
        motion: None,
        friction: None,
        color: None,
    }
}

/// A panel between the workspace centre and the front camera.
fn panel() -> Fixture {
    fixture(FixtureKind::Occluder, Primitive::Box { half: [0.005, 0.0075, 0.08] }, [0.65, 0.0])
}

/// The arm at home, and everything else at its pose in the scene.
fn at_start(robot: &Robot, scene: &Scene) -> Posture {
    Posture {
        joints: robot.settings.arm.home_rad.clone(),
        opening_m: Some(0.08),
        cup_travel_m: 0.0,
        object: scene.object_pose,
        others: Vec::new(),
        fixtures: scene.fixtures.iter().map(|fixture| fixture.part.pose).collect(),
    }
}

fn cameras() -> (Robot, Cameras) {
    let robot = built_in_robot("franka").unwrap();
    let cameras = Cameras::new(&robot).unwrap();
    (robot, cameras)
}

fn pictures(scene: &Scene) -> Vec<Image> {
    let (robot, mut cameras) = cameras();
    cameras.set_up(scene);
    cameras.render(&at_start(&robot, scene))
}

/// Mean over red, green and blue.
fn brightness(image: &Image) -> f64 {
    image.rgb.iter().map(|b| f64::from(*b)).sum::<f64>() / image.rgb.len() as f64
}

#[test]
fn equal_scenes_give_equal_bytes() {
    let steel = looking(|visual| visual.table_material = TableMaterial::Steel);
    let first = pictures(&steel);
    let (robot, mut cameras) = cameras();
    let other = looking(|visual| visual.table_material = TableMaterial::Rubber);
    cameras.set_up(&other);
    cameras.render(&at_start(&robot, &other));
    cameras.set_up(&steel);
    assert_eq!(cameras.render(&at_start(&robot, &steel)), first);
    assert_eq!(cameras.render(&at_start(&robot, &steel)), first);
}

#[test]
fn images_have_the_requested_size() {
    let scene = cube_at([0.5, 0.0]);
    for (image, name) in pictures(&scene).iter().zip(CAMERAS) {
        assert_eq!((image.camera.as_str(), image.width, image.height), (name, 256, 256));
        assert_eq!(image.rgb.len(), 3 * 256 * 256);
    }
    let (robot, cameras) = cameras();
    let mut cameras = cameras.with_size(93, 41);
    cameras.set_up(&scene);
    assert!(cameras.render(&at_start(&robot, &scene)).iter().all(|image| image.rgb.len() == 3 * 93 * 41));
}

#[test]
fn rendering_needs_a_scene() {
    let (robot, mut cameras) = cameras();
    let scene = cube_at([0.5, 0.0]);
    assert!(cameras.render(&at_start(&robot, &scene)).is_empty());
    assert_eq!(cameras.visual(), None);
    cameras.set_up(&scene);
    cameras.clear();
    assert!(cameras.render(&at_start(&robot, &scene)).is_empty());
}

#[test]
fn appearance_is_read_back() {
    let wanted = Visual {
        lighting_lux: 873.25,
        camera_roll_rad: -0.13,
        camera_pitch_rad: 0.07,
        table_material: TableMaterial::Cardboard,
        background_color: Color([0x12, 0x34, 0x56]),
        object_color: Color([0xfe, 0x01, 0xa0]),
        object_transparency: 0.35,
    };
    let (_, mut cameras) = cameras();
    cameras.set_up(&looking(|visual| *visual = wanted));
    let got = cameras.visual().unwrap();
    assert!((got.camera_roll_rad + 0.13).abs() < 1e-7 && (got.camera_pitch_rad - 0.07).abs() < 1e-7, "{got:?}");
    let same_turn = Visual { camera_roll_rad: -0.13, camera_pitch_rad: 0.07, ..got };
    assert_eq!(same_turn, wanted);
}

#[test]
fn more_light_gives_brighter_images() {
    let mut last = 0.0;
    let lit =
        |lux: f64| looking(|visual| (visual.lighting_lux, visual.table_material) = (lux, TableMaterial::Laminate));
    for lux in [50.0, 200.0, 500.0, 1000.0, 2000.0] {
        let image = &pictures(&lit(lux))[0];
        let now = brightness(image);
        assert!(now > last + 5.0, "{lux} lux: {now} after {last}");
        last = now;
        let clipped = image.rgb.chunks_exact(3).filter(|p| p.iter().all(|b| *b == 255)).count();
        assert!(clipped * 500 < image.rgb.len(), "{lux} lux: {clipped} white pixels");
    }
    let dark = &pictures(&looking(|visual| visual.lighting_lux = 50.0))[0];
    assert!(brightness(dark) < 80.0, "{}", brightness(dark));
}

/// The pixel of the front camera that shows a point in the base frame.
fn in_front(point: [f64; 3]) -> [usize; 2] {
    let (_, cameras) = cameras();
    let posture = Posture {
        joints: vec![0.0; 7],
        opening_m: None,
        cup_travel_m: 0.0,
        object: Default::default(),
        others: Vec::new(),
        fixtures: Vec::new(),
    };
    let [u, v, _] = cameras.pinholes(&posture)[0].project(&Point3::from(point)).unwrap();
    [u as usize, v as usize]
}

fn pixel(image: &Image, [u, v]: [usize; 2]) -> [u8; 3] {
    let at = 3 * (v * image.width + u);
    [image.rgb[at], image.rgb[at + 1], image.rgb[at + 2]]
}

#[test]
fn object_appears_at_its_position() {
    for at in [[0.5, 0.0], [0.5, 0.15], [0.62, 0.0]] {
        let mut scene = cube_at(at);
        scene.visual.object_color = Color([0x20, 0x40, 0xd0]);
        let [red, green, blue] = pixel(&pictures(&scene)[0], in_front([at[0], at[1], 0.025]));
        assert!(blue > 2 * red && blue > 2 * green, "{at:?}: {red} {green} {blue}");
    }
}

#[test]
fn marker_is_visible_on_every_table() {
    for material in TableMaterial::ALL {
        let mut scene = looking(|visual| visual.table_material = material);
        // A point on the ring, and a point on the table beside it.
        let [on, beside] = [in_front([0.4, 0.35, 0.0]), in_front([0.4, 0.25, 0.0])];
        let image = &pictures(&scene)[0];
        let [red, green, _] = pixel(image, on);
        assert!(f64::from(green) > 1.25 * f64::from(red), "{material:?}: {red} {green}");
        let [red, green, _] = pixel(image, beside);
        assert!(f64::from(green) < 1.1 * f64::from(red), "{material:?}: {red} {green}");
        scene.marker = None;
        let [red, green, _] = pixel(&pictures(&scene)[0], on);
        assert!(f64::from(green) < 1.1 * f64::from(red), "{material:?} without a marker: {red} {green}");
    }
}

#[test]
fn panel_hides_the_object() {
    let at = in_front([0.5, 0.0, 0.025]);
    let plain = pixel(&pictures(&cube_at([0.5, 0.0]))[0], at);
    let mut behind = cube_at([0.5, 0.0]);
    behind.fixtures.push(panel());
    let hidden = pixel(&pictures(&behind)[0], at);
    assert!(plain[0] > 2 * plain[1] && hidden[0] < hidden[1] + 20, "{plain:?} {hidden:?}");
}

#[test]
fn transparent_object_shows_the_table() {
    let at = in_front([0.5, 0.0, 0.025]);
    let plain = pixel(&pictures(&cube_at([0.5, 0.0]))[0], at);
    let table = pixel(&pictures(&cube_at([0.5, 0.15]))[0], at);
    let clear = pixel(&pictures(&looking(|visual| visual.object_transparency = 0.95))[0], at);
    let off = |a: [u8; 3], b: [u8; 3]| a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(b))).sum::<u32>();
    assert!(off(clear, table) * 2 < off(plain, table), "{clear:?} of {plain:?} before {table:?}");
}

#[test]
fn shadows_fall_away_from_the_lamp() {
    let laminate = |at| {
        let mut scene = cube_at(at);
        scene.visual.table_material = TableMaterial::Laminate;
        pictures(&scene).swap_remove(0)
    };
    let (with, without) = (laminate([0.5, 0.0]), laminate([0.5, -0.15]));
    // The lamp is on the camera's side, to its left, so the object's shadow falls to the right and away from the
    // camera.
    let shadow = in_front([0.485, 0.036, 0.0]);
    let lit = in_front([0.52, -0.04, 0.0]);
    let (dark, bright) = (pixel(&with, shadow)[0], pixel(&without, shadow)[0]);
    assert!(f64::from(dark) < 0.9 * f64::from(bright), "{dark} {bright}");
    assert!(pixel(&with, lit)[0].abs_diff(pixel(&without, lit)[0]) < 4);
}

#[test]
fn tilted_camera_shifts_the_image() {
    let plain = &pictures(&cube_at([0.5, 0.0]))[0];
    let tilted = &pictures(&looking(|visual| visual.camera_pitch_rad = 0.1))[0];
    let red = |image: &Image| {
        let rows = (0..image.height).filter(|v| {
            (0..image.width).any(|u| {
                let [r, g, b] = pixel(image, [u, *v]).map(u32::from);
                r > 100 && r > 2 * g && r > 2 * b
            })
        });
        rows.map(|v| v as f64).fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)))
    };
    // With the camera tilted up by 0.1 rad, points near the centre move down by 0.1 focal lengths.
    let focal = 128.0 / 35_f64.to_radians().tan();
    let ((a, b), (c, d)) = (red(plain), red(tilted));
    assert!((0.5 * (c + d) - 0.5 * (a + b) - 0.1 * focal).abs() < 2.5, "{a} {b} {c} {d}");
}

/// A scene with fixtures of every kind and a transparent object of several parts.
fn crowded() -> Scene {
    let mut scene = looking(|visual| visual.object_transparency = 0.6);
    let slab = |z: f64, yaw: f64| Part {
        primitive: Primitive::Box { half: [0.02, 0.019, 0.0125] },
        pose: Isometry3::new(nalgebra::Vector3::z() * z, nalgebra::Vector3::z() * yaw),
    };
    let ball = Part { primitive: Primitive::Sphere { radius: 0.011 }, pose: Isometry3::translation(0.014, -0.01, 0.0) };
    scene.object.parts = vec![slab(-0.0125, 0.0), slab(0.0125, 0.26), ball];
    let cylinder = Primitive::Cylinder { radius: 0.025, half_height: 0.06 };
    let cuboid = Primitive::Box { half: [0.02, 0.02, 0.04] };
    scene.fixtures.extend([
        fixture(FixtureKind::Obstacle, cylinder.clone(), [0.4, -0.2]),
        fixture(FixtureKind::Obstacle, cuboid, [0.6, 0.2]),
        fixture(FixtureKind::Obstacle, cylinder, [0.7, -0.1]),
        panel(),
    ]);
    let motion = Motion::Straight { velocity: nalgebra::Vector3::x() * 0.2, starts_s: 0.0, ends_s: 1.0 };
    let box_in_motion = fixture(FixtureKind::Disturbance, Primitive::Box { half: [0.03, 0.03, 0.04] }, [0.5, -0.4]);
    scene.fixtures.push(Fixture { motion: Some(motion), ..box_in_motion });
    scene
}

#[test]
fn acceleration_changes_no_byte() {
    let scene = crowded();
    let (robot, mut quick) = cameras();
    quick.set_up(&scene);
    let mut exhaustive = Cameras::new(&robot).unwrap().exhaustive();
    exhaustive.set_up(&scene);
    let mut posture = at_start(&robot, &scene);
    for elbow in [-2.35, -2.0] {
        posture.joints[3] = elbow;
        assert!(quick.render(&posture) == exhaustive.render(&posture), "elbow at {elbow}");
    }
}
