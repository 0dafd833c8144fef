//! Detects a direction along which the likelihood increases without limit.
//!
//! With aᵢ = ±(1, xᵢ), + for a success, the rows are separated if some d ≠ 0 has aᵢ·d ≥ 0 for every row and aᵢ·d > 0
//! for one (quasi-complete) or all (complete). Then no maximum likelihood estimate exists (Albert and Anderson 1984).
//! The direction is the projection of Σ aᵢ onto the cone of all d with aᵢ·d ≥ 0: it is zero only if the rows overlap, because
//! Σ aᵢ·d > 0 for every separating d. Rows that a direction violates are added to the constraints until there are none, so the
//! result holds for all rows. The same search among the rows that lie on the boundary finds the rest that can be separated; the
//! separation is complete if no row is left. Limit: margins below 1e-8 of a standardized unit count as zero. Sources: Albert
//! and Anderson (1984), Biometrika 71(1); Konis (2007), DPhil thesis, Oxford, with a linear program for the same cone.

use super::cone::project;
use super::data::{BLOCK, Block, Standardized};

/// The kind of separation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SeparationKind {
    /// A linear function of the columns separates every success from every failure.
    Complete,
    /// A linear function separates some of them and is zero on the rest (for example a category without successes).
    Quasi,
}

/// Separation found in the data: no finite maximum likelihood estimate exists.
#[derive(Debug, Clone, PartialEq)]
pub struct Separation {
    /// Complete or quasi-complete.
    pub kind: SeparationKind,
    /// Columns, by the caller's index, on which the separating direction depends. Empty if only the intercept does.
    pub columns: Vec<usize>,
    /// Rows whose outcome the direction predicts without error.
    pub rows: usize,
    /// For each of `columns`, +1 if larger values indicate success and -1 if they indicate failure.
    pub signs: Vec<i8>,
}

const MARGIN: f64 = 1e-8;
const ROUNDS: usize = 200;

/// Searches for separation, starting from the rows with the smallest margin under `beta`.
pub(super) fn find(x: &Standardized<'_>, beta: &[f64]) -> Option<Separation> {
    let q = x.parameters();
    let mut directions: Vec<Vec<f64>> = Vec::new();
    let mut separated = 0;
    while separated < x.rows
        && let Some((direction, positive)) = seek(x, &directions, beta)
    {
        separated += positive;
        directions.push(direction);
    }
    if directions.is_empty() {
        return None;
    }
    // A later direction only matters for rows, and then for columns, on which the earlier ones are zero.
    let leads = |j: usize| directions.iter().map(|d| d[j]).find(|entry| entry.abs() > 1e-7);
    let involved: Vec<(usize, f64)> = (1..q).filter_map(|j| Some((x.kept[j - 1], leads(j)?))).collect();
    Some(Separation {
        kind: if separated == x.rows { SeparationKind::Complete } else { SeparationKind::Quasi },
        columns: involved.iter().map(|(column, _)| *column).collect(),
        rows: separated,
        signs: involved.iter().map(|(_, entry)| if *entry > 0.0 { 1 } else { -1 }).collect(),
    })
}

/// Finds a direction that separates some of the rows that earlier directions leave on the boundary, and their number.
fn seek(x: &Standardized<'_>, earlier: &[Vec<f64>], beta: &[f64]) -> Option<(Vec<f64>, usize)> {
    let q = x.parameters();
    let mut total = vec![0.0; q];
    let mut eta = [0.0; BLOCK];
    x.for_each_block(|block| {
        let left = on_boundary(block, earlier, &mut eta);
        for (j, t) in total.iter_mut().enumerate() {
            for (i, v) in block.column(j).iter().enumerate() {
                if left[i] {
                    *t += block.sign[i] * v;
                }
            }
        }
    });
    let mut constraints = scan(x, earlier, beta, f64::INFINITY, 4 * q).worst;
    for _ in 0..ROUNDS {
        let direction = project(&total, &constraints, 0.1 * MARGIN)?;
        let found = scan(x, earlier, &direction, -MARGIN, 4 * q);
        if found.worst.is_empty() {
            return (found.positive > 0).then_some((direction, found.positive));
        }
        constraints.extend(found.worst);
    }
    None
}

/// The rows of a block that have a weight and lie on the boundary of all directions.
fn on_boundary(block: &Block, directions: &[Vec<f64>], eta: &mut [f64; BLOCK]) -> [bool; BLOCK] {
    let mut left = [false; BLOCK];
    left.iter_mut().zip(&block.weight).for_each(|(left, weight)| *left = *weight > 0.0);
    for direction in directions {
        block.predictor(direction, eta);
        for (i, e) in eta.iter().enumerate() {
            left[i] &= block.sign[i] * e <= MARGIN;
        }
    }
    left
}

struct Scan {
    /// Signed rows with the smallest margins below the limit, at most the given number.
    worst: Vec<Vec<f64>>,
    /// Rows with a positive margin.
    positive: usize,
}

/// Compares the rows that earlier directions leave on the boundary with a direction.
fn scan(x: &Standardized<'_>, earlier: &[Vec<f64>], direction: &[f64], below: f64, at_most: usize) -> Scan {
    let q = x.parameters();
    let mut worst: Vec<(f64, Vec<f64>)> = Vec::new();
    let mut positive = 0;
    let mut eta = [0.0; BLOCK];
    x.for_each_block(|block| {
        let left = on_boundary(block, earlier, &mut eta);
        block.predictor(direction, &mut eta);
        for (i, e) in eta.iter().enumerate().filter(|(i, _)| left[*i]) {
            let margin = block.sign[i] * e;
            positive += usize::from(margin > MARGIN);
            let enters = worst.len() < at_most || worst.last().is_some_and(|(m, _)| margin < *m);
            if margin < below && enters {
                let row: Vec<f64> = (0..q).map(|j| block.sign[i] * block.column(j)[i]).collect();
                // Equal rows (categories, repeated scenarios) are skipped, because they would all add the same
                // constraint.
                if worst.iter().any(|(_, kept)| *kept == row) {
                    continue;
                }
                let at = worst.partition_point(|(m, _)| *m <= margin);
                worst.insert(at, (margin, row));
                worst.truncate(at_most);
            }
        }
    });
    Scan { worst: worst.into_iter().map(|(_, row)| row).collect(), positive }
}
