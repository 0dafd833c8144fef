//! Detects a direction along which the likelihood increases without limit.
//!
//! With aᵢ = ±(1, xᵢ), + for a success, the rows are separated if some d ≠ 0 has aᵢ·d ≥ 0 for every row and aᵢ·d > 0
//! for one (quasi-complete) or all (complete). Then no maximum likelihood estimate exists (Albert and Anderson 1984).
//! The direction is the solution of a linear program (Konis 2007)
//!
//! maximise Σ aᵢ·d  subject to  aᵢ·d ≥ 0,  -1 ≤ dⱼ ≤ 1,
//!
//! solved with constraint generation: rows that the solution violates are added until there are none, so the result
//! holds for all rows. Limit: margins below 1e-8 of a standardized unit count as zero. Sources: Albert and Anderson
//! (1984), Biometrika 71(1); Konis (2007), DPhil thesis, Oxford; the dictionary form of the simplex method as in
//! Chvátal (1983), with Bland's rule (1977) after a run of steps without progress.

use super::data::{BLOCK, Standardized};

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
    let batch = 4 * q;
    let mut total = vec![0.0; q];
    x.for_each_block(|block| {
        for (j, t) in total.iter_mut().enumerate() {
            for (i, v) in block.column(j).iter().enumerate() {
                if block.weight[i] > 0.0 {
                    *t += block.sign[i] * v;
                }
            }
        }
    });
    let largest = total.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    if largest <= 0.0 {
        return None;
    }
    total.iter_mut().for_each(|v| *v /= largest);

    let start = scan(x, beta, f64::INFINITY, batch);
    let (direction, found) = seek(x, &total, start.worst.clone())?;
    if found.positive == 0 {
        return None;
    }
    let complete = start.smallest > 0.0 || found.positive == x.rows || {
        // The same program for the widest margin: one more variable t with a·d ≥ t, and only t is maximised.
        let mut margin = vec![0.0; q];
        margin.push(1.0);
        let with_t = start.worst.into_iter().map(|row| row.into_iter().chain([-1.0]).collect()).collect();
        seek(x, &margin, with_t).is_some_and(|(d, _)| d[q] > MARGIN)
    };
    let involved: Vec<usize> = (1..q).filter(|&j| direction[j].abs() > 1e-7).collect();
    Some(Separation {
        kind: if complete { SeparationKind::Complete } else { SeparationKind::Quasi },
        columns: involved.iter().map(|&j| x.kept[j - 1]).collect(),
        rows: if complete { x.rows } else { found.positive },
        signs: involved.iter().map(|&j| if direction[j] > 0.0 { 1 } else { -1 }).collect(),
    })
}

/// Solves the program for all rows, starting from the given constraints. Violated rows are added until there are none.
/// If the objective has one more entry than there are parameters, its last variable is the margin t.
fn seek(x: &Standardized<'_>, objective: &[f64], mut constraints: Vec<Vec<f64>>) -> Option<(Vec<f64>, Scan)> {
    let q = x.parameters();
    for _ in 0..ROUNDS {
        let direction = maximise(objective, &constraints);
        let t = direction.get(q).copied();
        let found = scan(x, &direction[..q], t.unwrap_or(0.0) - MARGIN, 4 * q);
        if found.worst.is_empty() {
            return Some((direction, found));
        }
        constraints.extend(found.worst.into_iter().map(|mut row| {
            row.extend(t.map(|_| -1.0));
            row
        }));
    }
    None
}

struct Scan {
    /// Signed rows with the smallest margins below the limit, at most the given number.
    worst: Vec<Vec<f64>>,
    smallest: f64,
    /// Rows with a positive margin.
    positive: usize,
}

