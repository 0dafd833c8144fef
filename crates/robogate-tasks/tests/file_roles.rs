//! Settings, roles, derived numbers and named conditions of tasks from files.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use robogate_core::{Assignment, Environment, Outcome, Scenario, Value, check_applied, rollout};
use robogate_tasks::file::FileTask;
use robogate_tasks::{ArmDeclaration, ArmEnvironment, ArmTask, Rig};

use common::{EngineKind, Idle, scenario, stacking};

fn environment(task: &dyn ArmTask) -> ArmEnvironment {
    task.on(EngineKind::Mujoco.robot("franka").engine(), Rig { picture_px: [16; 2], ..Rig::default() }).unwrap()
}

/// Two cubes that fall; the first one to be named `upper` starts higher.
const FALL: &str = r#"
format = "robogate-task/1"
name = "fall"
instruction = "let {upper} fall"
time_limit = "1 s"

[[part]]
name = "red"
at = "60, 20, 12 cm"
mass = "200 g"
shapes = [{ box = "4, 4, 4 cm" }]

[[part]]
name = "blue_cube"
at = "60, -20, 12 cm"
mass = "200 g"
shapes = [{ box = "4, 4, 4 cm" }]

[choice]
name = "who"
roles = "upper, lower"
nominal = "red"
words = { red = "red, blue_cube", blue = "blue_cube, red" }

[[parameter]]
name = "edge_m"
range = "2, 6 cm"
nominal = "4 cm"

[[set]]
numbers = "red.size, blue_cube.size"
to = "{edge_m}"

[[set]]
numbers = "upper.mass"
to = "{edge_m} / 1 cm * 1 kg"

[[set]]
numbers = "upper.at.z"
to = "{drop_m}"

[[setting]]
name = "drop_m"
range = "20, 60 cm"
default = "40 cm"
meaning = "Height of the start."

[[condition]]
name = "landed"
when = "supported(upper) or height(upper) < {edge_m}"

[success]
when = "time() > 5 s"

[[failure]]
name = "low"
when = "landed"
at_limit = true

[[measure]]
name = "fall_s"
value = "first landed"

[[measure]]
name = "height_m"
value = ["final height(upper) when not landed", "final 0 m when time() > 2 s"]
"#;

#[test]
fn settings_words_and_derived_numbers_act() {
    let task = FileTask::read(FALL).unwrap();
    assert!(!ArmTask::settings(&task).iter().any(|spec| spec.meaning.is_empty()));
    let drops = |settings: &[(&str, f64)], word: &str| {
        let chosen: Assignment = settings.iter().map(|(name, value)| ((*name).into(), Value::Number(*value))).collect();
        let task = task.with(&chosen).unwrap();
        let mut environment = environment(&*task);
        let mut scenario = scenario(0, &[("edge_m", 0.05)]);
        scenario.requested.set("who", Value::Category(word.into()));
        let start = environment.reset(&scenario).unwrap();
        check_applied(&scenario.requested, &start.applied).unwrap();
        assert_eq!(start.instance.instruction, if word == "red" { "let red fall" } else { "let blue cube fall" });
        let read = environment.engine().read_back().unwrap();
        let masses = [read.mass_kg, read.others[0].mass_kg];
        assert_eq!(masses, if word == "red" { [5.0, 0.2] } else { [0.2, 5.0] });
        let episode = rollout(&mut environment, &mut Idle::default(), &scenario);
        let Outcome::Failure(mode) = episode.outcome else { panic!("{:?}", episode.outcome) };
        assert_eq!(mode.as_str(), "low");
        (episode.measures.get("fall_s").unwrap(), episode.measures.get("height_m").unwrap())
    };
    // A fall of h takes sqrt(2 h / g).
    for word in ["red", "blue"] {
        for (settings, height) in [(&[][..], 0.4), (&[("drop_m", 0.25)], 0.25)] {
            let (fall_s, last_m) = drops(settings, word);
            let expected = (2.0 * (height - 0.05_f64) / 9.81).sqrt();
            assert!((fall_s - expected).abs() < 0.01, "{word} from {height} m: {fall_s} s, not {expected} s");
            assert!((0.04..0.06).contains(&last_m), "{last_m}");
        }
    }
    let refused =
        |name: &str, value: f64| task.with(&[(name.into(), Value::Number(value))].into_iter().collect()).err().unwrap();
    assert!(refused("drop_m", 0.9).contains("drop_m"));
    assert!(refused("dorp_m", 0.3).contains("drop_m"));
}

