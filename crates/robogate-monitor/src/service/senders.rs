//! Alarms about the senders of cycles: what was refused, and what is missing.
//!
//! A refused cycle does not reach the detectors. A sender whose cycles are refused looks like one without
//! failures, so this is an alarm of its own. Ids that count are also checked for cycles that never arrived.

use std::collections::BTreeMap;

use crate::{Alarm, Cycle, Happening, Level};

/// Steps of one after which the number at the end of an id counts as a counter.
const COUNTS_AFTER: u32 = 20;
/// Accepted cycles without another problem after which an alarm about a sender is cleared.
const CLEAR_AFTER: u64 = 1_000;
/// Most robots and senders that are followed.
const MOST_SENDERS: usize = 10_000;
/// The metric of these alarms.
const METRIC: &str = "sender";

/// A problem of a sender.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Trouble {
    /// An id arrived again with another content: the counter of the sender has restarted.
    Restarted,
    /// A line was refused for another reason.
    Refused,
    /// Ids are missing between two cycles.
    Gap,
}

impl Trouble {
    fn level(self) -> Level {
        match self {
            // All cycles of a restarted counter are lost until it passes its old end.
            Self::Restarted => Level::Critical,
            Self::Refused | Self::Gap => Level::Warning,
        }
    }

    fn look_at(self) -> &'static str {
        match self {
            Self::Restarted => {
                "a counter that restarted after a power failure or an overflow: put the date or a run number into the id"
            }
            Self::Refused => "the program that sends the cycles: the reply to each batch lists the refused lines",
            Self::Gap => "a connection that was lost, or a program that drops cycles",
        }
    }
}

/// A problem as it was found.
#[derive(Debug, Clone)]
pub(super) struct Found {
    pub(super) trouble: Trouble,
    /// The robot, or the sender of a line that is not a cycle.
    pub(super) sender: String,
    pub(super) recipe: String,
    /// The id of the cycle, or the number of the line.
    pub(super) place: String,
    pub(super) time_s: f64,
    pub(super) because: String,
}

impl Found {
    /// A problem of this cycle.
    pub(super) fn of(trouble: Trouble, cycle: &Cycle, because: String) -> Self {
        let (sender, recipe) = (cycle.robot.clone(), cycle.recipe.clone());
        Self { trouble, sender, recipe, place: cycle.id.clone(), time_s: cycle.time_s, because }
    }
}

/// The number at the end of the ids of a robot.
#[derive(Debug, Clone, Default)]
struct Counter {
    prefix: String,
    last: u64,
    /// Steps of one in a row.
    steps: u32,
}

/// What is known about the senders since the start.
#[derive(Debug, Default)]
pub(super) struct Senders {
    counters: BTreeMap<String, Counter>,
    /// The active alarms, with the accepted cycles since the last problem.
    active: BTreeMap<(String, Trouble), (Alarm, u64)>,
}

impl Senders {
    /// Follows an accepted cycle that `from` sent. Returns whether cycles before it are missing.
    pub(super) fn accept(&mut self, cycle: &Cycle, from: &str, emit: &mut dyn FnMut(Alarm)) -> bool {
        self.clear(cycle, from, emit);
        let Some((prefix, number)) = counted(&cycle.id) else { return false };
        if self.counters.len() >= MOST_SENDERS && !self.counters.contains_key(&cycle.robot) {
            return false;
        }
        let counter = self.counters.entry(cycle.robot.clone()).or_default();
        if counter.prefix != prefix {
            *counter = Counter { prefix: prefix.to_owned(), last: number, steps: 0 };
            return false;
        }
        let (last, steps) = (counter.last, counter.steps);
        if number == last.wrapping_add(1) {
            (counter.last, counter.steps) = (number, steps.saturating_add(1));
            return false;
        }
        if steps < COUNTS_AFTER {
            (counter.last, counter.steps) = (number, 0);
            return false;
        }
        if number < last {
            // It arrived late, or fills a gap.
            return false;
        }
        counter.last = number;
        let missing = number - last - 1;
        let what = if missing == 1 { "1 id is".to_owned() } else { format!("{missing} ids are") };
        let because = format!("{what} missing between {prefix}{last} and {}", cycle.id);
        self.raise(Found::of(Trouble::Gap, cycle, because), emit);
        true
    }

    /// Raises an alarm, unless the same one is active.
    pub(super) fn raise(&mut self, found: Found, emit: &mut dyn FnMut(Alarm)) {
        let key = (found.sender.clone(), found.trouble);
        if let Some((_, since)) = self.active.get_mut(&key) {
            *since = 0;
            return;
        }
        if self.active.len() >= MOST_SENDERS {
            return;
        }
        let Found { trouble, sender, recipe, place, time_s, because } = found;
        let alarm = Alarm {
            // Lines of different batches have the same numbers.
            id: format!("{METRIC}/{sender}/{trouble:?}/{place}/{time_s}"),
            happening: Happening::Raised,
            level: trouble.level(),
            recipe,
            metric: METRIC.to_owned(),
            cycle: 0,
            cycle_id: place,
            what: format!("cycles of {sender} do not reach the detectors: {because}"),
            how_sure: "a fact about the messages, not a statistic".to_owned(),
            robot: sender,
            time_s,
            since: None,
            look_at: vec![trouble.look_at().to_owned()],
        };
        emit(alarm.clone());
        self.active.insert(key, (alarm, 0));
    }

