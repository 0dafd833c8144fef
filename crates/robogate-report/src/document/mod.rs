//! The structure of a document, independent of HTML and Markdown: sections of blocks, in reading order.

mod analysis;
mod comparison;
mod map;
mod requalification;
mod transfer;

use maud::Markup;
use robogate_analysis::PairCounts;

use crate::gate::VerdictBlock;
use crate::watch::Watch;

pub(crate) use analysis::analysis_document;
pub(crate) use comparison::comparison_document;
pub(crate) use requalification::requalification_document;
pub use requalification::{RequalificationPage, answer_label};
pub(crate) use transfer::transfer_document;

/// A document. Its texts are plain; the HTML and Markdown writers escape them.
pub(crate) struct Document {
    /// The kind of document, shown beside the product name.
    pub(crate) kind: &'static str,
    /// Its subject.
    pub(crate) title: String,
    /// One line below the title.
    pub(crate) subtitle: String,
    /// The key figure, shown large. A dash without one.
    pub(crate) figure: String,
    /// The label of the key figure.
    pub(crate) figure_label: String,
    /// The interval of the key figure.
    pub(crate) interval: String,
    /// The key figure on its scale.
    pub(crate) scale: Markup,
    /// The result in one or two sentences.
    pub(crate) answer: String,
    /// Up to three columns of sentences below the result, each with a title.
    pub(crate) columns: Vec<(&'static str, Vec<String>)>,
    pub(crate) sections: Vec<Section>,
    /// The verdict of the gate, which opens the document.
    pub(crate) verdict: Option<VerdictBlock>,
}

/// A section of a document.
pub(crate) struct Section {
    /// The anchor.
    pub(crate) id: &'static str,
    pub(crate) title: String,
    /// The population that its figures apply to, as a sentence below the title.
    pub(crate) population: Option<String>,
    pub(crate) blocks: Vec<Block>,
}

/// A block of a section.
pub(crate) enum Block {
    /// A paragraph.
    Text(String),
    /// How to read the figures that follow.
    Legend(String),
    /// A formula or command on its own line.
    Code(String),
    /// A warning.
    Caution(String),
    /// A small heading.
    Heading(String),
    /// A list of sentences.
    List(Vec<String>),
    /// A figure with a list of findings beside it.
    Figure(Figure),
    /// Figures side by side.
    Grid(Vec<Figure>),
    /// Blocks that the reader can expand, with a title.
    Group(String, Vec<Self>),
    /// A table that is always visible.
    Table(Table),
    /// A table that the reader can expand.
    Folded(Table),
    /// Names and values.
    Facts(Vec<(String, String)>),
    /// Episodes worth watching.
    Watch(Watch),
    /// A map of any two parameters, which the reader chooses.
    Pairs(PairCounts),
}

impl Block {
    /// A paragraph with the reason why a figure is missing.
    fn cannot(figure: &str, because: &str) -> Self {
        Self::Text(format!("{figure} cannot be estimated because {because}."))
    }
}

/// A figure with its caption, its findings and its data.
pub(crate) struct Figure {
    pub(crate) title: String,
    pub(crate) svg: Markup,
    /// Whether it is a map of cells. Its text is enlarged on small screens.
    pub(crate) is_map: bool,
    pub(crate) caption: String,
    /// The findings, beside the figure if there is space.
    pub(crate) findings: Vec<String>,
    /// The data of the figure.
    pub(crate) table: Table,
}

/// A table.
pub(crate) struct Table {
    pub(crate) title: String,
    pub(crate) columns: Vec<Column>,
    pub(crate) rows: Vec<Vec<String>>,
    /// A line below the table.
    pub(crate) remark: Option<String>,
}

/// A column of a table.
pub(crate) struct Column {
    pub(crate) head: String,
    pub(crate) kind: Kind,
}

/// The content of a column.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Text that may wrap.
    Text,
    /// Text that stays on one line.
    Short,
    /// Numbers, right-aligned, with tabular digits.
    Number,
    /// The name of a zone.
    Zone,
    /// A command.
    Code,
}

/// The section of episodes worth watching.
fn watch_section(watch: &Watch) -> Section {
    Section {
        id: "watch",
        title: "Episodes worth watching".to_owned(),
        population: None,
        blocks: vec![Block::Watch(watch.clone())],
    }
}

/// Maximum number of rows of a table on a page.
const MAX_ROWS: usize = 60;
/// Maximum number of rows of the table of a map.
const MAX_MAP_ROWS: usize = 100;

impl Table {
    pub(crate) fn new(title: impl Into<String>, columns: &[(&str, Kind)], rows: Vec<Vec<String>>) -> Self {
        let columns = columns.iter().map(|(head, kind)| Column { head: (*head).to_owned(), kind: *kind }).collect();
        Self { title: title.into(), columns, rows, remark: None }
    }

    /// Removes columns in which every cell is a dash.
    fn without_empty(mut self) -> Self {
        let empty =
            |at: usize| !self.rows.is_empty() && self.rows.iter().all(|row| row.get(at).is_some_and(|c| c == "-"));
        let keep: Vec<bool> = (0..self.columns.len()).map(|at| !empty(at)).collect();
        let mut at = keep.iter();
        self.columns.retain(|_| at.next().is_none_or(|k| *k));
        for row in &mut self.rows {
            let mut at = keep.iter();
            row.retain(|_| at.next().is_none_or(|k| *k));
        }
        self
    }

    /// Keeps at most `max` rows. A line below the table states the number of removed rows.
    fn at_most(mut self, max: usize) -> Self {
        if self.rows.len() > max {
            let left = self.rows.len() - max;
            self.rows.truncate(max);
            self.remark = Some(format!("{left} more rows are in the JSON document (--format json)."));
        }
        self
    }
}

/// The text of an optional figure, or "-".
fn or_dash<T>(figure: Option<T>, text: impl FnOnce(T) -> String) -> String {
    figure.map_or_else(|| "-".to_owned(), text)
}

/// Formats a p-value that is given as such, not as its logarithm.
fn plain_p(p: f64) -> String {
    robogate_stats::format::p_value(p.max(f64::MIN_POSITIVE).ln())
}

/// "yes" or "no".
fn yes_no(yes: bool) -> String {
    if yes { "yes" } else { "no" }.to_owned()
}
