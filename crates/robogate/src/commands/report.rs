//! `robogate report`: writes a run or a dictionary as one page.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use clap::{Args, ValueEnum};
use robogate_analysis::{Analysis, AnalysisOptions, DEFAULT_TARGET, HERE, Source, pair_counts};
use robogate_dictionary::files;
use robogate_gate::evidence::MANIFEST;
use robogate_gate::{Evaluation, Sampling};
use robogate_report::{
    Additions, Again, Change, Watch, analysis_json_with, html_with, markdown_with, required_success,
};

use crate::active_model;
use crate::arguments::ReopeningArguments;
use crate::changes;
use crate::commands::analyze::{Groups, analyse, options};
use crate::commands::gate;
use crate::exit::{DONE, Exit, INVALID, OrExit};
use crate::force_limits;
use crate::place;
use crate::terminal::{line, note};
use crate::twins::NominalArguments;
use crate::watch::{self, Frames, Moment};
use robogate_session::{Reopening, Subject, nominal_rate_of, open_source, twins_of, warner_effect_of};

/// Write a run or a dictionary as one page: where the policy fails, what to do, and the confidence intervals.
#[derive(Debug, Args)]
pub(crate) struct Report {
    /// Folder of a run, a dictionary (Parquet) or a published JSON dictionary
    dictionary: PathBuf,
    /// Choose the format of the page
    #[arg(long, value_name = "FORMAT", default_value = "html")]
    format: Form,
    /// Write to this file, - for stdout; default: report.html, .md or .json in the run's folder, or in the current
    /// folder for a file. Must be outside of a folder of evidence
    #[arg(long, value_name = "FILE", value_parser = place::local())]
    out: Option<PathBuf>,
    /// Map two more parameters; the first is on the vertical axis
    #[arg(long, num_args = 2, value_names = ["A", "B"])]
    pair: Vec<String>,
    /// Set the success rate that the advice aims at, between 0 and 1; default: that of the gate's requirement, otherwise 0.9
    #[arg(long, value_name = "RATE")]
    target: Option<f64>,
    /// Leave out the recorded episodes
    #[arg(long)]
    no_replay: bool,
    #[command(flatten)]
    groups: Groups,
    #[command(flatten)]
    nominal: NominalArguments,
    #[command(flatten)]
    opening: ReopeningArguments,
}

/// The name of the page in a run's folder.
pub(crate) const PAGE: &str = "report.html";

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Form {
    /// One self-contained file
    Html,
    /// The same content as Markdown
    Md,
    /// One versioned JSON document
    Json,
}

impl Form {
    /// The ending of a file's name.
    fn ending(self) -> &'static str {
        match self {
            Self::Html => "html",
            Self::Md => "md",
            Self::Json => "json",
        }
    }
}

impl Report {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let source = open_source(&self.dictionary)?;
        let out = self.out(&source)?;
        let evaluation = source.folder().and_then(|folder| gate_of(folder, &source));
        let target = self.target.unwrap_or_else(|| target_of(evaluation.as_ref()));
        let analysis = analyse(&source, &self.dictionary, &options(&self.pair, target, &self.groups))?;
        // Markdown on stdout has no place for images.
        let frames = out.as_deref().filter(|_| matches!(self.format, Form::Md)).map(frames_beside);
        let watch = match self.format {
            Form::Html | Form::Md if !self.no_replay => Some(
                watch::watch(&source, &analysis, &self.opening.choice(), Moment::OnRequest, frames.as_ref())
                    .or_usage()?,
            ),
            _ => None,
        };
        let pairs = pair_counts(&source, &analysis).or_usage()?;
        let sampling = evaluation.as_ref().map_or(Sampling::Fixed, |evaluation| evaluation.sampling);
        let twins = self.nominal.twins(&source, sampling)?;
        let active = source.folder().and_then(active_model::of_run);
        let warner = source.folder().map_or(Ok(None), |folder| warner_effect_of(folder, source.dictionary()))?;
        let forces = force_limits::of_run(source.folder(), source.dictionary(), evaluation.as_ref())?;
        let changes = changes_of(&source, &analysis, evaluation.as_ref(), watch.as_ref());
        let additions = Additions {
            evaluation: evaluation.as_ref(),
            changes: &changes,
            watch: shown(watch.as_ref()),
            pairs: Some(&pairs),
            twins: twins.as_ref(),
            nominal: source.folder().map_or(Ok(None), nominal_rate_of)?,
            warner: warner.as_ref(),
            forces: &forces,
            active: active.as_ref(),
        };
        let text = match self.format {
            Form::Html => html_with(&analysis, &additions),
            Form::Md => markdown_with(&analysis, &additions),
            Form::Json => analysis_json_with(&analysis, twins.as_ref()),
        };
        match &out {
            Some(out) => write(out, &text)?,
            None => line(text.trim_end()),
        }
        Ok(evidence(&analysis))
    }

    /// The file of the page, or `None` for stdout. A page in a folder of evidence would make the evidence invalid.
    fn out(&self, source: &Source) -> Result<Option<PathBuf>, Exit> {
        let out = match &self.out {
            Some(out) if out.as_os_str() == "-" => return Ok(None),
            Some(out) => out.clone(),
            None => source.folder().unwrap_or(Path::new("")).join(format!("report.{}", self.format.ending())),
        };
        let evidence = source.folder().filter(|folder| folder.join(MANIFEST).is_file());
        match evidence.filter(|folder| place::is_within(&out, folder)) {
            Some(folder) => Err(anyhow!(
                "{} contains evidence, and another file in it would make it invalid\nHint: choose a file outside of it with --out",
                folder.display()
            ))
            .or_usage(),
            None => Ok(Some(out)),
        }
    }
}

