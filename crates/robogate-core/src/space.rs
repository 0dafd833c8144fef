//! Parameter spaces: ranges and distributions of the parameters that vary between episodes.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Value;
use crate::budget::Budget;
use crate::copula::Copula;

/// A parameter space: the parameters that vary between episodes, with their ranges and distribution.
///
/// Each parameter is uniform in its scale, and independent of the others unless a [`Correlation`] states otherwise. The
/// TOML form:
///
/// ```
/// let space = robogate_core::ParameterSpace::from_toml(
///     r#"
///     name = "two"
///     [[parameter]]
///     name = "friction"
///     kind = "continuous"
///     low = 0.05
///     high = 1.2
///     scale = "log"
///     [[parameter]]
///     name = "shape"
///     kind = "categorical"
///     choices = ["box", "sphere"]
///     "#,
/// )?;
/// assert_eq!(space.len(), 2);
/// # Ok::<(), robogate_core::SpaceError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "SpaceFile", into = "SpaceFile")]
#[schemars(with = "SpaceFile")]
pub struct ParameterSpace {
    name: String,
    parameters: Vec<Parameter>,
    correlations: Vec<Correlation>,
}

impl ParameterSpace {
    /// Creates a space. Each parameter must have a non-empty range, and names must be distinct.
    pub fn new(name: impl Into<String>, parameters: Vec<Parameter>) -> Result<Self, SpaceError> {
        if parameters.is_empty() {
            return Err(SpaceError::NoParameters);
        }
        for (i, parameter) in parameters.iter().enumerate() {
            parameter.check()?;
            if parameters[..i].iter().any(|earlier| earlier.name == parameter.name) {
                return Err(SpaceError::Duplicate { parameter: parameter.name.to_string() });
            }
        }
        Ok(Self { name: name.into(), parameters, correlations: Vec::new() })
    }

    /// Replaces the correlations of the space. Each must be between two continuous parameters of the space, and
    /// together they must form a positive definite matrix.
    pub fn with_correlations(mut self, correlations: Vec<Correlation>) -> Result<Self, SpaceError> {
        correlations.iter().enumerate().try_for_each(|(i, c)| c.check(&self, &correlations[..i]))?;
        self.correlations = correlations;
        Copula::of(&self)?;
        Ok(self)
    }

    /// Reads a space from TOML. Errors name the line and key, or the parameter.
    pub fn from_toml(text: &str) -> Result<Self, SpaceError> {
        Budget::FILE.check_toml(text).map_err(|error| SpaceError::Syntax(error.to_string()))?;
        // Parsing and validation are separate steps, which keeps the type of a validation error.
        let syntax = |e: toml::de::Error| SpaceError::Syntax(in_parameter(text).unwrap_or_else(|| e.to_string()));
        let file = match with_fixed_kinds(text) {
            Some(table) => SpaceFile::deserialize(table).map_err(syntax)?,
            None => toml::from_str(text).map_err(syntax)?,
        };
        Self::try_from(file)
    }

    /// The space's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The parameters in order.
    pub fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    /// The correlations between parameters. Empty if all are independent.
    pub fn correlations(&self) -> &[Correlation] {
        &self.correlations
    }

    /// The position of the parameter `name`.
    pub fn position(&self, name: &str) -> Option<usize> {
        self.parameters.iter().position(|p| &*p.name == name)
    }

    /// The number of parameters, at least one.
    #[expect(clippy::len_without_is_empty, reason = "a space is never empty")]
    pub fn len(&self) -> usize {
        self.parameters.len()
    }
}

/// A parameter: a name with its unit, and a domain.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// The name. It ends with the unit, if there is one (`mass_kg`).
    pub name: Arc<str>,
    /// The accepted values.
    pub domain: Domain,
}

/// The values of a parameter and their distribution.
#[derive(Debug, Clone, PartialEq)]
pub enum Domain {
    /// A real number in [low, high), uniform in `scale`. With equal ends, it is constant.
    Continuous {
        /// Lower end.
        low: f64,
        /// Upper end.
        high: f64,
        /// The scale in which the parameter is uniform.
        scale: Scale,
    },
    /// An integer in low..=high; all are equally likely.
    Integer {
        /// Smallest value.
        low: i64,
        /// Largest value.
        high: i64,
    },
    /// One of several choices; all are equally likely.
    Categorical {
        /// The choices.
        choices: Vec<Arc<str>>,
    },
}

