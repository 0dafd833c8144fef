//! What is measured during an episode.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::Word;

/// Measured values by name. A name that is absent was not measured. The order in which they were set is kept, and does
/// not matter for equality.
#[derive(Debug, Clone, Default)]
pub struct Measures(Vec<(Word, f64)>);

impl PartialEq for Measures {
    fn eq(&self, other: &Self) -> bool {
        self.len() == other.len() && self.0.iter().all(|(name, value)| other.get(name.as_str()) == Some(*value))
    }
}

impl Measures {
    /// The value of a measure, if it was measured.
    pub fn get(&self, name: &str) -> Option<f64> {
        self.0.iter().find(|(known, _)| *known == name).map(|(_, value)| *value)
    }

    /// Sets a measure; `None` takes it away.
    pub fn set(&mut self, name: Word, value: Option<f64>) {
        let at = self.0.iter().position(|(known, _)| *known == name);
        match (at, value) {
            (Some(at), Some(value)) => self.0[at].1 = value,
            (Some(at), None) => drop(self.0.remove(at)),
            (None, Some(value)) => self.0.push((name, value)),
            (None, None) => {}
        }
    }

    /// Names and values.
    pub fn iter(&self) -> impl Iterator<Item = (Word, f64)> {
        self.0.iter().copied()
    }

    /// How many were measured.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether nothing was measured.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

impl FromIterator<(Word, Option<f64>)> for Measures {
    fn from_iter<I: IntoIterator<Item = (Word, Option<f64>)>>(values: I) -> Self {
        let mut measures = Self::default();
        values.into_iter().for_each(|(name, value)| measures.set(name, value));
        measures
    }
}

/// A map from name to number.
impl Serialize for Measures {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.iter())
    }
}

/// A map from name to number; null is a measure without a value.
impl<'de> Deserialize<'de> for Measures {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let map = std::collections::BTreeMap::<Word, Option<f64>>::deserialize(deserializer)?;
        // The names of a map differ already.
        Ok(Self(map.into_iter().filter_map(|(name, value)| Some((name, value?))).collect()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absent_is_not_zero() {
        let (slip, force) = (Word::constant("slip_m"), Word::constant("force_n"));
        let mut measures: Measures = [(slip, Some(0.1)), (force, None)].into_iter().collect();
        assert_eq!((measures.get("slip_m"), measures.get("force_n"), measures.len()), (Some(0.1), None, 1));
        measures.set(slip, None);
        assert!(measures.is_empty());
        let read: Measures = serde_json::from_str(r#"{"slip_m": null, "force_n": 2}"#).unwrap();
        assert_eq!(read, [(force, Some(2.0))].into_iter().collect());
    }
}
