//! Entries for tests: typical ones and edge cases.

use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock};

use robogate_core::{
    Assignment, Contact, Episode, FailureMode, Fault, FaultKind, Outcome, ParameterSpace, Scenario, Seed, Stream,
    TaskSpec, Value, Word,
};
use robogate_dictionary::{Engine, Entry, Label, Platform, Provenance, Robot, SCHEMA_VERSION, Tool, v1};

pub(crate) const SEED: u64 = 2026;

/// The SHA-256 of the plan of journals.
pub(crate) const PLAN: [u8; 32] = [7; 32];

/// A task that is unrelated to the built-in one.
static TASK: LazyLock<Arc<TaskSpec>> = LazyLock::new(|| {
    let task = serde_json::from_str(
        r#"{
            "name": "press_fit",
            "version": 3,
            "instruction": "press the pin into the bore",
            "control_period_s": 0.02,
            "time_limit_s": 6.0,
            "failure_modes": [
                { "name": "jammed", "meaning": "The pin stuck on its way.", "severity": "major" },
                { "name": "tilted" },
                { "name": "bore.damaged", "severity": "critical" }
            ],
            "measures": [
                { "name": "peak_force_n", "unit": "N", "better": "lower" },
                { "name": "depth_m", "unit": "m", "better": "higher" },
                { "name": "tilt_rad", "unit": "rad" }
            ],
            "phases": ["approach", "press", "retract"]
        }"#,
    );
    Arc::new(task.unwrap())
});

static PICK_PLACE: LazyLock<Arc<TaskSpec>> = LazyLock::new(|| Arc::new(v1::task()));

pub(crate) fn task() -> Arc<TaskSpec> {
    Arc::clone(&TASK)
}

/// The implied task of dictionaries with schema 1.
pub(crate) fn pick_place() -> Arc<TaskSpec> {
    Arc::clone(&PICK_PLACE)
}

pub(crate) fn space() -> ParameterSpace {
    ParameterSpace::from_toml(
        r#"
        name = "test"
        [[parameter]]
        name = "friction"
        kind = "continuous"
        low = 0.05
        high = 1.2
        scale = "log"
        [[parameter]]
        name = "mass_kg"
        kind = "continuous"
        low = 0.05
        high = 2.0
        scale = "log"
        [[parameter]]
        name = "obstacles"
        kind = "integer"
        low = 0
        high = 5
        [[parameter]]
        name = "shape"
        kind = "categorical"
        choices = ["box", "cylinder", "sphere", "irregular"]
        "#,
    )
    .unwrap()
}

pub(crate) fn provenance() -> Provenance {
    provenance_of(task())
}

pub(crate) fn provenance_of(task: Arc<TaskSpec>) -> Provenance {
    Provenance {
        task,
        tool: Tool::robogate(),
        schema_version: SCHEMA_VERSION,
        build: None,
        engine: Engine {
            name: "mujoco".to_owned(),
            version: Some("3.17.0".to_owned()),
            build_sha256: Some("ab".repeat(32)),
        },
        robot: Robot { name: "franka".to_owned(), sha256: Some("cd".repeat(32)), dimensions: None },
        policy: "scripted".to_owned(),
        world: None,
        space: space(),
        plan: serde_json::json!({ "stages": [{ "name": "uniform", "n": 100 }] }),
        seed: SEED,
        question_sha256: None,
        platform: Some(Platform::here()),
        source: None,
    }
}

/// Episode `index` of [`task`].
pub(crate) fn entry(index: u64) -> Entry {
    entry_of(&task(), index)
}

