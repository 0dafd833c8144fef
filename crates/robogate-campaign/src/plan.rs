//! Campaign plans.
//!
//! A [`Plan`] is read from TOML. The embedded presets contain the defaults and document every setting. Errors within
//! the plan are found on reading; conflicts with a parameter space are found by [`Plan::check`].

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use robogate_core::{Domain, ParameterSpace, Sampler, Suite, samplers};
use robogate_dictionary::{Fidelity, read_text};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{ActiveStage, Bins, CoarseStage, SuiteStage, suite_sha256};

/// A campaign plan: seed, sampler, and stages.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// The seed of all randomness in the campaign. The stages use separate streams of it.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// The sampler of the points: `latin_hypercube`, `sobol` or `uniform`.
    #[serde(default = "default_sampler")]
    pub sampler: String,
    /// The first stage, over the operating space.
    pub uniform: UniformStage,
    /// The second stage, around the boundary between success and failure.
    #[serde(default)]
    pub boundary: BoundaryStage,
    /// The active stage, which replaces the second stage.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub active: Option<ActiveStage>,
    /// The suite that replaces all stages: its scenarios run in rounds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub suite: Option<SuiteStage>,
    /// Whether the nominal twins of the episodes run after the campaign: those of the first stage, or of the suite.
    #[serde(default, skip_serializing_if = "is_false")]
    pub twins: bool,
    /// Coarse episodes, whose first scenarios are those of the first stage.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coarse: Option<CoarseStage>,
    /// The fidelity of the episodes. Only the plan of the coarse episodes beside a campaign is coarse.
    #[serde(default, skip_serializing_if = "Fidelity::is_fine")]
    pub fidelity: Fidelity,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_false(value: &bool) -> bool {
    !*value
}

/// The first stage: every parameter is uniform in its scale.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct UniformStage {
    /// The number of episodes.
    pub episodes: u64,
}

/// The second stage: it samples around the boundary that the first stage found (paper, section 5.2 and appendix F).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BoundaryStage {
    /// The number of episodes. With 0 there is no second stage.
    #[serde(default)]
    pub episodes: u64,
    /// The number of bins of equal width per continuous parameter, in the parameter's unit.
    #[serde(default = "default_bins")]
    pub bins: usize,
    /// Success rates, both ends included, between which a bin belongs to the boundary.
    #[serde(default = "default_band")]
    pub band: [f64; 2],
    /// A region that gets an additional share of the episodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub emphasis: Option<Emphasis>,
    /// Ranges for continuous parameters without a bin in the band. They replace the whole range.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub fallback: Vec<Range>,
    /// Integer parameters that are restricted to a part of their range, both ends included.
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

/// A region that gets a fixed share of the second stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Emphasis {
    /// The share of the stage's episodes, from 0 to 1.
    pub share: f64,
    /// The conditions of the region. All must hold.
    #[serde(rename = "where")]
    pub conditions: Vec<Range>,
}

/// A range of one parameter, in its unit. A missing end is the end of the parameter space.
///
/// For a continuous parameter the upper end is excluded. For an integer parameter both ends are included.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Range {
    /// The parameter's name.
    pub parameter: String,
    /// The lower end, included.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub low: Option<f64>,
    /// The upper end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub high: Option<f64>,
}

/// The seed of a campaign if the user does not choose one.
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

/// A built-in plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Preset {
    /// A quick overview with the active design: 3,000 episodes.
    #[default]
    Quick,
    /// The paper's two stages: 10,000 + 10,000 episodes.
    Paper,
}

impl Preset {
    /// Every preset.
    pub const ALL: [Self; 2] = [Self::Quick, Self::Paper];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Quick => "quick",
            Self::Paper => "paper",
        }
    }

    /// The preset with this name.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|preset| preset.name() == name)
    }

    /// The commented TOML text, which documents every setting.
    pub fn text(self) -> &'static str {
        match self {
            Self::Quick => include_str!("../../../assets/presets/quick.toml"),
            Self::Paper => include_str!("../../../assets/presets/paper.toml"),
        }
    }

    /// Parses the preset into a plan.
    pub fn plan(self) -> Result<Plan, PlanError> {
        Plan::from_toml(self.text())
    }
}

