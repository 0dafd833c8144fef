//! Provenance of the rows.

use robogate_analysis::Analysis;
use robogate_stats::format::{count, counted, sentence};

use super::{Block, Section};

/// Maximum number of notes of an import.
const MAX_NOTES: usize = 20;

pub(super) fn section(analysis: &Analysis) -> Section {
    let p = &analysis.provenance;
    // Neither path nor folder: copies of a run have identical pages.
    let mut facts = vec![
        ("dataset hash".to_owned(), analysis.subject.dataset_hash.clone()),
        ("episodes".to_owned(), count(analysis.subject.episodes)),
        ("robot".to_owned(), with_hash(&p.robot.name, p.robot.sha256.as_deref())),
        ("policy".to_owned(), p.policy.clone()),
        ("engine".to_owned(), with_hash(&analysis.subject.engine, p.engine.build_sha256.as_deref())),
        ("space".to_owned(), format!("{}, {}", p.space.name(), counted(p.space.len() as u64, "parameter"))),
        ("campaign seed".to_owned(), p.seed.to_string()),
        ("written by".to_owned(), format!("{} {}", p.tool.name, p.tool.version)),
        ("dictionary schema".to_owned(), p.schema_version.to_string()),
    ];
    if let Some(platform) = &p.platform {
        facts.push(("platform".to_owned(), format!("{} {}", platform.os, platform.arch)));
    }
    let changed = p.task.changed_settings();
    if !changed.is_empty() {
        facts.push(("settings".to_owned(), changed));
    }
    let mut notes = Vec::new();
    if let Some(source) = &p.source {
        facts.push(("imported from".to_owned(), with_hash(&source.format.replace('_', " "), Some(&source.sha256))));
        notes.extend(source.notes.iter().take(MAX_NOTES).map(|note| sentence(note)));
    }
    facts.push((
        "analysis".to_owned(),
        format!("robogate {}, document version {}", env!("CARGO_PKG_VERSION"), analysis.version),
    ));
    let mut blocks = vec![Block::Facts(facts)];
    if !notes.is_empty() {
        blocks.push(Block::Heading("Decisions of the import".to_owned()));
        blocks.push(Block::List(notes));
    }
    Section { id: "provenance", title: "Provenance".to_owned(), population: None, blocks }
}

fn with_hash(name: &str, hash: Option<&str>) -> String {
    match hash {
        Some(hash) => format!("{name}, sha256 {}", hash.get(..16).unwrap_or(hash)),
        None => name.to_owned(),
    }
}