/// Episode `index` of `task`, partly random from its seed. Every kind of outcome occurs among a few episodes.
pub(crate) fn entry_of(task: &TaskSpec, index: u64) -> Entry {
    let modes: Vec<FailureMode> = task.modes().collect();
    let seed = Seed::campaign(SEED).episode(index);
    let mut stream = seed.stream("test");
    let requested = draw(&mut stream);
    let mut applied = requested.clone();
    let mass = requested.number("mass_kg").unwrap();
    // Read back in single precision, like from an engine.
    applied.set("mass_kg", Value::Number(f64::from(mass as f32)));
    let outcome = match index % 7 {
        0..=2 => Outcome::Success,
        n @ 3..=5 => Outcome::Failure(modes[n as usize - 3]),
        _ if index.is_multiple_of(2) => Outcome::Failure(FailureMode::TIMEOUT),
        _ => {
            applied = Assignment::default();
            Outcome::Invalid(Fault::new(FaultKind::Setup, "object \"starts\" in contact,\nwith the table"))
        }
    };
    let contact = (outcome == Outcome::Failure(modes[2])).then(|| Contact {
        robot_body: "link5".to_owned(),
        other_body: "obstacle_2".to_owned(),
        force_n: stream.between(0.1, 200.0),
    });
    Entry {
        stage: if index < 1000 { "uniform" } else { "boundary" }.to_owned(),
        design: "latin_hypercube".to_owned(),
        weight: if index < 1000 { 1.0 } else { stream.between(0.0, 3.0) },
        label: match index % 4 {
            0 => Label {
                case: Some(format!("heavy-{}", index % 3)),
                category: Some("edge_cases".to_owned()),
                group: Some("heavy_objects".to_owned()),
            },
            1 => Label { group: Some(String::new()), ..Label::default() },
            _ => Label::default(),
        },
        episode: Episode {
            scenario: Scenario { index, seed, requested },
            applied,
            outcome,
            time_s: stream.between(0.0, 15.0),
            phase: task.phases.get((index % 8) as usize).copied(),
            contact,
            // The last measure always has a value.
            measures: (1..)
                .zip(&task.measures)
                .map(|(i, measure)| {
                    let value = stream.between(0.0, 0.5);
                    (measure.name, (i == task.measures.len() || !index.is_multiple_of(i as u64 + 1)).then_some(value))
                })
                .collect(),
            draws: Default::default(),
            ticks: stream.below(300) as u32,
            trajectory_hash: stream.bits(),
        },
    }
}

pub(crate) fn draw(stream: &mut Stream) -> Assignment {
    let space = space();
    let parameters = space.parameters().iter();
    parameters
        .map(|parameter| {
            let coded = parameter.domain.from_unit(stream.uniform());
            (Arc::clone(&parameter.name), parameter.domain.decode(coded))
        })
        .collect()
}

/// An entry that no normal campaign creates, but that must be recordable.
pub(crate) fn strange_entry(index: u64) -> Entry {
    let mut entry = entry(index);
    let episode = &mut entry.episode;
    episode.scenario.requested.set("friction", Value::Number(-0.0));
    episode.applied = [
        ("shape", Value::Category("".into())),
        ("friction", Value::Number(f64::NAN)),
        ("mass_kg", Value::Number(f64::NEG_INFINITY)),
        ("obstacles", Value::Number(-0.0)),
        ("gravity", Value::Number(f64::MIN_POSITIVE / 4.0)),
        ("colour", Value::Category("\u{1F916} \"'\0,\n".into())),
        ("count", Value::Integer(i64::MIN)),
    ]
    .into_iter()
    .map(|(name, value)| (name.into(), value))
    .collect();
    episode.outcome = Outcome::Invalid(Fault::new(FaultKind::NotApplied, ""));
    episode.time_s = f64::INFINITY;
    episode.contact = Some(Contact { robot_body: String::new(), other_body: "é".to_owned(), force_n: f64::NAN });
    episode.measures.set(Word::constant("peak_force_n"), Some(f64::NAN));
    episode.measures.set(Word::constant("depth_m"), Some(-0.0));
    episode.ticks = u32::MAX;
    episode.trajectory_hash = u64::MAX;
    entry
}

/// Bitwise equality: NaN equals NaN, and -0.0 differs from 0.0.
pub(crate) fn same(a: &Entry, b: &Entry) -> bool {
    // The Debug format writes the sign and the shortest distinguishing digits of a double, also for NaN.
    format!("{a:?}") == format!("{b:?}")
}

/// A temporary folder of one test.
pub(crate) struct Folder(PathBuf);

impl Folder {
    pub(crate) fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("robogate-dictionary-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub(crate) fn join(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    pub(crate) fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
