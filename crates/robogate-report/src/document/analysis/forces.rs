//! The contacts that exceed force limits.

use robogate_gate::ForceLimitResult;
use robogate_stats::format::{count, number, sentence, significant};

use super::{Block, Section, Table};
use crate::document::Kind::{Number, Text};

pub(super) fn section(results: &[ForceLimitResult]) -> Option<Section> {
    if results.is_empty() {
        return None;
    }
    let rows = results.iter().flat_map(|result| {
        result.contacts.iter().map(|contact| {
            vec![
                result.limit.name.to_string(),
                count(contact.episode),
                contact.ending.replace('_', " "),
                contact.pair(),
                contact.kind.as_str().to_owned(),
                significant(contact.force_n, 3),
                number(contact.limit_n),
            ]
        })
    });
    let columns = [
        ("limit", Text),
        ("episode", Number),
        ("ended with", Text),
        ("contact", Text),
        ("kind", Text),
        ("force (N)", Number),
        ("limit (N)", Number),
    ];
    let table = Table::new("Hardest contacts", &columns, rows.collect());
    let lines = results.iter().map(|result| format!("{}.", sentence(&result.text()))).collect();
    Some(Section {
        id: "forces",
        title: "Contact forces above the limits".to_owned(),
        population: None,
        blocks: vec![Block::List(lines), Block::Table(table)],
    })
}
