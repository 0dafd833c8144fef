//! Gradient boosting of regression trees on histograms, with monotone constraints.
//!
//! The model is a sum of trees in the log-odds of success. Each tree is a Newton step on the log loss: the value of a
//! leaf is -G/(H + λ), with the sums G and H of the first and second derivatives over its rows, and a split gains
//! ½ (G_l²/(H_l + λ) + G_r²/(H_r + λ) - G²/(H + λ)). Trees grow leaf by leaf, the largest gain first. Columns are cut into
//! at most 64 bins of nearly equal counts. A value that is NaN counts as smaller than every number.
//!
//! A column that must not lower the chance of success only gets splits whose right leaf has the larger value, and the
//! middle of both values bounds all later leaves below them. The sum of such trees is monotone in that column.
//!
//! Rows and columns are subsampled by a stream that depends on the seed alone, and all sums run in the order of the
//! rows: the same data and options give the same bits for any number of threads.
//!
//! Sources: Friedman (2001), Annals of Statistics 29; Chen and Guestrin (2016), KDD, for the gain; Ke et al. (2017),
//! NeurIPS, for histograms and growth by leaf. Limit: the fit has no interval; use rows that were not fitted to judge it.

use rand_chacha::ChaCha8Rng;
use rand_core::SeedableRng;

use crate::flexible::numbers;
use crate::logistic::logistic_and_log;
use crate::resample::uniform;

/// Largest number of bins of a column.
const BINS: usize = 64;

/// The direction in which a column may change the chance of success.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Monotone {
    /// Larger values never lower it.
    Increasing,
    /// Larger values never raise it.
    Decreasing,
    /// No constraint.
    #[default]
    Free,
}

/// Settings of a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Number of trees.
    pub trees: usize,
    /// Factor of each tree's values, from 0 to 1.
    pub learning_rate: f64,
    /// Largest number of leaves of a tree.
    pub leaves: usize,
    /// Smallest number of rows of a leaf.
    pub rows_of_leaf: usize,
    /// λ, the penalty on the values of leaves.
    pub penalty: f64,
    /// Share of the rows of each tree.
    pub row_share: f64,
    /// Share of the columns of each tree.
    pub column_share: f64,
    /// Seed of the subsamples.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            trees: 200,
            learning_rate: 0.05,
            leaves: 15,
            rows_of_leaf: 15,
            penalty: 1.0,
            row_share: 0.8,
            column_share: 0.6,
            seed: 0,
        }
    }
}

/// The reason why a model cannot be fitted.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BoostingError {
    /// Lengths differ.
    #[error("column {column} has {found} rows. Expected {expected}, one for each outcome")]
    Length {
        /// Index of the column.
        column: usize,
        /// Rows found.
        found: usize,
        /// Rows of the outcomes.
        expected: usize,
    },
    /// The constraints do not match the columns.
    #[error("{found} constraints. Expected {expected}, one for each column")]
    Constraints {
        /// Constraints found.
        found: usize,
        /// Number of columns.
        expected: usize,
    },
    /// All outcomes are equal.
    #[error("all {rows} rows have the same outcome. Expected successes and failures")]
    OneClass {
        /// Number of rows.
        rows: usize,
    },
}

/// A node of a tree.
#[derive(Debug, Clone, PartialEq)]
enum Node {
    /// Rows with a value up to the threshold, or NaN, go left.
    Split { column: u32, threshold: f64, left: u32, right: u32 },
    /// The contribution to the log-odds.
    Leaf(f64),
}

/// A fitted model.
#[derive(Debug, Clone, PartialEq)]
pub struct Boosting {
    start: f64,
    trees: Vec<Vec<Node>>,
    columns: usize,
}

