//! Positions of the parameter, measure and draw columns in a table.

use std::ops::Range;

use super::fixed::{CLOSING, LABEL, LEADING, TRAILING};

/// Positions of the parameter, measure and draw columns in the table of a dictionary.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Layout {
    /// The requested parameters. The same number of applied ones follows.
    pub(crate) parameters: Range<usize>,
    /// The measures.
    pub(crate) measures: Range<usize>,
    /// The hidden draws.
    pub(crate) draws: Range<usize>,
}

impl Layout {
    /// The layout for these column names, in this order. `None` if no dictionary can have them. The caller must still
    /// compare them with the columns of [`super::Columns::of`].
    pub(crate) fn of(names: &[String]) -> Option<Self> {
        let place = |name: &str| names.iter().position(|column| column == name);
        let first = LEADING.len();
        let applied_other = place(TRAILING[0].name)?;
        let measures = applied_other + TRAILING.len()..place(CLOSING[0].name)?;
        let parameters = first..first + applied_other.checked_sub(first)? / 2;
        let after_label = place(LABEL[0].name).filter(|at| *at >= measures.end)? + LABEL.len();
        let draws = after_label.min(names.len())..names.len();
        (measures.start <= measures.end).then_some(Self { parameters, measures, draws })
    }
}
