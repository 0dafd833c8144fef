//! What a campaign shall do.
//!
//! A [`Plan`] is read from TOML; the embedded presets are both its defaults and its reference. What is wrong
//! within the plan is found when it is read, what does not fit a parameter space when both are at hand
//! ([`Plan::check`]).

use std::fmt;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use robogate_core::{Domain, ParameterSpace, Sampler, Suite, samplers};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Bins, SuiteStage, suite_sha256};

/// What a campaign shall do: seed, sampler, and the two stages.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// Everything random in the campaign comes from this number. The stages draw from separate
    /// streams of it.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// What draws the points: `latin_hypercube`, `sobol` or `uniform`.
    #[serde(default = "default_sampler")]
    pub sampler: String,
    /// The first stage, over the operating space.
    pub uniform: UniformStage,
    /// The second stage, where success turns into failure.
    #[serde(default)]
    pub boundary: BoundaryStage,
    /// In place of these two: the scenarios of a suite, in rounds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub suite: Option<SuiteStage>,
}

/// The first stage: every parameter uniform in its own scale.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct UniformStage {
    /// How many episodes.
    pub episodes: u64,
}

/// The second stage: closer where the first one found the boundary (paper, section 5.2 and appendix F).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BoundaryStage {
    /// How many episodes; 0 for none, and then there is no second stage.
    #[serde(default)]
    pub episodes: u64,
    /// Into how many bins of equal width, in its own unit, each continuous parameter is cut.
    #[serde(default = "default_bins")]
    pub bins: usize,
    /// Success rates, both ends included, between which a bin is boundary.
    #[serde(default = "default_band")]
    pub band: [f64; 2],
    /// Where a share of the episodes is drawn besides.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub emphasis: Option<Emphasis>,
    /// For continuous parameters without any bin in the band: what is drawn from in place of its
    /// whole range.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub fallback: Vec<Range>,
    /// Whole-number parameters that are held to a part of their range, both ends included.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub restrict: Vec<Range>,
}

impl Default for BoundaryStage {
    fn default() -> Self {
        Self {
            episodes: 0,
            bins: default_bins(),
            band: default_band(),
            emphasis: None,
            fallback: Vec::new(),
            restrict: Vec::new(),
        }
    }
}

/// A place that gets a fixed share of the second stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Emphasis {
    /// Its share of the stage's episodes, from 0 to 1.
    pub share: f64,
    /// What holds there, all at once.
    #[serde(rename = "where")]
    pub conditions: Vec<Range>,
}

/// A range of one parameter, in its own unit; an end left out is that of the parameter space.
///
/// Of a continuous parameter the lower end belongs to it and the upper does not, of a whole-number
/// one both do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Range {
    /// The parameter's name.
    pub parameter: String,
    /// The lower end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub low: Option<f64>,
    /// The upper end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub high: Option<f64>,
}

/// The seed of a campaign where nobody chose another.
pub const DEFAULT_SEED: u64 = 2026;

fn default_seed() -> u64 {
    DEFAULT_SEED
}

fn default_sampler() -> String {
    "latin_hypercube".to_owned()
}

fn default_bins() -> usize {
    10
}

fn default_band() -> [f64; 2] {
    [0.30, 0.70]
}

/// A plan that comes with the tool.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Preset {
    /// A first picture: 2,000 + 1,000 episodes.
    #[default]
    Quick,
    /// The paper's budgets: 10,000 + 10,000 episodes.
    Paper,
}

impl Preset {
    /// Every preset.
    pub const ALL: [Self; 2] = [Self::Quick, Self::Paper];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Quick => "quick",
            Self::Paper => "paper",
        }
    }

    /// The preset of that name.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|preset| preset.name() == name)
    }

    /// Its commented TOML: the reference of every setting.
    pub fn text(self) -> &'static str {
        match self {
            Self::Quick => include_str!("../../../assets/presets/quick.toml"),
            Self::Paper => include_str!("../../../assets/presets/paper.toml"),
        }
    }

    /// The preset as a plan.
    pub fn plan(self) -> Result<Plan, PlanError> {
        Plan::from_toml(self.text())
    }
}

impl fmt::Display for Preset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// More points than this in one stage are a slip of the keyboard: their table alone would not fit.
const MOST_EPISODES: u64 = 100_000_000;

/// More bins than this resolve nothing that a campaign could fill.
const MOST_BINS: usize = 10_000;