fn scan(x: &Standardized<'_>, direction: &[f64], below: f64, at_most: usize) -> Scan {
    let q = x.parameters();
    let mut worst: Vec<(f64, Vec<f64>)> = Vec::new();
    let mut smallest = f64::INFINITY;
    let mut positive = 0;
    let mut eta = [0.0; BLOCK];
    x.for_each_block(|block| {
        block.predictor(direction, &mut eta);
        for (i, e) in eta.iter().enumerate().take(block.rows) {
            if block.weight[i] <= 0.0 {
                continue;
            }
            let margin = block.sign[i] * e;
            smallest = smallest.min(margin);
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
    Scan { worst: worst.into_iter().map(|(_, row)| row).collect(), smallest, positive }
}

/// Maximises c·d subject to a·d ≥ 0 for each constraint and |dⱼ| ≤ 1.
///
/// Variables are d = u - v with u, v ≥ 0 and u + v ≤ 1, so d = 0 is a feasible start and the optimum is bounded.
fn maximise(c: &[f64], constraints: &[Vec<f64>]) -> Vec<f64> {
    const EPSILON: f64 = 1e-10;
    let q = c.len();
    let columns = 2 * q;
    let rows = constraints.len() + q;
    // Dictionary: basic_i = rhs_i - Σ_j table_ij nonbasic_j; objective = Σ_j gain_j nonbasic_j.
    let mut table = vec![0.0; rows * columns];
    let mut rhs = vec![0.0; rows];
    for (i, a) in constraints.iter().enumerate() {
        for j in 0..q {
            table[i * columns + j] = -a[j];
            table[i * columns + q + j] = a[j];
        }
    }
    for j in 0..q {
        let i = constraints.len() + j;
        table[i * columns + j] = 1.0;
        table[i * columns + q + j] = 1.0;
        rhs[i] = 1.0;
    }
    let mut gain: Vec<f64> = c.iter().copied().chain(c.iter().map(|v| -v)).collect();
    let mut nonbasic: Vec<usize> = (0..columns).collect();
    let mut basic: Vec<usize> = (columns..columns + rows).collect();

    let mut idle = 0;
    for _ in 0..50_000 {
        let candidates = (0..columns).filter(|&j| gain[j] > EPSILON);
        let entering = if idle > 50 {
            candidates.min_by_key(|&j| nonbasic[j])
        } else {
            candidates.max_by(|&a, &b| gain[a].total_cmp(&gain[b]))
        };
        let Some(e) = entering else { break };
        let mut leaving: Option<(usize, f64)> = None;
        for i in 0..rows {
            let slope = table[i * columns + e];
            if slope > EPSILON {
                let ratio = rhs[i] / slope;
                let better = leaving
                    .is_none_or(|(l, best)| ratio < best - 1e-14 || (ratio <= best + 1e-14 && basic[i] < basic[l]));
                if better {
                    leaving = Some((i, ratio));
                }
            }
        }
        let Some((l, ratio)) = leaving else { break };
        idle = if ratio * gain[e] > 1e-12 { 0 } else { idle + 1 };

        let pivot = table[l * columns + e];
        for j in 0..columns {
            table[l * columns + j] /= pivot;
        }
        table[l * columns + e] = 1.0 / pivot;
        rhs[l] /= pivot;
        let pivot_row = table[l * columns..(l + 1) * columns].to_vec();
        for i in (0..rows).filter(|&i| i != l) {
            let factor = table[i * columns + e];
            if factor.abs() > 0.0 {
                for (t, p) in table[i * columns..(i + 1) * columns].iter_mut().zip(&pivot_row) {
                    *t -= factor * p;
                }
                table[i * columns + e] = -factor * pivot_row[e];
                rhs[i] = (rhs[i] - factor * rhs[l]).max(0.0);
            }
        }
        let factor = gain[e];
        for (g, p) in gain.iter_mut().zip(&pivot_row) {
            *g -= factor * p;
        }
        gain[e] = -factor * pivot_row[e];
        std::mem::swap(&mut nonbasic[e], &mut basic[l]);
    }
    let mut direction = vec![0.0; q];
    for (i, &variable) in basic.iter().enumerate() {
        if variable < q {
            direction[variable] += rhs[i];
        } else if variable < columns {
            direction[variable - q] -= rhs[i];
        }
    }
    direction
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn program_finds_corner_of_cone() {
        // Maximum of d0 + d1 with d0 >= d1 >= 0 in the box: (1, 1).
        let d = maximise(&[1.0, 1.0], &[vec![1.0, -1.0], vec![0.0, 1.0]]);
        assert!((d[0] - 1.0).abs() < 1e-12 && (d[1] - 1.0).abs() < 1e-12);
    }

    #[test]
    fn opposed_constraints_give_origin() {
        let d = maximise(&[1.0, 0.5], &[vec![1.0, 0.0], vec![-1.0, 0.0], vec![0.0, 1.0], vec![1.0, -1.0]]);
        assert!(d.iter().all(|v| v.abs() < 1e-12));
    }
}
