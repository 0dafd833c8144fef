//! Measurements of a robot without a scene, for its inspection.

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
