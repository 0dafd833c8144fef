//! Checks of a plan, alone and against a space.

use robogate_core::{Domain, ParameterSpace};

use super::{Plan, PlanError, Range};
use crate::{Bins, suite_sha256};
use robogate_core::hint;

/// Largest number of points in one stage. More is probably a typing error: the table alone would not fit into memory.
const MOST_EPISODES: u64 = 100_000_000;

/// Largest number of bins. No campaign has enough episodes to fill more.
const MOST_BINS: usize = 10_000;

impl Plan {
    /// Removes the ranges that do not apply to `space`. Returns a sentence about each removed range.
    ///
    /// This is for the presets, which name the Franka's parameters, with a robot whose space has other parameters. Use
    /// [`Self::check`] for a plan that a user wrote: there an unknown name is a mistake.
    #[must_use]
    pub fn fitted_to(mut self, space: &ParameterSpace) -> (Self, Vec<String>) {
        let mut left_out = Vec::new();
        let mut fits = |key: &str, kind: Kind, range: &Range| match check_range(space, key, kind, range) {
            Ok(()) => true,
            Err(error) => {
                // The hint is omitted: it is for the author of a range, and presets have no such author.
                let error = error.to_string();
                left_out.push(format!("left out: {}", error.lines().next().unwrap_or_default()));
                false
            }
        };
        self.boundary.fallback.retain(|range| fits("boundary.fallback", Kind::Continuous, range));
        self.boundary.restrict.retain(|range| fits("boundary.restrict", Kind::Integer, range));
        if let Some(emphasis) = &mut self.boundary.emphasis {
            emphasis.conditions.retain(|range| fits("boundary.emphasis.where", Kind::Number, range));
            if emphasis.conditions.is_empty() {
                self.boundary.emphasis = None;
            }
        }
        (self, left_out)
    }

    /// Rejects a plan that is invalid or does not fit `space`.
    pub fn check(&self, space: &ParameterSpace) -> Result<(), PlanError> {
        self.check_alone()?;
        if let Some(stage) = &self.suite {
            return if stage.suite.space() == space { Ok(()) } else { Err(PlanError::SuiteSpace) };
        }
        let stage = &self.boundary;
        if stage.episodes > 0
            && let Some(correlation) = space.correlations().first()
        {
            let [first, second] = correlation.parameters.each_ref().map(ToString::to_string);
            return Err(PlanError::CorrelatedBoundary { first, second });
        }
        check_ranges(space, "boundary.fallback", Kind::Continuous, &stage.fallback)?;
        check_ranges(space, "boundary.restrict", Kind::Integer, &stage.restrict)?;
        Bins::new(space, stage.bins)?;
        match &stage.emphasis {
            Some(emphasis) => check_ranges(space, "boundary.emphasis.where", Kind::Number, &emphasis.conditions),
            None => Ok(()),
        }
    }

    pub(super) fn check_alone(&self) -> Result<(), PlanError> {
        self.sampler()?;
        let (uniform, stage) = (&self.uniform, &self.boundary);
        if let Some(suite) = &self.suite {
            if uniform.episodes > 0 || stage.episodes > 0 || self.active.is_some() {
                return Err(PlanError::SuiteAndStages);
            }
            if suite.sha256 != suite_sha256(&suite.suite) {
                return Err(PlanError::SuiteHash { found: suite.sha256.clone() });
            }
            if suite.rounds == 0 {
                return Err(PlanError::NoRounds);
            }
            return check_most("suite.rounds", suite.episodes());
        }
        if self.staged() == 0 {
            return Err(PlanError::NoEpisodes);
        }
        if let Some(active) = &self.active {
            if stage.episodes > 0 {
                return Err(PlanError::ActiveAndBoundary);
            }
            if uniform.episodes == 0 {
                return Err(PlanError::ActiveAlone);
            }
            if active.seek.is_some() && active.until_rms.is_some() {
                return Err(PlanError::SeekUntilRms);
            }
            if let Some((key, found, expected)) = active.problem() {
                return Err(PlanError::Setting { key, found, expected });
            }
            check_most("active.episodes", active.episodes)?;
        }
        if uniform.episodes == 0 {
            return Err(PlanError::BoundaryAlone { boundary: stage.episodes });
        }
        for (key, episodes) in [("uniform.episodes", uniform.episodes), ("boundary.episodes", stage.episodes)] {
            check_most(key, episodes)?;
        }
        if !(2..=MOST_BINS).contains(&stage.bins) {
            return Err(PlanError::Bins { found: stage.bins, most: MOST_BINS });
        }
        let [low, high] = stage.band;
        // Written in this form to reject NaN as well.
        if !(0.0 <= low && low <= high && high <= 1.0) {
            return Err(PlanError::Band { low, high });
        }
        if let Some(emphasis) = &stage.emphasis {
            if !(0.0..=1.0).contains(&emphasis.share) {
                return Err(PlanError::Share { share: emphasis.share });
            }
            if emphasis.conditions.is_empty() {
                return Err(PlanError::NoConditions);
            }
            check_ends("boundary.emphasis.where", &emphasis.conditions)?;
        }
        check_ends("boundary.fallback", &stage.fallback)?;
        check_ends("boundary.restrict", &stage.restrict)
    }
}