    /// Counts an accepted cycle for the active alarms of its robot, and of `from`, who sent it.
    fn clear(&mut self, cycle: &Cycle, from: &str, emit: &mut dyn FnMut(Alarm)) {
        const TROUBLES: [Trouble; 3] = [Trouble::Restarted, Trouble::Refused, Trouble::Gap];
        if self.active.is_empty() {
            return;
        }
        let robot = cycle.robot.as_str();
        let of_sender = TROUBLES.map(|trouble| (from, trouble)).into_iter().filter(|_| from != robot);
        for (name, trouble) in TROUBLES.map(|trouble| (robot, trouble)).into_iter().chain(of_sender) {
            let key = (name.to_owned(), trouble);
            let Some((_, since)) = self.active.get_mut(&key) else { continue };
            *since += 1;
            if *since >= CLEAR_AFTER
                && let Some((raised, _)) = self.active.remove(&key)
            {
                emit(Alarm {
                    id: format!("{}/cleared", raised.id),
                    happening: Happening::Cleared,
                    recipe: cycle.recipe.clone(),
                    cycle_id: cycle.id.clone(),
                    time_s: cycle.time_s,
                    what: format!("the last {CLEAR_AFTER} cycles of {name} were accepted"),
                    look_at: Vec::new(),
                    ..raised
                });
            }
        }
    }
}

/// An id as a text and the number at its end.
fn counted(id: &str) -> Option<(&str, u64)> {
    let (prefix, digits) = id.split_at(id.trim_end_matches(|c: char| c.is_ascii_digit()).len());
    Some((prefix, digits.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cycle(id: &str) -> Cycle {
        let text = format!(r#"{{"id": "{id}", "robot": "a", "recipe": "x", "time_s": 1, "success": true}}"#);
        serde_json::from_str(&text).unwrap()
    }

    fn alarms(ids: impl IntoIterator<Item = String>) -> Vec<Alarm> {
        let (mut senders, mut all) = (Senders::default(), Vec::new());
        for id in ids {
            senders.accept(&cycle(&id), "the feed", &mut |alarm| all.push(alarm));
        }
        all
    }

    #[test]
    fn gaps_are_found_in_counters_only() {
        let found = alarms((0..30).chain(33..40).map(|n| format!("a/{n}")));
        assert_eq!(found.len(), 1);
        assert!(found[0].what.contains("3 ids are missing between a/29 and a/33"), "{}", found[0].what);
        assert_eq!((found[0].level, &*found[0].metric), (Level::Warning, "sender"));
        // Times and random numbers do not count.
        assert_eq!(alarms((0..100).map(|n| format!("{}", 1_795_254_000 + 4 * n))), []);
        assert_eq!(alarms((0..100_u64).map(|n| format!("a/{}", n.wrapping_mul(2_654_435_761) % 1_000))), []);
        // A cycle that arrives late is not a gap.
        assert_eq!(alarms((0..30).chain([12]).chain(30..40).map(|n| format!("a/{n}"))), []);
        assert_eq!(alarms([format!("a/{}", "9".repeat(30)), "a".to_owned(), String::new()]), []);
    }

    #[test]
    fn alarms_are_cleared_by_good_cycles() {
        let found = alarms((0..30).chain(31..1_100).map(|n| format!("a/{n}")));
        assert_eq!(
            found.iter().map(|alarm| alarm.happening).collect::<Vec<_>>(),
            [Happening::Raised, Happening::Cleared]
        );
        assert_ne!(found[0].id, found[1].id);
    }

    #[test]
    fn alarms_about_malformed_lines_are_cleared_by_their_sender() {
        let malformed = |sender: &str| {
            let because = "2 lines are not cycles".to_owned();
            let (sender, place) = (sender.to_owned(), "line 1".to_owned());
            Found { trouble: Trouble::Refused, sender, recipe: "*".to_owned(), place, time_s: 1.0, because }
        };
        let (mut senders, mut all) = (Senders::default(), Vec::new());
        for sender in ["10.0.0.7", "10.0.0.8"] {
            senders.raise(malformed(sender), &mut |alarm| all.push(alarm));
        }
        for n in 0..CLEAR_AFTER {
            senders.accept(&cycle(&format!("a/{n}")), "10.0.0.7", &mut |alarm| all.push(alarm));
        }
        let happenings: Vec<_> = all.iter().map(|alarm| (alarm.happening, alarm.robot.as_str())).collect();
        let raised = |sender| (Happening::Raised, sender);
        assert_eq!(happenings, [raised("10.0.0.7"), raised("10.0.0.8"), (Happening::Cleared, "10.0.0.7")]);
        assert!(all[2].what.contains("the last 1000 cycles of 10.0.0.7"), "{}", all[2].what);
    }
}
