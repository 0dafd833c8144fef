//! The reasons why a plan is invalid.

use std::io;
use std::path::PathBuf;

/// The reason why a plan is invalid.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// The file cannot be read.
    #[error("cannot read {}: {source}\nHint: check the path", path.display())]
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
    #[error("`uniform.episodes` and `boundary.episodes` are both 0\nHint: a campaign needs at least one episode")]
    NoEpisodes,
    /// A plan with both a suite and stages.
    #[error(
        "`suite` cannot be combined with `uniform.episodes` or `boundary.episodes`\nHint: a plan runs either a suite or stages"
    )]
    SuiteAndStages,
    /// A plan with two stages after the first.
    #[error(
        "`active` and `boundary.episodes` cannot be combined\nHint: the active stage replaces the boundary stage; remove one of them"
    )]
    ActiveAndBoundary,
    /// An active stage without a first stage.
    #[error(
        "`uniform.episodes` is 0, but `active` needs a uniform stage\nHint: give it about a quarter of the episodes"
    )]
    ActiveAlone,
    /// An active stage that seeks a failure mode and measures the error of a model of success.
    #[error(
        "`active.seek` and `active.until_rms` cannot be combined\nHint: the bound is that of a model of success; remove one of them"
    )]
    SeekUntilRms,
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
    #[error("a suite needs at least one round\nHint: set `suite.rounds` in the plan or `--rounds` on the command line")]
    NoRounds,
    /// A suite that does not match its hash.
    #[error("`suite.sha256` does not match `suite.suite`: it states {found}")]
    SuiteHash {
        /// The hash in the plan.
        found: String,
    },
    /// A suite with another parameter space.
    #[error(
        "the parameter space does not match the suite\nHint: a suite defines its own space; remove the separate one"
    )]
    SuiteSpace,
    /// A second stage without a first.
    #[error(
        "`uniform.episodes` is 0 and `boundary.episodes` is {boundary}\nHint: the boundary is found from the uniform stage; give it some of the episodes"
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
    #[error("`boundary.emphasis.share` is {share}; expected a number from 0 to 1\nHint: write 30 % as 0.30")]
    Share {
        /// The value.
        share: f64,
    },
    /// An emphasis without conditions.
    #[error("`boundary.emphasis` has no [[boundary.emphasis.where]]\nHint: remove the table if no emphasis is needed")]
    NoConditions,
    /// An unknown sampler.
    #[error("`sampler`: `{name}` is unknown\nHint: {hint}")]
    UnknownSampler {
        /// The name.
        name: String,
        /// The nearest known name, or all of them.
        hint: String,
    },
    /// A range of a parameter that is not in the space.
    #[error("`{key}`: the parameter space `{space}` has no parameter `{parameter}`\nHint: {hint}")]
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
    #[error("`{key}`: `{parameter}` is in this list twice\nHint: one range can have both a `low` and a `high`")]
    Twice {
        /// The key.
        key: String,
        /// The parameter.
        parameter: String,
    },
    /// A boundary stage in a space whose parameters are correlated.
    #[error(
        "the boundary stage needs independent parameters, but the space correlates `{first}` with `{second}`: its points \
         and weights would be wrong\nHint: use a plan without a [boundary] table (--plan FILE); the uniform stage supports \
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
