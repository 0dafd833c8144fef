//! Repeats that no label names: rows with equal settings, within the noise of reading them back.
//!
//! Rows are joined if all their settings are equal: levels and values on a grid exactly, other numbers within a radius
//! (single linkage). The radius is a tenth of the typical distance of a row to its nearest neighbour if every column is
//! permuted, so it adapts to the number of rows, the number of columns and their distributions.
//!
//! Rows can be equal by chance: a design on a grid repeats its settings. The groups count as repeats only if there are far more
//! equal pairs than columns that are sampled independently of each other would give.

use rand_chacha::ChaCha8Rng;
use rand_core::SeedableRng;
use std::collections::BTreeMap;

use super::Clusters;
use crate::resample::{shuffle, uniform};

/// The radius of single linkage, as a share of the expected distance to the nearest neighbour.
const SHARE: f64 = 0.1;
/// Equal pairs per expected one from which rows are repeats.
const EXCESS: f64 = 5.0;
/// Largest number of values of a grid.
const GRID: f64 = 1e6;
/// Rows whose nearest neighbours determine the radius.
const SAMPLED: usize = 200;
/// Rows up to which all are linked without an estimate of the number of pairs.
const LINKED: usize = 20_000;
/// Rows that estimate the number of pairs.
const PROBED: usize = 1_000;
/// Columns that divide space into cells for the search of neighbours.
const CELL_COLUMNS: usize = 3;