impl Domain {
    /// The coded value at `u` in [0, 1). For a continuous parameter this is the quantile of `u` in its scale, otherwise
    /// the index of the cell of `u` among equal parts.
    pub fn from_unit(&self, u: f64) -> f64 {
        match self {
            Self::Continuous { low, high, scale: Scale::Linear } => (low + u * (high - low)).clamp(*low, *high),
            // Paper, section 5.1: exp(log low + u (log high - log low)).
            Self::Continuous { low, high, scale: Scale::Log } => {
                (low.ln() + u * (high.ln() - low.ln())).exp().clamp(*low, *high)
            }
            Self::Integer { low, .. } => *low as f64 + self.cell(u),
            Self::Categorical { .. } => self.cell(u),
        }
    }

    /// The inverse of [`Self::from_unit`] for a continuous parameter. For a discrete one, the middle of the value's
    /// cell, and for a constant the middle of the cube.
    pub fn to_unit(&self, coded: f64) -> f64 {
        match self {
            Self::Continuous { low, high, .. } if low == high => 0.5,
            Self::Continuous { low, high, scale: Scale::Linear } => (coded - low) / (high - low),
            Self::Continuous { low, high, scale: Scale::Log } => (coded / low).ln() / (high / low).ln(),
            Self::Integer { low, .. } => (coded - *low as f64 + 0.5) / self.levels().unwrap_or(1) as f64,
            Self::Categorical { .. } => (coded + 0.5) / self.levels().unwrap_or(1) as f64,
        }
    }

    /// Both ends of a range and a number between them, or every choice. An environment that accepts these values accepts all.
    pub fn extremes(&self) -> Vec<Value> {
        match self {
            // Numbers between the ends need not be integers, even if both ends are.
            Self::Continuous { low, high, .. } => {
                vec![Value::Number(*low), Value::Number(*high), Value::Number(low + 0.618 * (high - low))]
            }
            Self::Integer { low, high } => vec![Value::Integer(*low), Value::Integer(*high)],
            Self::Categorical { choices } => choices.iter().cloned().map(Value::Category).collect(),
        }
    }

    /// Whether a continuous parameter has only one value. It varies in no stage and has no effect to analyse.
    pub fn is_constant(&self) -> bool {
        matches!(self, Self::Continuous { low, high, .. } if low == high)
    }

    /// The number of values of a discrete domain. `None` for a continuous one.
    pub fn levels(&self) -> Option<usize> {
        match self {
            Self::Continuous { .. } => None,
            Self::Integer { low, high } => Some((high - low) as usize + 1),
            Self::Categorical { choices } => Some(choices.len()),
        }
    }

    /// Whether `coded` stands for a value of this domain.
    pub fn has_code(&self, coded: f64) -> bool {
        match self {
            Self::Continuous { low, high, .. } => (*low..=*high).contains(&coded),
            Self::Integer { low, high } => coded.fract() == 0.0 && (*low as f64..=*high as f64).contains(&coded),
            Self::Categorical { choices } => coded.fract() == 0.0 && (0.0..choices.len() as f64).contains(&coded),
        }
    }

    /// Converts a code to its value.
    pub fn decode(&self, coded: f64) -> Value {
        match self {
            Self::Continuous { .. } => Value::Number(coded),
            Self::Integer { .. } => Value::Integer(coded as i64),
            Self::Categorical { choices } => {
                Value::Category(Arc::clone(&choices[(coded as usize).min(choices.len() - 1)]))
            }
        }
    }

    /// Converts a value to its code. `None` if the value has the wrong type or is not a choice. A number outside [low,
    /// high] has a code, because data may contain values outside the space.
    pub fn encode(&self, value: &Value) -> Option<f64> {
        match (self, value) {
            (Self::Continuous { .. } | Self::Integer { .. }, Value::Number(x)) => Some(*x),
            (Self::Continuous { .. } | Self::Integer { .. }, Value::Integer(n)) => Some(*n as f64),
            (Self::Categorical { choices }, Value::Category(word)) => {
                choices.iter().position(|c| c == word).map(|i| i as f64)
            }
            _ => None,
        }
    }

