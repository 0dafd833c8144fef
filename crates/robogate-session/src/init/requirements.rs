//! Requirements from three figures in plain units.

use std::fmt::Write as _;

use anyhow::bail;
use robogate_core::{FailureMode, TaskSpec};
use robogate_gate::Requirements;
use robogate_stats::format::{count, number};
use robogate_tasks::pick_place::spec::COLLISION;

use crate::gate::SAMPLED_SCENARIOS;

/// What the user requires.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wanted {
    /// The share of cycles that must succeed.
    pub success: f64,
    /// The collisions that are allowed in a thousand cycles. `None` for no requirement.
    pub collisions: Option<f64>,
    /// The longest mean duration of a successful cycle, in seconds. `None` for no requirement.
    pub cycle_time_s: Option<f64>,
}

/// Rounds of a gate without a rare event.
const ROUNDS: f64 = 20.0;
/// The number of episodes without an event that show a rate of at most p at 95 % is `-ln(0.05) / p`, for small rates.
const SHOWS: f64 = 3.0;

/// The failure mode for collisions, by its name.
pub fn collision_mode(task: &TaskSpec) -> Option<FailureMode> {
    task.modes().find(|mode| mode.as_str().contains(COLLISION.as_str()))
}

/// The file of these requirements (TOML), and remarks for the user.
///
/// # Errors
/// A figure out of range, or collisions of a task that declares none.
pub fn requirements(wanted: &Wanted, task: &TaskSpec) -> anyhow::Result<(String, Vec<String>)> {
    let Wanted { success, collisions, cycle_time_s } = *wanted;
    if !(0.0 < success && success < 1.0) {
        bail!("--success: expected more than 0 % and less than 100 %: no number of episodes shows 100 %");
    }
    let mut remarks = Vec::new();
    let (mut rounds, mut rest) = (ROUNDS, String::new());
    if let Some(thousandths) = collisions {
        if !(0.0 < thousandths && thousandths < 1000.0) {
            bail!("--collisions-per-thousand: expected more than 0 and less than 1000: no number of episodes shows 0");
        }
        let Some(mode) = collision_mode(task) else {
            let known: Vec<&str> = task.modes().map(FailureMode::as_str).collect();
            bail!(
                "--collisions-per-thousand: the task {} declares no failure mode for collisions, but {}\nHint: declare the mode \
                 `collision` in the Task of the environment (docs/guides/environments.md), or leave the option out",
                task.name,
                known.join(", ")
            );
        };
        let (rate, episodes) = (1e-3 * thousandths, (SHOWS / (1e-3 * thousandths)).ceil());
        rounds = rounds.max((2.0 * episodes / SAMPLED_SCENARIOS as f64).ceil()).min(10_000.0);
        remarks.push(format!(
            "at most {} collisions per thousand: it takes at least {} episodes without one to show this \
             (`robogate gate --plan` prints how many)",
            number(thousandths),
            count(episodes as u64)
        ));
        let _ = write!(rest, "\n[[requirement]]\nmetric = \"failure:{mode}\"\nat_most = {rate}\n");
    }
    if let Some(limit) = cycle_time_s {
        let ceiling = task.time_limit_s;
        if limit <= 0.0 {
            bail!("--cycle-time: expected more than 0 s");
        }
        if limit < ceiling {
            let _ = write!(
                rest,
                "\n[[requirement]]\nmetric = \"cycle_time_s\"\nat_most = {limit:?}\n# The time limit of an episode: the test of a \
                 mean needs it.\nceiling = {ceiling:?}\n"
            );
        } else {
            remarks.push(format!(
                "no requirement on the cycle time: an episode of {} ends after {} s anyway",
                task.name,
                number(ceiling)
            ));
        }
    }
    let text = format!(
        "# Requirements of the gate. Each is shown at the confidence, or the verdict is inconclusive (docs/guides/gate.md).\n\
         name = \"{0}\"\ntask = \"{0}\"\nmode = \"confidence\"\nconfidence = 0.95\n\n\
         # The gate stops earlier if the verdict is certain.\n[budget]\nrounds = {rounds}\n\n\
         [[requirement]]\nmetric = \"success\"\nat_least = {success}\n{rest}",
        task.name
    );
    Requirements::from_toml(&text)?;
    Ok((text, remarks))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A task whose episodes end after 15 s, with these failure modes.
    fn task(modes: &[&str]) -> TaskSpec {
        let mut task = (*crate::registry::task("pendulum").unwrap().task()).clone();
        let named = |name: &&str| {
            let mode = FailureMode::new(name).unwrap();
            robogate_core::FailureModeSpec { name: mode, ..task.failure_modes[0].clone() }
        };
        task.failure_modes = modes.iter().map(named).collect();
        task.time_limit_s = 15.0;
        task
    }

    #[test]
    fn three_figures_become_requirements() {
        let wanted = Wanted { success: 0.9, collisions: Some(1.0), cycle_time_s: Some(12.0) };
        let (text, remarks) = requirements(&wanted, &task(&["collision", "timeout"])).unwrap();
        let read = Requirements::from_toml(&text).unwrap();
        let limits: Vec<_> = read.requirement.iter().map(|one| (one.id(), one.at_least, one.at_most)).collect();
        assert_eq!(limits.len(), 3, "{text}");
        assert_eq!((limits[0].1, limits[1].2, limits[2].2), (Some(0.9), Some(0.001), Some(12.0)));
        // 3,000 episodes show the rate of collisions, so the default budget of 1,280 would not do.
        assert!(read.budget.rounds >= 47 && remarks[0].contains("3,000"), "{remarks:?}");
        let long = Wanted { cycle_time_s: Some(20.0), ..wanted };
        let (text, remarks) = requirements(&long, &task(&["collision"])).unwrap();
        assert!(!text.contains("cycle_time_s") && remarks[1].contains("ends after 15 s"), "{remarks:?}");
    }

    #[test]
    fn impossible_figures_are_refused() {
        let plain = Wanted { success: 0.9, collisions: None, cycle_time_s: None };
        for (wanted, part) in [
            (Wanted { success: 1.0, ..plain }, "no number of episodes shows 100 %"),
            (Wanted { collisions: Some(1.0), ..plain }, "declares no failure mode for collisions"),
            (Wanted { collisions: Some(0.0), ..plain }, "more than 0"),
            (Wanted { cycle_time_s: Some(-1.0), ..plain }, "more than 0 s"),
        ] {
            let error = requirements(&wanted, &task(&["timeout"])).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
    }
}
