//! The result as a Markdown page.

use std::fmt::Write;

use super::answer;

use robogate_analysis::labels::{parameter_label, value_with_unit};
use robogate_analysis::study::{Arm, ArmFigures, Figures, LearnerFigures, MeanFigure, Measure, Score, Study, Verdict};
use robogate_stats::format::{count, fixed, list, percent, percent_range, range, sentence};

/// A study as a Markdown page.
pub fn page(study: &Study) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail; so throughout this file.
    let _ = write!(out, "# Is boundary focusing worth it?\n\n{}\n\n", subject(study));
    for sentence in &answer(study) {
        let _ = writeln!(out, "- **{sentence}**");
    }
    out.push('\n');
    data(&mut out, study);
    out += "## On data that no model has seen\n\n";
    out += "Boundary error is the question's own measure; the others stand beside it. Each cell has the mean over repeats, \
            and below it the difference to the uniform design with its 95 % interval.\n\n";
    for learner in &study.learners {
        judged(&mut out, learner);
    }
    paper(&mut out, study);
    repeats(&mut out, study);
    method(&mut out, study);
    out
}

fn subject(study: &Study) -> String {
    let of = &study.subject;
    format!(
        "{} with the {} policy in {}, parameter space `{}`: {} episodes for each of three designs, {} times over, judged on \
         {} episodes drawn independently from the operating space.",
        of.robot,
        of.policy,
        of.engine,
        of.space,
        count(study.budget),
        count(study.repeats),
        count(study.test.episodes)
    )
}

fn data(out: &mut String, study: &Study) {
    *out += "## What was compared\n\n| Design | Episodes | of them focused | Success rate there | Fitted |\n\
             | --- | ---: | ---: | ---: | --- |\n";
    for of in &study.designs {
        let fitted = match of.arm {
            Arm::Uniform => "every episode alike",
            Arm::TwoStage => "alike, as published; and weighted back to the operating space",
            _ => "alike: weights would be equal within the region",
        };
        let _ = writeln!(
            out,
            "| {} | {} | {} | {} | {fitted} |",
            of.arm.name(),
            count(of.episodes),
            count(of.focused),
            of.rate.rate.map_or_else(|| "-".to_owned(), percent),
        );
    }
    let test = &study.test;
    let of_rate = match test.rate.rate {
        Some(rate) => format!("{} ({})", percent(rate), percent_range(test.rate.wilson_95)),
        None => "-".to_owned(),
    };
    let _ = writeln!(
        out,
        "| test set | {} | 0 | {} | never |\n\n\
         Stating the commoner outcome everywhere has a boundary error of {}; stating the overall success rate ({}) has a log \
         loss of {} and a Brier score of {}. A model must beat these.\n",
        count(test.episodes),
        of_rate,
        percent(test.error_of_the_commoner),
        test.rate.rate.map_or_else(|| "-".to_owned(), percent),
        fixed(test.log_loss_of_the_rate, 3),
        fixed(test.brier_of_the_rate, 3),
    );
}

/// Where the pure-boundary design draws from.
fn region(study: &Study) -> String {
    let ranges: Vec<String> = study
        .region
        .iter()
        .map(|of| {
            value_with_unit(&format!("{} {}", parameter_label(&of.parameter), range([of.low, of.high])), &of.parameter)
        })
        .collect();
    list(&ranges)
}

fn judged(out: &mut String, learner: &LearnerFigures) {
    let _ = write!(out, "### {}\n\n{}.\n\n", title(learner), sentence(&learner.about));
    *out += "| Design | Boundary error | Log loss | Brier score | AUC |\n| --- | ---: | ---: | ---: | ---: |\n";
    let mut missing = Vec::new();
    for ArmFigures { arm, figures } in &learner.arms {
        match figures.estimated() {
            Some(figures) => {
                let cells: Vec<String> = figures.test.iter().map(cell).collect();
                let _ = writeln!(out, "| {} | {} |", arm.name(), cells.join(" | "));
            }
            None => {
                let _ = writeln!(out, "| {} | - | - | - | - |", arm.name());
                missing.push(format!("{}: {}.", sentence(arm.name()), figures.because().unwrap_or_default()));
            }
        }
    }
    out.push('\n');
    for why in missing {
        let _ = write!(out, "{why}\n\n");
    }
}

fn title(learner: &LearnerFigures) -> String {
    sentence(&learner.name)
}

fn cell(score: &Score) -> String {
    let mut text = value(score.measure, score.value.mean);
    if let Some(difference) = &score.less_uniform {
        text += &format!("<br>{}", change(score.measure, difference));
        match score.verdict {
            Some(Verdict::NotShown) | None => {}
            Some(verdict) => text += &format!("<br>**{}**", verdict.words()),
        }
    }
    text
}

/// A measure's value.
fn value(measure: Measure, x: f64) -> String {
    if measure == Measure::BoundaryError { percent(x) } else { fixed(x, 3) }
}

/// A difference with its interval, of the boundary error in percentage points.
fn change(measure: Measure, difference: &MeanFigure) -> String {
    let (factor, decimals) = if measure == Measure::BoundaryError { (100.0, 1) } else { (1.0, 3) };
    let signed = |x: f64| {
        let text = fixed(factor * x, decimals);
        if text.starts_with('\u{2212}') || text.chars().all(|c| matches!(c, '0' | '.')) {
            text
        } else {
            format!("+{text}")
        }
    };
    match difference.interval_95 {
        Some([low, high]) => format!("{} ({} to {})", signed(difference.mean), signed(low), signed(high)),
        None => format!("{} (no interval)", signed(difference.mean)),
    }
}

