//! Tests of the boundary stage: its region and the weights of its points.

use std::sync::Arc;

use robogate_campaign::{Bins, BoundaryReport, DrawnFrom, Plan, Points};
use robogate_core::{Assignment, Domain, FailureMode, Fault, FaultKind, Outcome, ParameterSpace, Value};

use crate::world;

/// A linear parameter from 0 to 10, a log-scaled one from 1 to 101, and an integer.
fn space() -> ParameterSpace {
    ParameterSpace::from_toml(
        r#"
        name = "hand"
        [[parameter]]
        name = "x"
        kind = "continuous"
        low = 0
        high = 10
        [[parameter]]
        name = "y"
        kind = "continuous"
        low = 1
        high = 101
        scale = "log"
        [[parameter]]
        name = "k"
        kind = "integer"
        low = 0
        high = 5
        "#,
    )
    .unwrap()
}

fn plan(boundary: &str) -> Plan {
    Plan::from_toml(&format!("sampler = \"uniform\"\n[uniform]\nepisodes = 100\n[boundary]\nepisodes = 50\n{boundary}"))
        .unwrap()
}

fn at(x: f64, y: f64) -> Assignment {
    [("x".into(), Value::Number(x)), ("y".into(), Value::Number(y)), ("k".into(), Value::Integer(0))]
        .into_iter()
        .collect()
}

fn failure() -> Outcome {
    Outcome::Failure(FailureMode::TIMEOUT)
}

fn invalid() -> Outcome {
    Outcome::Invalid(Fault::new(FaultKind::Diverged, "test"))
}

/// Ten valid episodes in each of the ten bins of `x`, with `successes` successes.
fn counted(successes: [usize; 10]) -> Bins {
    let mut bins = Bins::new(&space(), 10).unwrap();
    for (bin, successes) in successes.into_iter().enumerate() {
        for i in 0..10 {
            let outcome = if i < successes { Outcome::Success } else { failure() };
            bins.add(&at(bin as f64 + 0.05 + 0.1 * i as f64, 1.0), &outcome);
        }
        // An invalid episode is counted in no bin.
        bins.add(&at(bin as f64, 1.0), &invalid());
    }
    bins
}

fn find(plan: &Plan, bins: &Bins) -> BoundaryReport {
    plan.check(&space()).unwrap();
    BoundaryReport::find(&plan.boundary, &space(), bins).unwrap()
}

#[test]
fn span_covers_bins_in_band() {
    // Rates 0.0, 0.1, ..., 0.9: those from 0.3 to 0.7 are the bins 3 to 7, with the span 3.0 to 8.0.
    let report = find(&plan(""), &counted([0, 1, 2, 3, 4, 5, 6, 7, 8, 9]));
    let x = &report.parameters[0];
    assert_eq!(x.in_band, [3, 4, 5, 6, 7]);
    assert_eq!((x.span, x.drawn, x.drawn_from), (Some([3.0, 8.0]), [3.0, 8.0], DrawnFrom::Bins));
    assert_eq!((x.effect.bins[4].valid, x.effect.bins[4].successes, x.effect.bins[4].success_rate), (10, 4, Some(0.4)));
    // Wilson at 95 % for 4 of 10, from R: prop.test(4, 10, correct = FALSE).
    let [low, high] = x.effect.bins[4].interval_95;
    assert!((low - 0.168_180_3).abs() < 1e-6 && (high - 0.687_326_2).abs() < 1e-6, "{low} {high}");
    // Only the first bin of y has valid episodes: 45 of 100 succeed.
    let y = &report.parameters[1];
    assert_eq!((y.in_band.as_slice(), y.span), ([0].as_slice(), Some([1.0, 11.0])));
    assert!(y.effect.bins[1..].iter().all(|bin| bin.success_rate.is_none() && bin.interval_95 == [0.0, 1.0]));
    // x: 5 of 10; y: ln 11 / ln 101; k: all.
    let expected = 0.5 * 11_f64.ln() / 101_f64.ln();
    assert!((report.volume.share_of_operating_space - expected).abs() < 1e-15);
}

