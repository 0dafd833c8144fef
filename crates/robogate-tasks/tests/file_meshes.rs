//! Tasks from files with meshes: what is refused, what a record contains, and the shipped one on both engines.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use std::fs;
use std::path::PathBuf;

use robogate_core::{Environment, Outcome, SolidShape, Value, check_applied, rollout};
use robogate_tasks::file::{FILE, FileTask, MOST_FILE_BYTES, Problem};
use robogate_tasks::{ArmDeclaration, ArmEnvironment, ArmTask, Rig};

use common::{EngineKind, scenario};

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../assets/tasks/pipe_clamp")
}

fn text() -> String {
    fs::read_to_string(folder().join(FILE)).unwrap()
}

fn find(name: &str) -> Result<Vec<u8>, String> {
    fs::read(folder().join(name)).map_err(|why| why.to_string())
}

fn read(text: &str) -> Result<FileTask, Vec<Problem>> {
    FileTask::read_with(text, &mut find)
}

fn environment(task: &FileTask, engine: EngineKind, robot: &str) -> ArmEnvironment {
    task.on(engine.robot(robot).engine(), Rig { picture_px: [16; 2], ..Rig::default() }).unwrap()
}

/// On Rapier as on MuJoCo, which the test of all shipped tasks runs.
#[test]
fn expert_seats_the_clamp_in_both_engines() {
    let task = read(&text()).unwrap();
    for engine in [EngineKind::Mujoco, EngineKind::Rapier] {
        for robot in ["franka", "ur5e"] {
            let mut environment = environment(&task, engine, robot);
            let mut expert = task.controller(engine.robot(robot).robot, environment.engine().chain().clone());
            let outcomes: Vec<_> = (0..10)
                .map(|index| rollout(&mut environment, &mut *expert, &scenario(index, &[("encoder_bias_rad", 0.002)])))
                .map(|episode| episode.outcome)
                .collect();
            assert!(outcomes.iter().all(|outcome| *outcome == Outcome::Success), "{engine:?} {robot}: {outcomes:?}");
        }
    }
}

/// The mass that follows from a density, and the mass that a parameter sets, act in both engines.
#[test]
fn masses_of_meshes_act() {
    let task = read(&text()).unwrap();
    for engine in [EngineKind::Mujoco, EngineKind::Rapier] {
        let mut environment = environment(&task, engine, "franka");
        environment.reset(&scenario(0, &[])).unwrap();
        let mass_kg = environment.engine().read_back().unwrap().mass_kg;
        // 2.7 g/cm^3 times the area of the outline, whose arch is half of a polygon with 24 corners, times 46 mm.
        let arch = 0.5 * 24.0 * 0.5 * 21.0_f64.powi(2) * (std::f64::consts::PI / 12.0).sin();
        let area = 56.0 * 50.0 - 36.0 + 2.0 * 18.0 * 8.0 - 42.0 * 20.0 - 2.0 * 0.5 * 3.0 * 6.0 - arch;
        assert!((mass_kg - 2.7e-6 * area * 46.0).abs() < 1e-4 * mass_kg, "{engine:?}: {mass_kg}");
        for parameter in ["clamp_mass_kg", "bed_x_m"] {
            let value = if parameter == "bed_x_m" { 0.47 } else { 0.7 };
            let scenario = scenario(1, &[(parameter, value)]);
            let start = environment.reset(&scenario).unwrap();
            check_applied(&scenario.requested, &start.applied).unwrap();
            assert_eq!(start.applied.get(parameter), Some(&Value::Number(value)), "{engine:?}");
        }
    }
}

/// A record contains the files of the task byte by byte, so that it needs no folder.
#[test]
fn declaration_contains_the_meshes() {
    let task = read(&text()).unwrap();
    let spec = std::sync::Arc::clone(environment(&task, EngineKind::Mujoco, "franka").task());
    let again = FileTask::recorded(&spec).unwrap().unwrap();
    assert_eq!((again.text(), again.files()), (task.text(), task.files()));
    assert_eq!(task.files()["meshes/clamp.obj"], find("meshes/clamp.obj").unwrap());
    assert_eq!(**environment(&again, EngineKind::Mujoco, "franka").task(), *spec);
    // Another mesh is another task.
    let other = FileTask::read_with(&text(), &mut |name| {
        let content = String::from_utf8(find(name)?).unwrap();
        Ok(content.replace("v 22 -23 50", "v 22 -23 51").replace("v 22 23 50", "v 22 23 51").into_bytes())
    });
    assert_ne!(**environment(&other.unwrap(), EngineKind::Mujoco, "franka").task(), *spec);
    for (from, to, expected) in [
        ("meshes/clamp.obj", "meshes/other.obj", "the record does not contain the file"),
        ("Iy", "!!", "the record does not contain it as Base64"),
    ] {
        let mut damaged = (*spec).clone();
        let files = damaged.details.to_string();
        let at = files.rfind(from).unwrap();
        damaged.details = serde_json::from_str(&(files[..at].to_owned() + to + &files[at + from.len()..])).unwrap();
        let problems = FileTask::recorded(&damaged).unwrap().unwrap_err();
        assert!(problems.iter().any(|problem| problem.what.contains(expected)), "{problems:?}");
    }
}

