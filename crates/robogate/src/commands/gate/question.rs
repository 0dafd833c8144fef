//! What a gate asks: requirements, the baseline or the run that it compares with, and trials of the real robot.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use robogate_analysis::Finding;
use robogate_analysis::transfer::Transfer;
use robogate_core::budget::Budget;
use robogate_dictionary::{Provenance, read_text};
use robogate_gate::evidence::PolicyBinding;
use robogate_gate::{Against, Baseline, RealEvidence, RealStratum, Record};

use super::Gate;
use crate::exit::{Exit, OrExit};
use crate::terminal::note;
use robogate_session::{built_in_baseline, open_source};

/// A baseline's figures, and the run that they came from if it can be compared episode by episode.
pub(super) struct Other {
    pub(super) baseline: Option<Baseline>,
    pub(super) record: Option<(PathBuf, Record)>,
}

impl Other {
    pub(super) fn against(&self, margin: f64) -> Option<Against<'_>> {
        self.record.as_ref().map(|(_, record)| Against { record, margin })
    }
}

impl Gate {
    /// The baseline's path, if it is a run. Its episodes can be compared one by one.
    pub(super) fn against_run(&self) -> Option<&Path> {
        let path = self.baseline.as_deref()?;
        (path.is_dir() || path.extension().is_some_and(|ending| ending == "parquet")).then_some(path)
    }

    pub(super) fn other_seed(&self) -> Result<Option<u64>, Exit> {
        let Some(path) = self.against_run() else { return Ok(None) };
        Ok(Some(open_source(path)?.dictionary().provenance().seed))
    }

    /// The baseline of the comparison.
    pub(super) fn other(&self, record: &Record) -> Result<Other, Exit> {
        let Some(path) = &self.baseline else {
            return Ok(Other { baseline: built_in_baseline(record), record: None });
        };
        if self.against_run().is_none() {
            let baseline = Baseline::open(path)?;
            return Ok(Other { baseline: Some(baseline), record: None });
        }
        let source = open_source(path)?;
        let a = Record::of(source.dictionary())?;
        let baseline = Baseline::of(&a)?;
        Ok(Other { baseline: Some(baseline), record: Some((path.clone(), a)) })
    }
}

/// Reads the trials of the real robot from the file of `robogate transfer --out`.
fn real_evidence(path: &Path) -> Result<RealEvidence, Exit> {
    let text = read_text(path).with_context(|| format!("cannot read {}", path.display())).or_usage()?;
    let transfer: Transfer = Budget::FILE
        .json(text.as_bytes())
        .with_context(|| {
            format!(
                "{}: not a transfer\nHint: create it with `robogate transfer --sim RUN --real FILE --out FILE`",
                path.display()
            )
        })
        .or_usage()?;
    let exact = match &transfer.exact {
        Finding::Estimated(exact) => exact,
        Finding::CannotBeEstimated { because } => {
            return Err(anyhow!("{}: it has no exact rate because {because}", path.display())).or_usage();
        }
    };
    let strata = exact.strata.map(|s| RealStratum { share: s.share, trials: s.trials, successes: s.successes });
    Ok(RealEvidence {
        format: RealEvidence::FORMAT,
        task: transfer.task.name.clone(),
        robot: transfer.simulation.robot.clone(),
        robot_sha256: transfer.simulation.robot_sha256.clone(),
        policy: transfer.simulation.policy.clone(),
        policy_sha256: transfer.simulation.policy_sha256.clone(),
        population: transfer.population.clone(),
        trials_sha256: transfer.real.sha256.clone(),
        simulation_sha256: transfer.simulation.dataset_hash.clone(),
        strata,
    })
}

/// Reads the trials of the real robot for a run with this provenance. They must be about its task, robot and policy.
pub(crate) fn real_evidence_for(path: &Path, provenance: &Provenance) -> Result<RealEvidence, Exit> {
    let real = real_evidence(path)?;
    real.check_subject(&Record::begun(provenance)?)?;
    let both = real.policy_sha256.is_some() && provenance.policy_sha256().is_some();
    if !both && PolicyBinding::of(provenance) != PolicyBinding::BuiltIn {
        note(format_args!(
            "note: {}: only the name `{}` shows that trials and episodes are about the same policy, because no SHA-256 of it is \
             known for both",
            path.display(),
            real.policy
        ));
    }
    Ok(real)
}
