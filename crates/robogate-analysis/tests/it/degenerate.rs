//! Insufficient data never cause a panic or a meaningless number, and always give a reason.

use robogate_analysis::{Analysis, Source};
use robogate_core::{FailureMode, Fault, FaultKind, Outcome};

use crate::hold;
use crate::synthetic::{analysed, entry, law, outcome, point, space, with_outcomes};

fn of(entries: Vec<robogate_dictionary::Entry>) -> Analysis {
    analysed(&space(&["box", "sphere"]), entries)
}

#[test]
fn empty_dictionary_has_no_rate() {
    let analysis = of(Vec::new());
    assert_eq!(analysis.success.rate.rate, None);
    assert!((analysis.success.rate.wilson_95[1] - 1.0).abs() < 1e-12);
    assert!(analysis.risk.because().unwrap().contains("no valid episode"));
}

#[test]
fn invalid_episodes_are_not_zero() {
    let analysis = of(with_outcomes(30, |_| Outcome::Invalid(Fault::new(FaultKind::Unavailable, "gone"))));
    assert_eq!(analysis.success.rate.rate, None);
    let bounds = &analysis.success.bounds;
    assert_eq!((bounds.invalid, bounds.worst_case, bounds.best_case), (30, Some(0.0), Some(1.0)));
    assert_eq!((bounds.faults[0].fault.as_str(), bounds.faults[0].episodes), ("unavailable", 30));
}

#[test]
fn few_rows_give_reasons() {
    for n in [1, 3] {
        let analysis =
            of(with_outcomes(n, |i| if i == 0 { Outcome::Success } else { Outcome::Failure(FailureMode::TIMEOUT) }));
        assert_eq!(analysis.success.rate.n, n);
        assert!(analysis.marginal_effects[0].threshold.because().unwrap().contains("too few"));
        let risk = analysis.risk.estimated();
        // Three rows are always separated. The fit is then Firth's, and the report states this.
        assert!(risk.is_none_or(|risk| !risk.regression.warnings.is_empty()));
        assert!(risk.is_none_or(|risk| risk.calibration_cross_validated.because().is_some()));
    }
}

#[test]
fn one_outcome_has_no_model() {
    let all = of(with_outcomes(200, |_| Outcome::Success));
    assert!(all.risk.because().unwrap().contains("same outcome"));
    assert!(all.envelopes[0].frontier.because().unwrap().contains("same outcome"));
    assert!(all.marginal_effects[0].correlation.because().unwrap().contains("every episode succeeded"));
    assert!(all.success.rate.wilson_95[0] < 1.0);
    let none = of(with_outcomes(200, |_| Outcome::Failure(FailureMode::constant("grasp_miss"))));
    assert!(none.marginal_effects[0].correlation.because().unwrap().contains("every episode failed"));
    assert_eq!(none.failure_modes.dominant.estimated().unwrap(), "grasp_miss");
}

#[test]
fn one_failure_names_no_dominant_mode() {
    let failing = |failures: u64| {
        of(with_outcomes(200, move |i| match i < failures {
            true => Outcome::Failure(FailureMode::constant("grasp_miss")),
            false => Outcome::Success,
        }))
    };
    for few in [1, 2, 4] {
        let because = failing(few).failure_modes.dominant.because().unwrap().to_owned();
        assert!(because.contains("do not differ significantly"), "{few}: {because}");
    }
    assert_eq!(failing(12).failure_modes.dominant.estimated().unwrap(), "grasp_miss");
}

#[test]
fn constant_parameter_is_named() {
    let space = space(&["box", "sphere"]);
    let entries = (0..400).map(|i| {
        let mut requested = point(&space, i);
        hold(&mut requested, &space, "mass_kg", 0.5);
        let went = outcome(i, &requested);
        entry(i, requested, went)
    });
    let analysis = of(entries.collect());
    assert!(analysis.marginal_effects[1].correlation.because().unwrap().contains("mass has the same value"));
    assert!(analysis.envelopes[0].frontier.because().is_some());
    let risk = analysis.risk.estimated().unwrap();
    let mass = risk.regression.terms.iter().find(|t| t.term == "mass").unwrap();
    assert!(mass.estimate.because().unwrap().contains("same value in every row"));
}

