//! Nominal twins: the scenarios of a control arm.
//!
//! The twin of an episode has its seed and its index, and the task's nominal value for each parameter. A parameter for which
//! the task declares no nominal value is not a perturbation (the id of a scene, for example): the twin keeps its value.
//! A pair of an episode and its twin therefore differs in the perturbed parameters only.

use std::sync::Arc;

use super::file::SuiteFile;
use super::{Spread, Suite, SuiteError};
use crate::{Assignment, ParameterSpace, TaskSpec, Value, Word};

impl Suite {
    /// The nominal twins of all scenarios, in the same order and groups: episode `i` of this suite and of its twin have the
    /// same seed.
    ///
    /// # Errors
    /// [`SuiteError::NoNominal`] if the task declares a nominal value for none of the parameters.
    pub fn nominal_twin(&self, task: &TaskSpec) -> Result<Self, SuiteError> {
        some_nominal(task, self.cases.iter().flat_map(|case| case.parameters.iter().map(|(name, _)| &**name)))?;
        let scenarios = self.cases.iter().map(|case| {
            let twin = |(name, spread): &(Arc<str>, Spread)| {
                let nominal = nominal(task, name).map_or_else(|| spread.clone(), Spread::Fixed);
                (Arc::clone(name), nominal)
            };
            let parameters = case.parameters.iter().map(twin).collect();
            ([case.category.as_str(), case.group.as_str()], case.id.clone(), parameters)
        });
        let about = format!("The scenarios of {} with the nominal values of the task.", self.name());
        let names = [format!("{}-nominal", self.name()), self.version().to_owned(), about];
        Self::try_from(SuiteFile::of_scenarios(names, self.environment().map(str::to_owned), scenarios))
    }

    /// The nominal twins of these episodes, in one round: episode `i` is the twin of the `i`-th point. If the task declares
    /// a nominal value for every parameter, the suite has one scenario, and its round `i` is the twin of the `i`-th point.
    ///
    /// # Errors
    /// [`SuiteError::NoNominal`] if the task declares a nominal value for none of the parameters.
    pub fn nominal_twins(task: &TaskSpec, points: &[Assignment]) -> Result<Self, SuiteError> {
        let first = points.first().map(Assignment::iter).into_iter().flatten();
        some_nominal(task, first.map(|(name, _)| name))?;
        let all_nominal = |point: &Assignment| point.iter().all(|(name, _)| nominal(task, name).is_some());
        let different = if points.iter().all(all_nominal) { &points[..1] } else { points };
        let scenarios = different.iter().enumerate().map(|(i, point)| {
            let twin = |(name, value): (&str, &Value)| {
                (Arc::from(name), Spread::Fixed(nominal(task, name).unwrap_or_else(|| value.clone())))
            };
            (["nominal", "nominal"], format!("nominal-{i}"), point.iter().map(twin).collect())
        });
        let about = "The episodes of a campaign with the nominal values of the task.".to_owned();
        let names = ["nominal".to_owned(), "1.0.0".to_owned(), about];
        Self::try_from(SuiteFile::of_scenarios(names, None, scenarios))
    }

    /// Scenarios with nothing varied: each has the nominal values of those of `names` that have one.
    ///
    /// # Errors
    /// [`SuiteError::NoNominal`] as above.
    pub fn nominal(task: &TaskSpec, names: &[&str], scenarios: usize) -> Result<Self, SuiteError> {
        some_nominal(task, names.iter().copied())?;
        let spread = |name: &&str| Some((Arc::from(*name), Spread::Fixed(nominal(task, name)?)));
        let parameters: Vec<(Arc<str>, Spread)> = names.iter().filter_map(spread).collect();
        let scenario = |number: usize| (["nominal", "nominal"], format!("nominal-{number:03}"), parameters.clone());
        let names = [format!("{}-nominal", task.name), "1.0.0".to_owned(), "Nothing varied.".to_owned()];
        Self::try_from(SuiteFile::of_scenarios(names, None, (1..=scenarios).map(scenario)))
    }

    /// The scenarios of this suite with the perturbations of one of the `families` each, and nominal values otherwise. They
    /// have the order of this suite, so episode `i` of both has the same seed. The first scenarios belong to the first family,
    /// the last to the last family.
    ///
    /// # Errors
    /// [`SuiteError::NoNominal`] as above.
    pub fn one_family_each(&self, task: &TaskSpec, families: &[(Word, Vec<Arc<str>>)]) -> Result<Self, SuiteError> {
        let scenarios = self.cases.iter().map(|case| (case.id.clone(), case.parameters.clone()));
        alone(self.name(), self.environment(), task, families, scenarios.collect())
    }

