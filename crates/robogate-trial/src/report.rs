//! The report of a study as one HTML page.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use robogate_stats::compare::fisher_exact;
use robogate_stats::format::{count, counted, date, number, percent, significant};
use robogate_stats::{Confidence, Trials, clopper_pearson};

use crate::{Answer, Study, VoidBy};

const STYLE: &str = "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#1b1f24;background:#fff}\
h1{font-size:1.5rem}h2{font-size:1.15rem;margin-top:2rem}table{border-collapse:collapse;display:block;overflow-x:auto}\
th,td{text-align:left;padding:.25rem .8rem .25rem 0;border-bottom:1px solid #d0d7de;vertical-align:top}\
.answer{font-size:1.25rem;font-weight:600}.note{color:#57606a}svg{max-width:100%;height:auto}\
.good{fill:#1a7f37}.bad{fill:#cf222e}.void{fill:none;stroke:#57606a}";

/// SHA-256 (base64) of the style, which the policy of the page names.
const STYLE_SHA256: &str = "i3qAD+MHJMa0nHMQRND++b+TdEIyM8rbPby6aAb/TWM=";

/// The report of a study that was unblinded. Its policy allows its own style alone: no script, and nothing that is loaded.
pub fn report(study: &Study, answer: &Answer) -> String {
    let plan = &study.plan;
    let mut out = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'sha256-{STYLE_SHA256}'; \
         base-uri 'none'; form-action 'none'\"><title>Trials: {title}</title><style>{STYLE}</style>\
         <h1>Trials of {title}</h1><p class=\"answer\">{sentence}</p>",
        title = escaped(&plan.task),
        sentence = escaped(&answer.sentence),
    );
    let _ = write!(
        out,
        "<p>{} in {} on robot {}. Population: {}.</p>",
        counted(answer.trials, "trial"),
        counted(answer.blocks, "complete block"),
        escaped(&plan.robot),
        escaped(&plan.population.describe())
    );
    for note in &answer.notes {
        let _ = write!(out, "<p>{}</p>", escaped(note));
    }
    policies(&mut out, answer);
    order(&mut out, study);
    drift(&mut out, study);
    operators(&mut out, study);
    invalid(&mut out, study);
    attachments(&mut out, study);
    heading(&mut out, "Plan");
    out.push_str("<ul>");
    for rule in &plan.rules {
        let _ = write!(out, "<li>{}</li>", escaped(rule));
    }
    out.push_str("</ul>");
    let rows = plan.expected.iter().map(|expected| {
        let rates: Vec<String> = expected.rates.iter().map(|rate| significant(*rate, 3)).collect();
        let answers: Vec<String> = expected.answers.iter().map(|(name, p)| format!("{name} {}", percent(*p))).collect();
        vec![rates.join(", "), significant(expected.trials, 3), answers.join(", ")]
    });
    table(&mut out, &["true success rates", "expected trials", "answers"], rows);
    let _ = write!(out, "<p class=\"note\">Plan SHA-256 {}</p></html>", plan.sha256());
    out
}

fn heading(out: &mut String, text: &str) {
    let _ = write!(out, "<h2>{text}</h2>");
}

fn table(out: &mut String, header: &[&str], rows: impl Iterator<Item = Vec<String>>) {
    out.push_str("<table><tr>");
    for cell in header {
        let _ = write!(out, "<th>{}</th>", escaped(cell));
    }
    out.push_str("</tr>");
    for row in rows {
        out.push_str("<tr>");
        for cell in row {
            let _ = write!(out, "<td>{}</td>", escaped(&cell));
        }
        out.push_str("</tr>");
    }
    out.push_str("</table>");
}

fn policies(out: &mut String, answer: &Answer) {
    heading(out, "Policies");
    let rows = answer.arms.iter().map(|arm| {
        let failures: Vec<String> = arm.failures.iter().map(|(mode, count)| format!("{mode} {count}")).collect();
        vec![
            arm.policy.clone() + if arm.eliminated { " (eliminated)" } else { "" },
            arm.rate(),
            failures.join(", "),
            arm.repeated.to_string(),
            arm.invalid_after.to_string(),
            arm.duration_s.map_or_else(|| "-".to_owned(), number),
            arm.reply_ms.map_or_else(|| "-".to_owned(), number),
        ]
    });
    let header = [
        "policy",
        "successes (95 % interval)",
        "failures",
        "repeated",
        "invalid after Stop",
        "median duration, s",
        "median reply, ms",
    ];
    table(out, &header, rows);
    out.push_str(
        "<p class=\"note\">The intervals describe complete blocks as if their number had been fixed. The answer above \
                  accounts for the stopping rule.</p>",
    );
}

