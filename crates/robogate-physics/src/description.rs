//! A robot's model as plain data, read from its MJCF without MuJoCo.

use std::fs;
use std::path::{Path, PathBuf};

use mjcf_rs::body::{Geom, GeomType, InertiaSpec, Joint, JointType};
use mjcf_rs::equality::Equality;
use nalgebra::{Isometry3, Matrix3, Point3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3};

use crate::robot::{BELLOWS_JOINT, CONTINUOUS_RAD, RobotSource};
use crate::{Bellows, Chain, ChainJoint, Problem, Robot, RobotError, Triangles, includes, robot_folder};

/// A tree of rigid bodies. A body without a joint is part of its parent link.
#[derive(Debug, Clone)]
pub struct Description {
    /// The links, parents before children. The first is the base.
    pub links: Vec<Link>,
    /// Pairs of joints where one follows the other.
    pub couplings: Vec<Coupling>,
    /// The kinematic chain from the base to the tool.
    pub chain: Chain,
    /// The link that carries the tool centre point, and its pose there.
    pub tcp: (usize, Isometry3<f64>),
    /// The MJCF bodies: name, index of the link that holds the body, and pose in that link.
    pub bodies: Vec<(String, usize, Isometry3<f64>)>,
}

/// One rigid body.
#[derive(Debug, Clone)]
pub struct Link {
    /// The motion relative to its parent. `None` for the base.
    pub joint: Option<LinkJoint>,
    /// Mass in kilograms.
    pub mass: f64,
    /// Centre of mass in the link's frame, in metres.
    pub centre: Vector3<f64>,
    /// Inertia about the centre of mass in the link's frame, in kg m^2.
    pub inertia: Matrix3<f64>,
    /// Collision shapes.
    pub shapes: Vec<LinkShape>,
    /// Visual shapes.
    pub looks: Vec<LinkLook>,
}

/// The motion of a link relative to its parent.
#[derive(Debug, Clone)]
pub struct LinkJoint {
    /// Name of the joint.
    pub name: String,
    /// Index of the parent link.
    pub parent: usize,
    /// The joint's frame in the parent's frame at joint position 0. The joint moves about or along its x axis.
    pub in_parent: Isometry3<f64>,
    /// The joint's frame in the link's frame.
    pub in_link: Isometry3<f64>,
    /// Whether it is a sliding joint; otherwise it is a hinge.
    pub slides: bool,
    /// Smallest and largest position, in metres or radians; `None` without limits.
    pub range: Option<[f64; 2]>,
    /// Reflected inertia of the drive, in kg m^2 or kg.
    pub armature: f64,
    /// Viscous damping, in N m s/rad or N s/m.
    pub damping: f64,
}

/// A collision shape of a link: a convex solid.
#[derive(Debug, Clone)]
pub struct LinkShape {
    /// The solid.
    pub solid: Solid,
    /// The pose in the link's frame.
    pub pose: Isometry3<f64>,
    /// Name of the MJCF body that it belongs to.
    pub body: String,
}

/// A visual shape of a link.
#[derive(Debug, Clone)]
pub struct LinkLook {
    /// The solid. The points of a mesh are the corners of its triangles, three for each; none if its file has no faces.
    pub solid: Solid,
    /// The pose in the link's frame.
    pub pose: Isometry3<f64>,
    /// Red, green, blue and opacity from 0 to 1, if the model gives them.
    pub rgba: Option<[f64; 4]>,
    /// Name of the MJCF geometry.
    pub name: Option<String>,
    /// The MJCF geometry group.
    pub group: i32,
}

/// A convex solid, centred at its own origin, axes along z. Lengths are in metres.
#[derive(Debug, Clone)]
pub enum Solid {
    /// A box.
    Box {
        /// Half extents along x, y, z.
        half: [f64; 3],
    },
    /// A cylinder.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Half the height.
        half_height: f64,
    },
    /// A cylinder with a half ball at each end.
    Capsule {
        /// Radius.
        radius: f64,
        /// Half the height of the cylinder, without the half balls.
        half_height: f64,
    },
    /// A ball.
    Sphere {
        /// Radius.
        radius: f64,
    },
    /// The convex hull of points.
    Hull {
        /// The points.
        points: Vec<Point3<f64>>,
    },
}

