//! Scenarios: one assignment of values to the parameters of a space.

use std::fmt;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Seed;

/// The value of one parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Value {
    /// An integer parameter's value.
    Integer(i64),
    /// A continuous parameter's value, in the unit that ends the parameter's name.
    Number(f64),
    /// A categorical parameter's value.
    Category(Arc<str>),
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Integer(n) => n.fmt(f),
            Self::Number(x) => x.fmt(f),
            Self::Category(word) => word.fmt(f),
        }
    }
}

/// Parameter names and their values, in the order of the space they come from.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Assignment(Vec<(Arc<str>, Value)>);

impl Assignment {
    /// The value of `name`, if assigned.
    pub fn get(&self, name: &str) -> Option<&Value> {
        self.0.iter().find(|(n, _)| &**n == name).map(|(_, v)| v)
    }

    /// The value of `name` as a number (an integer counts as one).
    pub fn number(&self, name: &str) -> Option<f64> {
        match self.get(name)? {
            Value::Number(x) => Some(*x),
            Value::Integer(n) => Some(*n as f64),
            Value::Category(_) => None,
        }
    }

    /// The value of `name` as a category.
    pub fn category(&self, name: &str) -> Option<&str> {
        match self.get(name)? {
            Value::Category(word) => Some(word),
            Value::Integer(_) | Value::Number(_) => None,
        }
    }

    /// Iterates over names and values in order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Value)> {
        self.0.iter().map(|(name, value)| (&**name, value))
    }

    /// The number of assigned parameters.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether no parameter is assigned.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Assigns `value` to `name`. An existing parameter keeps its position.
    pub fn set(&mut self, name: impl Into<Arc<str>>, value: Value) {
        let name = name.into();
        match self.0.iter_mut().find(|(n, _)| *n == name) {
            Some((_, old)) => *old = value,
            None => self.0.push((name, value)),
        }
    }
}

impl FromIterator<(Arc<str>, Value)> for Assignment {
    fn from_iter<I: IntoIterator<Item = (Arc<str>, Value)>>(pairs: I) -> Self {
        Self(pairs.into_iter().collect())
    }
}

/// The parameter values that an environment must set up, and the seed of everything else that is random.
#[derive(Debug, Clone, PartialEq)]
pub struct Scenario {
    /// The episode's index in its campaign.
    pub index: u64,
    /// The seed of this episode's randomness.
    pub seed: Seed,
    /// The requested parameter values.
    pub requested: Assignment,
}
