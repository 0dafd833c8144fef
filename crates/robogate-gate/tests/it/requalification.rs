//! What a requalification answers, and how often its claims are false.

use std::sync::Arc;

use robogate_core::{Assignment, FailureMode, Fault, FaultKind, Seed, Value};
use robogate_gate::{Answer, Ending, Requalification, Requalifier, Seen, Trace};
use serde_json::json;

const MARGIN: f64 = 0.1;
const ERROR: f64 = 0.05;

/// What a stand-in for an episode does.
#[derive(Debug, Clone)]
struct Physics {
    /// Where the cup is at the start, and how far it is pushed.
    x: f64,
    z: f64,
    pushed: f64,
    touched: bool,
    drift: f64,
    iterations: f64,
    warnings: f64,
    ticks: u32,
    succeeds: bool,
}

impl Physics {
    /// An episode that succeeds.
    fn of(index: u64) -> Self {
        Self {
            x: 0.01 * index as f64,
            z: 0.02,
            pushed: 0.1,
            touched: true,
            drift: 0.0,
            iterations: 2.0,
            warnings: 0.0,
            ticks: 40,
            succeeds: true,
        }
    }

    fn trace(&self) -> Trace {
        let pose = |x: f64| [x, 0.0, self.z, 1.0, 0.0, 0.0, 0.0];
        let header = json!({
            "signals": ["contacts", "penetration_m", "solver_iterations", "warnings"],
            "bodies": [{"name": "cup", "robot": false}],
            "pairs": ["cup and robot"],
            "frames": 3,
            "start": {"cup": pose(self.x)},
        });
        let mut bytes = format!("{header}\n").into_bytes();
        let frame = |x: f64, warnings: f64, touches: bool| {
            [1.0, 0.0, self.iterations, warnings].into_iter().chain(pose(x)).chain([f64::from(touches)])
        };
        let frames = [
            frame(self.x, 0.0, false),
            frame(self.x + self.drift, 0.0, false),
            frame(self.x + self.drift + self.pushed, self.warnings, self.touched),
        ];
        frames.into_iter().flatten().for_each(|number| bytes.extend(f64::to_le_bytes(number)));
        Trace::read(&bytes).unwrap()
    }

    fn seen(&self, index: u64) -> Seen {
        let ending = if self.succeeds { Ending::Success } else { Ending::Failure(Some(FailureMode::TIMEOUT)) };
        Seen {
            index,
            requested: Assignment::default(),
            case: None,
            ending,
            ticks: self.ticks,
            hash: 0,
            start: vec![self.x],
            trace: Some(Arc::new(self.trace())),
        }
    }
}

/// Requalifies `n` pairs in rounds, in which `change` makes the episode after the upgrade of the one before.
fn requalified(n: u64, change: impl Fn(u64, &mut Physics)) -> Requalification {
    let pair = |index: u64| {
        let (before, mut after) = (Physics::of(index), Physics::of(index));
        change(index, &mut after);
        [before.seen(index), after.seen(index)]
    };
    in_rounds((0..n).map(pair).collect())
}

fn in_rounds(pairs: Vec<[Seen; 2]>) -> Requalification {
    let mut judge = Requalifier::new(pairs.iter().map(|[before, _]| before.clone()).collect(), 1, MARGIN, ERROR);
    let mut pairs = pairs.into_iter();
    loop {
        let round: Vec<[Seen; 2]> = pairs.by_ref().take(20).collect();
        judge.round(round);
        let result = judge.conclude();
        if result.is_certain() || pairs.len() == 0 {
            return result;
        }
    }
}

#[track_caller]
fn answers(result: &Requalification, answer: Answer, part: &str) {
    assert_eq!(result.answer, answer, "{}", result.headline);
    let all = format!("{} {:?}", result.headline, result.changes);
    assert!(all.contains(part), "{all}");
}

#[test]
fn equal_pairs_have_no_relevant_change() {
    let result = requalified(60, |_, _| {});
    // 60 pairs bound success, but not all other properties, as far as a relevant change.
    answers(&result, Answer::NoRelevantChange, "a change in up to");
    assert!(result.changes.is_empty() && result.success.interval_95[1] <= MARGIN, "{result:?}");
}

#[test]
fn few_pairs_are_inconclusive() {
    answers(&requalified(10, |_, _| {}), Answer::Inconclusive, "the margin is 10 points");
}

#[test]
fn equal_success_can_mean_something_else() {
    let untouched = requalified(60, |_, after| (after.pushed, after.touched) = (0.0, false));
    answers(&untouched, Answer::MeaningChanged, "motion of cup 0.0 %, 100.0 % before");
    assert!(format!("{untouched:?}").contains("contact of cup and robot"));
    answers(&requalified(60, |_, after| after.ticks = 60), Answer::MeaningChanged, "duration 60 control periods");
    answers(&requalified(60, |_, after| after.drift = 0.004), Answer::MeaningChanged, "drift of cup");
}