/// A linear coupling of two joints: `second = factor x first + offset`.
#[derive(Debug, Clone)]
pub struct Coupling {
    /// Name of the leading joint.
    pub first: String,
    /// Name of the following joint.
    pub second: String,
    /// Factor.
    pub factor: f64,
    /// Offset, in radians or metres.
    pub offset: f64,
}

impl Description {
    /// Reads the robot's model and checks it against its settings.
    ///
    /// # Errors
    /// If the model is not MJCF, uses elements that this reader does not know, or does not match `robot.toml`.
    pub fn read(robot: &Robot) -> Result<Self, RobotError> {
        let (path, folder, text) = match &robot.source {
            RobotSource::BuiltIn { model, .. } => {
                (PathBuf::from(&robot.settings.model), PathBuf::new(), (*model).to_owned())
            }
            RobotSource::Folder(folder) => {
                let path = folder.join(&robot.settings.model);
                let text = fs::read_to_string(&path)
                    .map_err(|e| RobotError::Read { path: path.clone(), why: e.to_string() })?;
                (path, folder.clone(), text)
            }
        };
        Self::of_text(robot, &path, &folder, &text)
    }

    /// The model as cameras and pages show it. MuJoCo converts a URDF, whose visual shapes replace its collision shapes.
    ///
    /// # Errors
    /// As [`Self::read`], or if MuJoCo cannot read the URDF.
    pub fn for_pictures(robot: &Robot) -> Result<Self, RobotError> {
        #[cfg(feature = "mujoco")]
        if let RobotSource::Folder(folder) = &robot.source
            && crate::robot_model::is_urdf(Path::new(&robot.settings.model))
        {
            let path = folder.join(&robot.settings.model);
            let text =
                crate::robot_model::pictured(&path).map_err(|why| RobotError::Read { path: path.clone(), why })?;
            return Self::of_text(robot, &path, folder, &text);
        }
        Self::read(robot)
    }

    fn of_text(robot: &Robot, path: &Path, folder: &Path, text: &str) -> Result<Self, RobotError> {
        let hint = "Rapier and the cameras read a subset of MJCF without MuJoCo. Try --engine mujoco";
        let invalid =
            |why: String| RobotError::Invalid { path: path.to_owned(), problems: vec![Problem::new(why, hint)] };
        let text = includes::replaced(text, folder).map_err(invalid)?;
        // Files within the limits can exceed them together.
        robot_folder::check_model(text.as_bytes()).map_err(invalid)?;
        let model = mjcf_rs::Model::from_str(&text, folder).map_err(|e| invalid(e.to_string()))?;
        Reader { model: &model, folder }.read(robot).map_err(invalid)
    }

    /// Index of the link that the joint of that name moves.
    pub fn link_of(&self, joint: &str) -> Option<usize> {
        self.links.iter().position(|link| link.joint.as_ref().is_some_and(|j| j.name == joint))
    }
}

/// The spring of a suction cup.
#[derive(Debug, Clone, Copy)]
struct Spring {
    /// Index of the cup's body.
    body: usize,
    /// The tool's z axis in that body's frame.
    axis: Unit<Vector3<f64>>,
    bellows: Bellows,
}

struct Reader<'a> {
    model: &'a mjcf_rs::Model,
    folder: &'a Path,
}

