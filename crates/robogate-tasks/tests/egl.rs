//! Compares MuJoCo's renderer with the embedded one. Without an EGL device the tests are skipped with a message.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use robogate_camera::{CAMERAS, EglRenderer};
use robogate_core::{Assignment, Environment, Image, Policy, Scenario, Seed, Value};
use robogate_physics::{Engine, MujocoEngine, built_in_robot};
use robogate_tasks::file::FileTask;
use robogate_tasks::pick_place::{PickPlace, Scripted};
use robogate_tasks::{ArmEnvironment, ArmTask, Rig};

type Settings<'a> = Vec<(&'a str, Value)>;

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

fn embedded(robot: &str) -> ArmEnvironment {
    let robot = built_in_robot(robot).unwrap();
    PickPlace::default()
        .on(Box::new(MujocoEngine::new(robot, MujocoEngine::TIME_STEP_S).unwrap()), Rig::default())
        .unwrap()
}

/// The same cell with MuJoCo's renderer, if a device exists.
fn egl(robot: &str) -> Option<ArmEnvironment> {
    egl_of(robot, Rig::default().picture_px)
}

/// As [`egl`], with images of this size.
fn egl_of(robot: &str, picture_px: [usize; 2]) -> Option<ArmEnvironment> {
    let engine = MujocoEngine::new(built_in_robot(robot).unwrap(), MujocoEngine::TIME_STEP_S).unwrap();
    match EglRenderer::new(&engine) {
        Ok(renderer) => Some(
            PickPlace::default().on(Box::new(engine), Rig { renderer: Some(Box::new(renderer)), picture_px }).unwrap(),
        ),
        Err(why) => {
            robogate_testing::skip("egl", &why.to_string());
            None
        }
    }
}

/// The images after this number of steps of the scripted controller.
fn pictures(cell: &mut ArmEnvironment, robot: &str, settings: &[(&str, Value)], steps: usize) -> Vec<Image> {
    let scenario = scenario(settings);
    let start = cell.reset(&scenario).unwrap();
    let robot = built_in_robot(robot).unwrap();
    let chain = MujocoEngine::new(robot.clone(), MujocoEngine::TIME_STEP_S).unwrap();
    let mut policy = Scripted::new(robot, Engine::chain(&chain).clone());
    policy.reset(cell.task(), &start.instance, scenario.seed).unwrap();
    let mut observation = start.observation;
    for _ in 0..steps {
        observation = cell.step(&policy.act(&observation).unwrap()).unwrap().observation;
    }
    cell.render().unwrap()
}

/// The pixels that differ between two images.
fn differing(a: &Image, b: &Image) -> BTreeSet<(i64, i64)> {
    let differ = |(a, b): (&[u8], &[u8])| a.iter().zip(b).any(|(a, b)| a.abs_diff(*b) > 24);
    let pairs = a.rgb.chunks_exact(3).zip(b.rgb.chunks_exact(3));
    let place = |i: usize| ((i % a.width) as i64, (i / a.width) as i64);
    pairs.enumerate().filter(|(_, pair)| differ(*pair)).map(|(i, _)| place(i)).collect()
}

fn centroid(pixels: &BTreeSet<(i64, i64)>) -> [f64; 2] {
    let n = pixels.len() as f64;
    [pixels.iter().map(|p| p.0 as f64).sum::<f64>() / n, pixels.iter().map(|p| p.1 as f64).sum::<f64>() / n]
}

/// The number of these pixels without a pixel of the other set within two pixels.
fn alone(these: &BTreeSet<(i64, i64)>, others: &BTreeSet<(i64, i64)>) -> usize {
    let near = |(x, y): &(i64, i64)| (-2..=2).any(|dx| (-2..=2).any(|dy| others.contains(&(x + dx, y + dy))));
    these.iter().filter(|pixel| !near(pixel)).count()
}

