//! The detector: a score for each evaluation of an episode, and the threshold above which it warns.
//!
//! With failures to learn from, the score is the log-odds of a later failure by boosted trees. Without them it is the
//! Mahalanobis distance to successes at the same moment: of the same phase, and as long after its start. The band subtracts
//! the median of successes at that moment and divides by the distance to their 90 % quantile.

use std::borrow::Borrow;

use robogate_stats::boosting::Boosting;
use serde::{Deserialize, Serialize};

use super::features::{Features, LAST_PHASE, Moment, Window};

/// Added to the distance at a moment at which no success was in this phase, and once more for each second since the last other one.
const UNKNOWN_MOMENT: f64 = 5.0;

/// The moments of an episode, in bins of equal length within each phase.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Moments {
    /// The length of a bin, in seconds.
    pub bin_s: f64,
    /// For each phase, the cell of each bin from the start of the phase. Absent where too few successes were.
    pub cells: Vec<Vec<Option<u16>>>,
}

impl Moments {
    /// The cell of a moment.
    pub fn cell(&self, moment: Moment) -> Option<usize> {
        let bins = self.cells.get(moment.phase.min(LAST_PHASE))?;
        let bin = (f64::from(moment.in_phase_s.max(0.0)) / self.bin_s) as usize;
        bins.get(bin).copied().flatten().map(usize::from)
    }
}

/// The distance to successes at the same moment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Distance {
    /// The used columns.
    pub columns: Vec<usize>,
    /// Mean and standard deviation of each used column over all successes.
    pub scale: Vec<[f64; 2]>,
    /// The moments.
    pub moments: Moments,
    /// The mean of the scaled columns in each cell.
    pub means: Vec<Vec<f64>>,
    /// For each phase, the Cholesky factor of the covariance of the scaled columns around the means: the rows of the lower triangle.
    pub factors: Vec<Vec<f64>>,
    /// Median of the distance of successes in each cell, and the distance from there to their 90 % quantile.
    pub band: Vec<[f64; 2]>,
}

/// What gives the score.
#[derive(Debug, Clone, PartialEq)]
pub enum Model {
    /// Boosted trees, which learned from successes and failures.
    Trees(Boosting),
    /// The distance to successes.
    Distance(Distance),
}

/// A detector.
#[derive(Debug, Clone, PartialEq)]
pub struct Detector {
    /// The columns.
    pub features: Features,
    /// What gives the score.
    pub model: Model,
}

/// Room for the distance of one row, and its last known cell.
#[derive(Debug, Clone)]
pub(crate) struct Scratch {
    cell: usize,
    /// The time of that cell, in seconds since the start.
    known_s: f32,
    z: Vec<f64>,
}

impl Scratch {
    pub(crate) fn new(model: &Model) -> Self {
        Self::of(match model {
            Model::Trees(_) => 0,
            Model::Distance(distance) => distance.columns.len(),
        })
    }

    /// Room for this many columns.
    pub(crate) fn of(columns: usize) -> Self {
        Self { cell: 0, known_s: 0.0, z: vec![0.0; columns] }
    }
}

impl Model {
    /// The score of one evaluation: larger values are nearer to a failure.
    pub(crate) fn score(&self, moment: Moment, columns: &[f64], scratch: &mut Scratch) -> f64 {
        match self {
            Self::Trees(trees) => -trees.log_odds(columns),
            Self::Distance(distance) => distance.score(moment, columns, scratch),
        }
    }
}

impl Distance {
    /// The distance without the band.
    pub(crate) fn raw(&self, moment: Moment, columns: &[f64], scratch: &mut Scratch) -> f64 {
        let known = self.moments.cell(moment);
        // Times run backwards where the next episode begins.
        if known.is_some() || moment.time_s < scratch.known_s {
            (scratch.cell, scratch.known_s) = (known.unwrap_or(0), moment.time_s);
        }
        let unknown_s = f64::from(moment.time_s - scratch.known_s);
        let (Some(means), Some(factor)) =
            (self.means.get(scratch.cell), self.factors.get(moment.phase.min(LAST_PHASE)))
        else {
            return 0.0;
        };
        let mut squares = 0.0;
        let mut at = 0;
        // Forward substitution: L z = x - mean.
        for (i, (column, [centre, scale])) in self.columns.iter().zip(&self.scale).enumerate() {
            let x = columns.get(*column).map_or(0.0, |x| (x - centre) / scale - means[i]);
            let mut rest = if x.is_finite() { x } else { 0.0 };
            for j in 0..i {
                rest -= factor.get(at + j).copied().unwrap_or(0.0) * scratch.z[j];
            }
            let z = rest / factor.get(at + i).copied().unwrap_or(1.0);
            scratch.z[i] = z;
            squares += z * z;
            at += i + 1;
        }
        squares.sqrt() + if known.is_some() { 0.0 } else { UNKNOWN_MOMENT * (1.0 + unknown_s) }
    }

