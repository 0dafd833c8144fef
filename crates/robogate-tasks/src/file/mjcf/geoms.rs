//! Shapes and masses of MJCF bodies.

use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};
use robogate_physics::{MassProperties, Part, Primitive};

use super::Assets;
use super::attributes::{Source, along, position_text, rotation_text};
use super::xml::{Element, joined};
use crate::file::document::{ShapeTable, Text};

/// Density of geoms that state none, in kg/m^3.
const DENSITY: f64 = 1000.0;

/// A geom in the frame of the body that it belongs to.
pub(super) struct Geom {
    /// `None` if nothing can touch it.
    pub(super) shape: Option<ShapeTable>,
    /// Its mass properties, if it is a primitive that has a mass.
    pub(super) mass: Option<MassProperties>,
    pub(super) is_mesh: bool,
    pub(super) friction: Option<f64>,
    pub(super) color: Option<String>,
}

/// Kind, numbers and place of a geom or a site.
pub(super) struct Solid {
    pub(super) kind: String,
    /// Sizes as MuJoCo states them: half edges; radius and half height.
    pub(super) size: [f64; 3],
    pub(super) pose: Isometry3<f64>,
}

impl Source<'_, '_> {
    /// The solid of a geom or a site in the frame of its body.
    pub(super) fn solid(&mut self, element: &Element, class: &str) -> Option<Solid> {
        let kind = self.word(element, class, "type").unwrap_or_else(|| "sphere".to_owned());
        let mut size = [0.0; 3];
        if let Some(list) = self.list(element, class, "size", 3) {
            size[..list.len()].copy_from_slice(&list);
        }
        let mut pose = self.pose(element, class);
        if let Some([a, b, c, d, e, f]) = self.numbers::<6>(element, class, "fromto") {
            let (from, to) = (Vector3::new(a, b, c), Vector3::new(d, e, f));
            let length = (from - to).norm();
            let Some(turn) = along(from - to) else {
                self.wrong(element, "`fromto` has no length", "name two different points");
                return None;
            };
            match kind.as_str() {
                "capsule" | "cylinder" => size[1] = 0.5 * length,
                "box" | "ellipsoid" => {
                    // One size is that of both edges across.
                    size = [size[0], if size[1] > 0.0 { size[1] } else { size[0] }, 0.5 * length];
                }
                _ => self.wrong(element, format!("`fromto` does not fit a {kind}"), "state `pos` and `size`"),
            }
            pose = Isometry3::from_parts(Translation3::from(0.5 * (from + to)), turn);
        }
        Some(Solid { kind, size, pose })
    }

    /// A geom. `frame` is that of its own body in the frame of the body that it belongs to.
    pub(super) fn geom(
        &mut self,
        element: &Element,
        class: &str,
        frame: &Isometry3<f64>,
        assets: &Assets,
    ) -> Option<Geom> {
        self.check(element, class);
        self.check_class(element, "class");
        let color = self.color(element, class, assets);
        let bits = |source: &mut Self, name: &str| source.number(element, class, name).map_or(1, |bits| bits as i64);
        let touches = bits(self, "contype") != 0 || bits(self, "conaffinity") != 0;
        if !touches {
            self.leave_out("geoms that nothing touches, with their masses");
            return Some(Geom { shape: None, mass: None, is_mesh: false, friction: None, color });
        }
        let solid = self.solid(element, class)?;
        let (text, primitive) = self.shape_of(element, class, &solid, assets)?;
        let pose = frame * solid.pose;
        let (mass, density) = (self.number(element, class, "mass"), self.number(element, class, "density"));
        let density = density.unwrap_or(DENSITY);
        let shape = ShapeTable {
            at: Some(self.text(element, position_text(&pose.translation.vector))),
            rotation: Some(self.text(element, rotation_text(&pose.rotation))),
            mass: mass.map(|mass| self.text(element, format!("{mass} kg"))),
            density: mass.is_none().then(|| self.text(element, format!("{density} kg/m^3"))),
            ..text
        };
        let friction = self.list(element, class, "friction", 3).map(|list| list[0]);
        let properties = primitive.as_ref().map(|primitive| primitive.mass(&pose, mass, density));
        Some(Geom { shape: Some(shape), mass: properties, is_mesh: primitive.is_none(), friction, color })
    }