/// A tampered value is found through the numbers that follow from it.
#[test]
fn every_word_and_number_is_read_back() {
    let mut environment = environment(stacking());
    for word in ["abc", "cab"] {
        let mut scenario = scenario(2, &[("size_m", 0.06), ("mass_step", 1.7), ("position_jitter_m", 0.01)]);
        scenario.requested.set("order", Value::Category(word.into()));
        let start = environment.reset(&scenario).unwrap();
        check_applied(&scenario.requested, &start.applied).unwrap();
    }
    let unknown = Scenario {
        requested: [("order".into(), Value::Category("abd".into()))].into_iter().collect(),
        ..scenario(0, &[])
    };
    assert!(environment.reset(&unknown).unwrap_err().detail.contains("order"));
}

#[test]
fn problems_of_roles_and_settings_have_lines() {
    for (from, to, expected) in [
        ("blue = \"blue_cube, red\"", "blue = \"blue_cube\"", "has 1 parts for 2 roles"),
        ("blue = \"blue_cube, red\"", "blue = \"blue, red\"", "unknown part `blue`"),
        ("nominal = \"red\"", "nominal = \"green\"", "`green` is not one of the words"),
        ("roles = \"upper, lower\"", "roles = \"upper, red\"", "a second body or role `red`"),
        ("numbers = \"upper.mass\"", "numbers = \"uper.mass\"", "unknown body `uper`: did you mean `upper`?"),
        ("numbers = \"upper.mass\"", "numbers = \"red.size\"", "a second value for `red.size`"),
        ("to = \"{drop_m}\"", "to = \"2 kg\"", "the number does not fit. Expected a length"),
        ("name = \"drop_m\"", "name = \"drop_kg\"", "`drop_kg` ends with the unit kg, but its value is in m"),
        ("name = \"drop_m\"", "name = \"edge_m\"", "a second parameter or setting `edge_m`"),
        ("name = \"drop_m\"", "name = \"time_limit_s\"", "a second parameter or setting `time_limit_s`"),
        ("default = \"40 cm\"", "default = \"4 cm\"", "out of range. Expected 0.2 to 0.6 m"),
        ("value = \"first landed\"", "value = \"first landd\"", "unknown condition `landd`: did you mean `landed`?"),
        ("\"final 0 m when time() > 2 s\"", "\"final 0 kg\"", "the values do not fit"),
        ("let {upper} fall", "let {uppr} fall", "unknown parameter `uppr`"),
        ("time_limit = \"1 s\"", "time_limit = \"1 s\"\nspace = \"stackin\"", "unknown parameter space `stackin`"),
        ("time_limit = \"1 s\"", "time_limit = \"1 s\"\nforesight = \"stack\"", "`stack` needs a parameter or setting"),
    ] {
        assert!(FALL.contains(from), "{from}");
        let problems = FileTask::read(&FALL.replacen(from, to, 1)).unwrap_err();
        assert!(problems.iter().any(|problem| problem.what.contains(expected)), "{to}: {problems:#?}");
    }
}

/// A task without joints, motions and contacts between named bodies runs everywhere.
#[test]
fn tasks_without_contacts_run_in_other_processes() {
    assert_eq!(ArmTask::only_here(&FileTask::read(FALL).unwrap()), None);
    let touching = FALL.replacen("supported(upper)", "contact(upper, table)", 1);
    assert!(ArmTask::only_here(&FileTask::read(&touching).unwrap()).unwrap().contains("--simulator"));
    assert_eq!(ArmTask::only_here(stacking()), None);
    assert_eq!(stacking().suite(), Some("stacking-40"));
}
