//! Problems of a task that reading does not find and that need no simulation.

use robogate_physics::{Chain, Robot};

use super::conditions::Condition;
use super::document::Document;
use super::model::Model;
use super::problem::{Problem, Problems};

/// Every problem of the task with this robot.
pub(super) fn lint(model: &Model, robot: &Robot, chain: &Chain) -> Vec<Problem> {
    let mut problems = Problems::new(&model.text);
    let Document { success, failure, stage, expert, .. } = &model.document;
    let at = std::iter::once(&success.when).chain(failure.iter().map(|of| &of.when));
    let at = at.chain(stage.iter().map(|of| &of.when));
    let case = &model.cases[model.nominal.word];
    for (condition, at) in case.conditions().zip(at) {
        thresholds(model, condition, at.at, &mut problems);
    }
    if let Some(skill) = super::expert::unreachable(model, robot, chain) {
        let phase = case.skills.as_ref().and_then(|skills| skills.get(skill)).map_or("", |skill| skill.phase.as_str());
        problems.at(
            expert.as_ref().and_then(|of| of.skills.get(skill)).map_or(0, |text| text.at),
            format!("the expert cannot reach the goal of skill {} (`{phase}`) with {}", skill + 1, robot.name()),
            "move the scene nearer to x = 0.5 m, y = 0, or choose another robot with --robot",
        );
    }
    problems.found
}

/// Adds the comparisons of joints with numbers outside of their stops, for every value of the parameters.
fn thresholds(model: &Model, condition: &Condition, at: usize, problems: &mut Problems<'_>) {
    condition.thresholds(&mut |part, number| {
        let Some(joint) = model.nominal.parts[part].joint else { return };
        // A threshold that depends on a parameter is checked at both ends of every range.
        let ends = [0, 1].map(|end| {
            let parameters = model.parameters.iter().map(|of| of.range[end]);
            parameters.chain(model.settings.iter().map(|of| of.default)).collect::<Vec<_>>()
        });
        let [low, high] = joint.range;
        let outside = ends.iter().filter_map(|values| number.constant(values)).find(|x| !(*x > low && *x < high));
        if let Some(value) = outside {
            let name = &model.parts[part].name;
            problems.at(
                at,
                format!("joint({name}) is compared with {value}, but it moves from {low} to {high}"),
                "choose a number between the stops: the comparison never changes",
            );
        }
    });
}
