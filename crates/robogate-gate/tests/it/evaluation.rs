use robogate_core::{FailureMode, Seed, Stream, Value};
use robogate_dictionary::LostEpisode;
use robogate_gate::{
    Baseline, Ending, GateError, Population, Question, Record, Requirements, Sampling, Status, Verdict,
};

use crate::common::{baseline, failed, invalid, judge, requirements, sampled, suite, task, times, trial};

const SUCCESS: &str = "name = \"s\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.6\n";

/// All combinations of `n` endings of four kinds.
fn all_endings(n: u32) -> impl Iterator<Item = Vec<Ending>> {
    let kinds = [
        Ending::Success,
        failed(FailureMode::constant("collision")),
        failed(FailureMode::constant("grasp_miss")),
        Ending::Failure(None),
    ];
    (0..4_usize.pow(n)).map(move |code| (0..n).map(|i| kinds[code / 4_usize.pow(i) % 4].clone()).collect())
}

#[test]
fn invalid_episodes_never_reverse_a_verdict() {
    let gates = [
        "name = \"p\"\nmode = \"point\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.6\n[[requirement]]\nmetric = \"failure_count:collision\"\nat_most = 0\n[[requirement]]\nmetric = \"cycle_time_s\"\nat_most = 4.5\nceiling = 15.0\n",
        // The confidence is low, so that four episodes can decide.
        "name = \"c\"\nmode = \"confidence\"\nconfidence = 0.75\n[[requirement]]\nmetric = \"success\"\nat_least = 0.5\n[[requirement]]\nmetric = \"failure:collision\"\nat_most = 0.5\n",
    ];
    let mut decided = [0; 2];
    for gate in gates.map(requirements) {
        for sampling in [Sampling::Fixed, Sampling::Sequential] {
            for endings in all_endings(4) {
                let verdict = judge(&gate, &sampled(endings.clone()), sampling).verdict;
                decided[0] += u32::from(verdict == Verdict::Pass);
                decided[1] += u32::from(verdict == Verdict::Fail);
                for broken in 0..4 {
                    let mut with = endings.clone();
                    with[broken] = invalid();
                    let now = judge(&gate, &sampled(with), sampling).verdict;
                    let opposite =
                        matches!((verdict, now), (Verdict::Fail, Verdict::Pass) | (Verdict::Pass, Verdict::Fail));
                    assert!(!opposite, "{endings:?} {broken} {sampling:?}: {verdict} became {now}");
                }
            }
        }
    }
    assert!(decided.iter().all(|n| *n > 10), "the gates never decided: {decided:?}");
}

#[test]
fn unknown_failures_may_be_collisions() {
    let gate = requirements(
        "name = \"c\"\nmode = \"point\"\n[[requirement]]\nmetric = \"failure_count:collision\"\nat_most = 0\n",
    );
    let record = sampled([Ending::Success, Ending::Failure(None)]);
    let found = judge(&gate, &record, Sampling::Fixed);
    assert_eq!((found.verdict, found.results[0].invalid), (Verdict::Inconclusive, 1));
}

#[test]
fn unrecorded_modes_are_not_absent() {
    let gate = requirements(
        "name = \"c\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"failure:collision\"\nat_most = 0.1\n",
    );
    let mut record = sampled(times(400, &Ending::Success));
    assert_eq!(judge(&gate, &record, Sampling::Fixed).verdict, Verdict::Pass);
    for trial in &mut record.trials {
        trial.unseen = vec![FailureMode::constant("collision")];
    }
    let found = judge(&gate, &record, Sampling::Fixed);
    assert_eq!((found.verdict, found.results[0].valid), (Verdict::Inconclusive, 0));
}

#[test]
fn incomplete_rounds_are_not_judged() {
    let record = suite(8, times(21, &Ending::Success));
    let found = judge(&requirements(SUCCESS), &record, Sampling::Sequential);
    assert_eq!((found.counts.rounds, found.counts.episodes, found.counts.left_over), (Some(2), 16, 5));
    let started = suite(8, times(5, &Ending::Success));
    let found = judge(&requirements(SUCCESS), &started, Sampling::Sequential);
    assert_eq!(
        (found.verdict, found.because.as_str()),
        (Verdict::Invalid, "5 episodes are less than one complete round of the suite")
    );
}

