//! Claims about what the cell's cameras show.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use nalgebra::Point3;
use robogate_core::{Assignment, Image, Scenario, Seed, Simulator, Value};
use robogate_sim::camera::{CAMERAS, Cameras, Posture};
use robogate_sim::{
    Engine, MujocoEngine, PickPlace, Placement, RapierEngine, Robot, Scene, SceneParameters, built_in_robot,
    built_in_robots,
};

fn scenario(settings: &[(&str, Value)]) -> Scenario {
    let mut requested = Assignment::default();
    for (name, value) in settings {
        requested.set(*name, value.clone());
    }
    Scenario { index: 0, seed: Seed::campaign(5).episode(0), requested }
}

fn word(word: &str) -> Value {
    Value::Category(word.into())
}

fn mujoco(robot: Robot) -> PickPlace<MujocoEngine> {
    PickPlace::new(MujocoEngine::new(robot, MujocoEngine::TIME_STEP_S).unwrap(), None).unwrap()
}

fn pictures(settings: &[(&str, Value)]) -> Vec<Image> {
    let mut cell = mujoco(built_in_robot("franka").unwrap());
    cell.reset(&scenario(settings)).unwrap();
    cell.render().unwrap()
}

/// Mean of red, green and blue together.
fn brightness(image: &Image) -> f64 {
    image.rgb.iter().map(|b| f64::from(*b)).sum::<f64>() / image.rgb.len() as f64
}

#[test]
fn the_same_scene_gives_the_same_picture_in_both_engines() {
    let scenario = scenario(&[("obstacles", Value::Integer(3)), ("shape", word("L_shape"))]);
    let mut one = mujoco(built_in_robot("franka").unwrap());
    one.reset(&scenario).unwrap();
    let engine = RapierEngine::new(built_in_robot("franka").unwrap(), RapierEngine::TIME_STEP_S).unwrap();
    let mut other = PickPlace::new(engine, None).unwrap();
    other.reset(&scenario).unwrap();
    let (one, other) = (one.render().unwrap(), other.render().unwrap());
    // Engines keep poses to different last bits.
    let off = |a: &Image, b: &Image| a.rgb.iter().zip(&b.rgb).filter(|(a, b)| a.abs_diff(**b) > 1).count();
    for (a, b) in one.iter().zip(&other) {
        assert!(off(a, b) * 1000 < a.rgb.len(), "{} bytes differ", off(a, b));
    }
}

#[test]
fn looking_twice_gives_the_same_bytes_and_changes_nothing() {
    let settings = [("friction", Value::Number(0.6)), ("table_material", word("steel"))];
    let first = pictures(&settings);
    let mut cell = mujoco(built_in_robot("franka").unwrap());
    cell.reset(&scenario(&[("table_material", word("rubber"))])).unwrap();
    cell.render().unwrap();
    cell.reset(&scenario(&settings)).unwrap();
    assert_eq!(cell.render().unwrap(), first);
    assert_eq!(cell.render().unwrap(), first);
}

#[test]
fn pictures_have_the_size_asked_for() {
    for (image, name) in pictures(&[]).iter().zip(CAMERAS) {
        assert_eq!((image.camera.as_str(), image.width, image.height), (name, 256, 256));
        assert_eq!(image.rgb.len(), 3 * 256 * 256);
    }
    let mut cell = mujoco(built_in_robot("franka").unwrap()).with_picture_size(93, 41);
    cell.reset(&scenario(&[])).unwrap();
    assert!(cell.render().unwrap().iter().all(|image| image.rgb.len() == 3 * 93 * 41));
}

#[test]
fn nothing_is_shown_before_a_scenario_is_set_up() {
    let fault = mujoco(built_in_robot("franka").unwrap()).render().unwrap_err();
    assert!(fault.to_string().contains("no scenario is set up"), "{fault}");
}

#[test]
fn the_tool_is_where_the_engine_has_it() {
    for name in built_in_robots() {
        let robot = built_in_robot(name).unwrap();
        let mut cell = mujoco(robot.clone());
        cell.reset(&scenario(&[])).unwrap();
        let engine = cell.engine();
        let posture = Posture {
            joints: engine.joint_positions(),
            opening_m: engine.opening(),
            object: engine.object(),
            fixtures: Vec::new(),
        };
        let [_, wrist] = Cameras::new(&robot).unwrap().pinholes(&posture);
        // The wrist camera sees the tool centre point a little below the picture's middle.
        let tcp = Point3::from(engine.tcp().translation.vector);
        let [u, v, depth] = wrist.project(&tcp).unwrap();
        assert!((u - 128.0).abs() < 1e-6 && (128.0..200.0).contains(&v) && depth < 0.2, "{name}: {u} {v} {depth}");
    }
}

