//! The metric of a requirement.

use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;

use robogate_core::{FailureMode, TaskSpec, Word};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A metric of a set of episodes. Files contain it as text:
///
/// | text | figure |
/// |---|---|
/// | `success` | share of episodes that succeed |
/// | `failure:<mode>` | share of episodes that fail in this way |
/// | `failure_count:<mode>` | number of episodes that fail in this way, for point comparisons only |
/// | `cycle_time_s`, `cycle_time_s:p95` | mean or quantile of the duration of successful episodes, in simulated seconds |
/// | `real:success` | success rate of the real robot, from its trials and a simulation |
/// | `force_limit:<name>` | share of episodes with a contact above a force limit |
/// | `time_to_success_s:p95` | quantile of the time until an episode succeeds; one that does not succeed is censored |
/// | `measure:<name>`, `measure:<name>:p95` | mean or quantile of a measure of the task |
/// | `stage` | mean share of the way to success: the stages that an episode reached, of which success is the last |
/// | `units_per_hour` | successful episodes per hour of all episodes |
/// | `mean_cycles_between_failures` | episodes per failure |
/// | `time_between_assists_s` | duration of all episodes per episode that needs an assist: a failure, or a measure `assists` above 0 |
/// | `longest_clean_run` | length that the longest run of successes reaches with a probability of 50 % |
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Metric {
    /// Share of episodes that succeed.
    Success,
    /// Duration of a successful episode, in simulated seconds.
    CycleTime(Statistic),
    /// Number of episodes that fail in this way.
    FailureCount(FailureMode),
    /// Share of episodes that fail in this way.
    Failure(FailureMode),
    /// Share of episodes with a contact above the limit of this name ([`crate::ForceLimit`]).
    ForceLimit(Word),
    /// A measure of the task, in its unit.
    Measure(Word, Statistic),
    /// Success rate of the real robot. It needs [`crate::RealEvidence`].
    RealSuccess,
    /// A quantile of the time until success, in simulated seconds. Failures count as "later".
    TimeToSuccess(u16),
    /// Mean share of the way to success ([`TaskSpec::stage_share`]).
    Stage,
    /// A figure of production.
    Production(Production),
}

/// A figure of a cell whose episodes follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Production {
    /// Successful episodes per hour of all episodes.
    UnitsPerHour,
    /// Episodes per failure.
    CyclesBetweenFailures,
    /// Seconds of all episodes per episode that needs an assist.
    TimeBetweenAssists,
    /// The median of the longest run of successes among as many episodes as are planned.
    LongestCleanRun,
}

impl Production {
    /// All figures.
    pub const ALL: [Self; 4] =
        [Self::UnitsPerHour, Self::CyclesBetweenFailures, Self::TimeBetweenAssists, Self::LongestCleanRun];

    /// The name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::UnitsPerHour => "units_per_hour",
            Self::CyclesBetweenFailures => "mean_cycles_between_failures",
            Self::TimeBetweenAssists => "time_between_assists_s",
            Self::LongestCleanRun => "longest_clean_run",
        }
    }

    /// Whether its test needs an upper bound of the durations.
    pub(crate) fn is_per_time(self) -> bool {
        matches!(self, Self::UnitsPerHour | Self::TimeBetweenAssists)
    }
}

/// The statistic of a metric over all episodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Statistic {
    /// Their mean.
    Mean,
    /// A quantile: the smallest value that at least this many thousandths of all values do not exceed, 1 to 999.
    Quantile(u16),
}

impl Metric {
    /// The mean duration.
    pub const MEAN_CYCLE_TIME: Self = Self::CycleTime(Statistic::Mean);

    /// Every metric of a task with one figure, in the order of reports.
    pub fn of_task(task: &TaskSpec) -> Vec<Self> {
        let measures = task.measures.iter().map(|measure| Self::Measure(measure.name, Statistic::Mean));
        [Self::Success, Self::MEAN_CYCLE_TIME]
            .into_iter()
            .chain(task.modes().map(Self::FailureCount))
            .chain(task.modes().map(Self::Failure))
            .chain(measures)
            .collect()
    }