#[test]
fn each_group_is_one_requirement() {
    let gate = requirements(
        "name = \"g\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.6\neach = \"group\"\n",
    );
    // All episodes of group 3 fail.
    let endings = (0..80).map(|i| if i % 4 == 3 { failed(FailureMode::TIMEOUT) } else { Ending::Success });
    let found = judge(&gate, &suite(8, endings), Sampling::Fixed);
    let of: Vec<(&str, Status)> = found.results.iter().map(|f| (f.id.as_str(), f.status)).collect();
    assert_eq!(
        of,
        [
            ("success[nominal/group-0]", Status::Met),
            ("success[edge_cases/group-1]", Status::Met),
            ("success[nominal/group-2]", Status::Met),
            ("success[edge_cases/group-3]", Status::Violated),
        ]
    );
    assert_eq!(found.verdict, Verdict::Fail);
    assert_eq!(found.groups.len(), 4);
    assert_eq!(found.groups[3].endings[0].ending, "timeout");
}

#[test]
fn only_fail_is_adjusted() {
    let two = |family: &str| {
        requirements(&format!(
            "name = \"f\"\nmode = \"confidence\"\nfamily = \"{family}\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.92\n[[requirement]]\nmetric = \"failure:timeout\"\nat_most = 0.08\n"
        ))
    };
    // 67 of 68: p = 0.024 for both requirements. Holm's procedure shows both.
    let record = sampled(times(67, &Ending::Success).chain([failed(FailureMode::TIMEOUT)]));
    assert_eq!(judge(&two("intersection_union"), &record, Sampling::Fixed).verdict, Verdict::Pass);
    assert_eq!(judge(&two("holm"), &record, Sampling::Fixed).verdict, Verdict::Pass);
    // p = 0.024 and p = 0.083: the smaller is shown alone, but not in a family of two.
    let record = sampled(
        times(66, &Ending::Success).chain([failed(FailureMode::TIMEOUT), failed(FailureMode::constant("grasp_miss"))]),
    );
    let status = |family| judge(&two(family), &record, Sampling::Fixed).results[1].status;
    assert_eq!((status("intersection_union"), status("holm")), (Status::Met, Status::Met));
    // P(X <= 57 | 68, 0.92) = 0.03: violated alone, undecided beside a second requirement.
    let record = sampled(times(58, &Ending::Success).chain(times(10, &failed(FailureMode::constant("grasp_miss")))));
    let alone =
        requirements("name = \"a\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.92\n");
    let p = judge(&alone, &record, Sampling::Fixed).results[0].p_violated.unwrap();
    let both = judge(&two("intersection_union"), &record, Sampling::Fixed);
    assert_eq!(both.results[0].status == Status::Violated, p <= 0.025, "p {p}");
}

#[test]
fn evaluations_round_trip() {
    let record = suite(68, times(136, &Ending::Success));
    let requirements = Requirements::open("default", &task()).unwrap();
    let baseline = baseline(&record, 1.0, 4.1, 0.0);
    let question = Question {
        requirements: &requirements,
        baseline: Some(&baseline),
        against: None,
        sampling: Sampling::Sequential,
    };
    let (a, b) = (question.evaluate(&record).unwrap(), question.evaluate(&record).unwrap());
    assert_eq!(a.to_json(), b.to_json());
    let read: robogate_gate::Evaluation = serde_json::from_str(&a.to_json()).unwrap();
    assert_eq!(read, a);
}