    /// The same for the episodes of a campaign, in one round.
    ///
    /// # Errors
    /// [`SuiteError::NoNominal`] as above.
    pub fn points_with_one_family(
        task: &TaskSpec,
        families: &[(Word, Vec<Arc<str>>)],
        points: &[Assignment],
    ) -> Result<Self, SuiteError> {
        let scenarios = points.iter().enumerate().map(|(i, point)| {
            let fixed = |(name, value): (&str, &Value)| (Arc::from(name), Spread::Fixed(value.clone()));
            (format!("point-{i}"), point.iter().map(fixed).collect())
        });
        alone("campaign", None, task, families, scenarios.collect())
    }

    /// A suite with `each` scenarios, and one group, for each family of parameters: those of the family are sampled from
    /// `space` in each round, and all others have the task's nominal value. Each scenario also has its nominal twin, so the
    /// pairs of a group show the effect of its family alone. A parameter without a nominal value is sampled in every scenario.
    ///
    /// # Errors
    /// [`SuiteError::NoNominal`] as above, and the problems of a suite with these names.
    pub fn of_families(
        space: &ParameterSpace,
        task: &TaskSpec,
        families: &[(String, Vec<String>)],
        each: usize,
    ) -> Result<Self, SuiteError> {
        some_nominal(task, families.iter().flat_map(|(_, parameters)| parameters.iter().map(String::as_str)))?;
        let scenarios = families.iter().flat_map(|(family, varied)| {
            let spread = |parameter: &crate::Parameter| {
                let fixed =
                    nominal(task, &parameter.name).filter(|_| !varied.iter().any(|name| **name == *parameter.name));
                let spread = fixed.map_or_else(|| Spread::Drawn(parameter.domain.clone()), Spread::Fixed);
                (Arc::clone(&parameter.name), spread)
            };
            let parameters: Vec<(Arc<str>, Spread)> = space.parameters().iter().map(spread).collect();
            let id = move |number| if each > 1 { format!("{family}-{number}") } else { family.clone() };
            (1..=each).map(move |number| ([family.as_str(), family.as_str()], id(number), parameters.clone()))
        });
        let about = format!("One family of parameters of `{}` at a time, with nominal twins.", space.name());
        let name = Word::nearest(space.name()).map_or("space", Word::as_str);
        let names = [format!("{name}-families"), "1.0.0".to_owned(), about];
        let mut file = SuiteFile::of_scenarios(names, None, scenarios);
        file.nominal = true;
        Self::try_from(file)
    }

    /// The parameters with a nominal value that have another one in some scenario.
    pub fn perturbed(&self, task: &TaskSpec) -> Vec<&str> {
        let differs = |name: &str| {
            nominal(task, name).map(Spread::Fixed).is_some_and(|nominal| {
                self.cases
                    .iter()
                    .any(|case| case.parameters.iter().any(|(of, spread)| **of == *name && *spread != nominal))
            })
        };
        self.space().parameters().iter().map(|parameter| &*parameter.name).filter(|name| differs(name)).collect()
    }

    /// Whether each scenario also runs with the task's nominal values and the same seed.
    pub fn has_twins(&self) -> bool {
        self.file.nominal
    }
}

/// A scenario before it is in a suite: its id and its parameters.
type Draft = (String, Vec<(Arc<str>, Spread)>);

/// These scenarios with the perturbations of one family each. Each family gets a block of neighbours of nearly equal size.
fn alone(
    name: &str,
    environment: Option<&str>,
    task: &TaskSpec,
    families: &[(Word, Vec<Arc<str>>)],
    scenarios: Vec<Draft>,
) -> Result<Suite, SuiteError> {
    some_nominal(task, families.iter().flat_map(|(_, parameters)| parameters.iter().map(|name| &**name)))?;
    let count = scenarios.len().max(1);
    let blocks = scenarios.into_iter().enumerate().filter_map(|(i, (id, parameters))| {
        let (family, varied) = families.get(i * families.len() / count)?;
        let of = |(name, spread): (Arc<str>, Spread)| {
            let fixed = nominal(task, &name).filter(|_| !varied.contains(&name));
            (name, fixed.map_or(spread, Spread::Fixed))
        };
        Some(([family.as_str(); 2], id, parameters.into_iter().map(of).collect()))
    });
    let about = "The scenarios of the campaign with the perturbations of one family each.".to_owned();
    let names = [format!("{name}-one-family"), "1.0.0".to_owned(), about];
    Suite::try_from(SuiteFile::of_scenarios(names, environment.map(str::to_owned), blocks))
}

fn nominal(task: &TaskSpec, name: &str) -> Option<Value> {
    task.parameter(name)?.nominal.clone()
}

fn some_nominal<'a>(task: &TaskSpec, mut names: impl Iterator<Item = &'a str>) -> Result<(), SuiteError> {
    if names.any(|name| nominal(task, name).is_some()) {
        return Ok(());
    }
    Err(SuiteError::NoNominal { task: task.name.as_str().to_owned() })
}
