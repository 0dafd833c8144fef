//! Episodes that are worth replaying.

use robogate_analysis::labels::{parameter_label, value_with_unit};
use robogate_analysis::{Analysis, HERE, ReplayGroup, shell_word};

use super::{Block, Section, Table};
use crate::document::Kind::{Code, Number, Short, Text};

/// Maximum number of parameters of one episode.
const MAX_PARAMETERS: usize = 12;

pub(super) fn section(analysis: &Analysis) -> Section {
    let mut blocks = Vec::new();
    let folder = analysis.subject.replayable.then_some(HERE);
    if analysis.replay.is_empty() {
        blocks.push(Block::Text("No episode was selected.".to_owned()));
    } else if folder.is_none() {
        blocks.push(Block::Text(
            "These rows do not come from a run's folder, so their episodes cannot be replayed. The index is that of the row."
                .to_owned(),
        ));
    } else {
        blocks.push(Block::Text("Run the commands in the folder of the run.".to_owned()));
    }
    for group in &analysis.replay {
        blocks.push(Block::Heading(group.title.clone()));
        blocks.push(Block::Text(group.why.clone()));
        blocks.push(Block::Table(table(group, folder)));
    }
    Section { id: "replay", title: "Episodes worth replaying".to_owned(), population: None, blocks }
}

fn table(group: &ReplayGroup, folder: Option<&str>) -> Table {
    let rows = group.episodes.iter().map(|episode| {
        let parameters: Vec<String> = episode
            .parameters
            .iter()
            .take(MAX_PARAMETERS)
            .map(|(parameter, value)| format!("{} {}", parameter_label(parameter), value_with_unit(value, parameter)))
            .collect();
        vec![
            match folder {
                Some(folder) => format!("robogate replay {} {}", shell_word(folder), episode.index),
                None => episode.index.to_string(),
            },
            episode.outcome.replace('_', " "),
            if episode.figure.is_empty() { "-".to_owned() } else { episode.figure.clone() },
            parameters.join(", "),
        ]
    });
    let columns = [
        if folder.is_some() { ("command", Code) } else { ("index", Number) },
        ("outcome", Short),
        ("chosen by", Short),
        ("parameters", Text),
    ];
    Table::new("", &columns, rows.collect())
}