fn check_most(key: &'static str, episodes: u64) -> Result<(), PlanError> {
    if episodes > MOST_EPISODES {
        return Err(PlanError::TooMany { key, found: episodes, most: MOST_EPISODES });
    }
    Ok(())
}

/// The kind of parameters that a list of ranges accepts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Continuous,
    Integer,
    Number,
}

impl Kind {
    fn takes(self, domain: &Domain) -> bool {
        match domain {
            Domain::Continuous { .. } => self != Self::Integer,
            Domain::Integer { .. } => self != Self::Continuous,
            Domain::Categorical { .. } => false,
        }
    }

    fn word(self) -> &'static str {
        match self {
            Self::Continuous => "a continuous parameter",
            Self::Integer => "an integer parameter",
            Self::Number => "a numeric parameter",
        }
    }
}

/// Checks that need no parameter space.
fn check_ends(list: &str, ranges: &[Range]) -> Result<(), PlanError> {
    for (i, range) in ranges.iter().enumerate() {
        let key = || format!("{list}[{i}]");
        let parameter = || range.parameter.clone();
        let ends = [range.low, range.high];
        if ends == [None, None] {
            return Err(PlanError::NoEnds { key: key(), parameter: parameter() });
        }
        if ends.iter().flatten().any(|end| !end.is_finite()) {
            return Err(PlanError::NotFinite { key: key(), parameter: parameter() });
        }
        if let [Some(low), Some(high)] = ends
            && low > high
        {
            return Err(PlanError::UpsideDown { key: key(), parameter: parameter(), low, high });
        }
        if ranges[..i].iter().any(|earlier| earlier.parameter == range.parameter) {
            return Err(PlanError::Twice { key: key(), parameter: parameter() });
        }
    }
    Ok(())
}

fn check_ranges(space: &ParameterSpace, list: &str, kind: Kind, ranges: &[Range]) -> Result<(), PlanError> {
    ranges.iter().enumerate().try_for_each(|(i, range)| check_range(space, &format!("{list}[{i}]"), kind, range))
}

fn check_range(space: &ParameterSpace, key: &str, kind: Kind, range: &Range) -> Result<(), PlanError> {
    let key = key.to_owned();
    let parameter = range.parameter.clone();
    let Some(at) = space.position(&parameter) else {
        let hint = hint(&parameter, space.parameters().iter().map(|p| &*p.name));
        return Err(PlanError::UnknownParameter { key, parameter, space: space.name().to_owned(), hint });
    };
    let domain = &space.parameters()[at].domain;
    if !kind.takes(domain) {
        return Err(PlanError::WrongKind { key, parameter, wanted: kind.word() });
    }
    if kind == Kind::Integer && [range.low, range.high].iter().flatten().any(|end| end.fract() != 0.0) {
        return Err(PlanError::NotWhole { key, parameter });
    }
    match range.within(domain) {
        Some(_) => Ok(()),
        None => {
            let (low, high) = ends(domain);
            Err(PlanError::Outside { key, parameter, low, high })
        }
    }
}

/// Both ends of a numeric domain. For a categorical domain, the ends of its codes, which no range uses.
fn ends(domain: &Domain) -> (f64, f64) {
    match domain {
        Domain::Continuous { low, high, .. } => (*low, *high),
        Domain::Integer { low, high } => (*low as f64, *high as f64),
        Domain::Categorical { choices } => (0.0, choices.len() as f64 - 1.0),
    }
}

impl Range {
    /// `domain` restricted to this range. `None` if the result is empty.
    pub(crate) fn within(&self, domain: &Domain) -> Option<Domain> {
        let low = self.low.unwrap_or(f64::NEG_INFINITY);
        let high = self.high.unwrap_or(f64::INFINITY);
        match domain {
            Domain::Continuous { low: least, high: most, scale } => {
                let (low, high) = (low.max(*least), high.min(*most));
                (low < high).then_some(Domain::Continuous { low, high, scale: *scale })
            }
            Domain::Integer { low: least, high: most } => {
                // A float beyond the range of i64 becomes the nearest i64.
                let (low, high) = ((low.ceil() as i64).max(*least), (high.floor() as i64).min(*most));
                (low <= high).then_some(Domain::Integer { low, high })
            }
            Domain::Categorical { .. } => None,
        }
    }
}
