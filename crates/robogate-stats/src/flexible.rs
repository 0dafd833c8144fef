//! A calibrated model of the chance of success from columns, without an assumption about the shape of the effects.
//!
//! Two learners are fitted: ridge logistic regression on splines and products ([`crate::spline_logistic`]), and gradient
//! boosting ([`crate::boosting`]). Cross-validation chooses the weights of their log-odds by the log loss of rows that were not
//! fitted, and calibrates the mean with a line (Platt 1999) or a monotone curve (Zadrozny and Elkan 2002). The caller gives the folds,
//! so that rows that depend on each other can be in one fold.
//!
//! Sources: Wolpert (1992), Neural Networks 5, for the choice of a mean by held-out rows; Platt (1999), Advances in Large Margin
//! Classifiers, and Zadrozny and Elkan (2002), KDD, for the calibration.

use std::num::NonZeroUsize;

use crate::boosting::{Boosting, BoostingError, Monotone, Options};
use crate::logistic::{Data, RegressionError, logistic_and_log};
use crate::parallel::in_parallel;
use crate::ridge;
use crate::spline_logistic::{SplineForm, SplineLogistic};
use crate::threshold::{Direction, isotonic};

/// The shares of the boosting among which cross-validation chooses.
const SHARES: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];
/// Prior variance of the calibration line, which hardly shrinks it.
const WEAK: f64 = 100.0;
/// Most lines of a model as text.
const MOST_LINES: usize = 10_000;

/// A learner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Learner {
    /// The mean of both learners that predicts best in cross-validation.
    #[default]
    Chosen,
    /// Monotone gradient boosting alone.
    Boosting,
    /// Ridge logistic regression on splines and products alone.
    Splines,
}

/// The rows of a fit.
#[derive(Debug, Clone, Copy)]
pub struct Training<'a> {
    /// The columns.
    pub columns: &'a [Vec<f64>],
    /// Whether each row succeeded.
    pub outcomes: &'a [bool],
    /// The direction in which each column may change the chance of success.
    pub constraints: &'a [Monotone],
    /// Columns whose products are terms of the spline model.
    pub interacting: &'a [usize],
}

/// How predictions are calibrated on rows that were not fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Calibrated {
    /// By a line.
    Line,
    /// By a line or a monotone curve, whichever predicts better in cross-validation.
    LineOrCurve,
}

/// What cross-validation chose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Choice {
    /// Share of the boosting in the mean of the log-odds; the rest is the spline model.
    pub boosting_share: f64,
    /// Mean log loss of the predictions of rows that were not fitted, after calibration.
    pub log_loss: f64,
    /// Their Brier score.
    pub brier: f64,
    /// Intercept and slope of the calibration line: log-odds = intercept + slope x mean log-odds.
    pub calibration: [f64; 2],
    /// Whether a monotone curve calibrates instead of the line.
    pub curve: bool,
}

