//! The knowledge of a task about an episode before it runs.

use crate::{Better, Fault, Measures, Scenario};

/// A declared feature of a risk model: a physical margin, or a number that follows from the hidden draws.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FeatureSpec {
    /// The name.
    pub name: &'static str,
    /// The unit. Empty for a number without unit.
    pub unit: &'static str,
    /// The meaning, in one sentence.
    pub meaning: &'static str,
    /// Whether larger values make success more likely. [`Better::Neither`] makes no claim. A risk model is monotone
    /// where the task makes a claim.
    pub better: Better,
}

/// The knowledge of a task about an episode before it runs: its hidden draws and its physical margins.
///
/// Both depend on the scenario alone (parameters, campaign seed and index). A task without such knowledge has none, and
/// its risk models use the parameters only.
pub trait Foresight: Send + Sync {
    /// The hidden draws of an episode, by the names that the task declares. An absent draw does not exist in this
    /// episode, as the position of a third obstacle of two.
    ///
    /// # Errors
    /// A fault if the scenario cannot be set up.
    fn draws(&self, scenario: &Scenario) -> Result<Measures, Fault>;

    /// The features of [`Self::features`], in their order.
    fn feature_specs(&self) -> &[FeatureSpec];

    /// The values of the features of an episode, in the order of [`Self::feature_specs`]. A feature that does not exist
    /// in this episode is NaN.
    ///
    /// # Errors
    /// A fault if the scenario cannot be set up.
    fn features(&self, scenario: &Scenario) -> Result<Vec<f64>, Fault>;
}
