//! `robogate replay`: one episode again, bit for bit, with its story.

use std::path::PathBuf;

use clap::Args;
use robogate_campaign::{Workshop, recorded};
use robogate_core::{Episode, Outcome, Phase, rollout_with};
use serde_json::json;

use crate::commands::run::provenance;
use crate::exit::{DONE, Exit, INVALID, OrExit};
use crate::guest::Guest;
use crate::remote::Simulators;
use crate::terminal::{bold, dim, line};
use crate::world::Cell;

/// Run one episode of a campaign again, bit for bit, and tell its story.
#[derive(Debug, Args)]
pub(crate) struct Replay {
    /// The run's folder
    dir: PathBuf,
    /// The episode's index, as in the dictionary
    index: u64,
    #[command(flatten)]
    simulators: Simulators,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Something that happened, when and in which phase.
struct Line {
    time_s: f64,
    phase: Option<Phase>,
    what: String,
}

impl Replay {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let settings = robogate_campaign::settings(&self.dir).or_usage()?;
        let cell = Cell::recorded(&settings.provenance, &self.simulators)?.asked_again()?;
        let entry = recorded(&self.dir, self.index).or_usage()?;
        let mut station = cell.station().or_broken()?;
        let mut story: Vec<Line> = Vec::new();
        let mut phase = None;
        let before = entry.episode;
        let again = rollout_with(&mut *station.simulator, &mut *station.policy, &before.scenario, &mut |tick| {
            let time_s = tick.step.observation.time_s;
            if tick.action.phase != phase {
                phase = tick.action.phase;
                story.push(Line { time_s, phase, what: "begins".to_owned() });
            }
            story.extend(tick.step.events.iter().map(|what| Line { time_s, phase, what: what.clone() }));
        });
        let same = again == before;
        if self.json {
            self.print_json(&again, &story, same);
        } else {
            self.print(&again, &story);
            if same {
                line(format_args!("same as recorded, bit for bit (trajectory {:016x})", again.trajectory_hash));
            } else {
                line(bold("NOT the same as recorded"));
                line(format_args!("  recorded {}", describe(&before)));
                line(format_args!("  replayed {}", describe(&again)));
                let now = provenance(&cell, settings.provenance.space.clone())?;
                let was = &settings.provenance;
                if (&now.tool, &now.engine, &now.robot, &now.platform)
                    != (&was.tool, &was.engine, &was.robot, &was.platform)
                {
                    line("  tool, engine, robot or platform are not those that the run was made with");
                }
                if now.world != was.world {
                    line("  the policy is another: not the file of the run, or its server says other things of itself");
                }
                let profile = cell.world().policy.as_ref().and_then(Guest::profile);
                if profile.is_some_and(|profile| !profile.dialect.is_file()) {
                    line(
                        "  the policy is behind a server: where that draws at random, no replay is the same (robogate policy check)",
                    );
                }
            }
        }
        Ok(if same { DONE } else { INVALID })
    }

    fn print(&self, episode: &Episode, story: &[Line]) {
        line(bold(format_args!("Episode {} of {}", self.index, self.dir.display())));
        for (name, asked) in episode.scenario.requested.iter() {
            line(format_args!("  {name:<14} {asked}"));
        }
        line("");
        let mut last = None;
        for Line { time_s, phase, what } in story {
            let word = phase.map_or("", Phase::word);
            if last == Some(*phase) {
                line(format_args!("  {time_s:>6.2} s  {:<15} {what}", ""));
            } else if what == "begins" {
                line(format_args!("  {time_s:>6.2} s  {}", bold(format_args!("{word:<15}"))));
            } else {
                line(format_args!("  {time_s:>6.2} s  {word:<15} {what}"));
            }
            last = Some(*phase);
        }
        line("");
        line(format_args!("{}", bold(describe(episode))));
        if let Some(contact) = &episode.contact {
            line(format_args!("  {} touched {} with {:.1} N", contact.robot_body, contact.other_body, contact.force_n));
        }
        let m = &episode.measures;
        for (what, value, unit, scale) in [
            ("peak contact force", m.peak_contact_force_n, "N", 1.0),
            ("slip in the hand", m.slip_m, "mm", 1e3),
            ("least clearance", m.min_clearance_m, "mm", 1e3),
            ("distance to target", m.target_distance_m, "mm", 1e3),
        ] {
            match value {
                Some(x) => line(format_args!("  {what:<20} {:>8.1} {unit}", scale * x)),
                None => line(format_args!("  {what:<20} {:>8}", dim("-"))),
            }
        }
    }

    fn print_json(&self, episode: &Episode, story: &[Line], same: bool) {
        let story: Vec<_> = story
            .iter()
            .map(|Line { time_s, phase, what }| json!({"time_s": time_s, "phase": phase, "what": what}))
            .collect();
        let requested: serde_json::Map<_, _> =
            episode.scenario.requested.iter().map(|(name, value)| (name.to_owned(), json!(value))).collect();
        line(json!({
            "version": 1,
            "index": self.index,
            "requested": requested,
            "outcome": episode.outcome.word(),
            "time_s": episode.time_s,
            "phase": episode.phase,
            "contact": episode.contact,
            "measures": episode.measures,
            "ticks": episode.ticks,
            "trajectory_hash": format!("{:016x}", episode.trajectory_hash),
            "same_as_recorded": same,
            "story": story,
        }));
    }
}

/// An episode's end in one line.
fn describe(episode: &Episode) -> String {
    let phase = episode.phase.map_or_else(String::new, |phase| format!(" in {}", phase.word()));
    match &episode.outcome {
        Outcome::Invalid(fault) => format!("invalid: {fault}"),
        outcome => format!("{} at {:.3} s{phase}", outcome.word(), episode.time_s),
    }
}
