//! Why the gate cannot answer.

use std::path::PathBuf;

use robogate_dictionary::DictionaryError;

/// Why the gate cannot answer.
#[derive(Debug, thiserror::Error)]
pub enum GateError {
    /// A file that is none of its form; the text has line, column and key.
    #[error("{0}")]
    Syntax(String),
    /// A file that cannot be read.
    #[error("cannot read {}: {source}\nhint: check the path", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the operating system answered.
        source: std::io::Error,
    },
    /// Something is wrong in a file.
    #[error("{}: {error}", path.display())]
    InFile {
        /// The file.
        path: PathBuf,
        /// What it is.
        error: Box<GateError>,
    },
    /// Nothing is demanded.
    #[error("there is no [[requirement]]\nhint: a gate that demands nothing would pass everything")]
    NoRequirements,
    /// A confidence that is none, or none that says anything.
    #[error("`confidence` is {confidence}; it must be at least 0.75 and below 1\nhint: write 95 % as 0.95")]
    Confidence {
        /// As given.
        confidence: f64,
    },
    /// Nothing may be run.
    #[error("`budget.rounds` is {rounds}; it must be from 1 to {most}")]
    Budget {
        /// As given.
        rounds: u32,
        /// The limit.
        most: u32,
    },
    /// A demand without a limit, or with contradictory ones.
    #[error("requirement `{id}`: {reason}")]
    Requirement {
        /// Which.
        id: String,
        /// What is wrong, with a hint.
        reason: String,
    },
    /// The same demand twice.
    #[error("requirement `{id}` stands there twice\nhint: keep the stricter one")]
    Twice {
        /// Which.
        id: String,
    },
    /// A demand that no number of episodes can show.
    #[error("requirement `{id}` ({demand}) can't be met at any number of episodes: {reason}")]
    Unmeetable {
        /// Which.
        id: String,
        /// The demand in words.
        demand: String,
        /// Why, with a hint.
        reason: String,
    },
    /// A demand that a perfect policy cannot meet within the budget.
    #[error(
        "requirement `{id}` can't be met within the budget: even without a single failure it takes {fewest} episodes, and the budget allows {budget}\nhint: raise `budget.rounds`, or demand less"
    )]
    BudgetTooSmall {
        /// Which.
        id: String,
        /// Episodes that a perfect policy needs.
        fewest: u64,
        /// Episodes that the budget allows.
        budget: u64,
    },
    /// A relative demand without a baseline.
    #[error(
        "{what} refers to a baseline, and there is none\nhint: make one with `robogate baseline RUN -o FILE` and pass it with --baseline"
    )]
    NoBaseline {
        /// Which requirement or term.
        what: String,
    },
    /// A baseline without the figure that is asked for.
    #[error("{what} refers to the baseline's {metric}, which the baseline does not have")]
    NotInBaseline {
        /// Which requirement or term.
        what: String,
        /// The figure.
        metric: String,
    },
    /// A baseline of something else.
    #[error(
        "the baseline is of {baseline}, the episodes are of {run}\nhint: make a baseline on the same scenarios: `robogate baseline RUN -o FILE`"
    )]
    ForeignBaseline {
        /// What the baseline speaks of.
        baseline: String,
        /// What the episodes speak of.
        run: String,
    },
    /// A baseline in a later form.
    #[error("the baseline has format {found}, and this robogate reads {known} at most\nhint: upgrade robogate")]
    NewerBaseline {
        /// Its version.
        found: u32,
        /// What is known.
        known: u32,
    },
    /// A baseline made from nothing.
    #[error("there is no valid episode to make a baseline from")]
    EmptyBaseline,
    /// A scope that no episode has.
    #[error("requirement `{id}`: no episode is of {scope}\nhint: there are {known}")]
    NoSuchScope {
        /// Which.
        id: String,
        /// The scope.
        scope: String,
        /// The scopes there are.
        known: String,
    },
    /// A demand for each category or group, and episodes that are of none.
    #[error(
        "requirement `{id}`: there are episodes without a {what}\nhint: name the column on import (--map {what}=COLUMN), or leave out `each`"
    )]
    NoLabel {
        /// Which.
        id: String,
        /// What is missing: category or group.
        what: &'static str,
    },
    /// A plan whose suite is not what it says.
    #[error("the plan's suite {reason}\nhint: these rows were changed or are of another robogate; run the suite again")]
    PlannedSuite {
        /// What is wrong.
        reason: String,
    },
    /// The same episode twice among imported rows.
    #[error(
        "rows {first} and {second} are the same episode: case, seed and parameters are alike, and copies are no further evidence\nhint: leave one out, or, where the seed is that of a whole series, import without its column"
    )]
    Copies {
        /// The first row.
        first: u64,
        /// The one that repeats it.
        second: u64,
    },
    /// Imported episodes of which nobody knows which worlds they met.
    #[error(
        "imported episodes are compared pair by pair only where case and seed are recorded for each, and those of {policy} are not\nhint: name both columns on import (--map case=COLUMN --map seed=COLUMN), or take the other's figures: `robogate baseline RUN -o FILE`"
    )]
    NoIdentity {
        /// Whose.
        policy: String,
    },
    /// A comparison that the best of policies could not win.
    #[error(
        "the comparison can't be decided: the other run has {pairs} episodes to pair with, and even if none of this policy's failed, that shows no margin of {margin}\nhint: run the other policy for more rounds with the same seed, or allow a wider --margin"
    )]
    TooFewPairs {
        /// Pairs there can be.
        pairs: u64,
        /// The margin.
        margin: f64,
    },
    /// Episodes of a suite among others.
    #[error("episode {index} carries no scenario id, and others do\nhint: judge a suite's episodes by themselves")]
    MixedLabels {
        /// The first without.
        index: u64,
    },
    /// A value outside the range that the test of a mean was given.
    #[error(
        "requirement `{id}`: episode {index} has the value {value}, outside {low} to {high}\nhint: set `floor` and `ceiling` to bounds of every value (for `cycle_time_s`, `ceiling` is the time limit of the episodes)"
    )]
    OutOfRange {
        /// Which.
        id: String,
        /// The episode's index.
        index: u64,
        /// Its value.
        value: f64,
        /// The lower bound.
        low: f64,
        /// The upper bound.
        high: f64,
    },
    /// A metric that the task does not have.
    #[error("requirements `{requirements}`: {reason}")]
    NotOfTask {
        /// The set of requirements.
        requirements: String,
        /// What is missing, and what there is.
        reason: String,
    },
    /// Weights that are none.
    #[error("`score`: {reason}")]
    Score {
        /// What is wrong.
        reason: String,
    },
    /// Two runs that did not meet the same worlds.
    #[error(
        "episode {index} is not the same in both runs: {what}\nhint: run the other policy on the same suite with the same seed"
    )]
    NotPaired {
        /// The episode's index.
        index: u64,
        /// What differs.
        what: String,
    },
    /// A leaderboard without entries.
    #[error("there is nothing to rank")]
    NothingToRank,
    /// Records of different scenarios in one leaderboard.
    #[error(
        "{name} is of {population}, the first is of {first}\nhint: only policies that ran the same scenarios can be ranked"
    )]
    NotComparable {
        /// The record's name.
        name: String,
        /// What it speaks of.
        population: String,
        /// What the first one speaks of.
        first: String,
    },
    /// A margin that is none.
    #[error(transparent)]
    Margin(#[from] robogate_stats::non_inferiority::NotAMargin),
    /// The record cannot be read.
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
}
