//! The evaluation of a fleet as text, Markdown and one HTML file.

use std::fmt::Write;

use maud::{Markup, html};
use robogate_analysis::labels::label_with_unit;
use robogate_gate::{DriverForm, Fleet, FleetUnit, UnitDriver, UnitPlaces, Verdict};
use robogate_stats::format::{count, fixed, number, percent, percent_range};

use crate::html::{frame, prose, rich};
use crate::markdown::escape_markdown;

/// The result of a fleet in one sentence.
pub fn fleet_headline(fleet: &Fleet) -> String {
    let share = &fleet.share;
    format!(
        "{} of {} units meet the requirements `{}`, {} {} them, {} {} undecided",
        share.meets,
        fleet.units.len(),
        fleet.requirements.name,
        share.violates,
        if share.violates == 1 { "violates" } else { "violate" },
        share.undecided,
        if share.undecided == 1 { "is" } else { "are" }
    )
}

/// The share of units with its interval, and the comparison with the required share, in sentences.
pub fn fleet_share(fleet: &Fleet) -> Vec<String> {
    let mut lines = vec![format!(
        "Share of units that meet the requirements: {} (95 % interval)",
        percent_range(fleet.share.interval_95)
    )];
    if let (Some(required), Some(verdict)) = (fleet.required_share, fleet.verdict) {
        let required = percent(required);
        lines.push(match verdict {
            Verdict::Pass => format!("At least {required} of the units meet the requirements."),
            Verdict::Fail => format!("Fewer than {required} of the units meet the requirements."),
            Verdict::Inconclusive | Verdict::Invalid => {
                format!("These units do not show whether at least {required} of the units meet the requirements.")
            }
        });
    }
    lines
}

/// What distinguishes worse units, in sentences. Only significant differences are named.
pub fn fleet_drivers(fleet: &Fleet) -> Vec<String> {
    if let Some(because) = &fleet.not_tested {
        return vec![format!("Unit parameters cannot be compared: {because}.")];
    }
    let mut named: Vec<&UnitDriver> = Vec::new();
    for driver in fleet.drivers.iter().filter(|driver| driver.significant) {
        if !named.iter().any(|known| known.parameter == driver.parameter) {
            named.push(driver);
        }
    }
    if named.is_empty() {
        return vec![format!(
            "No unit parameter is significantly correlated with the order of the units ({} quantities tested together, 5 % error).",
            fleet.drivers.len()
        )];
    }
    named.into_iter().map(sentence).collect()
}

fn sentence(driver: &UnitDriver) -> String {
    let UnitDriver { parameter, form, word, correlation, .. } = driver;
    let which = match (form, *correlation > 0.0) {
        (DriverForm::Value, true) => "units with larger values do worse".to_owned(),
        (DriverForm::Value, false) => "units with smaller values do worse".to_owned(),
        (DriverForm::Deviation, true) => "units farther from the middle of its range do worse".to_owned(),
        (DriverForm::Deviation, false) => "units nearer to the middle of its range do worse".to_owned(),
        (DriverForm::Word, worse) => {
            format!(
                "units with `{}` do {}",
                word.as_deref().unwrap_or_default(),
                if worse { "worse" } else { "better" }
            )
        }
    };
    let medians = match (driver.median_violates, driver.median_meets, form) {
        (Some(violates), Some(meets), DriverForm::Value) => {
            format!("median {} of failing units, {} of passing ones, ", number(violates), number(meets))
        }
        (Some(violates), Some(meets), _) => {
            format!(
                "median distance {} of the half range for failing units, {} for passing ones, ",
                percent(violates),
                percent(meets)
            )
        }
        _ => String::new(),
    };
    format!("`{parameter}`: {which} ({medians}rank correlation {}, p = {})", fixed(*correlation, 2), p(driver))
}

fn p(driver: &UnitDriver) -> String {
    fixed(driver.p_adjusted, if driver.p_adjusted < 0.01 { 4 } else { 2 })
}

