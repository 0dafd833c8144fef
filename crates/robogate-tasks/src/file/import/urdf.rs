//! URDF as MJCF.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};

use crate::file::meshes::Find;
use crate::file::mjcf::xml::{Element, folder_of, joined};

/// Deepest chain of links.
const DEEPEST: usize = 48;

/// The links and joints of a URDF.
struct Links<'a, 'b> {
    links: BTreeMap<&'a str, &'a Element>,
    /// Joints by their parent link.
    joints: BTreeMap<&'a str, Vec<&'a Element>>,
    colors: BTreeMap<&'a str, &'a str>,
    /// Mesh files by their names in MJCF.
    meshes: BTreeMap<String, (String, String)>,
    folder: &'a str,
    find: Find<'b>,
}

/// The same bodies as MJCF.
pub(super) fn to_mjcf(root: &Element, path: &str, find: Find<'_>) -> Result<Element, String> {
    let mut links = Links {
        links: root.all("link").filter_map(|link| Some((link.get("name")?, link))).collect(),
        joints: BTreeMap::new(),
        colors: BTreeMap::new(),
        meshes: BTreeMap::new(),
        folder: folder_of(path),
        find,
    };
    for material in root.all("material") {
        let color = material.first("color").and_then(|color| color.get("rgba"));
        links.colors.extend(material.get("name").zip(color));
    }
    let mut children = Vec::new();
    for joint in root.all("joint") {
        let link = |name: &str| joint.first(name).and_then(|of| of.get("link"));
        let (Some(parent), Some(child)) = (link("parent"), link("child")) else {
            return Err(wrong(joint, "a joint without `parent` and `child`"));
        };
        if !links.links.contains_key(parent) || !links.links.contains_key(child) {
            return Err(wrong(
                joint,
                &format!("a joint names the link `{parent}` or `{child}`, which the file does not have"),
            ));
        }
        children.push(child);
        links.joints.entry(parent).or_default().push(joint);
    }
    let place = &root.place;
    let mut mujoco = Element::new("mujoco", &[("model", root.get("name").unwrap_or("scene"))], place);
    mujoco.children.push(Element::new("compiler", &[("angle", "radian"), ("autolimits", "true")], place));
    let mut world = Element::new("worldbody", &[], place);
    let tops: Vec<&str> =
        root.all("link").filter_map(|link| link.get("name")).filter(|name| !children.contains(name)).collect();
    if tops.is_empty() {
        return Err(wrong(root, "the file has no link that is not the child of a joint"));
    }
    for top in tops {
        // An empty link named `world` is the world itself.
        let body = links.body(top, None, 0)?;
        if top == "world" && !body.children.iter().any(|child| child.name == "geom") {
            world.children.extend(body.children.into_iter().filter(|child| child.name == "body"));
        } else {
            world.children.push(body);
        }
    }
    let mut asset = Element::new("asset", &[], place);
    for (name, (file, scale)) in &links.meshes {
        asset.children.push(Element::new("mesh", &[("name", name), ("file", file), ("scale", scale)], place));
    }
    mujoco.children.extend([asset, world]);
    Ok(mujoco)
}

fn wrong(element: &Element, what: &str) -> String {
    format!("{}, line {}: {what}", element.place.file, element.place.line)
}

/// Numbers of an attribute.
fn numbers<const N: usize>(element: &Element, name: &str, or: [f64; N]) -> Result<[f64; N], String> {
    let Some(text) = element.get(name) else { return Ok(or) };
    let found: Vec<f64> =
        text.split_whitespace().filter_map(|word| word.parse().ok()).filter(|x: &f64| x.is_finite()).collect();
    found.try_into().map_err(|_| wrong(element, &format!("{name}=\"{text}\" is not {N} numbers")))
}

