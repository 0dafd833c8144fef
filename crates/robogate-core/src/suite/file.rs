//! The TOML form of a suite and its conversion to scenarios.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::de::{self, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::{Case, Spread, Suite, SuiteProblem};
use crate::{Domain, Parameter, ParameterSpace, Scale, Value};

type Table = BTreeMap<Arc<str>, Given>;

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_false(value: &bool) -> bool {
    !*value
}

/// A suite of scenarios.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "Suite")]
pub(super) struct SuiteFile {
    /// The version of the file format: 1.
    schema: u32,
    /// The suite's name.
    pub(super) name: String,
    /// The version of the suite, chosen by its author.
    pub(super) version: String,
    /// The purpose of the suite.
    pub(super) description: String,
    /// The environment of the scenarios, as `--env` names it. Default: the environment that the command selects.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) environment: Option<String>,
    /// Whether each scenario also runs with the task's nominal values and the same seed.
    #[serde(default, skip_serializing_if = "is_false")]
    pub(super) nominal: bool,
    /// Published results on these scenarios, for orientation.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) published: Vec<Published>,
    /// Parameters of every scenario, unless the scenario or its group sets them.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    defaults: Table,
    /// The groups, in execution order.
    group: Vec<GroupFile>,
}

/// A published result on the scenarios of a suite.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "SuitePublished")]
pub struct Published {
    /// The policy.
    pub policy: String,
    /// Its success rate, as a fraction.
    pub success: f64,
    /// Where it was published.
    pub source: String,
}

/// A group of related scenarios.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "SuiteGroup")]
struct GroupFile {
    /// The name, unique within the category.
    name: String,
    /// The category in which the group counts.
    category: String,
    /// The purpose of the group.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    description: Option<String>,
    /// Parameters of the group's scenarios, unless a scenario sets them.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    defaults: Table,
    /// The scenarios, at least one.
    scenarios: Vec<ScenarioFile>,
}

/// One scenario: its id and the parameters that differ from the defaults.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "SuiteScenario")]
struct ScenarioFile {
    /// The id, unique in the suite.
    id: String,
    #[serde(flatten)]
    parameters: Table,
}

/// A number, a word, a list of words or a range `{ low, high }`, with `scale = "log"` if its logarithm is uniform. A list or a range is
/// sampled again in each round.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
enum Given {
    Integer(i64),
    Number(f64),
    Word(Arc<str>),
    Words(Vec<Arc<str>>),
    IntegerRange(Ends<i64>),
    Range(Ends<f64>),
    Scaled(ScaledEnds),
}

/// The ends of a range. Two integer ends give an integer range, both included.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "SuiteRange")]
struct Ends<T> {
    low: T,
    high: T,
}

/// The ends of a range of numbers, with the scale on which it is sampled uniformly.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "SuiteScaledRange")]
struct ScaledEnds {
    low: f64,
    high: f64,
    scale: Scale,
}

/// Implemented by hand, because a flattened table loses the line numbers of its keys.
impl<'de> Deserialize<'de> for ScenarioFile {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Keys;
        impl<'de> Visitor<'de> for Keys {
            type Value = ScenarioFile;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a scenario: a table with an `id` and parameters")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<ScenarioFile, A::Error> {
                let (mut id, mut parameters) = (None, Table::new());
                while let Some(key) = map.next_key::<String>()? {
                    if key == "id" {
                        id = Some(map.next_value()?);
                    } else {
                        parameters.insert(key.into(), map.next_value()?);
                    }
                }
                Ok(ScenarioFile { id: id.ok_or_else(|| de::Error::missing_field("id"))?, parameters })
            }
        }
        deserializer.deserialize_map(Keys)
    }
}

/// Implemented by hand, because the error for an untagged enum does not name the expected forms.
impl<'de> Deserialize<'de> for Given {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Any;
        impl<'de> Visitor<'de> for Any {
            type Value = Given;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number, a word, a list of words, or { low, high }")
            }

            fn visit_i64<E: de::Error>(self, n: i64) -> Result<Given, E> {
                Ok(Given::Integer(n))
            }

