//! Writes and prints the result of a fleet.

use std::path::Path;

use anyhow::Context;
use robogate_dictionary::{TaskIdentity, files};
use robogate_gate::{Fleet, FleetSubject, FleetUnit, Verdict};
use robogate_report::{fleet_drivers, fleet_headline, fleet_html, fleet_markdown, fleet_share};

use crate::exit::{DONE, Exit, INVALID, OrExit};
use crate::terminal::{bold, dim, line, note, wrapped};
use robogate_session::FleetPlan;
use robogate_session::text::quoted;

/// The files of the result.
const FILES: [&str; 3] = ["fleet-result.json", "fleet.md", "fleet.html"];

/// Evaluates the units, writes the files and prints the result.
pub(super) fn write(dir: &Path, plan: &FleetPlan, units: Vec<FleetUnit>, json: bool) -> Result<u8, Exit> {
    let provenance = &plan.provenance;
    let subject = FleetSubject {
        task: TaskIdentity::of(&provenance.task),
        robot: provenance.robot.name.clone(),
        policy: provenance.policy.clone(),
        scenarios: plan.nominal_record()?.population,
        requirements: plan.requirements.clone(),
        unit_space: plan.unit_space.clone(),
        seed: plan.seed,
        required_share: plan.required_share,
    };
    let fleet = Fleet::of(subject, units);
    let texts = [fleet.to_json(), fleet_markdown(&fleet), fleet_html(&fleet)];
    for (name, text) in FILES.iter().zip(&texts) {
        let path = dir.join(name);
        files::write(&path, text).with_context(|| format!("cannot write {}", path.display())).or_broken()?;
    }
    if json {
        line(texts[0].trim_end());
    } else {
        print(dir, &fleet);
    }
    Ok(match fleet.verdict {
        _ if fleet.units.iter().all(|unit| unit.verdict == Verdict::Invalid) => INVALID,
        Some(verdict) => verdict.exit_code(),
        None => DONE,
    })
}

fn print(dir: &Path, fleet: &Fleet) {
    line("");
    line(bold(format_args!("  {}", fleet_headline(fleet))));
    line(dim(format_args!("  {} on {}, {}", fleet.policy, fleet.robot, fleet.scenarios)));
    line("");
    fleet_share(fleet).iter().for_each(|text| line(format_args!("  {text}")));
    line("");
    line(bold("  What distinguishes worse units"));
    fleet_drivers(fleet).iter().for_each(|text| wrapped(text));
    line("");
    wrapped(&fleet.share.estimand);
    let files: Vec<String> = FILES.iter().map(|name| dir.join(name).display().to_string()).collect();
    note(format_args!("files: {}", files.join(", ")));
    if let Some(unit) = fleet.units.iter().find(|unit| unit.verdict == Verdict::Fail) {
        note(format_args!("details: robogate report {}", quoted(&dir.join(format!("unit-{:03}", unit.unit)))));
    }
}