/// The trials in their order, one row of dots for each policy.
fn order(out: &mut String, study: &Study) {
    heading(out, "Order of the trials");
    let (arms, attempts) = (study.plan.arms.len(), study.attempts());
    let (width, height) = (16 * attempts.len() + 8, 22 * arms + 8);
    let _ = write!(
        out,
        "<svg viewBox=\"0 0 {width} {height}\" width=\"{width}\" role=\"img\" aria-label=\"order of the trials\">"
    );
    for (at, attempt) in attempts.iter().enumerate() {
        let planned = study.planned(attempt);
        let (class, word) = match attempt.success() {
            Some(true) => ("good", "success"),
            Some(false) => ("bad", "failure"),
            None => ("void", "repeated"),
        };
        let _ = write!(
            out,
            "<circle class=\"{class}\" cx=\"{}\" cy=\"{}\" r=\"6\"><title>{}: {}, {word}</title></circle>",
            16 * at + 12,
            22 * planned.arm + 14,
            escaped(&attempt.code),
            escaped(&study.plan.arms[planned.arm].name)
        );
    }
    let names: Vec<&str> = study.plan.arms.iter().map(|arm| arm.name.as_str()).collect();
    let _ = write!(
        out,
        "</svg><p class=\"note\">Rows from above: {}. Filled green: success, filled red: failure, open: repeated.</p>",
        escaped(&names.join(", "))
    );
}

/// The first and the second half of the trials of each policy.
fn drift(out: &mut String, study: &Study) {
    heading(out, "Change over time");
    let rows = (0..study.plan.arms.len()).map(|arm| {
        let of_arm = study.attempts().iter().filter(|attempt| study.planned(attempt).arm == arm);
        let results: Vec<bool> = of_arm.filter_map(crate::Attempt::success).collect();
        let (first, second) = results.split_at(results.len() / 2);
        let (first, second) = (Trials::count(first.iter().copied()), Trials::count(second.iter().copied()));
        vec![study.plan.arms[arm].name.clone(), of(first), of(second), number(fisher_exact(first, second))]
    });
    table(out, &["policy", "first half", "second half", "p (Fisher)"], rows);
}

fn of(trials: Trials) -> String {
    format!("{}/{}", trials.successes(), trials.n())
}

/// The rates by operator and day, over all policies.
fn operators(out: &mut String, study: &Study) {
    heading(out, "Operators and days");
    let mut groups: BTreeMap<(String, String), Vec<bool>> = BTreeMap::new();
    for attempt in study.attempts() {
        if let Some(success) = attempt.success() {
            groups.entry((attempt.operator.clone(), date(attempt.start.unix_ms / 1000))).or_default().push(success);
        }
    }
    let rows = groups.into_iter().map(|((operator, day), results)| {
        let trials = Trials::count(results);
        let interval = clopper_pearson(trials, Confidence::P95);
        let range = robogate_stats::format::percent_range([interval.low, interval.high]);
        vec![operator, day, of(trials), range]
    });
    table(out, &["operator", "day (UTC)", "successes", "95 % interval"], rows);
}

/// Trials that were declared invalid, with their reasons.
fn invalid(out: &mut String, study: &Study) {
    let rows: Vec<Vec<String>> = study
        .attempts()
        .iter()
        .filter_map(|attempt| {
            let (reason, by) = attempt.void.as_ref()?;
            let by = match by {
                VoidBy::OperatorBefore => "operator, before Stop: repeated",
                VoidBy::OperatorAfter => "operator, after Stop: counts as a failure",
                VoidBy::Infrastructure => "switch or server of the policy: repeated",
            };
            let policy = study.plan.arms[study.planned(attempt).arm].name.clone();
            Some(vec![attempt.code.clone(), policy, by.to_owned(), reason.clone()])
        })
        .collect();
    if !rows.is_empty() {
        heading(out, "Invalid trials");
        table(out, &["trial", "policy", "by", "reason"], rows.into_iter());
    }
}

/// The files of the trials.
fn attachments(out: &mut String, study: &Study) {
    let rows: Vec<Vec<String>> = study
        .attempts()
        .iter()
        .flat_map(|attempt| {
            let policy = &study.plan.arms[study.planned(attempt).arm].name;
            attempt.attachments.iter().map(move |of| {
                vec![attempt.code.clone(), policy.clone(), of.name.clone(), count(of.bytes), of.sha256.clone()]
            })
        })
        .collect();
    if !rows.is_empty() {
        heading(out, "Attachments");
        table(out, &["trial", "policy", "file", "bytes", "SHA-256"], rows.into_iter());
    }
}

/// Text for HTML. Controls of the text direction and other controls become visible.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            c if c.is_control() || robogate_stats::format::is_deceptive(c) => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}
