use robogate_gate::{Baseline, Ending, GateError, Question, Requirements, Sampling};

use crate::common::{baseline, invalid, requirements, sampled, suite, times};

fn refused(toml: &str) -> String {
    Requirements::from_toml(toml).unwrap_err().to_string()
}

fn one(mode: &str, lines: &str) -> String {
    format!("name = \"x\"\nmode = \"{mode}\"\n[[requirement]]\n{lines}\n")
}

#[test]
fn undecidable_requirements_are_rejected() {
    for lines in [
        "metric = \"failure:collision\"\nat_most = 0.0",
        "metric = \"success\"\nat_least = 1.0",
        "metric = \"failure_count:collision\"\nat_most = 0",
    ] {
        let text = refused(&one("confidence", lines));
        assert!(text.contains("can't be met at any number of episodes") && text.contains("Hint:"), "{text}");
    }
    assert!(refused(&one("point", "metric = \"success\"\nat_least = 92.0")).contains("write 92 % as 0.92"));
    // The paper's gate compares counts, so a limit of zero can be met.
    assert!(Requirements::from_toml(&one("point", "metric = \"failure_count:collision\"\nat_most = 0")).is_ok());
}

#[test]
fn zero_relative_limits_are_rejected() {
    let record = suite(4, times(8, &Ending::Success));
    let gate = requirements(&one("confidence", "metric = \"failure:grasp_miss\"\nat_most_times_baseline = 1.2"));
    let ask = |baseline: Option<&Baseline>| {
        let question = Question { requirements: &gate, baseline, against: None, sampling: Sampling::Fixed };
        question.evaluate(&record).unwrap_err().to_string()
    };
    let perfect = baseline(&record, 1.0, 4.0, 0.0);
    assert!(ask(Some(&perfect)).contains("also set `at_most` as a minimum limit"));
    assert!(ask(None).contains("robogate gate --run RUN --write-baseline FILE"));
    let mut other = perfect.clone();
    other.population = sampled([]).population;
    assert!(ask(Some(&other)).contains("the baseline is of space test"), "{}", ask(Some(&other)));
    let mut poor = perfect;
    poor.figures.clear();
    assert!(ask(Some(&poor)).contains("the baseline has no such figure"));
}

#[test]
fn empty_requirements_are_rejected() {
    assert!(refused("name = \"x\"\nmode = \"point\"\n").contains("would pass every policy"));
    assert!(
        refused(&one("confidence", "metric = \"failure:grip_loss\"\nat_most = 1.0")).contains("holds for every rate")
    );
    let twice = one(
        "point",
        "metric = \"failure:grip_loss\"\nat_most = 0.1\n[[requirement]]\nmetric = \"failure:grip_loss\"\nat_most = 0.2",
    );
    assert!(refused(&twice).contains("duplicate"));
}

#[test]
fn typing_errors_are_located() {
    for (toml, problem) in [
        (one("point", "metric = \"failure:grip_loss\""), "expected either"),
        (one("point", "metric = \"failure:grip_loss\"\nat_most = nan"), "finite"),
        (one("point", "metric = \"failure:grip_loss\"\nat_most = 0.1\nat_least = 0.2"), "expected either"),
        (one("point", "metric = \"drop_rat\"\nat_most = 0.1"), "`drop_rat` is not a metric"),
        (one("point", "metric = \"failure:grip_loss\"\nat_mots = 0.1"), "unknown field `at_mots`"),
        (one("point", "metric = \"cycle_time_s\"\nat_most = 5.0"), "ceiling"),
        (one("sure", "metric = \"failure:grip_loss\"\nat_most = 0.1"), "unknown variant `sure`"),
        (
            one("point", "metric = \"failure:grip_loss\"\nat_most = 0.1\neach = \"group\"\ngroup = \"g\""),
            "cannot be combined with",
        ),
        (one("point\"\nconfidence = 95\n#", "metric = \"failure:grip_loss\"\nat_most = 0.1"), "95 % is 0.95"),
        (
            one("point", "metric = \"failure:grip_loss\"\nat_most = 0.1\n[budget]\nrounds = 0"),
            "`budget.rounds` is 0; expected 1 to",
        ),
    ] {
        let text = refused(&toml);
        assert!(text.contains(problem), "{toml}\n{text}");
    }
}

#[test]
fn unknown_scopes_list_known_ones() {
    let gate = requirements(&one("point", "metric = \"success\"\nat_least = 0.5\ngroup = \"heavy\""));
    let question = Question { requirements: &gate, baseline: None, against: None, sampling: Sampling::Fixed };
    let error = question.evaluate(&suite(4, times(4, &Ending::Success))).unwrap_err();
    assert!(error.to_string().contains("nominal/group-0, edge_cases/group-1"), "{error}");
    let error = question.evaluate(&sampled(times(4, &Ending::Success))).unwrap_err();
    assert!(error.to_string().contains("not episodes of a suite"), "{error}");
}

#[test]
fn values_beyond_ceiling_are_rejected() {
    let gate = requirements(&one("confidence", "metric = \"cycle_time_s\"\nat_most = 5.0\nceiling = 15.0"));
    let mut record = sampled(times(4, &Ending::Success));
    record.trials[2].time_s = Some(64.3);
    let question = Question { requirements: &gate, baseline: None, against: None, sampling: Sampling::Fixed };
    assert!(matches!(question.evaluate(&record), Err(GateError::OutOfRange { index: 2, .. })));
}

#[test]
fn unlabelled_episodes_are_rejected() {
    let gate = requirements(&one("point", "metric = \"success\"\nat_least = 0.5"));
    let mut record = suite(4, times(8, &Ending::Success));
    record.trials[5].label = robogate_dictionary::Label::default();
    let question = Question { requirements: &gate, baseline: None, against: None, sampling: Sampling::Fixed };
    assert!(matches!(question.evaluate(&record), Err(GateError::MixedLabels { index: 5 })));
}

#[test]
fn invalid_baselines_are_rejected() {
    assert!(matches!(Baseline::of(&sampled(times(3, &invalid()))), Err(GateError::EmptyBaseline)));
    assert!(Baseline::from_json("{}").unwrap_err().to_string().contains("not a baseline"));
    assert!(Baseline::from_json("{\"format\": 7}").unwrap_err().to_string().contains("format 7"));
}