#[test]
fn perfect_policy_passes_after_five_rounds() {
    let requirements = Requirements::open("default", &task()).unwrap();
    let perfect = |rounds: usize| suite(68, times(68 * rounds, &Ending::Success));
    let baseline = baseline(&perfect(1), 1.0, 4.1, 0.0);
    let judge = |rounds| {
        let question = Question {
            requirements: &requirements,
            baseline: Some(&baseline),
            against: None,
            sampling: Sampling::Sequential,
        };
        question.evaluate(&perfect(rounds)).unwrap()
    };
    // "At most 1 %" cannot be shown with fewer than 299 episodes.
    let verdicts: Vec<Verdict> = (1..=5).map(|rounds| judge(rounds).verdict).collect();
    assert_eq!(verdicts[..4], [Verdict::Inconclusive; 4]);
    assert_eq!(verdicts[4], Verdict::Pass);
}

#[test]
fn unknown_durations_count_as_worst_case() {
    let gate = requirements(
        "name = \"t\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"cycle_time_s\"\nat_most_times_baseline = 1.1\nceiling = 15.0\n",
    );
    let judge = |time: f64, unknown: usize, n: usize| {
        let mut record = sampled(times(n, &Ending::Success).chain(times(unknown, &invalid())));
        for trial in &mut record.trials {
            trial.time_s = Some(time);
        }
        let baseline = baseline(&record, 1.0, 4.0, 0.0);
        let question =
            Question { requirements: &gate, baseline: Some(&baseline), against: None, sampling: Sampling::Fixed };
        question.evaluate(&record).unwrap().results.remove(0)
    };
    assert_eq!(judge(3.5, 0, 200).status, Status::Met);
    assert_eq!(judge(5.5, 0, 200).status, Status::Violated);
    assert_eq!(judge(4.4, 0, 200).status, Status::Undecided);
    // Twenty unknown durations could be 15 s each, so the mean could be 4.5 s.
    let unsure = judge(3.5, 20, 180);
    assert_eq!(unsure.status, Status::Undecided);
    assert!((unsure.figure.most.unwrap() - 4.65).abs() < 1e-9 && (unsure.figure.least.unwrap() - 3.15).abs() < 1e-9);
    let [low, high] = judge(3.5, 0, 200).interval.unwrap();
    assert!(low < 3.5 && 3.5 < high && high < 4.4);
}

#[test]
fn baselines_round_trip() {
    let made = Baseline::of(&suite(4, times(8, &Ending::Success))).unwrap();
    assert_eq!(Baseline::from_json(&made.to_json()).unwrap(), made);
    // Success rate, cycle time, and count and rate of four failure modes.
    assert_eq!(made.figures.len(), 10);
}

#[test]
fn row_order_does_not_matter() {
    let gate =
        requirements("name = \"o\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.9\n");
    // 80 % succeed. The file has the successes first, so a prefix of it would pass.
    let sorted = sampled(times(800, &Ending::Success).chain(times(200, &failed(FailureMode::constant("grasp_miss")))));
    let found = judge(&gate, &sorted, Sampling::Sequential);
    assert_eq!(found.verdict, Verdict::Fail);
    let mut turned = sorted;
    turned.trials.reverse();
    let again = judge(&gate, &turned, Sampling::Sequential);
    assert_eq!(
        (again.results[0].p_met, again.results[0].p_violated),
        (found.results[0].p_met, found.results[0].p_violated)
    );
    assert!(found.results[0].p_met.unwrap() > 0.9);
}

#[test]
fn each_group_needs_group_labels() {
    for (each, missing) in [("group", "group"), ("category", "category")] {
        let gate = requirements(&format!(
            "name = \"g\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.1\n[[requirement]]\nmetric = \"success\"\nat_least = 0.6\neach = \"{each}\"\n"
        ));
        let ask = |record: &Record| {
            Question { requirements: &gate, baseline: None, against: None, sampling: Sampling::Fixed }.evaluate(record)
        };
        let error = ask(&sampled(times(100, &Ending::Success))).unwrap_err();
        assert!(matches!(error, GateError::NoLabel { what, .. } if what == missing), "{error}");
        let mut one = suite(8, times(80, &Ending::Success));
        assert_eq!(ask(&one).unwrap().verdict, Verdict::Pass);
        one.trials[9].label.category = None;
        one.trials[9].label.group = None;
        assert!(matches!(ask(&one), Err(GateError::NoLabel { .. })));
    }
}

