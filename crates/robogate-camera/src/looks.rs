//! Appearance of a robot, and poses of its links.

use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_physics::description::{Description, LinkLook, Solid};
use robogate_physics::{BELLOWS_JOINT, FingerMotion, Robot, RobotError, RobotSource};

use crate::Posture;
use crate::body::Form;
use crate::finish::{Finish, Pattern};
use crate::mesh::Mesh;
use crate::outfits::{self, Outfit};

/// Geometry groups up to this one are rendered, as in MuJoCo's viewer. Simplified collision shapes are in higher
/// groups.
pub(crate) const SHOWN_GROUPS: i32 = 2;

/// The appearance of a robot as the cameras store it.
#[derive(Debug)]
pub(crate) struct RobotLooks {
    pub(crate) pieces: Vec<Piece>,
    /// Whether the pieces come from RoboGate's outfit instead of the model's geometry.
    #[cfg(feature = "egl")]
    pub(crate) dressed: bool,
    /// The model's bodies: name, index of the link that holds the body, and pose in that link.
    #[cfg(feature = "egl")]
    pub(crate) bodies: Vec<(String, usize, Isometry3<f64>)>,
    links: Vec<Option<Hinge>>,
    /// Motion of fingers with drives.
    fingers: Option<FingerMotion>,
    /// The link with the tool centre point, and its pose in that link.
    tool: (usize, Isometry3<f64>),
}

/// A solid of a link.
#[derive(Debug)]
pub(crate) struct Piece {
    pub(crate) link: usize,
    pub(crate) form: Form,
    pub(crate) finish: Finish,
    /// The pose in the link's frame.
    pub(crate) place: Isometry3<f64>,
}

/// The motion of a link relative to its parent.
#[derive(Debug)]
struct Hinge {
    parent: usize,
    in_parent: Isometry3<f64>,
    from_joint: Isometry3<f64>,
    slides: bool,
    drive: Drive,
}

/// The source of a joint's position.
#[derive(Debug, Clone, Copy)]
enum Drive {
    /// A joint of the arm, by its index.
    Arm(usize),
    /// Distance of a finger from the closed position.
    Finger,
    /// A joint of fingers with drives, by its index in their motion.
    Linkage(usize),
    /// The spring of a suction cup.
    Bellows,
    /// `factor` times the joint of another link plus `offset`.
    Follows { link: usize, factor: f64, offset: f64 },
    /// No source: the joint stays at 0.
    Nothing,
}

impl RobotLooks {
    pub(crate) fn new(robot: &Robot) -> Result<Self, String> {
        let why = |error: RobotError| match error {
            RobotError::Invalid { problems, .. } => {
                problems.first().map_or_else(|| "the model cannot be read".to_owned(), |first| first.what.clone())
            }
            other => other.to_string(),
        };
        let description = Description::for_pictures(robot).map_err(why)?;
        let fingers = FingerMotion::of(robot).map_err(why)?;
        let hinges = description.links.iter().map(|link| {
            link.joint.as_ref().map(|joint| Hinge {
                parent: joint.parent,
                in_parent: joint.in_parent,
                from_joint: joint.in_link.inverse(),
                slides: joint.slides,
                drive: drive(&joint.name, robot, &description, fingers.as_ref()),
            })
        });
        let links = hinges.collect();
        let all = || description.links.iter().enumerate().flat_map(|(i, link)| link.looks.iter().map(move |l| (i, l)));
        let shown: Vec<_> = all().filter(|(_, look)| look.group <= SHOWN_GROUPS).collect();
        let drawn = if shown.is_empty() { all().collect() } else { shown };
        let built_in = matches!(robot.source, RobotSource::BuiltIn { .. });
        let outfit = if built_in { outfits::of(robot.name()) } else { None };
        #[cfg(feature = "egl")]
        let dressed = outfit.is_some();
        let mut pieces: Vec<Piece> = match outfit {
            Some(Outfit::Whole(parts)) => parts.iter().filter_map(|part| part.on(&description)).collect(),
            Some(Outfit::Housings) => drawn.into_iter().flat_map(|(link, look)| outfits::housing(link, look)).collect(),
            None => drawn.into_iter().filter_map(|(link, look)| Piece::new(link, look)).collect(),
        };
        if pieces.is_empty() {
            return Err("the model has no visible shape".to_owned());
        }
        pieces.push(outfits::pedestal());
        Ok(Self {
            pieces,
            #[cfg(feature = "egl")]
            dressed,
            #[cfg(feature = "egl")]
            bodies: description.bodies,
            links,
            fingers,
            tool: description.tcp,
        })
    }

    /// Number of links.
    pub(crate) fn link_count(&self) -> usize {
        self.links.len()
    }

    /// Poses of the links.
    pub(crate) fn links(&self, posture: &Posture) -> Vec<Isometry3<f64>> {
        self.links_with(posture, posture.cup_travel_m)
    }