#[test]
fn span_includes_bins_between() {
    let report = find(&plan(""), &counted([0, 10, 5, 10, 0, 0, 10, 3, 0, 0]));
    assert_eq!(
        (report.parameters[0].in_band.as_slice(), report.parameters[0].span),
        ([2, 7].as_slice(), Some([2.0, 8.0]))
    );
}

#[test]
fn log_parameter_has_linear_bins() {
    let report = find(&plan(""), &counted([5; 10]));
    assert_eq!((report.parameters[1].effect.bins[0].low, report.parameters[1].effect.bins[0].high), (1.0, 11.0));
    let focus = report.focus(&space()).unwrap();
    let Domain::Continuous { low: 1.0, high: 11.0, scale: robogate_core::Scale::Log } =
        focus.volume.parameters()[1].domain
    else {
        panic!("{:?}", focus.volume)
    };
}

#[test]
fn fallback_replaces_missing_boundary() {
    let text = "[[boundary.fallback]]\nparameter = \"x\"\nlow = -3\nhigh = 4";
    for successes in [[0; 10], [10; 10]] {
        let report = find(&plan(text), &counted(successes));
        let x = &report.parameters[0];
        assert_eq!((x.in_band.len(), x.span, x.drawn, x.drawn_from), (0, None, [0.0, 4.0], DrawnFrom::Fallback));
    }
    // Not used if a bin is in the band.
    let report = find(&plan(text), &counted([0, 0, 0, 0, 0, 0, 0, 0, 0, 5]));
    assert_eq!((report.parameters[0].drawn, report.parameters[0].drawn_from), ([9.0, 10.0], DrawnFrom::Bins));
}

#[test]
fn whole_range_is_last_fallback() {
    let report = find(&plan(""), &counted([0; 10]));
    assert_eq!((report.parameters[0].drawn, report.parameters[0].drawn_from), ([0.0, 10.0], DrawnFrom::WholeRange));
}

#[test]
fn empty_bin_is_never_boundary() {
    let mut bins = Bins::new(&space(), 10).unwrap();
    for x in 0..10 {
        bins.add(&at(f64::from(x) + 0.5, 2.0), &invalid());
    }
    // Also for a band that contains every rate.
    let report = find(&plan("band = [0.0, 1.0]"), &bins);
    assert!(report.parameters.iter().all(|p| p.in_band.is_empty() && p.drawn_from == DrawnFrom::WholeRange));
    assert!(report.is_without_evidence());
}

#[test]
fn outer_bins_include_range_ends() {
    let mut bins = Bins::new(&space(), 10).unwrap();
    bins.add(&at(0.0, 1.0), &Outcome::Success);
    bins.add(&at(10.0, 101.0), &Outcome::Success);
    bins.add(&at(3.0, 11.0), &Outcome::Success);
    let valid: Vec<u64> = bins.marginal_effects()[0].bins.iter().map(|bin| bin.valid).collect();
    assert_eq!(valid, [1, 0, 0, 1, 0, 0, 0, 0, 0, 1]);
}

#[test]
fn emphasis_can_leave_the_volume() {
    let text = "[boundary.emphasis]\nshare = 0.3\nwhere = [{ parameter = \"x\", high = 2 }]";
    let plan = plan(text);
    let report = find(&plan, &counted([0, 0, 0, 5, 5, 0, 0, 0, 0, 0]));
    let emphasis = report.emphasis.as_ref().unwrap();
    assert_eq!(emphasis.beyond, ["x"]);
    assert_eq!((emphasis.region.episodes, report.volume.episodes), (15, 35));
    let points = Points::boundary(&plan, &Arc::new(space()), &report).unwrap();
    assert_eq!(points.indices(), 100..150);
    for index in points.indices() {
        let x = points.requested(index).unwrap().number("x").unwrap();
        let (region, share, range) =
            if index < 115 { (emphasis.region, 0.3, 0.0..2.0) } else { (report.volume, 0.7, 3.0..5.0) };
        assert!(range.contains(&x), "{index}: {x}");
        // E and V are disjoint: each point has only the density of its own region.
        let weight = points.weight(index).unwrap();
        assert!((weight - region.share_of_operating_space / share).abs() < 1e-12, "{index}: {weight}");
    }
}