#[test]
fn stopped_runs_are_sequential() {
    let mut record = suite(8, times(40, &Ending::Success));
    assert_eq!(judge(&requirements(SUCCESS), &record, Sampling::Fixed).sampling, Sampling::Fixed);
    record.planned = Some(40);
    assert_eq!(judge(&requirements(SUCCESS), &record, Sampling::Fixed).sampling, Sampling::Fixed);
    record.planned = Some(80);
    let forced = judge(&requirements(SUCCESS), &record, Sampling::Fixed);
    assert_eq!(forced.sampling, Sampling::Sequential);
    assert_eq!(forced, judge(&requirements(SUCCESS), &record, Sampling::Sequential));
}

#[test]
fn relative_requirements_are_dropped_without_baseline() {
    let gate = Requirements::from_toml(
        "name = 'r'\nmode = 'confidence'\n[[requirement]]\nmetric = 'success'\nat_least = 0.5\n[[requirement]]\nmetric = 'cycle_time_s'\nat_most_times_baseline = 1.1\nceiling = 15.0\n[[requirement]]\nmetric = 'failure:grip_loss'\nat_most_times_baseline = 1.2\nat_most = 0.2\n",
    )
    .unwrap();
    let record = sampled(vec![Ending::Success; 200]);
    let evaluation = Question { requirements: &gate, baseline: None, against: None, sampling: Sampling::Fixed }
        .evaluate(&record)
        .unwrap();
    assert_eq!(evaluation.verdict, Verdict::Pass);
    let dropped: Vec<&str> = evaluation.dropped.iter().map(|dropped| dropped.id.as_str()).collect();
    assert_eq!(dropped, ["cycle_time_s", "failure:grip_loss"]);
    // The absolute limit of the second one still applies.
    assert_eq!(evaluation.results.len(), 2);
}

#[test]
fn imports_use_a_test_for_any_stopping_rule() {
    use robogate_dictionary::Stopping;
    let mut record = sampled(vec![Ending::Success; 40]);
    record.imported = true;
    for (stopping, expected) in [
        (None, Sampling::Sequential),
        (Some(Stopping::Monitored), Sampling::Sequential),
        (Some(Stopping::Fixed), Sampling::Fixed),
    ] {
        record.stopping = stopping;
        assert_eq!(record.sampling(Sampling::Fixed), expected);
    }
}

/// Ten imported episodes of each case, which succeed with the rate of their case.
fn repeating(stream: &mut Stream, rates: &[f64]) -> Record {
    let mut record = sampled([]);
    for (case, rate) in rates.iter().enumerate() {
        for _ in 0..10 {
            let ending = if stream.uniform() < *rate { Ending::Success } else { Ending::Failure(None) };
            let mut episode = trial(record.trials.len() as u64, ending);
            episode.label.case = Some(format!("case-{case}"));
            record.trials.push(episode);
        }
    }
    record.imported = true;
    record.stopping = Some(robogate_dictionary::Stopping::Fixed);
    record.population = Population::Imported {
        sha256: "1".repeat(64),
        sampling: None,
        cases: Some(rates.len() as u64),
        groups: Vec::new(),
    };
    record
}

#[test]
fn repeated_cases_are_the_population() {
    let stream = &mut Seed::campaign(1).stream("test");
    let found = judge(&requirements(SUCCESS), &repeating(stream, &[1.0; 20]), Sampling::Fixed);
    assert!(found.estimand.contains("repeat 20 cases") && found.estimand.contains("exactly these cases"));
    assert!(found.population.to_string().starts_with("imported episodes of 20 cases ("), "{}", found.population);
    // 200 episodes show a rate of these cases, 20 cases much less about others.
    assert_eq!(found.verdict, Verdict::Pass);
    let new = found.new_cases.unwrap();
    assert_eq!((new.cases, new.rate, new.interval_95[1]), (20, Some(1.0), 1.0));
    assert!(new.interval_95[0] < 0.85 && found.results[0].interval.unwrap()[0] > 0.98, "{new:?}");
    let one = judge(&requirements(SUCCESS), &repeating(stream, &[1.0]), Sampling::Fixed);
    assert!(one.new_cases.is_none() && one.estimand.contains("repeat 1 case. "), "{}", one.estimand);
    assert!(judge(&requirements(SUCCESS), &sampled(times(40, &Ending::Success)), Sampling::Fixed).new_cases.is_none());
}