/// The reason why a model cannot be fitted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FlexibleError {
    /// Gradient boosting cannot be fitted.
    #[error(transparent)]
    Boosting(#[from] BoostingError),
    /// The spline model cannot be fitted.
    #[error(transparent)]
    Splines(#[from] RegressionError),
}

/// A fitted model.
#[derive(Debug, Clone)]
pub struct Flexible {
    splines: Option<SplineLogistic>,
    scorer: Scorer,
    choice: Choice,
    held_out: Vec<f64>,
}

/// The part of a model that predicts. It can be written as text.
#[derive(Debug, Clone, PartialEq)]
pub struct Scorer {
    boosting: Option<Boosting>,
    splines: Option<SplineForm>,
    boosting_share: f64,
    calibration: Calibration,
}

/// From the mean log-odds to calibrated ones.
#[derive(Debug, Clone, PartialEq)]
enum Calibration {
    /// Intercept and slope.
    Line([f64; 2]),
    /// Points in increasing order, with lines between them and the end values outside.
    Curve(Vec<[f64; 2]>),
}

/// Both learners, fitted to the same rows.
struct Pair {
    boosting: Option<Boosting>,
    splines: Option<SplineLogistic>,
}

impl Flexible {
    /// Fits the model. `folds` has the number of the fold of each row, from 0; each fold and its complement have both outcomes.
    /// The model does not depend on the number of threads.
    ///
    /// # Errors
    /// As [`Boosting::fit`] and [`SplineLogistic::fit`], for all rows and for all without a fold.
    pub fn fit(
        training: Training<'_>,
        folds: &[usize],
        (learner, how): (Learner, Calibrated),
        threads: NonZeroUsize,
    ) -> Result<Self, FlexibleError> {
        let Training { columns, outcomes, .. } = training;
        let count = folds.iter().max().map_or(0, |last| last + 1);
        // One fit without each fold, and the last one to all rows.
        let mut fits = in_parallel(threads, count + 1, |left_out| {
            let train: Vec<usize> = (0..outcomes.len()).filter(|row| folds.get(*row) != Some(&left_out)).collect();
            Pair::fit(training, &train, learner)
        })
        .into_iter()
        .collect::<Result<Vec<Pair>, FlexibleError>>()?;
        let row = |at: usize| columns.iter().map(|column| column[at]).collect::<Vec<f64>>();
        let held_out: Vec<[f64; 2]> = folds.iter().enumerate().map(|(at, of)| fits[*of].log_odds(&row(at))).collect();
        let mut best: Option<(Choice, Vec<f64>)> = None;
        for share in learner.shares() {
            let mixed: Vec<f64> = held_out.iter().map(|both| mix(*both, *share)).collect();
            let choice = calibrated(&mixed, outcomes, *share)?;
            if best.as_ref().is_none_or(|(best, _)| choice.log_loss < best.log_loss) {
                best = Some((choice, mixed));
            }
        }
        let (Some(Pair { boosting, splines }), Some((mut choice, mut held_out))) = (fits.pop(), best) else {
            return Err(RegressionError::NoRows.into());
        };
        let boosting_share = choice.boosting_share;
        let curve = (how == Calibrated::LineOrCurve && curve_is_better(&held_out, outcomes, folds))
            .then(|| Calibration::curve(&held_out, outcomes));
        choice.curve = curve.is_some();
        let calibration = curve.unwrap_or(Calibration::Line(choice.calibration));
        held_out.iter_mut().for_each(|score| *score = calibration.at(*score));
        [choice.log_loss, choice.brier] = scores(held_out.iter().copied(), outcomes);
        let form = splines.as_ref().map(|splines| splines.form().clone());
        let scorer = Scorer { boosting, splines: form, boosting_share, calibration };
        Ok(Self { splines, scorer, choice, held_out })
    }

    /// What cross-validation chose.
    pub fn choice(&self) -> Choice {
        self.choice
    }

    /// The spline model, unless it was not fitted. Its log-odds come before the calibration.
    pub fn splines(&self) -> Option<&SplineLogistic> {
        self.splines.as_ref()
    }

    /// Calibrated log-odds of success of each fitted row, by the model without the row's fold.
    pub fn held_out(&self) -> &[f64] {
        &self.held_out
    }

    /// The part that predicts.
    pub fn scorer(&self) -> &Scorer {
        &self.scorer
    }

    /// Calibrated log-odds of success of a row.
    pub fn log_odds(&self, row: &[f64]) -> f64 {
        self.scorer.log_odds(row)
    }
}

impl Scorer {
    /// Calibrated log-odds of success of a row. A missing column counts as NaN. Nothing is allocated.
    pub fn log_odds(&self, row: &[f64]) -> f64 {
        let both = [
            self.boosting.as_ref().map_or(0.0, |model| model.log_odds(row)),
            self.splines.as_ref().map_or(0.0, |model| model.log_odds(row)),
        ];
        self.calibration.at(mix(both, self.boosting_share))
    }

    /// The model as text. [`Self::parse`] reads it without a loss.
    pub fn lines(&self) -> Vec<String> {
        let points = match &self.calibration {
            Calibration::Line(line) => vec![*line],
            Calibration::Curve(points) => points.clone(),
        };
        let kind = if matches!(self.calibration, Calibration::Line(_)) { "line" } else { "curve" };
        let points: Vec<String> = points.iter().map(|[x, y]| format!("{x} {y}")).collect();
        let mut lines = vec![format!("calibration {} {kind} {}", self.boosting_share, points.join(" "))];
        // A learner without a share does not contribute.
        lines.extend(self.splines.iter().filter(|_| self.boosting_share < 1.0).flat_map(SplineForm::lines));
        lines.extend(self.boosting.iter().filter(|_| self.boosting_share > 0.0).flat_map(Boosting::lines));
        lines
    }

    /// Reads a model of rows with `columns` columns.
    ///
    /// # Errors
    /// The first line that cannot be read, with its number.
    pub fn parse(lines: &[String], columns: usize) -> Result<Self, String> {
        if lines.len() > MOST_LINES {
            return Err(format!("{} lines. Expected at most {MOST_LINES}", lines.len()));
        }
        let mut model =
            Self { boosting: None, splines: None, boosting_share: 0.0, calibration: Calibration::Curve(Vec::new()) };
        for (at, line) in lines.iter().enumerate() {
            let mut words = line.split(' ');
            let kind = words.next().unwrap_or_default();
            let rest: Vec<&str> = words.collect();
            let read = match kind {
                "calibration" => Calibration::read(&rest)
                    .map(|(share, calibration)| (model.calibration, model.boosting_share) = (calibration, share)),
                "start" | "tree" => model.boosting.get_or_insert_with(|| Boosting::empty(columns)).read(kind, &rest),
                _ => model.splines.get_or_insert_with(SplineForm::default).read(kind, &rest, columns),
            };
            read.ok_or_else(|| format!("line {}, starting with `{kind:.20}`, is not valid", at + 1))?;
        }
        let complete = (0.0..=1.0).contains(&model.boosting_share)
            && (model.boosting_share == 0.0 || model.boosting.is_some())
            && (model.boosting_share == 1.0 || model.splines.is_some());
        if complete && model.calibration != Calibration::Curve(Vec::new()) {
            Ok(model)
        } else {
            Err("it lacks a calibration, or a learner that has a share".to_owned())
        }
    }
}

/// This many finite numbers. `None` for other text.
pub(crate) fn numbers<const N: usize>(words: &[&str]) -> Option<[f64; N]> {
    let read: Option<Vec<f64>> = words.iter().map(|word| word.parse().ok().filter(|x: &f64| x.is_finite())).collect();
    read?.try_into().ok()
}

impl Calibration {
    fn at(&self, score: f64) -> f64 {
        match self {
            Self::Line([intercept, slope]) => intercept + slope * score,
            Self::Curve(points) => {
                let next = points.partition_point(|[x, _]| *x <= score);
                match (next.checked_sub(1).and_then(|at| points.get(at)), points.get(next)) {
                    (Some([x0, y0]), Some([x1, y1])) => y0 + (y1 - y0) * (score - x0) / (x1 - x0),
                    (Some([_, y]), None) | (None, Some([_, y])) => *y,
                    (None, None) => score,
                }
            }
        }
    }

    /// The isotonic regression of the outcomes on the scores, with lines between the middles of its steps. Each rate is shrunk towards
    /// the overall one by the weight of one row.
    fn curve(scores: &[f64], outcomes: &[bool]) -> Self {
        let mut order: Vec<usize> = (0..scores.len()).collect();
        order.sort_by(|a, b| scores[*a].total_cmp(&scores[*b]));
        let rates: Vec<f64> = order.iter().map(|row| f64::from(u8::from(outcomes[*row]))).collect();
        let overall = rates.iter().sum::<f64>() / rates.len().max(1) as f64;
        let steps = isotonic(&rates, &vec![1.0; rates.len()], Direction::Rising);
        let (mut middles, mut shrunk, mut sizes) = (Vec::new(), Vec::new(), Vec::new());
        let mut first = 0;
        for step in steps.chunk_by(|a, b| a == b) {
            let rows = &order[first..first + step.len()];
            let n = step.len() as f64;
            middles.push(rows.iter().map(|row| scores[*row]).sum::<f64>() / n);
            shrunk.push((step[0] * n + overall) / (n + 1.0));
            sizes.push(n);
            first += step.len();
        }
        // Small steps are shrunk more, so the rates need not rise any more.
        let rising = isotonic(&shrunk, &sizes, Direction::Rising);
        let mut points: Vec<[f64; 2]> = Vec::new();
        for (middle, p) in middles.into_iter().zip(rising) {
            let log_odds = (p / (1.0 - p)).ln();
            if log_odds.is_finite() && points.last().is_none_or(|[x, _]| middle > *x) {
                points.push([middle, log_odds]);
            }
        }
        Self::Curve(points)
    }

    fn read(words: &[&str]) -> Option<(f64, Self)> {
        let [share, kind, points @ ..] = words else { return None };
        let [share] = numbers(&[*share])?;
        let points: Vec<[f64; 2]> = points.chunks(2).map(numbers).collect::<Option<_>>()?;
        let calibration = match (*kind, points.as_slice()) {
            ("line", [line]) => Self::Line(*line),
            ("curve", all) if all.is_sorted_by(|a, b| a[0] < b[0]) => Self::Curve(points),
            _ => return None,
        };
        Some((share, calibration))
    }
}

/// Whether a curve predicts better than a line, if each calibrates the scores of a fold by those of the others.
fn curve_is_better(scores: &[f64], outcomes: &[bool], folds: &[usize]) -> bool {
    let mut losses = [0.0; 2];
    for fold in 0..folds.iter().max().map_or(0, |last| last + 1) {
        let part = |held: bool| {
            let rows = (0..scores.len()).filter(|row| (folds[*row] == fold) == held);
            rows.map(|row| (scores[row], outcomes[row])).unzip::<f64, bool, Vec<f64>, Vec<bool>>()
        };
        let ((train, success), (test, truth)) = (part(false), part(true));
        let Ok(line) = calibrated(&train, &success, 0.0) else { return false };
        for (loss, of) in
            losses.iter_mut().zip([Calibration::Line(line.calibration), Calibration::curve(&train, &success)])
        {
            *loss += self::scores(test.iter().map(|score| of.at(*score)), &truth)[0] * truth.len() as f64;
        }
    }
    losses[1] < losses[0]
}

impl Learner {
    fn shares(self) -> &'static [f64] {
        match self {
            Self::Chosen => &SHARES,
            Self::Boosting => &[1.0],
            Self::Splines => &[0.0],
        }
    }
}

