//! The queue of actions between a policy and a robot.

use std::collections::VecDeque;
use std::f64::consts::E;

use super::ExecutionMode;
use crate::{PredictedStep, Prediction};

/// The share of the old action where two chunks overlap in [`ExecutionMode::Queue`].
const OLD_SHARE: f64 = 0.3;
/// The share of a chunk below which [`ExecutionMode::Queue`] requests the next one.
const REQUEST_BELOW: f64 = 0.5;

/// Steps that the robot will execute.
#[derive(Debug, Default)]
pub(super) struct Queue {
    mode: ExecutionMode,
    steps: VecDeque<PredictedStep>,
    /// Steps of the last chunk, and of its executed part.
    length: usize,
    execute: usize,
    /// Steps that were executed since the last request.
    executed: usize,
}

impl Queue {
    pub(super) fn new(mode: ExecutionMode) -> Self {
        Self { mode, ..Self::default() }
    }

    pub(super) fn clear(&mut self) {
        *self = Self::new(self.mode);
    }

    /// Whether the next request is due, if none is in progress.
    pub(super) fn is_due(&self) -> bool {
        match self.mode {
            ExecutionMode::Hold => self.steps.is_empty(),
            ExecutionMode::Queue => self.steps.len() as f64 <= REQUEST_BELOW * self.length as f64,
            ExecutionMode::Overlap => self.steps.is_empty() || self.executed >= self.execute,
        }
    }

    /// Starts a request.
    pub(super) fn requested(&mut self) {
        self.executed = 0;
    }

    /// The next step.
    pub(super) fn pop(&mut self) -> Option<PredictedStep> {
        let step = self.steps.pop_front()?;
        self.executed += 1;
        Some(step)
    }

    /// Adds a chunk. Its steps begin at the time of the request; those of the past are left out.
    pub(super) fn merge(&mut self, prediction: Prediction) {
        let mut steps = VecDeque::from(prediction.steps);
        self.length = steps.len();
        self.execute = prediction.execute.clamp(1, steps.len().max(1));
        if self.mode == ExecutionMode::Hold {
            steps.truncate(self.execute);
        } else {
            // A robot that holds its position executes nothing, so only executed steps are in the past.
            steps.drain(..self.executed.min(steps.len()));
            let old = self.steps.len();
            for (i, (step, old_step)) in steps.iter_mut().zip(&self.steps).enumerate() {
                let share = if self.mode == ExecutionMode::Overlap { soft_mask(i, old) } else { OLD_SHARE };
                blend(step, old_step, share);
            }
        }
        self.steps = steps;
    }
}

/// The weight of the old chunk at its remaining action `i` of `old`: equation 5 of Black, Galliker and Levine (2025), with
/// `old` = H - s - d.
fn soft_mask(i: usize, old: usize) -> f64 {
    let c = (old - i) as f64 / (old + 1) as f64;
    c * c.exp_m1() / (E - 1.0)
}

/// Moves the numbers of a step towards those of an old one. Actions of a policy without chunks replace old ones.
fn blend(step: &mut PredictedStep, old: &PredictedStep, share: f64) {
    if let (PredictedStep::Numbers(new), PredictedStep::Numbers(old)) = (step, old) {
        new.iter_mut().zip(old).for_each(|(new, old)| *new += share * (old - *new));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chunk(numbers: &[f64], execute: usize) -> Prediction {
        let steps = numbers.iter().map(|n| PredictedStep::Numbers(vec![*n])).collect();
        Prediction { steps, execute, periods: 1 }
    }

    fn pop(queue: &mut Queue) -> Option<f64> {
        let PredictedStep::Numbers(numbers) = queue.pop()? else { panic!() };
        Some(numbers[0])
    }

    #[test]
    fn hold_executes_first_part() {
        let mut queue = Queue::new(ExecutionMode::Hold);
        assert!(queue.is_due());
        queue.requested();
        queue.merge(chunk(&[1.0, 2.0, 3.0], 2));
        assert_eq!([pop(&mut queue), pop(&mut queue), pop(&mut queue)], [Some(1.0), Some(2.0), None]);
        assert!(queue.is_due());
    }

    #[test]
    fn queue_averages_equal_times() {
        let mut queue = Queue::new(ExecutionMode::Queue);
        queue.requested();
        queue.merge(chunk(&[0.0; 4], 4));
        pop(&mut queue);
        assert!(!queue.is_due());
        pop(&mut queue);
        // Half of the chunk is left: the next request starts, and one more action is executed before its reply.
        assert!(queue.is_due());
        queue.requested();
        pop(&mut queue);
        queue.merge(chunk(&[10.0, 10.0, 10.0, 10.0], 4));
        assert_eq!(
            [pop(&mut queue), pop(&mut queue), pop(&mut queue), pop(&mut queue)],
            [Some(7.0), Some(10.0), Some(10.0), None]
        );
    }

    #[test]
    fn overlap_follows_the_soft_mask() {
        let mut queue = Queue::new(ExecutionMode::Overlap);
        queue.requested();
        queue.merge(chunk(&[1.0; 8], 4));
        (0..4).for_each(|_| assert!(pop(&mut queue).is_some()));
        assert!(queue.is_due());
        queue.requested();
        pop(&mut queue);
        pop(&mut queue);
        queue.merge(chunk(&[0.0; 8], 4));
        // H = 8, s = 4, d = 2: c = 2/3 and 1/3 for the two remaining old actions.
        let mask = |c: f64| c * (c.exp() - 1.0) / (E - 1.0);
        let found = [pop(&mut queue), pop(&mut queue), pop(&mut queue)].map(Option::unwrap);
        assert!((found[0] - mask(2.0 / 3.0)).abs() < 1e-12 && (found[1] - mask(1.0 / 3.0)).abs() < 1e-12, "{found:?}");
        assert!(found[2].abs() < 1e-12);
    }
}