impl Boosting {
    /// Fits the model to these columns.
    ///
    /// # Errors
    /// Unequal lengths, or outcomes of one class.
    pub fn fit(
        columns: &[&[f64]],
        outcomes: &[bool],
        constraints: &[Monotone],
        options: Options,
    ) -> Result<Self, BoostingError> {
        let rows = outcomes.len();
        if let Some(column) = columns.iter().position(|c| c.len() != rows) {
            return Err(BoostingError::Length { column, found: columns[column].len(), expected: rows });
        }
        if constraints.len() != columns.len() {
            return Err(BoostingError::Constraints { found: constraints.len(), expected: columns.len() });
        }
        let successes = outcomes.iter().filter(|y| **y).count();
        if successes == 0 || successes == rows {
            return Err(BoostingError::OneClass { rows });
        }
        let binned: Vec<Binned> = columns.iter().map(|column| Binned::new(column)).collect();
        let start = (successes as f64 / (rows - successes) as f64).ln();
        let mut score = vec![start; rows];
        let mut slopes = vec![[0.0; 2]; rows];
        let mut random = ChaCha8Rng::seed_from_u64(options.seed);
        let mut trees = Vec::with_capacity(options.trees);
        for _ in 0..options.trees {
            for ((slope, score), success) in slopes.iter_mut().zip(&score).zip(outcomes) {
                let (p, _) = logistic_and_log(*score);
                *slope = [p - f64::from(u8::from(*success)), p * (1.0 - p)];
            }
            let sample = subsample(rows, options.row_share, &mut random);
            let used = subsample(columns.len(), options.column_share, &mut random);
            let grower = Grower { binned: &binned, slopes: &slopes, constraints, used: &used, options };
            let tree = grower.grow(sample);
            for (row, score) in score.iter_mut().enumerate() {
                *score += value(&tree, |column| columns[column][row]);
            }
            trees.push(tree);
        }
        Ok(Self { start, trees, columns: columns.len() })
    }

    /// A model of this many columns without trees.
    pub(crate) fn empty(columns: usize) -> Self {
        Self { start: 0.0, trees: Vec::new(), columns }
    }

    /// The model as text: the log-odds before the first tree, then one line for each tree. A tree lists its nodes from the root,
    /// `column<threshold` or `=value`, each followed by its left and its right part.
    pub fn lines(&self) -> Vec<String> {
        let tree = |tree: &Vec<Node>| {
            let (mut line, mut open) = ("tree".to_owned(), vec![0_u32]);
            while let Some(node) = open.pop() {
                line += &match tree[node as usize] {
                    Node::Leaf(value) => format!(" ={value}"),
                    Node::Split { column, threshold, left, right } => {
                        open.extend([right, left]);
                        format!(" {column}<{threshold}")
                    }
                };
            }
            line
        };
        std::iter::once(format!("start {}", self.start)).chain(self.trees.iter().map(tree)).collect()
    }

    /// Reads a line of [`Self::lines`]. `None` if it is not valid.
    pub(crate) fn read(&mut self, kind: &str, words: &[&str]) -> Option<()> {
        if kind == "start" {
            [self.start] = numbers(words)?;
            return Some(());
        }
        let mut nodes: Vec<Node> = Vec::with_capacity(words.len());
        // The splits whose right part has not begun.
        let mut open: Vec<usize> = Vec::new();
        for (at, word) in words.iter().enumerate() {
            match word.strip_prefix('=') {
                Some(value) => {
                    let [value] = numbers(&[value])?;
                    nodes.push(Node::Leaf(value));
                    let next = u32::try_from(at + 1).ok()?;
                    if let Some(parent) = open.pop() {
                        let Node::Split { right, .. } = &mut nodes[parent] else { return None };
                        *right = next;
                    } else if at + 1 < words.len() {
                        return None;
                    }
                }
                None => {
                    let (column, threshold) = word.split_once('<')?;
                    let column = column.parse().ok().filter(|column: &u32| (*column as usize) < self.columns)?;
                    let [threshold] = numbers(&[threshold])?;
                    open.push(at);
                    let left = u32::try_from(at + 1).ok()?;
                    nodes.push(Node::Split { column, threshold, left, right: u32::MAX });
                }
            }
        }
        (open.is_empty() && matches!(nodes.last()?, Node::Leaf(_))).then(|| self.trees.push(nodes))
    }

    /// Reads a model that [`Self::lines`] wrote. `None` if a line is not valid.
    pub fn parse(lines: &[String], columns: usize) -> Option<Self> {
        let mut model = Self::empty(columns);
        for line in lines {
            let words: Vec<&str> = line.split_whitespace().collect();
            let (kind, words) = words.split_first().filter(|(kind, _)| matches!(**kind, "start" | "tree"))?;
            model.read(kind, words)?;
        }
        (!lines.is_empty()).then_some(model)
    }