#[test]
fn interval_over_new_cases_covers() {
    let stream = &mut Seed::campaign(2).stream("test");
    let (sets, mut covered) = (200, 0);
    for _ in 0..sets {
        // One case in ten always fails. The interval of 400 independent episodes would cover about half of the sets.
        let rates: Vec<f64> = (0..40).map(|_| f64::from(u8::from(stream.uniform() < 0.9))).collect();
        let [low, high] =
            judge(&requirements(SUCCESS), &repeating(stream, &rates), Sampling::Fixed).new_cases.unwrap().interval_95;
        covered += u32::from((low..=high).contains(&0.9));
    }
    assert!(covered >= 190, "{covered} of {sets}");
}

#[test]
fn invalid_episodes_widen_the_interval_over_new_cases() {
    let mut record = repeating(&mut Seed::campaign(3).stream("test"), &[1.0; 20]);
    let interval = |record: &Record| judge(&requirements(SUCCESS), record, Sampling::Fixed).new_cases.unwrap();
    let without = interval(&record);
    record.trials.iter_mut().take(10).for_each(|trial| trial.ending = invalid());
    let with = interval(&record);
    assert!(with.rate == Some(1.0) && with.interval_95[0] < without.interval_95[0], "{with:?} {without:?}");
}

/// A server that closes the connection in episodes that it would fail, and answers them another time, succeeds in all of them.
#[test]
fn lost_attempts_of_a_server_are_no_successes() {
    let gate = requirements(SUCCESS);
    let mut record = suite(8, times(80, &Ending::Success));
    let lost: Vec<LostEpisode> =
        (0..60).map(|index| LostEpisode { index, fault: "closed".to_owned(), began: index < 40 }).collect();
    record.count_lost(&lost);
    assert_eq!(judge(&gate, &record, Sampling::Fixed).verdict, Verdict::Pass, "only a server can answer differently");
    record.served = true;
    record.count_lost(&lost);
    let found = judge(&gate, &record, Sampling::Fixed);
    assert_eq!((found.counts.invalid, found.counts.valid), (40, 40), "attempts that did not begin show nothing");
    assert_ne!(found.verdict, Verdict::Pass);
    // As many invalid episodes again decide nothing either.
    assert!(found.results[0].next.is_none_or(|next| next.at_observed < 0.01), "{:?}", found.results[0].next);
}

/// Fifty imported episodes of each operator, which succeed with the operator's rate.
fn by_operator(stream: &mut Stream, rates: &[f64]) -> Record {
    let mut record = repeating(stream, &[]);
    for (operator, rate) in (0..).zip(rates) {
        for _ in 0..50 {
            let ending = if stream.uniform() < *rate { Ending::Success } else { Ending::Failure(None) };
            let mut episode = trial(record.trials.len() as u64, ending);
            episode.requested.set("tote", Value::Integer(operator));
            episode.time_s = Some(if stream.uniform() < *rate { 4.0 } else { 8.0 });
            record.trials.push(episode);
        }
    }
    record
}