#[test]
fn broken_meshes_are_problems_with_lines() {
    let valid = text();
    let clamp = "{ mesh = \"meshes/clamp.obj\", unit = \"mm\" }";
    for (from, to, expected) in [
        ("meshes/clamp.obj", "meshes/clmap.obj", "meshes/clmap.obj: No such file"),
        ("meshes/clamp.obj", "../clamp.obj", "`../clamp.obj` is not a file in the folder of the task"),
        ("meshes/clamp.obj", "/etc/clamp.obj", "is not a file in the folder of the task"),
        ("meshes/clamp.obj", "clamp.step", "`clamp.step` is neither STL nor OBJ"),
        (clamp, "{ mesh = \"meshes/clamp.obj\" }", "its largest extent is 92.000 m. Is the file in mm?"),
        (clamp, "{ mesh = \"meshes/clamp.obj\", unit = \"kg\" }", "`kg` is not a unit of length"),
        (clamp, "{ mesh = \"meshes/clamp.obj\", unit = \"inch\" }", "unknown unit `inch`"),
        (
            clamp,
            "{ mesh = \"meshes/clamp.obj\", unit = \"mm\", pieces = 99 }",
            "`99` is out of range. Expected 1 to 64",
        ),
        (clamp, "{ box = \"1, 1, 1 cm\", unit = \"mm\" }", "`unit`, `scale` and `pieces` are keys of a mesh"),
        ("density = \"2.7 g/cm^3\"", "density = \"2.7 g\"", "Expected a density, such as `2.7 g/cm^3`"),
        ("density = \"2.7 g/cm^3\"", "density = \"0.01 g/cm^3\"", "the mass that follows is 6.9"),
        ("sets = \"clamp.mass\"", "sets = \"clamp.size\"", "`clamp` has no size"),
    ] {
        assert!(valid.contains(from), "{from}");
        let broken = valid.replacen(from, to, 1);
        let line = 1 + valid[..valid.find(from).unwrap()].matches('\n').count();
        let problems = read(&broken).unwrap_err();
        let found = problems.iter().find(|problem| problem.what.contains(expected));
        let found = found.unwrap_or_else(|| panic!("{to}: {problems:#?}"));
        assert_eq!(found.line, line, "{to}");
    }
    for (from, to, expected) in [
        (
            clamp,
            "{ mesh = \"meshes/clamp.obj\", box = \"1, 1, 1 cm\" }",
            "exactly one of `box`, `cylinder`, `capsule`, `sphere` and `mesh`",
        ),
        ("density = \"2.7 g/cm^3\"", "density = \"2.7 g/cm^3\"\nmass = \"1 kg\"", "needs either `mass` or `density`"),
        ("density = \"2.7 g/cm^3\"", "", "`clamp` needs either `mass` or `density`"),
    ] {
        let problems = read(&valid.replacen(from, to, 1)).unwrap_err();
        assert!(problems.iter().any(|problem| problem.what.contains(expected)), "{to}: {problems:#?}");
    }
}

#[test]
fn broken_files_are_problems_of_the_task() {
    let clamp = || String::from_utf8(find("meshes/clamp.obj").unwrap()).unwrap();
    let with = |content: Vec<u8>| {
        let read = FileTask::read_with(&text(), &mut |name| match name {
            "meshes/clamp.obj" => Ok(content.clone()),
            _ => find(name),
        });
        read.unwrap_err().iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
    };
    let face = clamp().lines().position(|line| line.starts_with("f ")).unwrap() + 1;
    for (content, expected) in [
        (clamp().replacen("f 1 ", "f 99 ", 1).into_bytes(), format!("line {face}: the face names the vertex `99`")),
        (clamp().replacen("f 1 ", "# f 1 ", 1).into_bytes(), "its surface is not closed".to_owned()),
        (clamp().replacen(" -23 ", " x ", 1).into_bytes(), "line 2: `x` is not a number".to_owned()),
        (b"version https://git-lfs.github.com/spec/v1\n".to_vec(), "a pointer of Git LFS".to_owned()),
        (vec![0; MOST_FILE_BYTES], "the files of the task have more than 2 MiB".to_owned()),
    ] {
        let found = with(content);
        assert!(found.contains("line 24: meshes/clamp.obj: ") && found.contains(&expected), "{expected}: {found}");
    }
}

/// Pages and cameras show the meshes, not their pieces.
#[test]
fn meshes_are_drawn() {
    let task = read(&text()).unwrap();
    let mut environment = environment(&task, EngineKind::Mujoco, "franka");
    environment.record_trajectory(Some(0.1));
    let mut expert = task.controller(EngineKind::Mujoco.robot("franka").robot, environment.engine().chain().clone());
    rollout(&mut environment, &mut *expert, &scenario(0, &[]));
    let trajectory = environment.take_trajectory().unwrap();
    let drawn: Vec<(&str, usize, [u8; 3])> = trajectory
        .solids
        .iter()
        .filter_map(|solid| match &solid.shape {
            SolidShape::Mesh { triangles } => Some((&*trajectory.bodies[solid.body], triangles.len(), solid.color)),
            _ => None,
        })
        .filter(|(body, ..)| !body.starts_with("robot/"))
        .collect();
    assert_eq!(drawn.len(), 2, "{drawn:?}");
    assert_eq!((drawn[0].0, drawn[0].1), ("bed.1", 48));
    assert_eq!(drawn[1], ("object", 104, [200, 60, 40]));
}

/// Only an engine of this process simulates meshes.
#[test]
fn remote_engines_are_refused_by_name() {
    let why = ArmTask::only_here(&read(&text()).unwrap()).unwrap();
    assert!(why.contains("meshes") && why.contains("--engine mujoco"), "{why}");
}
