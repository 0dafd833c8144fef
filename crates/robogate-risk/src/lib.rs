//! Risk models of a policy: the chance of success from parameters, hidden draws and physical margins.
//!
//! Much of the apparent noise of a simulated episode follows from numbers that are sampled from its seed and recorded as
//! draws. A [`RiskModel`] is trained with the parameters, and with the features that the task computes from parameters
//! and draws ([`robogate_core::Foresight`]). It answers two questions:
//!
//! - [`RiskModel::told`]: the chance of success of one episode, whose draws are known.
//! - [`RiskModel::averaged`]: the chance of success of parameters alone, averaged over fresh draws. This is the answer
//!   for the real robot, where the draws are unknown.
//!
//! Two learners are fitted: ridge logistic regression on splines and products, and monotone gradient boosting.
//! Cross-validation finds the mean of both that predicts best, and calibrates it. Each fit runs in the order of the
//! episodes, so the result does not depend on the number of threads that share the fits.

mod inputs;
mod model;

pub use inputs::Inputs;
pub use model::{Fitting, RiskError, RiskModel, Sample};
pub use robogate_stats::flexible::{Choice, Learner};
pub use robogate_stats::parallel::{all_processors, in_parallel};