            fn visit_u64<E: de::Error>(self, n: u64) -> Result<Given, E> {
                i64::try_from(n).map(Given::Integer).map_err(|_| E::custom(format_args!("{n} is too large")))
            }

            fn visit_f64<E: de::Error>(self, x: f64) -> Result<Given, E> {
                Ok(Given::Number(x))
            }

            fn visit_str<E: de::Error>(self, word: &str) -> Result<Given, E> {
                Ok(Given::Word(word.into()))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Given, A::Error> {
                let mut words = Vec::new();
                while let Some(word) = list.next_element()? {
                    words.push(word);
                }
                Ok(Given::Words(words))
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Given, A::Error> {
                let (mut low, mut high, mut scale) = (None, None, Scale::Linear);
                while let Some(key) = map.next_key::<String>()? {
                    match key.as_str() {
                        "low" => low = Some(map.next_value()?),
                        "high" => high = Some(map.next_value()?),
                        "scale" => scale = map.next_value()?,
                        other => return Err(de::Error::unknown_field(other, &["low", "high", "scale"])),
                    }
                }
                let low = low.ok_or_else(|| de::Error::missing_field("low"))?;
                let high = high.ok_or_else(|| de::Error::missing_field("high"))?;
                Ok(match (low, high) {
                    (Given::Integer(low), Given::Integer(high)) if scale == Scale::Linear => {
                        Given::IntegerRange(Ends { low, high })
                    }
                    (low, high) => match (low.as_number(), high.as_number()) {
                        (Some(low), Some(high)) if scale == Scale::Log => {
                            Given::Scaled(ScaledEnds { low, high, scale })
                        }
                        (Some(low), Some(high)) => Given::Range(Ends { low, high }),
                        _ => return Err(de::Error::custom("`low` and `high` must be numbers")),
                    },
                })
            }
        }
        deserializer.deserialize_any(Any)
    }
}

/// The kind of a value: number or word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Integer,
    Number,
    Word,
}

impl Kind {
    fn word(self) -> &'static str {
        if self == Self::Word { "word" } else { "number" }
    }
}

impl Given {
    fn as_number(&self) -> Option<f64> {
        match self {
            Self::Integer(n) => Some(*n as f64),
            Self::Number(x) => Some(*x),
            _ => None,
        }
    }

    fn kind(&self) -> Kind {
        match self {
            Self::Integer(_) | Self::IntegerRange(_) => Kind::Integer,
            Self::Number(_) | Self::Range(_) | Self::Scaled(_) => Kind::Number,
            Self::Word(_) | Self::Words(_) => Kind::Word,
        }
    }

    /// The same value as a domain. `None` for a single value or an empty domain.
    fn domain(&self) -> Option<Domain> {
        match self {
            Self::Integer(_) | Self::Number(_) | Self::Word(_) => None,
            Self::Words(choices) => Some(Domain::Categorical { choices: choices.clone() }),
            Self::IntegerRange(Ends { low, high }) => Some(Domain::Integer { low: *low, high: *high }),
            Self::Range(Ends { low, high }) => {
                Some(Domain::Continuous { low: *low, high: *high, scale: Scale::Linear })
            }
            Self::Scaled(ScaledEnds { low, high, scale }) => {
                Some(Domain::Continuous { low: *low, high: *high, scale: *scale })
            }
        }
    }

    /// Checks the value by itself.
    fn check(&self, name: &Arc<str>) -> Result<(), crate::SpaceError> {
        let domain = self.domain().unwrap_or_else(|| match self {
            // A value is checked as the narrowest range around it, which gives the same errors.
            Self::Number(x) => Domain::Continuous { low: *x, high: x.next_up(), scale: Scale::Linear },
            _ => Domain::Integer { low: 0, high: 0 },
        });
        ParameterSpace::new("", vec![Parameter { name: Arc::clone(name), domain }]).map(drop)
    }

