//! The risk model of an active design: its rounds.

use robogate_stats::format::{count, fixed, percent_or_dash, sentence};

use super::{Block, Section, Table};
use crate::ActiveModel;
use crate::document::Kind::Number;
use crate::document::{MAX_ROWS, or_dash};

/// `draws` states whether the task declares hidden draws.
pub(super) fn section(model: &ActiveModel, draws: bool) -> Section {
    let rows = model.rounds.iter().map(|round| {
        let number = |value: Option<f64>| or_dash(value, |value| fixed(value, 3));
        vec![
            if round.episodes > 0 { count(round.episodes) } else { "end".to_owned() },
            count(round.trained_on),
            percent_or_dash(round.boosting_share),
            number(round.brier),
            number(round.log_loss),
        ]
    });
    let columns = [
        ("episodes of the round", Number),
        ("trained on", Number),
        ("share of boosting", Number),
        ("Brier score", Number),
        ("log loss", Number),
    ];
    let mut table = Table::new("Rounds", &columns, rows.collect()).without_empty().at_most(MAX_ROWS);
    table.remark = Some("Scores of cross-validation before each round, over all episodes so far.".to_owned());
    let inputs = if draws { "the parameters, the hidden draws and the margins of the task" } else { "the parameters" };
    let mut about = vec![format!(
        "This model chose the episodes of the active design: gradient boosting and logistic regression on splines of {inputs}. The \
         risk model further below is another one: a logistic regression on the parameters, whose coefficients can be read."
    )];
    about.extend(model.sentences.iter().map(|text| format!("{}.", sentence(text))));
    Section {
        id: "active",
        title: "Risk model of the active design".to_owned(),
        population: None,
        blocks: vec![Block::List(about), Block::Folded(table)],
    }
}
