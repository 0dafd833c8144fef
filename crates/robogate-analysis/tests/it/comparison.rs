//! Comparisons of several dictionaries.

use std::path::PathBuf;

use robogate_analysis::{Comparison, ComparisonError, ComparisonOptions, Finding, Source};
use robogate_core::{FailureMode, Fault, FaultKind, Outcome, ParameterSpace};
use robogate_dictionary::{CellPlace, DictionaryError, Place, RendererRecord, World, write_parquet};
use tempfile::TempDir;

use crate::runs::{boxes, changed, saved};
use crate::synthetic::{entry, law, point, provenance, unit};

fn compared(sources: &[(Source, PathBuf)]) -> Comparison {
    Comparison::of(sources, &ComparisonOptions { common: true, ..ComparisonOptions::default() }).unwrap()
}

fn paired() -> ComparisonOptions {
    ComparisonOptions { paired: true, ..ComparisonOptions::default() }
}

#[test]
fn runs_are_named_by_renderer() {
    let dir = TempDir::new().unwrap();
    let space = boxes();
    let sampled = |file: &str, renderer: Option<RendererRecord>, n: u64| {
        let place = CellPlace {
            robot: "franka".to_owned(),
            engine: "mujoco".to_owned(),
            time_step_s: 0.002,
            renderer,
            physics_servers: false,
        };
        let world = Some(World::new(Place::Cell(place)));
        let path = dir.path().join(format!("{file}.parquet"));
        let provenance = robogate_dictionary::Provenance { world, ..provenance(space.clone()) };
        write_parquet(&path, &provenance, law(&space, n).into_iter().map(Ok::<_, DictionaryError>)).unwrap();
        (Source::open(&path).unwrap(), path)
    };
    let names = |a, b| compared(&[a, b]).datasets.iter().map(|d| d.name.clone()).collect::<Vec<_>>();
    let egl = Some(RendererRecord::Egl { device: Some("llvmpipe".to_owned()) });
    assert_eq!(names(sampled("a", None, 50), sampled("b", egl, 60)), ["embedded", "egl"]);
    assert_eq!(names(sampled("c", None, 50), sampled("d", None, 60)), ["c", "d"]);
}

#[test]
fn same_rows_twice_are_rejected() {
    let dir = TempDir::new().unwrap();
    let space = boxes();
    let one = saved(&dir, "one", &space, law(&space, 50));
    let twin = saved(&dir, "twin", &space, law(&space, 50));
    let only = Comparison::of(&[one], &paired()).unwrap_err();
    assert!(matches!(only, ComparisonError::TooFew { found: 1 }), "{only}");
    let again = saved(&dir, "again", &space, law(&space, 50));
    let twice = Comparison::of(&[twin, again], &ComparisonOptions::default()).unwrap_err();
    assert!(matches!(twice, ComparisonError::SameTwice { .. }), "{twice}");
}

#[test]
fn adjustment_never_lowers_a_p_value() {
    let dir = TempDir::new().unwrap();
    let space = boxes();
    let worse = |i: u64, by_law| {
        if i.is_multiple_of(4) { Outcome::Failure(FailureMode::constant("collision")) } else { by_law }
    };
    let all = [
        saved(&dir, "a", &space, law(&space, 600)),
        saved(&dir, "b", &space, changed(&space, 600, worse)),
        saved(&dir, "c", &space, changed(&space, 500, |_, by_law| by_law)),
    ];
    let of = compared(&all);
    assert_eq!(of.compared, ["a", "b", "c"]);
    assert_eq!(of.differences.len(), 3);
    // The first two ran the same 600 scenarios; the third ran 500.
    let pairs: Vec<bool> = of.differences.iter().map(|d| d.valid_pairs.is_some()).collect();
    assert_eq!(pairs, [true, false, false]);
    for d in &of.differences[1..] {
        let rate = |name: &str| of.datasets.iter().find(|x| x.name == name).unwrap().success.rate.rate.unwrap();
        assert!((d.difference - (rate(&d.first) - rate(&d.second))).abs() < 1e-12);
        assert!(d.interval_95[0] < d.difference && d.difference < d.interval_95[1]);
        assert!(d.adjusted_p >= d.ln_p.exp());
        // Interval and p-value come from one test.
        let excludes = d.interval_95[0] > 0.0 || d.interval_95[1] < 0.0;
        assert_eq!(d.is_significant(), excludes, "{d:?}");
    }
    assert!(of.differences[0].adjusted_p < 0.05, "{:?}", of.differences[0]);
    assert!(of.differences[1].adjusted_p > 0.5, "{:?}", of.differences[1]);
    // The twelve invalid episodes of the first are excluded from all rates.
    assert_eq!(of.datasets[0].success.rate.n, 588);
    assert_eq!(of.datasets[0].success.bounds.invalid, 12);
}