/// The mean over operators is at the limit, so each verdict is wrong. Counted as independent episodes, 32 of 60 such files are
/// decided.
#[test]
fn operators_are_the_observations() {
    let stream = &mut Seed::campaign(5).stream("test");
    for metric in ["metric = \"success\"\nat_least = 0.8", "metric = \"cycle_time_s\"\nat_most = 4.8\nceiling = 10.0"] {
        let of = |groups: &str| {
            requirements(&format!("name = \"s\"\nmode = \"confidence\"\n{groups}[[requirement]]\n{metric}\n"))
        };
        let (by_row, by_group) = (of(""), of("groups = [\"tote\"]\n"));
        let (mut rows, mut groups) = (0, 0);
        for _ in 0..200 {
            // Three of four operators always succeed, the others with 0.2.
            let rates: Vec<f64> = (0..12).map(|_| if stream.uniform() < 0.75 { 1.0 } else { 0.2 }).collect();
            let record = by_operator(stream, &rates);
            let decided = |of: &Requirements| judge(of, &record, Sampling::Fixed).verdict != Verdict::Inconclusive;
            rows += u32::from(decided(&by_row));
            groups += u32::from(decided(&by_group));
        }
        println!("{metric}: {rows} of 200 decided by row, {groups} by operator");
        assert!(groups <= 20, "each end errs in at most 5 %: {groups} of 200");
        assert!(rows >= 40 || metric.contains("cycle"), "{rows}");
    }
    let gate = requirements(&SUCCESS.replace("mode", "groups = [\"tote\"]\nmode"));
    let passed = judge(&gate, &by_operator(stream, &[1.0; 12]), Sampling::Fixed);
    assert_eq!(passed.verdict, Verdict::Pass, "12 of 12 operators, limit 0.6");
    assert!(passed.estimand.contains("12 values of tote"), "{}", passed.estimand);
    // One operator with many failures counts once: the figure that is judged is the mean over operators.
    let mut uneven = by_operator(stream, &[1.0; 20]);
    for _ in 0..2_000 {
        let mut episode = trial(uneven.trials.len() as u64, Ending::Failure(None));
        episode.requested.set("tote", Value::Integer(0));
        uneven.trials.push(episode);
    }
    let found = judge(&gate, &uneven, Sampling::Fixed).results[0].clone();
    assert_eq!(found.figure.observed, Some(1.0 / 3.0));
    let over_groups = found.over_groups.unwrap();
    assert!((over_groups - (19.0 + 50.0 / 2_050.0) / 20.0).abs() < 1e-12, "{over_groups}");
    let few = judge(&gate, &by_operator(stream, &[1.0; 7]), Sampling::Fixed);
    assert_eq!(few.verdict, Verdict::Inconclusive, "fewer than 8 operators decide nothing");
    let unknown = requirements(&SUCCESS.replace("mode", "groups = [\"day\"]\nmode"));
    let question = Question { requirements: &unknown, baseline: None, against: None, sampling: Sampling::Fixed };
    let error = question.evaluate(&by_operator(stream, &[1.0; 3])).unwrap_err().to_string();
    assert!(error.contains("no column `day`"), "{error}");
}

/// Copies of a few trajectories look like many episodes, whose success rate would be certain.
#[test]
fn copies_of_trajectories_are_no_evidence() {
    let gate = requirements(SUCCESS);
    let judged = |cases: u64, distinct: u64| {
        let mut record = suite(cases, times(64, &Ending::Success));
        (0..).zip(&mut record.trials).for_each(|(i, trial)| trial.trajectory = Some(1 + i % distinct));
        judge(&gate, &record, Sampling::Fixed)
    };
    let copied = judged(32, 3);
    assert_eq!((copied.verdict, copied.distinct_trajectories), (Verdict::Invalid, Some(3)));
    assert!(copied.because.starts_with("32 scenarios have only 3 distinct trajectories"), "{}", copied.because);
    assert!(!copied.estimand.contains("fresh seeds"), "{}", copied.estimand);
    assert_eq!(judged(1, 1).verdict, Verdict::Invalid, "the seed has no effect");
    // Rounds that repeat four scenarios exactly.
    let repeated = judged(4, 4);
    assert_eq!(repeated.verdict, Verdict::Pass);
    assert!(repeated.estimand.contains("4 of 64 valid episodes have a distinct trajectory"), "{}", repeated.estimand);
    let fresh = judged(4, 64);
    assert_eq!(fresh.verdict, Verdict::Pass);
    assert!(fresh.estimand.contains("over fresh seeds"), "{}", fresh.estimand);
    // Without recorded trajectories, as in imported rows, nothing is claimed.
    let unknown = judge(&gate, &suite(4, times(64, &Ending::Success)), Sampling::Fixed);
    assert_eq!((unknown.verdict, unknown.distinct_trajectories), (Verdict::Pass, None));
}

