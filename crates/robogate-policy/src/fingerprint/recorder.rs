//! Chooses requests of a campaign.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use super::MOST_PROBES;
use crate::query::Query;

/// Most bytes of all requests together.
const MOST_BYTES: usize = 24 << 20;

/// Keeps the requests with the smallest keys. Keys that follow from seeds make the choice independent of threads and order.
#[derive(Debug, Clone, Default)]
pub struct Recorder(Arc<Mutex<Kept>>);

#[derive(Debug, Default)]
struct Kept {
    queries: BTreeMap<u64, Query>,
    bytes: usize,
}

impl Recorder {
    /// Keeps a request if its key is one of the smallest.
    pub(crate) fn offer(&self, key: u64, query: &Query) {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let kept = &mut *kept;
        let full = kept.queries.len() >= MOST_PROBES;
        if full && kept.queries.last_key_value().is_some_and(|(last, _)| *last <= key)
            || kept.queries.contains_key(&key)
        {
            return;
        }
        kept.queries.insert(key, query.clone());
        kept.bytes += bytes(query);
        while kept.queries.len() > MOST_PROBES || (kept.bytes > MOST_BYTES && kept.queries.len() > 1) {
            let Some((_, dropped)) = kept.queries.pop_last() else { return };
            kept.bytes -= bytes(&dropped);
        }
    }

    /// The number of kept requests.
    pub fn kept(&self) -> usize {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).queries.len()
    }

    /// Takes the kept requests, in the order of their keys.
    pub fn take(&self) -> Vec<Query> {
        let kept = std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner));
        kept.queries.into_values().collect()
    }
}

fn bytes(query: &Query) -> usize {
    query.images.iter().chain(&query.states).map(|(_, array)| array.data().len()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::array::{Array, Dtype};

    fn query(step: u64, bytes: usize) -> Query {
        let image = Array::new(Dtype::U8, vec![bytes], vec![0; bytes]).unwrap();
        let images = vec![("front".to_owned(), image)];
        Query { images, states: Vec::new(), instruction: String::new(), step, time_s: 0.0 }
    }

    fn kept(keys: impl Iterator<Item = u64>, bytes: usize) -> Vec<u64> {
        let recorder = Recorder::default();
        keys.for_each(|key| recorder.offer(key, &query(key, bytes)));
        recorder.take().iter().map(|query| query.step).collect()
    }

    #[test]
    fn order_has_no_effect() {
        let expected: Vec<u64> = (0..MOST_PROBES as u64).collect();
        assert_eq!(kept(0..500, 3), expected);
        assert_eq!(kept((0..500).rev(), 3), expected);
    }

    #[test]
    fn large_requests_are_fewer() {
        assert_eq!(kept((0..40).rev(), 4 << 20), [0, 1, 2, 3, 4, 5]);
        assert_eq!(kept(0..3, MOST_BYTES + 1), [0]);
    }
}
