//! What a warner changes.

use std::collections::BTreeMap;

use robogate_core::{FailureMode, Measures};
use robogate_dictionary::OnWarning;
use robogate_gate::{ActingWarner, Ending, HANDOVER, Trial, WARNED_S, WARNED_STOP, WarnerEffect};

use crate::common::trial;

const JAM: FailureMode = FailureMode::constant("jam");

fn acting(on_warning: OnWarning) -> ActingWarner {
    ActingWarner { on_warning, detector_sha256: "a".repeat(64), promised: Some(0.05) }
}

fn ended(index: u64, ending: Ending, warned: bool) -> Trial {
    let measures: Measures = warned.then_some((WARNED_S, Some(1.5))).into_iter().collect();
    Trial { index, measures, ..trial(index, ending) }
}

fn failure(mode: FailureMode) -> Ending {
    Ending::Failure(Some(mode))
}

#[test]
fn stops_are_counted_apart() {
    let trials = [
        ended(0, Ending::Success, false),
        ended(1, failure(JAM), false),
        ended(2, failure(WARNED_STOP), true),
        ended(3, failure(WARNED_STOP), true),
        ended(4, failure(WARNED_STOP), true),
    ];
    let ends = [(2, "success"), (3, "jam"), (4, "jam")].map(|(index, end)| (index, end.to_owned()));
    let unwarned = BTreeMap::from(ends.clone());
    let effect = WarnerEffect::of(&acting(OnWarning::Stop), trials.iter(), &unwarned);
    assert_eq!(
        (effect.warned, effect.ended, effect.avoided, effect.false_warnings, effect.missed, effect.unknown),
        (3, 3, 2, 1, 1, 0)
    );
    let without = effect.without.as_ref().unwrap();
    assert_eq!((effect.with.successes, without.successes, without.failures["jam"]), (1, 2, 3));
    let text = effect.lines().join("\n");
    for part in
        ["3 of 5 episodes were stopped", "2 of them fail (avoided", "1 succeed (false stops)", "jam 1 in place of 3"]
    {
        assert!(text.contains(part), "{part}: {text}");
    }

    // An episode that did not repeat leaves the rate without the warner unknown.
    let effect = WarnerEffect::of(&acting(OnWarning::Stop), trials.iter(), &ends[1..].iter().cloned().collect());
    assert_eq!((effect.unknown, effect.without.is_none()), (1, true));
}

#[test]
fn slow_motion_can_save_and_spoil() {
    let trials = [ended(0, Ending::Success, true), ended(1, failure(JAM), true), ended(2, failure(JAM), true)];
    let unwarned = BTreeMap::from([(0, "jam"), (1, "jam"), (2, "success")].map(|(index, end)| (index, end.to_owned())));
    let effect = WarnerEffect::of(&acting(OnWarning::Slow(2)), trials.iter(), &unwarned);
    assert_eq!((effect.avoided, effect.not_avoided, effect.false_warnings, effect.spoiled), (1, 1, 1, 1));
}

#[test]
fn recorded_warnings_need_no_second_run() {
    let trials = [ended(0, Ending::Success, true), ended(1, failure(HANDOVER), true), ended(2, failure(JAM), true)];
    let effect = WarnerEffect::of(&acting(OnWarning::Record), trials.iter(), &BTreeMap::new());
    assert_eq!((effect.unknown, effect.false_warnings, effect.not_avoided), (0, 1, 1));
    assert!(effect.lines()[0].contains("3 of 3 episodes were warned"), "{:?}", effect.lines());
}