/// The <origin> of an element: a position, and roll, pitch and yaw about fixed axes.
fn origin(element: &Element) -> Result<Isometry3<f64>, String> {
    let Some(origin) = element.first("origin") else { return Ok(Isometry3::identity()) };
    let [x, y, z] = numbers(origin, "xyz", [0.0; 3])?;
    let [roll, pitch, yaw] = numbers(origin, "rpy", [0.0; 3])?;
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_euler_angles(roll, pitch, yaw)))
}

fn list(numbers: &[f64]) -> String {
    numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(" ")
}

fn set_pose(element: &mut Element, pose: &Isometry3<f64>) {
    let q = pose.rotation.quaternion();
    element.set("pos", &list(pose.translation.vector.as_slice()));
    element.set("quat", &list(&[q.w, q.i, q.j, q.k]));
}

impl Links<'_, '_> {
    /// A link with the links below it. `joint` holds it.
    fn body(&mut self, name: &str, joint: Option<&Element>, depth: usize) -> Result<Element, String> {
        let link = self.links[name];
        if depth > DEEPEST {
            return Err(wrong(
                link,
                &format!("more than {DEEPEST} links are one below another, or joints form a loop"),
            ));
        }
        let mut body = Element::new("body", &[("name", name)], &link.place);
        if let Some(joint) = joint {
            set_pose(&mut body, &origin(joint)?);
            body.children.extend(self.joint(joint)?);
        }
        if let Some(inertial) = link.first("inertial") {
            body.children.push(inertial_of(inertial)?);
        }
        let color = link.all("visual").find_map(|visual| {
            let material = visual.first("material")?;
            let own = material.first("color").and_then(|color| color.get("rgba"));
            own.or_else(|| self.colors.get(material.get("name")?).copied())
        });
        let color = color.map(str::to_owned);
        for collision in link.all("collision") {
            let mut geom = self.geom(collision)?;
            set_pose(&mut geom, &origin(collision)?);
            if let Some(color) = &color {
                geom.set("rgba", color);
            }
            body.children.push(geom);
        }
        for joint in self.joints.get(name).cloned().unwrap_or_default() {
            let child = joint.first("child").and_then(|of| of.get("link")).unwrap_or_default();
            body.children.push(self.body(child, Some(joint), depth + 1)?);
        }
        Ok(body)
    }

    fn joint(&self, joint: &Element) -> Result<Option<Element>, String> {
        let kind = match joint.get("type") {
            Some("fixed") => return Ok(None),
            Some("floating") => return Ok(Some(Element::new("freejoint", &[], &joint.place))),
            Some("revolute" | "continuous") => "hinge",
            Some("prismatic") => "slide",
            other => {
                let other = other.unwrap_or("");
                return Err(wrong(
                    joint,
                    &format!(
                        "joints of type `{other}` are not simulated. Expected revolute, continuous, prismatic, fixed or floating"
                    ),
                ));
            }
        };
        if joint.first("mimic").is_some() {
            return Err(wrong(joint, "the joint follows another one (<mimic>), which is not simulated"));
        }
        let name = joint.get("name").unwrap_or_default();
        let mut made = Element::new("joint", &[("name", name), ("type", kind)], &joint.place);
        let axis = joint.first("axis").map_or(Ok([1.0, 0.0, 0.0]), |axis| numbers(axis, "xyz", [1.0, 0.0, 0.0]))?;
        made.set("axis", &list(&axis));
        if let Some(limit) = joint.first("limit").filter(|_| joint.get("type") != Some("continuous")) {
            let ([low], [high]) = (numbers(limit, "lower", [0.0])?, numbers(limit, "upper", [0.0])?);
            made.set("range", &list(&[low, high]));
        }
        if let Some(dynamics) = joint.first("dynamics") {
            let ([damping], [friction]) = (numbers(dynamics, "damping", [0.0])?, numbers(dynamics, "friction", [0.0])?);
            made.set("damping", &list(&[damping]));
            made.set("frictionloss", &list(&[friction]));
        }
        Ok(Some(made))
    }

