//! Networks with memory and with a history of observations, compared with ONNX Runtime step by step (networks/networks.py).

mod support;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use robogate_core::{Command, Observation, Policy, PredictedStep, Seed, TaskInstance, vectors};
use robogate_policy::{ExternalPolicy, Profile};
use support::{begin, observation, task};

const GRU: &str = include_str!("networks/gru.toml");
const HISTORY: &str = include_str!("networks/history.toml");
/// Actions of an episode in networks.py.
const STEPS: usize = 8;

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/networks").join(name)
}

/// The LSTM has three memories, of which one is an integer, and executes two actions of each chunk.
fn lstm() -> String {
    let more = "\n[[memory]]\ninput = \"c0\"\noutput = \"c1\"\n\n[[memory]]\ninput = \"n0\"\noutput = \"n1\"\n";
    GRU.replace("execute = 1", "execute = 2").replacen("\n[action]", &format!("{more}\n[action]"), 1)
}

fn load(name: &str, profile: &str) -> Result<ExternalPolicy, String> {
    let profile = Profile::from_toml(profile).expect("a good profile");
    let path = file(&format!("{name}.onnx")).display().to_string();
    ExternalPolicy::connect(&path, Arc::new(profile)).map_err(|error| error.to_string())
}

/// What the model sees at an action; see `step_state` and `step_image` in networks.py.
fn seen(step: usize) -> Observation {
    let mut observation = observation(96);
    for (name, values) in &mut observation.vectors {
        match *name {
            vectors::JOINT_POSITIONS => {
                *values = (1..=7).map(|joint| 0.05 * (step + 1) as f64 * f64::from(joint)).collect();
            }
            vectors::GRIPPER_OPENING => *values = vec![0.08 - 0.01 * step as f64],
            _ => {}
        }
    }
    for image in &mut observation.images {
        image.rgb.iter_mut().for_each(|byte| *byte = byte.wrapping_add((40 * step) as u8));
    }
    observation
}

/// The joint commands of an episode of this length.
fn episode(policy: &mut ExternalPolicy, steps: usize) -> Vec<Vec<f64>> {
    begin(policy, "pick up the box").expect("nothing to begin");
    let joints = |step| match policy.act(&seen(step)).expect("it answers").command {
        Command::JointPosition(joints) => joints,
        other => panic!("{other:?}"),
    };
    (0..steps).map(joints).collect()
}

fn bits(episode: &[Vec<f64>]) -> Vec<u64> {
    episode.iter().flatten().map(|q| q.to_bits()).collect()
}

fn agrees_with_onnx_runtime(name: &str, profile: &str) {
    let text = std::fs::read_to_string(file("expected.json")).expect("it lies there");
    let mut all: serde_json::Value = serde_json::from_str(&text).expect("it is JSON");
    let expected: Vec<Vec<f64>> = serde_json::from_value(all[name].take()).expect("rows of numbers");
    let executed = episode(&mut load(name, profile).expect("it loads"), STEPS);
    assert_eq!(executed.len(), expected.len());
    for (step, (ours, theirs)) in executed.iter().zip(&expected).enumerate() {
        // The last number is for the gripper.
        for (ours, theirs) in ours.iter().zip(&theirs[..7]) {
            assert!((ours - theirs).abs() < 1e-5 * theirs.abs().max(1.0), "{name}, step {step}: {ours} {theirs}");
        }
    }
}

#[test]
fn gru_agrees_with_onnx_runtime() {
    agrees_with_onnx_runtime("gru", GRU);
}

#[test]
fn lstm_agrees_with_onnx_runtime() {
    agrees_with_onnx_runtime("lstm", &lstm());
}

#[test]
fn history_agrees_with_onnx_runtime() {
    agrees_with_onnx_runtime("history", HISTORY);
}

#[test]
fn episodes_do_not_share_memory() {
    let lstm = lstm();
    for (name, profile) in [("gru", GRU), ("lstm", lstm.as_str()), ("history", HISTORY)] {
        let mut policy = load(name, profile).expect("it loads");
        let first = bits(&episode(&mut policy, STEPS));
        // The third one follows an interrupted episode.
        for steps in [STEPS, 3, STEPS] {
            assert_eq!(bits(&episode(&mut policy, steps)), first[..7 * steps], "{name}");
        }
    }
}

#[test]
fn threads_do_not_share_memory() {
    let lstm = lstm();
    for (name, profile) in [("gru", GRU), ("lstm", lstm.as_str()), ("history", HISTORY)] {
        let first = bits(&episode(&mut load(name, profile).expect("it loads"), STEPS));
        // All networks answer in turn, each in its own episode.
        let mut policies: Vec<ExternalPolicy> = (0..4).map(|_| load(name, profile).expect("it loads")).collect();
        let mut commands = vec![Vec::new(); policies.len()];
        policies.iter_mut().for_each(|policy| begin(policy, "pick up the box").expect("nothing to begin"));
        for step in 0..STEPS {
            std::thread::scope(|scope| {
                for (policy, commands) in policies.iter_mut().zip(&mut commands) {
                    scope.spawn(move || match policy.act(&seen(step)).expect("it answers").command {
                        Command::JointPosition(joints) => commands.push(joints),
                        other => panic!("{other:?}"),
                    });
                }
            });
        }
        assert!(commands.iter().all(|commands| bits(commands) == first), "{name}");
    }
}

