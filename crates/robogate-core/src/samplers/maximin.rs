//! Maximin improvement of a Latin hypercube by exchanging coordinates, which keeps every stratum.

use super::latin_hypercube::stratum;
use crate::Stream;

/// Initial relative increase of the target distance over the present smallest distance.
const FIRST_STEP: f64 = 0.1;
/// Smallest relative increase that is still attempted.
const LAST_STEP: f64 = 0.002;
/// Exchanges tried for a crowded point before the next point.
const TRIES: usize = 40;
/// Smallest number of points to try before a target distance may be given up. With few crowded points this is several
/// rounds.
const PATIENCE: usize = 50;
/// Limit on the root mean square of a column's correlations with the others after an exchange, in units of 1/sqrt(n),
/// the value for random columns. The limit is at least `GRAIN` in units of 1/n, the effect of a single exchange.
const CORRELATION: f64 = 0.1;
/// See [`CORRELATION`].
const GRAIN: f64 = 2.0;
/// Inverse variance of a uniform number in [0, 1).
const VARIANCE_INVERSE: f64 = 12.0;
/// Half the range from which the partner of a local exchange is chosen, in units of the target distance.
const LOCAL_RANGE: f64 = 2.0;

/// Increases the smallest Euclidean distance between any two of the n points in `at`. `at` has `d` columns, stored row
/// by row; each column has one number in each of n equal parts of [0, 1).
///
/// The search sets a target distance a little above the present smallest one. Each point with a neighbour nearer than
/// the target, closest pair first, exchanges one coordinate with another point. The exchange is kept only if neither
/// point then has a neighbour nearer than the target. Each exchange therefore removes pairs below the target, adds
/// none, and never lowers the smallest distance. Half of the partners come from nearby along the axis, which suits a
/// dense design, and half from anywhere. An exchange that would bring correlation back into the columns is rejected.
/// When the search stalls, the next target is lower, until the increase is below 0.2 % or `budget` is spent. The result
/// is a local optimum.
///
/// The budget counts visits of a cell of the neighbour index or of a point in it. A visit has a fixed cost, whereas one
/// exchange in twenty dimensions needs a thousand of them. The function reads no clock: a slow or busy machine gives
/// the same points.
pub(super) fn spread(at: &mut [f64], d: usize, budget: u64, stream: &mut Stream) {
    let n = at.len() / d.max(1);
    // With one column, any order gives the same set. A single point has no neighbour.
    if d < 2 || n < 2 {
        return;
    }
    let mut cloud = Cloud::new(at, d, budget);
    let mut step = FIRST_STEP;
    // Half the side of the cube that each point would have for itself. This is easy to reach.
    let mut aim = 0.5 * (n as f64).powf(-1.0 / d as f64);
    while step > LAST_STEP && cloud.looks_left > 0 {
        let reached = cloud.relieve(aim, stream);
        if reached < aim {
            step *= 0.5;
        }
        aim = reached * (1.0 + step);
    }
}

/// The points with two indexes that make exchanges fast to find and to check.
struct Cloud<'a> {
    n: usize,
    d: usize,
    at: &'a mut [f64],
    /// The point in each stratum, column by column.
    holder: Vec<u32>,
    /// Correlation of each pair of columns, row by row.
    correlations: Vec<f64>,
    allowed_correlation: f64,
    grid: Grid,
    looks_left: u64,
}

impl<'a> Cloud<'a> {
    fn new(at: &'a mut [f64], d: usize, budget: u64) -> Self {
        let n = at.len() / d;
        let mut holder = vec![0; n * d];
        for (p, point) in at.chunks_exact(d).enumerate() {
            for (j, u) in point.iter().enumerate() {
                holder[j * n + stratum(*u, n)] = p as u32;
            }
        }
        let mut correlations = vec![0.0; d * d];
        for point in at.chunks_exact(d) {
            for j in 0..d {
                for k in 0..d {
                    correlations[j * d + k] += (point[j] - 0.5) * (point[k] - 0.5) * VARIANCE_INVERSE / n as f64;
                }
            }
        }
        let allowed_correlation = (CORRELATION / (n as f64).sqrt()).max(GRAIN / n as f64);
        Self { n, d, at, holder, correlations, allowed_correlation, grid: Grid::default(), looks_left: budget }
    }