impl Plan {
    /// Reads a plan from TOML. Errors name line and key.
    pub fn from_toml(text: &str) -> Result<Self, PlanError> {
        let plan: Self = toml::from_str(text).map_err(|e| PlanError::Syntax(e.to_string()))?;
        plan.check_alone()?;
        Ok(plan)
    }

    /// Reads a plan from a TOML file. Errors name the file as well.
    pub fn load(path: &Path) -> Result<Self, PlanError> {
        let text =
            fs::read_to_string(path).map_err(|source| PlanError::Unreadable { path: path.to_owned(), source })?;
        Self::from_toml(&text).map_err(|error| PlanError::InFile { path: path.to_owned(), error: Box::new(error) })
    }

    /// The same plan with `total` episodes: two thirds, rounded up, in the first stage, the others in
    /// the second.
    #[must_use]
    pub fn with_total(mut self, total: u64) -> Self {
        self.boundary.episodes = total / 3;
        self.uniform.episodes = total - total / 3;
        self
    }

    /// The plan that runs a suite in at most `rounds` rounds.
    pub fn of_suite(suite: Suite, rounds: u64, seed: u64) -> Self {
        Self {
            seed,
            // What a scenario leaves open is drawn uniformly and by itself.
            sampler: "uniform".to_owned(),
            uniform: UniformStage { episodes: 0 },
            boundary: BoundaryStage::default(),
            suite: Some(SuiteStage::new(suite, rounds)),
        }
    }

    /// How many episodes all stages have.
    pub fn episodes(&self) -> u64 {
        self.uniform.episodes + self.boundary.episodes + self.suite.as_ref().map_or(0, SuiteStage::episodes)
    }

