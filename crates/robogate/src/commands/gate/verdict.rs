//! The answer of a gate: its files, and what is printed.

use std::fs;
use std::path::Path;

use anyhow::Context;
use robogate_analysis::Source;
use robogate_campaign::Completion;
use robogate_dictionary::{Provenance, files};
use robogate_gate::{Asked, Evaluation, Record, Verdict};
use robogate_report::{Again, Watch, evaluation_markdown_with, junit};
use robogate_stats::format::counted;

use crate::answer;
use crate::benchmark;
use crate::changes;
use crate::commands::report::PAGE;
use crate::commands::run::{interrupted, write_report};
use crate::exit::{Exit, OrExit};
use crate::terminal::{line, note};
use crate::twins;
use crate::watch::Frames;
use robogate_session::text::quoted;
use robogate_session::{Failure, Subject, judged, nominal_rate_of, question, twins_of, warner_effect_of};

/// The files of the evaluation in a run's folder.
const ANSWER: [&str; 3] = ["gate.json", "gate.md", "gate.junit.xml"];

/// The folder of images to which the Markdown file refers, in a run's folder.
const FRAMES: &str = "frames";

/// Evaluates a finished run, writes the verdict and the report, and prints the verdict. `again` has the options of a new run, where the
/// command line is that of this gate.
pub(crate) fn finish(
    dir: &Path,
    asked: &Asked,
    other: Option<&Record>,
    completion: Completion,
    subject: Option<&Subject>,
    again: Option<&Again>,
    json: bool,
) -> Result<u8, Exit> {
    if let Completion::Interrupted { done, episodes } = completion {
        return Ok(interrupted(dir, done, episodes));
    }
    let frames = Frames { folder: dir.join(FRAMES), link: FRAMES.to_owned() };
    let answered = ANSWER.iter().all(|name| dir.join(name).exists());
    if !answered {
        // Its episodes worth watching are also part of the answer. An error shows when the page is written.
        let _ = fs::remove_file(dir.join(PAGE));
    }
    let (analysis, watch) = write_report(dir, Some(&frames), subject).unzip();
    // The evaluation uses the rows on disk, and not those that were seen during the run.
    let source = Source::open(dir).or_broken()?;
    let record = judged(dir, source.dictionary(), asked)?;
    let mut evaluation = question(asked, other).evaluate(&record)?;
    evaluation.twins = twins_of(dir, &source, asked.sampling)?;
    evaluation.nominal = nominal_rate_of(dir)?;
    evaluation.warner = warner_effect_of(dir, source.dictionary())?;
    if let Some(twins) = &evaluation.twins {
        twins::write(dir, twins)?;
    }
    let watch = watch.flatten();
    // An answer that is there lists the episodes of the page that is there.
    let same = || fs::read_to_string(dir.join(ANSWER[0])).is_ok_and(|there| there == evaluation.to_json());
    if !answered || watch.is_some() || !same() {
        answer_files(dir, &evaluation, watch.as_ref())?;
    }
    let code = show(dir, Some(dir), &evaluation, source.dictionary().provenance(), json)?;
    if let Some(analysis) = analysis.filter(|_| !json) {
        let watch = watch.as_ref().filter(|watch| !watch.items.is_empty());
        let again = again.cloned().unwrap_or_else(|| Again::of(&analysis));
        changes::print(&changes::of(&source, &analysis, &evaluation, watch, &quoted(dir), &again));
    }
    Ok(code)
}

/// Writes the files of the evaluation into the folder of a run.
pub(crate) fn answer_files(dir: &Path, evaluation: &Evaluation, watch: Option<&Watch>) -> Result<(), Failure> {
    let texts = [evaluation.to_json(), evaluation_markdown_with(evaluation, watch), junit(evaluation)];
    for (name, text) in ANSWER.iter().zip(texts) {
        let path = dir.join(name);
        let written = files::write(&path, text).with_context(|| format!("cannot write {}", path.display()));
        robogate_session::OrFailure::or_broken(written)?;
    }
    Ok(())
}

/// Prints the verdict on `run`, a folder or a dictionary, and the files of the answer in `dir`, if it has any. `provenance` is that
/// of the run.
pub(super) fn show(
    run: &Path,
    dir: Option<&Path>,
    evaluation: &Evaluation,
    provenance: &Provenance,
    json: bool,
) -> Result<u8, Exit> {
    if json {
        line(evaluation.to_json().trim_end());
    } else {
        answer::print(evaluation);
        benchmark::print(evaluation, provenance);
        if let Some(dir) = dir {
            let files: Vec<String> = ANSWER.iter().map(|name| dir.join(name).display().to_string()).collect();
            note(format_args!("files: {}", files.join(", ")));
        }
        if evaluation.verdict == Verdict::Fail || evaluation.counts.invalid > 0 {
            note(format_args!("details: robogate report {}", quoted(run)));
        }
        if evaluation.counts.left_over > 0 {
            let left_over = counted(evaluation.counts.left_over, "episode");
            note(format_args!("not judged: {left_over} after the last complete round"));
        }
    }
    Ok(evaluation.verdict.exit_code())
}
