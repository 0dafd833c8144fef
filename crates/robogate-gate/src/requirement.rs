//! One requirement.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Baseline, GateError, Metric, Mode, Production, Statistic};

/// A limit on one metric.
///
/// It has either `at_least` or `at_most`. `at_most_times_baseline` can replace `at_most` or be combined with it; the
/// larger limit then applies.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Requirement {
    /// The metric that is limited.
    pub metric: Metric,
    /// Lower limit of the metric.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_least: Option<f64>,
    /// Upper limit of the metric.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_most: Option<f64>,
    /// Upper limit as a multiple of the baseline's figure.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_most_times_baseline: Option<f64>,
    /// Only scenarios of this category count.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub category: Option<String>,
    /// Only scenarios of this group count.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub group: Option<String>,
    /// The requirement applies to each category or group separately.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub each: Option<Each>,
    /// For means: an upper bound of every value (for `cycle_time_s`, the time limit of the task in seconds).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ceiling: Option<f64>,
    /// For means of measures: a lower bound of every value. Default 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub floor: Option<f64>,
    /// Identifiers of the requirements that it verifies, in the user's requirement management (`SYS-REQ-12`).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub ids: Vec<String>,
}

/// The partition of a requirement that applies to each part separately.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Each {
    /// Each category of the suite.
    Category,
    /// Each group of the suite.
    Group,
}

/// The side of the limit on which a metric must be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Sense {
    /// At or above the limit.
    AtLeast,
    /// At or below the limit.
    AtMost,
}

impl fmt::Display for Sense {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::AtLeast => "at least",
            Self::AtMost => "at most",
        })
    }
}

/// A limit as a number.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Bound {
    /// The side of the limit.
    pub sense: Sense,
    /// The limit, in the metric's unit.
    pub limit: f64,
}

impl Bound {
    /// Whether `value` is on the required side. The limit itself is.
    pub fn holds(self, value: f64) -> bool {
        match self.sense {
            Sense::AtLeast => value >= self.limit,
            Sense::AtMost => value <= self.limit,
        }
    }
}

impl Requirement {
    /// A requirement on a metric over all scenarios.
    pub(crate) fn on(metric: Metric, at_least: Option<f64>, at_most: Option<f64>) -> Self {
        Self {
            metric,
            at_least,
            at_most,
            at_most_times_baseline: None,
            category: None,
            group: None,
            each: None,
            ceiling: None,
            floor: None,
            ids: Vec::new(),
        }
    }

    /// Its name in reports: the metric and its scope.
    pub fn id(&self) -> String {
        match (&self.category, &self.group) {
            (Some(category), Some(group)) => format!("{}[{category}/{group}]", self.metric),
            (Some(scope), None) | (None, Some(scope)) => format!("{}[{scope}]", self.metric),
            (None, None) => match self.each {
                Some(Each::Category) => format!("{}[each category]", self.metric),
                Some(Each::Group) => format!("{}[each group]", self.metric),
                None => self.metric.to_string(),
            },
        }
    }

    /// Returns an error if the requirement is invalid for any evidence.
    pub(crate) fn check(&self, mode: Mode) -> Result<(), GateError> {
        let wrong = |reason: &str| Err(GateError::Requirement { id: self.id(), reason: reason.to_owned() });
        let at_most = self.at_most.is_some() || self.at_most_times_baseline.is_some();
        if self.at_least.is_some() == at_most {
            return wrong("expected either `at_least` or an upper limit (`at_most`, `at_most_times_baseline`)");
        }
        if [self.at_least, self.at_most, self.at_most_times_baseline, self.ceiling]
            .iter()
            .flatten()
            .any(|limit| !limit.is_finite() || (*limit < 0.0 && !matches!(self.metric, Metric::Measure(..))))
        {
            return wrong("limits must be finite numbers of at least 0");
        }
        if self.metric == Metric::RealSuccess
            && (self.each.is_some()
                || self.category.is_some()
                || self.group.is_some()
                || self.at_most_times_baseline.is_some())
        {
            return wrong(
                "`real:success` applies to all trials: remove `each`, `category`, `group` and `at_most_times_baseline`",
            );
        }
        if self.each.is_some() && (self.category.is_some() || self.group.is_some()) {
            return wrong("`each` cannot be combined with `category` or `group`");
        }
        let per_time = matches!(self.metric, Metric::Production(figure) if figure.is_per_time());
        if self.ceiling.is_some() && !self.metric.is_mean() && !per_time {
            return wrong(
                "`ceiling` applies to means of `cycle_time_s` and of measures, and to figures per time, only",
            );
        }
        if let Metric::Production(figure) = self.metric {
            let Some(limit) = self.at_least else { return wrong("a figure of production needs `at_least`") };
            if mode == Mode::Confidence && per_time && self.ceiling.is_none_or(|ceiling| ceiling <= 0.0) {
                return wrong(
                    "it needs `ceiling`, the longest possible duration of an episode: the time limit in seconds",
                );
            }
            let least = if figure == Production::CyclesBetweenFailures { 1.0 } else { 0.0 };
            if limit <= least {
                let reason = format!("`at_least {limit}` holds for every policy. Expected more than {least}");
                return Err(GateError::Requirement { id: self.id(), reason });
            }
            if figure == Production::LongestCleanRun && (limit.fract() != 0.0 || limit > 1e6) {
                return wrong("`at_least` is a number of episodes. Expected an integer of at most 1,000,000");
            }
        }
        if let (Metric::TimeToSuccess(_), None) = (self.metric, self.at_most) {
            return wrong("a time to success needs `at_most`");
        }
        if self.ceiling.is_none()
            && self.metric.is_mean()
            && self.metric != Metric::Stage
            && (mode == Mode::Confidence || self.metric == Metric::MEAN_CYCLE_TIME)
        {
            return wrong(
                "the test of a mean needs `ceiling`, an upper bound of every value (for `cycle_time_s`, the time limit)",
            );
        }
        if self.floor.is_some() && !matches!(self.metric, Metric::Measure(_, Statistic::Mean)) {
            return wrong("`floor` applies to means of measures only");
        }
        let [floor, ceiling] = self.range();
        if floor.zip(ceiling).is_some_and(|(floor, ceiling)| floor >= ceiling) {
            return wrong("`floor` must be below `ceiling`");
        }
        if matches!(self.metric, Metric::FailureCount(_)) && mode == Mode::Confidence {
            return Err(GateError::Unmeetable {
                id: self.id(),
                demand: self.demand(),
                reason: "a count grows with the number of episodes, so a limit on it cannot be shown to hold\nHint: require `failure:<mode>` with `at_most = 0.01`".to_owned(),
            });
        }
        Ok(())
    }

