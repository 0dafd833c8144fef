//! The resolved cell: a scenario after every random draw.

use robogate_core::{Fault, FaultKind, Pose, Scenario};
use robogate_physics::{Robot, Scene};

use super::scene::{scene, target};
use super::spec::Briefing;
use super::{PickPlace, Placement, SceneParameters};
use crate::arm::encoder_bias;

/// Distance around the target that obstacles leave free, in metres: the tolerance of the paper (section 4.3).
pub(crate) const TARGET_ROOM_M: f64 = 0.03;

/// Everything about an episode that is fixed before it starts.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ResolvedCell {
    pub(crate) parameters: SceneParameters,
    /// Scale of the workspace about the robot's base.
    pub(crate) scale: f64,
    /// Placement of the object that the policy is given.
    placement: Placement,
    pub(crate) scene: Scene,
    /// Where the object's centre must come to rest, in metres.
    pub(crate) target: [f64; 3],
    /// Bias of each joint's encoder: measured minus true position, in radians.
    pub(crate) bias: Vec<f64>,
    /// From the unit disc: the direction and fraction of the position jitter.
    pub(crate) jitter: [f64; 2],
}

/// The cell of an episode and what the policy is told about it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Told {
    pub(crate) cell: ResolvedCell,
    pub(crate) briefing: Briefing,
}

impl ResolvedCell {
    /// Resolves the cell of a scenario for this robot under these rules. The result depends only on these inputs.
    pub(crate) fn new(scenario: &Scenario, robot: &Robot, rules: &PickPlace) -> Result<Self, Fault> {
        let setup = |why: String| Fault::new(FaultKind::Setup, why);
        let gripper = &robot.settings.gripper;
        let mut parameters = SceneParameters::from_assignment(&scenario.requested, gripper)?;
        let placement = Placement::from_name(&parameters.placement)
            .ok_or_else(|| setup(format!("unknown placement `{}`", parameters.placement)))?;
        let scale = rules.workspace_scale(robot);
        let placement = placement.scaled(scale).moved(parameters.offset_m);
        let mut jitter = scenario.seed.stream("position-jitter");
        let fraction = jitter.uniform().sqrt();
        let off = parameters.position_jitter_m * fraction;
        let (sin, cos) = jitter.between(0.0, std::f64::consts::TAU).sin_cos();
        let standing = placement.moved([off * cos, off * sin]);
        let mut obstacles = scenario.seed.stream("obstacles");
        let scene = scene(&parameters, &standing, scale, &mut obstacles).map_err(setup)?;
        let [x, y] = target(scale);
        let target = [x, y, 0.5 * parameters.size_m];
        let bias = parameters.around.bias(scenario, robot)?;
        parameters.around.encoders = encoder_bias(scenario, robot, 1.0);
        Ok(Self { parameters, scale, placement, scene, target, bias, jitter: [fraction * cos, fraction * sin] })
    }

    /// The briefing that the policy receives.
    pub(crate) fn briefing(&self) -> Briefing {
        let size = self.parameters.size_m;
        Briefing {
            shape: self.parameters.shape.as_str().to_owned(),
            object_extent_m: [size; 3],
            object_pose: self.placement.pose(size),
            target_pose: Pose::upright(self.target, 0.0),
            tolerance_m: super::PickPlace::DEFAULT.tolerance_m,
            orientation_tolerance_rad: None,
            approach_speed_m_s: self.parameters.approach_speed_m_s,
        }
    }
}