#[test]
fn single_point_overlap_is_empty() {
    // x < 3 within 3 <= x < 5.
    let text = "[boundary.emphasis]\nshare = 0.3\nwhere = [{ parameter = \"x\", high = 3 }]";
    let report = find(&plan(text), &counted([0, 0, 0, 5, 5, 0, 0, 0, 0, 0]));
    assert_eq!(report.emphasis.unwrap().beyond, ["x"]);
}

/// A report over the synthetic space with a known volume, and its plan.
fn synthetic(episodes: u64, share: f64) -> (Plan, Arc<ParameterSpace>, BoundaryReport) {
    let space = Arc::new(world::space());
    let mut plan = world::plan(100, episodes);
    plan.boundary.emphasis.as_mut().unwrap().share = share;
    let mut bins = Bins::new(&space, 10).unwrap();
    // Three of four succeed with friction in the bins 0 to 3 and mass in the bins 1 to 9. The rate along friction is 27
    // of 40 in the bins 0 to 3, along mass 12 of 40 in the bins 1 to 9, and along size 108 of 400 in the only bin with
    // episodes, which gives the fallback.
    for friction in 0..10 {
        for mass in 0..10 {
            for turn in 0..4 {
                let requested: Assignment = [
                    ("friction".into(), Value::Number(0.05 + 0.115 * (f64::from(friction) + 0.5))),
                    ("mass_kg".into(), Value::Number(0.05 + 0.195 * (f64::from(mass) + 0.5))),
                    ("size_m".into(), Value::Number(0.02 + 0.001 * f64::from(turn))),
                ]
                .into_iter()
                .collect();
                let good = friction < 4 && mass > 0 && turn != 3;
                bins.add(&requested, &if good { Outcome::Success } else { failure() });
            }
        }
    }
    let report = BoundaryReport::find(&plan.boundary, &space, &bins).unwrap();
    (plan, space, report)
}

#[test]
fn emphasis_gets_its_exact_share() {
    for (episodes, share, expected) in
        [(1000, 0.3, 300), (10_000, 0.3, 3000), (7, 0.3, 2), (5, 0.3, 2), (1, 0.3, 0), (9, 1.0, 9), (9, 0.0, 0)]
    {
        let (plan, space, report) = synthetic(episodes, share);
        let region = report.emphasis.as_ref().unwrap().region;
        assert_eq!(
            (region.episodes, region.episodes + report.volume.episodes),
            (expected, episodes),
            "{episodes} {share}"
        );
        let points = Points::boundary(&plan, &space, &report).unwrap();
        assert_eq!((points.len(), points.indices()), (episodes, 100..100 + episodes));
        for index in points.indices() {
            let scenario = points.scenario(index).unwrap();
            let of = |name: &str| scenario.requested.number(name).unwrap();
            if index < 100 + expected {
                assert!(of("friction") < 0.3 && of("mass_kg") >= 0.5, "{scenario:?}");
            }
            for parameter in &report.parameters {
                let value = of(&parameter.effect.parameter);
                assert!(parameter.drawn[0] <= value && value <= parameter.drawn[1], "{scenario:?}");
            }
            assert!((1.0..=5.0).contains(&of("obstacles")), "{scenario:?}");
        }
    }
}

#[test]
fn mean_weight_is_volume_share() {
    let (plan, space, report) = synthetic(40_000, 0.3);
    let points = Points::boundary(&plan, &space, &report).unwrap();
    let weights: Vec<f64> = points.indices().map(|index| points.weight(index).unwrap()).collect();
    let n = weights.len() as f64;
    let mean = weights.iter().sum::<f64>() / n;
    let variance = weights.iter().map(|w| (w - mean).powi(2)).sum::<f64>() / (n - 1.0);
    // Computed by hand from the report's ranges: logarithms for friction and mass, 5 of 6 numbers of obstacles.
    let range = |i: usize| report.parameters[i].drawn;
    let log = |[a, b]: [f64; 2], [low, high]: [f64; 2]| (b / a).ln() / (high / low).ln();
    let [size_low, size_high] = range(2);
    let volume = log(range(0), [0.05, 1.2]) * log(range(1), [0.05, 2.0]) * (size_high - size_low) / 0.10 * 5.0 / 6.0;
    assert!((report.volume.share_of_operating_space / volume - 1.0).abs() < 1e-12);
    assert!((mean - volume).abs() < 4.0 * (variance / n).sqrt(), "{mean} {volume} {variance}");
    // There are two weights: inside and outside the emphasis.
    let mut distinct = weights.clone();
    distinct.sort_by(f64::total_cmp);
    distinct.dedup();
    assert_eq!(distinct.len(), 2);
}

