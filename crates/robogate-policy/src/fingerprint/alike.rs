//! Compares the answers of several servers of one policy.

use super::{Asked, Fingerprint, admit, difference};
use crate::chunk::Chunk;
use crate::error::PolicyError;

/// How the answers of a server compare with those of the first one.
#[derive(Debug, Clone, PartialEq)]
pub struct Likeness {
    /// The largest difference of an answer, in spreads of its number. `None` for a policy with random answers.
    pub largest: Option<f64>,
    /// For random answers: the p-value of the hypothesis that both servers have the same distribution of answers.
    pub p_value: Option<f64>,
    /// The difference in words. `None` if both answer alike.
    pub difference: Option<String>,
}

impl Fingerprint {
    /// Asks another server of the same policy the requests of this fingerprint, which has the answers of the first server.
    ///
    /// # Errors
    /// If the server does not answer.
    pub fn compare(&self, server: &mut dyn Asked) -> Result<Likeness, PolicyError> {
        if self.is_random() {
            let admission = admit(self, server)?;
            let difference = (!admission.is_admitted()).then(|| admission.differences.join("; "));
            return Ok(Likeness { largest: None, p_value: admission.p_value, difference });
        }
        let answers: Vec<Chunk> = self.probes.iter().map(|probe| server.ask(&probe.query)).collect::<Result<_, _>>()?;
        let spreads = self.spreads();
        let each =
            self.probes.iter().zip(&answers).map(|(probe, answer)| difference(&probe.answers[0], answer, &spreads));
        let largest = each.fold(0.0, f64::max);
        let difference = (largest > self.tolerance()).then(|| self.farthest(&answers, &spreads));
        Ok(Likeness { largest: Some(largest), p_value: None, difference })
    }

    /// The number that differs most, in words.
    fn farthest(&self, answers: &[Chunk], spreads: &[f64]) -> String {
        let size = |chunk: &Chunk| [chunk.rows().len(), chunk.rows().first().map_or(0, Vec::len)];
        let mut worst = (-1.0, String::new());
        for (request, (probe, answer)) in self.probes.iter().zip(answers).enumerate() {
            let [first, other] = [&probe.answers[0], answer].map(size);
            if first != other {
                return format!(
                    "an answer has {} actions of {} numbers in place of {} of {}",
                    other[0], other[1], first[0], first[1]
                );
            }
            for (row, (a, b)) in probe.answers[0].rows().iter().zip(answer.rows()).enumerate() {
                for (at, ((a, b), spread)) in a.iter().zip(b).zip(spreads).enumerate() {
                    // A number that is not finite is the largest difference.
                    let apart = Some((a - b).abs() / spread).filter(|apart| !apart.is_nan()).unwrap_or(f64::INFINITY);
                    if apart > worst.0 {
                        let (number, action, request) = (at + 1, row + 1, request + 1);
                        worst = (
                            apart,
                            format!(
                                "number {number} of action {action} of answer {request} is {b:.4} in place of {a:.4}"
                            ),
                        );
                    }
                }
            }
        }
        worst.1
    }
}
