//! The page before it is HTML or Markdown: sections of blocks, in the order in which they are read.

mod sections;
mod tables;
mod versus;

use maud::Markup;

pub(crate) use sections::tell;
pub(crate) use versus::tell as tell_comparison;

/// The whole page.
pub(crate) struct Story {
    /// What kind of page it is, beside the brand.
    pub(crate) kind: &'static str,
    /// What it is about.
    pub(crate) title: String,
    /// One line under it.
    pub(crate) subtitle: String,
    /// The success rate, large; a dash without evidence.
    pub(crate) rate: String,
    /// What it is the rate of.
    pub(crate) rate_of: String,
    pub(crate) interval: String,
    /// The rate on its scale.
    pub(crate) scale: Markup,
    pub(crate) answer: String,
    /// Three columns of sentences under the answer.
    pub(crate) columns: Vec<(&'static str, Vec<String>)>,
    pub(crate) sections: Vec<Section>,
}

/// A part of the page.
pub(crate) struct Section {
    /// The anchor.
    pub(crate) id: &'static str,
    pub(crate) title: String,
    /// What it speaks of, in a few words under the title.
    pub(crate) population: Option<String>,
    pub(crate) blocks: Vec<Block>,
}

/// What a section is made of. Texts are plain: each form escapes them in its own way.
pub(crate) enum Block {
    /// A paragraph.
    Text(String),
    /// A formula or command on a line of its own.
    Code(String),
    /// Something that must not be overlooked.
    Caution(String),
    /// A small heading.
    Heading(String),
    /// A list of sentences.
    List(Vec<String>),
    /// A figure beside a list of what to read from it.
    Figure(Figure),
    /// Figures side by side.
    Grid(Vec<Figure>),
    /// A table that is always open.
    Table(Table),
    /// A table behind a line that opens it.
    Folded(Table),
    /// Names and values.
    Facts(Vec<(String, String)>),
}

/// A drawing, what it shows, and the same in figures.
pub(crate) struct Figure {
    pub(crate) title: String,
    pub(crate) svg: Markup,
    /// Whether it is a map of cells, whose letters grow on a phone.
    pub(crate) is_map: bool,
    pub(crate) caption: String,
    /// What to read from it, beside it where there is room.
    pub(crate) reading: Vec<String>,
    pub(crate) table: Table,
}

/// A table.
pub(crate) struct Table {
    pub(crate) title: String,
    pub(crate) columns: Vec<Column>,
    pub(crate) rows: Vec<Vec<String>>,
    /// A line under it.
    pub(crate) remark: Option<String>,
}

/// A column of a table.
pub(crate) struct Column {
    pub(crate) head: String,
    pub(crate) kind: Kind,
}

/// What a column holds.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Text,
    /// Text that keeps to one line.
    Short,
    /// Set to the right, in figures of equal width.
    Number,
    /// A zone's word.
    Zone,
    /// Something to type.
    Code,
}

impl Table {
    pub(crate) fn new(title: impl Into<String>, columns: &[(&str, Kind)], rows: Vec<Vec<String>>) -> Self {
        let columns = columns.iter().map(|(head, kind)| Column { head: (*head).to_owned(), kind: *kind }).collect();
        Self { title: title.into(), columns, rows, remark: None }
    }

    /// Without columns that hold nothing but dashes.
    pub(crate) fn without_empty(mut self) -> Self {
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

    /// At most so many rows; a line under the table says what is left out.
    pub(crate) fn at_most(mut self, most: usize) -> Self {
        if self.rows.len() > most {
            let left = self.rows.len() - most;
            self.rows.truncate(most);
            self.remark = Some(format!("{left} more rows stand in the JSON document (--format json)."));
        }
        self
    }
}