    /// The range of the values of a mean, as far as it is known.
    pub(crate) fn range(&self) -> [Option<f64>; 2] {
        match self.metric {
            Metric::CycleTime(_) => [Some(0.0), self.ceiling],
            // Without a ceiling the range of a measure is unknown, and 0 is not assumed.
            Metric::Measure(..) => [self.floor.or(self.ceiling.map(|_| 0.0)), self.ceiling],
            Metric::Production(_) => [Some(0.0), self.ceiling],
            Metric::Stage => [Some(0.0), Some(1.0)],
            Metric::Success
            | Metric::RealSuccess
            | Metric::Failure(_)
            | Metric::FailureCount(_)
            | Metric::ForceLimit(_)
            | Metric::TimeToSuccess(_) => [None, None],
        }
    }

    fn demand(&self) -> String {
        let mut parts = Vec::new();
        parts.extend(self.at_least.map(|x| format!("at least {x}")));
        parts.extend(self.at_most_times_baseline.map(|x| format!("at most {x} times the baseline")));
        parts.extend(self.at_most.map(|x| format!("at most {x}")));
        parts.join(" or ")
    }

    /// The limit as a number.
    ///
    /// # Errors
    /// If the baseline is missing, or if no number of episodes could show that the requirement is met.
    pub fn bound(&self, mode: Mode, baseline: Option<&Baseline>) -> Result<Bound, GateError> {
        let bound = match (self.at_least, self.at_most_times_baseline) {
            (Some(limit), _) => Bound { sense: Sense::AtLeast, limit },
            (None, Some(times)) => {
                let what = || format!("requirement `{}`", self.id());
                let baseline = baseline.ok_or_else(|| GateError::NoBaseline { what: what() })?;
                let figure = baseline
                    .figure(self.metric)
                    .ok_or_else(|| GateError::NotInBaseline { what: what(), metric: self.metric.to_string() })?;
                Bound { sense: Sense::AtMost, limit: (times * figure).max(self.at_most.unwrap_or(0.0)) }
            }
            (None, None) => Bound { sense: Sense::AtMost, limit: self.at_most.unwrap_or(0.0) },
        };
        self.meetable(mode, bound).map(|()| bound)
    }

    fn meetable(&self, mode: Mode, bound: Bound) -> Result<(), GateError> {
        let refuse = |reason: &str| {
            let number = format!("{} {}", bound.sense, bound.limit);
            let demand = self.demand();
            let demand = if number == demand { demand } else { format!("{demand}: {number}") };
            Err(GateError::Unmeetable { id: self.id(), demand, reason: reason.to_owned() })
        };
        let Bound { sense, limit } = bound;
        if self.metric.is_rate() {
            if sense == Sense::AtLeast && limit > 1.0 {
                return refuse("a rate cannot exceed 1\nHint: write 92 % as 0.92");
            }
            if mode == Mode::Confidence {
                if (sense == Sense::AtLeast && limit >= 1.0) || (sense == Sense::AtMost && limit <= 0.0) {
                    return refuse(
                        "no number of episodes can show that an event never happens\nHint: use a limit such as 0.99 or 0.01; with `at_most_times_baseline`, also set `at_most` as a minimum limit",
                    );
                }
                if (sense == Sense::AtLeast && limit <= 0.0) || (sense == Sense::AtMost && limit >= 1.0) {
                    return Err(GateError::Requirement {
                        id: self.id(),
                        reason: format!(
                            "`{sense} {limit}` holds for every rate\nHint: remove the requirement, or choose a stricter limit"
                        ),
                    });
                }
            }
        }
        if let (true, [Some(floor), ceiling]) = (self.metric.is_mean(), self.range()) {
            let ceiling = ceiling.unwrap_or(f64::INFINITY);
            let always = |end: &str| {
                let reason = format!("`{sense} {limit}` holds for every value, because no value lies beyond `{end}`");
                Err(GateError::Requirement { id: self.id(), reason })
            };
            match sense {
                Sense::AtMost if limit <= floor => return refuse("no value is below it\nHint: raise the limit"),
                Sense::AtLeast if limit >= ceiling => return refuse("`ceiling` is not above the limit"),
                Sense::AtMost if limit >= ceiling => return always("ceiling"),
                Sense::AtLeast if limit <= floor && self.floor.is_some() => return always("floor"),
                Sense::AtLeast | Sense::AtMost => {}
            }
        }
        Ok(())
    }
}
