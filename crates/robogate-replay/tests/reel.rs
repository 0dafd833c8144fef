//! Reels hold what was recorded, share solids, keep to the budget of meshes, and escape markup.

use robogate_core::{
    Assignment, ContactBetween, ContactPoint, Episode, Frame, Measures, Outcome, Pose, Scenario, Seed, Solid,
    SolidShape, Trajectory,
};
use robogate_replay::{Clip, Clock, FilmFrame, MESH_BUDGET_BYTES, Mark, Recording, Signal, reel};
use serde_json::Value;

fn solid(shape: SolidShape) -> Solid {
    Solid { body: 0, shape, pose: Pose::upright([0.1, 0.2, 0.3], 0.5), color: [10, 20, 30], opacity: 1.0 }
}

fn clip(title: &str, solids: Vec<Solid>) -> Clip {
    let frame = |i: u32| Frame {
        time_s: f64::from(i) / 30.0,
        poses: vec![Pose::upright([0.01 * f64::from(i), -0.2, 0.5], 0.02 * f64::from(i))],
        contacts: vec![ContactPoint {
            position: [0.1, 0.0, 0.0],
            force_n: [0.0, 0.0, 3.0],
            between: ContactBetween::RobotAndObject,
        }],
    };
    let episode = Episode {
        scenario: Scenario { index: 3, seed: Seed::campaign(1).episode(3), requested: Assignment::default() },
        applied: Assignment::default(),
        outcome: Outcome::Success,
        time_s: 1.0,
        phase: None,
        contact: None,
        measures: Measures::default(),
        draws: Default::default(),
        ticks: 2,
        trajectory_hash: 1,
    };
    let values = vec![None, Some(0.25)];
    Clip {
        title: title.to_owned(),
        outcome: "success".to_owned(),
        success: true,
        parameters: vec![("mass".to_owned(), "1 kg".to_owned())],
        command: "robogate replay run 3".to_owned(),
        recording: Recording {
            episode,
            trajectory: Some(Trajectory {
                bodies: vec!["part".to_owned()],
                solids,
                frames: (0..30).map(frame).collect(),
            }),
            tick_s: vec![0.5, 1.0],
            signals: vec![Signal { name: "slip".to_owned(), unit: "m".to_owned(), clock: Clock::Ticks, values }],
            phases: vec![Mark { time_s: 0.0, what: "LIFT".to_owned() }],
            events: vec![Mark { time_s: 0.5, what: "object held".to_owned() }],
        },
        film: Vec::new(),
    }
}

#[test]
fn clips_share_solids() {
    let sphere = || solid(SolidShape::Sphere { radius: 0.05 });
    let made = reel(&[clip("one", vec![sphere()]), clip("two", vec![sphere()])]);
    let document: Value = serde_json::from_str(&made.json).unwrap();
    assert_eq!(document["clips"][0]["solids"], document["clips"][1]["solids"]);
    assert_eq!(document["clips"][0]["frames"], 30);
    assert_eq!(document["clips"][0]["events"][0]["what"], "object held");
    assert_eq!(made, reel(&[clip("one", vec![sphere()]), clip("two", vec![sphere()])]), "equal clips, equal bytes");
}

#[test]
fn films_are_part_of_the_document() {
    let mut filmed = clip("filmed", Vec::new());
    filmed.film = vec![FilmFrame { time_ms: 1250, jpeg: vec![0xff, 0xd8, 0xff] }];
    let document: Value = serde_json::from_str(&reel(&[filmed]).json).unwrap();
    assert_eq!(document["clips"][0]["film"], serde_json::json!([[1.25, "/9j/"]]));
}

#[test]
fn markup_is_escaped() {
    let made = reel(&[clip("</script><script>alert(1)", Vec::new())]);
    assert!(!made.json.contains('<'), "{}", made.json);
    let document: Value = serde_json::from_str(&made.json).unwrap();
    assert_eq!(document["clips"][0]["title"], "</script><script>alert(1)");
}

/// A mesh of triangles side by side, the first of them at a height.
fn strip(triangles: usize, height: f32) -> Solid {
    let triangle = |i: usize| {
        let x = 0.001 * i as f32;
        [[x, 0.0, height], [x, 0.1, height], [x, 0.0, height + 0.2]]
    };
    solid(SolidShape::Mesh { triangles: (0..triangles).map(triangle).collect() })
}

#[test]
fn meshes_beyond_the_budget_have_fewer_triangles() {
    let small = reel(&[clip("small", vec![strip(100, 0.0)])]);
    let large = reel(&[clip("large", vec![strip(MESH_BUDGET_BYTES / 40, 0.0)])]);
    assert_eq!((small.simplified, large.simplified), (0, 0));
    assert!(large.json.len() < MESH_BUDGET_BYTES, "{} bytes", large.json.len());
    assert_ne!(large, reel(&[clip("large", vec![strip(MESH_BUDGET_BYTES / 40 + 4000, 0.0)])]));
}

#[test]
fn too_many_meshes_become_boxes() {
    let mut meshes: Vec<Solid> = (0..20_000_u16).map(|i| strip(1, 0.01 * f32::from(i))).collect();
    let made = reel(&[clip("many", meshes.clone())]);
    assert!((1..20_000).contains(&made.simplified), "{}", made.simplified);
    // Equal solids are stored once.
    meshes.extend(meshes.clone());
    assert_eq!(reel(&[clip("many", meshes)]).simplified, made.simplified);
}
