//! Messages of `motion`: the recorded motion of all bodies of an episode.

use robogate_core::{ContactBetween, ContactPoint, Frame, Pose, Solid, SolidShape, Trajectory};
use serde::{Deserialize, Serialize};

use crate::limits;

/// Numbers of a pose: x, y, z in metres, then the quaternion w, x, y, z.
const POSE: usize = 7;
/// Numbers of a contact: frame, kind, position, force.
const CONTACT: usize = 8;

/// Reply to `motion`. Three frames follow the header: motion, triangles and contacts, all of them 32-bit floats.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MotionReply {
    /// Names of the bodies.
    pub bodies: Vec<String>,
    /// The visible solids of the bodies.
    pub solids: Vec<SolidMessage>,
    /// Number of recorded frames.
    pub frames: usize,
}

/// A visible solid that moves with a body.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SolidMessage {
    /// Index of the body.
    pub body: usize,
    /// Pose in the frame of the body.
    pub pose: Pose,
    /// The shape.
    pub shape: ShapeMessage,
    /// Colour in sRGB.
    pub color: [u8; 3],
    /// From 0 (invisible) to 1 (opaque).
    #[serde(default = "opaque")]
    pub opacity: f64,
}

fn opaque() -> f64 {
    1.0
}

/// A shape. Lengths are in metres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum ShapeMessage {
    /// A box by its half extents.
    Box {
        /// Half extents.
        half: [f64; 3],
    },
    /// A ball.
    Sphere {
        /// Radius.
        radius: f64,
    },
    /// A cylinder along z with half a ball at each end.
    Capsule {
        /// Radius.
        radius: f64,
        /// Half the height of the cylinder.
        half_height: f64,
    },
    /// A cylinder along z.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Half the height.
        half_height: f64,
    },
    /// Some of the triangles in the second frame.
    Mesh {
        /// The first triangle.
        first: usize,
        /// Number of triangles.
        count: usize,
    },
}

impl MotionReply {
    /// A trajectory as a header and the frames after it.
    pub fn pack(trajectory: &Trajectory) -> (Self, [Vec<u8>; 3]) {
        let (mut motion, mut triangles, mut contacts) = (Vec::new(), Vec::new(), Vec::new());
        for (at, frame) in trajectory.frames.iter().enumerate() {
            put(&mut motion, [frame.time_s]);
            frame.poses.iter().for_each(|pose| put(&mut motion, pose.to_array()));
            for contact in &frame.contacts {
                put(&mut contacts, [at as f64, f64::from(kind_of(contact.between))]);
                put(&mut contacts, contact.position);
                put(&mut contacts, contact.force_n);
            }
        }
        let mut stored = 0;
        let solids = trajectory.solids.iter().map(|solid| {
            let shape = match &solid.shape {
                SolidShape::Box { half } => ShapeMessage::Box { half: *half },
                SolidShape::Sphere { radius } => ShapeMessage::Sphere { radius: *radius },
                SolidShape::Capsule { radius, half_height } => {
                    ShapeMessage::Capsule { radius: *radius, half_height: *half_height }
                }
                SolidShape::Cylinder { radius, half_height } => {
                    ShapeMessage::Cylinder { radius: *radius, half_height: *half_height }
                }
                SolidShape::Mesh { triangles: mesh } => {
                    mesh.iter().flatten().for_each(|corner| put(&mut triangles, corner.map(f64::from)));
                    let first = stored;
                    stored += mesh.len();
                    ShapeMessage::Mesh { first, count: mesh.len() }
                }
            };
            SolidMessage { body: solid.body, pose: solid.pose, shape, color: solid.color, opacity: solid.opacity }
        });
        let solids = solids.collect();
        let header = Self { bodies: trajectory.bodies.clone(), solids, frames: trajectory.frames.len() };
        (header, [motion, triangles, contacts])
    }

    /// The trajectory of this header and the frames after it.
    ///
    /// # Errors
    /// If they do not agree, or if a number is not finite.
    pub fn unpack(self, frames: &[Vec<u8>]) -> Result<Trajectory, String> {
        let [motion, triangles, contacts] = frames else {
            return Err(format!("{} frames after the header of `motion`; expected 3", frames.len()));
        };
        let width = 1 + POSE * self.bodies.len();
        let motion = floats(motion, "motion")?;
        if Some(motion.len()) != self.frames.checked_mul(width) {
            return Err(format!("the motion has {} numbers; expected {} x {width}", motion.len(), self.frames));
        }
        let mut frames = motion.chunks_exact(width).map(frame).collect::<Result<Vec<Frame>, String>>()?;
        if !frames.is_sorted_by(|a, b| a.time_s <= b.time_s) {
            return Err("the frames are not in the order of time".to_owned());
        }
        add_contacts(&mut frames, contacts)?;
        let solids = self.solids(&floats(triangles, "triangles")?)?;
        Ok(Trajectory { bodies: self.bodies, solids, frames })
    }

