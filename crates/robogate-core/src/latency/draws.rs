//! The hidden draws of an episode whose latencies are sampled: those of its first requests.
//!
//! The number of requests depends on the course of an episode. The draws describe a fixed number of them, so they follow from the seed
//! of the episode and are known before it runs.

use super::Latency;
use crate::{Better, DrawSpec, FeatureSpec, Measures, Seed, Stream, Word};

/// The number of requests that the draws describe: the first ones of the episode, also if it ends before it has made them all.
pub(super) const REQUESTS: usize = 10;

const FIRST: Word = Word::constant("inference_latency_first_s");
const MEAN: Word = Word::constant("inference_latency_mean_s");
const LONGEST: Word = Word::constant("inference_latency_longest_s");

/// The features of a risk model. They make no claim, because a longer latency does not always make success less likely.
static FEATURES: [FeatureSpec; 2] = [
    FeatureSpec {
        name: MEAN.as_str(),
        unit: "s",
        meaning: "Mean inference latency of the first requests.",
        better: Better::Neither,
    },
    FeatureSpec {
        name: LONGEST.as_str(),
        unit: "s",
        meaning: "Longest inference latency of the first requests.",
        better: Better::Neither,
    },
];

/// The latencies of the first [`REQUESTS`] requests of an episode, in seconds.
struct FirstRequests {
    first_s: f64,
    mean_s: f64,
    longest_s: f64,
}

/// The random stream of an episode from which its requests sample their latencies, one after the other.
pub(super) fn stream(seed: Seed) -> Stream {
    seed.stream("inference-latency")
}

impl Latency {
    /// The declarations of the hidden draws of an episode. Empty unless each request samples its latency.
    pub fn draw_specs(&self) -> Vec<DrawSpec> {
        if !self.is_sampled() {
            return Vec::new();
        }
        let spec = |name: Word, meaning: String| DrawSpec { name, unit: "s".to_owned(), meaning };
        vec![
            spec(FIRST, "Inference latency of the first request.".to_owned()),
            spec(MEAN, format!("Mean inference latency of the first {REQUESTS} requests.")),
            spec(LONGEST, format!("Longest inference latency of the first {REQUESTS} requests.")),
        ]
    }

    /// The hidden draws of the episode with this seed, in seconds. Empty unless each request samples its latency.
    pub fn draws(&self, seed: Seed) -> Measures {
        let Some(FirstRequests { first_s, mean_s, longest_s }) = self.first_requests(seed) else {
            return Measures::default();
        };
        [(FIRST, Some(first_s)), (MEAN, Some(mean_s)), (LONGEST, Some(longest_s))].into_iter().collect()
    }

    /// The features of [`Self::features`].
    pub(super) fn feature_specs(&self) -> &'static [FeatureSpec] {
        if self.is_sampled() { &FEATURES } else { &[] }
    }

    /// The features of the episode with this seed, in the order of [`Self::feature_specs`].
    pub(super) fn features(&self, seed: Seed) -> Vec<f64> {
        self.first_requests(seed).map_or_else(Vec::new, |of| vec![of.mean_s, of.longest_s])
    }

    /// Whether each request samples its latency.
    fn is_sampled(&self) -> bool {
        match self {
            Self::Uniform { .. } | Self::Normal { .. } | Self::Gamma { .. } | Self::Measured { .. } => true,
            Self::Fixed { .. } | Self::Parameter => false,
        }
    }

    /// `None` unless each request samples its latency.
    fn first_requests(&self, seed: Seed) -> Option<FirstRequests> {
        if !self.is_sampled() {
            return None;
        }
        let mut stream = stream(seed);
        // The parameter of the scenario has no effect on a sampled latency.
        let latencies: [f64; REQUESTS] = std::array::from_fn(|_| self.sample(&mut stream, 0.0));
        Some(FirstRequests {
            first_s: latencies[0],
            mean_s: latencies.iter().sum::<f64>() / REQUESTS as f64,
            longest_s: latencies.into_iter().fold(0.0, f64::max),
        })
    }
}