    /// Bytes of the trees.
    pub fn bytes(&self) -> usize {
        self.trees.iter().map(|tree| tree.len() * size_of::<Node>()).sum()
    }

    /// The number of columns.
    pub fn width(&self) -> usize {
        self.columns
    }

    /// Log-odds of success of one row. A missing column counts as NaN.
    pub fn log_odds(&self, row: &[f64]) -> f64 {
        let at = |column: usize| row.get(column).copied().unwrap_or(f64::NAN);
        self.trees.iter().fold(self.start, |sum, tree| sum + value(tree, at))
    }
}

fn value(tree: &[Node], at: impl Fn(usize) -> f64) -> f64 {
    let mut node = 0;
    loop {
        match tree[node] {
            Node::Leaf(value) => return value,
            Node::Split { column, threshold, left, right } => {
                node = if at(column as usize) > threshold { right } else { left } as usize;
            }
        }
    }
}

/// A share of `0..n` in increasing order, at least one.
fn subsample(n: usize, share: f64, random: &mut ChaCha8Rng) -> Vec<u32> {
    let wanted = ((share * n as f64).round() as usize).clamp(1, n.max(1));
    let mut chosen = Vec::with_capacity(wanted);
    // Knuth's selection sampling (algorithm S).
    for i in 0..n {
        if uniform(random) * ((n - i) as f64) < (wanted - chosen.len()) as f64 {
            chosen.push(i as u32);
        }
    }
    chosen
}

/// A column in bins. Bin b contains values up to `edges[b]`; the last bin contains all larger ones.
struct Binned {
    edges: Vec<f64>,
    bins: Vec<u8>,
}

impl Binned {
    fn new(column: &[f64]) -> Self {
        let mut sorted: Vec<f64> = column.iter().copied().filter(|x| !x.is_nan()).collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let mut edges: Vec<f64> = Vec::new();
        let (n, mut first) = (sorted.len(), 0);
        let mut bins_left = BINS;
        while first < n && bins_left > 1 {
            // The bin takes its share of the remaining rows, and all rows with the same value as its last one.
            let share = (n - first).div_ceil(bins_left).max(1);
            let last = sorted[(first + share - 1).min(n - 1)];
            let next = first + sorted[first..].partition_point(|x| *x <= last);
            if next < n {
                let middle = 0.5 * (last + sorted[next]);
                // The middle of two neighbouring doubles may round up to the larger one.
                edges.push(if middle < sorted[next] { middle } else { last });
            }
            (first, bins_left) = (next, bins_left - 1);
        }
        let bin = |x: &f64| if x.is_nan() { 0 } else { edges.partition_point(|edge| edge < x) as u8 };
        Self { bins: column.iter().map(bin).collect(), edges }
    }
}

/// Sums over the rows of a leaf in one bin: first and second derivatives, and the number of rows.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    g: f64,
    h: f64,
    n: u32,
}

impl Sums {
    fn plus(self, other: Self) -> Self {
        Self { g: self.g + other.g, h: self.h + other.h, n: self.n + other.n }
    }

    fn minus(self, other: Self) -> Self {
        Self { g: self.g - other.g, h: self.h - other.h, n: self.n - other.n.min(self.n) }
    }
}

/// A leaf that may be split.
struct Open {
    node: usize,
    rows: Vec<u32>,
    sums: Sums,
    histogram: Vec<Sums>,
    bounds: [f64; 2],
    split: Option<Split>,
}

#[derive(Debug, Clone, Copy)]
struct Split {
    gain: f64,
    column: usize,
    bin: usize,
    left: Sums,
}

struct Grower<'a> {
    binned: &'a [Binned],
    slopes: &'a [[f64; 2]],
    constraints: &'a [Monotone],
    used: &'a [u32],
    options: Options,
}

