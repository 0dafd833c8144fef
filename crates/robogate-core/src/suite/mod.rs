//! Scenarios that were chosen one by one: a gate's questions, in place of a space to draw from.

mod file;
mod problem;

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use self::file::SuiteFile;
pub use self::problem::{SuiteError, SuiteProblem};
use crate::samplers::LatinHypercube;
use crate::{Assignment, Domain, ParameterSpace, Sampler, Scenario, Seed, Value};

/// A list of scenarios in groups, each with a value or a small range for every parameter of the suite.
///
/// Written in TOML. What a scenario does not say stands in its group's `defaults`, and what these do not say in the
/// suite's. A range `{ low, high }` or a list of words is drawn from anew in each round; everything else
/// is as it stands there:
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
/// What its parameters mean, and in which range, is the simulator's to say.
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
    /// Its name, once in the suite.
    pub id: String,
    /// The category of its group.
    pub category: String,
    /// Its group.
    pub group: String,
    /// For every parameter of the suite, in the order of its space.
    pub parameters: Vec<(Arc<str>, Spread)>,
}

/// What one parameter may be in one scenario.
#[derive(Debug, Clone, PartialEq)]
pub enum Spread {
    /// The same in every round.
    Fixed(Value),
    /// Drawn in every round.
    Drawn(Domain),
}

impl Suite {
    /// A suite of `scenarios` points of `space`, drawn by a Latin hypercube with this seed. It has one group.
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

    /// The version of the file's form that is written here, and the newest that is read.
    pub const SCHEMA: u32 = 1;

    /// Reads a suite from TOML. A syntax error names line and key; of errors of meaning all are told at once.
    pub fn from_toml(text: &str) -> Result<Self, SuiteError> {
        let file: SuiteFile = toml::from_str(text).map_err(|e| SuiteError::Syntax(e.to_string()))?;
        Self::try_from(file)
    }

    /// The suite's name.
    pub fn name(&self) -> &str {
        &self.file.name
    }

    /// Its version, in its author's own counting.
    pub fn version(&self) -> &str {
        &self.file.version
    }

    /// What it is for.
    pub fn description(&self) -> &str {
        &self.file.description
    }

    /// What a group asks, where its author said so.
    pub fn group_description(&self, category: &str, group: &str) -> Option<&str> {
        self.file.group_description(category, group)
    }

    /// The scenarios, in the file's order: at least one.
    pub fn cases(&self) -> &[Case] {
        &self.cases
    }

    /// The least space that holds every scenario: what the dictionary's columns are made of.
    ///
    /// A number is continuous where any scenario gives it a fraction, else whole. A continuous parameter that
    /// is one number throughout gets a range a thousandth wide, since a space knows no constants.
    pub fn space(&self) -> &ParameterSpace {
        &self.space
    }

    /// The scenario of episode `index`: the suite is run through in rounds, each in the file's order.
    pub fn case(&self, index: u64) -> &Case {
        // Both fit: a suite has fewer scenarios than there are addresses.
        &self.cases[(index % self.cases.len() as u64) as usize]
    }

    /// Episode `index` of a campaign over the suite: a function of the campaign's seed and the index. `seed` may be
    /// that of the campaign or of any of its episodes.
    pub fn scenario(&self, seed: Seed, index: u64) -> Scenario {
        let seed = seed.episode(index);
        let value = |name: &str, spread: &Spread| match spread {
            Spread::Fixed(value) => value.clone(),
            // A stream for each parameter: giving one a range does not shift another's numbers.
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
