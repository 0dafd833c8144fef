//! End-to-end tests of runs with coarse episodes: the estimate, interruption, and the separation of both kinds of rows.

use std::fs;

use robogate_analysis::TwoFidelities;
use robogate_dictionary::{Dictionary, Fidelity};
use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{kill_after, verb};

const RUN: &str = "run --robot franka --coarse 0.5 -n 24 --seed 5";

/// The files of a run with coarse episodes.
const FILES: [&str; 6] = [
    "fidelity.json",
    "coarse/dictionary.parquet",
    "coarse/plan.json",
    "dictionary.parquet",
    "plan.json",
    "summary.json",
];

#[test]
fn coarse_rows_estimate_and_stay_apart() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    verb(at, &format!("{RUN} --out a"), 0, &["24 coarse episodes", "Fine and coarse episodes", "physics steps"]);
    let [fine, coarse] =
        ["a", "a/coarse"].map(|name| Dictionary::open(&at.join(name).join("dictionary.parquet")).unwrap());
    assert_eq!((fine.provenance().fidelity, coarse.provenance().fidelity), (Fidelity::Fine, Fidelity::Coarse));
    assert_eq!((fine.len(), coarse.len()), (12, 24));
    let rows = |dictionary: &Dictionary| dictionary.entries().collect::<Result<Vec<_>, _>>().unwrap();
    let (fine_rows, coarse_rows) = (rows(&fine), rows(&coarse));
    for (fine, coarse) in fine_rows.iter().zip(&coarse_rows) {
        assert_eq!((fine.fidelity, coarse.fidelity), (Fidelity::Fine, Fidelity::Coarse));
        assert_eq!(fine.episode.scenario, coarse.episode.scenario);
        assert_eq!(fine.episode.draws, coarse.episode.draws);
        assert_ne!(fine.episode.trajectory_hash, coarse.episode.trajectory_hash);
    }
    // The fine episodes are those of a run without coarse ones.
    let found: TwoFidelities = serde_json::from_slice(&fs::read(at.join("a/fidelity.json")).unwrap()).unwrap();
    assert_eq!((found.pairs + found.fine.invalid, found.coarse.episodes), (12, 24));
    let ticks = |rows: &[robogate_dictionary::Entry]| rows.iter().map(|row| u64::from(row.episode.ticks)).sum::<u64>();
    assert_eq!(
        (found.fine.physics_steps, found.coarse.physics_steps),
        (25 * ticks(&fine_rows), 10 * ticks(&coarse_rows))
    );
    let success = found.success().unwrap();
    assert!(success.interval_95[0] <= success.rate && success.rate <= success.interval_95[1], "{found:?}");

    // Killed in the coarse episodes, then resumed.
    let cut = format!("{RUN} --threads 1 --out cut");
    kill_after(at, &cut, ["cut", "fidelity.json"], |line| line == "24 coarse episodes");
    verb(at, "resume cut", 0, &["Fine and coarse episodes"]);
    for file in FILES {
        let [a, b] = ["a", "cut"].map(|name| fs::read(at.join(name).join(file)).unwrap());
        assert!(a == b, "{file} differs");
    }

    let json = verb(at, "report a --format json --out -", 0, &[]);
    let fidelities = serde_json::to_value(&found).unwrap();
    assert_eq!(serde_json::from_str::<Value>(&json).unwrap()["fidelities"], fidelities);
    assert!(fs::read_to_string(at.join("a/report.html")).unwrap().contains("Rates of the fine simulator"));
    verb(at, "report a --format md --out -", 0, &["Rates of the fine simulator"]);

    // Coarse rows are exported with their fidelity. Nothing judges or analyses them.
    verb(at, "export a/coarse coarse.csv", 0, &[]);
    verb(at, "export a fine.csv", 0, &[]);
    verb(at, "import coarse.csv coarse.parquet", 0, &[]);
    for line in [
        "report a/coarse",
        "analyze a/coarse",
        "analyze coarse.parquet",
        "gate --run a/coarse",
        "compare a a/coarse",
        "monitor reference a/coarse --out r.json",
        "run --robot franka -n 40 --prior a/coarse --out p",
        "view a/coarse",
        "demos --failed-in a/coarse --out d",
    ] {
        verb(at, line, 2, &["coarse"]);
    }
    let (fine, coarse) =
        (fs::read_to_string(at.join("fine.csv")).unwrap(), fs::read_to_string(at.join("coarse.csv")).unwrap());
    let mixed: String = fine.split_inclusive("\r\n").chain(coarse.split_inclusive("\r\n").skip(13)).collect();
    fs::write(at.join("mixed.csv"), mixed).unwrap();
    verb(at, "import mixed.csv mixed.parquet", 2, &["has the fidelity coarse. Expected fine"]);
}

#[test]
fn unusable_options_are_refused() {
    let dir = TempDir::new().unwrap();
    for (options, says) in [
        ("--task pendulum --coarse -n 60", "the time step of pendulum in mujoco cannot be changed"),
        ("--coarse --twins -n 60", "--twins"),
        ("--coarse --suite industrial-68", "--suite"),
        ("--coarse --design active -n 60", "--coarse applies to the uniform design"),
        ("--coarse 0 -n 60", "Expected a share above 0"),
        ("--coarse -n 45", "9 episodes with both time steps; expected at least 10"),
        ("--coarse --coarse-step 0.001 -n 60", "expected a time step above that of the run, which is 0.002 s"),
        ("--coarse --coarse-step 0.003 -n 60", "integer multiple"),
        ("--coarse-step 0.01 -n 60", "--coarse"),
        ("--coarse --divide 2 -n 60", "--divide"),
    ] {
        verb(dir.path(), &format!("run {options} --out x"), 2, &[says]);
    }
    assert!(!dir.path().join("x").exists());
}