    fn point(&self, p: u32) -> &[f64] {
        &self.at[p as usize * self.d..][..self.d]
    }

    /// Separates as many points as possible from neighbours nearer than `aim`. Returns the smallest distance
    /// afterwards, or `aim` if no distance is below it.
    fn relieve(&mut self, aim: f64, stream: &mut Stream) -> f64 {
        self.grid = Grid::over(self.at, self.d, aim);
        let everyone = (0..self.n as u32).collect();
        let mut crowded = self.crowded(everyone, aim);
        let mut turns = 0;
        while !crowded.is_empty() && self.looks_left > 0 {
            let before = crowded.len();
            turns += before;
            let unhelped = crowded.into_iter().map(|(_, p)| p).filter(|p| !self.help(*p, aim, stream)).collect();
            crowded = self.crowded(unhelped, aim);
            // A round that separates fewer than 5 % of the points has stalled.
            if crowded.len() * 20 > before * 19 && turns >= PATIENCE {
                break;
            }
        }
        crowded.first().map_or(aim, |(distance, _)| *distance)
    }

    /// The members of `points` that have a neighbour nearer than `aim`, with its distance, closest first.
    fn crowded(&mut self, points: Vec<u32>, aim: f64) -> Vec<(f64, u32)> {
        let mut crowded: Vec<_> = points
            .into_iter()
            .filter_map(|p| {
                if self.looks_left == 0 {
                    return None;
                }
                let mut search = Search::new(&self.grid, self.at, self.point(p), [p, p], aim, Wanted::Nearest);
                let found = search.run();
                self.looks_left = self.looks_left.saturating_sub(search.looks);
                found.map(|distance| (distance, p))
            })
            .collect();
        crowded.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        crowded
    }

    /// Tries exchanges until `p` has no neighbour nearer than `aim`. Returns whether that succeeded.
    fn help(&mut self, p: u32, aim: f64, stream: &mut Stream) -> bool {
        let range = ((LOCAL_RANGE * aim * self.n as f64) as usize).clamp(1, self.n - 1);
        // An earlier exchange may have removed the neighbour.
        let here = self.point(p).to_vec();
        if !self.any_nearer(&here, [p, p], aim) {
            return true;
        }
        let (mut new_p, mut new_q, mut correlations) = (here.clone(), here.clone(), vec![0.0; self.d]);
        for attempt in 0..TRIES {
            if self.looks_left == 0 {
                break;
            }
            let j = stream.below(self.d);
            let from = stratum(here[j], self.n);
            let to = if attempt % 2 == 0 {
                // Clamped at both ends of the axis.
                let low = from.saturating_sub(range);
                low + stream.below((from + range).min(self.n - 1) - low + 1)
            } else {
                stream.below(self.n)
            };
            let q = self.holder[j * self.n + to];
            new_p.copy_from_slice(&here);
            new_q.copy_from_slice(self.point(q));
            // An exchange does not change the distance between the two points.
            if q == p
                || squared_distance(&new_p, &new_q) < aim * aim
                || !self.correlations_allow(j, &new_p, &new_q, &mut correlations)
            {
                continue;
            }
            std::mem::swap(&mut new_p[j], &mut new_q[j]);
            if !self.any_nearer(&new_p, [p, q], aim) && !self.any_nearer(&new_q, [p, q], aim) {
                self.put(p, &new_p);
                self.put(q, &new_q);
                self.holder[j * self.n + from] = q;
                self.holder[j * self.n + to] = p;
                for (k, c) in correlations.into_iter().enumerate() {
                    self.correlations[j * self.d + k] = c;
                    self.correlations[k * self.d + j] = c;
                }
                return true;
            }
        }
        false
    }