    /// The value as part of a parameter that has this kind in the whole suite.
    fn spread(&self, kind: Kind) -> Spread {
        match (self, kind) {
            (Self::Integer(n), Kind::Number) => Spread::Fixed(Value::Number(*n as f64)),
            (Self::IntegerRange(Ends { low, high }), Kind::Number) if low < high => {
                Spread::Drawn(Domain::Continuous { low: *low as f64, high: *high as f64, scale: Scale::Linear })
            }
            (Self::IntegerRange(Ends { low, .. }), Kind::Number) => Spread::Fixed(Value::Number(*low as f64)),
            (Self::Integer(n), _) => Spread::Fixed(Value::Integer(*n)),
            (Self::Number(x), _) => Spread::Fixed(Value::Number(*x)),
            (Self::Word(word), _) => Spread::Fixed(Value::Category(Arc::clone(word))),
            (Self::Words(_) | Self::IntegerRange(_) | Self::Range(_) | Self::Scaled(_), _) => {
                Spread::Drawn(self.domain().unwrap_or(Domain::Integer { low: 0, high: 0 }))
            }
        }
    }
}

impl From<&Value> for Given {
    fn from(value: &Value) -> Self {
        match value {
            Value::Integer(n) => Self::Integer(*n),
            Value::Number(x) => Self::Number(*x),
            Value::Category(word) => Self::Word(Arc::clone(word)),
        }
    }
}

impl From<&Spread> for Given {
    fn from(spread: &Spread) -> Self {
        match spread {
            Spread::Fixed(value) => Self::from(value),
            Spread::Drawn(Domain::Continuous { low, high, scale: Scale::Linear }) => {
                Self::Range(Ends { low: *low, high: *high })
            }
            Spread::Drawn(Domain::Continuous { low, high, scale }) => {
                Self::Scaled(ScaledEnds { low: *low, high: *high, scale: *scale })
            }
            Spread::Drawn(Domain::Integer { low, high }) => Self::IntegerRange(Ends { low: *low, high: *high }),
            Spread::Drawn(Domain::Categorical { choices }) => Self::Words(choices.clone()),
        }
    }
}