    fn cell(&self, u: f64) -> f64 {
        let levels = self.levels().unwrap_or(1);
        ((u * levels as f64) as usize).min(levels - 1) as f64
    }
}

/// The scale in which a continuous parameter is uniform.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Scale {
    /// Uniform in the number itself.
    #[default]
    Linear,
    /// Uniform in the logarithm.
    Log,
}

impl Parameter {
    fn check(&self) -> Result<(), SpaceError> {
        let parameter = self.name.to_string();
        if parameter.is_empty() || !parameter.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') {
            return Err(SpaceError::Name { parameter });
        }
        match &self.domain {
            Domain::Continuous { low, high, .. } if !low.is_finite() || !high.is_finite() => {
                Err(SpaceError::NotFinite { parameter })
            }
            Domain::Continuous { low, high, .. } if low > high => {
                Err(SpaceError::EmptyRange { parameter, low: *low, high: *high })
            }
            Domain::Continuous { low, scale: Scale::Log, .. } if *low <= 0.0 => {
                Err(SpaceError::LogOfNonPositive { parameter, low: *low })
            }
            Domain::Integer { low, high } if low > high => {
                Err(SpaceError::EmptyRange { parameter, low: *low as f64, high: *high as f64 })
            }
            Domain::Integer { low, high } if high.abs_diff(*low) >= 1 << 32 => {
                Err(SpaceError::TooManyLevels { parameter })
            }
            Domain::Categorical { choices } if choices.is_empty() => Err(SpaceError::NoChoices { parameter }),
            Domain::Categorical { choices } => {
                match (1..choices.len()).find(|i| choices[..*i].contains(&choices[*i])) {
                    Some(i) => Err(SpaceError::DuplicateChoice { parameter, choice: choices[i].to_string() }),
                    None => Ok(()),
                }
            }
            _ => Ok(()),
        }
    }
}

/// The rank correlation of two continuous parameters. A Gaussian copula creates it and leaves both uniform in their
/// scales.
///
/// Their joint distribution is that of Φ(x) and Φ(y) with x, y normal of correlation 2 sin(π rank / 6), which gives
/// them this rank correlation (Kruskal 1958, JASA 53). A rank correlation is independent of scales: the logarithms have
/// the same rank correlation as the numbers.
/// logarithms is that of the numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Correlation {
    /// The two parameters.
    pub parameters: [Arc<str>; 2],
    /// Spearman's rank correlation between them, above -1 and below 1.
    pub rank: f64,
}

impl Correlation {
    fn check(&self, space: &ParameterSpace, earlier: &[Self]) -> Result<(), SpaceError> {
        let [first, second] = &self.parameters;
        let pair = || format!("`{first}` and `{second}`");
        for name in &self.parameters {
            let Some(at) = space.position(name) else {
                let known: Vec<&str> = space.parameters.iter().map(|p| &*p.name).collect();
                return Err(SpaceError::UnknownInCorrelation { parameter: name.to_string(), known: known.join(", ") });
            };
            if !matches!(space.parameters[at].domain, Domain::Continuous { .. }) {
                return Err(SpaceError::CorrelationOfDiscrete { parameter: name.to_string() });
            }
        }
        if first == second {
            return Err(SpaceError::CorrelationWithItself { parameter: first.to_string() });
        }
        // Written in this form to reject NaN as well.
        if !(-1.0 < self.rank && self.rank < 1.0) {
            return Err(SpaceError::CorrelationOutside { pair: pair(), rank: self.rank });
        }
        let same = |other: &Self| other.parameters.contains(first) && other.parameters.contains(second);
        match earlier.iter().any(same) {
            true => Err(SpaceError::CorrelationTwice { pair: pair() }),
            false => Ok(()),
        }
    }
}

