//! Does the outcome of a row depend on its neighbours in the file?
//!
//! The statistic is the sum of squares of the sums of [`LAG`] neighbouring residuals. Under the hypothesis that rows can be
//! exchanged, it is compared with that of permuted rows; sampling stops as soon as the p-value is clearly large.
//!
//! Limit: an effect in a narrow band of a column that drifts with the order can look like dependence (19 of 100 files of 480 rows): the
//! intervals are then too wide. A test that does not reject proves nothing. Of eight days with rates that differ by a standard deviation of
//! 0.4 on the logit scale, 60 rows each, it finds about half. Source of the sequential p-value: Besag and Clifford (1991), Biometrika
//! 78(2).

use rand_chacha::ChaCha8Rng;
use rand_core::SeedableRng;

use crate::clusters::Clusters;
use crate::logistic::{Data, Options, fit, standardized};
use crate::resample::shuffle;

/// Number of neighbouring rows whose residuals are summed.
pub const LAG: usize = 20;
/// Permutations that must reach the observed statistic before sampling stops.
const EXCEEDANCES: usize = 20;
/// Blocks of neighbouring rows, if the rows of a file depend on their order.
const BLOCKS: usize = 10;
/// Level of the test of neighbouring rows.
const LEVEL: f64 = 0.01;
/// Share of the changes from row to row that go in one direction, from which the file counts as sorted by a column. A value that drifts
/// while the rows are recorded, such as a temperature, goes up and down.
const SORTED: f64 = 0.98;
/// Most levels of a column by which a file counts as sorted.
const MOST_LEVELS: u64 = 25;
/// Pieces of the effect of a column by which the rows are sorted: one with a sharp edge would otherwise look like dependence.
const PIECES: usize = 8;
/// Most rows of the test of neighbouring rows.
const MOST_ROWS: usize = 100_000;
/// Most columns in the model whose residuals are tested.
const MODELLED: usize = 12;

/// The permutation p-value of "the residuals do not depend on their order". `level` is the smallest level of interest. `None`
/// with fewer than two windows, or if all residuals are equal.
pub fn serial_dependence(residuals: &[f64], level: f64, seed: u64) -> Option<f64> {
    if residuals.len() < 2 * LAG || residuals.iter().all(|e| (e - residuals[0]).abs() <= 0.0) {
        return None;
    }
    let observed = statistic(residuals);
    let replicates = (2.0 / level).ceil() as usize - 1;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut permuted = residuals.to_vec();
    let mut reached = 0;
    for drawn in 1..=replicates {
        shuffle(&mut rng, &mut permuted);
        if statistic(&permuted) >= observed {
            reached += 1;
            if reached == EXCEEDANCES {
                return Some(EXCEEDANCES as f64 / drawn as f64);
            }
        }
    }
    Some((reached + 1) as f64 / (replicates + 1) as f64)
}

fn statistic(residuals: &[f64]) -> f64 {
    let mut window: f64 = residuals[..LAG].iter().sum();
    let mut total = window * window;
    for (entering, leaving) in residuals[LAG..].iter().zip(residuals) {
        window += entering - leaving;
        total += window * window;
    }
    total
}

/// Blocks of neighbouring rows, and the p-value of the test, if rows depend on their neighbours. `columns` are the parameters
/// of the rows, `numeric` those of them that a smooth model of the outcome can use. `None` for rows that are sorted by a column, as a
/// sweep writes them: the order of the rows is then that of a setting. Rows that are sorted by their outcomes depend on each other: nothing
/// tells them from those of a robot that broke down.
pub fn blocks_of_neighbours(success: &[bool], columns: &[&[f64]], numeric: &[&[f64]]) -> Option<(f64, Clusters)> {
    let rows = success.len().min(MOST_ROWS);
    // A sweep has a few levels.
    let sorted = |column: &&[f64]| changes_in_order(&column[..rows]).is_some_and(|changes| changes < MOST_LEVELS);
    if rows < 2 * LAG || columns.iter().any(sorted) {
        return None;
    }
    let numeric: Vec<&[f64]> = numeric.iter().map(|column| &column[..rows]).collect();
    let p = serial_dependence(&residuals(&success[..rows], &numeric), LEVEL, 0)?;
    let size = success.len().div_ceil(BLOCKS);
    (p <= LEVEL).then(|| (p, Clusters::of_labels((0..success.len()).map(|row| row / size))))
}

/// The number of changes from row to row in a column whose rows are in its order. `None` if they are not.
fn changes_in_order(column: &[f64]) -> Option<u64> {
    let steps = column.windows(2).map(|pair| pair[1] - pair[0]);
    let (up, down) = steps.fold((0, 0), |(up, down), step| (up + u64::from(step > 0.0), down + u64::from(step < 0.0)));
    (up + down > 0 && up.max(down) as f64 >= SORTED * (up + down) as f64).then_some(up + down)
}

