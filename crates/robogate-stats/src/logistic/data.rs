//! Rows of a regression: checked once, then processed in blocks.

use super::RegressionError;
use crate::weighted::is_weight;
use robogate_maths::dense::{dependent_columns, dot};

/// Rows per block. A block with a few dozen columns fits into the first-level cache.
pub(super) const BLOCK: usize = 128;

/// Smallest fraction of a column's variance that the other columns must leave unexplained. Below it the column is
/// collinear.
const COLLINEAR: f64 = 1e-9;

/// Columns, outcomes and optional weights of equal length. All are finite, and at least one row has positive weight.
#[derive(Debug, Clone, Copy)]
pub struct Data<'a> {
    columns: &'a [&'a [f64]],
    outcomes: &'a [bool],
    weights: Option<&'a [f64]>,
    clusters: Option<&'a [usize]>,
}

impl<'a> Data<'a> {
    /// Checks lengths and values. The fit adds the intercept.
    ///
    /// `weights` state how many rows of the population each row represents. A weight of zero excludes a row.
    ///
    /// # Errors
    /// The problem, with the index of its column and row.
    pub fn new(
        columns: &'a [&'a [f64]],
        outcomes: &'a [bool],
        weights: Option<&'a [f64]>,
    ) -> Result<Self, RegressionError> {
        let rows = outcomes.len();
        for (column, values) in columns.iter().enumerate() {
            if values.len() != rows {
                return Err(RegressionError::ColumnLength { column, expected: rows, found: values.len() });
            }
            if let Some(row) = values.iter().position(|v| !v.is_finite()) {
                return Err(RegressionError::NotFinite { column, row, value: values[row] });
            }
        }
        if let Some(weights) = weights {
            if weights.len() != rows {
                return Err(RegressionError::WeightLength { expected: rows, found: weights.len() });
            }
            if let Some(row) = weights.iter().position(|w| !is_weight(*w)) {
                return Err(RegressionError::BadWeight { row, value: weights[row] });
            }
        }
        Ok(Self { columns, outcomes, weights, clusters: None })
    }

    /// The same rows, of which those with equal numbers depend on each other. Standard errors, intervals and p-values then
    /// count clusters. `clusters` are numbered from 0; `None` changes nothing.
    ///
    /// # Errors
    /// [`RegressionError::ClusterLength`] if there is not one number for each row.
    pub fn clustered(self, clusters: Option<&'a [usize]>) -> Result<Self, RegressionError> {
        match clusters.filter(|of| of.len() != self.rows()) {
            Some(of) => Err(RegressionError::ClusterLength { expected: self.rows(), found: of.len() }),
            None => Ok(Self { clusters, ..self }),
        }
    }

    /// Number of columns, without the intercept.
    pub fn width(&self) -> usize {
        self.columns.len()
    }

    /// Number of rows, including those with zero weight.
    pub fn rows(&self) -> usize {
        self.outcomes.len()
    }

    /// The outcomes.
    pub fn outcomes(&self) -> &'a [bool] {
        self.outcomes
    }

    /// The columns.
    pub fn columns(&self) -> &'a [&'a [f64]] {
        self.columns
    }

    /// The weights.
    pub fn weights(&self) -> Option<&'a [f64]> {
        self.weights
    }

    /// The cluster of each row.
    pub(super) fn clusters(&self) -> Option<&'a [usize]> {
        self.clusters
    }

    fn weight(&self, row: usize) -> f64 {
        self.weights.map_or(1.0, |w| w[row])
    }
}

/// The reason why a column is not part of a fit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Dropped {
    /// The column is constant, like the intercept.
    Constant,
    /// The column is a linear function of these columns (and the intercept).
    CollinearWith(Vec<usize>),
}

/// The columns of the fit, centred and scaled to unit variance, after an intercept.
pub(super) struct Standardized<'a> {
    data: Data<'a>,
    /// Index of each kept column among the caller's columns.
    pub(super) kept: Vec<usize>,
    /// The dropped columns with the reason.
    pub(super) dropped: Vec<(usize, Dropped)>,
    pub(super) means: Vec<f64>,
    pub(super) deviations: Vec<f64>,
    /// Rows with positive weight, and the successes among them.
    pub(super) rows: usize,
    pub(super) successes: usize,
    pub(super) weight: f64,
    pub(super) success_weight: f64,
}

/// Up to [`BLOCK`] rows: the intercept and the standardized columns one after the other, `BLOCK` apart, zero-padded.
pub(super) struct Block {
    pub(super) first_row: usize,
    pub(super) rows: usize,
    pub(super) x: Vec<f64>,
    /// +1 for a success, -1 for a failure, 0 for padding.
    pub(super) sign: [f64; BLOCK],
    /// Weight; 0 for padding.
    pub(super) weight: [f64; BLOCK],
}

impl Block {
    /// Column `j` of the block. Column 0 is the intercept.
    pub(super) fn column(&self, j: usize) -> &[f64] {
        &self.x[j * BLOCK..(j + 1) * BLOCK]
    }

    /// Linear predictor of every row.
    pub(super) fn predictor(&self, beta: &[f64], eta: &mut [f64; BLOCK]) {
        eta.fill(0.0);
        for (j, b) in beta.iter().enumerate() {
            for (e, x) in eta.iter_mut().zip(self.column(j)) {
                *e += b * x;
            }
        }
    }
}