/// How the parameters are tested, in one sentence.
const TEST: &str = "Units are ordered by verdict, and by success rate among equal verdicts. All parameters and forms are tested together: the \
                    p-value is the share of permutations of this order in which any of them is correlated at least as strongly \
                    (Westfall and Young 1993). At most 5 % of fleets without any effect name a parameter.";

/// Why a unit can be undecided although its interval lies on one side of the limit.
const INTERVAL: &str = "The exact interval assumes a fixed number of episodes. The verdict allows for a look at the data after each round, so it \
                        needs more evidence than an interval on one side of the limit.";

/// The cells of one unit.
fn cells(unit: &FleetUnit) -> [String; 5] {
    let rate = if unit.valid > 0 { percent(unit.successes as f64 / unit.valid as f64) } else { "-".to_owned() };
    let requirements = |title: &str, ids: &[String]| {
        if ids.is_empty() { None } else { Some(format!("{title} {}", ids.join(", "))) }
    };
    let why = [requirements("violated:", &unit.violated), requirements("undecided:", &unit.undecided)];
    let why: Vec<String> = why.into_iter().flatten().collect();
    [
        unit.unit.to_string(),
        unit.verdict.to_string(),
        format!("{rate} ({} of {})", count(unit.successes), count(unit.valid)),
        percent_range(unit.success_95),
        if why.is_empty() { "-".to_owned() } else { why.join("; ") },
    ]
}

const HEADS: [&str; 5] = ["unit", "verdict", "success", "exact 95 % interval", "requirements"];

fn parameter_cells(fleet: &Fleet, of: &UnitPlaces) -> [String; 3] {
    let best = fleet.drivers.iter().find(|driver| driver.parameter == of.parameter);
    let dash = || "-".to_owned();
    [of.range.clone(), best.map_or_else(dash, |driver| fixed(driver.correlation, 2)), best.map_or_else(dash, p)]
}

/// The fleet as Markdown.
pub fn fleet_markdown(fleet: &Fleet) -> String {
    let mut out = format!("# Fleet\n\n**{}**\n\n", escape_markdown(&fleet_headline(fleet)));
    // Writing to a string cannot fail, here and below.
    for text in fleet_share(fleet).iter().chain([&fleet.share.estimand]) {
        let _ = write!(out, "{}\n\n", escape_markdown(text));
    }
    let _ = write!(out, "{}\n\n## What distinguishes worse units\n\n", escape_markdown(&subject(fleet)));
    for text in fleet_drivers(fleet) {
        let _ = writeln!(out, "- {}", escape_markdown(&text));
    }
    let _ = write!(out, "\n{}\n\n", escape_markdown(TEST));
    let _ = writeln!(out, "| parameter | range | rank correlation | adjusted p |\n|---|---|---:|---:|");
    for of in fleet.places() {
        let cells = parameter_cells(fleet, &of).map(|cell| escape_markdown(&cell));
        let _ = writeln!(out, "| {} | {} |", escape_markdown(&of.parameter), cells.join(" | "));
    }
    let _ = write!(out, "\n## Units\n\n| {} |\n|{}\n", HEADS.join(" | "), "---|".repeat(HEADS.len()));
    for unit in &fleet.units {
        let _ = writeln!(out, "| {} |", cells(unit).map(|cell| escape_markdown(&cell)).join(" | "));
    }
    let _ = write!(out, "\n{INTERVAL}\n");
    out
}

fn subject(fleet: &Fleet) -> String {
    format!(
        "{} on {}, {}, units drawn from {} with seed {}",
        fleet.policy,
        fleet.robot,
        fleet.scenarios,
        fleet.unit_space.name(),
        fleet.seed
    )
}

