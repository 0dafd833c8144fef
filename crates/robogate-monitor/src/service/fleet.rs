//! The fleet document: all robots, and the differences between the robots of each recipe.

use std::collections::BTreeMap;

use robogate_stats::Trials;
use robogate_stats::overdispersion::{Outlier, outliers, spread};
use serde::Serialize;

use super::intake::Intake;
use super::status::RateStatus;
use crate::Level;

/// Maximum number of recipes whose robots are compared, the most severe and busiest first.
const RECIPES: usize = 20;
/// Maximum number of listed robots, the lowest success rate first.
const ROBOTS: usize = 200;
/// Level of significance of the outlier test, over the robots of one recipe.
const ALPHA: f64 = 0.05;

/// The cycles of each robot in each recipe.
#[derive(Debug)]
pub(super) struct Tallies {
    all: Trials,
    robots: BTreeMap<String, Trials>,
    recipes: Vec<(String, Vec<(String, Trials)>)>,
}

/// The fleet.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FleetStatus {
    /// The version of the format.
    pub version: u32,
    /// All cycles of all robots and recipes.
    pub all: RateStatus,
    /// The number of robots.
    pub robots_known: usize,
    /// Each robot over all its recipes, the lowest success rate first. Recipes differ, so robots are compared in
    /// `recipes` only.
    pub robots: Vec<RobotStatus>,
    /// Recipes with more than one robot, the most severe first, then the busiest.
    pub recipes: Vec<RecipeFleet>,
}

/// The cycles of a robot.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RobotStatus {
    /// The robot.
    pub robot: String,
    /// Its success rate.
    pub rate: RateStatus,
}

/// The differences between the robots of one recipe.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecipeFleet {
    /// The recipe.
    pub recipe: String,
    /// The spread. `None` if all cycles have the same outcome.
    pub spread: Option<SpreadStatus>,
    /// Robots that differ significantly from their peers, the smallest p-value first, at the level 0.05 over all robots
    /// of the recipe. Empty for fewer than four robots.
    pub outliers: Vec<OutlierStatus>,
    /// Its robots, the lowest success rate first.
    pub robots: Vec<RobotStatus>,
}

/// Spread of the robots' success rates beyond chance: a beta-binomial fit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SpreadStatus {
    /// Number of robots.
    pub robots: usize,
    /// Mean success rate of a robot.
    pub mean: f64,
    /// Overdispersion, from 0 (equal rates) to 1.
    pub overdispersion: f64,
    /// Its 95 % interval.
    pub overdispersion_95: [f64; 2],
    /// Standard deviation of the robots' rates.
    pub deviation: f64,
    /// Its 95 % interval.
    pub deviation_95: [f64; 2],
}

/// A robot that differs significantly from its peers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OutlierStatus {
    /// The robot.
    pub robot: String,
    /// Whether it is worse than its peers, otherwise better.
    pub worse: bool,
    /// The two-sided p-value after Holm's correction.
    pub p: f64,
    /// Its success rate.
    pub rate: RateStatus,
}

impl Tallies {
    pub(super) fn of(intake: &Intake) -> Self {
        let mut robots: BTreeMap<String, Trials> = BTreeMap::new();
        let mut several: Vec<(Option<Level>, u64, &str)> = Vec::new();
        let mut all = Trials::NONE;
        for (name, recipe) in intake.monitor().recipes() {
            all = together(all, recipe.trials());
            for (robot, tally) in recipe.robots() {
                let trials = Trials::new(tally.successes, tally.cycles).unwrap_or(Trials::NONE);
                match robots.get_mut(robot) {
                    Some(sum) => *sum = together(*sum, trials),
                    None => drop(robots.insert(robot.to_owned(), trials)),
                }
            }
            if recipe.robots().nth(1).is_some() {
                several.push((recipe.level(), recipe.trials().n(), name));
            }
        }
        several.sort_by_key(|(level, n, _)| std::cmp::Reverse((*level, *n)));
        let tallies = |(_, _, name): &(Option<Level>, u64, &str)| {
            let recipe = intake.monitor().recipe(name)?;
            let robots = recipe.robots().filter_map(|(robot, tally)| {
                Some((robot.to_owned(), Trials::new(tally.successes, tally.cycles).ok()?))
            });
            Some(((*name).to_owned(), robots.collect()))
        };
        Self { all, robots, recipes: several.iter().take(RECIPES).filter_map(tallies).collect() }
    }
}

fn together(a: Trials, b: Trials) -> Trials {
    Trials::new(a.successes() + b.successes(), a.n() + b.n()).unwrap_or(Trials::NONE)
}

impl FleetStatus {
    /// Compares the robots. A recipe with a thousand robots takes up to a second, so the engine's thread does not call
    /// this.
    pub(super) fn of(tallies: &Tallies) -> Self {
        let robots = tallies.robots.iter().map(|(robot, trials)| (robot.as_str(), *trials));
        Self {
            version: 1,
            all: RateStatus::of(tallies.all),
            robots_known: tallies.robots.len(),
            robots: lowest(robots),
            recipes: tallies.recipes.iter().map(|(recipe, robots)| recipe_fleet(recipe, robots)).collect(),
        }
    }
}

fn lowest<'a>(robots: impl Iterator<Item = (&'a str, Trials)>) -> Vec<RobotStatus> {
    let mut all: Vec<RobotStatus> =
        robots.map(|(robot, trials)| RobotStatus { robot: robot.to_owned(), rate: RateStatus::of(trials) }).collect();
    all.sort_by(|a, b| a.rate.rate.unwrap_or(1.0).total_cmp(&b.rate.rate.unwrap_or(1.0)));
    all.truncate(ROBOTS);
    all
}

fn recipe_fleet(recipe: &str, robots: &[(String, Trials)]) -> RecipeFleet {
    let trials: Vec<Trials> = robots.iter().map(|(_, trials)| *trials).collect();
    let outlier = |o: Outlier| OutlierStatus {
        rate: RateStatus::of(o.trials),
        robot: robots[o.index].0.clone(),
        worse: o.worse,
        p: o.p,
    };
    RecipeFleet {
        recipe: recipe.to_owned(),
        spread: spread(&trials).map(|s| SpreadStatus {
            robots: s.groups,
            mean: s.mean,
            overdispersion: s.rho,
            overdispersion_95: s.rho_95,
            deviation: s.deviation,
            deviation_95: s.deviation_95,
        }),
        outliers: outliers(&trials, ALPHA).into_iter().map(outlier).collect(),
        robots: lowest(robots.iter().map(|(robot, trials)| (robot.as_str(), *trials))),
    }
}
