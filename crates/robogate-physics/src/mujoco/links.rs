//! Contact of the robot's links with each other.
//!
//! Two links can touch if at least one further link is between them. These pairs are left out:
//!
//! - the same link, and neighbours in the chain, whose shapes meet at the joint between them;
//! - parts of the gripper, whose linkages overlap by design and whose fingers meet;
//! - pairs that the model excludes from contact;
//! - pairs that overlap, or nearly do, while the arm waits at home with an open gripper: their shapes are larger than the links.

use mujoco_rs::prelude::*;
use mujoco_rs::wrappers::mj_editing::MjsBody;
use robogate_core::Region;

use super::{PREFIX, ROBOT_WITH_ITSELF};
use crate::region::region;
use crate::{FingerMotion, RobotSettings};

/// Two links whose shapes are this near to each other at home can never touch, in metres.
const NEAR_M: f64 = 1e-3;

/// The bodies of a robot without a scene, or in one.
pub(super) struct Links<'a> {
    model: &'a MjModel,
    /// The bodies of the gripper.
    gripper: Vec<usize>,
    /// The pairs of bodies that the robot's own model excludes.
    excluded: Vec<(usize, usize)>,
}

impl<'a> Links<'a> {
    /// The links of a model whose arm has joints at these addresses in qpos.
    pub(super) fn new(model: &'a MjModel, arm: &[usize]) -> Self {
        let of_model = |index: usize| {
            let name = model.id_to_name(MjtObjBase::mjOBJ_EXCLUDE, index);
            !name.is_some_and(|name| name.starts_with(PREFIX))
        };
        let pairs = model.exclude_signature().iter().enumerate().filter(|(index, _)| of_model(*index));
        let excluded = pairs.map(|(_, pair)| ((*pair >> 16) as usize, (*pair & 0xffff) as usize)).collect();
        Self { model, gripper: gripper_parts(model, arm), excluded }
    }

    fn weld(&self, body: usize) -> usize {
        self.model.body_weldid()[body] as usize
    }

    /// Whether two bodies are the same link or neighbours in the chain.
    fn are_neighbours(&self, a: usize, b: usize) -> bool {
        let above = |body: usize| self.weld(self.model.body_parentid()[self.weld(body)] as usize);
        self.weld(a) == self.weld(b) || self.weld(a) == above(b) || self.weld(b) == above(a)
    }

    /// Whether two bodies can touch, as far as this follows from the structure of the model.
    pub(super) fn may_touch(&self, a: usize, b: usize) -> bool {
        let in_gripper = self.gripper.contains(&a) && self.gripper.contains(&b);
        !self.are_neighbours(a, b)
            && !in_gripper
            && !self.excluded.contains(&(a, b))
            && !self.excluded.contains(&(b, a))
    }
}

/// Gives every body a name: MuJoCo excludes contacts of bodies by their names.
pub(crate) fn name_bodies(spec: &mut MjSpec) {
    name_below(spec.world_body_mut(), &mut 0);
}

fn name_below(body: &mut MjsBody, count: &mut usize) {
    for child in body.body_iter_mut() {
        *count += 1;
        if child.name().is_empty() {
            // If the name is taken, the body can touch everything.
            let _ = child.set_name(&format!("body {count}"));
        }
        name_below(child, count);
    }
}