#[test]
fn same_scenarios_are_always_paired() {
    let dir = TempDir::new().unwrap();
    let space = boxes();
    // A few scenarios flip, nearly all in one direction: too few for independent runs, but enough for pairs.
    let worse = |i: u64, by_law| match by_law {
        Outcome::Success if i.is_multiple_of(25) => Outcome::Failure(FailureMode::constant("collision")),
        other => other,
    };
    let all = [saved(&dir, "a", &space, law(&space, 600)), saved(&dir, "b", &space, changed(&space, 600, worse))];
    let plain = compared(&all);
    let by_pairs = &Comparison::of(&all, &paired()).unwrap().paired[0];
    let d = &plain.differences[0];
    assert_eq!(d.valid_pairs, Some(by_pairs.valid_pairs));
    assert_eq!((Some(d.difference), d.interval_95), (by_pairs.difference, by_pairs.difference_95));
    assert_eq!((d.ln_p, d.adjusted_p), (by_pairs.ln_p, by_pairs.adjusted_p));
    assert!(d.adjusted_p < 0.05, "{d:?}");
}

#[test]
fn shared_bins_cover_the_shared_range() {
    let dir = TempDir::new().unwrap();
    let wide = boxes();
    let toml = "name = \"other\"\n[[parameter]]\nname = \"mass_kg\"\nkind = \"continuous\"\nlow = 0.5\nhigh = 4.0\n\
                [[parameter]]\nname = \"grip_threshold_m\"\nkind = \"continuous\"\nlow = 0.0\nhigh = 1.0\n";
    let other = ParameterSpace::from_toml(toml).unwrap();
    let entries = (0..400).map(|i| {
        entry(i, point(&other, i), if i % 3 == 0 { Outcome::Success } else { Outcome::Failure(FailureMode::TIMEOUT) })
    });
    let all = [saved(&dir, "a", &wide, law(&wide, 400)), saved(&dir, "b", &other, entries.collect())];
    let of = compared(&all);
    assert_eq!(of.parameters.shared, ["mass_kg"]);
    let names: Vec<&str> = of.parameters.not_shared.iter().map(|p| p.parameter.as_str()).collect();
    assert_eq!(names, ["friction", "obstacles", "shape", "grip_threshold_m"]);
    let curve = &of.marginal_effects[0];
    assert!(curve.remark.is_some());
    let ends = (curve.cells.first().unwrap().range.unwrap()[0], curve.cells.last().unwrap().range.unwrap()[1]);
    assert_eq!(ends, (0.5, 2.0));
    for (at, source) in
        [&law(&wide, 400), &(0..400).map(|i| entry(i, point(&other, i), Outcome::Success)).collect::<Vec<_>>()]
            .iter()
            .enumerate()
    {
        let inside = source.iter().filter(|e| {
            let mass = e.episode.scenario.requested.number("mass_kg").unwrap();
            !matches!(e.episode.outcome, Outcome::Invalid(_)) && (0.5..=2.0).contains(&mass)
        });
        assert_eq!(curve.cells.iter().map(|cell| cell.rates[at].n).sum::<u64>(), inside.count() as u64);
    }
}

#[test]
fn unrelated_datasets_have_rates_only() {
    let dir = TempDir::new().unwrap();
    let wide = boxes();
    let toml = "name = \"other\"\n[[parameter]]\nname = \"x\"\nkind = \"continuous\"\nlow = 0.5\nhigh = 4.0\n";
    let other = ParameterSpace::from_toml(toml).unwrap();
    let entries = (0..60).map(|i| entry(i, point(&other, i), Outcome::Success)).collect();
    let of = compared(&[saved(&dir, "a", &wide, law(&wide, 60)), saved(&dir, "b", &other, entries)]);
    assert!(of.marginal_effects.is_empty() && of.parameters.shared.is_empty());
    assert_eq!(of.universal_zones.tested, 0);
    assert!(matches!(of.sensitivity, Finding::CannotBeEstimated { .. }));
    assert!(of.has_evidence());
}