impl SuiteFile {
    /// A suite with these scenarios: category, group, id and parameters of each. Neighbours with equal group are one group.
    pub(super) fn of_scenarios<'a>(
        [name, version, description]: [String; 3],
        environment: Option<String>,
        scenarios: impl Iterator<Item = ([&'a str; 2], String, Vec<(Arc<str>, Spread)>)>,
    ) -> Self {
        let mut groups: Vec<GroupFile> = Vec::new();
        for ([category, group], id, parameters) in scenarios {
            let parameters = parameters.into_iter().map(|(name, spread)| (name, Given::from(&spread))).collect();
            let scenario = ScenarioFile { id, parameters };
            match groups.last_mut().filter(|of| of.category == category && of.name == group) {
                Some(of) => of.scenarios.push(scenario),
                None => groups.push(GroupFile {
                    name: group.to_owned(),
                    category: category.to_owned(),
                    description: None,
                    defaults: Table::new(),
                    scenarios: vec![scenario],
                }),
            }
        }
        let (nominal, published, defaults) = (false, Vec::new(), Table::new());
        Self {
            schema: Suite::SCHEMA,
            name,
            version,
            description,
            environment,
            nominal,
            published,
            defaults,
            group: groups,
        }
    }

    /// Returns the scenarios with all their parameters and the space of these, or all problems.
    pub(super) fn resolve(&self) -> Result<(Vec<Case>, ParameterSpace), Vec<SuiteProblem>> {
        let mut problems = Vec::new();
        if self.schema != Suite::SCHEMA {
            problems.push(SuiteProblem::Schema { found: self.schema, known: Suite::SCHEMA });
        }
        self.check_words(&mut problems);
        self.check_values(&mut problems);
        let kinds = self.kinds(&mut problems);
        if !problems.is_empty() {
            return Err(problems);
        }
        let mut cases = Vec::new();
        for (group, scenario) in self.scenarios() {
            let given =
                |name: &Arc<str>, kind| Some((Arc::clone(name), self.given(group, scenario, name)?.spread(kind)));
            cases.push(Case {
                id: scenario.id.clone(),
                category: group.category.clone(),
                group: group.name.clone(),
                parameters: kinds.iter().filter_map(|(name, kind)| given(name, *kind)).collect(),
            });
        }
        let parameters = kinds.iter().enumerate().map(|(i, (name, _))| {
            let spreads = cases.iter().filter_map(|case| case.parameters.get(i)).map(|(_, spread)| spread);
            Parameter { name: Arc::clone(name), domain: cover(spreads) }
        });
        match ParameterSpace::new(self.name.clone(), parameters.collect()) {
            Ok(space) => Ok((cases, space)),
            Err(error) => Err(vec![SuiteProblem::Space(error)]),
        }
    }

    /// Sets a parameter to one value in every scenario.
    pub(super) fn fix(&mut self, name: &Arc<str>, value: &Value) {
        for group in &mut self.group {
            group.defaults.remove(name);
            group.scenarios.iter_mut().for_each(|scenario| drop(scenario.parameters.remove(name)));
        }
        let given = match value {
            Value::Integer(n) => Given::Integer(*n),
            Value::Number(x) => Given::Number(*x),
            Value::Category(word) => Given::Word(Arc::clone(word)),
        };
        self.defaults.insert(Arc::clone(name), given);
    }

    pub(super) fn group_description(&self, category: &str, group: &str) -> Option<&str> {
        self.group.iter().find(|g| g.category == category && g.name == group)?.description.as_deref()
    }

    fn scenarios(&self) -> impl Iterator<Item = (&GroupFile, &ScenarioFile)> {
        self.group.iter().flat_map(|group| group.scenarios.iter().map(move |scenario| (group, scenario)))
    }

    fn given<'a>(&'a self, group: &'a GroupFile, scenario: &'a ScenarioFile, name: &str) -> Option<&'a Given> {
        [&scenario.parameters, &group.defaults, &self.defaults].into_iter().find_map(|table| table.get(name))
    }

    fn check_words(&self, problems: &mut Vec<SuiteProblem>) {
        let mut word = |what: String, text: &str| {
            if text.is_empty() || !text.chars().all(|c| c.is_ascii_alphanumeric() || "_-.".contains(c)) {
                problems.push(SuiteProblem::Word { what, text: text.to_owned() });
            }
        };
        word("name".to_owned(), &self.name);
        word("version".to_owned(), &self.version);
        for group in &self.group {
            word(format!("the name of a group in category `{}`", group.category), &group.name);
            word(format!("the category of group `{}`", group.name), &group.category);
            for scenario in &group.scenarios {
                word(format!("an id in group `{}`", group.name), &scenario.id);
            }
        }
        for (i, group) in self.group.iter().enumerate() {
            if group.scenarios.is_empty() {
                problems.push(SuiteProblem::EmptyGroup { group: group.name.clone() });
            }
            if self.group[..i].iter().any(|g| (&g.category, &g.name) == (&group.category, &group.name)) {
                let (group, category) = (group.name.clone(), group.category.clone());
                problems.push(SuiteProblem::DuplicateGroup { group, category });
            }
        }
        let mut ids: Vec<&str> = self.scenarios().map(|(_, scenario)| scenario.id.as_str()).collect();
        if ids.is_empty() {
            problems.push(SuiteProblem::Empty);
        }
        ids.sort_unstable();
        let twice = ids.chunk_by(|a, b| a == b).filter(|same| same.len() > 1);
        problems.extend(twice.map(|same| SuiteProblem::DuplicateId { id: same[0].to_owned() }));
    }

    /// Checks each value in the file, used or not.
    fn check_values(&self, problems: &mut Vec<SuiteProblem>) {
        let wrong = self.published.iter().filter(|published| !(0.0..=1.0).contains(&published.success));
        problems.extend(
            wrong.map(|published| SuiteProblem::Published {
                policy: published.policy.clone(),
                success: published.success,
            }),
        );
        let mut table = |place: &dyn Fn() -> String, table: &Table| {
            let errors = table.iter().filter_map(|(name, given)| given.check(name).err());
            problems.extend(errors.map(|error| SuiteProblem::Value { place: place(), error }));
        };
        table(&|| "defaults".to_owned(), &self.defaults);
        for group in &self.group {
            table(&|| format!("defaults of group `{}`", group.name), &group.defaults);
            for scenario in &group.scenarios {
                table(&|| format!("scenario `{}`", scenario.id), &scenario.parameters);
            }
        }
    }

    /// Returns every parameter of the suite with its kind.
    fn kinds(&self, problems: &mut Vec<SuiteProblem>) -> BTreeMap<Arc<str>, Kind> {
        let mut kinds: BTreeMap<Arc<str>, (Kind, &str)> = BTreeMap::new();
        let names = self.group.iter().map(|group| &group.defaults).chain([&self.defaults]);
        let names = names.chain(self.scenarios().map(|(_, scenario)| &scenario.parameters));
        let mut names: Vec<&Arc<str>> = names.flat_map(BTreeMap::keys).collect();
        names.sort_unstable();
        names.dedup();
        for (group, scenario) in self.scenarios() {
            for name in &names {
                let Some(given) = self.given(group, scenario, name) else {
                    let (case, parameter) = (scenario.id.clone(), name.to_string());
                    problems.push(SuiteProblem::Missing { case, parameter });
                    continue;
                };
                let kind = given.kind();
                let (known, first) = kinds.entry(Arc::clone(name)).or_insert((kind, &scenario.id));
                match (*known, kind) {
                    (Kind::Integer, Kind::Number) => *known = Kind::Number,
                    (Kind::Word, Kind::Word) | (Kind::Integer | Kind::Number, Kind::Integer | Kind::Number) => {}
                    (one, other) => problems.push(SuiteProblem::Mixed {
                        parameter: name.to_string(),
                        one: one.word(),
                        first: (*first).to_owned(),
                        other: other.word(),
                        case: scenario.id.clone(),
                    }),
                }
            }
        }
        kinds.into_iter().map(|(name, (kind, _))| (name, kind)).collect()
    }
}