    /// Whether the correlations of column `j` stay within the limit after the points at `p` and `q` exchange that
    /// coordinate. The new correlations are left in `after`.
    fn correlations_allow(&self, j: usize, p: &[f64], q: &[f64], after: &mut [f64]) -> bool {
        let before = &self.correlations[j * self.d..][..self.d];
        let moved = (q[j] - p[j]) * VARIANCE_INVERSE / self.n as f64;
        let (mut squares_before, mut squares_after) = (0.0, 0.0);
        for k in 0..self.d {
            // A column's correlation with itself does not change.
            after[k] = if k == j { before[k] } else { before[k] + moved * (p[k] - q[k]) };
            squares_before += before[k] * before[k];
            squares_after += after[k] * after[k];
        }
        let with_itself = before[j] * before[j];
        let allowed = with_itself + (self.d - 1) as f64 * self.allowed_correlation * self.allowed_correlation;
        squares_after <= squares_before.max(allowed)
    }

    /// Whether a point outside `skip` is nearer to `x` than `aim`.
    fn any_nearer(&mut self, x: &[f64], skip: [u32; 2], aim: f64) -> bool {
        let mut search = Search::new(&self.grid, self.at, x, skip, aim, Wanted::Any);
        let found = search.run().is_some();
        self.looks_left = self.looks_left.saturating_sub(search.looks);
        found
    }

    fn put(&mut self, p: u32, x: &[f64]) {
        self.grid.remove(self.grid.cell(self.point(p)), p);
        self.at[p as usize * self.d..][..self.d].copy_from_slice(x);
        self.grid.insert(self.grid.cell(x), p);
    }
}

/// The neighbour index: equal cells over the first axes, at least as wide as the query distance. A point nearer than
/// that is in the same cell or in an adjacent one. There is about one point per cell, and a single cell if the distance
/// exceeds half the cube.
#[derive(Default)]
struct Grid {
    axes: usize,
    cells_per_axis: usize,
    /// The first point of each cell's chain, and the next point after each point.
    first: Vec<u32>,
    next: Vec<u32>,
}

/// Marks the end of a chain.
const END: u32 = u32::MAX;

impl Grid {
    fn over(at: &[f64], d: usize, distance: f64) -> Self {
        let n = at.len() / d;
        let room = 2.0 * n as f64;
        let by_room = (room.powf(1.0 / d as f64) as usize).max(2);
        let cells_per_axis = ((1.0 / distance) as usize).clamp(1, by_room);
        let axes = if cells_per_axis == 1 { 0 } else { (room.ln() / (cells_per_axis as f64).ln()) as usize }.min(d);
        let cells = cells_per_axis.pow(axes as u32);
        let mut grid = Self { axes, cells_per_axis, first: vec![END; cells], next: vec![END; n] };
        for (p, point) in at.chunks_exact(d).enumerate() {
            grid.insert(grid.cell(point), p as u32);
        }
        grid
    }

    fn cell(&self, x: &[f64]) -> usize {
        x[..self.axes].iter().fold(0, |cell, u| cell * self.cells_per_axis + stratum(*u, self.cells_per_axis))
    }

    fn insert(&mut self, cell: usize, p: u32) {
        self.next[p as usize] = std::mem::replace(&mut self.first[cell], p);
    }

    fn remove(&mut self, cell: usize, p: u32) {
        let after = self.next[p as usize];
        let mut here = self.first[cell];
        if here == p {
            self.first[cell] = after;
            return;
        }
        while self.next[here as usize] != p {
            here = self.next[here as usize];
        }
        self.next[here as usize] = after;
    }
}

/// What a search looks for within its distance.
#[derive(PartialEq)]
enum Wanted {
    Nearest,
    Any,
}

