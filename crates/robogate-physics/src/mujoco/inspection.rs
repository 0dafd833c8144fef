//! Measurements of a robot without a scene, for its inspection.

use mujoco_rs::prelude::*;

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
        let model = loaded.data.model();
        let weld = |body: usize| model.body_weldid()[body] as usize;
        let above = |body: usize| weld(model.body_parentid()[weld(body)] as usize);
        let excluded: Vec<(usize, usize)> =
            model.exclude_signature().iter().map(|s| ((*s >> 16) as usize, (*s & 0xffff) as usize)).collect();
        let parts = gripper_parts(model, &loaded.arm);
        let mut pairs = Vec::new();
        for (i, a) in loaded.kinds.iter().enumerate() {
            for (j, b) in loaded.kinds.iter().enumerate().skip(i + 1) {
                let (Kind::Robot { body: a, finger: f }, Kind::Robot { body: b, finger: g }) = (*a, *b) else {
                    continue;
                };
                let neighbours = weld(a) == weld(b) || weld(a) == above(b) || weld(b) == above(a);
                let fingers = (f.is_some() && g.is_some()) || (parts.contains(&a) && parts.contains(&b));
                if !neighbours && !fingers && !excluded.contains(&(a, b)) && !excluded.contains(&(b, a)) {
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

/// The bodies of the gripper: those that joints other than the arm's move, and those that carry such bodies. The parts of a
/// linkage overlap by design.
fn gripper_parts(model: &MjModel, arm: &[(usize, usize)]) -> Vec<usize> {
    let of_arm = |body: usize| {
        let first = model.body_jntadr()[body].max(0) as usize;
        let joints = first..first + model.body_jntnum()[body] as usize;
        let on_arm = |joint: usize| arm.iter().any(|(qpos, _)| *qpos == model.jnt_qposadr()[joint] as usize);
        (!joints.is_empty()).then(|| joints.into_iter().all(on_arm))
    };
    let parent = |body: usize| model.body_parentid()[model.body_weldid()[body] as usize] as usize;
    // Bodies that move on the world belong to the scene.
    let moves = |body: usize| parent(body) != 0 && of_arm(model.body_weldid()[body] as usize) == Some(false);
    let bodies = 1..model.body_parentid().len();
    let moving: Vec<usize> = bodies.clone().filter(|body| moves(*body)).collect();
    let carriers: Vec<i32> = moving.iter().map(|body| model.body_weldid()[parent(*body)]).collect();
    bodies.filter(|body| moves(*body) || carriers.contains(&model.body_weldid()[*body])).collect()
}
