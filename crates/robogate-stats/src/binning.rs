//! Success counts per bin, per category and per pair of parameters.
//!
//! A bin contains edge ≤ value < next edge. The last bin also contains its upper edge (as in numpy.histogram). Values
//! outside the edges are counted separately and never assigned to the nearest bin.

use crate::interval::Trials;

/// The reason why values cannot be binned.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum BinningError {
    /// Two inputs differ in length.
    #[error("{found} values. Expected {expected}")]
    Length {
        /// Length of the first input.
        expected: usize,
        /// Length found.
        found: usize,
    },
    /// A value is NaN or infinite.
    #[error("row {row}: {value} is not valid. Expected a finite number")]
    NotFinite {
        /// Index of the row.
        row: usize,
        /// Value found.
        value: f64,
    },
    /// No values, or all values are equal.
    #[error("fewer than two distinct values cannot be cut into bins")]
    OneValue,
    /// Zero bins were requested.
    #[error("the number of bins is 0. Expected at least 1")]
    NoBins,
    /// Edges that are not finite and strictly increasing, or fewer than two.
    #[error("the edges are not valid. Expected at least two finite numbers in strictly increasing order")]
    BadEdges,
    /// A category code at or above the number of categories.
    #[error("row {row}: category {code} is out of range. Expected a code below {categories}")]
    UnknownCategory {
        /// Index of the row.
        row: usize,
        /// Code found.
        code: usize,
        /// Number of categories.
        categories: usize,
    },
}

/// Strictly increasing, finite bin edges.
#[derive(Debug, Clone, PartialEq)]
pub struct Edges(Vec<f64>);

impl Edges {
    /// Creates edges from at least two strictly increasing finite numbers.
    ///
    /// # Errors
    /// [`BinningError::BadEdges`] otherwise.
    pub fn new(edges: Vec<f64>) -> Result<Self, BinningError> {
        let increasing = edges.windows(2).all(|e| e[0] < e[1]) && edges.iter().all(|e| e.is_finite());
        if edges.len() >= 2 && increasing { Ok(Self(edges)) } else { Err(BinningError::BadEdges) }
    }

    /// Creates `bins` bins of equal width over the observed range.
    ///
    /// # Errors
    /// Zero bins, a value that is not finite, or fewer than two distinct values.
    pub fn equal_width(values: &[f64], bins: usize) -> Result<Self, BinningError> {
        let (low, high) = range(values)?;
        if bins == 0 {
            return Err(BinningError::NoBins);
        }
        let step = (high - low) / bins as f64;
        let mut edges: Vec<f64> = (0..bins).map(|i| low + step * i as f64).collect();
        edges.push(high);
        Self::new(edges).map_err(|_| BinningError::OneValue)
    }

    /// Creates at most `bins` bins of nearly equal count. Equal values stay together, so there may be fewer bins.
    ///
    /// # Errors
    /// As [`Edges::equal_width`].
    pub fn equal_count(values: &[f64], bins: usize) -> Result<Self, BinningError> {
        let (low, high) = range(values)?;
        if bins == 0 {
            return Err(BinningError::NoBins);
        }
        let mut sorted = values.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        let mut edges = vec![low];
        for i in 1..bins {
            let cut = sorted[i * sorted.len() / bins];
            if edges.last().is_some_and(|last| cut > *last) && cut < high {
                edges.push(cut);
            }
        }
        edges.push(high);
        Self::new(edges)
    }

    /// The edges in order. There is one more edge than bins.
    pub fn as_slice(&self) -> &[f64] {
        &self.0
    }

    /// Number of bins.
    pub fn bins(&self) -> usize {
        self.0.len() - 1
    }

    /// The bin of a value. `None` outside the edges and for NaN.
    pub fn bin(&self, value: f64) -> Option<usize> {
        let last = self.0.len() - 1;
        if !(value >= self.0[0] && value <= self.0[last]) {
            return None;
        }
        Some((self.0.partition_point(|e| *e <= value) - 1).min(last - 1))
    }
}

fn range(values: &[f64]) -> Result<(f64, f64), BinningError> {
    if let Some(row) = values.iter().position(|v| !v.is_finite()) {
        return Err(BinningError::NotFinite { row, value: values[row] });
    }
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if low < high { Ok((low, high)) } else { Err(BinningError::OneValue) }
}

fn same_length(expected: usize, found: usize) -> Result<(), BinningError> {
    if expected == found { Ok(()) } else { Err(BinningError::Length { expected, found }) }
}