    /// Checks that the task has this metric. The error lists those that it has.
    pub fn check(self, task: &TaskSpec) -> Result<(), String> {
        let list = |names: Vec<&str>| if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        match self {
            Self::Failure(mode) | Self::FailureCount(mode) if !task.declares(mode) => Err(format!(
                "the task {} has no failure mode `{mode}`\nHint: its failure modes are {}",
                task.name,
                list(task.modes().map(FailureMode::as_str).collect())
            )),
            Self::Measure(name, _) if task.measure(name.as_str()).is_none() => Err(format!(
                "the task {} has no measure `{name}`\nHint: its measures are {}",
                task.name,
                list(task.measures.iter().map(|measure| measure.name.as_str()).collect())
            )),
            Self::Stage if task.stages.is_empty() => Err(format!(
                "the task {} declares no stages\nHint: a task of your own declares `[[stage]]` in its file, or `stages` and a measure `stages`",
                task.name
            )),
            _ => Ok(()),
        }
    }

    /// The metric as text for reports.
    pub fn title(self) -> String {
        match self {
            Self::Success => "success rate".to_owned(),
            Self::RealSuccess => "success rate of the real robot".to_owned(),
            Self::CycleTime(statistic) => format!("{statistic} of cycle time"),
            Self::FailureCount(mode) => format!("failures by {mode}"),
            Self::Failure(mode) => format!("rate of {mode}"),
            Self::ForceLimit(name) => format!("contacts above force limit {name}"),
            Self::Measure(name, statistic) => format!("{statistic} of {name}"),
            Self::Stage => "mean share of stages".to_owned(),
            Self::TimeToSuccess(q) => format!("{} of time to success", Statistic::Quantile(q)),
            Self::Production(figure) => match figure {
                Production::UnitsPerHour => "units per hour",
                Production::CyclesBetweenFailures => "mean cycles between failures",
                Production::TimeBetweenAssists => "time between assists",
                Production::LongestCleanRun => "longest clean run",
            }
            .to_owned(),
        }
    }

    /// The unit of its figure. Empty for rates and counts.
    pub fn unit(self, task: &TaskSpec) -> String {
        match self {
            Self::CycleTime(_) | Self::TimeToSuccess(_) | Self::Production(Production::TimeBetweenAssists) => {
                "s".to_owned()
            }
            Self::Measure(name, _) => {
                task.measure(name.as_str()).map_or_else(String::new, |measure| measure.unit.clone())
            }
            Self::Success
            | Self::RealSuccess
            | Self::Failure(_)
            | Self::FailureCount(_)
            | Self::ForceLimit(_)
            | Self::Stage
            | Self::Production(_) => String::new(),
        }
    }

    /// Whether the metric is the probability of an event in an episode.
    pub fn is_rate(self) -> bool {
        matches!(self, Self::Success | Self::RealSuccess | Self::Failure(_) | Self::ForceLimit(_))
    }

    /// For a quantile of order q, the share 1 - q of episodes that may lie beyond the limit.
    pub(crate) fn quantile(self) -> Option<f64> {
        match self {
            Self::CycleTime(Statistic::Quantile(q)) | Self::Measure(_, Statistic::Quantile(q)) => {
                Some(f64::from(q) / 1000.0)
            }
            Self::TimeToSuccess(q) => Some(f64::from(q) / 1000.0),
            _ => None,
        }
    }

    /// Whether the metric is a mean of values.
    pub(crate) fn is_mean(self) -> bool {
        matches!(self, Self::CycleTime(Statistic::Mean) | Self::Measure(_, Statistic::Mean) | Self::Stage)
    }
}

impl fmt::Display for Statistic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Mean => f.write_str("mean"),
            Self::Quantile(q) => write!(f, "{} % quantile", f64::from(*q) / 10.0),
        }
    }
}

impl fmt::Display for Metric {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let statistic = match self {
            Self::Success => return f.write_str("success"),
            Self::RealSuccess => return f.write_str("real:success"),
            Self::FailureCount(mode) => return write!(f, "failure_count:{mode}"),
            Self::Production(figure) => return f.write_str(figure.name()),
            Self::Stage => return f.write_str("stage"),
            Self::TimeToSuccess(q) => {
                f.write_str("time_to_success_s")?;
                &Statistic::Quantile(*q)
            }
            Self::Failure(mode) => return write!(f, "failure:{mode}"),
            Self::ForceLimit(name) => return write!(f, "force_limit:{name}"),
            Self::CycleTime(statistic) => {
                f.write_str("cycle_time_s")?;
                statistic
            }
            Self::Measure(name, statistic) => {
                write!(f, "measure:{name}")?;
                statistic
            }
        };
        match statistic {
            Statistic::Mean => Ok(()),
            Statistic::Quantile(q) => write!(f, ":p{}", f64::from(*q) / 10.0),
        }
    }
}