#[test]
fn parameters_of_the_look_come_back_from_the_cameras() {
    let settings = [
        ("lighting_lux", Value::Number(873.25)),
        ("camera_roll_rad", Value::Number(-0.13)),
        ("camera_pitch_rad", Value::Number(0.07)),
        ("table_material", word("cardboard")),
        ("background_color", word("#123456")),
        ("object_color", word("#fe01a0")),
        ("object_transparency", Value::Number(0.35)),
    ];
    let mut cell = mujoco(built_in_robot("franka").unwrap());
    let start = cell.reset(&scenario(&settings)).unwrap();
    for (name, asked) in &settings {
        match asked {
            Value::Number(asked) => {
                let got = start.applied.number(name).unwrap();
                assert!((got - asked).abs() < 1e-7, "{name}: {got}");
            }
            _ => assert_eq!(start.applied.get(name), Some(asked), "{name}"),
        }
    }
}

#[test]
fn more_light_makes_brighter_pictures_and_neither_end_clips() {
    let mut last = 0.0;
    for lux in [50.0, 200.0, 500.0, 1000.0, 2000.0] {
        let image = &pictures(&[("lighting_lux", Value::Number(lux)), ("table_material", word("laminate"))])[0];
        let now = brightness(image);
        assert!(now > last + 5.0, "{lux} lux: {now} after {last}");
        last = now;
        let clipped = image.rgb.chunks_exact(3).filter(|p| p.iter().all(|b| *b == 255)).count();
        assert!(clipped * 500 < image.rgb.len(), "{lux} lux: {clipped} white pixels");
    }
    let dark = &pictures(&[("lighting_lux", Value::Number(50.0))])[0];
    assert!(brightness(dark) < 80.0, "{}", brightness(dark));
}

/// Where the front camera has a point of the base frame.
fn in_front(point: [f64; 3]) -> [usize; 2] {
    let cameras = Cameras::new(&built_in_robot("franka").unwrap()).unwrap();
    let posture = Posture { joints: vec![0.0; 7], opening_m: None, object: Default::default(), fixtures: Vec::new() };
    let [u, v, _] = cameras.pinholes(&posture)[0].project(&Point3::from(point)).unwrap();
    [u as usize, v as usize]
}

fn pixel(image: &Image, [u, v]: [usize; 2]) -> [u8; 3] {
    let at = 3 * (v * image.width + u);
    [image.rgb[at], image.rgb[at + 1], image.rgb[at + 2]]
}

#[test]
fn the_object_is_seen_where_it_stands_and_in_its_colour() {
    for (placement, at) in [("center_0", [0.5, 0.0]), ("left_0", [0.5, 0.15]), ("edge_0", [0.62, 0.0])] {
        let image = &pictures(&[("placement", word(placement)), ("object_color", word("#2040d0"))])[0];
        let [red, green, blue] = pixel(image, in_front([at[0], at[1], 0.025]));
        assert!(blue > 2 * red && blue > 2 * green, "{placement}: {red} {green} {blue}");
    }
}

#[test]
fn the_target_is_marked_on_every_table() {
    for material in ["wood", "steel", "laminate", "rubber", "cardboard"] {
        let image = &pictures(&[("table_material", word(material))])[0];
        // On the ring; the table beside it.
        let [red, green, _] = pixel(image, in_front([0.4, 0.35, 0.0]));
        assert!(f64::from(green) > 1.25 * f64::from(red), "{material}: {red} {green}");
        let [red, green, _] = pixel(image, in_front([0.4, 0.25, 0.0]));
        assert!(f64::from(green) < 1.1 * f64::from(red), "{material}: {red} {green}");
    }
}