/// The reason why a parameter space is invalid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SpaceError {
    /// Invalid TOML or an invalid structure. The text has line, column and key.
    #[error("{0}")]
    Syntax(String),
    /// The space has no parameters.
    #[error("the space has no [[parameter]]")]
    NoParameters,
    /// Two parameters have the same name.
    #[error("parameter `{parameter}` is defined twice")]
    Duplicate {
        /// The name.
        parameter: String,
    },
    /// A name that cannot be a column name.
    #[error("parameter name `{parameter}` is invalid: expected letters, digits and underscores")]
    Name {
        /// The name.
        parameter: String,
    },
    /// An empty range.
    #[error("parameter `{parameter}`: low {low} must be below high {high}")]
    EmptyRange {
        /// The name.
        parameter: String,
        /// The lower end.
        low: f64,
        /// The upper end.
        high: f64,
    },
    /// A range with equal ends.
    #[error(
        "parameter `{parameter}`: low and high are both {value}\nHint: to fix the parameter, write `value = {value:?}`"
    )]
    OneValue {
        /// The name.
        parameter: String,
        /// Both ends.
        value: f64,
    },
    /// An infinite range or a bound that is not a number.
    #[error("parameter `{parameter}`: low and high must be finite numbers")]
    NotFinite {
        /// The name.
        parameter: String,
    },
    /// A log scale with a non-positive bound.
    #[error("parameter `{parameter}`: a log scale needs low above 0 (got {low})")]
    LogOfNonPositive {
        /// The name.
        parameter: String,
        /// The lower end.
        low: f64,
    },
    /// A correlation names an unknown parameter.
    #[error("[[correlation]]: unknown parameter `{parameter}`. Expected one of: {known}")]
    UnknownInCorrelation {
        /// The name.
        parameter: String,
        /// The known names.
        known: String,
    },
    /// A correlation of an integer or categorical parameter.
    #[error("[[correlation]]: `{parameter}` is not continuous. Rank correlations need continuous parameters")]
    CorrelationOfDiscrete {
        /// The name.
        parameter: String,
    },
    /// A correlation of a parameter with itself.
    #[error("[[correlation]]: `{parameter}` is listed twice. Expected two different parameters")]
    CorrelationWithItself {
        /// The name.
        parameter: String,
    },
    /// A rank correlation out of range.
    #[error(
        "[[correlation]] of {pair}: rank {rank} is out of range: expected a number in (-1, 1)\nHint: if one parameter determines the other, remove one of them"
    )]
    CorrelationOutside {
        /// The parameters.
        pair: String,
        /// The requested rank correlation.
        rank: f64,
    },
    /// Two correlations of the same pair.
    #[error("[[correlation]] of {pair} is defined twice")]
    CorrelationTwice {
        /// The parameters.
        pair: String,
    },
    /// Correlations that contradict each other.
    #[error(
        "the correlations of {parameters} contradict each other (the matrix is not positive definite)\nHint: two parameters that are strongly correlated with a third must be correlated with each other"
    )]
    CorrelationsContradict {
        /// The parameters up to the first that contradicts the ones before it.
        parameters: String,
    },
    /// An integer range with too many values.
    #[error("parameter `{parameter}`: more than 2^32 integers. Use `kind = \"continuous\"` instead")]
    TooManyLevels {
        /// The name.
        parameter: String,
    },
    /// A categorical parameter without choices.
    #[error("parameter `{parameter}`: `choices` is empty; expected at least one")]
    NoChoices {
        /// The name.
        parameter: String,
    },
    /// A choice that is listed twice.
    #[error("parameter `{parameter}`: choice `{choice}` is listed twice")]
    DuplicateChoice {
        /// The name.
        parameter: String,
        /// The choice.
        choice: String,
    },
}

/// Describes the first invalid `[[parameter]]` table, with the line where it begins. The parser reads a tagged enum
/// from a copy without positions, so its own error has no line.
fn in_parameter(text: &str) -> Option<String> {
    #[derive(Deserialize)]
    struct Tables {
        parameter: Vec<toml::Spanned<toml::Value>>,
    }
    let tables: Tables = toml::from_str(text).ok()?;
    tables.parameter.into_iter().find_map(|table| {
        let line = text.get(..table.span().start)?.matches('\n').count() + 1;
        let mut value = table.into_inner();
        fix_kind(&mut value);
        let name = value.get("name").map_or_else(|| "without a name".to_owned(), toml::Value::to_string);
        let error = ParameterFile::deserialize(value).err()?;
        Some(format!("line {line}: [[parameter]] {name}: {}", error.message()))
    })
}

/// The space with `kind = "fixed"` in each `[[parameter]]` that has a `value` and no kind. `None` if it has no such
/// parameter, or is not valid TOML.
fn with_fixed_kinds(text: &str) -> Option<toml::Table> {
    let mut table: toml::Table = toml::from_str(text).ok()?;
    let parameters = table.get_mut("parameter")?.as_array_mut()?;
    let fixed = parameters.iter_mut().map(fix_kind).filter(|fixed| *fixed).count();
    (fixed > 0).then_some(table)
}

