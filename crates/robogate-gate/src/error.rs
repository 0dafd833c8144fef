//! Errors of the gate.

use std::path::PathBuf;

use robogate_core::Word;
use robogate_dictionary::DictionaryError;

/// An error of the gate: the question cannot be evaluated.
#[derive(Debug, thiserror::Error)]
pub enum GateError {
    /// Trials of the real robot that do not belong to the judged episodes.
    #[error(
        "{reason}\nHint: create the file with `robogate transfer` from a simulation of the same task, robot and policy"
    )]
    Real {
        /// The mismatch.
        reason: String,
    },
    /// A requirement on the real robot, without trials of it.
    #[error(
        "requirement `{id}` needs trials of the real robot, but none were given: no number of simulated episodes can show \
         it\nHint: create the trials' file with `robogate transfer --sim RUN --real FILE --out FILE`, and pass it with --real"
    )]
    NoRealTrials {
        /// The requirement.
        id: String,
    },
    /// A file with a syntax error. The text contains line, column and key.
    #[error("{0}")]
    Syntax(String),
    /// A file that cannot be read.
    #[error("cannot read {}: {source}\nHint: check the path", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// An error in a file.
    #[error("{}: {error}", path.display())]
    InFile {
        /// The file.
        path: PathBuf,
        /// The error.
        error: Box<GateError>,
    },
    /// A set without requirements.
    #[error("no [[requirement]]. Expected at least one\nHint: a gate without requirements would pass every policy")]
    NoRequirements,
    /// A confidence out of range.
    #[error("`confidence` is {confidence}; expected at least 0.75 and below 1\nHint: 95 % is 0.95")]
    Confidence {
        /// The given value.
        confidence: f64,
    },
    /// A number of rounds out of range.
    #[error("`budget.rounds` is {rounds}; expected 1 to {most}")]
    Budget {
        /// The given value.
        rounds: u32,
        /// The limit.
        most: u32,
    },
    /// A requirement without a limit, or with contradictory limits.
    #[error("requirement `{id}`: {reason}")]
    Requirement {
        /// The requirement.
        id: String,
        /// The problem, with a hint.
        reason: String,
    },
    /// A force limit that is invalid, or that the episodes cannot be compared with.
    #[error("force limit `{name}`: {reason}")]
    Limit {
        /// Its name.
        name: Word,
        /// The problem, with a hint.
        reason: String,
    },
    /// A duplicate requirement.
    #[error("requirement `{id}`: duplicate\nHint: keep the stricter one")]
    Twice {
        /// The requirement.
        id: String,
    },
    /// A requirement that cannot be met at any number of episodes.
    #[error("requirement `{id}` ({demand}) can't be met at any number of episodes: {reason}")]
    Unmeetable {
        /// The requirement.
        id: String,
        /// Its limit as text.
        demand: String,
        /// The reason, with a hint.
        reason: String,
    },
    /// A requirement that a perfect policy cannot meet within the budget.
    #[error(
        "requirement `{id}` can't be met within the budget: without any failure it takes {fewest} episodes, but the budget allows {budget}\nHint: allow more rounds with `--rounds N`, or choose a weaker limit in a file of your own with --requirements"
    )]
    BudgetTooSmall {
        /// The requirement.
        id: String,
        /// Episodes that a perfect policy needs.
        fewest: u64,
        /// Episodes that the budget allows.
        budget: u64,
    },
    /// A relative requirement without a baseline.
    #[error(
        "{what} refers to a baseline, but none was given\nHint: create one with `robogate gate --run RUN --write-baseline FILE` and pass it with --baseline, or choose requirements that need none with --requirements FILE"
    )]
    NoBaseline {
        /// The requirement or term.
        what: String,
    },
    /// A baseline without a required figure.
    #[error("{what} refers to the baseline's {metric}, but the baseline has no such figure")]
    NotInBaseline {
        /// The requirement or term.
        what: String,
        /// The metric.
        metric: String,
    },
    /// A baseline of another population.
    #[error(
        "the baseline is of {baseline}, but the episodes are of {run}\nHint: create a baseline from the same scenarios: `robogate gate --run RUN --write-baseline FILE`"
    )]
    ForeignBaseline {
        /// The population of the baseline.
        baseline: String,
        /// The population of the episodes.
        run: String,
    },
    /// Policies that were judged under other conditions.
    #[error(
        "the two policies were not judged alike: {differences}\nHint: run both with the same settings, engine and robot; `robogate requalify` \
         compares one policy under two of them"
    )]
    OtherConditions {
        /// What differs.
        differences: String,
    },
    /// A question that was changed after the start of its gate.
    #[error(
        "gate-question.json is not the question that the gate was asked: the run names another one\nHint: restore the file; another question \
         about a finished run is asked with `robogate gate --run DIR --requirements FILE` on a copy without it"
    )]
    OtherQuestion,
    /// A baseline in a newer format.
    #[error("unsupported baseline format {found}. Expected at most {known}\nHint: upgrade robogate")]
    NewerBaseline {
        /// Its format.
        found: u32,
        /// The newest supported format.
        known: u32,
    },
    /// A baseline without episodes.
    #[error("the run has no valid episode, so it cannot be a baseline")]
    EmptyBaseline,
    /// A scope without episodes.
    #[error("requirement `{id}`: no episode belongs to {scope}. Expected one of: {known}")]
    NoSuchScope {
        /// The requirement.
        id: String,
        /// The scope.
        scope: String,
        /// The existing scopes.
        known: String,
    },
    /// A requirement for each category or group, with episodes that have none.
    #[error(
        "requirement `{id}`: some episodes have no {what}\nHint: set the column on import (--map {what}=COLUMN), or remove `each`"
    )]
    NoLabel {
        /// The requirement.
        id: String,
        /// The missing property: category or group.
        what: &'static str,
    },
    /// A plan whose suite does not match.
    #[error(
        "the plan's suite {reason}\nHint: the rows were changed, or written by another version of robogate. Run the suite again"
    )]
    PlannedSuite {
        /// The problem.
        reason: String,
    },
    /// A duplicate episode among imported rows.
    #[error(
        "rows {first} and {second} are the same episode: case, seed and parameters are equal, and a copy is not independent evidence\nHint: remove one of them. If the seed belongs to a whole series, import without its column"
    )]
    Copies {
        /// The first row.
        first: u64,
        /// The row that repeats it.
        second: u64,
    },
    /// A control arm that no row belongs to.
    #[error(
        "no row has `{column}` = `{value}`\nHint: give the column that names the perturbation and its value without one, for example --nominal category=none"
    )]
    NoNominalRows {
        /// The column.
        column: String,
        /// The value.
        value: String,
    },
    /// Imported episodes without scenario seeds, which cannot be paired.
    #[error(
        "the imported episodes of {policy} cannot be paired, because case and seed are not recorded for each\nHint: set both columns on import (--map case=COLUMN --map seed=COLUMN), or compare with a baseline: `robogate gate --run RUN --write-baseline FILE`"
    )]
    NoIdentity {
        /// The policy.
        policy: String,
    },
    /// A comparison that even a perfect policy could not pass.
    #[error(
        "the comparison can't be decided: the other run has {pairs} episodes to pair with, which cannot show a margin of {margin} even if this policy never fails\nHint: run the other policy for more rounds with the same seed, or allow a wider --margin"
    )]
    TooFewPairs {
        /// The possible number of pairs.
        pairs: u64,
        /// The margin.
        margin: f64,
    },
    /// An episode without a scenario id in a suite.
    #[error("episode {index} has no scenario id, but others do\nHint: judge the episodes of a suite separately")]
    MixedLabels {
        /// The first episode without an id.
        index: u64,
    },
    /// A value outside the range of a test of a mean.
    #[error(
        "requirement `{id}`: episode {index} has the value {value}, outside {low} to {high}\nHint: set `floor` and `ceiling` to bounds of every value (for `cycle_time_s`, `ceiling` is the time limit of the episodes)"
    )]
    OutOfRange {
        /// The requirement.
        id: String,
        /// The episode's index.
        index: u64,
        /// The value.
        value: f64,
        /// The lower bound.
        low: f64,
        /// The upper bound.
        high: f64,
    },
    /// A failure mode or measure that the task does not have.
    #[error("requirements `{requirements}`: {reason}")]
    NotOfTask {
        /// The set of requirements.
        requirements: String,
        /// The missing item, and the existing ones.
        reason: String,
    },
    /// Invalid score terms.
    #[error("`score`: {reason}")]
    Score {
        /// The problem.
        reason: String,
    },
    /// Two runs with different scenarios.
    #[error(
        "episode {index} differs between the runs: {what}\nHint: run the other policy on the same suite with the same seed"
    )]
    NotPaired {
        /// The episode's index.
        index: u64,
        /// The difference.
        what: String,
    },
    /// A comparison of episodes that do not repeat.
    #[error(
        "the policies cannot be compared episode by episode: in the run of {policy}, {why}\nHint: let the reset of the environment \
         set everything that varies from its seed, or judge each policy with a gate of its own"
    )]
    Unpaired {
        /// The policy of the run.
        policy: String,
        /// What does not repeat.
        why: String,
    },
    /// A leaderboard without entries.
    #[error("no runs to rank. Expected at least one")]
    NothingToRank,
    /// Records of different scenarios in one leaderboard.
    #[error(
        "{name} is of {population}, but the first run is of {first}\nHint: rank only policies that ran the same scenarios"
    )]
    NotComparable {
        /// The record's name.
        name: String,
        /// Its population.
        population: String,
        /// The population of the first record.
        first: String,
    },
    /// A margin out of range.
    #[error(transparent)]
    Margin(#[from] robogate_stats::non_inferiority::NotAMargin),
    /// A record that cannot be read.
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
}