/// One column of settings.
#[derive(Debug, Clone, Copy)]
pub enum Setting<'a> {
    /// Numbers. All are finite.
    Numbers(&'a [f64]),
    /// Numbers that vary on a logarithmic scale. All are positive and finite.
    Logarithmic(&'a [f64]),
    /// Indices of levels.
    Levels(&'a [f64]),
}

/// The groups of rows with equal settings. `None` if the settings of too many rows would be equal by chance, or if all differ.
pub fn equal_settings(settings: &[Setting<'_>]) -> Option<Clusters> {
    let rows = settings.iter().map(|setting| setting.values().len()).min().filter(|rows| *rows > 2)?;
    let mut exact: Vec<&[f64]> = Vec::new();
    let mut near: Vec<Vec<f64>> = Vec::new();
    // The probability that two independent rows agree in all exact columns.
    let mut agree = 1.0;
    for setting in settings {
        let values = &setting.values()[..rows];
        match setting.grid(values) {
            Some(chance) => {
                agree *= chance;
                exact.push(values);
            }
            None => near.push(scaled(values, matches!(setting, Setting::Logarithmic(_)))),
        }
    }
    let blocks = Clusters::of_labels((0..rows).map(|row| exact.iter().map(|c| c[row].to_bits()).collect::<Vec<_>>()));
    let (groups, by_chance) = if near.is_empty() {
        (blocks, agree * 0.5 * (rows as f64).powi(2))
    } else {
        let radius = SHARE * neighbour_distance(&near);
        // Of the rows at the median distance d, the share within s d is ln 2 times s to the number of columns.
        let chance = 0.5 * rows as f64 * std::f64::consts::LN_2 * SHARE.powi(near.len() as i32);
        if rows > LINKED && sampled_pairs(&blocks, &near, radius) <= EXCESS * chance {
            return None;
        }
        (linked(&blocks, &near, radius), chance)
    };
    let mut sizes = vec![0_u64; groups.count()];
    groups.of_row().iter().for_each(|group| sizes[*group] += 1);
    let pairs: f64 = sizes.iter().map(|n| (n * n.saturating_sub(1)) as f64 / 2.0).sum();
    (groups.divides() && pairs > EXCESS * by_chance + 3.0).then_some(groups)
}

impl<'a> Setting<'a> {
    fn values(self) -> &'a [f64] {
        match self {
            Self::Numbers(values) | Self::Logarithmic(values) | Self::Levels(values) => values,
        }
    }

    /// The probability that two independent values are equal, if the values lie on a grid. `None` for other numbers.
    fn grid(self, values: &[f64]) -> Option<f64> {
        let n = values.len() as f64;
        let mut counts: BTreeMap<u64, f64> = BTreeMap::new();
        values.iter().for_each(|v| *counts.entry((v + 0.0).to_bits()).or_default() += 1.0);
        let observed = counts.values().map(|k| (k / n).powi(2)).sum::<f64>();
        if matches!(self, Self::Levels(_)) || counts.len() == 1 {
            return Some(observed);
        }
        let mut distinct: Vec<f64> = counts.keys().map(|bits| f64::from_bits(*bits)).collect();
        distinct.sort_unstable_by(f64::total_cmp);
        let gap = distinct.windows(2).map(|pair| pair[1] - pair[0]).fold(f64::INFINITY, f64::min);
        let positions = (distinct[distinct.len() - 1] - distinct[0]) / gap;
        let on_grid = |v: &f64| {
            let at = (v - distinct[0]) / gap;
            (at - at.round()).abs() < 1e-3
        };
        if positions > GRID || !distinct.iter().all(on_grid) {
            return None;
        }
        // A grid that is mostly empty says nothing about how often its values are chosen.
        let filled = counts.len() as f64 >= 0.5 * (positions + 1.0);
        Some(if filled { observed } else { 1.0 / (positions + 1.0) })
    }
}

/// The values in units of the distance between their 5 % and 95 % quantiles.
fn scaled(values: &[f64], logarithmic: bool) -> Vec<f64> {
    let positive = values.iter().all(|v| *v > 0.0);
    let values: Vec<f64> = values.iter().map(|v| if logarithmic && positive { v.ln() } else { *v }).collect();
    let mut sorted = values.clone();
    sorted.sort_unstable_by(f64::total_cmp);
    let at = |share: f64| sorted[(share * (sorted.len() - 1) as f64) as usize];
    let mut width = at(0.95) - at(0.05);
    if width <= 0.0 {
        width = at(1.0) - at(0.0);
    }
    values.into_iter().map(|v| v / width).collect()
}

fn squared_distance(columns: &[Vec<f64>], a: usize, b: usize) -> f64 {
    columns.iter().map(|column| (column[a] - column[b]).powi(2)).sum()
}

/// The median distance to the nearest neighbour if all columns were independent.
fn neighbour_distance(columns: &[Vec<f64>]) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let rows = columns[0].len();
    let independent: Vec<Vec<f64>> = match columns {
        // A single column cannot be permuted against others.
        [column] => {
            let (low, high) = column.iter().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
            vec![(0..rows).map(|_| low + (high - low) * uniform(&mut rng)).collect()]
        }
        _ => columns
            .iter()
            .map(|column| {
                let mut column = column.clone();
                shuffle(&mut rng, &mut column);
                column
            })
            .collect(),
    };
    let step = rows.div_ceil(if rows > LINKED { SAMPLED / 5 } else { SAMPLED }).max(1);
    let nearest = |row: usize| {
        let others = (0..rows).filter(|other| *other != row);
        others.map(|other| squared_distance(&independent, row, other)).fold(f64::INFINITY, f64::min)
    };
    let mut found: Vec<f64> = (0..rows).step_by(step).map(nearest).collect();
    found.sort_unstable_by(f64::total_cmp);
    found[found.len() / 2].sqrt()
}

/// An estimate of the number of pairs at most `radius` apart, from some rows.
fn sampled_pairs(blocks: &Clusters, columns: &[Vec<f64>], radius: f64) -> f64 {
    let rows = blocks.of_row().len();
    let mut order: Vec<usize> = (0..rows).collect();
    order.sort_unstable_by(|a, b| columns[0][*a].total_cmp(&columns[0][*b]));
    let sorted: Vec<f64> = order.iter().map(|row| columns[0][*row]).collect();
    let step = (rows / PROBED).max(1);
    let (mut pairs, mut probed) = (0.0, 0.0);
    for row in (0..rows).step_by(step) {
        probed += 1.0;
        let at = columns[0][row];
        let (from, to) = (sorted.partition_point(|v| *v < at - radius), sorted.partition_point(|v| *v <= at + radius));
        let near = |other: &&usize| {
            **other != row
                && blocks.of_row()[**other] == blocks.of_row()[row]
                && squared_distance(columns, row, **other) <= radius * radius
        };
        pairs += order[from..to].iter().filter(near).count() as f64;
    }
    0.5 * pairs * rows as f64 / probed
}

/// Single linkage within blocks: rows at most `radius` apart are in one group.
fn linked(blocks: &Clusters, columns: &[Vec<f64>], radius: f64) -> Clusters {
    let rows = blocks.of_row().len();
    if radius <= 0.0 {
        let bits = |row: usize| columns.iter().map(|c| c[row].to_bits()).collect::<Vec<_>>();
        return Clusters::of_labels((0..rows).map(|row| (blocks.of_row()[row], bits(row))));
    }
    let used = &columns[..columns.len().min(CELL_COLUMNS)];
    let cell = |row: usize| {
        let mut at = [0_i64; CELL_COLUMNS];
        at.iter_mut().zip(used).for_each(|(at, column)| *at = (column[row] / radius).floor() as i64);
        at
    };
    let mut cells: BTreeMap<(usize, [i64; CELL_COLUMNS]), Vec<usize>> = BTreeMap::new();
    for row in 0..rows {
        cells.entry((blocks.of_row()[row], cell(row))).or_default().push(row);
    }
    let mut parent: Vec<usize> = (0..rows).collect();
    let directions = 3_usize.pow(used.len() as u32);
    for ((block, at), members) in &cells {
        for direction in 0..directions {
            let (mut there, mut code) = (*at, direction);
            for axis in there.iter_mut().take(used.len()) {
                *axis += (code % 3) as i64 - 1;
                code /= 3;
            }
            // Each pair of cells once.
            if there < *at {
                continue;
            }
            let Some(others) = cells.get(&(*block, there)) else { continue };
            for (i, a) in members.iter().enumerate() {
                let others = if there == *at { &members[i + 1..] } else { &others[..] };
                for b in others {
                    let (x, y) = (root(&mut parent, *a), root(&mut parent, *b));
                    if x != y && squared_distance(columns, *a, *b) <= radius * radius {
                        parent[x.max(y)] = x.min(y);
                    }
                }
            }
        }
    }
    Clusters::of_labels((0..rows).map(|row| root(&mut parent, row)))
}

/// The first row of the group of a row.
fn root(parent: &mut [usize], mut row: usize) -> usize {
    while parent[row] != row {
        parent[row] = parent[parent[row]];
        row = parent[row];
    }
    row
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `repeats` rows at each of `scenarios` random points, read back with noise.
    fn rows(scenarios: usize, repeats: usize, noise: f64, integers: bool, columns: usize) -> Vec<Vec<f64>> {
        let mut rng = ChaCha8Rng::seed_from_u64(scenarios as u64 + 17);
        let mut column = || {
            let points: Vec<f64> = (0..scenarios)
                .map(|_| if integers { (1_000.0 * uniform(&mut rng)).floor() } else { uniform(&mut rng) })
                .collect();
            (0..scenarios * repeats).map(|row| points[row % scenarios] + noise * (uniform(&mut rng) - 0.5)).collect()
        };
        (0..columns).map(|_| column()).collect()
    }

    fn found(columns: &[Vec<f64>]) -> Option<usize> {
        let settings: Vec<Setting<'_>> = columns.iter().map(|column| Setting::Numbers(column)).collect();
        equal_settings(&settings).map(|groups| groups.count())
    }

    #[test]
    fn repeats_are_found() {
        assert_eq!(found(&rows(15, 60, 0.0, false, 4)), Some(15));
        assert_eq!(found(&rows(50, 20, 0.0, true, 4)), Some(50));
        assert_eq!(found(&rows(6, 60, 0.0, true, 3)), Some(6));
        assert_eq!(found(&rows(50, 20, 1e-4, false, 4)), Some(50));
        assert_eq!(found(&rows(50, 20, 1e-3, false, 6)), Some(50));
        assert_eq!(found(&rows(30, 20, 1e-5, false, 1)), Some(30));
        assert_eq!(found(&rows(500, 2, 0.0, false, 3)), Some(500));
        assert_eq!(found(&rows(40, 20, 0.0, true, 1)), Some(40));
    }

    #[test]
    fn independent_rows_and_grids_are_no_repeats() {
        for columns in [1, 2, 4, 8] {
            assert_eq!(found(&rows(1_000, 1, 0.0, false, columns)), None, "{columns} columns");
        }
        // Rounded values, and integers with few values.
        let rounded = |digits: f64, columns| -> Vec<Vec<f64>> {
            let round = |column: Vec<f64>| column.into_iter().map(|v| (v * digits).round() / digits).collect();
            rows(1_000, 1, 0.0, false, columns).into_iter().map(round).collect()
        };
        assert_eq!(found(&rounded(100.0, 1)), None);
        assert_eq!(found(&rounded(10.0, 3)), None);
        assert_eq!(found(&rounded(4.0, 2)), None);
        // A full factorial of 3 x 4 settings, 50 rows each.
        let grid = vec![
            (0..600).map(|i| f64::from(i % 3)).collect::<Vec<f64>>(),
            (0..600).map(|i| f64::from(i / 3 % 4)).collect(),
        ];
        assert_eq!(found(&grid), None);
    }

    #[test]
    fn many_rows_are_grouped() {
        let columns = rows(200_000, 1, 0.0, false, 5);
        assert_eq!(found(&columns), None);
    }

    #[test]
    fn levels_are_settings() {
        let columns = rows(40, 10, 0.0, false, 1);
        let levels: Vec<f64> = (0..400).map(|i| f64::from(i % 40 % 3)).collect();
        let groups = equal_settings(&[Setting::Numbers(&columns[0]), Setting::Levels(&levels)]).unwrap();
        assert_eq!(groups.count(), 40);
        // The same value with another level is another setting.
        let other: Vec<f64> = (0..400).map(|i| f64::from(i / 40 % 2)).collect();
        let groups = equal_settings(&[Setting::Numbers(&columns[0]), Setting::Levels(&other)]).unwrap();
        assert_eq!(groups.count(), 80);
    }
}