    /// The shape of a geom as task.toml states it, and as a primitive if it is not a mesh.
    fn shape_of(
        &mut self,
        element: &Element,
        class: &str,
        solid: &Solid,
        assets: &Assets,
    ) -> Option<(ShapeTable, Option<Weighed>)> {
        let [x, y, z] = solid.size;
        let mesh = self.word(element, class, "mesh");
        if let Some(mesh) = mesh.as_ref().filter(|_| solid.kind != "mesh") {
            let what = format!("the {} is fitted to the mesh `{mesh}`", solid.kind);
            self.wrong(element, what, "use type=\"mesh\", or state its size");
            return None;
        }
        let (table, primitive) = match solid.kind.as_str() {
            "box" => {
                let cuboid = Some(self.text(element, format!("{}, {}, {} m", 2.0 * x, 2.0 * y, 2.0 * z)));
                (ShapeTable { cuboid, ..ShapeTable::default() }, Weighed::Primitive(Primitive::Box { half: [x, y, z] }))
            }
            "sphere" => {
                let sphere = Some(self.text(element, format!("{} m", 2.0 * x)));
                let table = ShapeTable { sphere, ..ShapeTable::default() };
                (table, Weighed::Primitive(Primitive::Sphere { radius: x }))
            }
            "cylinder" => {
                let cylinder = Some(self.text(element, format!("{}, {} m", 2.0 * x, 2.0 * y)));
                let primitive = Primitive::Cylinder { radius: x, half_height: y };
                (ShapeTable { cylinder, ..ShapeTable::default() }, Weighed::Primitive(primitive))
            }
            "capsule" => {
                let capsule = Some(self.text(element, format!("{}, {} m", 2.0 * x, 2.0 * y)));
                (ShapeTable { capsule, ..ShapeTable::default() }, Weighed::Capsule { radius: x, half_length: y })
            }
            "mesh" => return self.mesh_shape(element, mesh.as_deref(), assets).map(|table| (table, None)),
            "plane" => {
                self.wrong(
                    element,
                    "a plane is not a shape of a body",
                    "the table of the cell is the plane z = 0. Use a box",
                );
                return None;
            }
            other => {
                let known = ["box", "sphere", "cylinder", "capsule", "mesh"];
                let hint = robogate_core::hint(other, known.into_iter());
                self.wrong(element, format!("geoms of type `{other}` are not simulated: {hint}"), "");
                return None;
            }
        };
        Some((table, Some(primitive)))
    }

    fn mesh_shape(&mut self, element: &Element, name: Option<&str>, assets: &Assets) -> Option<ShapeTable> {
        let Some(name) = name else {
            self.wrong(element, "a geom of type `mesh` without `mesh`", "name a mesh of <asset>");
            return None;
        };
        let Some((asset, file)) = assets.meshes.get(name) else {
            let hint = robogate_core::hint(name, assets.meshes.keys().map(String::as_str));
            self.wrong(element, format!("unknown mesh `{name}`: {hint}"), "");
            return None;
        };
        self.check(asset, super::attributes::MAIN);
        let scale = self.numbers::<3>(asset, super::attributes::MAIN, "scale").unwrap_or([1.0; 3]);
        let pieces = assets.pieces.clone().unwrap_or_else(|| Text { text: "1".to_owned(), at: 0 });
        Some(ShapeTable {
            mesh: Some(self.text(asset, joined(&assets.folder, file))),
            scale: Some(self.text(asset, format!("{}, {}, {}", scale[0], scale[1], scale[2]))),
            pieces: Some(pieces),
            ..ShapeTable::default()
        })
    }

