//! A limit on the new recipes of each sender: one that sends invented names must not use up the places of
//! real recipes.

use std::collections::BTreeMap;
use std::time::Instant;

/// Most senders that are followed. The oldest is forgotten.
const MOST_SENDERS: usize = 10_000;

/// The error for a recipe beyond the limit.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "recipe `{recipe}` is new, and this sender may add {per_hour} recipes in an hour\nHint: increase `new_recipes_per_hour`, or \
     remove invented names: robogate monitor recipes remove"
)]
pub(super) struct TooManyNew {
    pub(super) recipe: String,
    pub(super) per_hour: u32,
}

/// The new recipes that each sender may still add.
#[derive(Debug)]
pub(super) struct Newcomers {
    per_hour: u32,
    left: BTreeMap<String, (f64, Instant)>,
}

impl Newcomers {
    pub(super) fn new(per_hour: u32) -> Self {
        Self { per_hour, left: BTreeMap::new() }
    }

    /// Lets a sender add this recipe now.
    pub(super) fn admit(&mut self, sender: &str, recipe: &str, now: Instant) -> Result<(), TooManyNew> {
        let most = f64::from(self.per_hour);
        if self.left.len() >= MOST_SENDERS && !self.left.contains_key(sender) {
            let oldest = self.left.iter().min_by_key(|(_, (_, since))| *since).map(|(name, _)| name.clone());
            oldest.and_then(|name| self.left.remove(&name));
        }
        let (left, since) = self.left.entry(sender.to_owned()).or_insert((most, now));
        *left = (*left + now.saturating_duration_since(*since).as_secs_f64() * most / 3_600.0).min(most);
        *since = now;
        if *left < 1.0 {
            return Err(TooManyNew { recipe: recipe.to_owned(), per_hour: self.per_hour });
        }
        *left -= 1.0;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn each_sender_has_its_own_limit() {
        let (mut newcomers, begin) = (Newcomers::new(60), Instant::now());
        let mut admitted = |sender: &str, after_s: u64| {
            let now = begin + Duration::from_secs(after_s);
            (0..1_000).filter(|n| newcomers.admit(sender, &n.to_string(), now).is_ok()).count()
        };
        assert_eq!(admitted("a", 0), 60);
        assert_eq!(admitted("b", 0), 60);
        assert_eq!(admitted("a", 60), 1);
        assert_eq!(admitted("a", 7_260), 60);
    }
}