/// Adds the kind of a fixed parameter if it is absent. Returns whether it was added.
fn fix_kind(parameter: &mut toml::Value) -> bool {
    match parameter.as_table_mut() {
        Some(table) if table.contains_key("value") && !table.contains_key("kind") => {
            table.insert("kind".to_owned(), toml::Value::String("fixed".to_owned()));
            true
        }
        _ => false,
    }
}

/// The TOML form of a parameter space.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "ParameterSpace")]
struct SpaceFile {
    /// The space's name. The provenance records it.
    name: String,
    /// The parameters, in the order of the dictionary's columns.
    parameter: Vec<ParameterFile>,
    /// Correlations between parameters. Without this list, parameters are independent.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    correlation: Vec<Correlation>,
}

/// One `[[parameter]]` table.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
enum ParameterFile {
    /// A real number.
    Continuous {
        /// The name, with its unit.
        name: Arc<str>,
        /// Lower end.
        low: f64,
        /// Upper end.
        high: f64,
        /// The scale in which the number is uniform.
        #[serde(default)]
        scale: Scale,
    },
    /// An integer, both ends included.
    Integer {
        /// The name, with its unit.
        name: Arc<str>,
        /// Smallest value.
        low: i64,
        /// Largest value.
        high: i64,
    },
    /// One of several choices.
    Categorical {
        /// The name.
        name: Arc<str>,
        /// The choices.
        choices: Vec<Arc<str>>,
    },
    /// A parameter with one value. In TOML, `kind` can be left out.
    Fixed {
        /// The name, with its unit.
        name: Arc<str>,
        /// The value.
        value: FixedValue,
    },
}

/// The value of a fixed parameter.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
enum FixedValue {
    /// An integer. A continuous parameter needs a decimal point.
    Integer(i64),
    /// A real number.
    Number(f64),
    /// A choice.
    Category(Arc<str>),
}

impl FixedValue {
    fn domain(self) -> Domain {
        match self {
            Self::Integer(n) => Domain::Integer { low: n, high: n },
            Self::Number(x) => Domain::Continuous { low: x, high: x, scale: Scale::Linear },
            Self::Category(word) => Domain::Categorical { choices: vec![word] },
        }
    }
}

impl TryFrom<SpaceFile> for ParameterSpace {
    type Error = SpaceError;

    fn try_from(file: SpaceFile) -> Result<Self, SpaceError> {
        let parameters = file
            .parameter
            .into_iter()
            .map(|parameter| {
                Ok(match parameter {
                    ParameterFile::Continuous { name, low, high, .. } if low == high => {
                        return Err(SpaceError::OneValue { parameter: name.to_string(), value: low });
                    }
                    ParameterFile::Continuous { name, low, high, scale } => {
                        Parameter { name, domain: Domain::Continuous { low, high, scale } }
                    }
                    ParameterFile::Integer { name, low, high } => {
                        Parameter { name, domain: Domain::Integer { low, high } }
                    }
                    ParameterFile::Categorical { name, choices } => {
                        Parameter { name, domain: Domain::Categorical { choices } }
                    }
                    ParameterFile::Fixed { name, value } => Parameter { name, domain: value.domain() },
                })
            })
            .collect::<Result<_, _>>()?;
        Self::new(file.name, parameters)?.with_correlations(file.correlation)
    }
}

impl From<ParameterSpace> for SpaceFile {
    fn from(space: ParameterSpace) -> Self {
        let parameter = space
            .parameters
            .into_iter()
            .map(|Parameter { name, domain }| match domain {
                Domain::Continuous { low, high, .. } if low == high => {
                    ParameterFile::Fixed { name, value: FixedValue::Number(low) }
                }
                Domain::Continuous { low, high, scale } => ParameterFile::Continuous { name, low, high, scale },
                Domain::Integer { low, high } => ParameterFile::Integer { name, low, high },
                Domain::Categorical { choices } => ParameterFile::Categorical { name, choices },
            })
            .collect();
        Self { name: space.name, parameter, correlation: space.correlations }
    }
}
