//! The document of a comparison.

mod failures;
mod marginal;
mod paired;
mod rates;
mod reach;
mod sensitivity;
mod universal;

use robogate_analysis::Comparison;
use robogate_stats::format::{count, fixed, list, points_range};

use super::{Block, Document, Figure, Section, Table, watch_section};
use crate::document::Kind::{Number, Short, Text};
use crate::document::MAX_ROWS;
use crate::figures;
use crate::text::{ComparisonHeadline, comparison_limits};
use crate::watch::Watch;

/// Creates the document of a comparison.
pub(crate) fn comparison_document(of: &Comparison, watch: Option<&Watch>) -> Document {
    let headline = ComparisonHeadline::of(of);
    let names: Vec<String> = of.datasets.iter().map(|d| d.name.clone()).collect();
    let largest = Largest::of(of);
    let mut sections: Vec<Section> = watch.map(watch_section).into_iter().collect();
    sections.push(rates::section(of));
    sections.extend(of.paired.iter().enumerate().map(|(i, pair)| paired::section(pair, i)));
    sections.extend([failures::section(of), marginal::section(of), universal::section(of), sensitivity::section(of)]);
    sections.extend(reach::section(of));
    sections.extend([
        sources(of),
        Section {
            id: "limits",
            title: "Limits".to_owned(),
            population: None,
            blocks: vec![Block::List(comparison_limits(of))],
        },
    ]);
    Document {
        kind: "comparison",
        title: match names.as_slice() {
            [first, second] => format!("{first} and {second}"),
            names => list(names),
        },
        subtitle: format!(
            "{} datasets, {} episodes \u{b7} compared {}",
            of.datasets.len(),
            count(of.datasets.iter().map(|d| d.subject.episodes).sum()),
            match of.differences.iter().filter(|difference| difference.valid_pairs.is_some()).count() {
                0 => "as independent runs",
                n if n == of.differences.len() => "scenario by scenario",
                _ => "scenario by scenario where both ran the same",
            }
        ),
        figure: largest.as_ref().map_or_else(|| "\u{2013}".to_owned(), Largest::figure),
        figure_label: match &largest {
            Some(largest) => largest.label(of.datasets.len() > 2),
            None => "no comparison is possible".to_owned(),
        },
        interval: largest.as_ref().map_or_else(|| "no interval".to_owned(), Largest::interval),
        scale: figures::rates(&of.datasets, &of.compared),
        answer: headline.answer,
        columns: vec![
            ("What differs", headline.what_differs),
            ("What they share", headline.what_they_share),
            ("Uncertainty", headline.uncertainty),
        ],
        sections,
        verdict: None,
    }
}

/// The largest difference of success rates.
struct Largest<'a> {
    difference: f64,
    interval: [f64; 2],
    first: &'a str,
    second: &'a str,
}

impl<'a> Largest<'a> {
    fn of(comparison: &'a Comparison) -> Option<Self> {
        let paired = comparison.paired.iter().filter_map(|pair| {
            let (first, second) = (pair.first.as_str(), pair.second.as_str());
            Some(Self { difference: pair.difference?, interval: pair.difference_95, first, second })
        });
        let independent = comparison.differences.iter().map(|d| Self {
            difference: d.difference,
            interval: d.interval_95,
            first: &d.first,
            second: &d.second,
        });
        let larger = |best: Self, next: Self| if next.difference.abs() > best.difference.abs() { next } else { best };
        paired.chain(independent).reduce(larger)
    }

    fn figure(&self) -> String {
        format!("{} points", fixed(100.0 * self.difference.abs(), 1))
    }

    fn label(&self, several: bool) -> String {
        let (ahead, behind) =
            if self.difference >= 0.0 { (self.first, self.second) } else { (self.second, self.first) };
        let which = if several { "largest difference: " } else { "" };
        format!("{which}{ahead} ahead of {behind}")
    }

    fn interval(&self) -> String {
        let [low, high] = self.interval;
        let ends = if self.difference >= 0.0 { [low, high] } else { [-high, -low] };
        format!("95 % interval {} points", points_range(ends))
    }
}

/// The populations of the compared datasets, as a sentence under the title of a section.
fn population(of: &Comparison) -> Option<String> {
    let mut populations: Vec<&str> = Vec::new();
    for dataset in of.datasets.iter().filter(|d| d.excluded_because.is_none()) {
        let text = dataset.population.describe();
        if !populations.contains(&text) {
            populations.push(text);
        }
    }
    (!populations.is_empty()).then(|| format!("Applies to {}.", populations.join("; and to ")))
}

fn sources(of: &Comparison) -> Section {
    let rows = of.datasets.iter().map(|d| {
        let s = &d.subject;
        let hash = s.dataset_hash.get(..12).unwrap_or(&s.dataset_hash).to_owned();
        vec![
            d.name.clone(),
            s.robot.clone(),
            s.policy.clone(),
            s.engine.clone(),
            count(s.episodes),
            hash,
            s.path.clone(),
        ]
    });
    let columns = [
        ("dataset", Text),
        ("robot", Short),
        ("policy", Short),
        ("engine", Short),
        ("episodes", Number),
        ("hash", Short),
        ("path", Text),
    ];
    let blocks = vec![Block::Table(Table::new("", &columns, rows.collect()).at_most(MAX_ROWS))];
    Section { id: "sources", title: "Datasets".to_owned(), population: None, blocks }
}