impl Pair {
    fn fit(training: Training<'_>, train: &[usize], learner: Learner) -> Result<Self, FlexibleError> {
        let columns: Vec<Vec<f64>> =
            training.columns.iter().map(|column| train.iter().map(|row| column[*row]).collect()).collect();
        let views: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        let outcomes: Vec<bool> = train.iter().map(|row| training.outcomes[*row]).collect();
        let boosting = match learner {
            Learner::Splines => None,
            Learner::Chosen | Learner::Boosting => {
                Some(Boosting::fit(&views, &outcomes, training.constraints, Options::default())?)
            }
        };
        let splines = match learner {
            Learner::Boosting => None,
            Learner::Chosen | Learner::Splines => Some(SplineLogistic::fit(&views, &outcomes, training.interacting)?),
        };
        Ok(Self { boosting, splines })
    }

    fn log_odds(&self, row: &[f64]) -> [f64; 2] {
        [
            self.boosting.as_ref().map_or(0.0, |model| model.log_odds(row)),
            self.splines.as_ref().map_or(0.0, |model| model.log_odds(row)),
        ]
    }
}

fn mix([boosting, splines]: [f64; 2], share: f64) -> f64 {
    share * boosting + (1.0 - share) * splines
}

/// Calibrates log-odds of rows that were not fitted with a line (Platt 1999), and scores the result.
fn calibrated(log_odds: &[f64], outcomes: &[bool], boosting_share: f64) -> Result<Choice, RegressionError> {
    let line = ridge::fit(Data::new(&[log_odds], outcomes, None)?, WEAK)?.coefficients;
    // A negative slope would turn the prediction around. It means that the model found nothing.
    let calibration = [line[0], line.get(1).map_or(0.0, |slope| slope.max(0.0))];
    let predicted = log_odds.iter().map(|score| calibration[0] + calibration[1] * score);
    let [log_loss, brier] = scores(predicted, outcomes);
    Ok(Choice { boosting_share, log_loss, brier, calibration, curve: false })
}

