//! The prior of the active stage: it is used and tested, stored beside the plan, and never replaced.

use std::fs;
use std::path::Path;

use robogate_campaign::shards::{Assignment, DirectoryStore, ShardEnd, Shards};
use robogate_campaign::{
    ActiveReport, Completion, Plan, Prior, PriorEffect, PriorError, RowsError, RunError, check_rows,
};
use robogate_core::{FailureMode, Outcome, ParameterSpace, TaskSpec, Word};
use robogate_dictionary::{Dictionary, Robot};

use crate::world::{self, Synthetic, plan, provenance, start, stop_after, summary, with_pool};

fn dictionary(dir: &Path) -> Dictionary {
    Dictionary::open(&dir.join("dictionary.parquet")).unwrap()
}

/// The prior of an earlier campaign of the same policy with 600 episodes.
fn earlier(dir: &Path) -> Prior {
    start(dir, &plan(600, 0), &Synthetic::default(), 2).unwrap();
    Prior::of(&dictionary(dir)).unwrap()
}

fn from(prior: &Prior, total: u64) -> Plan {
    let mut plan = Plan { seed: 99, ..plan(total, 0).with_active() };
    plan.active.as_mut().unwrap().prior = Some(prior.identity(&provenance().robot).unwrap());
    plan
}

fn run(dir: &Path, plan: &Plan, prior: &Prior, threads: usize, stop: u64) -> Result<Completion, RunError> {
    with_pool(&Synthetic::default(), threads, &mut stop_after(stop), |pool, events| {
        robogate_campaign::start_from(dir, plan, provenance(), prior, pool, events)
    })
}

fn report(dir: &Path) -> ActiveReport {
    serde_json::from_slice(&fs::read(dir.join("active.json")).unwrap()).unwrap()
}

#[test]
fn prior_is_used_and_tested() {
    let base = tempfile::tempdir().unwrap();
    let prior = earlier(&base.path().join("earlier"));
    let (dir, alone) = (base.path().join("with"), base.path().join("without"));
    let plan = from(&prior, 120);
    run(&dir, &plan, &prior, 2, u64::MAX).unwrap();
    let found = report(&dir);
    // 30 uniform episodes are too few for a model, but not with the prior: even the first round has chosen points.
    assert!(found.rounds.iter().all(|round| round.model.is_some()), "{found:?}");
    let mut without = plan.clone();
    without.active.as_mut().unwrap().prior = None;
    start(&alone, &without, &Synthetic::default(), 2).unwrap();
    assert!(report(&alone).prior.is_none() && report(&alone).rounds.iter().all(|round| round.prior.is_none()));
    // The uniform episodes of each round are the test of the model before it.
    let tests: Vec<u64> = found.rounds.iter().filter_map(|round| Some(round.prior?.episodes)).collect();
    assert_eq!(tests.len(), found.rounds.len() - 1);
    let rows = dictionary(&dir);
    let uniform = rows.entries().map(Result::unwrap).filter(|row| row.stage == "active" && row.design == "uniform");
    assert_eq!(tests.iter().sum::<u64>(), uniform.count() as u64);
    let result = found.prior.unwrap();
    assert!(result.with < result.without + 0.05 && result.effect != PriorEffect::Hurt, "{result:?}");
    assert!(found.rounds[1].prior.unwrap().slope > 0.0);
}

#[test]
fn threads_and_interruptions_change_nothing() {
    let base = tempfile::tempdir().unwrap();
    let prior = earlier(&base.path().join("earlier"));
    let plan = from(&prior, 160);
    let dir = base.path().join("reference");
    run(&dir, &plan, &prior, 1, u64::MAX).unwrap();
    let expected = world::files(&dir);
    assert!(expected.contains_key("prior.json"));
    let dir = base.path().join("stopped");
    // A process that was killed before it wrote the plan leaves the prior.
    fs::create_dir(&dir).unwrap();
    fs::write(dir.join("prior.json"), "{").unwrap();
    let mut completion = run(&dir, &plan, &prior, 3, 33).unwrap();
    // The earlier campaign is not needed any more.
    fs::remove_dir_all(base.path().join("earlier")).unwrap();
    while let Completion::Interrupted { .. } = completion {
        completion = with_pool(&Synthetic::default(), 2, &mut stop_after(41), |pool, events| {
            robogate_campaign::resume(&dir, &provenance(), pool, events)
        })
        .unwrap();
    }
    assert_eq!(world::files(&dir), expected);
}

