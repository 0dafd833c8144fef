//! Measured values of an episode.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::Word;

/// Measured values by name. An absent name was not measured. Insertion order is kept and does not affect equality.
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

    /// Sets a measure. `None` removes it.
    pub fn set(&mut self, name: Word, value: Option<f64>) {
        let at = self.0.iter().position(|(known, _)| *known == name);
        match (at, value) {
            (Some(at), Some(value)) => self.0[at].1 = value,
            (Some(at), None) => drop(self.0.remove(at)),
            (None, Some(value)) => self.0.push((name, value)),
            (None, None) => {}
        }
    }

    /// Iterates over names and values.
    pub fn iter(&self) -> impl Iterator<Item = (Word, f64)> {
        self.0.iter().copied()
    }

    /// The number of measures.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there are no measures.
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

/// Serializes as a map from name to number.
impl Serialize for Measures {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.iter())
    }
}

/// Deserializes a map from name to number. Null stands for a measure without a value.
impl<'de> Deserialize<'de> for Measures {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let map = std::collections::BTreeMap::<Word, Option<f64>>::deserialize(deserializer)?;
        // The keys of a map are already distinct.
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