/// Relative width of the range of a continuous parameter that is constant (relative to the larger of its value and 1).
const CONSTANT_WIDTH: f64 = 1e-3;

/// The smallest domain that holds all values. They have the same kind.
fn cover<'a>(spreads: impl Iterator<Item = &'a Spread>) -> Domain {
    let mut all: Option<Domain> = None;
    for spread in spreads {
        let one = match spread {
            Spread::Drawn(domain) => domain.clone(),
            Spread::Fixed(Value::Integer(n)) => Domain::Integer { low: *n, high: *n },
            Spread::Fixed(Value::Number(x)) => Domain::Continuous { low: *x, high: *x, scale: Scale::Linear },
            Spread::Fixed(Value::Category(word)) => Domain::Categorical { choices: vec![Arc::clone(word)] },
        };
        match (&mut all, one) {
            (None, one) => all = Some(one),
            (Some(Domain::Integer { low, high }), Domain::Integer { low: from, high: to }) => {
                (*low, *high) = ((*low).min(from), (*high).max(to));
            }
            (Some(Domain::Continuous { low, high, .. }), Domain::Continuous { low: from, high: to, .. }) => {
                (*low, *high) = (low.min(from), high.max(to));
            }
            (Some(Domain::Categorical { choices }), Domain::Categorical { choices: more }) => {
                let new: Vec<_> = more.into_iter().filter(|word| !choices.contains(word)).collect();
                choices.extend(new);
            }
            // Values of mixed kinds were already reported as a problem.
            _ => {}
        }
    }
    match all {
        Some(Domain::Continuous { low, high, scale }) if low == high => {
            Domain::Continuous { low, high: low + CONSTANT_WIDTH * low.abs().max(1.0), scale }
        }
        Some(domain) => domain,
        None => Domain::Integer { low: 0, high: 0 },
    }
}
