//! What mass does to each robot, and whether its workspace suits its reach.

use robogate_stats::Confidence;
use robogate_stats::logistic::{Data, Estimator, Options, Profile, RegressionError, firth_profile, fit};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::comparison::axis::SharedAxis;
use crate::comparison::entrant::Entrant;
use crate::models::why;
use crate::rate::{Finding, Rate};
use crate::words::ends;

/// The parameter that is meant by mass.
pub(crate) const MASS: &str = "mass_kg";

/// What mass does to each compared dictionary, over the range that all of them cover.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MassSensitivity {
    /// The range in kilograms.
    pub range_kg: [f64; 2],
    /// The lightest bin.
    pub light_kg: [f64; 2],
    /// The heaviest bin.
    pub heavy_kg: [f64; 2],
    /// Each compared dictionary, in their order.
    pub of: Vec<MassEffect>,
}

/// What mass does to one of them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MassEffect {
    /// Its name.
    pub name: String,
    /// Slope of the log-odds of success per unit of ln(mass): below 0, weight hurts.
    pub slope: Finding<Slope>,
    /// Success in the lightest bin.
    pub light: Rate,
    /// Success in the heaviest bin.
    pub heavy: Rate,
}

/// A slope with its interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Slope {
    /// Change of the log-odds per unit of ln(mass).
    pub per_log_mass: f64,
    /// 95 % interval: Wald's, or of the penalised profile where success and failure are separated; an end that
    /// lies beyond what was followed is absent.
    pub interval_95: [Option<f64>; 2],
    /// By what the odds of success are multiplied where the mass doubles.
    pub odds_per_doubling: f64,
    /// ln of the two-sided p-value that mass does nothing.
    pub ln_p: f64,
    /// Whether it is Firth's penalised fit.
    pub penalised: bool,
}

pub(crate) fn mass(entrants: &[&Entrant<'_>], axes: &[SharedAxis]) -> Finding<MassSensitivity> {
    let Some(axis) = axes.iter().find(|axis| axis.axis.parameter == MASS) else {
        return Finding::not("mass_kg is not a parameter of all of them");
    };
    let cells = axis.cells();
    let (Some(light_kg), Some(heavy_kg)) = (axis.range(0), axis.range(cells.saturating_sub(1))) else {
        return Finding::not("mass_kg has no range");
    };
    let range_kg = [light_kg[0], heavy_kg[1]];
    if range_kg[0] <= 0.0 {
        return Finding::not("a mass that is not above 0 has no logarithm");
    }
    let of = entrants.iter().map(|entrant| {
        let trials = axis.trials(entrant);
        MassEffect {
            name: entrant.name.clone(),
            slope: slope(entrant, range_kg),
            light: Rate::of(trials[0]),
            heavy: Rate::of(trials[cells - 1]),
        }
    });
    Finding::Estimated(MassSensitivity { range_kg, light_kg, heavy_kg, of: of.collect() })
}

fn slope(entrant: &Entrant<'_>, [low, high]: [f64; 2]) -> Finding<Slope> {
    let Some(column) = entrant.parameter(MASS) else { return Finding::not("it has no mass_kg") };
    let inside = |mass: &f64| (low..=high).contains(mass);
    let log_mass: Vec<f64> = column.values.iter().copied().filter(inside).map(f64::ln).collect();
    let success: Vec<bool> =
        column.values.iter().zip(&entrant.base.success).filter(|(mass, _)| inside(mass)).map(|(_, s)| *s).collect();
    slope_of(&log_mass, &success)
}

fn slope_of(log_mass: &[f64], success: &[bool]) -> Finding<Slope> {
    let names = ["ln(mass)".to_owned()];
    let columns = [log_mass];
    let fitted = Data::new(&columns, success, None).and_then(|data| Ok((data, fit(data, Options::default())?)));
    let (data, fitted) = match fitted {
        Ok(both) => both,
        Err(error) => return Finding::not(why(&error, &names)),
    };
    let Some(coefficient) = fitted.terms.first().and_then(|term| term.coefficient()) else {
        return Finding::not("every episode has the same mass");
    };
    let doubling = |slope: f64| (slope * std::f64::consts::LN_2).exp();
    if fitted.estimator != Estimator::Firth {
        let [low, high] = ends(coefficient.interval(Confidence::P95));
        return Finding::Estimated(Slope {
            per_log_mass: coefficient.estimate,
            interval_95: [Some(low), Some(high)],
            odds_per_doubling: doubling(coefficient.estimate),
            ln_p: coefficient.ln_p.max(f64::MIN),
            penalised: false,
        });
    }
    let profile: Result<Profile, RegressionError> = firth_profile(data, 0, Confidence::P95);
    match profile {
        Ok(profile) => Finding::Estimated(Slope {
            per_log_mass: profile.estimate,
            interval_95: ends(profile.interval).map(|end| Some(end).filter(|end| end.is_finite())),
            odds_per_doubling: doubling(profile.estimate),
            ln_p: profile.ln_p.max(f64::MIN),
            penalised: true,
        }),
        Err(error) => Finding::not(why(&error, &names)),
    }
}

/// How far the workspace lies within one robot's reach.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ReachRow {
    /// The dictionary's name.
    pub name: String,
    /// The robot's reach; absent where it is not known.
    pub reach_m: Option<f64>,
    /// Distance from the robot's base to the centre of the workspace; absent where it is not known.
    pub workspace_m: Option<f64>,
    /// Workspace over reach.
    pub ratio: Option<f64>,
    /// Whether the user gave one of the two on the command line.
    pub given: bool,
    /// The success rate it goes with.
    pub rate: Rate,
}

pub(crate) fn reach(entrants: &[&Entrant<'_>], given: &[(String, f64)], workspace: Option<f64>) -> Vec<ReachRow> {
    let row = |entrant: &&Entrant<'_>| {
        let known = entrant.provenance().robot.dimensions;
        let named = given.iter().find(|(name, _)| *name == entrant.name).map(|(_, reach)| *reach);
        let reach_m = named.or(known.map(|d| d.reach_m));
        let recorded = known.map(|d| d.workspace_m);
        let workspace_m = recorded.or(workspace);
        ReachRow {
            name: entrant.name.clone(),
            reach_m,
            workspace_m,
            ratio: reach_m.zip(workspace_m).map(|(reach, workspace)| workspace / reach),
            given: named.is_some() || (recorded.is_none() && workspace.is_some()),
            rate: Rate::of(robogate_stats::Trials::count(entrant.base.success.iter().copied())),
        }
    };
    entrants.iter().map(row).collect()
}