/// The object's pixels, from images with two object colours.
fn outlines(
    cell: &mut ArmEnvironment,
    robot: &str,
    settings: &Settings<'_>,
    steps: usize,
) -> Vec<BTreeSet<(i64, i64)>> {
    let mut painted = |color: &str| {
        let mut settings = settings.clone();
        settings.push(("object_color", word(color)));
        pictures(cell, robot, &settings, steps)
    };
    let (red, blue) = (painted("#e02020"), painted("#2020e0"));
    red.iter().zip(&blue).map(|(a, b)| differing(a, b)).collect()
}

#[test]
fn object_outline_matches() {
    let cases: Vec<(&str, Settings<'_>, usize)> = vec![
        ("franka", vec![], 0),
        ("franka", vec![("shape", word("sphere")), ("size_m", Value::Number(0.08)), ("placement", word("left_0"))], 0),
        (
            "franka",
            vec![("shape", word("L_shape")), ("occluders", Value::Integer(2)), ("obstacles", Value::Integer(3))],
            30,
        ),
        ("franka", vec![("camera_roll_rad", Value::Number(0.2)), ("camera_pitch_rad", Value::Number(-0.1))], 20),
        ("ur5e", vec![("shape", word("cylinder")), ("table_material", word("steel"))], 0),
        ("ur5e", vec![("shape", word("irregular")), ("lighting_lux", Value::Number(1500.0))], 30),
    ];
    let mut seen = [0, 0];
    for (robot, settings, steps) in cases {
        let Some(mut other) = egl(robot) else { return };
        let one = outlines(&mut embedded(robot), robot, &settings, steps);
        let other = outlines(&mut other, robot, &settings, steps);
        for (camera, (one, other)) in one.iter().zip(&other).enumerate() {
            let what = format!("{robot} {settings:?} {}: {} and {} pixels", CAMERAS[camera], one.len(), other.len());
            // A sliver at the image border has no meaningful centre.
            if one.len() < 40 {
                assert!(other.len() < 60, "{what}");
                continue;
            }
            seen[camera] += 1;
            let ([x, y], [u, v]) = (centroid(one), centroid(other));
            assert!((x - u).hypot(y - v) < 1.0, "{what}: ({x:.2}, {y:.2}) and ({u:.2}, {v:.2})");
            assert!(alone(one, other) == 0 && alone(other, one) == 0, "{what}");
        }
    }
    assert!(seen[0] >= 5 && seen[1] >= 4, "the object is visible in too few images: {seen:?}");
}

/// A part that is a mesh, and not its convex pieces.
#[test]
fn mesh_outline_matches() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/tasks/pipe_clamp");
    let images = |color: &str, of_mujoco: bool| {
        let text = fs::read_to_string(folder.join("task.toml")).unwrap().replacen("#c83c28", color, 1);
        let mut find = |name: &str| fs::read(folder.join(name)).map_err(|why| why.to_string());
        let task = FileTask::read_with(&text, &mut find).unwrap();
        let engine = MujocoEngine::new(built_in_robot("franka").unwrap(), MujocoEngine::TIME_STEP_S).unwrap();
        let renderer = of_mujoco.then(|| EglRenderer::new(&engine)).transpose();
        let renderer = renderer.map_err(|why| robogate_testing::skip("egl", &why.to_string())).ok()?;
        let renderer = renderer.map(|renderer| Box::new(renderer) as Box<_>);
        let mut cell = task.on(Box::new(engine), Rig { renderer, ..Rig::default() }).unwrap();
        cell.reset(&scenario(&[])).unwrap();
        Some(cell.render().unwrap())
    };
    let outlines = |of_mujoco: bool| -> Option<Vec<BTreeSet<(i64, i64)>>> {
        let (red, blue) = (images("#e02020", of_mujoco)?, images("#2020e0", of_mujoco)?);
        Some(red.iter().zip(&blue).map(|(a, b)| differing(a, b)).collect())
    };
    let Some(others) = outlines(true) else { return };
    let (one, other) = (&outlines(false).unwrap()[0], &others[0]);
    assert!(one.len() > 100, "{} pixels", one.len());
    let ([x, y], [u, v]) = (centroid(one), centroid(other));
    assert!((x - u).hypot(y - v) < 1.0, "({x:.2}, {y:.2}) and ({u:.2}, {v:.2})");
    assert!(alone(one, other) == 0 && alone(other, one) == 0, "{} and {} pixels", one.len(), other.len());
}