impl<'a> Standardized<'a> {
    /// Classifies each column as constant, collinear, or kept.
    pub(super) fn new(data: Data<'a>) -> Self {
        let n = data.rows();
        let mut rows = 0;
        let mut successes = 0;
        let mut weight = 0.0;
        let mut success_weight = 0.0;
        for row in 0..n {
            let w = data.weight(row);
            if w > 0.0 {
                rows += 1;
                weight += w;
                if data.outcomes[row] {
                    successes += 1;
                    success_weight += w;
                }
            }
        }
        let mut this = Self {
            data,
            kept: Vec::new(),
            dropped: Vec::new(),
            means: Vec::new(),
            deviations: Vec::new(),
            rows,
            successes,
            weight,
            success_weight,
        };
        if rows == 0 {
            return this;
        }
        for (column, values) in data.columns.iter().enumerate() {
            match this.moments(values) {
                Some((mean, deviation)) => {
                    this.kept.push(column);
                    this.means.push(mean);
                    this.deviations.push(deviation);
                }
                None => this.dropped.push((column, Dropped::Constant)),
            }
        }
        this.drop_collinear();
        this
    }

    /// Weighted mean and standard deviation (divisor: total weight). `None` for a constant column.
    fn moments(&self, values: &[f64]) -> Option<(f64, f64)> {
        // Division by the largest magnitude first keeps squares of extreme values finite.
        let largest = values.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        if largest <= 0.0 {
            return None;
        }
        let mut sum = 0.0;
        for (row, v) in values.iter().enumerate() {
            sum += self.data.weight(row) * (v / largest);
        }
        let mean = sum / self.weight;
        let mut square = 0.0;
        for (row, v) in values.iter().enumerate() {
            square += self.data.weight(row) * (v / largest - mean).powi(2);
        }
        let deviation = (square / self.weight).sqrt();
        (deviation > 1e-12).then_some((mean * largest, deviation * largest))
    }

    fn drop_collinear(&mut self) {
        let q = self.parameters();
        let mut gram = vec![0.0; q * q];
        self.for_each_block(|block| {
            add_weighted_gram(&mut gram, q, block, &block.weight);
        });
        mirror(&mut gram, q);
        let dependent = dependent_columns(&gram, q, COLLINEAR);
        for (position, explaining) in dependent.iter().rev() {
            if *position == 0 {
                continue;
            }
            let with = explaining.iter().filter(|&&p| p > 0).map(|&p| self.kept[p - 1]).collect();
            self.dropped.push((self.kept[position - 1], Dropped::CollinearWith(with)));
        }
        for (position, _) in dependent.iter().rev() {
            if *position > 0 {
                self.kept.remove(position - 1);
                self.means.remove(position - 1);
                self.deviations.remove(position - 1);
            }
        }
        self.dropped.sort_by_key(|(column, _)| *column);
    }

    /// The cluster of each row.
    pub(super) fn clusters(&self) -> Option<&'a [usize]> {
        self.data.clusters()
    }

    /// Number of coefficients, including the intercept.
    pub(super) fn parameters(&self) -> usize {
        self.kept.len() + 1
    }

    /// Calls `visit` with the rows, in order, block by block.
    pub(super) fn for_each_block(&self, mut visit: impl FnMut(&Block)) {
        let n = self.data.rows();
        let q = self.parameters();
        let mut block =
            Block { first_row: 0, rows: 0, x: vec![0.0; q * BLOCK], sign: [0.0; BLOCK], weight: [0.0; BLOCK] };
        let mut first = 0;
        while first < n {
            let rows = BLOCK.min(n - first);
            block.first_row = first;
            block.rows = rows;
            block.x[..BLOCK].fill(1.0);
            for i in 0..BLOCK {
                if i < rows {
                    block.sign[i] = if self.data.outcomes[first + i] { 1.0 } else { -1.0 };
                    block.weight[i] = self.data.weight(first + i);
                } else {
                    block.sign[i] = 0.0;
                    block.weight[i] = 0.0;
                }
            }
            for (j, &column) in self.kept.iter().enumerate() {
                let (mean, scale) = (self.means[j], 1.0 / self.deviations[j]);
                let source = &self.data.columns[column][first..first + rows];
                let target = &mut block.x[(j + 1) * BLOCK..(j + 2) * BLOCK];
                for (t, s) in target.iter_mut().zip(source) {
                    *t = (s - mean) * scale;
                }
                target[rows..].fill(0.0);
            }
            visit(&block);
            first += rows;
        }
    }
}

/// Adds Xᵀ diag(weight) X of one block to the lower triangle of `gram`.
pub(super) fn add_weighted_gram(gram: &mut [f64], q: usize, block: &Block, weight: &[f64; BLOCK]) {
    let mut weighted = [0.0; BLOCK];
    for i in 0..q {
        for ((t, x), w) in weighted.iter_mut().zip(block.column(i)).zip(weight) {
            *t = x * w;
        }
        for j in 0..=i {
            gram[i * q + j] += dot(&weighted, block.column(j));
        }
    }
}

/// Copies the lower triangle to the upper one.
pub(super) fn mirror(matrix: &mut [f64], q: usize) {
    for i in 0..q {
        for j in 0..i {
            matrix[j * q + i] = matrix[i * q + j];
        }
    }
}

impl Standardized<'_> {
    /// Number of the caller's columns.
    pub(super) fn full_width(&self) -> usize {
        self.data.width()
    }
}