/// Lets the links of a robot collide with each other. `model` is the compiled `spec`, whose bodies have names.
pub(crate) fn let_links_collide(
    spec: &mut MjSpec,
    model: MjModel,
    settings: &RobotSettings,
    fingers: Option<&FingerMotion>,
) {
    let mut data = MjData::new(Box::new(model));
    at_home(&mut data, settings, fingers);
    let model = data.model();
    let address = |name: &String| Some(model.jnt_qposadr()[model.name_to_id(MjtObjBase::mjOBJ_JOINT, name)?] as usize);
    let arm: Vec<usize> = settings.arm.joints.iter().filter_map(address).collect();
    let links = Links::new(model, &arm);
    let solid = |geom: &usize| model.geom_contype()[*geom] != 0 || model.geom_conaffinity()[*geom] != 0;
    let solids: Vec<(usize, usize)> =
        (0..model.geom_bodyid().len()).filter(solid).map(|geom| (geom, model.geom_bodyid()[geom] as usize)).collect();
    let mut bodies: Vec<usize> = solids.iter().map(|(_, body)| *body).collect();
    bodies.dedup();
    let mut apart: Vec<(usize, usize)> = Vec::new();
    let mut near: Vec<(usize, usize, usize, usize)> = Vec::new();
    for (i, a) in bodies.iter().enumerate() {
        for b in &bodies[i + 1..] {
            if !links.may_touch(*a, *b) {
                apart.push((*a, *b));
                continue;
            }
            let of = |body: usize| solids.iter().filter(move |(_, of)| *of == body).map(|(geom, _)| *geom);
            near.extend(of(*a).flat_map(|one| of(*b).map(move |two| (*a, *b, one, two))));
        }
    }
    for (a, b, one, two) in near {
        if apart.last() != Some(&(a, b)) && data.geom_distance(one, two, NEAR_M, None) < NEAR_M {
            apart.push((a, b));
        }
    }
    let model = data.model();
    let name = |body: usize| model.id_to_name(MjtObjBase::mjOBJ_BODY, body);
    for (a, b) in apart {
        if let (Some(a), Some(b)) = (name(a), name(b)) {
            let exclude = spec.add_exclude().with_name(&format!("{PREFIX}{a}/{b}"));
            exclude.set_bodyname1(a);
            exclude.set_bodyname2(b);
        }
    }
    for geom in spec.geom_iter_mut() {
        if geom.contype() != 0 || geom.conaffinity() != 0 {
            geom.set_contype(ROBOT_WITH_ITSELF.0);
            geom.set_conaffinity(ROBOT_WITH_ITSELF.1);
        }
    }
}

/// Moves the robot to its home posture with an open gripper.
fn at_home(data: &mut MjData<Box<MjModel>>, settings: &RobotSettings, fingers: Option<&FingerMotion>) {
    let model = data.model();
    let address = |name: &String| Some(model.jnt_qposadr()[model.name_to_id(MjtObjBase::mjOBJ_JOINT, name)?] as usize);
    let arm = settings.arm.joints.iter().map(address).zip(&settings.arm.home_rad);
    let mut posture: Vec<(usize, f64)> = arm.filter_map(|(at, q)| Some((at?, *q))).collect();
    let open = settings.gripper.jaw().map_or(0.0, |jaw| 0.5 * jaw.opening_m);
    let slides = settings.gripper.jaw().map_or(&[][..], |jaw| jaw.slides());
    posture.extend(slides.iter().filter_map(address).map(|at| (at, open)));
    if let Some(fingers) = fingers {
        posture.extend(
            fingers.joints.iter().map(address).zip(&fingers.open().joints).filter_map(|(at, q)| Some((at?, *q))),
        );
    }
    for (at, q) in posture {
        data.qpos_mut()[at] = q;
    }
    data.forward();
}

/// The bodies of the gripper: those that joints other than the arm's move, and those that carry such bodies. The parts of a
/// linkage overlap by design.
fn gripper_parts(model: &MjModel, arm: &[usize]) -> Vec<usize> {
    let of_arm = |body: usize| {
        let first = model.body_jntadr()[body].max(0) as usize;
        let joints = first..first + model.body_jntnum()[body] as usize;
        let on_arm = |joint: usize| arm.contains(&(model.jnt_qposadr()[joint] as usize));
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

/// The region of the robot to which each body belongs.
pub(super) fn regions(model: &MjModel, settings: &RobotSettings) -> Vec<Region> {
    let last = settings.arm.joints.last().and_then(|name| model.name_to_id(MjtObjBase::mjOBJ_JOINT, name));
    let last = last.map_or(0, |joint| model.jnt_bodyid()[joint] as usize);
    let weld = |body: usize| model.body_weldid()[body] as usize;
    let parent = |link: usize| (link != 0).then(|| weld(model.body_parentid()[link] as usize));
    let bodies = 0..model.body_weldid().len();
    let carries = bodies.clone().any(|body| body != last && weld(body) == last);
    bodies.map(|body| region(weld(body), body == last && carries, last, parent, &settings.gripper)).collect()
}