#[test]
fn initial_states_are_compared() {
    let higher = requalified(60, |_, after| after.z += 0.012);
    answers(&higher, Answer::StartsChanged, "height of cup: +12 mm (median) in 60 starts");
    let same = requalified(60, |_, after| after.x = 0.0);
    answers(&same, Answer::StartsChanged, "effectively different ones: 1, 60 before");
}

#[test]
fn lost_success_is_claimed() {
    let result = requalified(60, |index, after| after.succeeds = !index.is_multiple_of(3));
    answers(&result, Answer::SuccessChanged, "less in 0 of 40 pairs");
    assert!(result.success.interval_95[1] < 0.0 && result.success.only[1] == 0, "{:?}", result.success);
}

#[test]
fn regions_are_named() {
    let pair = |index: u64| {
        let mass = index as f64 / 10.0;
        let physics = |succeeds: bool| Physics { succeeds, ..Physics::of(index) };
        [physics(true), physics(mass <= 13.0)].map(|physics| {
            let mut requested = Assignment::default();
            requested.set("mass", Value::Number(mass));
            Seen { requested, ..physics.seen(index) }
        })
    };
    let result = in_rounds((0..200).map(|i| pair(i * 83 % 200)).collect());
    answers(&result, Answer::SuccessChanged, "success where mass 13.2 to 19.9");
    assert!(!format!("{:?}", result.changes).contains("success where mass 0"), "{:?}", result.changes);
}

#[test]
fn causes_of_failing_episodes_are_named() {
    let broken = |index: u64| {
        let ending = Ending::Invalid(Fault::new(FaultKind::Setup, "eq_data has 12 numbers"));
        let before = Physics::of(index).seen(index);
        [before.clone(), Seen { ending, trace: None, start: Vec::new(), ..before }]
    };
    answers(&in_rounds((0..20).map(broken).collect()), Answer::CannotRun, "20 episodes: eq_data has 12 numbers");
    let start = Requalification::does_not_start("no module".to_owned(), 20);
    answers(&start, Answer::CannotRun, "no module");
}

#[test]
fn mixed_up_starts_are_no_pairs() {
    let result = requalified(60, |index, after| after.x = 0.01 * ((index * 37 + 11) % 60) as f64);
    answers(&result, Answer::NotPaired, "nearest to that of their own pair");
    let mut judge = Requalifier::new(Vec::new(), 1, MARGIN, ERROR);
    judge.is_unpaired("2 of 4 episodes start differently".to_owned());
    answers(&judge.conclude(), Answer::NotPaired, "2 of 4 episodes");
}

#[test]
fn a_common_shift_keeps_pairs() {
    answers(&requalified(60, |_, after| after.x += 0.4), Answer::StartsChanged, "horizontal position of cup");
}

#[test]
fn more_solver_work_is_named() {
    answers(&requalified(60, |_, after| after.iterations = 9.0), Answer::SolverWorse, "solver iterations 9, 2 before");
    answers(&requalified(60, |_, after| after.warnings = 3.0), Answer::SolverWorse, "engine warnings");
    // Less work is not worse.
    answers(&requalified(60, |_, after| after.iterations = 0.1), Answer::NoRelevantChange, "");
}

#[test]
fn copies_of_a_pair_count_once() {
    let lost = |index: u64| {
        let [mut before, mut after] = [true, false].map(|succeeds| Physics { succeeds, ..Physics::of(0) }.seen(index));
        (before.hash, after.hash) = (7, 8);
        [before, after]
    };
    let result = in_rounds((0..60).map(lost).collect());
    answers(&result, Answer::Inconclusive, "");
    assert_eq!((result.pairs, result.distinct), ([60, 60], 1));
}

/// An upgrade that changes last bits only: both episodes of a pair are samples of the same distribution, which depends on the scenario.
#[test]
fn claims_are_rarely_false() {
    const REPEATS: u64 = 200;
    let mut false_claims = 0;
    for repeat in 0..REPEATS {
        let mut random = Seed::campaign(1_000 + repeat).stream("upgrade");
        let pair = |index: u64| {
            let chance = random.uniform();
            let mut episode = || {
                let succeeds = random.uniform() < 0.3 + 0.6 * chance;
                let mut seen = Physics {
                    succeeds,
                    pushed: if random.uniform() < chance { 0.1 } else { 0.0 },
                    touched: random.uniform() < chance,
                    drift: if random.uniform() < 0.3 { 0.004 * random.uniform() } else { 0.0 },
                    iterations: 2.0 + 4.0 * random.uniform(),
                    warnings: if random.uniform() < 0.2 { 1.0 } else { 0.0 },
                    ticks: 30 + (30.0 * random.uniform()) as u32,
                    ..Physics::of(index)
                }
                .seen(index);
                seen.requested.set("mass", Value::Number(chance));
                seen
            };
            [episode(), episode()]
        };
        let result = in_rounds((0..100).map(pair).collect());
        false_claims += u64::from(!result.changes.is_empty());
    }
    let rate = false_claims as f64 / REPEATS as f64;
    assert!(rate <= ERROR, "{false_claims} of {REPEATS}");
    println!("false claims: {false_claims} of {REPEATS}");
}
