//! Pick and place as a task for an arm.

use std::sync::Arc;

use robogate_core::{
    Assignment, CameraSpec, Domain, Fault, Foresight, Infeasibility, Parameter, ParameterSpace, Policy, Scenario,
    SpaceError, TaskInstance, TaskSpec, Value,
};
use robogate_physics::{Chain, Gripper, Robot, SuctionLaw};

use super::cell::{ResolvedCell, Told};
use super::foresight::PickPlaceForesight;
use super::parameters::TABLE;
use super::referee::Referee;
use super::spec::{Briefing, spec};
use super::{ModeSet, NAME, PickPlace, Scripted, claims, feasibility, scripted};
use crate::arm::claims::Claim;
use crate::arm::{ArmDeclaration, Parameters, Resolved, Rules, ToolExpert};

impl ArmDeclaration for PickPlace {
    fn name(&self) -> &'static str {
        NAME
    }

    fn summary(&self) -> &str {
        "pick a part from a table with a robot arm and place it at a target"
    }

    fn space(&self, gripper: &Gripper) -> &'static str {
        if gripper.cup().is_some() { "cup-cell" } else { "cell" }
    }

    fn fitted(&self, space: ParameterSpace, robot: &Robot) -> Result<ParameterSpace, SpaceError> {
        /// The largest part, as a fraction of the opening of the hand.
        const FILLED: f64 = 15.0 / 16.0;
        /// The largest part in any hand, in metres.
        const LARGEST_M: f64 = 0.12;
        let opening_m = robot.settings.gripper.jaw().map(|jaw| jaw.opening_m);
        let payload_kg = robot.settings.arm.payload_kg;
        let limited = |parameter: &Parameter| {
            let mut parameter = parameter.clone();
            if let Domain::Continuous { low, high, .. } = &mut parameter.domain {
                let most = match (&*parameter.name, opening_m) {
                    ("size_m", Some(opening_m)) => LARGEST_M.min(FILLED * opening_m),
                    ("mass_kg", _) => high.min(payload_kg),
                    _ => return parameter,
                };
                // The ends keep at least their ratio.
                *low = low.min(most * (*low / *high));
                *high = most;
            }
            parameter
        };
        ParameterSpace::new(space.name(), space.parameters().iter().map(limited).collect())
    }

    fn published_space(&self, gripper: &Gripper) -> Option<&'static str> {
        Some(if gripper.cup().is_some() { "ur" } else { "franka" })
    }

    fn suite(&self) -> Option<&'static str> {
        Some("industrial-68")
    }

    fn parameters(&self) -> &dyn Parameters {
        &TABLE
    }

    fn demonstration_space(&self, _: &Gripper) -> &'static str {
        "learned"
    }

    fn first_part(&self, instance: &TaskInstance, _: &Robot) -> Result<[f64; 4], Fault> {
        let briefing = Briefing::of(instance)?;
        let [x, y, z] = briefing.object_pose.position;
        Ok([x, y, z, briefing.object_extent_m[0]])
    }

    fn own_claims(&self, gripper: &Gripper) -> Vec<Claim> {
        claims::claims(gripper)
    }

    fn published(&self, gripper: &Gripper) -> Assignment {
        let word = |name: &str, word: &str| (name.into(), Value::Category(word.into()));
        let cup = gripper.cup().map(|_| word("suction", SuctionLaw::Surface.as_str()));
        let tolerance = ("tolerance_m".into(), Value::Number(0.03));
        [word("failure_modes", "paper"), word("workspace", "paper"), tolerance].into_iter().chain(cup).collect()
    }

    fn controller(&self, robot: Robot, chain: Chain) -> Box<dyn Policy> {
        Box::new(Scripted::new(robot, chain))
    }

    fn tool_expert(&self, robot: Robot, _: Chain) -> Option<Box<dyn Policy>> {
        Some(Box::new(ToolExpert::new(NAME, Arc::new(scripted::way), robot)))
    }
}

impl Rules for PickPlace {
    fn limits_forces(&self) -> bool {
        // The paper has no such mode.
        self.modes == ModeSet::All
    }

    fn spec(&self, robot: &Robot, cameras: Vec<CameraSpec>) -> TaskSpec {
        spec(robot, cameras, self)
    }

    fn resolve(&self, scenario: &Scenario, robot: &Robot, grip_force_n: f64) -> Result<Resolved, Fault> {
        let cell = ResolvedCell::new(scenario, robot, self)?;
        let mut briefing = cell.briefing();
        briefing.tolerance_m = self.tolerance_m;
        briefing.orientation_tolerance_rad = self.orientation_limit_rad();
        Ok(Resolved {
            scene: cell.scene.clone(),
            grip_threshold_m: cell.parameters.grip_threshold_m,
            bias: cell.bias.clone(),
            instance: briefing.instance(),
            trial: Box::new(Referee::new(Told { cell, briefing }, *self, grip_force_n)),
        })
    }

    fn foresight(&self, robot: &Robot, chain: &Chain, grip_force_n: f64) -> Option<Arc<dyn Foresight>> {
        Some(Arc::new(PickPlaceForesight::new(robot, chain, grip_force_n, self)))
    }

    fn infeasibility(&self, requested: &Assignment, robot: &Robot, grip_force_n: f64) -> Option<Infeasibility> {
        feasibility::infeasibility(requested, robot, self.workspace_scale(robot), grip_force_n, self.arm.suction)
    }
}