fn paper(out: &mut String, study: &Study) {
    *out += "## The paper's own comparison\n\n\
             The paper states an AUC of 0.754 for its uniform stage and of 0.780 for both stages together, each on the very \
             rows that its model was fitted to, and reads the rise as the gain of focusing. The same figures here, beside \
             the AUC of the same models on the one test set:\n\n\
             | Learner | Design | AUC in sample, on its own rows | less uniform's | AUC on the test set | less uniform's |\n\
             | --- | --- | ---: | ---: | ---: | ---: |\n";
    for learner in &study.learners {
        let uniform = study.figures(learner.learner, Arm::Uniform);
        for arm in [Arm::Uniform, Arm::TwoStage, Arm::PureBoundary] {
            let Some(figures) = study.figures(learner.learner, arm) else { continue };
            let own = figures.mean_auc_in_sample();
            let test = |f: &Figures| f.score(Measure::Auc).map_or(f64::NAN, |score| score.value.mean);
            let (mut of_own, mut of_test) = (String::new(), String::new());
            if let Some(uniform) = uniform.filter(|_| arm != Arm::Uniform) {
                of_own = signed(own - uniform.mean_auc_in_sample());
                of_test = signed(test(figures) - test(uniform));
            }
            let _ = writeln!(
                out,
                "| {} | {} | {} | {of_own} | {} | {of_test} |",
                learner.name,
                arm.name(),
                fixed(own, 3),
                fixed(test(figures), 3)
            );
        }
    }
    *out += "\nThe in-sample column compares nothing: an AUC says how well successes are told from failures *among the rows \
             at hand*, and each design has other rows. Where a second stage adds many easy rows the AUC rises, where it \
             adds hard ones it falls, and the model may be the same in both cases. Only the test set asks all models the \
             same questions.\n\n";
}

fn signed(x: f64) -> String {
    let text = fixed(x, 3);
    if text.starts_with('\u{2212}') || text == "0.000" { text } else { format!("+{text}") }
}

fn repeats(out: &mut String, study: &Study) {
    *out += "## Every repeat\n\n| Learner | Design | Repeat | Boundary error | Log loss | Brier score | AUC (DeLong's 95 %) |\n\
             | --- | --- | ---: | ---: | ---: | ---: | ---: |\n";
    for learner in &study.learners {
        for ArmFigures { arm, figures } in &learner.arms {
            let Some(figures) = figures.estimated() else { continue };
            for (r, [low, high]) in figures.auc_95.iter().enumerate() {
                let of = |measure| {
                    let x = figures.score(measure).and_then(|score| score.value.repeats.get(r)).copied();
                    x.map_or_else(|| "-".to_owned(), |x| value(measure, x))
                };
                let _ = writeln!(
                    out,
                    "| {} | {} | {} | {} | {} | {} | {} ({} to {}) |",
                    learner.name,
                    arm.name(),
                    r + 1,
                    of(Measure::BoundaryError),
                    of(Measure::LogLoss),
                    of(Measure::Brier),
                    of(Measure::Auc),
                    fixed(*low, 3),
                    fixed(*high, 3)
                );
            }
        }
    }
    out.push('\n');
}

fn method(out: &mut String, study: &Study) {
    let parameters: Vec<String> = study.subject.parameters.iter().map(|p| parameter_label(p)).collect();
    *out += "## What was measured\n\n";
    let _ = writeln!(
        out,
        "- **Boundary error**: the share of test episodes whose outcome is not the one that the model states at 50 %. An \
         episode is decided by its parameters ({}) and by what is left to chance within it (joint offsets, where obstacles \
         stand), so a model of the parameters cannot reach 0: with p(x) the true chance, the error is the mean of \
         min(p, 1 \u{2212} p), which no design changes, plus the mean of |2p \u{2212} 1| over what lies on the wrong side. \
         Differences between designs are differences of the second part alone; where p is near 0 or 1 almost everywhere \
         that is the share of the space on the wrong side of the boundary.",
        list(&parameters)
    );
    *out += "- **Log loss, Brier score**: of the stated chance of success. **AUC**: with DeLong's interval.\n\
             - **Designs**: *uniform* is one Latin hypercube over the operating space. *Two-stage* spends half the budget so, \
             finds the boundary in it and draws the other half there, emphasis included. *Pure boundary* spends everything \
             evenly in the region that the paper names from prior knowledge (the plan's fallback ranges and its held \
             parameters), as the paper defines this design: it needs no pilot, so no episode goes uncounted. A region found \
             by a pilot of half the budget would be the two-stage design again. ";
    let _ = writeln!(out, "Here: {}.", region(study));
    *out += "- **Weights**: *weighted* rows carry (n1 + n2) / (n1 + n2 q/p) for stages of n1 and n2 episodes, operating density p \
             and boundary density q, so that both stages together speak of the operating space.\n\
             - **Intervals**: differences are taken episode by episode within a repeat. The variance of their mean adds that of \
             repeats and that of test episodes; the interval is Student's with Satterthwaite's degrees of freedom. Each \
             interval is for itself. *Better* and *worse* go by wider ones, their 95 % shared over all learners and designs \
             of a measure (Bonferroni), and are not said below three repeats. Boundary error was named first.\n\
             - **Limits**: one robot, one policy, one budget, one test set. Learners differ more than designs may; another \
             learner may rank designs otherwise.\n";
}