#[test]
fn outlines_against_background_match() {
    for (robot, steps) in [("franka", 0), ("franka", 25), ("ur5e", 0), ("ur10e", 25)] {
        let Some(mut other) = egl(robot) else { return };
        let wall = |cell: &mut ArmEnvironment| {
            let mut painted = |color| pictures(cell, robot, &[("background_color", word(color))], steps);
            let (light, dark) = (painted("#e0e0e0"), painted("#203020"));
            differing(&light[0], &dark[0])
        };
        let (one, other) = (wall(&mut embedded(robot)), wall(&mut other));
        let (lost, gained) = (alone(&one, &other), alone(&other, &one));
        assert!(one.len() > 5000 && lost + gained == 0, "{robot}: {lost} and {gained} of {}", one.len());
    }
}

#[test]
fn marker_matches() {
    let Some(mut other) = egl("franka") else { return };
    for material in ["wood", "steel", "laminate", "rubber", "cardboard"] {
        // The green pixels: the ring and the cross.
        let mark = |cell: &mut ArmEnvironment| {
            let image = &pictures(cell, "franka", &[("table_material", word(material))], 0)[0];
            let green = |p: &[u8]| f64::from(p[1]) > 1.2 * f64::from(p[0]) && f64::from(p[1]) > 1.1 * f64::from(p[2]);
            let pixels = image.rgb.chunks_exact(3).enumerate().filter(|(_, p)| green(p));
            pixels.map(|(i, _)| ((i % image.width) as i64, (i / image.width) as i64)).collect::<BTreeSet<_>>()
        };
        let (one, other) = (mark(&mut embedded("franka")), mark(&mut other));
        assert!(one.len() > 40 && other.len() > 40, "{material}: {} and {}", one.len(), other.len());
        let ([x, y], [u, v]) = (centroid(&one), centroid(&other));
        assert!((x - u).hypot(y - v) < 1.0, "{material}: ({x:.2}, {y:.2}) and ({u:.2}, {v:.2})");
    }
}

fn brightness(image: &Image) -> f64 {
    image.rgb.iter().map(|b| f64::from(*b)).sum::<f64>() / image.rgb.len() as f64
}

#[test]
fn brightness_matches() {
    let Some(mut other) = egl("franka") else { return };
    for material in ["wood", "laminate", "rubber"] {
        for lux in [50.0, 200.0, 500.0, 2000.0] {
            let settings = [("lighting_lux", Value::Number(lux)), ("table_material", word(material))];
            let one = pictures(&mut embedded("franka"), "franka", &settings, 0);
            let two = pictures(&mut other, "franka", &settings, 0);
            for (one, two) in one.iter().zip(&two) {
                let (a, b) = (brightness(one), brightness(two));
                assert!((a - b).abs() < 0.1 * a + 3.0, "{material} {lux} lux {}: {a:.1} and {b:.1}", one.camera);
                let white = two.rgb.chunks_exact(3).filter(|p| p.iter().all(|b| *b == 255)).count();
                assert!(white * 100 < two.rgb.len() / 3, "{material} {lux} lux: {white} white pixels");
            }
        }
    }
}

/// Mean red, green and blue of these pixels.
fn mean(image: &Image, pixels: &BTreeSet<(i64, i64)>) -> [f64; 3] {
    let byte = |(x, y): &(i64, i64), c: usize| f64::from(image.rgb[3 * (*y as usize * image.width + *x as usize) + c]);
    [0, 1, 2].map(|c| pixels.iter().map(|pixel| byte(pixel, c)).sum::<f64>() / pixels.len() as f64)
}

