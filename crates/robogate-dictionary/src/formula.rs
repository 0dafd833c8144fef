//! Words that a spreadsheet would compute.
//!
//! Names come from files and servers. A cell that starts with one of a few characters is a formula in a spreadsheet, which can read
//! other cells and contact servers. An apostrophe marks it as text there; our own reader removes it again.

use std::borrow::Cow;

/// Whether a word, without apostrophes at its start, is a formula.
fn is_formula(word: &str) -> bool {
    word.trim_start_matches('\'').starts_with(['=', '@', '+', '-', '\t', '\r'])
}

/// A word as a cell of a spreadsheet: one that it would compute gets an apostrophe, which our readers remove.
pub fn marked(word: &str) -> Cow<'_, str> {
    if is_formula(word) { Cow::Owned(format!("'{word}")) } else { Cow::Borrowed(word) }
}

/// The word of a cell.
pub(crate) fn unmarked(cell: &str) -> &str {
    cell.strip_prefix('\'').filter(|word| is_formula(word)).unwrap_or(cell)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_no_formulas_and_come_back() {
        for (word, cell) in [
            ("=1+1", "'=1+1"),
            ("@SUM(A1)", "'@SUM(A1)"),
            ("\t=1", "'\t=1"),
            ("-", "'-"),
            ("'=1", "''=1"),
            ("plain", "plain"),
            ("'quoted'", "'quoted'"),
            ("a=b", "a=b"),
        ] {
            assert_eq!(marked(word), cell);
            assert_eq!(unmarked(cell), word);
        }
    }
}