/// A query to the grid.
struct Search<'a> {
    grid: &'a Grid,
    at: &'a [f64],
    x: &'a [f64],
    skip: [u32; 2],
    wanted: Wanted,
    /// Squared search radius. It shrinks to the distance of the nearest point found.
    within: f64,
    found: bool,
    looks: u64,
}

impl<'a> Search<'a> {
    fn new(grid: &'a Grid, at: &'a [f64], x: &'a [f64], skip: [u32; 2], distance: f64, wanted: Wanted) -> Self {
        Self { grid, at, x, skip, wanted, within: distance * distance, found: false, looks: 0 }
    }

    /// Runs the search and returns the distance of the point found.
    fn run(&mut self) -> Option<f64> {
        self.descend(0, 0, 0.0);
        self.found.then(|| self.within.sqrt())
    }

    fn done(&self) -> bool {
        self.found && self.wanted == Wanted::Any
    }

    /// Visits the cells that agree with `cell` on the axes before `axis`. `gap` is the squared distance to them along
    /// those axes.
    fn descend(&mut self, axis: usize, cell: usize, gap: f64) {
        if axis == self.grid.axes {
            return self.look_into(cell);
        }
        let cells = self.grid.cells_per_axis;
        let own = stratum(self.x[axis], cells);
        let below = self.x[axis] - own as f64 / cells as f64;
        let above = (own + 1) as f64 / cells as f64 - self.x[axis];
        let cell = cell * cells + own;
        self.descend(axis + 1, cell, gap);
        if own > 0 && !self.done() && gap + below * below < self.within {
            self.descend(axis + 1, cell - 1, gap + below * below);
        }
        if own + 1 < cells && !self.done() && gap + above * above < self.within {
            self.descend(axis + 1, cell + 1, gap + above * above);
        }
    }

    fn look_into(&mut self, cell: usize) {
        self.looks += 1;
        let mut p = self.grid.first[cell];
        while p != END && !self.done() {
            self.looks += 1;
            if !self.skip.contains(&p) {
                let squared = squared_distance(self.x, &self.at[p as usize * self.x.len()..][..self.x.len()]);
                if squared < self.within {
                    self.within = squared;
                    self.found = true;
                }
            }
            p = self.grid.next[p as usize];
        }
    }
}

fn squared_distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Seed;

    fn cloud(n: usize, d: usize) -> Vec<f64> {
        let mut stream = Seed::campaign(n as u64).stream("cloud");
        (0..n * d).map(|_| stream.uniform()).collect()
    }

    #[test]
    fn index_matches_brute_force_search() {
        for (n, d, distance) in [(400, 5, 0.2), (400, 2, 0.03), (50, 3, 0.6), (300, 12, 0.45), (400, 1, 0.001)] {
            let at = cloud(n, d);
            let grid = Grid::over(&at, d, distance);
            for (p, x) in at.chunks_exact(d).enumerate() {
                let others = at.chunks_exact(d).enumerate().filter(|(q, _)| *q != p);
                let nearest = others.map(|(_, y)| squared_distance(x, y).sqrt()).fold(f64::INFINITY, f64::min);
                let found = Search::new(&grid, &at, x, [p as u32; 2], distance, Wanted::Nearest).run();
                assert_eq!(found, (nearest < distance).then_some(nearest), "n {n} d {d} p {p}");
                let any = Search::new(&grid, &at, x, [p as u32; 2], distance, Wanted::Any).run();
                assert_eq!(any.is_some(), nearest < distance, "n {n} d {d} p {p}");
            }
        }
    }

    #[test]
    fn zero_budget_moves_nothing() {
        let n = 500;
        let mut at: Vec<f64> =
            (0..n).flat_map(|i| [i, i * 7 % n, i * 11 % n].map(|s| (s as f64 + 0.5) / n as f64)).collect();
        let before = at.clone();
        spread(&mut at, 3, 0, &mut Seed::campaign(1).stream("none"));
        assert_eq!(at, before);
    }
}
