//! Tests of the layout of a dataset on disk, with an independent Parquet reader.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};
use std::fs::{self, File};

use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::RowAccessor;
use robogate_core::{Action, Command, Fault, Image, Observation, Policy, Pose, Seed, TaskInstance, TaskSpec, vectors};
use robogate_demos::{Dataset, DatasetError, Demonstration, Recorder};
use robogate_physics::{Engine, MujocoEngine, built_in_robot};
use robogate_tasks::ArmDeclaration;
use robogate_tasks::pick_place::PickPlace;
use robogate_tasks::pick_place::spec::{Briefing, spec};

/// An expert that keeps moving the first joint.
struct Onward;

impl Policy for Onward {
    fn check(&self, _: &TaskSpec) -> Result<(), String> {
        Ok(())
    }

    fn reset(&mut self, _: &TaskSpec, _: &TaskInstance, _: Seed) -> Result<(), Fault> {
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        let mut joints = observation.joint_positions().to_vec();
        joints[0] += 0.01;
        Ok(Action { command: Command::JointPosition(joints), gripper: Some(Action::OPEN), phase: None })
    }
}

const READY: [f64; 7] = [0.0, -FRAC_PI_4, 0.0, -3.0 * FRAC_PI_4, 0.0, FRAC_PI_2, FRAC_PI_4];

fn instance() -> TaskInstance {
    let briefing = Briefing {
        shape: "box".to_owned(),
        object_extent_m: [0.05; 3],
        object_pose: Pose::upright([0.5, 0.0, 0.025], 0.0),
        target_pose: Pose::upright([0.4, 0.4, 0.0], 0.0),
        tolerance_m: 0.03,
        orientation_tolerance_rad: None,
        approach_speed_m_s: None,
    };
    briefing.instance()
}

fn demonstration(frames: usize, sigma_m: f64) -> (Demonstration, Vec<Action>) {
    let robot = built_in_robot("franka").unwrap();
    let task = spec(&robot, Vec::new(), &PickPlace::DEFAULT);
    let of = robot.clone();
    let chain = MujocoEngine::new(robot, 0.002).unwrap().chain().clone();
    let mut recorder = Recorder::new(
        Box::new(Onward),
        Box::new(move |instance| PickPlace::DEFAULT.first_part(instance, &of)),
        chain.clone(),
        READY.to_vec(),
        sigma_m,
    );
    recorder.reset(&task, &instance(), Seed::campaign(3).episode(1)).unwrap();
    let tool = chain.tcp_at(&READY);
    let q = tool.rotation.quaternion();
    let pose = Pose { position: tool.translation.vector.into(), orientation: [q.w, q.i, q.j, q.k] };
    let observation = Observation {
        time_s: 0.0,
        vectors: vec![
            (vectors::JOINT_POSITIONS, READY.to_vec()),
            (vectors::JOINT_VELOCITIES, vec![0.0; 7]),
            (vectors::GRIPPER_OPENING, vec![0.08]),
            (vectors::TOOL_POSE, pose.to_array().to_vec()),
        ],
        images: ["front", "wrist"]
            .map(|camera| Image {
                camera: camera.to_owned(),
                width: 4,
                height: 2,
                rgb: (0..24).map(|i| i * 10).collect(),
            })
            .into(),
    };
    let actions = (0..frames).map(|_| recorder.act(&observation).unwrap()).collect();
    (recorder.take(), actions)
}