#[test]
fn weighted_mean_matches_operating_mean() {
    let (plan, space, report) = synthetic(40_000, 0.3);
    let points = Points::boundary(&plan, &space, &report).unwrap();
    // f = log friction * log mass + obstacles has a known mean over the volume, where all are independent and uniform.
    let middle = |i: usize| 0.5 * (report.parameters[i].drawn[0].ln() + report.parameters[i].drawn[1].ln());
    let expected = middle(0) * middle(1) + 3.0;
    let (mut total, mut weighted, mut plain) = (0.0, 0.0, 0.0);
    let mut squares = 0.0;
    for index in points.indices() {
        let requested = points.requested(index).unwrap();
        let of = |name: &str| requested.number(name).unwrap();
        let f = of("friction").ln() * of("mass_kg").ln() + of("obstacles");
        let weight = points.weight(index).unwrap();
        total += weight;
        weighted += weight * f;
        squares += (weight * (f - expected)).powi(2);
        plain += f;
    }
    let error = squares.sqrt() / total;
    let estimate = weighted / total;
    assert!((estimate - expected).abs() < 4.0 * error, "{estimate} {expected} {error}");
    // Without the weights, the emphasis biases the mean.
    let plain = plain / points.len() as f64;
    assert!((plain - expected).abs() > 10.0 * error, "{plain} {expected} {error}");
}

#[test]
fn first_stage_is_independent_of_second() {
    let space = Arc::new(world::space());
    let points = Points::uniform(&world::plan(50, 100), &space).unwrap();
    let other = Points::uniform(&world::plan(50, 7), &space).unwrap();
    for index in points.indices() {
        assert_eq!(points.weight(index), Some(1.0));
        assert_eq!(points.scenario(index), other.scenario(index));
    }
    assert_eq!((points.scenario(50), points.weight(50)), (None, None));
}

#[test]
fn designs_use_separate_streams() {
    let (plan, space, report) = synthetic(1000, 0.3);
    let focus = report.focus(&space).unwrap();
    let uniform = Points::uniform(&plan, &space).unwrap();
    let boundary = Points::boundary(&plan, &space, &report).unwrap();
    // The first point of each design, as fractions of its space. The same stream would give the same fractions.
    let share = |points: &Points, index, space: &ParameterSpace| {
        let parameter = &space.parameters()[0];
        let requested = points.requested(index).unwrap();
        parameter.domain.to_unit(parameter.domain.encode(requested.get("friction").unwrap()).unwrap())
    };
    let shares = [
        share(&uniform, 0, &space),
        share(&boundary, 100, &focus.emphasis.unwrap()),
        share(&boundary, 400, &focus.volume),
    ];
    for (a, b) in [(0, 1), (0, 2), (1, 2)] {
        assert!((shares[a] - shares[b]).abs() > 1e-9, "{shares:?}");
    }
}

#[test]
fn second_stage_redraws_from_report_file() {
    let (plan, space, report) = synthetic(200, 0.3);
    let copy: BoundaryReport = serde_json::from_str(&serde_json::to_string_pretty(&report).unwrap()).unwrap();
    assert_eq!(copy, report);
    let [points, again] = [&report, &copy].map(|report| Points::boundary(&plan, &space, report).unwrap());
    for index in points.indices() {
        assert_eq!((points.scenario(index), points.weight(index)), (again.scenario(index), again.weight(index)));
    }
}