    /// The colour of a geom that can be seen.
    fn color(&mut self, element: &Element, class: &str, assets: &Assets) -> Option<String> {
        let material = self.word(element, class, "material").and_then(|name| assets.materials.get(&name).copied());
        let stated = self.value(element, class, "rgba").is_some();
        let own = if stated { self.numbers::<4>(element, class, "rgba") } else { None };
        // MuJoCo takes this value, its default, as none.
        let rgba = own.filter(|rgba| *rgba != [0.5, 0.5, 0.5, 1.0]).or(material).or(own);
        let [r, g, b, a] = rgba?;
        let byte = |x: f64| (255.0 * x.clamp(0.0, 1.0)).round() as u8;
        (a > 0.0).then(|| format!("#{:02x}{:02x}{:02x}", byte(r), byte(g), byte(b)))
    }

    /// Mass, centre of mass and inertia of an <inertial>.
    pub(super) fn inertial(&mut self, element: &Element, frame: &Isometry3<f64>) -> Option<MassProperties> {
        self.check(element, "");
        let pose = frame * self.pose(element, "");
        let mass_kg = self.number(element, "", "mass");
        let own = match (element.get("diaginertia"), element.get("fullinertia")) {
            (Some(_), None) => {
                self.numbers::<3>(element, "", "diaginertia").map(|of| Matrix3::from_diagonal(&Vector3::from(of)))
            }
            (None, Some(_)) => self
                .numbers::<6>(element, "", "fullinertia")
                .map(|[xx, yy, zz, xy, xz, yz]| Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)),
            _ => None,
        };
        let (Some(mass_kg), Some(own)) = (mass_kg, own) else {
            self.wrong(element, "<inertial> needs `mass` and one of `diaginertia` and `fullinertia`", "");
            return None;
        };
        let rotation = pose.rotation.to_rotation_matrix().into_inner();
        let inertia = rotation * own * rotation.transpose();
        Some(MassProperties { mass_kg, centre: pose.translation.vector, inertia })
    }
}

/// A shape whose mass properties are known without a file.
enum Weighed {
    Primitive(Primitive),
    Capsule { radius: f64, half_length: f64 },
}

impl Weighed {
    fn mass(&self, pose: &Isometry3<f64>, mass_kg: Option<f64>, density: f64) -> MassProperties {
        use std::f64::consts::PI;
        let volume = match self {
            Self::Primitive(primitive) => primitive.volume(),
            Self::Capsule { radius: r, half_length } => 2.0 * PI * r * r * half_length + 4.0 / 3.0 * PI * r.powi(3),
        };
        let mass_kg = mass_kg.unwrap_or(density * volume);
        if !(mass_kg > 0.0 && volume > 0.0) {
            return MassProperties { mass_kg: 0.0, centre: Vector3::zeros(), inertia: Matrix3::zeros() };
        }
        match self {
            Self::Capsule { radius, half_length } => MassProperties::capsule(pose, *radius, *half_length, mass_kg),
            Self::Primitive(primitive) => {
                let part = Part { primitive: primitive.clone(), pose: *pose };
                MassProperties::homogeneous(&[part], mass_kg)
            }
        }
    }
}

/// Half of the edges of the box around a solid along the axes of its frame, if it has one.
pub(super) fn half_edges(solid: &Solid) -> Option<[f64; 3]> {
    let [x, y, z] = solid.size;
    match solid.kind.as_str() {
        "sphere" => Some([if x > 0.0 { x } else { 0.005 }; 3]),
        "box" | "ellipsoid" => Some([x, y, z]),
        "cylinder" => Some([x, x, y]),
        "capsule" => Some([x, x, x + y]),
        _ => None,
    }
}

/// The edges along the axes of a frame that a rotation only permutes. `None` for another rotation.
pub(super) fn permuted(rotation: &UnitQuaternion<f64>, half: [f64; 3]) -> Option<[f64; 3]> {
    // Files often state rotations with four or five digits.
    const ROUNDED: f64 = 1e-3;
    let axes = rotation.to_rotation_matrix().into_inner().map(f64::abs);
    let straight = axes.iter().all(|x| *x < ROUNDED || *x > 1.0 - ROUNDED);
    straight.then(|| (axes.map(f64::round) * Vector3::from(half)).into())
}