impl Reader<'_> {
    fn read(&self, robot: &Robot) -> Result<Description, String> {
        let base = Link {
            joint: None,
            mass: 0.0,
            centre: Vector3::zeros(),
            inertia: Matrix3::zeros(),
            shapes: Vec::new(),
            looks: Vec::new(),
        };
        let mut links = vec![base];
        let spring = self.spring(robot)?;
        // For each MJCF body: the link that it is part of, and its pose there at joint positions 0.
        let mut places: Vec<(usize, Isometry3<f64>)> = Vec::with_capacity(self.model.bodies.len());
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), robot.settings.arm.base_yaw_rad);
        let yaw = Isometry3::from_parts(Translation3::identity(), yaw);
        for (id, entry) in self.model.bodies.iter().enumerate() {
            let body = &entry.body;
            let name = body.name.clone().unwrap_or_else(|| format!("body {id}"));
            let (parent, placement) = match entry.parent {
                Some(parent) => {
                    let (link, placement) = *places.get(parent).ok_or("a body comes before its parent")?;
                    (link, placement * isometry(&body.pose))
                }
                None => (0, yaw),
            };
            let spring = spring.filter(|spring| spring.body == id);
            let joint = match (body.joints.as_slice(), spring) {
                ([], None) => None,
                ([], Some(spring)) => Some(bellows_joint(parent, &placement, &spring)),
                ([joint], None) => Some(self.joint(joint, parent, &placement, &name)?),
                (_, None) => return Err(format!("body `{name}` has several joints; give each joint a separate body")),
                (_, Some(_)) => return Err(format!("gripper.bellows: the body `{name}` has a joint of its own")),
            };
            let moves = joint.is_some();
            let place = match joint {
                None => (parent, placement),
                Some(joint) => {
                    links.push(Link {
                        joint: Some(joint),
                        mass: 0.0,
                        centre: Vector3::zeros(),
                        inertia: Matrix3::zeros(),
                        shapes: Vec::new(),
                        looks: Vec::new(),
                    });
                    (links.len() - 1, Isometry3::identity())
                }
            };
            places.push(place);
            let (link, within) = (&mut links[place.0], place.1);
            for geom in &body.geoms {
                // A shape without contacts is visual only.
                if geom.contype != 0 || geom.conaffinity != 0 {
                    let (solid, at) = self.solid(geom)?;
                    link.shapes.push(LinkShape { solid, pose: within * at, body: name.clone() });
                }
                // An unreadable visual shape does not affect physics and is skipped.
                link.looks.extend(self.look(geom, &within).ok());
            }
            if let Some(inertial) = &body.inertial {
                let frame = within * isometry(&inertial.pose);
                let about = match inertial.inertia {
                    InertiaSpec::Diagonal(d) => Matrix3::from_diagonal(&Vector3::from(d)),
                    InertiaSpec::Full([xx, yy, zz, xy, xz, yz]) => Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
                };
                let rotation = frame.rotation.to_rotation_matrix();
                link.add(inertial.mass, frame.translation.vector, rotation * about * rotation.inverse());
            } else if moves {
                return Err(format!("body `{name}` moves but has no <inertial>, which Rapier requires"));
            }
        }
        let site = |wanted: &str| {
            if let Some(site) = robot.settings.sites.iter().find(|site| site.name == wanted) {
                let body = self.model.body_id_by_name(&site.body);
                let body = body.ok_or_else(|| format!("[[site]] `{wanted}`: the model has no body `{}`", site.body))?;
                let (link, within) = places[body];
                let [roll, pitch, yaw] = site.rpy_rad;
                let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
                return Ok((
                    link,
                    within * Isometry3::from_parts(Translation3::from(Vector3::from(site.position_m)), rotation),
                ));
            }
            let (body, site) = self
                .model
                .site_by_name(wanted)
                .ok_or_else(|| format!("the model has no site `{wanted}`, which robot.toml names"))?;
            let (link, within) = places[body];
            Ok::<_, String>((link, within * isometry(&self.model.bodies[body].body.sites[site].pose)))
        };
        let tcp = site(&robot.settings.arm.tcp_site)?;
        let flange = site(&robot.settings.arm.flange_site)?;
        let chain = chain(&links, robot, tcp, flange)?;
        let named = self.model.bodies.iter().zip(&places);
        let bodies =
            named.filter_map(|(entry, (link, within))| Some((entry.body.name.clone()?, *link, *within))).collect();
        // The motion of fingers with drives is measured, not computed from couplings.
        let measured = robot.settings.gripper.jaw().is_some_and(|jaw| !jaw.drives.is_empty());
        let couplings = if measured { Vec::new() } else { self.couplings()? };
        Ok(Description { chain, couplings, links, tcp, bodies })
    }

    /// The spring of a suction cup, if the robot has one.
    fn spring(&self, robot: &Robot) -> Result<Option<Spring>, String> {
        let Some(cup) = robot.settings.gripper.cup() else { return Ok(None) };
        let Some(bellows) = cup.bellows else { return Ok(None) };
        let tcp = &robot.settings.arm.tcp_site;
        let (body, rotation) = match robot.settings.sites.iter().find(|site| site.name == *tcp) {
            Some(site) => {
                let [roll, pitch, yaw] = site.rpy_rad;
                (self.model.body_id_by_name(&site.body), UnitQuaternion::from_euler_angles(roll, pitch, yaw))
            }
            None => {
                let (body, site) =
                    self.model.site_by_name(tcp).ok_or_else(|| format!("the model has no site `{tcp}`"))?;
                (Some(body), isometry(&self.model.bodies[body].body.sites[site].pose).rotation)
            }
        };
        let on_cup = body.filter(|body| self.model.body_id_by_name(&cup.cup_body) == Some(*body));
        let body = on_cup.ok_or_else(|| {
            format!("gripper.bellows: the site `{tcp}` is not on the body `{}`, which the spring moves", cup.cup_body)
        })?;
        Ok(Some(Spring { body, axis: rotation * Vector3::z_axis(), bellows }))
    }

    fn joint(&self, joint: &Joint, parent: usize, placement: &Isometry3<f64>, body: &str) -> Result<LinkJoint, String> {
        let name = joint.name.clone().unwrap_or_else(|| format!("the joint of body `{body}`"));
        let slides = match joint.type_ {
            JointType::Hinge => false,
            JointType::Slide => true,
            JointType::Ball | JointType::Free => return Err(format!("`{name}` is neither a hinge nor a slide")),
        };
        let axis = Unit::try_new(Vector3::from(joint.axis), 1e-12).ok_or_else(|| format!("`{name}` has no axis"))?;
        let in_link = Isometry3::from_parts(Translation3::from(Vector3::from(joint.pos)), turned_to(&axis));
        let limited = joint.limited.resolve(self.model.compiler.autolimits, joint.range.is_some());
        Ok(LinkJoint {
            name,
            parent,
            in_parent: placement * in_link,
            in_link,
            slides,
            range: joint.range.filter(|_| limited),
            armature: joint.armature,
            damping: joint.damping,
        })
    }

    fn solid(&self, geom: &Geom) -> Result<(Solid, Isometry3<f64>), String> {
        let name = geom.name.as_deref().unwrap_or("without a name");
        let [a, b, c] = geom.size;
        let at = isometry(&geom.pose);
        if let Some([x1, y1, z1, x2, y2, z2]) = geom.fromto {
            let (from, to) = (Vector3::new(x1, y1, z1), Vector3::new(x2, y2, z2));
            let along = to - from;
            let rotation = UnitQuaternion::rotation_between(&Vector3::z(), &along)
                .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
            let at = Isometry3::from_parts(Translation3::from(0.5 * (from + to)), rotation);
            let half_height = 0.5 * along.norm();
            return match geom.type_ {
                GeomType::Capsule => Ok((Solid::Capsule { radius: a, half_height }, at)),
                GeomType::Cylinder => Ok((Solid::Cylinder { radius: a, half_height }, at)),
                GeomType::Box => Ok((Solid::Box { half: [a, a, half_height] }, at)),
                _ => Err(format!("shape `{name}`: fromto is supported for capsules, cylinders and boxes only")),
            };
        }
        let solid = match geom.type_ {
            GeomType::Box => Solid::Box { half: [a, b, c] },
            GeomType::Sphere => Solid::Sphere { radius: a },
            GeomType::Capsule => Solid::Capsule { radius: a, half_height: b },
            GeomType::Cylinder => Solid::Cylinder { radius: a, half_height: b },
            GeomType::Mesh => Solid::Hull { points: self.hull(geom, name)? },
            GeomType::Plane | GeomType::Hfield | GeomType::Ellipsoid | GeomType::Sdf => {
                return Err(format!(
                    "shape `{name}` has an unsupported type. Expected box, sphere, capsule, cylinder or mesh"
                ));
            }
        };
        Ok((solid, at))
    }

    fn look(&self, geom: &Geom, within: &Isometry3<f64>) -> Result<LinkLook, String> {
        let (mut solid, at) = self.solid(geom)?;
        if let Solid::Hull { points } = &mut solid {
            let faces = self.faces(geom)?;
            let corners: Option<Vec<_>> = faces.iter().map(|i| points.get(*i).copied()).collect();
            *points = corners.ok_or("a mesh has a face with a missing vertex")?;
        }
        let material = geom.material.as_deref().and_then(|name| self.model.assets.material(name)?.rgba);
        Ok(LinkLook {
            solid,
            pose: within * at,
            rgba: geom.rgba.or(material),
            name: geom.name.clone(),
            group: geom.group,
        })
    }

    /// The corners of a mesh's triangles as vertex indices.
    fn faces(&self, geom: &Geom) -> Result<Vec<usize>, String> {
        let wanted = geom.mesh.as_deref().unwrap_or_default();
        let mesh = self.model.assets.mesh(wanted).ok_or_else(|| format!("the model has no mesh `{wanted}`"))?;
        if mesh.inline_vertices.is_some() {
            return Ok(mesh.inline_faces.iter().flatten().map(|i| *i as usize).collect());
        }
        Ok(self.file_of(mesh, wanted)?.faces.into_iter().flatten().map(|i| i as usize).collect())
    }

    /// The vertices of a mesh. Rapier uses their convex hull, as MuJoCo does.
    fn hull(&self, geom: &Geom, name: &str) -> Result<Vec<Point3<f64>>, String> {
        let wanted = geom.mesh.as_deref().ok_or_else(|| format!("shape `{name}` names no mesh"))?;
        let mesh = self.model.assets.mesh(wanted).ok_or_else(|| format!("the model has no mesh `{wanted}`"))?;
        let vertices = match &mesh.inline_vertices {
            Some(flat) => flat.chunks_exact(3).map(|v| Point3::new(v[0], v[1], v[2])).collect(),
            None => self.file_of(mesh, wanted)?.vertices,
        };
        let place = isometry(&mesh.refpose);
        let points: Vec<_> = vertices
            .iter()
            .map(|vertex| place.inverse_transform_point(vertex))
            .map(|p| Point3::new(p.x * mesh.scale[0], p.y * mesh.scale[1], p.z * mesh.scale[2]))
            .collect();
        if points.len() < 4 || points.iter().any(|p| !p.coords.iter().all(|x| x.is_finite())) {
            return Err(format!("mesh `{wanted}` has no four finite vertices"));
        }
        Ok(points)
    }

    /// The file of a mesh.
    fn file_of(&self, mesh: &mjcf_rs::assets::Mesh, name: &str) -> Result<Triangles, String> {
        let path = self.model.resolve_mesh_file(mesh, self.folder);
        let path = path.ok_or_else(|| format!("mesh `{name}` has neither file nor vertices"))?;
        let bytes = fs::read(&path).map_err(|e| format!("mesh `{name}`: {}: {e}", path.display()))?;
        // The size of a robot's files is limited.
        Triangles::read(&bytes, usize::MAX).map_err(|why| format!("mesh `{name}`: {}: {why}", path.display()))
    }

    fn couplings(&self) -> Result<Vec<Coupling>, String> {
        let mut couplings = Vec::new();
        for equality in &self.model.equality {
            match equality {
                Equality::Joint(joint) if joint.common.active => {
                    let [offset, factor, square, cube, fourth] = joint.polycoef;
                    let Some(second) = joint.joint2.clone().filter(|_| [square, cube, fourth] == [0.0; 3]) else {
                        return Err(format!(
                            "the coupling of joint `{}` is not linear; Rapier supports linear couplings only",
                            joint.joint1
                        ));
                    };
                    // MJCF: joint1 follows joint2.
                    couplings.push(Coupling { first: second, second: joint.joint1.clone(), factor, offset });
                }
                Equality::Joint(_) => {}
                _ => return Err("an <equality> other than between two joints is not supported by Rapier".to_owned()),
            }
        }
        Ok(couplings)
    }
}