#[test]
fn universal_zones_need_enough_episodes() {
    let dir = TempDir::new().unwrap();
    let space = boxes();
    // Both always fail with three obstacles. Only the first fails with two.
    let fails_from = |least: f64| {
        let space = space.clone();
        move |i: u64| {
            let requested = point(&space, i);
            let fails = requested.number("obstacles").unwrap() >= least;
            let went = if fails { Outcome::Failure(FailureMode::constant("collision")) } else { Outcome::Success };
            entry(i, requested, went)
        }
    };
    let all = [
        saved(&dir, "a", &space, (0..400).map(fails_from(2.0)).collect()),
        saved(&dir, "b", &space, (0..300).map(fails_from(3.0)).collect()),
    ];
    let of = compared(&all);
    let sure: Vec<String> = of.universal_zones.zones.iter().filter(|z| z.significant).map(|z| z.describe()).collect();
    assert_eq!(sure, ["obstacles 3"]);
    let thin = [
        saved(&dir, "c", &space, (0..400).map(fails_from(2.0)).collect()),
        saved(&dir, "d", &space, (0..9).map(fails_from(0.0)).collect()),
    ];
    let of = compared(&thin);
    assert!(of.universal_zones.too_few_episodes > 0);
    assert!(
        of.universal_zones.zones.iter().all(|zone| zone.rates.iter().all(|r| r.n >= of.universal_zones.smallest_n))
    );
    assert_eq!(of.universal_zones.smallest_n, 6);
}

#[test]
fn slope_of_mass_follows_the_law() {
    let dir = TempDir::new().unwrap();
    let space = boxes();
    let coin = |i: u64, _| if unit(i, 55) < 0.5 { Outcome::Success } else { Outcome::Failure(FailureMode::TIMEOUT) };
    let all =
        [saved(&dir, "law", &space, law(&space, 2_000)), saved(&dir, "coin", &space, changed(&space, 2_000, coin))];
    let of = compared(&all);
    let mass = of.sensitivity.estimated().unwrap();
    let slope = |at: usize| *mass.effects[at].slope.estimated().unwrap();
    assert!(slope(0).interval_95[1].unwrap() < 0.0 && slope(0).odds_per_doubling < 1.0, "{:?}", slope(0));
    assert!(slope(1).interval_95[0].unwrap() < 0.0 && slope(1).interval_95[1].unwrap() > 0.0, "{:?}", slope(1));
    assert!(mass.effects[0].low.rate > mass.effects[0].high.rate);
}

#[test]
fn reach_comes_from_provenance_or_options() {
    let dir = TempDir::new().unwrap();
    let space = boxes();
    let all = [saved(&dir, "a", &space, law(&space, 60)), saved(&dir, "b", &space, law(&space, 70))];
    let of = |reach: &[(&str, f64)]| {
        let reach_m = reach.iter().map(|(name, reach)| ((*name).to_owned(), *reach)).collect();
        Comparison::of(&all, &ComparisonOptions { reach_m, common: true, ..ComparisonOptions::default() })
    };
    let ratio = |of: &Comparison, at: usize| (of.reach[at].ratio, of.reach[at].given);
    let found = of(&[("b", 0.5)]).unwrap();
    assert_eq!((ratio(&found, 0), ratio(&found, 1)), ((Some(0.5), false), (Some(1.0), true)));
    assert!(matches!(of(&[("z", 0.5)]), Err(ComparisonError::NoSuchName { .. })));
    assert!(matches!(of(&[("b", -0.5)]), Err(ComparisonError::Setting { .. })));
}