#[test]
fn memory_changes_the_actions() {
    let mut policy = load("gru", GRU).expect("it loads");
    policy.begin("pick up the box").expect("nothing to begin");
    let first = policy.infer(&seen(0)).expect("it answers");
    assert_ne!(policy.infer(&seen(0)).expect("it answers"), first);
    policy.begin("pick up the box").expect("nothing to begin");
    assert_eq!(policy.infer(&seen(0)).expect("it answers"), first);
}

#[test]
fn the_record_names_the_memory() {
    let declared = load("gru", GRU).expect("it loads").declared().to_string();
    assert!(declared.contains("\"memory\":[{\"input\":\"h0\",\"output\":\"h1\"}]"), "{declared}");
}

#[test]
fn wrong_declarations_are_explained() {
    let lstm = lstm();
    let cases = [
        (
            "gru",
            GRU,
            "input = \"h0\"",
            "input = \"h9\"",
            "memory.input `h9` is not an input of the network, which has state, h0. Hint",
        ),
        (
            "gru",
            GRU,
            "output = \"h1\"",
            "output = \"h9\"",
            "memory.output `h9` is not an output of the network, which has h1, actions",
        ),
        (
            "gru",
            GRU,
            "[[memory]]\ninput = \"h0\"\noutput = \"h1\"\n",
            "",
            "the network has an input `h0`, but the profile sends state. Hint",
        ),
        (
            "gru",
            GRU,
            "output = \"h1\"",
            "output = \"actions\"",
            "the memory `h0` takes [1, 1, 16] F32, but the output `actions` is [1, 2, 8] F32. Expected the same shape and type",
        ),
        (
            "lstm",
            lstm.as_str(),
            "output = \"n1\"",
            "output = \"actions\"",
            "the memory `n0` takes [1] I64, but the output `actions` is [1, 2, 8]",
        ),
        (
            "history",
            HISTORY,
            "history = [-2, -1, 0]",
            "history = [-1, 0]",
            "the profile sends `state` with shape [2, 8], but the network takes [1, 3, 8]",
        ),
        (
            "history",
            HISTORY,
            "[action]",
            "[[memory]]\ninput = \"m\"\noutput = \"actions\"\n\n[action]",
            "memory.input `m` is not an input of the network",
        ),
    ];
    for (name, profile, from, to, part) in cases {
        let changed = profile.replacen(from, to, 1);
        assert_ne!(changed, profile, "{from}");
        let why = load(name, &changed).and_then(|mut policy| {
            policy.begin("pick up the box").and_then(|()| policy.infer(&seen(0))).map_err(|error| error.to_string())
        });
        let why = why.expect_err(part);
        // At loading, or with the first observation.
        let known = why.starts_with("profile mismatch: ") || why.starts_with("observation: ");
        assert!(known && why.contains(part), "expected {part:?} in {why:?}");
    }
    // All outputs are memories.
    let small = include_str!("networks/small.toml");
    let none_left = small.replacen("[action]", "[[memory]]\ninput = \"state\"\noutput = \"actions\"\n\n[action]", 1);
    let none_left = none_left.replacen(
        "[[state]]\nkey = \"state\"\nparts = [\"joint_positions\", \"gripper_opening\"]\ntype = \"<f4\"\n",
        "",
        1,
    );
    let why = load("small", &none_left).expect_err("no actions");
    assert!(why.contains("all outputs of the network (actions) are memories"), "{why}");
}

/// With latency the history is that of control periods: without a delay, a network sees the same as without latency.
#[test]
fn history_continues_with_latency() {
    let mut policy = load("history", HISTORY).expect("it loads");
    let expected = episode(&mut policy, STEPS);
    policy.reset(&task(), &TaskInstance::default(), Seed::campaign(1)).expect("nothing to begin");
    assert!(policy.observes_images());
    let mut joints = |step: usize| {
        policy.observe(&seen(step)).expect("it is kept");
        // The first action of a chunk is executed in each mode.
        let prediction = policy.predict(&seen(step)).expect("it answers");
        let Some(PredictedStep::Numbers(numbers)) = prediction.steps.first() else { panic!("{prediction:?}") };
        match policy.perform(Some(numbers), &seen(step)).expect("a valid action").command {
            Command::JointPosition(joints) => joints,
            other => panic!("{other:?}"),
        }
    };
    let found: Vec<Vec<f64>> = (0..STEPS).map(&mut joints).collect();
    // Without latency a request is made for every second action.
    assert_eq!(found.iter().step_by(2).collect::<Vec<_>>(), expected.iter().step_by(2).collect::<Vec<_>>());
    assert_ne!(found[2], found[4]);
}