/// The folder for images beside a page: `report-frames` for `report.md`.
fn frames_beside(page: &Path) -> Frames {
    let stem = page.file_stem().map_or_else(|| "report".to_owned(), |stem| stem.to_string_lossy().into_owned());
    let link = format!("{stem}-frames");
    Frames { folder: page.with_file_name(&link), link }
}

/// Analyzes a finished run and writes its page into its folder, unless it exists. With `frames`, images of the episodes
/// worth watching are written too. `subject` is that of the run, if it has just ended. The second result is empty if the
/// page exists.
pub(crate) fn page(
    dir: &Path,
    frames: Option<&Frames>,
    subject: Option<&Subject>,
) -> Result<(Analysis, Option<Watch>), Exit> {
    let out = dir.join(PAGE);
    let source = Source::open(dir).or_broken()?;
    let evaluation = gate_of(dir, &source);
    let target_rate = target_of(evaluation.as_ref());
    let analysis = analyse(&source, dir, &AnalysisOptions { target_rate, ..AnalysisOptions::default() })?;
    if out.exists() {
        return Ok((analysis, None));
    }
    // The user of this call has just run the subject.
    let opening = subject.map_or_else(Reopening::none, |_| Reopening::trusted());
    let watch = watch::watch(&source, &analysis, &opening, Moment::EndOfRun(subject), frames).or_broken()?;
    let pairs = pair_counts(&source, &analysis).or_broken()?;
    let sampling = evaluation.as_ref().map_or(Sampling::Fixed, |evaluation| evaluation.sampling);
    let twins = twins_of(dir, &source, sampling)?;
    let active = active_model::of_run(dir);
    let warner = warner_effect_of(dir, source.dictionary())?;
    let forces = force_limits::of_run(Some(dir), source.dictionary(), evaluation.as_ref())?;
    let changes = changes_of(&source, &analysis, evaluation.as_ref(), Some(&watch));
    let additions = Additions {
        evaluation: evaluation.as_ref(),
        changes: &changes,
        watch: shown(Some(&watch)),
        pairs: Some(&pairs),
        twins: twins.as_ref(),
        nominal: nominal_rate_of(dir)?,
        warner: warner.as_ref(),
        forces: &forces,
        active: active.as_ref(),
    };
    files::write(&out, html_with(&analysis, &additions))
        // It may not be safe on disk. Without it, a resumed run writes it again.
        .inspect_err(|_| drop(std::fs::remove_file(&out)))
        .with_context(|| format!("cannot write {}", out.display()))
        .or_broken()?;
    Ok((analysis, Some(watch)))
}

/// The success rate that the advice aims at.
pub(crate) fn target_of(evaluation: Option<&Evaluation>) -> f64 {
    evaluation.and_then(required_success).unwrap_or(DEFAULT_TARGET)
}

/// What to change, as the page says it.
fn changes_of(
    source: &Source,
    analysis: &Analysis,
    evaluation: Option<&Evaluation>,
    watch: Option<&Watch>,
) -> Vec<Change> {
    evaluation.map_or_else(Vec::new, |evaluation| {
        let again = Again::of(analysis);
        changes::of(source, analysis, evaluation, shown(watch), HERE, &again)
    })
}

/// The verdict of the gate that a run belongs to. A problem is a note, because the analysis does not depend on it.
fn gate_of(folder: &Path, source: &Source) -> Option<Evaluation> {
    gate::evaluation_of(folder, source).unwrap_or_else(|exit| {
        note(format_args!("note: the page has no verdict: {exit}"));
        None
    })
}

/// The episodes worth watching, unless there are none.
fn shown(watch: Option<&Watch>) -> Option<&Watch> {
    watch.filter(|watch| !watch.items.is_empty())
}

fn write(out: &Path, text: &str) -> Result<(), Exit> {
    files::write(out, text).with_context(|| format!("cannot write {}", out.display())).or_broken()?;
    note(format_args!("{}: {} KB", out.display(), text.len().div_ceil(1024)));
    Ok(())
}

/// Exit code 0, or 4 without a valid episode.
pub(crate) fn evidence(analysis: &Analysis) -> u8 {
    if analysis.success.rate.n > 0 { DONE } else { INVALID }
}