impl Link {
    /// Adds a part's mass, centre and inertia about that centre, in the link's frame.
    fn add(&mut self, mass: f64, centre: Vector3<f64>, inertia: Matrix3<f64>) {
        let total = self.mass + mass;
        if total <= 0.0 {
            return;
        }
        let both = (self.mass * self.centre + mass * centre) / total;
        let shifted = |m: f64, c: Vector3<f64>| {
            let d = c - both;
            m * (Matrix3::identity() * d.norm_squared() - d * d.transpose())
        };
        self.inertia = self.inertia + shifted(self.mass, self.centre) + inertia + shifted(mass, centre);
        (self.mass, self.centre) = (total, both);
    }
}

/// Converts a pose of the MJCF reader, which Rapier shares, to nalgebra's type.
pub(crate) fn isometry(pose: &mjcf_rs::Pose) -> Isometry3<f64> {
    let (t, r) = (pose.translation, pose.rotation);
    let rotation = UnitQuaternion::new_normalize(Quaternion::new(r.w, r.x, r.y, r.z));
    Isometry3::from_parts(Translation3::new(t.x, t.y, t.z), rotation)
}

/// The joint of a cup's spring.
fn bellows_joint(parent: usize, placement: &Isometry3<f64>, spring: &Spring) -> LinkJoint {
    let in_link = Isometry3::from_parts(Translation3::identity(), turned_to(&spring.axis));
    LinkJoint {
        name: BELLOWS_JOINT.to_owned(),
        parent,
        in_parent: placement * in_link,
        in_link,
        slides: true,
        range: Some([-spring.bellows.stroke_m, 0.0]),
        armature: 0.0,
        damping: 0.0,
    }
}

