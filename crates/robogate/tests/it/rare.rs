//! Tests of `robogate rare`.

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::verb;

const RARE: &str = "rare --task pendulum --event overspeed --seed 2";

#[test]
fn rare_event_is_estimated() {
    let dir = TempDir::new().unwrap();
    let question =
        "rare --task pendulum --event fell --seed 2 --margin peak_speed_rad_s --episodes 600 --target 1e-2 --check 200";
    let text = verb(dir.path(), &format!("{question} --json --threads 2"), 0, &[]);
    let answer: Value = serde_json::from_str(&text).unwrap();
    let number = |name: &str| answer[name].as_f64().unwrap();
    assert!(number("episodes") <= 800.0 && answer["reached"] == true, "{answer:#}");
    let [low, high] = [0, 1].map(|at| answer["interval_95"][at].as_f64().unwrap());
    assert!(low < number("probability") && number("probability") < high, "{answer:#}");
    assert_eq!(answer["check"]["agrees"], true, "{answer:#}");
    // The probabilities of the levels fall to that of the event.
    let levels: Vec<f64> =
        answer["levels"].as_array().unwrap().iter().map(|level| level["probability"].as_f64().unwrap()).collect();
    assert!(levels.is_sorted_by(|a, b| a >= b) && levels.last().copied() == Some(number("probability")));
    // The answer does not depend on the number of threads.
    let again: Value =
        serde_json::from_str(&verb(dir.path(), &format!("{question} --json --threads 1"), 0, &[])).unwrap();
    assert_eq!(again, answer);
    verb(dir.path(), question, 0, &["P(fell) = ", "coefficient of variation", "modes may be missed", "they agree"]);
}

#[test]
fn bare_events_are_refused() {
    let dir = TempDir::new().unwrap();
    verb(dir.path(), RARE, 2, &["bare yes or no", "--margin", "peak_speed_rad_s"]);
    verb(dir.path(), &format!("{RARE} --margin nonsense"), 2, &["not a measure", "peak_speed_rad_s"]);
    verb(dir.path(), "rare --task pendulum --event fire", 2, &["no such failure mode", "overspeed"]);
    verb(dir.path(), &format!("{RARE} --margin energy_j --target 2"), 2, &["--target 2"]);
}
