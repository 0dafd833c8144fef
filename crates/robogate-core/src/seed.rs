//! Reproducible randomness.
//!
//! A [`Seed`] identifies a campaign and, within it, an episode. A [`Stream`] is derived from a seed for one named
//! purpose ("encoder-bias", "obstacles", ...), which keeps the numbers of one purpose independent of all others.
//! Streams are ChaCha8 keyed by (campaign, episode, purpose): no two share a key, and the order of creation has no
//! effect.

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};

/// The source of an episode's randomness: it depends only on the campaign's seed and the episode's index.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Seed {
    campaign: u64,
    episode: Option<u64>,
}

impl Seed {
    /// The seed of a campaign. Designs are drawn from it.
    pub fn campaign(campaign: u64) -> Self {
        Self { campaign, episode: None }
    }

    /// The seed of episode `index` of the same campaign.
    pub fn episode(self, index: u64) -> Self {
        Self { campaign: self.campaign, episode: Some(index) }
    }

    /// The number that the user chose for the campaign.
    pub fn campaign_number(self) -> u64 {
        self.campaign
    }

    /// Creates the stream of random numbers for one purpose. The same (seed, purpose) gives the same stream.
    pub fn stream(self, purpose: &str) -> Stream {
        let mut key = [0_u8; 32];
        key[..8].copy_from_slice(&self.campaign.to_le_bytes());
        // A marker distinguishes the campaign from its episodes, so no episode index is reserved.
        key[8..16].copy_from_slice(&self.episode.unwrap_or(0).to_le_bytes());
        key[16] = u8::from(self.episode.is_some());
        key[24..].copy_from_slice(&fnv1a(purpose.as_bytes()).to_le_bytes());
        Stream(ChaCha8Rng::from_seed(key))
    }
}

/// FNV-1a, 64 bit (Fowler, Noll, Vo): a fixed, platform-independent hash of short labels.
fn fnv1a(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3))
}

/// A reproducible stream of random numbers.
#[derive(Debug, Clone)]
pub struct Stream(ChaCha8Rng);

impl Stream {
    /// Draws the next 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// Draws a uniform number in [0, 1), a multiple of 2^-53.
    pub fn uniform(&mut self) -> f64 {
        const SCALE: f64 = 1.0 / (1_u64 << 53) as f64;
        (self.bits() >> 11) as f64 * SCALE
    }

    /// Draws a standard normal number (Box and Muller 1958).
    pub fn normal(&mut self) -> f64 {
        // 1 - u is in (0, 1].
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    /// Draws a uniform number in [low, high).
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Draws a uniform integer in 0..n without bias (rejection). Returns 0 if n is 0.
    pub fn below(&mut self, n: usize) -> usize {
        let n = n as u64;
        if n < 2 {
            return 0;
        }
        // The largest multiple of n that fits. Draws beyond it would favour small remainders.
        let limit = u64::MAX - u64::MAX % n;
        loop {
            let draw = self.bits();
            if draw < limit {
                return (draw % n) as usize;
            }
        }
    }

    /// Shuffles `items` uniformly (Fisher and Yates).
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for last in (1..items.len()).rev() {
            let other = self.below(last + 1);
            items.swap(last, other);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn same_purpose_repeats() {
        let seed = Seed::campaign(2026).episode(7);
        let draw = |seed: Seed, purpose| seed.stream(purpose).bits();
        assert_eq!(draw(seed, "obstacles"), draw(seed, "obstacles"));
        assert_ne!(draw(seed, "obstacles"), draw(seed, "encoder-bias"));
        assert_ne!(draw(seed, "obstacles"), draw(Seed::campaign(2026).episode(8), "obstacles"));
        assert_ne!(draw(seed, "obstacles"), draw(Seed::campaign(2027).episode(7), "obstacles"));
    }

    #[test]
    fn episode_zero_differs_from_campaign() {
        let campaign = Seed::campaign(1);
        assert_ne!(campaign.stream("x").bits(), campaign.episode(0).stream("x").bits());
    }

    #[test]
    fn below_is_uniform() {
        let mut stream = Seed::campaign(3).stream("below");
        let mut counts = [0_u32; 6];
        for _ in 0..60_000 {
            counts[stream.below(6)] += 1;
        }
        // Six cells of 10,000 +- 91 (one standard deviation). The tolerance is five standard deviations.
        assert!(counts.iter().all(|c| c.abs_diff(10_000) < 456), "{counts:?}");
    }
}