#[test]
fn invalid_pairs_bound_the_difference() {
    let dir = TempDir::new().unwrap();
    let space = boxes();
    let first = |i: u64, _| match i {
        0..60 => Outcome::Success,
        60..100 => Outcome::Failure(FailureMode::constant("grasp_miss")),
        _ => Outcome::Invalid(Fault::new(FaultKind::Diverged, "made up")),
    };
    let second = |i: u64, _| match i {
        0..40 | 60..65 | 100.. => Outcome::Success,
        _ => Outcome::Failure(FailureMode::constant("grip_loss")),
    };
    let all =
        [saved(&dir, "a", &space, changed(&space, 104, first)), saved(&dir, "b", &space, changed(&space, 104, second))];
    let of = Comparison::of(&all, &paired()).unwrap();
    let pair = &of.paired[0];
    assert_eq!((pair.scenarios, pair.valid_pairs), (104, 100));
    assert_eq!((pair.both, pair.first_only, pair.second_only, pair.neither), (40, 20, 5, 35));
    assert!((pair.difference.unwrap() - 0.15).abs() < 1e-12);
    // The score is (20 - 5) / sqrt(25) = 3. The exact test takes the largest tail over the share of pairs that differ: that of
    // 100 pairs that all differ, twice the chance of at least 65 heads in 100 tosses.
    assert!((pair.ln_p.exp() - 0.003_517_641_7).abs() < 1e-9, "{}", pair.ln_p.exp());
    assert_eq!((pair.invalid.first, pair.invalid.second, pair.invalid.either), (4, 0, 4));
    // The four invalid episodes could each be a failure (15 - 4) or a success (15 + 0), where the second succeeded.
    let [low, high] = pair.invalid.difference_bounds.unwrap();
    assert!((low - 11.0 / 104.0).abs() < 1e-12 && (high - 15.0 / 104.0).abs() < 1e-12, "{low} {high}");
    assert_eq!(pair.outcomes.outcomes, ["success", "grasp_miss", "grip_loss", "invalid"]);
    assert_eq!(pair.outcomes.counts.iter().flatten().sum::<u64>(), 104);
    assert_eq!(pair.flips.len(), 15);
    let map = pair.disagreement.estimated().unwrap();
    assert_eq!(map.cells.iter().map(|cell| cell.differ.n).sum::<u64>(), 100);
    assert_eq!(map.cells.iter().map(|cell| cell.first_only).sum::<u64>(), 20);
}

#[test]
fn first_different_scenario_is_named() {
    let dir = TempDir::new().unwrap();
    let space = boxes();
    let mut moved = law(&space, 80);
    moved[17].episode.scenario.requested.set("mass_kg", robogate_core::Value::Number(1.25));
    let all = [saved(&dir, "a", &space, law(&space, 80)), saved(&dir, "b", &space, moved)];
    let error = Comparison::of(&all, &paired()).unwrap_err().to_string();
    assert!(error.contains("row 17") && error.contains("mass_kg") && error.contains("1.25"), "{error}");
    let short = [saved(&dir, "c", &space, law(&space, 80)), saved(&dir, "d", &space, law(&space, 79))];
    let error = Comparison::of(&short, &paired()).unwrap_err().to_string();
    assert!(error.contains("80") && error.contains("79"), "{error}");
}

#[test]
fn datasets_without_evidence_are_excluded() {
    let dir = TempDir::new().unwrap();
    let space = boxes();
    let broken = |_, _| Outcome::Invalid(Fault::new(FaultKind::Diverged, "made up"));
    let mut all = vec![
        saved(&dir, "good", &space, law(&space, 80)),
        saved(&dir, "broken", &space, changed(&space, 30, broken)),
        saved(&dir, "empty", &space, Vec::new()),
    ];
    let of = compared(&all);
    assert!(!of.has_evidence() && of.differences.is_empty());
    all.push(saved(&dir, "other", &space, law(&space, 90)));
    let of = compared(&all);
    assert!(of.has_evidence());
    assert_eq!(of.compared, ["good", "other"]);
    assert!(of.datasets[1].excluded_because.is_some() && of.datasets[2].excluded_because.is_some());
}

#[test]
fn focused_datasets_are_excluded() {
    let dir = TempDir::new().unwrap();
    let space = boxes();
    let mut focused = law(&space, 100);
    focused.iter_mut().for_each(|entry| entry.stage = "boundary".to_owned());
    let all = [saved(&dir, "even", &space, law(&space, 80)), saved(&dir, "focused", &space, focused)];
    let of = compared(&all);
    assert_eq!(of.compared, ["even"]);
    assert!(of.datasets[1].excluded_because.as_deref().unwrap().contains("focused design only"));
}

#[test]
fn different_spaces_need_common() {
    let dir = TempDir::new().unwrap();
    let wide = boxes();
    let toml = "name = \"narrow\"\n[[parameter]]\nname = \"mass_kg\"\nkind = \"continuous\"\nlow = 0.5\nhigh = 4.0\n";
    let narrow = ParameterSpace::from_toml(toml).unwrap();
    let entries: Vec<_> = (0..200).map(|i| entry(i, point(&narrow, i), Outcome::Success)).collect();
    let all = [saved(&dir, "a", &wide, law(&wide, 300)), saved(&dir, "b", &narrow, entries)];
    let error = Comparison::of(&all, &ComparisonOptions::default()).unwrap_err();
    assert!(matches!(error, ComparisonError::DifferentSpaces { .. }), "{error}");
    assert!(error.to_string().contains("`mass_kg` is") && error.to_string().contains("--common"), "{error}");
    let common = compared(&all);
    assert_eq!(common.restricted.len(), 2);
    // Only rows in the shared range of the mass count.
    assert!(common.datasets[0].success.rate.n < 300 - 6, "{:?}", common.restricted);
}