#[test]
fn a_panel_hides_the_object_and_a_clear_object_shows_what_is_behind_it() {
    let at = in_front([0.5, 0.0, 0.025]);
    let plain = pixel(&pictures(&[])[0], at);
    let hidden = pixel(&pictures(&[("occluders", Value::Integer(1))])[0], at);
    assert!(plain[0] > 2 * plain[1] && hidden[0] < hidden[1] + 20, "{plain:?} {hidden:?}");
    let table = pixel(&pictures(&[("placement", word("left_0"))])[0], at);
    let clear = pixel(&pictures(&[("object_transparency", Value::Number(0.95))])[0], at);
    let off = |a: [u8; 3], b: [u8; 3]| a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(b))).sum::<u32>();
    assert!(off(clear, table) * 2 < off(plain, table), "{clear:?} of {plain:?} before {table:?}");
}

#[test]
fn things_cast_shadows_away_from_the_lamp() {
    let with = &pictures(&[("table_material", word("laminate"))])[0];
    let without = &pictures(&[("table_material", word("laminate")), ("placement", word("right_0"))])[0];
    // The lamp stands at the camera's side, to its left: the object's shadow falls to the right and away.
    let shadow = in_front([0.485, 0.036, 0.0]);
    let lit = in_front([0.52, -0.04, 0.0]);
    let (dark, bright) = (pixel(with, shadow)[0], pixel(without, shadow)[0]);
    assert!(f64::from(dark) < 0.9 * f64::from(bright), "{dark} {bright}");
    assert!(pixel(with, lit)[0].abs_diff(pixel(without, lit)[0]) < 4);
}

#[test]
fn a_turned_camera_turns_the_picture() {
    let plain = &pictures(&[])[0];
    let tilted = &pictures(&[("camera_pitch_rad", Value::Number(0.1))])[0];
    let red = |image: &Image| {
        let rows = (0..image.height).filter(|v| {
            (0..image.width).any(|u| {
                let [r, g, b] = pixel(image, [u, *v]).map(u32::from);
                r > 100 && r > 2 * g && r > 2 * b
            })
        });
        rows.map(|v| v as f64).fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)))
    };
    // Tilted up by 0.1 rad, what was near the middle falls by 0.1 focal lengths.
    let focal = 128.0 / 35_f64.to_radians().tan();
    let ((a, b), (c, d)) = (red(plain), red(tilted));
    assert!((0.5 * (c + d) - 0.5 * (a + b) - 0.1 * focal).abs() < 2.5, "{a} {b} {c} {d}");
}

/// A scene with everything in it, and where all of it is while the arm waits.
fn crowded() -> (Robot, Scene, Posture) {
    let mut requested = Assignment::default();
    for (name, value) in [
        ("obstacles", Value::Integer(5)),
        ("occluders", Value::Integer(2)),
        ("disturbance_speed_m_s", Value::Number(0.2)),
        ("object_transparency", Value::Number(0.6)),
        ("shape", word("irregular")),
    ] {
        requested.set(name, value);
    }
    let parameters = SceneParameters::from_assignment(&requested, None).unwrap();
    let placement = Placement::from_name(&parameters.placement).unwrap();
    let mut stream = Seed::campaign(1).stream("obstacles");
    let scene = Scene::new(&parameters, &placement, &mut stream).unwrap();
    let robot = built_in_robot("franka").unwrap();
    let posture = Posture {
        joints: robot.settings.arm.home_rad.clone(),
        opening_m: Some(0.08),
        object: scene.object_pose,
        fixtures: scene.fixtures.iter().map(|fixture| fixture.part.pose).collect(),
    };
    (robot, scene, posture)
}

#[test]
fn a_scene_can_be_looked_at_without_an_engine() {
    let (robot, scene, posture) = crowded();
    let mut cameras = Cameras::new(&robot).unwrap();
    assert!(cameras.render(&posture).is_empty());
    cameras.set_up(&scene);
    assert_eq!(cameras.visual().map(|visual| visual.table_material), Some(scene.visual.table_material));
    assert_eq!(cameras.render(&posture).len(), 2);
}

#[test]
fn tiles_and_shadow_grid_spare_work_and_change_no_byte() {
    let (robot, scene, mut posture) = crowded();
    let mut cameras = Cameras::new(&robot).unwrap();
    cameras.set_up(&scene);
    let mut exhaustive = Cameras::new(&robot).unwrap().exhaustive();
    exhaustive.set_up(&scene);
    for elbow in [-2.35, -2.0] {
        posture.joints[3] = elbow;
        assert!(cameras.render(&posture) == exhaustive.render(&posture), "elbow at {elbow}");
    }
}
