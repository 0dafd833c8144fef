//! Warnings within an episode.

use robogate_core::{Seed, SignalGroup, SignalKind, Signals, Stream};
use robogate_monitor::warn::{
    Baselines, Calibration, Conditions, Detector, Features, Model, PROMISED, Scored, Tally, Track, WarnError, WarnFile,
    Warner, calibrate, divided, false_warnings, score, seconds, train, upper_bound, view,
};

fn features() -> Features {
    let group = |name: &str, kind, length| SignalGroup { name: name.to_owned(), kind, length, unit: String::new() };
    let groups = vec![
        group("position", SignalKind::Observation, 2),
        group("vector", SignalKind::Command, 2),
        group("gripper", SignalKind::Gripper, 1),
    ];
    Features { signals: Signals { period_s: 0.05, groups, gripper_in_vector: None }, parameters: Vec::new() }
}

/// An arm follows its command for 3 to 5 s and closes its gripper half-way. Before a failure it follows less and less from 1.5 s
/// before the event on.
fn track(index: u64, fails: bool, seed: &str) -> Track {
    let mut stream: Stream = Seed::campaign(1).episode(index).stream(seed);
    let event_s = stream.between(3.0, 5.0);
    let (mut position, mut times, mut rows) = ([0.0; 2], Vec::new(), Vec::new());
    for tick in 0..(event_s / 0.05) as usize + 10 {
        let time_s = 0.05 * tick as f64;
        let command = [0.1 * time_s, (0.8 * time_s).sin() * 0.1];
        let lost = if fails { ((time_s - event_s + 1.5) / 1.5).clamp(0.0, 1.0) } else { 0.0 };
        for (x, wanted) in position.iter_mut().zip(command) {
            *x += (1.0 - lost) * 0.5 * (wanted - *x) + 0.001 * stream.normal();
        }
        let closes = if time_s > 0.5 * event_s { 1.0 } else { -1.0 };
        times.push(time_s as f32);
        rows.extend(position.into_iter().chain(command).chain([closes]).map(|x| x as f32));
    }
    Track {
        index,
        scenario: index,
        sampled: true,
        failure: fails.then(|| "lost".to_owned()),
        event_s,
        times,
        rows,
        parameters: Vec::new(),
        scenario_numbers: Vec::new(),
    }
}

fn tracks(n: u64, failing: u64, seed: &str) -> Vec<Track> {
    (0..n).map(|i| track(i, failing > 0 && i % failing == 0, seed)).collect()
}

fn scored(detector: &Detector, tracks: &[&Track]) -> Vec<Scored> {
    tracks.iter().map(|track| score(detector, track).unwrap()).collect()
}

fn trained(tracks: &[Track]) -> (Detector, Calibration) {
    let (model, others) = divided(tracks, 1);
    let detector = train(features(), &model, 1).unwrap();
    let calibration = calibrate(&scored(&detector, &others), PROMISED).unwrap();
    (detector, calibration)
}

/// Both kinds of detector keep the promise on fresh successes and warn early.
#[test]
fn failures_are_warned_and_successes_are_not() {
    for (failing, early) in [(4, 0.9), (0, 0.6)] {
        let (detector, calibration) = trained(&tracks(600, failing, "train"));
        assert_eq!(matches!(detector.model, Model::Trees(_)), failing > 0);
        let fresh = tracks(1_200, 4, "fresh");
        let fresh = scored(&detector, &fresh.iter().collect::<Vec<_>>());
        let seen = view(&fresh, calibration.threshold, &seconds(&fresh));
        let found = false_warnings(&fresh, calibration.threshold);
        assert_eq!(found.of, 900);
        assert!(found.warned <= 45, "{failing}: {found:?}");
        assert!(seen.modes[1].early > early, "{failing}: {:?}", seen.modes[1]);
        assert!(seen.modes[1].matched[1].auroc.unwrap() > 0.9, "{:?}", seen.modes[1].matched);
        assert_eq!(seen.modes[1].is_hidden(), Some(false));
    }
}

/// The threshold is the k-th smallest of n with P(Beta(k, n - k + 1) ≥ 0.95) ≥ 0.95: 484 of 500, and 59 of 59.
#[test]
fn promise_needs_59_successes() {
    let of = |n: u64| -> Vec<Scored> {
        let of = |i: u64| Scored {
            index: i,
            scenario: i,
            sampled: true,
            failure: None,
            event_s: 1.0,
            times: vec![0.0],
            scores: vec![i as f64],
        };
        (0..n).map(of).collect()
    };
    let rank = |n| calibrate(&of(n), PROMISED).map(|found| (found.rank, found.threshold));
    assert_eq!(rank(58), Err(WarnError::TooFew { found: 58, needed: 59, promised: 0.05 }));
    assert_eq!(rank(59), Ok((59, 58.0)));
    assert_eq!(rank(500), Ok((484, 483.0)));
    assert!(upper_bound(16, 500) <= 0.05 && upper_bound(17, 500) > 0.05);
    // Repeated scenarios count once, and scenarios that a model chose do not count.
    let mut repeated = of(500);
    repeated.iter_mut().for_each(|episode| episode.scenario %= 50);
    assert!(matches!(calibrate(&repeated, PROMISED), Err(WarnError::TooFew { found: 50, .. })));
    let mut chosen = of(100);
    chosen.iter_mut().skip(40).for_each(|episode| episode.sampled = false);
    assert!(matches!(calibrate(&chosen, PROMISED), Err(WarnError::TooFew { found: 40, .. })));
}

