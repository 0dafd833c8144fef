//! Suites: scenarios that were chosen one by one, in place of a parameter space.

mod file;
mod problem;
mod twin;

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use self::file::Published;
use self::file::SuiteFile;
pub use self::problem::{SuiteError, SuiteProblem};
use crate::budget::Budget;
use crate::samplers::LatinHypercube;
use crate::{Assignment, Domain, ParameterSpace, Sampler, Scenario, Seed, Value};

/// A suite: a list of scenarios in groups. Each scenario has a value or a small range for every parameter of the suite.
///
/// Suites are written in TOML. A parameter that a scenario does not set comes from its group's `defaults`, and
/// otherwise from the suite's. A range `{ low, high }` or a list of words is sampled again in each round; single values
/// stay the same:
///
/// ```
/// let suite = robogate_core::Suite::from_toml(
///     r#"
///     schema = 1
///     name = "two"
///     version = "1.0.0"
///     description = "A light part and a heavy one."
///     defaults = { friction = 0.8, size_m = { low = 0.048, high = 0.052 } }
///     [[group]]
///     name = "weights"
///     category = "nominal"
///     scenarios = [
///         { id = "light", mass_kg = 0.1 },
///         { id = "heavy", mass_kg = 2.5, friction = 1.0 },
///     ]
///     "#,
/// )?;
/// assert_eq!(suite.cases().len(), 2);
/// let seed = robogate_core::Seed::campaign(2026);
/// // Episode 3 is the second scenario in the second round.
/// assert_eq!(suite.scenario(seed, 3).requested.number("mass_kg"), Some(2.5));
/// # Ok::<(), robogate_core::SuiteError>(())
/// ```
///
/// The environment defines the meaning and the allowed range of each parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "SuiteFile", into = "SuiteFile")]
#[schemars(with = "SuiteFile")]
pub struct Suite {
    file: SuiteFile,
    cases: Vec<Case>,
    space: ParameterSpace,
}

/// One scenario of a suite.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// The id, unique in the suite.
    pub id: String,
    /// The category of its group.
    pub category: String,
    /// The group.
    pub group: String,
    /// A value or range for every parameter of the suite, in the order of its space.
    pub parameters: Vec<(Arc<str>, Spread)>,
}

/// The value or range of one parameter in one scenario.
#[derive(Debug, Clone, PartialEq)]
pub enum Spread {
    /// The same value in every round.
    Fixed(Value),
    /// Sampled again in every round.
    Drawn(Domain),
}

impl Suite {
    /// Builds a suite of `scenarios` points of `space`, sampled by a Latin hypercube with this seed. It has one group.
    pub fn sampled(space: &Arc<ParameterSpace>, scenarios: usize, seed: u64) -> Result<Self, SuiteError> {
        let stream = Seed::campaign(seed).stream("sampled suite");
        let wrong = |why: String| SuiteError::Syntax(why);
        let design =
            LatinHypercube::default().design(space, scenarios, stream).map_err(|why| wrong(why.to_string()))?;
        let points = (0..design.len()).filter_map(|i| design.assignment(i));
        let points: Vec<serde_json::Value> = (1..)
            .zip(points)
            .map(|(number, point)| {
                let mut scenario = serde_json::Map::new();
                scenario.insert("id".to_owned(), format!("sampled-{number:03}").into());
                scenario.extend(point.iter().map(|(name, value)| (name.to_owned(), serde_json::json!(value))));
                serde_json::Value::Object(scenario)
            })
            .collect();
        let name = crate::Word::nearest(space.name()).map_or("space", crate::Word::as_str);
        let file = serde_json::json!({
            "schema": 1,
            "name": format!("{name}-{seed}"),
            "version": "1.0.0",
            "description": format!("{scenarios} scenarios sampled from the parameter space `{}` with seed {seed}.", space.name()),
            "group": [{ "name": "sampled", "category": "sampled", "scenarios": points }],
        });
        serde_json::from_value(file).map_err(|why| wrong(why.to_string()))
    }

    /// Builds a suite whose scenarios are `scenarios` new points of `space` in each round. It has one group. A space that samples
    /// parameters jointly has no such suite: a suite samples each parameter by itself.
    ///
    /// # Errors
    /// A space whose parameters are sampled together, or one that a suite cannot have.
    pub fn fresh(space: &ParameterSpace, scenarios: usize) -> Result<Self, SuiteError> {
        if let Some(joint) = space.correlations().first() {
            let names: Vec<&str> = joint.parameters.iter().map(|name| &**name).collect();
            let why = format!("the space `{}` samples {} jointly", space.name(), names.join(" and "));
            return Err(SuiteError::Syntax(why));
        }
        let spread = |domain: &Domain| match domain {
            Domain::Continuous { low, .. } if domain.is_constant() => Spread::Fixed(Value::Number(*low)),
            Domain::Integer { low, high } if low == high => Spread::Fixed(Value::Integer(*low)),
            Domain::Categorical { choices } if choices.len() == 1 => {
                Spread::Fixed(Value::Category(Arc::clone(&choices[0])))
            }
            _ => Spread::Drawn(domain.clone()),
        };
        let parameters: Vec<(Arc<str>, Spread)> =
            space.parameters().iter().map(|p| (Arc::clone(&p.name), spread(&p.domain))).collect();
        let name = crate::Word::nearest(space.name()).map_or("space", crate::Word::as_str).to_owned();
        let about = format!("{scenarios} new points of the parameter space `{}` in each round.", space.name());
        let scenario = |number: usize| (["fresh", "fresh"], format!("fresh-{number:03}"), parameters.clone());
        Self::try_from(SuiteFile::of_scenarios([name, "1.0.0".to_owned(), about], None, (1..=scenarios).map(scenario)))
    }

