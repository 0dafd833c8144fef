//! Rates of the fine simulator from fine and coarse episodes.

use robogate_analysis::{FidelityCost, FidelityRisk, TwoFidelities};
use robogate_stats::format::{count, counted, fixed, number, percent, percent_range};

use super::{Block, Section, Table};
use crate::document::Kind::{Number, Text};
use crate::document::or_dash;

/// The result in sentences, with full stops.
pub fn lines(found: &TwoFidelities) -> Vec<String> {
    let step = |seconds: f64| format!("{} ms", number(1000.0 * seconds));
    let mut lines = Vec::new();
    if let Some(success) = found.success() {
        lines.push(format!(
            "Success with time steps of {}: {} (95 % interval {}), from {} and {} with steps of {}.",
            step(found.fine.time_step_s),
            percent(success.rate),
            percent_range(success.interval_95),
            counted(found.fine.episodes, "episode"),
            counted(found.coarse.episodes, "coarse episode"),
            step(found.coarse.time_step_s),
        ));
        lines.push(format!(
            "The fine episodes alone: {} ({}). The coarse ones alone: {}, which estimates another simulator.",
            percent(success.fine_alone),
            percent_range(success.fine_alone_95),
            percent(success.coarse_alone)
        ));
        lines.push(format!(
            "{} of {} ran with both steps and ended differently: {} succeeded with the fine step only, {} with the coarse one only{}.",
            count(found.fine_success_only + found.coarse_success_only),
            counted(found.pairs, "valid episode"),
            count(found.fine_success_only),
            count(found.coarse_success_only),
            success.correlation.map_or_else(String::new, |rho| format!("; the correlation is {}", fixed(rho, 2)))
        ));
        lines.extend(cost(found, success.worth_fine_episodes));
    }
    if found.fine.invalid + found.coarse.invalid > 0 {
        lines.push(format!(
            "Invalid: {} fine and {} coarse. Invalid fine episodes are excluded; an invalid coarse one counts as an outcome of its own.",
            count(found.fine.invalid),
            count(found.coarse.invalid)
        ));
    }
    lines.extend(found.risk.as_ref().map(risk));
    lines
}

/// What the rate costs, and which share would cost least.
fn cost(found: &TwoFidelities, worth: f64) -> Vec<String> {
    let FidelityCost { coarse_relative, steps, fine_alone_steps, saved, share, best_share, best_relative } = found.cost;
    let compared = match saved {
        saved if saved >= 0.0 => format!("{} fewer", percent(saved)),
        saved => format!("{} more", percent(-saved)),
    };
    let mut lines = vec![format!(
        "Its standard error is that of {} fine episodes. These would take {} physics steps; this run took {}, {compared}. A coarse \
         episode took {} of the steps of a fine one.",
        count(worth.round() as u64),
        count(fine_alone_steps.round() as u64),
        count(steps),
        percent(coarse_relative)
    )];
    lines.extend(best_share.zip(best_relative).map(|(best, relative)| {
        match relative {
        relative if best < 1.0 && relative < 1.0 => format!(
            "At this correlation the best share of fine episodes is {} (here {}). It costs {} of fine episodes alone.",
            percent(best),
            percent(share),
            percent(relative)
        ),
        _ => "At this correlation coarse episodes cost more than they give: run fine episodes alone, without --coarse."
            .to_owned(),
    }
    }));
    lines
}

/// Whether coarse episodes improve the risk model.
fn risk(found: &FidelityRisk) -> String {
    let effect = match found.gain_95 {
        [low, _] if low > 0.0 => "The coarse episodes improve the risk model",
        [_, high] if high < 0.0 => "The coarse episodes make the risk model worse",
        _ => "The coarse episodes make no significant difference to the risk model",
    };
    let [low, high] = found.gain_95;
    let chosen = match found.slope {
        slope if slope > 0.0 => format!("the slope of the coarse model is {}", fixed(slope, 2)),
        _ => "the model of all fine episodes does not use the coarse one".to_owned(),
    };
    format!(
        "{effect}: log loss {} with them and {} without (95 % interval of the gain {low:+.3} to {high:+.3}), in cross-validation on {}; \
         {chosen}.",
        fixed(found.with, 3),
        fixed(found.without, 3),
        counted(found.fine_episodes, "fine episode"),
    )
}

pub(super) fn section(found: &TwoFidelities) -> Section {
    let rows = found.rates.iter().map(|rate| {
        vec![
            rate.metric.clone(),
            percent(rate.rate),
            percent_range(rate.interval_95),
            percent_range(rate.fine_alone_95),
            percent(rate.coarse_alone),
            or_dash(rate.correlation, |rho| fixed(rho, 2)),
            count(rate.worth_fine_episodes.round() as u64),
        ]
    });
    let columns = [
        ("rate", Text),
        ("estimate", Number),
        ("95 % interval", Number),
        ("interval of the fine episodes alone", Number),
        ("coarse episodes alone", Number),
        ("correlation", Number),
        ("worth in fine episodes", Number),
    ];
    let mut table = Table::new("Rates of the fine simulator", &columns, rows.collect());
    table.remark = Some(
        "The estimate corrects the rate of all coarse episodes by the pairs: scenarios that ran with both time steps and the same seed. It is \
         unbiased for the fine simulator. Each failure mode is estimated by itself, so the rates need not add up to 100 %. All other sections use \
         the fine episodes only."
            .to_owned(),
    );
    Section {
        id: "fidelity",
        title: "Fine and coarse episodes".to_owned(),
        population: Some("Applies to the operating space, in the fine simulator.".to_owned()),
        blocks: vec![Block::List(lines(found)), Block::Table(table)],
    }
}