/// A rotation that turns the x axis to this axis.
fn turned_to(axis: &Unit<Vector3<f64>>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between_axis(&Vector3::x_axis(), axis)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI))
}

/// The serial chain of the arm's joints, tool and flange at its end.
fn chain(
    links: &[Link],
    robot: &Robot,
    tcp: (usize, Isometry3<f64>),
    flange: (usize, Isometry3<f64>),
) -> Result<Chain, String> {
    let arm = &robot.settings.arm;
    // The kinematics are those of the relaxed cup. A flange can be on its body too.
    let [tcp, flange] = [tcp, flange].map(|(link, place)| {
        let spring = links[link].joint.as_ref().filter(|joint| joint.name == BELLOWS_JOINT);
        spring.map_or((link, place), |joint| (joint.parent, joint.in_parent * joint.in_link.inverse() * place))
    });
    let mut path = vec![tcp.0];
    while let Some(joint) = links[path[path.len() - 1]].joint.as_ref() {
        path.push(joint.parent);
    }
    path.pop();
    path.reverse();
    let names: Vec<&str> = path.iter().filter_map(|l| links[*l].joint.as_ref()).map(|j| j.name.as_str()).collect();
    if names != arm.joints {
        return Err(format!(
            "the joints between base and `{}` are {}, but arm.joints has {}: list every joint of the arm, base to tip",
            arm.tcp_site,
            names.join(", "),
            arm.joints.join(", ")
        ));
    }
    if flange.0 != tcp.0 {
        return Err(format!("site `{}` is not on the arm's last link", arm.flange_site));
    }
    let mut joints = Vec::new();
    // Transform from a link's frame to its joint's frame, in which the next placement is expressed.
    let mut back = Isometry3::identity();
    for joint in path.iter().filter_map(|l| links[*l].joint.as_ref()) {
        if joint.slides {
            return Err(format!("joint `{}` is not a hinge: arms with sliding joints are not supported", joint.name));
        }
        let range = joint.range.unwrap_or([-CONTINUOUS_RAD, CONTINUOUS_RAD]);
        joints.push(ChainJoint { placement: back * joint.in_parent, axis: Vector3::x_axis(), range });
        back = joint.in_link.inverse();
    }
    Ok(Chain { joints, flange: back * flange.1, tcp: back * tcp.1 })
}