#[test]
fn transparency_matches() {
    let Some(mut other) = egl("franka") else { return };
    let size = ("size_m", Value::Number(0.08));
    let place = outlines(&mut embedded("franka"), "franka", &vec![size.clone()], 0).swap_remove(0);
    for lux in [150.0, 500.0, 1500.0] {
        let light = ("lighting_lux", Value::Number(lux));
        for transparency in [0.4, 0.7, 0.95] {
            let settings = [size.clone(), light.clone(), ("object_transparency", Value::Number(transparency))];
            let one = mean(&pictures(&mut embedded("franka"), "franka", &settings, 0)[0], &place);
            let two = mean(&pictures(&mut other, "franka", &settings, 0)[0], &place);
            let near = one.iter().zip(two).all(|(a, b)| (a - b).abs() < 30.0);
            assert!(near, "{lux} lux, {transparency}: {one:.0?} and {two:.0?}");
        }
    }
}

#[test]
fn equal_scenes_give_equal_bytes() {
    let settings =
        [("shape", word("irregular")), ("obstacles", Value::Integer(4)), ("disturbance_speed_m_s", Value::Number(0.2))];
    let (Some(mut one), Some(mut two)) = (egl("franka"), egl("franka")) else { return };
    let first = pictures(&mut one, "franka", &settings, 10);
    assert!(first.iter().all(|image| brightness(image) > 30.0));
    assert_eq!(one.render().unwrap(), first);
    pictures(&mut two, "franka", &[("table_material", word("rubber"))], 0);
    assert_eq!(pictures(&mut two, "franka", &settings, 10), first);
    assert_eq!(one.render().unwrap(), first);
}

#[test]
fn renderer_does_not_change_physics() {
    let settings = vec![
        ("friction", Value::Number(0.7)),
        ("lighting_lux", Value::Number(873.25)),
        ("camera_pitch_rad", Value::Number(0.07)),
        ("table_material", word("cardboard")),
        ("object_color", word("#fe01a0")),
        ("object_transparency", Value::Number(0.35)),
        ("obstacles", Value::Integer(3)),
        ("disturbance_speed_m_s", Value::Number(0.2)),
    ];
    let scenario = scenario(&settings);
    let run = |mut cell: ArmEnvironment| {
        let start = cell.reset(&scenario).unwrap();
        let robot = built_in_robot("franka").unwrap();
        let engine = MujocoEngine::new(robot.clone(), MujocoEngine::TIME_STEP_S).unwrap();
        let mut policy = Scripted::new(robot, Engine::chain(&engine).clone());
        policy.reset(cell.task(), &start.instance, scenario.seed).unwrap();
        let mut observation = start.observation;
        let mut hashes = Vec::new();
        for i in 0..80 {
            if i % 8 == 0 {
                assert_eq!(cell.render().unwrap().len(), 2);
            }
            let step = cell.step(&policy.act(&observation).unwrap()).unwrap();
            hashes.push(step.state_hash);
            observation = step.observation;
            if step.ending.is_some() {
                break;
            }
        }
        (start.applied, hashes)
    };
    let Some(other) = egl("franka") else { return };
    let (applied, hashes) = run(embedded("franka"));
    assert!(hashes.len() > 40);
    assert_eq!(run(other), (applied, hashes));
}

#[test]
fn images_have_the_requested_size() {
    let Some(mut cell) = egl_of("franka", [93, 41]) else { return };
    let fault = cell.render().unwrap_err().to_string();
    assert!(fault.contains("no scenario is set up"), "{fault}");
    cell.reset(&scenario(&[])).unwrap();
    for (image, name) in cell.render().unwrap().iter().zip(CAMERAS) {
        assert_eq!((image.camera.as_str(), image.width, image.height, image.rgb.len()), (name, 93, 41, 3 * 93 * 41));
    }
}