#[test]
fn shards_equal_single_run() {
    let base = tempfile::tempdir().unwrap();
    let prior = earlier(&base.path().join("earlier"));
    let plan = from(&prior, 160);
    let (one, many, out) = (base.path().join("one"), base.path().join("many"), base.path().join("out"));
    run(&one, &plan, &prior, 2, u64::MAX).unwrap();
    let store = || Box::new(DirectoryStore::new(&many));
    let missing = Shards::begin(store(), 3, &plan, provenance()).unwrap_err();
    assert!(missing.to_string().contains("--prior"), "{missing}");
    let text = prior.document().unwrap();
    let campaign = Shards::begin_with(store(), 3, &plan, provenance(), &[("prior.json", &text)]).unwrap();
    while let Some(open) = campaign.open_round(None).unwrap() {
        for shard in open.missing {
            if let Some(round) = campaign.unchosen().unwrap() {
                campaign.choose(round, None).unwrap();
            }
            let Assignment::Run(task) = campaign.assign(shard, None).unwrap() else { panic!() };
            let end = with_pool(&Synthetic::default(), 2, &mut |_, _| {}, |pool, events| task.run(pool, events));
            let ShardEnd::Complete(result) = end.unwrap() else { panic!() };
            campaign.commit(&result).unwrap();
        }
    }
    let last = campaign.unchosen().unwrap().unwrap();
    campaign.choose(last, None).unwrap();
    campaign.merge(&out, &mut |_| {}, None).unwrap();
    assert_eq!(world::files(&out), world::files(&one));
    fs::write(many.join("prior.json"), "{}").unwrap();
    assert!(Shards::open(store()).unwrap_err().to_string().contains("another prior"));
}

/// The rates of a run whose prior claims the opposite are those of uniform episodes.
#[test]
fn misleading_prior_biases_no_rate() {
    let base = tempfile::tempdir().unwrap();
    let _ = earlier(&base.path().join("earlier"));
    let path = base.path().join("opposite.parquet");
    let honest = dictionary(&base.path().join("earlier"));
    let opposite = honest.entries().map(|row| {
        let mut row = row?;
        // Failures only where the part is light and the friction high.
        let of = |name: &str| row.episode.scenario.requested.number(name).unwrap();
        let success = of("friction") < 0.4 * of("mass_kg");
        row.episode.outcome =
            if success { Outcome::Success } else { Outcome::Failure(FailureMode::constant("grip_loss")) };
        Ok(row)
    });
    robogate_dictionary::write_parquet(&path, honest.provenance(), opposite).unwrap();
    let prior = Prior::of(&Dictionary::open(&path).unwrap()).unwrap();
    let even = base.path().join("even");
    let done = start(&even, &plan(4000, 0), &Synthetic::default(), 2).unwrap();
    let truth = summary(&done).estimate.success_rate.unwrap();
    let dir = base.path().join("with");
    let done = run(&dir, &from(&prior, 800), &prior, 2, u64::MAX).unwrap();
    let [low, high] = summary(&done).estimate.interval_95;
    assert!(low <= truth && truth <= high, "{low} to {high}: {truth}");
    let report = report(&dir);
    // The model drops it.
    let last = report.rounds.last().unwrap();
    assert!(last.prior.unwrap().slope < 0.2, "{last:?}");
}

#[test]
fn changed_prior_is_refused() {
    let base = tempfile::tempdir().unwrap();
    let prior = earlier(&base.path().join("earlier"));
    let plan = from(&prior, 80);
    let dir = base.path().join("run");
    run(&dir, &plan, &prior, 2, 30).unwrap();
    fs::write(dir.join("prior.json"), prior.document().unwrap().split_last().unwrap().1).unwrap();
    let error = world::resume(&dir, &Synthetic::default(), 1).unwrap_err().to_string();
    assert!(error.contains("another prior"), "{error}");
    // A plan that names a prior needs it.
    assert!(matches!(start(&base.path().join("x"), &plan, &Synthetic::default(), 1), Err(RunError::NoPrior)));
    // Rows alone do not contain the prior.
    let other = base.path().join("other");
    run(&other, &plan, &prior, 2, u64::MAX).unwrap();
    let rows = dictionary(&other);
    let checked = check_rows(rows.provenance(), None, rows.entries());
    assert!(matches!(checked, Err(RowsError::Prior)));
}

#[test]
fn unsuitable_priors_are_rejected() {
    let base = tempfile::tempdir().unwrap();
    let prior = earlier(base.path());
    let (task, space) = (world::task(), world::space());
    prior.check(&task, &space, None).unwrap();
    let other = TaskSpec { name: Word::constant("other"), ..(*task).clone() };
    assert!(matches!(prior.check(&other, &space, None), Err(PriorError::OtherTask { .. })));
    let smaller = ParameterSpace::new("small", space.parameters()[1..].to_vec()).unwrap();
    let error = prior.check(&task, &smaller, None).unwrap_err().to_string();
    assert!(error.contains("`friction`"), "{error}");
    let mut parameters = space.parameters().to_vec();
    parameters[0].domain = parameters[4].domain.clone();
    let other = ParameterSpace::new("other", parameters).unwrap();
    assert!(matches!(prior.check(&task, &other, None), Err(PriorError::Kind { .. })));
    assert!(matches!(prior.check(&task, &space, Some("explosion")), Err(PriorError::TooFew { failures: 0, .. })));
    // Another robot has other hidden draws.
    let robot = Robot { name: "ur5e".to_owned(), sha256: None, dimensions: None };
    assert!(!prior.identity(&robot).unwrap().told_draws && prior.identity(&provenance().robot).unwrap().told_draws);
}