    /// Poses of the links with a cup that is pressed back by `travel` (m).
    fn links_with(&self, posture: &Posture, travel: f64) -> Vec<Isometry3<f64>> {
        let mut poses: Vec<Isometry3<f64>> = Vec::with_capacity(self.links.len());
        // Without an opening the gripper is open.
        let opening = posture.opening_m.unwrap_or(f64::INFINITY);
        let linkage = self.fingers.as_ref().map(|fingers| fingers.joints_at(opening));
        for hinge in &self.links {
            let pose = hinge.as_ref().map_or_else(Isometry3::identity, |hinge| {
                let q = match (hinge.drive, &linkage) {
                    (Drive::Linkage(i), Some(joints)) => joints.get(i).copied().unwrap_or_default(),
                    (Drive::Bellows, _) => -travel,
                    (drive, _) => self.position(drive, posture),
                };
                let motion = if hinge.slides {
                    Isometry3::translation(q, 0.0, 0.0)
                } else {
                    let rotation = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), q);
                    Isometry3::from_parts(Translation3::identity(), rotation)
                };
                // Parents precede their children.
                poses.get(hinge.parent).copied().unwrap_or_default() * hinge.in_parent * motion * hinge.from_joint
            });
            poses.push(pose);
        }
        poses
    }

    /// Pose of the tool centre point, with a relaxed cup: the wrist camera does not move with the lip.
    pub(crate) fn tool(&self, posture: &Posture) -> Isometry3<f64> {
        self.links_with(posture, 0.0).get(self.tool.0).copied().unwrap_or_default() * self.tool.1
    }

    fn position(&self, drive: Drive, posture: &Posture) -> f64 {
        match drive {
            Drive::Arm(i) => posture.joints.get(i).copied().unwrap_or_default(),
            Drive::Finger => 0.5 * posture.opening_m.unwrap_or_default(),
            Drive::Follows { link, factor, offset } => {
                let led = match self.links.get(link).and_then(Option::as_ref).map(|hinge| hinge.drive) {
                    Some(drive @ (Drive::Arm(_) | Drive::Finger)) => self.position(drive, posture),
                    _ => 0.0,
                };
                factor * led + offset
            }
            Drive::Linkage(_) | Drive::Bellows | Drive::Nothing => 0.0,
        }
    }
}

/// The source of the position of the joint with this name.
fn drive(joint: &str, robot: &Robot, description: &Description, fingers: Option<&FingerMotion>) -> Drive {
    let settings = &robot.settings;
    if let Some(i) = settings.arm.joints.iter().position(|name| name == joint) {
        return Drive::Arm(i);
    }
    if joint == BELLOWS_JOINT {
        return Drive::Bellows;
    }
    if settings.gripper.jaw().is_some_and(|jaw| jaw.slides().iter().any(|name| name == joint)) {
        return Drive::Finger;
    }
    if let Some(i) = fingers.and_then(|fingers| fingers.joints.iter().position(|name| name == joint)) {
        return Drive::Linkage(i);
    }
    let coupling = description.couplings.iter().find(|coupling| coupling.second == joint);
    coupling
        .and_then(|coupling| {
            let link = description.link_of(&coupling.first)?;
            Some(Drive::Follows { link, factor: coupling.factor, offset: coupling.offset })
        })
        .unwrap_or(Drive::Nothing)
}

impl Piece {
    /// A visual shape of the model. `None` for a mesh without triangles and for an invisible shape.
    pub(crate) fn new(link: usize, look: &LinkLook) -> Option<Self> {
        let mut place = look.pose;
        let form = match &look.solid {
            Solid::Box { half } => Form::Box { half: half.map(|x| x as f32) },
            Solid::Sphere { radius } => Form::Sphere { radius: *radius as f32 },
            Solid::Capsule { radius, half_height } => {
                Form::Capsule { radius: *radius as f32, half_height: *half_height as f32 }
            }
            Solid::Cylinder { radius, half_height } => {
                Form::Cylinder { radius: *radius as f32, half_height: *half_height as f32 }
            }
            Solid::Hull { points } => {
                let corners = points.chunks_exact(3).map(|t| [t[0].coords, t[1].coords, t[2].coords]);
                let (mesh, middle) = Mesh::new(&corners.collect::<Vec<_>>())?;
                place *= Translation3::from(middle);
                Form::Mesh(Arc::new(mesh))
            }
        };
        // MuJoCo's default colour is a light grey.
        let [red, green, blue, opacity] = look.rgba.unwrap_or([0.5, 0.5, 0.5, 1.0]);
        if opacity <= 0.0 {
            return None;
        }
        let byte = |x: f64| (255.0 * x.clamp(0.0, 1.0)).round() as u8;
        let finish = Finish::new([byte(red), byte(green), byte(blue)], 0.5).with(Pattern::Grain);
        Some(Self { link, form, finish, place })
    }
}
