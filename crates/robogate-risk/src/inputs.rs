//! The inputs of a risk model: parameters, and features of the task.

use std::fmt;
use std::sync::Arc;

use robogate_core::{Assignment, Better, Domain, Fault, Foresight, ParameterSpace, Scenario, Seed};
use robogate_stats::boosting::Monotone;

/// The campaign seed of fresh draws. Every point sees the same ones, which makes differences between points smooth.
const FRESH: u64 = 0x6672_6573_6864_7277;

/// Converts scenarios to the columns of a risk model.
///
/// A numeric parameter is one column on its own scale, a categorical one has a column for each choice. The features of
/// the task follow.
#[derive(Clone)]
pub struct Inputs {
    space: ParameterSpace,
    foresight: Option<Arc<dyn Foresight>>,
    names: Vec<String>,
    constraints: Vec<Monotone>,
    /// Columns whose products are terms of the spline model.
    interacting: Vec<usize>,
}

impl fmt::Debug for Inputs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Inputs").field("names", &self.names).finish_non_exhaustive()
    }
}

impl Inputs {
    /// The inputs of a model over this space. Without `foresight` they are the parameters alone.
    pub fn new(space: &ParameterSpace, foresight: Option<Arc<dyn Foresight>>) -> Self {
        let (mut names, mut constraints, mut interacting) = (Vec::new(), Vec::new(), Vec::new());
        for parameter in space.parameters() {
            match &parameter.domain {
                Domain::Categorical { choices } => {
                    names.extend(choices.iter().map(|choice| format!("{} = {choice}", parameter.name)));
                }
                Domain::Continuous { .. } | Domain::Integer { .. } => {
                    interacting.push(names.len());
                    names.push(parameter.name.to_string());
                }
            }
            constraints.resize(names.len(), Monotone::Free);
        }
        for spec in foresight.iter().flat_map(|foresight| foresight.feature_specs()) {
            interacting.push(names.len());
            names.push(spec.name.to_owned());
            constraints.push(match spec.better {
                Better::Higher => Monotone::Increasing,
                Better::Lower => Monotone::Decreasing,
                Better::Neither => Monotone::Free,
            });
        }
        Self { space: space.clone(), foresight, names, constraints, interacting }
    }

    /// The names of the columns.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// The parameter space.
    pub fn space(&self) -> &ParameterSpace {
        &self.space
    }

    /// Whether the task knows the draws of an episode.
    pub fn knows_draws(&self) -> bool {
        self.foresight.is_some()
    }

    pub(crate) fn constraints(&self) -> &[Monotone] {
        &self.constraints
    }

    pub(crate) fn interacting(&self) -> &[usize] {
        &self.interacting
    }

    /// The columns of one episode.
    ///
    /// # Errors
    /// A fault if the task cannot set the scenario up.
    pub fn row(&self, scenario: &Scenario) -> Result<Vec<f64>, Fault> {
        let mut row = Vec::with_capacity(self.names.len());
        for parameter in self.space.parameters() {
            let value = scenario.requested.get(&parameter.name);
            match &parameter.domain {
                Domain::Categorical { choices } => {
                    let chosen = scenario.requested.category(&parameter.name);
                    row.extend(choices.iter().map(|choice| f64::from(u8::from(Some(&**choice) == chosen))));
                }
                domain => {
                    let coded = value.and_then(|value| domain.encode(value));
                    row.push(coded.map_or(f64::NAN, |coded| domain.to_unit(coded)));
                }
            }
        }
        if let Some(foresight) = &self.foresight {
            row.extend(foresight.features(scenario)?);
        }
        Ok(row)
    }

    /// An episode with these parameters and the fresh draw of this number.
    pub fn fresh(requested: &Assignment, draw: u64) -> Scenario {
        let seed = Seed::campaign(FRESH).episode(draw);
        Scenario { index: draw, seed, requested: requested.clone() }
    }
}
