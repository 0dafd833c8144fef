//! Whether a posture of a drafted robot touches the table or the robot itself.

use mujoco_rs::prelude::*;

use super::SHOULDER;
use crate::inspect::DEEP_M;

/// An endless plane, by MuJoCo's convention.
const PLANE: [f64; 3] = [0.0, 0.0, 1.0];

/// The robot on a table, whose top is the plane z = 0.
pub(super) struct Clearance {
    data: MjData<Box<MjModel>>,
    /// The place of each joint of the arm in the positions.
    places: Vec<usize>,
    /// How many joints of the arm move each body.
    depth: Vec<usize>,
    /// The shape of the table.
    table: usize,
}

impl Clearance {
    /// `joints` are those of the arm, from base to tip. `None` if the robot does not compile with a table.
    pub(super) fn of(spec: &MjSpec, joints: &[usize]) -> Option<Self> {
        let mut spec = spec.clone();
        let plane = spec.world_body_mut().add_geom().with_name("robogate_draft_table");
        plane.set_type(MjtGeomBase::mjGEOM_PLANE);
        *plane.size_mut() = PLANE;
        plane.set_contype(i32::MAX);
        plane.set_conaffinity(i32::MAX);
        let model = spec.compile().ok()?;
        let table = model.name_to_id(MjtObjBase::mjOBJ_GEOM, "robogate_draft_table")?;
        let places = joints.iter().map(|joint| model.jnt_qposadr()[*joint] as usize).collect();
        let moved: Vec<usize> = joints.iter().map(|joint| model.jnt_bodyid()[*joint] as usize).collect();
        let mut depth = vec![0; model.body_parentid().len()];
        // Parents come before their children.
        for body in 1..depth.len() {
            depth[body] = depth[model.body_parentid()[body] as usize] + usize::from(moved.contains(&body));
        }
        Some(Self { data: MjData::new(Box::new(model)), places, depth, table })
    }

    /// Whether nothing touches with the arm at these positions. Neighbours in the chain, parts of the gripper, and the table with
    /// the shoulder do not count.
    pub(super) fn is_free(&mut self, positions: &[f64]) -> bool {
        for (place, position) in self.places.iter().zip(positions) {
            self.data.qpos_mut()[*place] = *position;
        }
        self.data.forward();
        let model = self.data.model();
        let depth = |geom: i32| self.depth[model.geom_bodyid()[geom as usize] as usize];
        !self.data.contact().iter().any(|contact| {
            let (one, two) = (contact.geom1, contact.geom2);
            if one < 0 || two < 0 || contact.dist > -DEEP_M {
                return false;
            }
            let (a, b) = (depth(one), depth(two));
            match [one, two].contains(&(self.table as i32)) {
                true => a.max(b) > SHOULDER,
                false => a.abs_diff(b) > 1,
            }
        })
    }
}
