//! Simulated dictionaries whose law is known: success that depends on nothing, and one planted effect. The program
//! `headlines` of `robogate-report` runs them at full size.

use std::path::Path;
use std::sync::Arc;

use robogate_analysis::{Analysis, AnalysisOptions, Source};
use robogate_core::{FailureMode, Outcome, ParameterSpace};

use crate::synthetic::{entry, unit, write};

/// A space of ten parameters: seven continuous ones (two of them logarithmic), one integer and two with levels.
pub(crate) fn ten() -> ParameterSpace {
    use std::fmt::Write;
    let mut toml = "name = \"ten\"\n".to_owned();
    for i in 0..7 {
        let (low, scale) = if i < 2 { (0.01, "log") } else { (0.0, "linear") };
        let head = "[[parameter]]\nkind = \"continuous\"\nhigh = 1.0\n";
        write!(toml, "{head}name = \"p{i}\"\nlow = {low}\nscale = \"{scale}\"\n").unwrap();
    }
    toml += "[[parameter]]\nname = \"p7\"\nkind = \"integer\"\nlow = 0\nhigh = 5\n";
    for (name, levels) in [("p8", 4), ("p9", 20)] {
        let choices: Vec<String> = (0..levels).map(|i| format!("\"{name}_{i}\"")).collect();
        write!(toml, "[[parameter]]\nname = \"{name}\"\nkind = \"categorical\"\nchoices = [{}]\n", choices.join(","))
            .unwrap();
    }
    ParameterSpace::from_toml(&toml).unwrap()
}

/// The analysis of `n` episodes. `law` is the probability of success at a point of the unit cube.
pub(crate) fn simulated(seed: u64, n: u64, law: impl Fn(&[f64]) -> f64) -> Analysis {
    let space = ten();
    let one = |index: u64| {
        let of = (seed + 1) * 1_000_003 + index;
        let at: Vec<f64> = (1..=space.len() as u64).map(|salt| unit(of, salt)).collect();
        let requested = space
            .parameters()
            .iter()
            .zip(&at)
            .map(|(p, u)| (Arc::clone(&p.name), p.domain.decode(p.domain.from_unit(*u))))
            .collect();
        let mode = if unit(of, 98) < 0.6 { "grasp_miss" } else { "grip_loss" };
        let success = unit(of, 99) < law(&at);
        entry(index, requested, if success { Outcome::Success } else { Outcome::Failure(FailureMode::constant(mode)) })
    };
    // Models and maps name nothing, and most of the time would be theirs.
    let options = AnalysisOptions { models: false, ..AnalysisOptions::default() };
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("dictionary.parquet");
    write(&path, &space, (0..n).map(one).collect());
    Analysis::with(&Source::open(&path).unwrap(), Path::new("test.parquet"), &options).unwrap()
}

/// A law whose odds of success are divided by `ratio` in the tenth of one parameter that starts at `from`.
pub(crate) fn planted(rate: f64, ratio: f64, from: f64) -> impl Fn(&[f64]) -> f64 {
    let odds = rate / (1.0 - rate);
    move |at| {
        let odds = if (from..from + 0.1).contains(&at[3]) { odds / ratio } else { odds };
        odds / (1.0 + odds)
    }
}