/// A score depends on the past alone: not on how long the episode runs, nor on what happens later.
#[test]
fn score_knows_no_duration() {
    for failing in [4, 0] {
        let all = tracks(300, failing, "train");
        let (detector, _) = trained(&all);
        let whole = score(&detector, &all[1]).unwrap();
        let cut = score(&detector, &Track { event_s: 1.0, ..all[1].clone() }).unwrap();
        assert_eq!(cut.scores.len(), 20);
        assert_eq!(cut.scores, whole.scores[..20]);
        // The warner of a robot gives the same.
        let mut warner = Warner::new(&detector, f64::INFINITY);
        for _ in 0..2 {
            warner.start(&[]);
            let given = all[1].rows.chunks_exact(5).zip(&all[1].times).take(20);
            let scores: Vec<f64> = given.map(|(row, time_s)| warner.observe(*time_s, row).unwrap()).collect();
            assert_eq!(scores, cut.scores);
        }
        assert!(warner.bytes() <= 256 * 1024, "{}", warner.bytes());
    }
}

/// At the same age a clock knows nothing.
#[test]
fn clock_has_no_matched_advantage() {
    let all = tracks(300, 3, "clock");
    let (detector, _) = trained(&all);
    let clock: Vec<Scored> =
        scored(&detector, &all.iter().collect::<Vec<_>>()).iter().map(|of| of.with(f64::from)).collect();
    for matched in &view(&clock, 9.0, &[1.0]).modes[0].matched {
        assert_eq!(matched.auroc, Some(0.5));
    }
}

#[test]
fn file_repeats_the_scores() {
    for failing in [4, 0] {
        let all = tracks(300, failing, "file");
        let (detector, calibration) = trained(&all);
        let (trees, distance) = match &detector.model {
            Model::Trees(trees) => (trees.lines(), None),
            Model::Distance(distance) => (Vec::new(), Some(distance.clone())),
        };
        let word = || "x".to_owned();
        let file = WarnFile {
            runs: Vec::new(),
            warn_format: WarnFile::FORMAT,
            conditions: Conditions { task: word(), engine: word(), robot: word(), policy: word(), population: word() },
            features: detector.features.clone(),
            known: Vec::new(),
            trees,
            distance,
            calibration,
            events: Vec::new(),
            baselines: Baselines { clock: 1.0, scenario: None, parameters: Vec::new(), trees: Vec::new() },
        };
        let text = serde_json::to_string(&file).unwrap();
        let read: WarnFile = serde_json::from_str(&text).unwrap();
        let again = read.detector().unwrap();
        assert_eq!(score(&again, &all[0]).unwrap(), score(&detector, &all[0]).unwrap());
        // Tables that do not fit are an error.
        let mut broken = read.clone();
        broken.features.signals.groups[0].length = 100_000_000;
        assert!(broken.detector().is_err());
        let mut broken = read.clone();
        broken.trees = vec!["tree 900<0.5 =1 =2".to_owned()];
        broken.distance = None;
        assert!(broken.detector().is_err());
        if let Some(mut distance) = read.distance.clone() {
            distance.means.pop();
            assert!(WarnFile { distance: Some(distance), ..read }.detector().is_err());
        }
    }
}

/// At the promised rate warnings are rarely ever suspended; at three times the rate they soon are.
#[test]
fn broken_promise_suspends_warnings() {
    let suspended_after = |rate: f64, seed: u64| {
        let mut stream = Seed::campaign(seed).stream("tally");
        let mut tally = Tally::new(PROMISED);
        (1..=2_000).find(|_| tally.ended(true, stream.uniform() < rate))
    };
    let false_alarms = (0..200).filter(|seed| suspended_after(0.05, *seed).is_some()).count();
    assert!(false_alarms <= 10, "{false_alarms} of 200");
    let delays: Vec<Option<u64>> = (0..50).map(|seed| suspended_after(0.15, seed)).collect();
    assert!(delays.iter().all(Option::is_some), "{delays:?}");
    let mut tally = Tally::new(PROMISED);
    assert!(!tally.ended(false, true) && !tally.ended(false, false));
    assert_eq!((tally.warned_failures, tally.missed_failures, tally.suspended), (1, 1, false));
}
