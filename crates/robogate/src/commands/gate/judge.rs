//! `robogate gate --run`: judges a finished run.

use std::path::Path;

use anyhow::Context;
use robogate_analysis::{AnalysisOptions, Source};
use robogate_dictionary::files;
use robogate_gate::{Asked, Evaluation, Question, RealEvidence, Requirements, Sampling, Verdict};
use robogate_report::Again;
use robogate_stats::format::counted;

use super::question::{Other, real_evidence_for};
use super::verdict::{answer_files, show};
use super::{Gate, baseline};
use crate::changes;
use crate::commands::analyze::analyse;
use crate::commands::report::target_of;
use crate::exit::{Exit, OrExit};
use crate::force_limits;
use crate::terminal::note;
use crate::twins::NominalArguments;
use robogate_session::text::quoted;
use robogate_session::{
    MARGIN, compared_with, judged, nominal_rate_of, open_source, question, record_of, twins_of, warner_effect_of,
};

impl Gate {
    /// Judges a finished run.
    pub(super) fn judge(&self, run: &Path) -> Result<u8, Exit> {
        self.check_nominal()?;
        let source = open_source(run)?;
        if let Some(file) = &self.write_baseline {
            baseline::write(&source, file)?;
        }
        let mut record = record_of(&source)?;
        let asked = source.folder().map_or(Ok(None), Asked::of)?;
        if let Some(asked) = &asked {
            asked.check(source.dictionary().provenance())?;
        }
        // A run that was tested after each round stays a sequential test, also if it is judged again.
        let sampling = asked.as_ref().map_or(Sampling::Fixed, |asked| asked.sampling);
        let requirements = match (&self.requirements, &asked) {
            (None, Some(asked)) => asked.requirements.clone(),
            (name, _) => Requirements::open(name.as_deref().unwrap_or("default"), &record.task)?,
        };
        let requirements = force_limits::added(requirements, self.force_limits.as_deref(), &record.task)?;
        let other = match &asked {
            Some(asked) if self.baseline.is_none() => {
                Other { baseline: asked.baseline.clone(), record: compared_with(asked)? }
            }
            _ => self.other(&record)?,
        };
        self.check_margin(other.record.is_some())?;
        let asked_margin = asked.as_ref().and_then(|asked| Some(asked.against.as_ref()?.margin));
        let margin = self.margin.or(asked_margin).unwrap_or(MARGIN);
        record.real = match &self.real {
            Some(file) => Some(real_evidence_for(file, source.dictionary().provenance())?),
            None => asked.as_ref().and_then(|asked| asked.real.clone()),
        };
        if let Some(asked) = &asked {
            self.note_changes(asked, &requirements, asked_margin, record.real.as_ref());
        }
        let question = Question {
            requirements: &requirements,
            baseline: other.baseline.as_ref(),
            against: other.against(margin),
            sampling,
        };
        let nominal = NominalArguments::of(self.nominal.clone().flatten());
        let twins = nominal.twins(&source, sampling)?;
        let mut evaluation = question.evaluate(&nominal.judged(record))?;
        evaluation.twins = twins;
        evaluation.nominal = source.folder().map_or(Ok(None), nominal_rate_of)?;
        if let Some(folder) = source.folder() {
            evaluation.warner = warner_effect_of(folder, source.dictionary())?;
        }
        if let Some(out) = &self.out {
            files::create_folders(out).with_context(|| format!("cannot create {}", out.display())).or_broken()?;
            answer_files(out, &evaluation, None)?;
        }
        let code = show(run, self.out.as_deref(), &evaluation, source.dictionary().provenance(), self.how.json)?;
        if !self.how.json && evaluation.verdict != Verdict::Pass {
            let target_rate = target_of(Some(&evaluation));
            let options = AnalysisOptions { target_rate, models: false, ..AnalysisOptions::default() };
            let analysis = analyse(&source, run, &options)?;
            let again = self.again(Again::of(&analysis));
            changes::print(&changes::of(&source, &analysis, &evaluation, None, &quoted(run), &again));
        }
        Ok(code)
    }

    /// Prints one line for each part of the question that differs from the question of the run's gate.
    fn note_changes(
        &self,
        asked: &Asked,
        requirements: &Requirements,
        margin: Option<f64>,
        real: Option<&RealEvidence>,
    ) {
        if *requirements != asked.requirements {
            let (was, is) = (&asked.requirements.name, &requirements.name);
            note(format_args!(
                "note: the run's gate used the requirements `{was}`; this evaluation uses `{is}` as given now"
            ));
        }
        if let Some(path) = &self.baseline {
            let was = match (&asked.against, &asked.baseline) {
                (Some(against), _) => format!("the run {}", against.path),
                (None, Some(_)) => "another baseline".to_owned(),
                (None, None) => "no baseline".to_owned(),
            };
            note(format_args!(
                "note: the run's gate compared with {was}; this evaluation compares with {}",
                path.display()
            ));
        }
        if let (Some(was), Some(is)) = (margin, self.margin)
            && (was - is).abs() > 0.0
        {
            note(format_args!("note: the run's gate used the margin {was}; this evaluation uses {is}"));
        }
        if real != asked.real.as_ref() {
            note(format_args!(
                "note: the run's gate used {}; this evaluation uses {}",
                described(asked.real.as_ref()),
                described(real)
            ));
        }
    }
}

/// The trials of the real robot in a few words, with the first digits of the hashes of both data sets.
fn described(real: Option<&RealEvidence>) -> String {
    let short = |sha256: &str| sha256.get(..12).unwrap_or(sha256).to_owned();
    real.map_or_else(
        || "no real trials".to_owned(),
        |real| {
            let (trials, simulation) = (short(&real.trials_sha256), short(&real.simulation_sha256));
            format!("{} ({trials}, simulation {simulation})", counted(real.trials(), "real trial"))
        },
    )
}

/// The evaluation of the gate that a run's folder belongs to. `None` for a run without a gate.
pub(crate) fn evaluation_of(folder: &Path, source: &Source) -> Result<Option<Evaluation>, Exit> {
    let Some(asked) = Asked::of(folder)? else { return Ok(None) };
    asked.check(source.dictionary().provenance())?;
    let record = judged(folder, source.dictionary(), &asked)?;
    let other = compared_with(&asked)?.map(|(_, record)| record);
    let mut evaluation = question(&asked, other.as_ref()).evaluate(&record)?;
    evaluation.twins = twins_of(folder, source, asked.sampling)?;
    evaluation.nominal = nominal_rate_of(folder)?;
    evaluation.warner = warner_effect_of(folder, source.dictionary())?;
    Ok(Some(evaluation))
}