    fn geom(&mut self, collision: &Element) -> Result<Element, String> {
        let shape = collision.first("geometry").and_then(|geometry| geometry.children.first());
        let Some(shape) = shape else { return Err(wrong(collision, "<collision> without a shape in <geometry>")) };
        let (kind, size) = match shape.name.as_str() {
            "box" => ("box", numbers(shape, "size", [0.0; 3])?.map(|edge| 0.5 * edge).to_vec()),
            "sphere" => ("sphere", numbers::<1>(shape, "radius", [0.0])?.to_vec()),
            name @ ("cylinder" | "capsule") => {
                let ([radius], [length]) = (numbers(shape, "radius", [0.0])?, numbers(shape, "length", [0.0])?);
                (if name == "cylinder" { "cylinder" } else { "capsule" }, vec![radius, 0.5 * length])
            }
            "mesh" => {
                let file = shape.get("filename").unwrap_or_default();
                let scale = list(&numbers(shape, "scale", [1.0; 3])?);
                let mesh = self.mesh(shape, file, &scale)?;
                return Ok(Element::new("geom", &[("type", "mesh"), ("mesh", &mesh)], &collision.place));
            }
            other => return Err(wrong(shape, &format!("shapes of type `{other}` are not simulated"))),
        };
        Ok(Element::new("geom", &[("type", kind), ("size", &list(&size))], &collision.place))
    }

    /// The name of a mesh. Its file is found beside the URDF or, for a `package://` address, in a folder above it.
    fn mesh(&mut self, shape: &Element, file: &str, scale: &str) -> Result<String, String> {
        let inside = file.strip_prefix("package://").map(|rest| rest.split_once('/').map_or(rest, |(_, rest)| rest));
        let plain = file.strip_prefix("package://").or(file.strip_prefix("file://")).unwrap_or(file);
        let candidates = [Some(plain.to_owned()), inside.map(str::to_owned), inside.map(|rest| format!("../{rest}"))];
        let mut why = String::new();
        let found = candidates.into_iter().flatten().find(|name| match (self.find)(&joined(self.folder, name)) {
            Ok(_) => true,
            Err(error) => {
                why = error;
                false
            }
        });
        let Some(found) = found else { return Err(wrong(shape, &format!("mesh {file}: {why}"))) };
        let known =
            self.meshes.iter().find(|(_, (known, of))| *known == found && of == scale).map(|(name, _)| name.clone());
        Ok(known.unwrap_or_else(|| {
            let name = format!("mesh_{}", self.meshes.len() + 1);
            self.meshes.insert(name.clone(), (found, scale.to_owned()));
            name
        }))
    }
}

fn inertial_of(inertial: &Element) -> Result<Element, String> {
    let pose = origin(inertial)?;
    let of = |name: &str| inertial.first(name);
    let [mass] = of("mass").map_or(Ok([0.0]), |mass| numbers(mass, "value", [0.0]))?;
    let Some(inertia) = of("inertia") else { return Err(wrong(inertial, "<inertial> without <inertia>")) };
    let at = |name: &str| numbers::<1>(inertia, name, [0.0]).map(|[x]| x);
    let (xx, yy, zz) = (at("ixx")?, at("iyy")?, at("izz")?);
    let (xy, xz, yz) = (at("ixy")?, at("ixz")?, at("iyz")?);
    let own = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    let turn = pose.rotation.to_rotation_matrix().into_inner();
    let m = turn * own * turn.transpose();
    let full = list(&[m[(0, 0)], m[(1, 1)], m[(2, 2)], m[(0, 1)], m[(0, 2)], m[(1, 2)]]);
    let position: Vector3<f64> = pose.translation.vector;
    let attributes = [("pos", list(position.as_slice())), ("mass", mass.to_string()), ("fullinertia", full)];
    let attributes: Vec<(&str, &str)> = attributes.iter().map(|(name, value)| (*name, value.as_str())).collect();
    Ok(Element::new("inertial", &attributes, &inertial.place))
}