impl Grower<'_> {
    fn grow(&self, rows: Vec<u32>) -> Vec<Node> {
        let histogram = self.histogram(&rows);
        let sums = rows.iter().fold(Sums::default(), |sums, row| sums.plus(self.of(*row)));
        let bounds = [f64::NEG_INFINITY, f64::INFINITY];
        let mut root = Open { node: 0, rows, sums, histogram, bounds, split: None };
        root.split = self.best(&root);
        let mut nodes = vec![Node::Leaf(0.0)];
        let mut open = vec![root];
        let mut closed: Vec<(usize, Sums, [f64; 2])> = Vec::new();
        while open.len() + closed.len() < self.options.leaves {
            // The first of equal gains wins, which makes the result deterministic.
            let best = open.iter().enumerate().filter_map(|(at, leaf)| Some((at, leaf.split?))).fold(
                None,
                |best: Option<(usize, Split)>, (at, split)| match best {
                    Some((_, kept)) if kept.gain >= split.gain => best,
                    _ => Some((at, split)),
                },
            );
            let Some((at, split)) = best else { break };
            let leaf = open.swap_remove(at);
            let [left, right] = self.divide(&leaf, split, nodes.len());
            nodes[leaf.node] = Node::Split {
                column: split.column as u32,
                threshold: self.binned[split.column].edges[split.bin],
                left: left.node as u32,
                right: right.node as u32,
            };
            nodes.extend([Node::Leaf(0.0), Node::Leaf(0.0)]);
            for leaf in [left, right] {
                if leaf.split.is_some() { open.push(leaf) } else { closed.push((leaf.node, leaf.sums, leaf.bounds)) }
            }
        }
        closed.extend(open.into_iter().map(|leaf| (leaf.node, leaf.sums, leaf.bounds)));
        for (node, sums, bounds) in closed {
            nodes[node] = Node::Leaf(self.options.learning_rate * self.value(sums, bounds));
        }
        nodes
    }

    fn of(&self, row: u32) -> Sums {
        let [g, h] = self.slopes[row as usize];
        Sums { g, h, n: 1 }
    }

    fn value(&self, sums: Sums, [low, high]: [f64; 2]) -> f64 {
        (-sums.g / (sums.h + self.options.penalty)).clamp(low, high)
    }

    /// The reduction of the loss by a leaf of this value.
    fn reduction(&self, sums: Sums, value: f64) -> f64 {
        -(sums.g * value + 0.5 * (sums.h + self.options.penalty) * value * value)
    }

    fn histogram(&self, rows: &[u32]) -> Vec<Sums> {
        let mut histogram = vec![Sums::default(); self.used.len() * BINS];
        for (column, sums) in self.used.iter().zip(histogram.chunks_exact_mut(BINS)) {
            let bins = &self.binned[*column as usize].bins;
            for row in rows {
                let sum = &mut sums[usize::from(bins[*row as usize])];
                *sum = sum.plus(self.of(*row));
            }
        }
        histogram
    }

    fn best(&self, leaf: &Open) -> Option<Split> {
        let least = self.options.rows_of_leaf.max(1) as u32;
        if leaf.sums.n < 2 * least {
            return None;
        }
        let here = self.reduction(leaf.sums, self.value(leaf.sums, leaf.bounds));
        let mut best: Option<Split> = None;
        for (column, histogram) in self.used.iter().zip(leaf.histogram.chunks_exact(BINS)) {
            let column = *column as usize;
            let mut left = Sums::default();
            for (bin, sums) in histogram.iter().enumerate().take(self.binned[column].edges.len()) {
                left = left.plus(*sums);
                let right = leaf.sums.minus(left);
                if left.n < least {
                    continue;
                }
                if right.n < least {
                    break;
                }
                let [l, r] = [left, right].map(|sums| self.value(sums, leaf.bounds));
                let allowed = match self.constraints[column] {
                    Monotone::Free => true,
                    Monotone::Increasing => l <= r,
                    Monotone::Decreasing => l >= r,
                };
                let gain = self.reduction(left, l) + self.reduction(right, r) - here;
                if allowed && gain > 1e-9 && best.is_none_or(|best| gain > best.gain) {
                    best = Some(Split { gain, column, bin, left });
                }
            }
        }
        best
    }

    fn divide(&self, leaf: &Open, split: Split, next: usize) -> [Open; 2] {
        let bins = &self.binned[split.column].bins;
        let (left, right): (Vec<u32>, Vec<u32>) =
            leaf.rows.iter().partition(|row| usize::from(bins[**row as usize]) <= split.bin);
        let sums = [split.left, leaf.sums.minus(split.left)];
        let middle = 0.5 * (self.value(sums[0], leaf.bounds) + self.value(sums[1], leaf.bounds));
        let [low, high] = leaf.bounds;
        let bounds = match self.constraints[split.column] {
            Monotone::Free => [leaf.bounds; 2],
            Monotone::Increasing => [[low, middle], [middle, high]],
            Monotone::Decreasing => [[middle, high], [low, middle]],
        };
        // The histogram of the larger part is the difference of the two others.
        let left_is_smaller = left.len() <= right.len();
        let smaller = self.histogram(if left_is_smaller { &left } else { &right });
        let larger: Vec<Sums> = leaf.histogram.iter().zip(&smaller).map(|(all, part)| all.minus(*part)).collect();
        let [of_left, of_right] = if left_is_smaller { [smaller, larger] } else { [larger, smaller] };
        let mut parts = [
            Open { node: next, rows: left, sums: sums[0], histogram: of_left, bounds: bounds[0], split: None },
            Open { node: next + 1, rows: right, sums: sums[1], histogram: of_right, bounds: bounds[1], split: None },
        ];
        for part in &mut parts {
            part.split = self.best(part);
        }
        parts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two columns: success is likely where the first is large; the second is noise.
    fn data(rows: usize) -> (Vec<Vec<f64>>, Vec<bool>) {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let columns: Vec<Vec<f64>> = (0..2).map(|_| (0..rows).map(|_| uniform(&mut random)).collect()).collect();
        let outcomes = columns[0].iter().map(|x| uniform(&mut random) < 0.1 + 0.8 * x).collect();
        (columns, outcomes)
    }

    fn fit(columns: &[Vec<f64>], outcomes: &[bool], constraints: &[Monotone]) -> Boosting {
        let views: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        Boosting::fit(&views, outcomes, constraints, Options::default()).unwrap()
    }

    #[test]
    fn constrained_column_is_monotone() {
        let (columns, outcomes) = data(2000);
        for (constraint, sign) in [(Monotone::Increasing, 1.0), (Monotone::Decreasing, -1.0)] {
            let columns = vec![columns[0].iter().map(|x| sign * x).collect(), columns[1].clone()];
            let model = fit(&columns, &outcomes, &[constraint, Monotone::Free]);
            for second in [0.1, 0.5, 0.9] {
                let curve: Vec<f64> =
                    (0..200).map(|i| model.log_odds(&[sign * f64::from(i) / 200.0, second])).collect();
                assert!(curve.windows(2).all(|pair| pair[0] <= pair[1] + 1e-12), "{constraint:?}");
                assert!(curve[199] - curve[0] > 2.0, "{constraint:?}: {} {}", curve[0], curve[199]);
            }
        }
    }

    #[test]
    fn same_seed_same_bits() {
        let (columns, outcomes) = data(500);
        let model = || fit(&columns, &outcomes, &[Monotone::Free; 2]);
        assert_eq!(model(), model());
    }

    #[test]
    fn missing_values_and_constants_are_accepted() {
        let (mut columns, outcomes) = data(400);
        columns.push(vec![f64::NAN; 400]);
        columns.push(vec![3.0; 400]);
        columns[1][7] = f64::NAN;
        let model = fit(&columns, &outcomes, &[Monotone::Free; 4]);
        assert!(model.log_odds(&[0.5, f64::NAN, 1.0, 3.0]).is_finite());
        assert_eq!(model.width(), 4);
    }

    #[test]
    fn bad_data_are_rejected() {
        let views: [&[f64]; 1] = [&[1.0, 2.0]];
        let fit = |outcomes: &[bool], constraints: &[Monotone]| {
            Boosting::fit(&views, outcomes, constraints, Options::default()).map(drop)
        };
        assert_eq!(fit(&[true, true], &[Monotone::Free]), Err(BoostingError::OneClass { rows: 2 }));
        assert_eq!(fit(&[true], &[Monotone::Free]), Err(BoostingError::Length { column: 0, found: 2, expected: 1 }));
        assert_eq!(fit(&[true, false], &[]), Err(BoostingError::Constraints { found: 0, expected: 1 }));
    }
}