/// Outcomes less a smooth model of the columns, in units of their standard deviation.
fn residuals(success: &[bool], numeric: &[&[f64]]) -> Vec<f64> {
    let rows = success.len();
    let mut columns: Vec<Vec<f64>> = Vec::new();
    for line in numeric.iter().take(MODELLED).filter_map(|column| standardized(column)) {
        if changes_in_order(&line).is_some() {
            let mut sorted = line.clone();
            sorted.sort_by(f64::total_cmp);
            let knots = (1..PIECES).map(|piece| sorted[piece * rows / PIECES]);
            columns.extend(knots.map(|knot| line.iter().map(|x| (x - knot).max(0.0)).collect()));
        }
        columns.push(line.iter().map(|x| x * x).collect());
        columns.push(line);
    }
    let slices: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    let model = Data::new(&slices, success, None).and_then(|data| fit(data, Options::default()));
    let mean = success.iter().filter(|s| **s).count() as f64 / rows as f64;
    let p = model.ok().and_then(|model| model.probabilities(&slices)).filter(|p| p.len() == rows);
    let p = p.unwrap_or_else(|| vec![mean; rows]);
    let residual = |(p, success): (&f64, &bool)| (f64::from(u8::from(*success)) - p) / (p * (1.0 - p)).max(1e-4).sqrt();
    p.iter().zip(success).map(residual).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resample::uniform;

    /// How often the test rejects for `days` of 60 rows whose rates lie within `spread` of 0.7.
    fn rejected(days: usize, spread: f64) -> u32 {
        let mut found = 0;
        for seed in 0..200 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let rates: Vec<f64> = (0..days).map(|_| 0.7 + spread * (2.0 * uniform(&mut rng) - 1.0)).collect();
            let rows: Vec<f64> =
                (0..days * 60).map(|row| f64::from(u8::from(uniform(&mut rng) < rates[row / 60])) - 0.7).collect();
            found += u32::from(serial_dependence(&rows, 0.01, seed).is_some_and(|p| p <= 0.01));
        }
        found
    }

    #[test]
    fn days_are_found_and_independent_rows_are_not() {
        assert!(rejected(8, 0.0) <= 6, "{}", rejected(8, 0.0));
        assert!(rejected(8, 0.3) >= 190, "{}", rejected(8, 0.3));
        assert_eq!(serial_dependence(&[1.0; 100], 0.01, 1), None);
    }

    /// How often blocks are found in 12 sessions of 40 rows, beside a column that is `drift` in each row.
    fn found(spread: f64, drift: impl Fn(usize, &mut ChaCha8Rng) -> f64) -> u32 {
        let mut found = 0;
        for seed in 0..100 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let rates: Vec<f64> = (0..12).map(|_| 0.7 + spread * (2.0 * uniform(&mut rng) - 1.0)).collect();
            let success: Vec<bool> = (0..480).map(|row| uniform(&mut rng) < rates[row / 40]).collect();
            let column: Vec<f64> = (0..480).map(|row| drift(row, &mut rng)).collect();
            found += u32::from(blocks_of_neighbours(&success, &[&column], &[&column]).is_some());
        }
        found
    }

    #[test]
    fn drifting_column_does_not_hide_dependent_rows() {
        // A room that warms up by 2.4 degrees, read with noise.
        let warm = |row: usize, rng: &mut ChaCha8Rng| 18.0 + row as f64 / 200.0 + uniform(rng);
        assert!(found(0.29, warm) >= 88, "{}", found(0.29, warm));
        assert!(found(0.0, warm) <= 4, "{}", found(0.0, warm));
        // A sweep: the order is that of a setting.
        assert_eq!(found(0.29, |row, _| (row / 48) as f64), 0);
    }

    #[test]
    fn a_breakdown_is_found() {
        let of = |failed: std::ops::Range<usize>| -> Vec<bool> { (0..600).map(|row| !failed.contains(&row)).collect() };
        for failed in [350..480, 467..600, 0..133] {
            assert!(blocks_of_neighbours(&of(failed.clone()), &[], &[]).is_some(), "{failed:?}");
        }
        for failed in [599..600, 0..1, 300..301] {
            assert!(blocks_of_neighbours(&of(failed.clone()), &[], &[]).is_none(), "{failed:?}");
        }
    }

    #[test]
    fn effect_of_an_ordered_column_is_no_dependence() {
        let slope = |x: f64| 1.0 / (1.0 + (4.0 * (x - 0.7)).exp());
        let step = |x: f64| if x < 0.5 { 0.9 } else { 0.4 };
        let band = |x: f64| if (0.4..0.6).contains(&x) { 0.3 } else { 0.9 };
        for (effect, noise, most) in
            [(&slope as &dyn Fn(f64) -> f64, 0.4, 4), (&step, 0.0, 10), (&band, 0.0, 25), (&band, 0.4, 30)]
        {
            let mut blocks = 0;
            for seed in 0..100 {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                let column: Vec<f64> = (0..480).map(|row| row as f64 / 480.0 + noise * uniform(&mut rng)).collect();
                let success: Vec<bool> = column.iter().map(|x| uniform(&mut rng) < effect(*x)).collect();
                blocks += u32::from(blocks_of_neighbours(&success, &[&column], &[&column]).is_some());
            }
            assert!(blocks <= most, "{blocks} of {most}");
        }
    }
}