    /// Whether each scenario of each round is a new point of [`Self::space`]: all scenarios vary the same parameters over the same
    /// ranges.
    pub fn is_fresh(&self) -> bool {
        let varies = self.cases[0].parameters.iter().any(|(_, spread)| matches!(spread, Spread::Drawn(_)));
        varies && !self.has_twins() && self.cases.iter().all(|case| case.parameters == self.cases[0].parameters)
    }

    /// The same scenarios under another name, with `constants` in all of them: parameters that belong to one unit of a
    /// robot. A parameter that the suite sets to one value in all scenarios is replaced.
    ///
    /// # Errors
    /// If a scenario varies one of these parameters.
    pub fn with_constants(&self, name: &str, constants: &Assignment) -> Result<Self, SuiteError> {
        let mut file = self.file.clone();
        file.name = name.to_owned();
        let mut problems = Vec::new();
        for (parameter, value) in constants.iter() {
            if self.varies(parameter) {
                problems.push(SuiteProblem::Varies { parameter: parameter.to_owned() });
            }
            file.fix(&parameter.into(), value);
        }
        if problems.is_empty() { Self::try_from(file) } else { Err(SuiteError::Problems(problems)) }
    }

    /// Whether a parameter differs between scenarios or is sampled.
    pub fn varies(&self, parameter: &str) -> bool {
        let spreads = || self.cases.iter().flat_map(|case| &case.parameters).filter(|(name, _)| &**name == parameter);
        let first = spreads().next().map(|(_, spread)| spread);
        spreads().any(|(_, spread)| matches!(spread, Spread::Drawn(_)) || Some(spread) != first)
    }

    /// The version of the file format that is written, and the newest one that is read.
    pub const SCHEMA: u32 = 1;

    /// Reads a suite from TOML. A syntax error names line and key. Errors of content are all reported at once.
    pub fn from_toml(text: &str) -> Result<Self, SuiteError> {
        let file: SuiteFile = Budget::FILE.toml(text).map_err(|e| SuiteError::Syntax(e.to_string()))?;
        Self::try_from(file)
    }

    /// The suite's name.
    pub fn name(&self) -> &str {
        &self.file.name
    }

    /// The version, chosen by the suite's author.
    pub fn version(&self) -> &str {
        &self.file.version
    }

    /// The purpose of the suite.
    pub fn description(&self) -> &str {
        &self.file.description
    }

    /// The environment of the scenarios, as `--env` names it, if the suite is for one environment only.
    pub fn environment(&self) -> Option<&str> {
        self.file.environment.as_deref()
    }

    /// Published results on these scenarios.
    pub fn published(&self) -> &[Published] {
        &self.file.published
    }

    /// The description of a group, if its author wrote one.
    pub fn group_description(&self, category: &str, group: &str) -> Option<&str> {
        self.file.group_description(category, group)
    }

    /// The scenarios in the order of the file, at least one.
    pub fn cases(&self) -> &[Case] {
        &self.cases
    }

    /// The smallest space that contains every scenario. It defines the columns of the dictionary.
    ///
    /// A number is continuous if any scenario gives it a fraction, otherwise an integer. A continuous parameter that is
    /// constant gets a range with a relative width of 0.001, because a space has no constants.
    pub fn space(&self) -> &ParameterSpace {
        &self.space
    }

    /// The case of episode `index`. The suite runs in rounds, each in the order of the file.
    pub fn case(&self, index: u64) -> &Case {
        // The conversion cannot overflow: a suite has fewer scenarios than there are addresses.
        &self.cases[(index % self.cases.len() as u64) as usize]
    }

    /// The scenario of episode `index` of a campaign over the suite. It depends only on the campaign's seed and the
    /// index. `seed` may be the seed of the campaign or of any of its episodes.
    pub fn scenario(&self, seed: Seed, index: u64) -> Scenario {
        let seed = seed.episode(index);
        let value = |name: &str, spread: &Spread| match spread {
            Spread::Fixed(value) => value.clone(),
            // Each parameter has a separate stream: giving one a range does not change the numbers of another.
            Spread::Drawn(domain) => domain.decode(domain.from_unit(seed.stream(&format!("suite-{name}")).uniform())),
        };
        let requested: Assignment =
            self.case(index).parameters.iter().map(|(name, spread)| (Arc::clone(name), value(name, spread))).collect();
        Scenario { index, seed, requested }
    }
}

impl TryFrom<SuiteFile> for Suite {
    type Error = SuiteError;

    fn try_from(file: SuiteFile) -> Result<Self, SuiteError> {
        let (cases, space) = file.resolve().map_err(SuiteError::Problems)?;
        Ok(Self { file, cases, space })
    }
}

impl From<Suite> for SuiteFile {
    fn from(suite: Suite) -> Self {
        suite.file
    }
}
