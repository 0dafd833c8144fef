//! A study as a Markdown page.

use std::fmt::Write;

use robogate_analysis::labels::{parameter_label, value_with_unit};
use robogate_analysis::study::{Arm, ArmFigures, Figures, LearnerFigures, MeanFigure, Measure, Score, Study, Verdict};
use robogate_stats::format::{count, fixed, list, percent, percent_range, range, sentence};

use super::answer;

/// A study as a Markdown page.
pub fn page(study: &Study) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail, here and below.
    let _ = write!(out, "# Is boundary focusing worth it?\n\n{}\n\n", subject(study));
    for sentence in &answer(study) {
        let _ = writeln!(out, "- **{sentence}**");
    }
    out.push('\n');
    data(&mut out, study);
    out += "## Held-out data\n\n";
    out += "Boundary error is the primary measure. Each cell has the mean over repeats and the difference to the uniform design \
            with its 95 % interval.\n\n";
    for learner in &study.learners {
        held_out(&mut out, learner);
    }
    in_sample(&mut out, study);
    repeats(&mut out, study);
    method(&mut out, study);
    out
}

fn subject(study: &Study) -> String {
    let of = &study.subject;
    format!(
        "{} with the {} policy in {}, parameter space `{}`: three designs of {} episodes each, {} repeats, evaluated on {} \
         episodes that were sampled independently from the operating space.",
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
    *out += "## Designs\n\n| Design | Episodes | Focused episodes | Success rate | Weights in the fit |\n\
             | --- | ---: | ---: | ---: | --- |\n";
    for of in &study.designs {
        let fitted = match of.arm {
            Arm::Uniform => "equal",
            Arm::TwoStage => "equal, as published; and weighted to the operating space",
            _ => "equal: the weights are constant within the region",
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
    let rate = match test.rate.rate {
        Some(rate) => format!("{} ({})", percent(rate), percent_range(test.rate.wilson_95)),
        None => "-".to_owned(),
    };
    let _ = writeln!(
        out,
        "| test set | {} | 0 | {} | not fitted |\n\n\
         References: always predicting the more frequent outcome has a boundary error of {}; always predicting the \
         overall success rate ({}) has a log loss of {} and a Brier score of {}.\n",
        count(test.episodes),
        rate,
        percent(test.majority_error),
        test.rate.rate.map_or_else(|| "-".to_owned(), percent),
        fixed(test.base_rate_log_loss, 3),
        fixed(test.base_rate_brier, 3),
    );
}

/// The ranges of the pure-boundary design.
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

fn held_out(out: &mut String, learner: &LearnerFigures) {
    let _ = write!(out, "### {}\n\n{}.\n\n", title(learner), sentence(&learner.about));
    *out += "| Design | Boundary error | Log loss | Brier score | AUC |\n| --- | ---: | ---: | ---: | ---: |\n";
    let mut reasons = Vec::new();
    for ArmFigures { arm, figures } in &learner.arms {
        match figures.estimated() {
            Some(figures) => {
                let cells: Vec<String> = figures.test.iter().map(cell).collect();
                let _ = writeln!(out, "| {} | {} |", arm.name(), cells.join(" | "));
            }
            None => {
                let _ = writeln!(out, "| {} | - | - | - | - |", arm.name());
                reasons.push(format!("{}: {}.", sentence(arm.name()), figures.because().unwrap_or_default()));
            }
        }
    }
    out.push('\n');
    for reason in reasons {
        let _ = write!(out, "{reason}\n\n");
    }
}

fn title(learner: &LearnerFigures) -> String {
    sentence(&learner.name)
}

fn cell(score: &Score) -> String {
    let mut text = value(score.measure, score.value.mean);
    if let Some(difference) = &score.difference_to_uniform {
        text += &format!("<br>{}", change(score.measure, difference));
        match score.verdict {
            Some(Verdict::NotSignificant) | None => {}
            Some(verdict) => text += &format!("<br>**{}**", verdict.as_str()),
        }
    }
    text
}

/// The value of a measure.
fn value(measure: Measure, x: f64) -> String {
    if measure == Measure::BoundaryError { percent(x) } else { fixed(x, 3) }
}

/// Formats a difference with its interval. The boundary error is in percentage points.
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

fn in_sample(out: &mut String, study: &Study) {
    *out += "## The paper's comparison\n\n\
             The paper reports an AUC of 0.754 for its uniform stage and of 0.780 for both stages together, each in sample, and \
             attributes the increase to focusing. The same figures for this study, with the AUC of the same models on the test \
             set:\n\n\
             | Learner | Design | AUC in sample | minus uniform | AUC on the test set | minus uniform |\n\
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
    *out += "\nDo not compare the in-sample AUC of different designs: it measures how well a model separates successes from \
             failures *in the rows of its design*, and each design has other rows. If a second stage adds easy rows, the AUC rises; \
             if it adds hard rows, it falls, even if the model is the same. Only the test set is the same for all models.\n\n";
}

fn signed(x: f64) -> String {
    let text = fixed(x, 3);
    if text.starts_with('\u{2212}') || text == "0.000" { text } else { format!("+{text}") }
}

fn repeats(out: &mut String, study: &Study) {
    *out += "## All repeats\n\n| Learner | Design | Repeat | Boundary error | Log loss | Brier score | AUC (DeLong's 95 %) |\n\
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
    *out += "## Method\n\n";
    let _ = writeln!(
        out,
        "- **Boundary error**: the share of test episodes whose outcome differs from the prediction of the model at 50 %. The \
         outcome of an episode depends on its parameters ({}) and on random draws within the episode, so a model of the \
         parameters cannot reach 0. With the true probability p(x), the error is the mean of min(p, 1 \u{2212} p), which no design \
         changes, plus the mean of |2p \u{2212} 1| over the region on the wrong side of the boundary. Designs differ in the second \
         part only. If p is near 0 or 1 almost everywhere, the second part is the share of the space on the wrong side.",
        list(&parameters)
    );
    *out += "- **Log loss, Brier score**: of the predicted probability of success. **AUC**: with DeLong's interval.\n\
             - **Designs**: *uniform* is one Latin hypercube over the operating space. *Two-stage* uses half of the budget in the \
             same way, estimates the boundary from it, and samples the other half there, including the emphasis region. *Pure \
             boundary* samples the whole budget uniformly in the region of prior knowledge (the fallback ranges and restrictions of \
             the plan), as the paper defines this design. It needs no pilot run. ";
    let _ = writeln!(out, "Its ranges here: {}.", region(study));
    *out += "- **Weights**: *weighted* rows have the weight (n1 + n2) / (n1 + n2 q/p) for stages of n1 and n2 episodes, operating \
             density p and boundary density q, so that both stages together estimate the operating space.\n\
             - **Intervals**: differences are paired by test episode within a repeat. The variance of their mean is the sum of the \
             variances of repeats and of test episodes; the interval is Student's with Satterthwaite's degrees of freedom. The \
             intervals in the tables are pointwise. *Better* and *worse* use wider intervals, with 95 % confidence for all learners \
             and designs of a measure together (Bonferroni), and need at least three repeats.\n\
             - **Limits**: one robot, one policy, one budget, one test set. Another learner may rank the designs differently.\n";
}
