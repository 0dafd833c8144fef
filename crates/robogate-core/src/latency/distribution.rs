//! Distributions of latencies.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::MOST_LATENCY_S;
use crate::Stream;

/// The latency of each request, in seconds. Samples are limited to the range from 0 to [`MOST_LATENCY_S`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Latency {
    /// The same latency for every request.
    Fixed {
        /// The latency.
        seconds: f64,
    },
    /// Uniformly distributed.
    Uniform {
        /// Lower end.
        low_s: f64,
        /// Upper end.
        high_s: f64,
    },
    /// Normally distributed. Negative samples become 0.
    Normal {
        /// Mean.
        mean_s: f64,
        /// Standard deviation.
        sd_s: f64,
    },
    /// Gamma distributed: positive, with a long tail of slow requests.
    Gamma {
        /// Mean.
        mean_s: f64,
        /// Standard deviation.
        sd_s: f64,
    },
    /// Sampled with replacement from measured latencies. A dependence between consecutive requests is lost.
    Measured {
        /// The measured latencies.
        samples_s: Vec<f64>,
    },
    /// The value of the parameter [`LATENCY_PARAMETER`](super::LATENCY_PARAMETER) of the scenario.
    Parameter,
}

/// The reason why a latency is invalid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LatencyError {
    /// A number is out of range.
    #[error("{name} {value} s is out of range: expected 0 to {MOST_LATENCY_S} s")]
    OutOfRange {
        /// The name of the number.
        name: &'static str,
        /// The value.
        value: f64,
    },
    /// The ends of a range are in the wrong order.
    #[error("the range {low} s to {high} s is not valid: expected numbers in increasing order")]
    Order {
        /// Lower end.
        low: f64,
        /// Upper end.
        high: f64,
    },
    /// A distribution without a positive mean and standard deviation.
    #[error("a gamma distribution needs a mean and a standard deviation above 0")]
    Gamma,
    /// No measured latency.
    #[error("there is no measured latency")]
    NoSamples,
}

impl Latency {
    /// Checks the numbers.
    pub fn check(&self) -> Result<(), LatencyError> {
        let within = |name: &'static str, value: f64| match (0.0..=MOST_LATENCY_S).contains(&value) {
            true => Ok(()),
            false => Err(LatencyError::OutOfRange { name, value }),
        };
        match self {
            Self::Fixed { seconds } => within("the latency", *seconds),
            Self::Uniform { low_s, high_s } => {
                within("the lower end", *low_s)?;
                within("the upper end", *high_s)?;
                if low_s > high_s { Err(LatencyError::Order { low: *low_s, high: *high_s }) } else { Ok(()) }
            }
            Self::Normal { mean_s, sd_s } | Self::Gamma { mean_s, sd_s } => {
                within("the mean", *mean_s)?;
                within("the standard deviation", *sd_s)?;
                let positive = *mean_s > 0.0 && *sd_s > 0.0;
                if matches!(self, Self::Gamma { .. }) && !positive { Err(LatencyError::Gamma) } else { Ok(()) }
            }
            Self::Measured { samples_s } if samples_s.is_empty() => Err(LatencyError::NoSamples),
            Self::Measured { samples_s } => {
                samples_s.iter().try_for_each(|sample| within("a measured latency", *sample))
            }
            Self::Parameter => Ok(()),
        }
    }

    /// Draws the latency of one request, in seconds. `parameter_s` is the value of the scenario's parameter.
    pub(super) fn sample(&self, stream: &mut Stream, parameter_s: f64) -> f64 {
        let sample = match self {
            Self::Fixed { seconds } => *seconds,
            Self::Uniform { low_s, high_s } => stream.between(*low_s, *high_s),
            Self::Normal { mean_s, sd_s } => mean_s + sd_s * stream.normal(),
            Self::Gamma { mean_s, sd_s } => gamma(stream, (mean_s / sd_s).powi(2)) * sd_s * sd_s / mean_s,
            Self::Measured { samples_s } => samples_s.get(stream.below(samples_s.len())).copied().unwrap_or_default(),
            Self::Parameter => parameter_s,
        };
        sample.clamp(0.0, MOST_LATENCY_S)
    }
}

/// A gamma number with this shape and scale 1 (Marsaglia and Tsang 2000; shapes below 1 with their boost).
fn gamma(stream: &mut Stream, shape: f64) -> f64 {
    if shape < 1.0 {
        let boost = (1.0 - stream.uniform()).powf(1.0 / shape);
        return gamma(stream, shape + 1.0) * boost;
    }
    let d = shape - 1.0 / 3.0;
    let c = 1.0 / (9.0 * d).sqrt();
    loop {
        let x = stream.normal();
        let v = (1.0 + c * x).powi(3);
        if v > 0.0 && (1.0 - stream.uniform()).ln() < 0.5 * x * x + d - d * v + d * v.ln() {
            return d * v;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Seed;

    #[test]
    fn samples_have_mean_and_deviation() {
        let moments = |latency: Latency| {
            let mut stream = Seed::campaign(5).stream("test");
            let samples: Vec<f64> = (0..20_000).map(|_| latency.sample(&mut stream, 0.3)).collect();
            let mean = samples.iter().sum::<f64>() / 20_000.0;
            let variance = samples.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 20_000.0;
            (mean, variance.sqrt())
        };
        for (latency, mean, sd) in [
            (Latency::Fixed { seconds: 0.08 }, 0.08, 0.0),
            (Latency::Parameter, 0.3, 0.0),
            (Latency::Uniform { low_s: 0.1, high_s: 0.3 }, 0.2, 0.2 / 12f64.sqrt()),
            (Latency::Normal { mean_s: 0.2, sd_s: 0.03 }, 0.2, 0.03),
            (Latency::Gamma { mean_s: 0.2, sd_s: 0.05 }, 0.2, 0.05),
            (Latency::Gamma { mean_s: 0.1, sd_s: 0.2 }, 0.1, 0.2),
            (Latency::Measured { samples_s: vec![0.1, 0.3] }, 0.2, 0.1),
        ] {
            latency.check().unwrap();
            let (found_mean, found_sd) = moments(latency.clone());
            // More than five standard errors of each figure.
            assert!((found_mean - mean).abs() < 0.04 * sd + 1e-9, "{latency:?} {found_mean}");
            assert!((found_sd - sd).abs() < 0.1 * sd + 1e-9, "{latency:?} {found_sd}");
        }
    }

    #[test]
    fn wrong_numbers_are_rejected() {
        for latency in [
            Latency::Fixed { seconds: f64::NAN },
            Latency::Fixed { seconds: 11.0 },
            Latency::Uniform { low_s: 0.3, high_s: 0.1 },
            Latency::Normal { mean_s: -0.1, sd_s: 0.1 },
            Latency::Gamma { mean_s: 0.1, sd_s: 0.0 },
            Latency::Measured { samples_s: Vec::new() },
        ] {
            assert!(latency.check().is_err(), "{latency:?}");
        }
    }
}
