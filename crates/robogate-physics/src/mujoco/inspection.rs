//! Measurements of a robot without a scene, for its inspection.

use mujoco_rs::prelude::*;

use super::links::Links;
use super::{Kind, MujocoEngine, load_mujoco};
use crate::{Engine, Problem, Robot, RobotError, robot_model};

impl MujocoEngine {
    /// All problems of a robot's model. The settings are checked separately.
    pub(crate) fn problems(robot: &Robot) -> Vec<Problem> {
        match load_mujoco() {
            Ok(_) => robot_model::build(robot, Self::TIME_STEP_S).err().unwrap_or_default(),
            Err(error) => RobotError::Engine { why: error.to_string() }.into_problems(),
        }
    }

    /// Mass in kilograms of each moving body of the loaded robot that has one, in the model's order.
    pub(crate) fn masses(&self) -> Vec<(String, f64)> {
        let Some(loaded) = &self.loaded else { return Vec::new() };
        let model = loaded.data.model();
        (1..model.body_mass().len())
            .filter(|body| loaded.free.iter().all(|free| free.body != *body) && model.body_weldid()[*body] != 0)
            .map(|body| (self.robot_body(body), model.body_mass()[body]))
            .filter(|(_, mass)| *mass > 0.0)
            .collect()
    }

    /// The joint of a gripper with drives that is farthest off its measured position at this opening (m): its name, its
    /// position and the measured one, in radians or metres. `None` without drives.
    pub(crate) fn farthest_off(&self, opening_m: f64) -> Option<(String, [f64; 2])> {
        let (loaded, fingers) = (self.loaded.as_ref()?, self.fingers.as_ref()?);
        let off = |(name, wanted): (&String, f64)| {
            let joint = loaded.data.model().name_to_id(MjtObjBase::mjOBJ_JOINT, name)?;
            let at = loaded.data.qpos()[loaded.data.model().jnt_qposadr()[joint] as usize];
            Some((name.clone(), [at, wanted]))
        };
        let joints = fingers.joints.iter().zip(fingers.joints_at(opening_m)).filter_map(off);
        joints.max_by(|(_, [a, at_a]), (_, [b, at_b])| (a - at_a).abs().total_cmp(&(b - at_b).abs()))
    }

    /// Pairs of the loaded robot's bodies that penetrate each other deeper than `deep` (m), with the depth. Neighbours in
    /// the chain, parts of the gripper and pairs that the model excludes from contact do not count.
    pub(crate) fn self_contacts(&mut self, deep: f64) -> Vec<(String, String, f64)> {
        let Some(loaded) = self.loaded.as_mut() else { return Vec::new() };
        let arm: Vec<usize> = loaded.arm.iter().map(|(qpos, _)| *qpos).collect();
        let links = Links::new(loaded.data.model(), &arm);
        let mut pairs = Vec::new();
        for (i, a) in loaded.kinds.iter().enumerate() {
            for (j, b) in loaded.kinds.iter().enumerate().skip(i + 1) {
                if let (Kind::Robot { body: a, .. }, Kind::Robot { body: b, .. }) = (*a, *b)
                    && links.may_touch(a, b)
                {
                    pairs.push((i, j, a, b));
                }
            }
        }
        let mut deepest: Vec<(usize, usize, f64)> = Vec::new();
        for (i, j, a, b) in pairs {
            let depth = -loaded.data.geom_distance(i, j, deep, None);
            if depth > deep {
                match deepest.iter_mut().find(|(x, y, _)| (*x, *y) == (a, b)) {
                    Some((.., most)) => *most = most.max(depth),
                    None => deepest.push((a, b, depth)),
                }
            }
        }
        deepest.into_iter().map(|(a, b, depth)| (self.robot_body(a), self.robot_body(b), depth)).collect()
    }
}