    fn solids(&self, numbers: &[f32]) -> Result<Vec<Solid>, String> {
        let mut triangles = Vec::with_capacity(numbers.len() / 9);
        for triangle in numbers.as_chunks::<9>().0 {
            let [a, b, c, d, e, f, g, h, i] = *triangle;
            triangles.push([[a, b, c], [d, e, f], [g, h, i]]);
        }
        let mut used = 0;
        let mut solids = Vec::with_capacity(self.solids.len());
        for (at, solid) in self.solids.iter().enumerate() {
            let wrong = |what: &str| Err(format!("solids[{at}]: {what}"));
            if solid.body >= self.bodies.len() {
                return wrong("the body does not exist");
            }
            if !is_pose(&solid.pose.to_array()) {
                return wrong("its orientation is not a unit quaternion");
            }
            let shape = match solid.shape {
                ShapeMessage::Box { half } => SolidShape::Box { half },
                ShapeMessage::Sphere { radius } => SolidShape::Sphere { radius },
                ShapeMessage::Capsule { radius, half_height } => SolidShape::Capsule { radius, half_height },
                ShapeMessage::Cylinder { radius, half_height } => SolidShape::Cylinder { radius, half_height },
                ShapeMessage::Mesh { first, count } => {
                    // Solids may share triangles, so their number is bounded apart from the size of the frame.
                    used += count.min(limits::TRIANGLES);
                    if used > limits::TRIANGLES {
                        return wrong(&format!("the solids have more than {} triangles", limits::TRIANGLES));
                    }
                    let mesh = first.checked_add(count).and_then(|end| triangles.get(first..end));
                    let Some(mesh) = mesh else { return wrong("it has triangles that were not sent") };
                    SolidShape::Mesh { triangles: mesh.to_vec() }
                }
            };
            let (body, pose, color) = (solid.body, solid.pose, solid.color);
            solids.push(Solid { body, shape, pose, color, opacity: solid.opacity.clamp(0.0, 1.0) });
        }
        Ok(solids)
    }
}

/// The frame of these numbers: a time, and a pose for each body.
fn frame(numbers: &[f32]) -> Result<Frame, String> {
    let (time_s, poses) = numbers.split_first().ok_or("a frame without a time")?;
    let poses = poses.as_chunks::<POSE>().0.iter().map(|numbers| {
        let pose = numbers.map(f64::from);
        if is_pose(&pose) {
            Ok(Pose::from_array(pose))
        } else {
            Err("an orientation is not a unit quaternion".to_owned())
        }
    });
    Ok(Frame { time_s: f64::from(*time_s), poses: poses.collect::<Result<_, String>>()?, contacts: Vec::new() })
}

fn is_pose([.., w, x, y, z]: &[f64; POSE]) -> bool {
    // Of 32-bit floats.
    (w * w + x * x + y * y + z * z - 1.0).abs() <= 1e-4
}

fn add_contacts(frames: &mut [Frame], bytes: &[u8]) -> Result<(), String> {
    let numbers = floats(bytes, "contacts")?;
    let (contacts, rest) = numbers.as_chunks::<CONTACT>();
    if !rest.is_empty() {
        return Err(format!("the contacts have {} numbers; expected {CONTACT} for each", numbers.len()));
    }
    for [at, kind, x, y, z, force @ ..] in contacts {
        let between = match *kind as u32 {
            0 => ContactBetween::RobotAndObject,
            1 => ContactBetween::RobotAndSurroundings,
            2 => ContactBetween::ObjectAndSurroundings,
            _ => return Err(format!("a contact of the kind {kind}; expected 0, 1 or 2")),
        };
        let frame =
            frames.get_mut(*at as usize).ok_or_else(|| format!("a contact in frame {at}, which was not sent"))?;
        let (position, force_n) = ([*x, *y, *z].map(f64::from), force.map(f64::from));
        frame.contacts.push(ContactPoint { position, force_n, between });
    }
    Ok(())
}

fn kind_of(between: ContactBetween) -> u8 {
    match between {
        ContactBetween::RobotAndObject => 0,
        ContactBetween::RobotAndSurroundings => 1,
        ContactBetween::ObjectAndSurroundings => 2,
    }
}

fn put<const N: usize>(to: &mut Vec<u8>, numbers: [f64; N]) {
    numbers.into_iter().for_each(|number| to.extend((number as f32).to_le_bytes()));
}

/// The finite numbers of a frame.
fn floats(bytes: &[u8], what: &str) -> Result<Vec<f32>, String> {
    let (chunks, rest) = bytes.as_chunks::<4>();
    if !rest.is_empty() {
        return Err(format!("the {what} have {} bytes; expected 32-bit floats", bytes.len()));
    }
    let numbers: Vec<f32> = chunks.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    match numbers.iter().position(|number| !number.is_finite()) {
        Some(at) => Err(format!("number {at} of the {what} is not finite")),
        None => Ok(numbers),
    }
}