impl fmt::Display for Preset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Largest number of points in one stage. More is probably a typing error: the table alone would not fit into memory.
const MOST_EPISODES: u64 = 100_000_000;

/// Largest number of bins. No campaign has enough episodes to fill more.
const MOST_BINS: usize = 10_000;

impl Plan {
    /// Reads a plan from TOML. Errors name line and key.
    pub fn from_toml(text: &str) -> Result<Self, PlanError> {
        let plan: Self = toml::from_str(text).map_err(|e| PlanError::Syntax(e.to_string()))?;
        if plan.fidelity == Fidelity::Coarse {
            return Err(PlanError::CoarseAlone);
        }
        plan.check_alone()?;
        Ok(plan)
    }

    /// Reads a plan from a TOML file. Errors also name the file.
    pub fn load(path: &Path) -> Result<Self, PlanError> {
        let text = read_text(path).map_err(|source| PlanError::Unreadable { path: path.to_owned(), source })?;
        Self::from_toml(&text).map_err(|error| PlanError::InFile { path: path.to_owned(), error: Box::new(error) })
    }

    /// Sets the total number of episodes and keeps the design. With an active stage, a quarter, rounded up, is in the first
    /// stage; with a boundary stage, two thirds, rounded up.
    #[must_use]
    pub fn with_total(mut self, total: u64) -> Self {
        if let Some(active) = &mut self.active {
            self.uniform.episodes = total.div_ceil(4);
            active.episodes = total - self.uniform.episodes;
        } else if self.boundary.episodes > 0 {
            self.boundary.episodes = total / 3;
            self.uniform.episodes = total - total / 3;
        } else {
            self.uniform.episodes = total;
        }
        self
    }

    /// The number of episodes of both stages.
    fn staged(&self) -> u64 {
        self.uniform.episodes + self.boundary.episodes + self.active_episodes()
    }

    /// Replaces the second stage by the active stage. A quarter of all episodes, rounded up, is uniform.
    #[must_use]
    pub fn with_active(mut self) -> Self {
        let total = self.staged();
        self.active.get_or_insert_with(|| ActiveStage::new(0));
        self.boundary.episodes = 0;
        self.with_total(total)
    }

    /// Replaces the active stage by the boundary stage, with a third of all episodes. A plan with a boundary stage does not
    /// change.
    #[must_use]
    pub fn with_two_stages(mut self) -> Self {
        let total = self.staged();
        self.active = None;
        if self.boundary.episodes == 0 {
            self.boundary.episodes = total / 3;
            self.uniform.episodes = total - total / 3;
        }
        self
    }

    /// Replaces all other stages by the uniform one.
    #[must_use]
    pub fn with_uniform_only(mut self) -> Self {
        self.uniform.episodes = self.staged();
        self.boundary.episodes = 0;
        self.active = None;
        self
    }

    /// The number of episodes of the active stage.
    pub(crate) fn active_episodes(&self) -> u64 {
        self.active.as_ref().map_or(0, |stage| stage.episodes)
    }

    /// Creates a plan that runs a suite in at most `rounds` rounds.
    pub fn of_suite(suite: Suite, rounds: u64, seed: u64) -> Self {
        Self {
            seed,
            // Ranges within a scenario are always sampled independently and uniformly.
            sampler: "uniform".to_owned(),
            uniform: UniformStage { episodes: 0 },
            boundary: BoundaryStage::default(),
            active: None,
            twins: suite.has_twins(),
            suite: Some(SuiteStage::new(suite, rounds)),
            coarse: None,
            fidelity: Fidelity::Fine,
        }
    }

    /// The number of episodes of all stages.
    pub fn episodes(&self) -> u64 {
        self.staged() + self.suite.as_ref().map_or(0, SuiteStage::episodes)
    }

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

    fn check_alone(&self) -> Result<(), PlanError> {
        self.sampler()?;
        self.check_coarse()?;
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
            if let Some((key, found, expected)) = active.problem() {
                return Err(PlanError::Setting { key, found, expected });
            }
            check_most("active.episodes", active.episodes)?;
        }
        if uniform.episodes == 0 {
            return Err(PlanError::BoundaryAlone { boundary: stage.episodes });
        }
        let coarse = self.coarse.map_or(0, |coarse| coarse.episodes);
        for (key, episodes) in
            [("uniform.episodes", uniform.episodes), ("boundary.episodes", stage.episodes), ("coarse.episodes", coarse)]
        {
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

    /// The sampler of the plan.
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

/// The hint of an error about an unknown name: the nearest known name, or all of them.
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
        _ => format!("expected one of: {}", known.collect::<Vec<_>>().join(", ")),
    }
}