/// Mean log loss and Brier score of predicted log-odds.
fn scores(predicted: impl Iterator<Item = f64>, outcomes: &[bool]) -> [f64; 2] {
    let (mut log_loss, mut brier) = (0.0, 0.0);
    for (log_odds, success) in predicted.zip(outcomes) {
        let p = logistic_and_log(log_odds).0;
        let likely = if *success { p } else { 1.0 - p };
        log_loss -= likely.max(1e-15).ln();
        brier += (1.0 - likely).powi(2);
    }
    let n = outcomes.len().max(1) as f64;
    [log_loss / n, brier / n]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resample::uniform;
    use crate::roc::stratified_folds;
    use rand_chacha::ChaCha8Rng;
    use rand_core::SeedableRng;

    fn fitted(learner: Learner) -> (Flexible, Vec<Vec<f64>>) {
        let mut random = ChaCha8Rng::seed_from_u64(11);
        let columns: Vec<Vec<f64>> = (0..3).map(|_| (0..400).map(|_| uniform(&mut random)).collect()).collect();
        let success = |row: usize| uniform(&mut random) < if columns[0][row] > 0.4 { 0.9 } else { 0.2 };
        let outcomes: Vec<bool> = (0..400).map(success).collect();
        let folds = stratified_folds(&outcomes, None, 5, 0);
        let training = Training {
            columns: &columns,
            outcomes: &outcomes,
            constraints: &[Monotone::Free; 3],
            interacting: &[0, 1],
        };
        (Flexible::fit(training, &folds, (learner, Calibrated::LineOrCurve), NonZeroUsize::MIN).unwrap(), columns)
    }

    #[test]
    fn text_keeps_every_bit() {
        for learner in [Learner::Chosen, Learner::Boosting, Learner::Splines] {
            let (model, columns) = fitted(learner);
            let read = Scorer::parse(&model.scorer().lines(), 3).unwrap();
            for at in 0..400 {
                let row: Vec<f64> = columns.iter().map(|column| column[at]).collect();
                assert_eq!(read.log_odds(&row), model.log_odds(&row), "{learner:?}");
            }
        }
    }

    #[test]
    fn damaged_text_is_rejected() {
        let lines = fitted(Learner::Chosen).0.scorer().lines();
        let with = |at: usize, text: &str| {
            let mut lines = lines.clone();
            lines[at] = text.to_owned();
            Scorer::parse(&lines, 3)
        };
        assert!(Scorer::parse(&lines, 3).is_ok() && Scorer::parse(&lines[1..], 3).is_err());
        for text in ["calibration 0 line 1", "calibration 2 line 0 1", "calibration 0.5 curve 1 0 0 1", "", "tree"] {
            assert!(with(0, text).is_err(), "{text}");
        }
        for text in ["tree 0<0.5 =1", "tree 0<0.5 =1 =2 =3", "tree =inf", "hinge 3 0 0 1 1", "line 0 0 0 1", "spline x"]
        {
            assert!(with(1, text).is_err(), "{text}");
        }
    }
}