#[test]
// All episodes are in one group, so its interval is that of a requirement at 97.5 % on each side, whichever way the number of
// episodes was chosen.
fn groups_use_the_method_of_the_requirements() {
    let gate = requirements(
        "name = \"t\"\nmode = \"confidence\"\nconfidence = 0.975\n[[requirement]]\nmetric = \"success\"\nat_least = 0.5\n",
    );
    for (sampling, planned) in
        [(Sampling::Fixed, None), (Sampling::Sequential, None), (Sampling::Sequential, Some(40 * 8))]
    {
        let mut record = suite(40, times(160, &Ending::Success));
        for trial in record.trials.iter_mut().step_by(3) {
            trial.ending = Ending::Failure(None);
        }
        for trial in &mut record.trials {
            (trial.label.category, trial.label.group) = (None, Some("all".to_owned()));
        }
        record.planned = planned;
        let question = Question { requirements: &gate, baseline: None, against: None, sampling };
        let found = question.evaluate(&record).unwrap();
        assert_eq!(Some(found.groups[0].interval_95), found.results[0].interval, "{sampling:?} {planned:?}");
    }
}

#[test]
fn undecided_requirement_states_a_probability() {
    let gate =
        requirements("name = \"t\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.9\n");
    let mut record = suite(20, times(80, &Ending::Success));
    record.trials.iter_mut().step_by(12).for_each(|trial| trial.ending = Ending::Failure(None));
    record.planned = Some(80);
    let question = Question { requirements: &gate, baseline: None, against: None, sampling: Sampling::Sequential };
    let found = question.evaluate(&record).unwrap();
    let next = found.results[0].next.unwrap();
    let [least, most] = next.over_interval;
    assert_eq!((found.verdict, next.episodes), (Verdict::Inconclusive, 80));
    assert!(least <= next.at_observed && next.at_observed <= most && most < 1.0, "{next:?}");
    let text = found.to_json();
    assert!(text.contains("over_interval") && !text.contains("decided_at"), "{text}");
}

#[test]
// Timeouts last 15 s and drops end early. Neither is a cycle time.
fn cycle_time_is_that_of_successes() {
    for (statistic, ceiling) in [("cycle_time_s", "ceiling = 15.0\n"), ("cycle_time_s:p90", "")] {
        let gate = requirements(&format!(
            "name = \"t\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"{statistic}\"\nat_most = 6.0\n{ceiling}"
        ));
        let mut record = suite(20, times(400, &Ending::Success));
        for (at, trial) in record.trials.iter_mut().enumerate() {
            trial.time_s = Some(4.0 + 0.1 * (at % 7) as f64);
            if at % 3 == 0 {
                (trial.ending, trial.time_s) = (Ending::Failure(None), Some(if at % 2 == 0 { 15.0 } else { 0.5 }));
            }
        }
        for (sampling, planned) in [(Sampling::Fixed, None), (Sampling::Sequential, Some(400))] {
            record.planned = planned;
            let found = judge(&gate, &record, sampling);
            let result = &found.results[0];
            assert_eq!((result.status, result.valid, result.invalid), (Status::Met, 266, 0), "{statistic} {result:?}");
            let observed = result.figure.observed.unwrap();
            assert!((4.0..=4.6).contains(&observed), "{observed}");
        }
        record.trials.iter_mut().for_each(|trial| trial.ending = Ending::Failure(None));
        assert_eq!(judge(&gate, &record, Sampling::Fixed).results[0].status, Status::NoEvidence);
    }
}