#[test]
fn different_tasks_are_rejected() {
    let dir = TempDir::new().unwrap();
    let space = boxes();
    let other = dir.path().join("other.parquet");
    let mut provenance = provenance(space.clone());
    let mut task = (*provenance.task).clone();
    task.name = robogate_core::Word::constant("drawer");
    provenance.task = std::sync::Arc::new(task);
    write_parquet(&other, &provenance, law(&space, 50).into_iter().map(Ok::<_, DictionaryError>)).unwrap();
    let all = [saved(&dir, "a", &space, law(&space, 60)), (Source::open(&other).unwrap(), other)];
    let error = Comparison::of(&all, &ComparisonOptions { common: true, ..ComparisonOptions::default() }).unwrap_err();
    assert!(matches!(error, ComparisonError::DifferentTasks { .. }), "{error}");
}

#[test]
fn ties_are_ties() {
    let dir = TempDir::new().unwrap();
    let space = boxes();
    // Two scenarios change sides, one in each direction.
    let swapped = |i: u64, by_law: Outcome| match i {
        1 => Outcome::Success,
        2 => Outcome::Failure(FailureMode::TIMEOUT),
        _ => by_law,
    };
    let flipped = |i: u64, by_law: Outcome| match i {
        1 => Outcome::Failure(FailureMode::TIMEOUT),
        2 => Outcome::Success,
        _ => by_law,
    };
    let all = [
        saved(&dir, "a", &space, changed(&space, 200, swapped)),
        saved(&dir, "b", &space, changed(&space, 200, flipped)),
    ];
    let tie = &compared(&all).differences[0];
    assert!(tie.is_tie() && !tie.is_significant(), "{tie:?}");
    assert!((tie.interval_95[0] + tie.interval_95[1]).abs() < 1e-4, "{tie:?}");
}

#[test]
// Two policies on the same scenarios and seeds, in the order in which their episodes ended, and one row is missing.
fn imported_rows_are_paired_by_scenario_and_seed() {
    use robogate_dictionary::results::{Mapping, import};

    let dir = TempDir::new().unwrap();
    let mut rows = Vec::new();
    for (policy, better) in [("old", 0.0), ("new", 0.15)] {
        for i in 0..60_u64 {
            let success = unit(i, 1) < 0.2 + 0.6 * unit(i / 3, 2) + better;
            rows.push((unit(i, 3 + policy.len() as u64), policy, i / 3, i % 3, u8::from(success)));
        }
    }
    rows.sort_by(|a, b| a.0.total_cmp(&b.0));
    let lost = rows.iter().position(|row| row.1 == "old").unwrap();
    rows.remove(lost);
    let text: String = rows
        .iter()
        .map(|(_, policy, scenario, seed, success)| {
            format!("{policy},s{scenario},{seed},{}.5,{success}\n", scenario * 7 % 20)
        })
        .collect();
    let results = dir.path().join("results.csv");
    std::fs::write(&results, format!("policy_id,scenario,seed,mass,success\n{text}")).unwrap();
    let open = |policy: &str| {
        let path = dir.path().join(format!("{policy}.parquet"));
        let mut mapping = Mapping::default();
        mapping.about.policy = Some(policy.to_owned());
        import(&results, &path, None, &mapping).unwrap();
        (Source::open(&path).unwrap(), path)
    };
    let found = Comparison::of(&[open("old"), open("new")], &paired()).unwrap();
    let pair = &found.paired[0];
    assert_eq!((pair.first.as_str(), pair.second.as_str(), pair.scenarios, pair.unpaired), ("old", "new", 59, 1));
    assert_eq!(pair.paired_by, ["source_seed", "scenario"]);
    assert_eq!(pair.first_only, 0, "the new policy solves what the old one solves");
    assert!(pair.second_only > 3 && pair.clusters == Some(20), "{pair:?}");
    assert!(pair.how_paired().unwrap().ends_with("1 row without a partner is left out."));
}