/// Counts per cell of a table, and of the rows outside it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cells {
    /// One count per cell. With two parameters, the index of the second one varies fastest.
    pub cells: Vec<Trials>,
    /// Rows outside the edges.
    pub outside: usize,
}

fn tally(outcomes: &[bool], cells: usize, cell_of: impl Fn(usize) -> Option<usize>) -> Cells {
    let mut counts = vec![(0_u64, 0_u64); cells];
    let mut outside = 0;
    for (row, success) in outcomes.iter().enumerate() {
        match cell_of(row) {
            Some(cell) => {
                counts[cell].0 += u64::from(*success);
                counts[cell].1 += 1;
            }
            None => outside += 1,
        }
    }
    Cells {
        // k ≤ n by construction.
        cells: counts.into_iter().map(|(k, n)| Trials::new(k, n).unwrap_or(Trials::NONE)).collect(),
        outside,
    }
}

/// Success counts per bin of one parameter.
///
/// # Errors
/// Unequal lengths.
pub fn per_bin(values: &[f64], outcomes: &[bool], edges: &Edges) -> Result<Cells, BinningError> {
    same_length(outcomes.len(), values.len())?;
    Ok(tally(outcomes, edges.bins(), |row| edges.bin(values[row])))
}

/// Success counts per cell of two parameters. Cell (i, j) has index i · `y_edges.bins()` + j.
///
/// # Errors
/// Unequal lengths.
pub fn per_pair(
    x: &[f64],
    x_edges: &Edges,
    y: &[f64],
    y_edges: &Edges,
    outcomes: &[bool],
) -> Result<Cells, BinningError> {
    same_length(outcomes.len(), x.len())?;
    same_length(outcomes.len(), y.len())?;
    let wide = y_edges.bins();
    Ok(tally(outcomes, x_edges.bins() * wide, |row| Some(x_edges.bin(x[row])? * wide + y_edges.bin(y[row])?)))
}

/// Success counts per category, codes 0..`categories`.
///
/// # Errors
/// Unequal lengths or a code out of range.
pub fn per_category(codes: &[usize], outcomes: &[bool], categories: usize) -> Result<Vec<Trials>, BinningError> {
    same_length(outcomes.len(), codes.len())?;
    if let Some(row) = codes.iter().position(|c| *c >= categories) {
        return Err(BinningError::UnknownCategory { row, code: codes[row], categories });
    }
    Ok(tally(outcomes, categories, |row| Some(codes[row])).cells)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn last_bin_includes_upper_edge() {
        let edges = Edges::new(vec![0.0, 1.0, 2.0]).unwrap();
        let bins: Vec<Option<usize>> = [-0.1, 0.0, 0.999, 1.0, 2.0, 2.1, f64::NAN].map(|v| edges.bin(v)).to_vec();
        assert_eq!(bins, [None, Some(0), Some(0), Some(1), Some(1), None, None]);
    }

    #[test]
    fn rows_are_counted_once() {
        let x: Vec<f64> = (0..100).map(f64::from).collect();
        let outcomes: Vec<bool> = (0..100).map(|i| i % 3 == 0).collect();
        let edges = Edges::new(vec![10.0, 20.0, 90.0]).unwrap();
        let cells = per_bin(&x, &outcomes, &edges).unwrap();
        assert_eq!(cells.cells.iter().map(|t| t.n()).sum::<u64>() + cells.outside as u64, 100);
        assert_eq!((cells.cells[0].n(), cells.cells[1].n()), (10, 71));
        let pairs = per_pair(&x, &edges, &x, &edges, &outcomes).unwrap();
        assert_eq!(pairs.cells.iter().map(|t| t.n()).collect::<Vec<_>>(), [10, 0, 0, 71]);
    }

    #[test]
    fn equal_counts_keep_ties_together() {
        let values = [1.0, 1.0, 1.0, 1.0, 2.0, 3.0];
        let edges = Edges::equal_count(&values, 3).unwrap();
        assert_eq!(edges.as_slice(), &[1.0, 2.0, 3.0]);
    }

    #[test]
    fn single_value_is_rejected() {
        assert_eq!(Edges::equal_width(&[2.0, 2.0], 4), Err(BinningError::OneValue));
        assert_eq!(Edges::equal_width(&[], 4), Err(BinningError::OneValue));
        assert!(per_category(&[0, 3], &[true, false], 3).is_err());
    }
}