/// The fleet as one self-contained HTML file. Equal fleets give equal bytes.
pub fn fleet_html(fleet: &Fleet) -> String {
    let body = html! {
        header.top {
            p.brand { b { "RoboGate" } " fleet" }
            h1 { (rich(&fleet_headline(fleet))) }
            p.sub { (prose(&subject(fleet))) }
            (share_scale(fleet))
            @for text in fleet_share(fleet) { p.answer { (prose(&text)) } }
            p.text { (prose(&fleet.share.estimand)) }
        }
        main {
            section {
                header { h2 { "What distinguishes worse units" } }
                ul.plain { @for text in fleet_drivers(fleet) { li { (rich(&text)) } } }
                (parameters(fleet))
                p.text { (prose(TEST)) }
            }
            section {
                header { h2 { "Units" } }
                div.scroll {
                    table {
                        thead { tr { @for head in HEADS { th scope="col" { (head) } } } }
                        tbody {
                            @for unit in &fleet.units {
                                tr { @for cell in cells(unit) { td { (prose(&cell)) } } }
                            }
                        }
                    }
                }
                p.text { (INTERVAL) }
                p.text { "The folder of each unit is a complete run: " code { "robogate report FLEET/unit-001" } " writes its page." }
            }
        }
    };
    frame("Fleet", &body, false)
}

/// The interval of the share, and the required share, on an axis from 0 to 100 %.
fn share_scale(fleet: &Fleet) -> Markup {
    let x = |share: f64| 16.0 + 320.0 * share;
    let [low, high] = fleet.share.interval_95;
    html! {
        svg viewBox="0 0 352 40" width="352" height="40" role="img" style="display:block"
            aria-label={ "share of units from " (percent(low)) " to " (percent(high)) }
        {
            line x1=(fixed(x(0.0), 1)) y1="11" x2=(fixed(x(1.0), 1)) y2="11" stroke="var(--line)" {}
            rect x=(fixed(x(low), 1)) y="5" width=(fixed((x(high) - x(low)).max(1.5), 1)) height="12" fill="var(--accent)" opacity="0.5" {}
            @for tick in [0.0, 0.25, 0.5, 0.75, 1.0] {
                line x1=(fixed(x(tick), 1)) y1="11" x2=(fixed(x(tick), 1)) y2="20" stroke="var(--line)" {}
                text.s.d x=(fixed(x(tick), 1)) y="34" text-anchor="middle" { (fixed(100.0 * tick, 0)) "\u{a0}%" }
            }
            @if let Some(required) = fleet.required_share {
                line x1=(fixed(x(required), 1)) y1="1" x2=(fixed(x(required), 1)) y2="21" stroke="var(--ink)" stroke-width="2" {}
            }
        }
    }
}

/// The parameters with the place of each unit in the range.
fn parameters(fleet: &Fleet) -> Markup {
    html! {
        div.scroll {
            table {
                thead {
                    tr {
                        th scope="col" { "parameter" }
                        th scope="col" { "units: circles meet, crosses violate, dots are undecided" }
                        @for head in ["range", "rank correlation", "adjusted p"] { th scope="col" { (head) } }
                    }
                }
                tbody {
                    @for of in fleet.places() {
                        tr {
                            th scope="row" { (prose(&label_with_unit(&of.parameter))) }
                            td { (strip(&of)) }
                            @for cell in parameter_cells(fleet, &of) { td { (prose(&cell)) } }
                        }
                    }
                }
            }
        }
    }
}

fn strip(of: &UnitPlaces) -> Markup {
    let marks = of.places.iter().map(|(verdict, place)| {
        let x = 6.0 + 200.0 * place;
        match verdict {
            Verdict::Pass => html! { circle cx=(fixed(x, 1)) cy="9" r="3.2" fill="none" stroke="var(--accent)" {} },
            Verdict::Fail => html! {
                path d={ "M" (fixed(x - 3.0, 1)) " 6l6 6m0-6l-6 6" } stroke="currentColor" stroke-width="1.6" fill="none" {}
            },
            Verdict::Inconclusive | Verdict::Invalid => html! { circle cx=(fixed(x, 1)) cy="9" r="1.4" fill="currentColor" {} },
        }
    });
    html! {
        svg viewBox="0 0 212 18" width="212" height="18" role="img" aria-label={ "units along " (of.parameter) } {
            line x1="6" y1="9" x2="206" y2="9" stroke="var(--line)" {}
            @for mark in marks { (mark) }
        }
    }
}