/// Levenshtein distance over bytes: the number of insertions, deletions and substitutions.
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

/// The reason why a plan is invalid.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// The file cannot be read.
    #[error("cannot read {}: {source}\nhint: check the path", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// A file contains an error.
    #[error("{}: {error}", path.display())]
    InFile {
        /// The file.
        path: PathBuf,
        /// The error.
        error: Box<PlanError>,
    },
    /// Invalid TOML or an invalid structure. The text has line, column and key.
    #[error("{0}")]
    Syntax(String),
    /// The plan has no episodes.
    #[error("`uniform.episodes` and `boundary.episodes` are both 0\nhint: a campaign needs at least one episode")]
    NoEpisodes,
    /// A plan with both a suite and stages.
    #[error(
        "`suite` cannot be combined with `uniform.episodes` or `boundary.episodes`\nhint: a plan runs either a suite or stages"
    )]
    SuiteAndStages,
    /// A plan with two stages after the first.
    #[error(
        "`active` and `boundary.episodes` cannot be combined\nhint: the active stage replaces the boundary stage; remove one of them"
    )]
    ActiveAndBoundary,
    /// An active stage without a first stage.
    #[error(
        "`uniform.episodes` is 0, but `active` needs a uniform stage\nhint: give it about a quarter of the episodes"
    )]
    ActiveAlone,
    /// Coarse episodes in a plan with more than a uniform stage.
    #[error(
        "`coarse` cannot be combined with `suite`, `active`, `boundary.episodes` or `twins`\nhint: coarse episodes estimate rates over \
         the operating space from a uniform stage alone"
    )]
    CoarseAndOthers,
    /// Coarse episodes of a design whose first points are not a sample.
    #[error(
        "`coarse` needs the sampler `uniform`, but `sampler` is `{found}`\nhint: the first points of another design are not an independent \
         sample"
    )]
    CoarseSampler {
        /// The sampler of the plan.
        found: String,
    },
    /// Fewer coarse episodes than fine ones.
    #[error("`coarse.episodes` is {coarse}; expected at least `uniform.episodes`, which is {fine}")]
    FewCoarse {
        /// Coarse episodes.
        coarse: u64,
        /// Fine episodes.
        fine: u64,
    },
    /// A plan of coarse episodes alone.
    #[error("`fidelity` is `coarse`; expected no such key\nhint: describe coarse episodes in the section `coarse`")]
    CoarseAlone,
    /// A setting out of range.
    #[error("`{key}` is {found}; expected {expected}")]
    Setting {
        /// The setting.
        key: &'static str,
        /// The value.
        found: f64,
        /// The expected range.
        expected: &'static str,
    },
    /// A suite with zero rounds.
    #[error("a suite needs at least one round\nhint: set `suite.rounds` in the plan or `--rounds` on the command line")]
    NoRounds,
    /// A suite that does not match its hash.
    #[error("`suite.sha256` does not match `suite.suite`: it states {found}")]
    SuiteHash {
        /// The hash in the plan.
        found: String,
    },
    /// A suite with another parameter space.
    #[error(
        "the parameter space does not match the suite\nhint: a suite defines its own space; remove the separate one"
    )]
    SuiteSpace,
    /// A second stage without a first.
    #[error(
        "`uniform.episodes` is 0 and `boundary.episodes` is {boundary}\nhint: the boundary is found from the uniform stage; give it some of the episodes"
    )]
    BoundaryAlone {
        /// Episodes of the second stage.
        boundary: u64,
    },
    /// A number of episodes above the limit.
    #[error("`{key}` is {found}; the maximum is {most}")]
    TooMany {
        /// The key.
        key: &'static str,
        /// The value.
        found: u64,
        /// The limit.
        most: u64,
    },
    /// An invalid number of bins.
    #[error("`boundary.bins` is {found}; expected 2 to {most}")]
    Bins {
        /// The value.
        found: usize,
        /// The limit.
        most: usize,
    },
    /// A range that is too narrow for the bins.
    #[error("`boundary.bins`: the range of `{parameter}` is too narrow for {bins} bins")]
    TooNarrow {
        /// The parameter.
        parameter: String,
        /// The requested number of bins.
        bins: usize,
    },
    /// An invalid band of success rates.
    #[error("`boundary.band` is [{low}, {high}]; expected two increasing numbers from 0 to 1")]
    Band {
        /// The lower end.
        low: f64,
        /// The upper end.
        high: f64,
    },
    /// A share out of range.
    #[error("`boundary.emphasis.share` is {share}; expected a number from 0 to 1\nhint: write 30 % as 0.30")]
    Share {
        /// The value.
        share: f64,
    },
    /// An emphasis without conditions.
    #[error("`boundary.emphasis` has no [[boundary.emphasis.where]]\nhint: remove the table if no emphasis is needed")]
    NoConditions,
    /// An unknown sampler.
    #[error("`sampler`: `{name}` is unknown\nhint: {hint}")]
    UnknownSampler {
        /// The name.
        name: String,
        /// The nearest known name, or all of them.
        hint: String,
    },
    /// A range of a parameter that is not in the space.
    #[error("`{key}`: the parameter space `{space}` has no parameter `{parameter}`\nhint: {hint}")]
    UnknownParameter {
        /// The key.
        key: String,
        /// The name.
        parameter: String,
        /// The space's name.
        space: String,
        /// The nearest known name, or all of them.
        hint: String,
    },
    /// A range of a parameter of the wrong kind.
    #[error("`{key}`: `{parameter}` is not {wanted}, which this list requires")]
    WrongKind {
        /// The key.
        key: String,
        /// The parameter.
        parameter: String,
        /// The required kind.
        wanted: &'static str,
    },
    /// A fractional end for an integer parameter.
    #[error("`{key}`: the ends of the integer parameter `{parameter}` must be integers")]
    NotWhole {
        /// The key.
        key: String,
        /// The parameter.
        parameter: String,
    },
    /// A range outside the operating space.
    #[error("`{key}`: the range of `{parameter}` is outside the operating space: expected values from {low} to {high}")]
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
    /// An end that is not a finite number.
    #[error("`{key}`: `low` and `high` of `{parameter}` must be finite numbers")]
    NotFinite {
        /// The key.
        key: String,
        /// The parameter.
        parameter: String,
    },
    /// A range whose low end is above its high end.
    #[error("`{key}`: `low` {low} of `{parameter}` is above `high` {high}")]
    UpsideDown {
        /// The key.
        key: String,
        /// The parameter.
        parameter: String,
        /// The lower end.
        low: f64,
        /// The upper end.
        high: f64,
    },
    /// Two ranges of the same parameter in one list.
    #[error("`{key}`: `{parameter}` is in this list twice\nhint: one range can have both a `low` and a `high`")]
    Twice {
        /// The key.
        key: String,
        /// The parameter.
        parameter: String,
    },
    /// A boundary stage in a space whose parameters are correlated.
    #[error(
        "the boundary stage needs independent parameters, but the space correlates `{first}` with `{second}`: its points \
         and weights would be wrong\nhint: use a plan without a [boundary] table (--plan FILE); the uniform stage supports \
         correlations"
    )]
    CorrelatedBoundary {
        /// One of the parameters.
        first: String,
        /// The other parameter.
        second: String,
    },
    /// The restricted space is invalid.
    #[error(transparent)]
    Space(#[from] robogate_core::SpaceError),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hint_names_nearest_word_or_all() {
        let known = ["friction", "mass_kg", "size_m"];
        assert_eq!(hint("fricton", known.into_iter()), "did you mean `friction`?");
        assert_eq!(hint("mass", known.into_iter()), "did you mean `mass_kg`?");
        assert_eq!(hint("temperature", known.into_iter()), "expected one of: friction, mass_kg, size_m");
    }

    #[test]
    fn distance_counts_single_edits() {
        for (a, b, d) in [("", "abc", 3), ("kitten", "sitting", 3), ("same", "same", 0), ("ab", "ba", 2)] {
            assert_eq!((distance(a, b), distance(b, a)), (d, d), "{a} {b}");
        }
    }
}