impl FromStr for Metric {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!(
                "`{text}` is not a metric. Expected success, stage, real:success, failure:<mode>, failure_count:<mode>, \
                 force_limit:<name>, time_to_success_s:p95, {}, cycle_time_s or measure:<name>, the last two with :p95 for a \
                 quantile",
                Production::ALL.map(Production::name).join(", ")
            )
        };
        if let Some(figure) = Production::ALL.into_iter().find(|figure| figure.name() == text) {
            return Ok(Self::Production(figure));
        }
        let (kind, rest) = text.split_once(':').map_or((text, None), |(kind, rest)| (kind, Some(rest)));
        let mode = |name: &str| FailureMode::new(name).map_err(|why| why.to_string());
        match (kind, rest) {
            ("success", None) => Ok(Self::Success),
            ("stage", None) => Ok(Self::Stage),
            ("real", Some("success")) => Ok(Self::RealSuccess),
            ("failure", Some(name)) => mode(name).map(Self::Failure),
            ("failure_count", Some(name)) => mode(name).map(Self::FailureCount),
            ("force_limit", Some(name)) => Word::new(name).map(Self::ForceLimit).map_err(|why| why.to_string()),
            ("cycle_time_s", None) => Ok(Self::MEAN_CYCLE_TIME),
            ("cycle_time_s", Some(quantile)) => parse_quantile(quantile).map(Self::CycleTime).ok_or_else(wrong),
            ("time_to_success_s", Some(quantile)) => match parse_quantile(quantile) {
                Some(Statistic::Quantile(q)) => Ok(Self::TimeToSuccess(q)),
                _ => Err(wrong()),
            },
            ("measure", Some(rest)) => {
                let (name, statistic) = match rest.split_once(':') {
                    Some((name, quantile)) => (name, parse_quantile(quantile).ok_or_else(wrong)?),
                    None => (rest, Statistic::Mean),
                };
                Word::new(name).map(|name| Self::Measure(name, statistic)).map_err(|why| why.to_string())
            }
            _ => Err(wrong()),
        }
    }
}

/// Parses `p95` or `p99.5`.
fn parse_quantile(text: &str) -> Option<Statistic> {
    let percent: f64 = text.strip_prefix('p')?.parse().ok()?;
    let thousandths = (10.0 * percent).round();
    let whole = (10.0 * percent - thousandths).abs() < 1e-9 && (1.0..=999.0).contains(&thousandths);
    whole.then_some(Statistic::Quantile(thousandths as u16))
}

impl Serialize for Metric {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Metric {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = Cow::<str>::deserialize(deserializer)?;
        text.parse().map_err(serde::de::Error::custom)
    }
}

impl JsonSchema for Metric {
    fn schema_name() -> Cow<'static, str> {
        "Metric".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "type": "string",
            "description": "success, stage, real:success, failure:<mode>, failure_count:<mode>, force_limit:<name>, \
                            time_to_success_s:p95, units_per_hour, mean_cycles_between_failures, time_between_assists_s, \
                            longest_clean_run, cycle_time_s or measure:<name>; the last two are means, or quantiles with the \
                            suffix :p95. The task declares the failure modes and measures.",
            "examples": ["success", "real:success", "failure:timeout", "cycle_time_s", "cycle_time_s:p95", "measure:force_n:p99.5"],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip() {
        for text in [
            "success",
            "stage",
            "real:success",
            "failure:jam",
            "failure_count:jam",
            "force_limit:hand",
            "cycle_time_s",
            "cycle_time_s:p95",
            "time_to_success_s:p90",
            "units_per_hour",
            "longest_clean_run",
            "measure:force_n:p99.5",
        ] {
            assert_eq!(text.parse::<Metric>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn unknown_metrics_are_rejected() {
        for text in [
            "",
            "success_rate",
            "success:p95",
            "failure",
            "failure:success",
            "cycle_time_s:p0",
            "cycle_time_s:p100",
            "time_to_success_s",
            "units_per_hour:p50",
            "measure:",
            "measure:x:p9.55",
        ] {
            assert!(text.parse::<Metric>().is_err(), "{text}");
        }
    }
}
