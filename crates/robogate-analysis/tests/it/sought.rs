//! A failure mode that a run sought and found is reported as a box of parameters.

use std::path::Path;

use robogate_analysis::{Analysis, Source};
use robogate_core::{FailureMode, Outcome};
use robogate_dictionary::{DictionaryError, write_parquet};

use crate::hold;
use crate::synthetic::{entry, point, provenance, space, unit};

/// The analysis of 1,500 episodes that sought collisions, which happen in 90 % of the episodes within a pocket, and in `elsewhere` of
/// the others. Every third point was chosen in a box around it, with the weights of the mixture.
fn sought(elsewhere: f64, pocket: bool) -> Analysis {
    let space = space(&["box", "sphere"]);
    let around = [0.3, 0.5];
    let row = |i: u64| {
        let mut requested = point(&space, i);
        let chosen = i.is_multiple_of(3);
        let at =
            |salt: u64| if chosen { around[0] + (around[1] - around[0]) * unit(i, salt) } else { unit(i, salt + 9) };
        let (friction, mass) = (at(50), at(51));
        hold(&mut requested, &space, "friction", friction);
        hold(&mut requested, &space, "mass_kg", mass);
        let is_around = [friction, mass].iter().all(|x| (around[0]..around[1]).contains(x));
        let within = pocket && [friction, mass].iter().all(|x| (0.35..0.42).contains(x));
        let collides = unit(i, 99) < if within { 0.9 } else { elsewhere };
        let outcome = match collides {
            true => Outcome::Failure(FailureMode::constant("collision")),
            false if unit(i, 98) < 0.1 => Outcome::Failure(FailureMode::constant("grasp_miss")),
            false => Outcome::Success,
        };
        let mut entry = entry(i, requested, outcome);
        if i >= 300 {
            "active".clone_into(&mut entry.stage);
            if chosen { "active" } else { "uniform" }.clone_into(&mut entry.design);
        }
        entry.weight = 1.0 / (2.0 / 3.0 + if is_around { 1.0 / 3.0 / 0.04 } else { 0.0 });
        entry
    };
    let mut provenance = provenance(space.clone());
    provenance.plan = serde_json::json!({ "active": { "episodes": 1_200, "seek": "collision" } });
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("dictionary.parquet");
    write_parquet(&path, &provenance, (0..1_500).map(|i| Ok::<_, DictionaryError>(row(i)))).unwrap();
    Analysis::of(&Source::open(&path).unwrap(), Path::new("test.parquet"), &[]).unwrap()
}

#[test]
fn small_pocket_is_reported() {
    let analysis = sought(0.002, true);
    let found = analysis.conditions.sought.as_ref().unwrap().estimated().unwrap();
    let names: Vec<&str> = found.limits.iter().map(|limit| limit.parameter.as_str()).collect();
    assert_eq!((found.mode.as_str(), names.as_slice()), ("collision", ["friction", "mass_kg"].as_slice()));
    assert!(found.inside.rate > 0.5 && found.outside.rate < 0.01, "{found:?}");
    assert!(found.inside.interval_95[0] > found.outside.interval_95[1]);
    assert_eq!(found.replay.len(), 3);
    assert!(found.replay.iter().all(|episode| episode.outcome.starts_with("collision")));
    // Weighted, the pocket is as rare as it is: half a percent of the space.
    assert!(analysis.success.rate.rate.unwrap() > 0.85);
}

#[test]
fn frequent_mode_without_a_place_has_no_box() {
    let analysis = sought(0.1, false);
    assert!(analysis.conditions.sought.unwrap().because().unwrap().contains("no box"));
}