#[test]
fn frames_round_trip() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("demos");
    let mut dataset = Dataset::create(&path, 20, "franka").unwrap();
    dataset.push(&demonstration(3, 0.0).0).unwrap();
    dataset.push(&demonstration(2, 0.0).0).unwrap();
    let written = dataset.finish().unwrap();
    assert_eq!((written.episodes, written.frames), (2, 5));

    let open = |name: &str| SerializedFileReader::new(File::open(path.join(name)).unwrap()).unwrap();
    let rows: Vec<_> =
        open("data/chunk-000/file-000.parquet").get_row_iter(None).unwrap().map(Result::unwrap).collect();
    let column = |name: &str| rows[0].get_column_iter().position(|(column, _)| column == name).unwrap();
    let longs = |name: &str| rows.iter().map(|row| row.get_long(column(name)).unwrap()).collect::<Vec<_>>();
    assert_eq!(longs("frame_index"), [0, 1, 2, 0, 1]);
    assert_eq!(longs("episode_index"), [0, 0, 0, 1, 1]);
    assert_eq!(longs("index"), [0, 1, 2, 3, 4]);
    let image = rows[4].get_group(column("observation.images.wrist")).unwrap();
    let mut png =
        png::Decoder::new(std::io::Cursor::new(image.get_bytes(0).unwrap().data().to_vec())).read_info().unwrap();
    let mut pixels = vec![0; png.output_buffer_size().unwrap()];
    png.next_frame(&mut pixels).unwrap();
    assert_eq!(pixels, (0..24).map(|i| i * 10).collect::<Vec<u8>>());
    let action = rows[0].get_list(column("action")).unwrap();
    assert_eq!(action.len(), 8);

    let info: serde_json::Value = serde_json::from_slice(&fs::read(path.join("meta/info.json")).unwrap()).unwrap();
    assert_eq!(info["codebase_version"], "v3.0");
    assert_eq!(info["features"]["observation.images.front"]["shape"], serde_json::json!([2, 4, 3]));
    assert_eq!(info["splits"]["train"], "0:2");
    // LeRobot's trainer makes an input of each feature of this kind, so the object's position has another name.
    let features = info["features"].as_object().unwrap();
    let mut inputs: Vec<&str> =
        features.keys().map(String::as_str).filter(|name| name.starts_with("observation")).collect();
    inputs.sort_unstable();
    assert_eq!(inputs, ["observation.images.front", "observation.images.wrist", "observation.state"]);
    assert!(features.contains_key("expert.object"));
    let stats: serde_json::Value = serde_json::from_slice(&fs::read(path.join("meta/stats.json")).unwrap()).unwrap();
    // Red is 0, 30, 60 ... 210 of 255 in every image.
    let red = stats["observation.images.front"]["mean"][0][0][0].as_f64().unwrap();
    assert!((red - 105.0 / 255.0).abs() < 1e-12, "{red}");
}

#[test]
fn label_excludes_the_push() {
    let (demonstration, actions) = demonstration(40, 0.02);
    let mut strayed = 0.0_f64;
    for (frame, action) in demonstration.frames.iter().zip(actions) {
        let Command::JointPosition(made) = action.command else { panic!("joint positions") };
        strayed = strayed.max(made.iter().zip(&frame.wanted).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max));
        // The expert advances by 0.01 rad from the arm position in its observation, which never contains the push.
        assert!((frame.wanted[6] - READY[6]).abs() < 0.2);
    }
    assert!(strayed > 0.005, "{strayed}");
}

#[test]
fn existing_folder_is_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    assert!(matches!(Dataset::create(folder.path(), 20, "franka"), Err(DatasetError::Exists(_))));
    let path = folder.path().join("demos");
    let mut dataset = Dataset::create(&path, 20, "franka").unwrap();
    dataset.push(&demonstration(1, 0.0).0).unwrap();
    // Another process would lose these episodes.
    assert!(matches!(Dataset::create(&path, 20, "franka"), Err(DatasetError::Locked(_))));
    let mut other = demonstration(1, 0.0).0;
    other.frames[0].pictures.pop();
    assert!(matches!(dataset.push(&other), Err(DatasetError::Episode { episode: 1, .. })));
    drop(dataset);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    // Remains of a killed process.
    fs::create_dir_all(folder.path().join(".demos.part/data/old")).unwrap();
    fs::write(folder.path().join(".demos.part/file"), "old").unwrap();
    drop(Dataset::create(&path, 20, "franka").unwrap());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    assert!(matches!(Dataset::create(&path, 20, "franka").unwrap().finish(), Err(DatasetError::Empty)));
}
