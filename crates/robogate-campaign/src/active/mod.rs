//! The active stage: rounds that sample where the outcome is least certain, or where a rare failure mode is likely.
//!
//! The uniform stage comes first. Then each round fits a risk model to all episodes so far, and samples the next ones.
//! Episode i, whose seed determines its hidden draws, chooses one of M candidates from the operating distribution. With
//! the uniform share a as probability it takes the first one, and otherwise candidate j in proportion to its score s_j:
//!
//! ```text
//! s = p (1 - p)   p: predicted chance of success of the candidate's parameters *and the draws of this episode*
//! s = p           p: predicted chance of the failure mode that the plan seeks
//! ```
//!
//! The candidates are exchangeable, so the first one is as good as a random one, and the probability of candidate j is
//!
//! ```text
//! pi_j = a/M + (1 - a) s_j / (s_1 + ... + s_M).
//! ```
//!
//! The weight of the episode is 1/(M pi_j), at most 1/a. Given everything before, the expected value of weight times outcome is
//! the mean outcome over the operating distribution, so weighted means are unbiased, although the model depends on earlier
//! outcomes. Source: sampling-importance-resampling (Rubin 1987) with one draw per set of candidates; defensive mixtures
//! (Hesterberg 1995).
//!
//! Whether an episode takes the first candidate depends on its seed alone. These episodes (design `uniform`) are therefore a
//! sample from the operating distribution without weights. Everything that cannot weight rows uses them and the uniform stage.
//!
//! If the plan states an error of the model ([`ActiveStage::until_rms`]), a share of each round are pairs: two episodes
//! with the same parameters, from the operating distribution, and different seeds. Pairs never enter the model. They bound
//! its error ([`robogate_stats::model_error`]), and the stage ends when the bound reaches the stated error.
//!
//! The points of a round depend on the plan and on the recorded episodes of earlier rounds only, so a run that was
//! interrupted chooses the same ones. A model that cannot be fitted makes its round uniform.

mod chooser;
mod report;
mod stage;

pub(crate) use chooser::{Chooser, Chosen, Opened};
pub use report::{ActiveReport, ActiveRound, Certificate, ModelScore};
pub use stage::ActiveStage;

#[cfg(test)]
mod tests {
    use robogate_core::{Seed, Stream};
    use robogate_stats::{Confidence, weighted::hajek};

    use super::chooser::chances;
    use super::*;

    #[test]
    fn rounds_grow_to_the_budget() {
        let rounds = ActiveStage::new(1500).rounds(500);
        let sizes: Vec<u64> = rounds.iter().map(|round| round.end - round.start).collect();
        assert_eq!(sizes, [250, 375, 563, 312]);
        assert_eq!((rounds[0].start, rounds[3].end), (500, 2000));
        assert!(ActiveStage::new(0).rounds(10).is_empty());
        assert_eq!(ActiveStage::new(70).rounds(4), [4..24, 24..54, 54..74]);
    }

    #[test]
    fn settings_are_checked() {
        assert_eq!(ActiveStage::new(10).problem(), None);
        let bad = |change: fn(&mut ActiveStage)| {
            let mut stage = ActiveStage::new(10);
            change(&mut stage);
            stage.problem().map(|(key, ..)| key)
        };
        assert_eq!(bad(|s| s.growth = 0.5), Some("active.growth"));
        assert_eq!(bad(|s| s.uniform_share = 0.0), Some("active.uniform_share"));
        assert_eq!(bad(|s| s.candidates = 1), Some("active.candidates"));
        assert_eq!(bad(|s| s.until_rms = Some(f64::NAN)), Some("active.until_rms"));
        assert_eq!(bad(|s| s.pair_share = 0.6), Some("active.pair_share"));
    }

    #[test]
    fn chances_are_probabilities() {
        let found = chances(&[0.0, 0.25, 0.25], 0.3);
        for (found, expected) in found.iter().zip([0.1, 0.45, 0.45]) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
        assert!(chances(&[0.0; 4], 0.3).iter().all(|chance| (chance - 0.25).abs() < 1e-12));
    }

    /// Samples 1 of 16 candidates by a wrong model that learns from earlier outcomes, 500 times with 300 episodes. The
    /// weighted rate is unbiased, and its interval covers the true rate.
    #[test]
    fn weighted_rate_is_unbiased_and_covers() {
        // Failures are rare below 0.8 and frequent above: the true rate is 0.8 x 0.98 + 0.2 x 0.3.
        let truth = 0.8 * 0.98 + 0.2 * 0.3;
        let p = |x: f64| if x < 0.8 { 0.98 } else { 0.3 };
        let (runs, mut sum, mut covered, mut kish) = (500, 0.0, 0, 0.0);
        for run in 0..runs {
            let mut stream: Stream = Seed::campaign(run).stream("coverage");
            let (mut outcomes, mut weights) = (Vec::new(), Vec::new());
            // The model: the failure rate above and below 0.7 so far, which is wrong on purpose.
            let mut counts = [[1.0_f64, 2.0]; 2];
            for _ in 0..300 {
                let xs: Vec<f64> = (0..16).map(|_| stream.uniform()).collect();
                let score = |x: &f64| {
                    let [failures, all] = counts[usize::from(*x > 0.7)];
                    let q = failures / all;
                    q * (1.0 - q)
                };
                let chances = chances(&xs.iter().map(score).collect::<Vec<_>>(), 0.25);
                let mut left = stream.uniform();
                let at = chances
                    .iter()
                    .position(|chance| {
                        left -= chance;
                        left < 0.0
                    })
                    .unwrap_or(15);
                let success = stream.uniform() < p(xs[at]);
                let count = &mut counts[usize::from(xs[at] > 0.7)];
                *count = [count[0] + f64::from(u8::from(!success)), count[1] + 1.0];
                outcomes.push(success);
                weights.push(1.0 / (16.0 * chances[at]));
            }
            let found = hajek(&outcomes, &weights, Confidence::P95).unwrap();
            sum += found.rate.unwrap() - truth;
            covered += usize::from(found.interval.low <= truth && truth <= found.interval.high);
            kish += found.effective;
        }
        let bias = sum / runs as f64;
        assert!(bias.abs() < 0.004, "bias {bias}");
        assert!(covered as f64 >= 0.93 * runs as f64, "{covered} of {runs}");
        assert!(kish / runs as f64 > 100.0);
    }
}