#[test]
fn separation_is_reported() {
    let space = space(&["box", "sphere"]);
    let entries = (0..300).map(|i| {
        let requested = point(&space, i);
        let heavy = requested.number("mass_kg").unwrap() > 1.0;
        let went = if heavy { Outcome::Failure(FailureMode::constant("grip_loss")) } else { Outcome::Success };
        entry(i, requested, went)
    });
    let analysis = of(entries.collect());
    let risk = analysis.risk.estimated().unwrap();
    assert_eq!(risk.regression.estimator, "firth");
    assert!(risk.regression.warnings[0].contains("Complete separation"), "{:?}", risk.regression.warnings);
}

#[test]
fn missing_columns_are_named() {
    let analysis = analysed(&space(&["box"]), law(&space(&["box"]), 300));
    let because = analysis.interactions.because().unwrap();
    assert!(because.contains("COM offset") && because.contains("IK noise"), "{because}");
}

#[test]
fn other_files_are_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        let path = dir.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    for path in [
        file("empty", ""),
        file("words.txt", "hello"),
        file("half.parquet", "PAR1 only"),
        file("half.json", "{\"experiments\": ["),
        dir.path().join("not-there"),
        dir.path().to_owned(),
    ] {
        let error = Source::open(&path).unwrap_err().to_string();
        assert!(!error.is_empty(), "{path:?}");
    }
}

#[test]
fn unknown_pair_lists_parameters() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("d.parquet");
    crate::synthetic::write(&path, &space(&["box"]), law(&space(&["box"]), 50));
    let source = Source::open(&path).unwrap();
    let pair = |a: &str, b: &str| Analysis::of(&source, &path, &[(a.to_owned(), b.to_owned())]);
    assert!(pair("friction", "colour").unwrap_err().to_string().contains("mass_kg"));
    assert!(pair("friction", "friction").is_err());
    assert!(pair("shape", "obstacles").unwrap().envelopes[1].frontier.because().unwrap().contains("categorical"));
}

#[test]
fn extreme_integers_are_handled() {
    let text = format!(
        "name = \"far\"\n[[parameter]]\nname = \"n\"\nkind = \"integer\"\nlow = {}\nhigh = {}\n\
         [[parameter]]\nname = \"m\"\nkind = \"integer\"\nlow = {}\nhigh = {}\n\
         [[parameter]]\nname = \"x\"\nkind = \"continuous\"\nlow = -1e300\nhigh = 1e300\n",
        i64::MAX - 3,
        i64::MAX,
        i64::MIN,
        i64::MIN + 2
    );
    let space = robogate_core::ParameterSpace::from_toml(&text).unwrap();
    let set = |i: u64| {
        let mut requested = robogate_core::Assignment::default();
        requested.set("n", robogate_core::Value::Integer(i64::MAX - (i % 4) as i64));
        requested.set("m", robogate_core::Value::Integer(i64::MIN + (i % 3) as i64));
        requested.set("x", robogate_core::Value::Number(if i.is_multiple_of(2) { 1e300 } else { -1e299 }));
        requested
    };
    let entries = (0..100).map(|i| {
        let went = if i % 5 < 2 { Outcome::Success } else { Outcome::Failure(FailureMode::TIMEOUT) };
        entry(i, set(i), went)
    });
    let analysis = analysed(&space, entries.collect());
    assert_eq!(analysis.success.rate.successes, 40);
}

#[test]
fn rows_with_success_only_are_analysed() {
    let dir = tempfile::tempdir().unwrap();
    let (csv, path) = (dir.path().join("results.csv"), dir.path().join("results.parquet"));
    let rows: String = (0..100).map(|i| format!("{},{i}\n", u8::from(i % 3 > 0))).collect();
    std::fs::write(&csv, format!("success,seed\n{rows}")).unwrap();
    robogate_dictionary::results::import(&csv, &path, None, &robogate_dictionary::results::Mapping::default()).unwrap();
    let analysis = Analysis::of(&Source::open(&path).unwrap(), &path, &[]).unwrap();
    assert!(analysis.marginal_effects.is_empty());
    assert!(analysis.risk.because().unwrap().contains("no parameter"));
    let because = analysis.failure_modes.dominant.because().unwrap();
    assert!(because.contains("does not record") && because.contains("grasp miss"), "{because}");
}