    fn score(&self, moment: Moment, columns: &[f64], scratch: &mut Scratch) -> f64 {
        let distance = self.raw(moment, columns, scratch);
        let [centre, scale] = self.band.get(scratch.cell).copied().unwrap_or([0.0, 1.0]);
        (distance - centre) / scale
    }

    /// Rejects tables whose lengths do not fit.
    pub(crate) fn check(&self, columns: usize) -> Result<(), String> {
        let (d, cells) = (self.columns.len(), self.means.len());
        let fits = self.columns.iter().all(|column| *column < columns)
            && self.scale.len() == d
            && self.scale.iter().all(|[_, scale]| *scale > 0.0)
            && self.means.iter().all(|mean| mean.len() == d)
            && self.factors.iter().all(|factor| factor.len() == d * (d + 1) / 2)
            && self.band.len() == cells
            && self.band.iter().all(|[_, scale]| *scale > 0.0)
            && self.moments.bin_s > 0.0
            && self.moments.cells.iter().flatten().flatten().all(|cell| usize::from(*cell) < cells);
        if fits { Ok(()) } else { Err("the tables of `distance` do not fit together".to_owned()) }
    }
}

/// A detector at work in one robot. After [`Self::new`] it allocates nothing. `D` is the detector or a pointer to it.
#[derive(Debug, Clone)]
pub struct Warner<D> {
    detector: D,
    threshold: f64,
    window: Window,
    scratch: Scratch,
    highest: f64,
    warned_s: Option<f32>,
}

impl<D: Borrow<Detector>> Warner<D> {
    /// A warner with this threshold.
    pub fn new(detector: D, threshold: f64) -> Self {
        let of = detector.borrow();
        let (window, scratch) = (Window::new(&of.features), Scratch::new(&of.model));
        let mut warner = Self { detector, threshold, window, scratch, highest: f64::NEG_INFINITY, warned_s: None };
        warner.start(&[]);
        warner
    }

    /// Starts an episode. `parameters` are the values of [`Features::parameters`], NaN for an unknown one.
    pub fn start(&mut self, parameters: &[f64]) {
        self.window.start(parameters);
        (self.scratch.cell, self.scratch.known_s) = (0, 0.0);
        (self.highest, self.warned_s) = (f64::NEG_INFINITY, None);
    }

    /// Takes the row of a control period ([`robogate_core::Signals::write`]) before its action is executed. Returns the score if the
    /// detector was evaluated.
    pub fn observe(&mut self, time_s: f32, row: &[f32]) -> Option<f64> {
        let (moment, columns) = self.window.push(time_s, row)?;
        let score = self.detector.borrow().model.score(moment, columns, &mut self.scratch);
        self.highest = self.highest.max(score);
        if score > self.threshold && self.warned_s.is_none() {
            self.warned_s = Some(time_s);
        }
        Some(score)
    }

    /// When this episode was warned, in seconds since its start.
    pub fn warned_s(&self) -> Option<f32> {
        self.warned_s
    }

    /// The highest score of this episode so far.
    pub fn highest(&self) -> f64 {
        self.highest
    }

    /// Bytes of detector and history together.
    pub fn bytes(&self) -> usize {
        let model = match &self.detector.borrow().model {
            Model::Trees(trees) => trees.bytes(),
            Model::Distance(of) => {
                let numbers = of.means.iter().chain(&of.factors).map(Vec::len).sum::<usize>();
                8 * (numbers + 3 * of.columns.len() + 2 * of.band.len())
                    + 4 * of.moments.cells.iter().map(Vec::len).sum::<usize>()
            }
        };
        model + self.window.bytes() + 8 * self.scratch.z.len()
    }
}