    /// The plan without the ranges that mean nothing in `space`, and a sentence about each that was left out.
    ///
    /// For the presets, which speak of the Franka's parameters, with a robot whose space has others. For
    /// a plan that a user wrote [`Self::check`] is right: there an unknown name is a mistake.
    #[must_use]
    pub fn fitted_to(mut self, space: &ParameterSpace) -> (Self, Vec<String>) {
        let mut left_out = Vec::new();
        let mut fits = |key: &str, kind: Kind, range: &Range| match check_range(space, key, kind, range) {
            Ok(()) => true,
            Err(error) => {
                // Without the hint, which is for somebody who wrote the range.
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

    /// Refuses a plan that is wrong in itself or does not fit `space`.
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

    fn check_alone(&self) -> Result<(), PlanError> {
        self.sampler()?;
        let (uniform, stage) = (&self.uniform, &self.boundary);
        if let Some(suite) = &self.suite {
            if uniform.episodes > 0 || stage.episodes > 0 {
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
        match (uniform.episodes, stage.episodes) {
            (0, 0) => return Err(PlanError::NoEpisodes),
            (0, boundary) => return Err(PlanError::BoundaryAlone { boundary }),
            _ => {}
        }
        for (key, episodes) in [("uniform.episodes", uniform.episodes), ("boundary.episodes", stage.episodes)] {
            check_most(key, episodes)?;
        }
        if !(2..=MOST_BINS).contains(&stage.bins) {
            return Err(PlanError::Bins { found: stage.bins, most: MOST_BINS });
        }
        let [low, high] = stage.band;
        // Written so that NaN is refused as well.
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

    /// The sampler that the plan names.
    pub fn sampler(&self) -> Result<Box<dyn Sampler>, PlanError> {
        samplers::by_name(&self.sampler).ok_or_else(|| PlanError::UnknownSampler {
            name: self.sampler.clone(),
            hint: hint(&self.sampler, samplers::NAMES.into_iter()),
        })
    }
}

fn check_most(key: &'static str, episodes: u64) -> Result<(), PlanError> {
    if episodes > MOST_EPISODES {
        return Err(PlanError::TooMany { key, found: episodes, most: MOST_EPISODES });
    }
    Ok(())
}

/// Which parameters a list of ranges may speak of.
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
            Self::Continuous => "continuous parameters",
            Self::Integer => "whole-number parameters",
            Self::Number => "parameters that are numbers",
        }
    }
}

/// What needs no space to be seen.
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

/// Both ends of a number's domain; of a category's codes, which no range speaks of.
fn ends(domain: &Domain) -> (f64, f64) {
    match domain {
        Domain::Continuous { low, high, .. } => (*low, *high),
        Domain::Integer { low, high } => (*low as f64, *high as f64),
        Domain::Categorical { choices } => (0.0, choices.len() as f64 - 1.0),
    }
}

impl Range {
    /// `domain` cut down to this range; `None` where nothing is left of it.
    pub(crate) fn within(&self, domain: &Domain) -> Option<Domain> {
        let low = self.low.unwrap_or(f64::NEG_INFINITY);
        let high = self.high.unwrap_or(f64::INFINITY);
        match domain {
            Domain::Continuous { low: least, high: most, scale } => {
                let (low, high) = (low.max(*least), high.min(*most));
                (low < high).then_some(Domain::Continuous { low, high, scale: *scale })
            }
            Domain::Integer { low: least, high: most } => {
                // A float beyond the range of i64 becomes its end.
                let (low, high) = ((low.ceil() as i64).max(*least), (high.floor() as i64).min(*most));
                (low <= high).then_some(Domain::Integer { low, high })
            }
            Domain::Categorical { .. } => None,
        }
    }
}

/// The hint that ends an error about an unknown word: the nearest known one, or all of them.
fn hint<'a>(word: &str, known: impl Iterator<Item = &'a str> + Clone) -> String {
    let near = known
        .clone()
        .map(|candidate| {
            let extends = !word.is_empty() && (candidate.starts_with(word) || word.starts_with(candidate));
            (if extends { 1 } else { distance(word, candidate) }, candidate)
        })
        .min_by_key(|(distance, _)| *distance);
    match near {
        Some((distance, candidate)) if distance <= 1 + word.len() / 4 => format!("did you mean `{candidate}`?"),
        _ => format!("there are {}", known.collect::<Vec<_>>().join(", ")),
    }
}

/// Levenshtein's distance over bytes: how many have to be put in, taken out or changed.
fn distance(a: &str, b: &str) -> usize {
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.bytes().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.bytes().enumerate() {
            let changed = diagonal + usize::from(x != y);
            diagonal = row[j + 1];
            row[j + 1] = changed.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

/// Why a plan is none.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// The file cannot be read.
    #[error("cannot read {}: {source}\nhint: check the path", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the operating system answered.
        source: io::Error,
    },
    /// Something is wrong in a file.
    #[error("{}: {error}", path.display())]
    InFile {
        /// The file.
        path: PathBuf,
        /// What it is.
        error: Box<PlanError>,
    },
    /// Not TOML, or not of the right form; the text has line, column and key.
    #[error("{0}")]
    Syntax(String),
    /// Nothing to do.
    #[error("`uniform.episodes` and `boundary.episodes` are both 0\nhint: a campaign needs at least one episode")]
    NoEpisodes,
    /// A suite beside what it replaces.
    #[error(
        "`suite` stands beside `uniform.episodes` or `boundary.episodes`\nhint: a plan runs a suite or stages, not both"
    )]
    SuiteAndStages,
    /// A suite that is never run.
    #[error("a suite needs at least one round\nhint: in a plan it is `suite.rounds`, at the command `--rounds`")]
    NoRounds,
    /// A suite that is not the one of its hash.
    #[error("`suite.suite` is not the suite whose SHA-256 `suite.sha256` states ({found})")]
    SuiteHash {
        /// The hash that is stated.
        found: String,
    },
    /// A suite over another space.
    #[error("the parameter space is not that of the suite\nhint: a suite brings its own; leave the space out")]
    SuiteSpace,
    /// A second stage without a first.
    #[error(
        "`uniform.episodes` is 0 and `boundary.episodes` is {boundary}\nhint: the boundary is found from the uniform stage; give it some of the episodes"
    )]
    BoundaryAlone {
        /// Episodes of the second stage.
        boundary: u64,
    },
    /// More episodes than can be meant.
    #[error("`{key}` is {found}, and {most} is the most")]
    TooMany {
        /// The key.
        key: &'static str,
        /// Its value.
        found: u64,
        /// The limit.
        most: u64,
    },
    /// Bins that bin nothing.
    #[error("`boundary.bins` is {found}; it must be from 2 to {most}")]
    Bins {
        /// Its value.
        found: usize,
        /// The limit.
        most: usize,
    },
    /// A range that cannot be cut.
    #[error("`boundary.bins`: the range of `{parameter}` is too narrow for {bins} bins")]
    TooNarrow {
        /// The parameter.
        parameter: String,
        /// The bins asked for.
        bins: usize,
    },
    /// A band that holds no success rate.
    #[error("`boundary.band` is [{low}, {high}]; its ends must rise and lie from 0 to 1")]
    Band {
        /// Its lower end.
        low: f64,
        /// Its upper end.
        high: f64,
    },
    /// A share that is none.
    #[error("`boundary.emphasis.share` is {share}; it must be from 0 to 1\nhint: write 30 % as 0.30")]
    Share {
        /// Its value.
        share: f64,
    },
    /// An emphasis on everything.
    #[error("`boundary.emphasis` has no [[boundary.emphasis.where]]\nhint: leave the table out for no emphasis")]
    NoConditions,
    /// No sampler of that name.
    #[error("`sampler`: `{name}` is unknown\nhint: {hint}")]
    UnknownSampler {
        /// The name.
        name: String,
        /// What could be meant.
        hint: String,
    },
    /// A range of a parameter that the space has not.
    #[error("`{key}`: the parameter space `{space}` has no `{parameter}`\nhint: {hint}")]
    UnknownParameter {
        /// The key.
        key: String,
        /// The name.
        parameter: String,
        /// The space's name.
        space: String,
        /// What could be meant.
        hint: String,
    },
    /// A range of a parameter that can have none here.
    #[error("`{key}`: `{parameter}` is none of the {wanted} that can stand here")]
    WrongKind {
        /// The key.
        key: String,
        /// The parameter.
        parameter: String,
        /// What can stand there.
        wanted: &'static str,
    },
    /// A whole-number parameter between two whole numbers.
    #[error("`{key}`: the ends of the whole-number parameter `{parameter}` must be whole numbers")]
    NotWhole {
        /// The key.
        key: String,
        /// The parameter.
        parameter: String,
    },
    /// A range that shares nothing with the operating space.
    #[error("`{key}`: nothing of the range of `{parameter}` lies in the operating space, which has {low} to {high}")]
    Outside {
        /// The key.
        key: String,
        /// The parameter.
        parameter: String,
        /// The space's lower end.
        low: f64,
        /// The space's upper end.
        high: f64,
    },
    /// A range without ends.
    #[error("`{key}`: `{parameter}` has neither `low` nor `high`")]
    NoEnds {
        /// The key.
        key: String,
        /// The parameter.
        parameter: String,
    },
    /// An end that is no number.
    #[error("`{key}`: `low` and `high` of `{parameter}` must be finite numbers")]
    NotFinite {
        /// The key.
        key: String,
        /// The parameter.
        parameter: String,
    },
    /// A range that holds nothing.
    #[error("`{key}`: `low` {low} of `{parameter}` is above `high` {high}")]
    UpsideDown {
        /// The key.
        key: String,
        /// The parameter.
        parameter: String,
        /// Its lower end.
        low: f64,
        /// Its upper end.
        high: f64,
    },
    /// Two ranges of one parameter in one list.
    #[error("`{key}`: `{parameter}` stands in this list twice\nhint: one range can have both a `low` and a `high`")]
    Twice {
        /// The key.
        key: String,
        /// The parameter.
        parameter: String,
    },
    /// A boundary stage in a space whose parameters are correlated.
    #[error(
        "the boundary stage takes parameters for independent, and the space correlates `{first}` with `{second}`: its points \
         and weights would be wrong\nhint: give a plan without a [boundary] table (--plan FILE); the uniform stage knows \
         correlations"
    )]
    CorrelatedBoundary {
        /// One parameter.
        first: String,
        /// The other.
        second: String,
    },
    /// A narrowed space is none.
    #[error(transparent)]
    Space(#[from] robogate_core::SpaceError),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hint_is_the_nearest_word_or_all_of_them() {
        let known = ["friction", "mass_kg", "size_m"];
        assert_eq!(hint("fricton", known.into_iter()), "did you mean `friction`?");
        assert_eq!(hint("mass", known.into_iter()), "did you mean `mass_kg`?");
        assert_eq!(hint("temperature", known.into_iter()), "there are friction, mass_kg, size_m");
    }

    #[test]
    fn distance_counts_single_changes() {
        for (a, b, d) in [("", "abc", 3), ("kitten", "sitting", 3), ("same", "same", 0), ("ab", "ba", 2)] {
            assert_eq!((distance(a, b), distance(b, a)), (d, d), "{a} {b}");
        }
    }
}
