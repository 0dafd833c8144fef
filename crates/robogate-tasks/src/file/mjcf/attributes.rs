//! Attributes of MJCF elements: their values, with default classes, and the poses that they state.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::xml::{Element, Place, Wrong};
use crate::file::document::Text;
use crate::file::problem::Problems;

/// The class of elements that name none.
pub(super) const MAIN: &str = "main";
/// Most problems that are reported for one file.
const MOST_PROBLEMS: usize = 40;

/// A file that is being translated: its settings, and what was found wrong with it.
pub(super) struct Source<'a, 'p> {
    problems: &'a mut Problems<'p>,
    found: usize,
    /// The attributes of each default class, by element.
    defaults: BTreeMap<String, BTreeMap<String, Vec<(String, String)>>>,
    degrees: bool,
    euler: [char; 3],
    pub(super) autolimits: bool,
    /// What was left out, and how often.
    pub(super) left_out: BTreeMap<String, usize>,
}

impl<'a, 'p> Source<'a, 'p> {
    pub(super) fn new(root: &Element, problems: &'a mut Problems<'p>) -> Self {
        let mut source = Self {
            problems,
            found: 0,
            defaults: BTreeMap::from([(MAIN.to_owned(), BTreeMap::new())]),
            degrees: true,
            euler: ['x', 'y', 'z'],
            autolimits: true,
            left_out: BTreeMap::new(),
        };
        for compiler in root.all("compiler") {
            source.check(compiler, MAIN);
            source.degrees = compiler.get("angle").map_or(source.degrees, |angle| angle != "radian");
            source.autolimits = compiler.get("autolimits").map_or(source.autolimits, |text| text != "false");
            let Some(text) = compiler.get("eulerseq") else { continue };
            match <[char; 3]>::try_from(text.chars().collect::<Vec<_>>()) {
                Ok(axes) if axes.iter().all(|axis| "xyzXYZ".contains(*axis)) => source.euler = axes,
                _ => source.wrong(compiler, format!("eulerseq=\"{text}\" does not name three axes"), "write `xyz`"),
            }
        }
        for default in root.all("default") {
            let class = default.get("class").unwrap_or(MAIN).to_owned();
            source.read_defaults(default, &class, MAIN);
        }
        source
    }

    fn read_defaults(&mut self, element: &Element, class: &str, parent: &str) {
        let mut own = self.defaults.get(if class == MAIN { MAIN } else { parent }).cloned().unwrap_or_default();
        for child in element.children.iter().filter(|child| child.name != "default") {
            self.check(child, "");
            let of = own.entry(child.name.clone()).or_default();
            for (name, value) in child.attributes.iter().filter(|(name, _)| name != "class") {
                of.retain(|(known, _)| known != name);
                of.push((name.clone(), value.clone()));
            }
        }
        self.defaults.insert(class.to_owned(), own);
        for child in element.all("default") {
            match child.get("class") {
                Some(name) if self.defaults.contains_key(name) => {
                    self.wrong(child, format!("a second default class `{name}`"), "use different names");
                }
                Some(name) => self.read_defaults(child, name, class),
                None => self.wrong(child, "a <default> in a <default> without `class`", "name the class"),
            }
        }
    }

    /// Adds a problem of an element.
    pub(super) fn wrong(&mut self, element: &Element, what: impl Into<String>, hint: &str) {
        let Place { file, line } = &element.place;
        self.add(&Wrong { place: Place { file: file.clone(), line: *line }, what: what.into(), hint: hint.to_owned() });
    }

    fn add(&mut self, wrong: &Wrong) {
        self.found += 1;
        if self.found <= MOST_PROBLEMS {
            let at = self.problems.elsewhere(&wrong.place.file, wrong.place.line);
            self.problems.at(at, wrong.what.clone(), wrong.hint.clone());
        }
    }

    /// A text of task.toml that stands for an element.
    pub(super) fn text(&mut self, element: &Element, text: impl Into<String>) -> Text {
        Text { text: text.into(), at: self.problems.elsewhere(&element.place.file, element.place.line) }
    }

    pub(super) fn leave_out(&mut self, what: &str) {
        *self.left_out.entry(what.to_owned()).or_default() += 1;
    }

    /// The value of an attribute: of the element itself or of its class. `class` is that of its body.
    pub(super) fn value<'e>(&'e self, element: &'e Element, class: &'e str, name: &str) -> Option<&'e str> {
        if let Some(own) = element.get(name) {
            return Some(own);
        }
        let class = element.get("class").unwrap_or(class);
        let of = self.defaults.get(class)?.get(&element.name)?;
        of.iter().find(|(known, _)| known == name).map(|(_, value)| value.as_str())
    }

    /// Whether the file has a default class. Adds a problem if it does not.
    pub(super) fn check_class(&mut self, element: &Element, attribute: &str) {
        let Some(class) = element.get(attribute) else { return };
        if !self.defaults.contains_key(class) {
            let hint = robogate_core::hint(class, self.defaults.keys().map(String::as_str));
            self.wrong(element, format!("unknown default class `{class}`: {hint}"), "");
        }
    }

    /// The numbers of an attribute, at most `most`.
    pub(super) fn list(&mut self, element: &Element, class: &str, name: &str, most: usize) -> Option<Vec<f64>> {
        let text = self.value(element, class, name)?;
        let found: Option<Vec<f64>> = text
            .split_whitespace()
            .map(|word| word.parse::<f64>().ok().filter(|x| x.is_finite() && x.abs() <= 1e9))
            .collect();
        let shown: String = text.chars().take(60).collect();
        match found {
            Some(found) if (1..=most).contains(&found.len()) => Some(found),
            Some(found) => {
                let what = format!("{name}=\"{shown}\" has {} numbers. Expected {most}", found.len());
                self.wrong(element, what, "");
                None
            }
            None => {
                self.wrong(element, format!("{name}=\"{shown}\" is not a list of numbers"), "");
                None
            }
        }
    }

    /// Exactly `N` numbers of an attribute.
    pub(super) fn numbers<const N: usize>(&mut self, element: &Element, class: &str, name: &str) -> Option<[f64; N]> {
        let found = self.list(element, class, name, N)?;
        let count = found.len();
        let found = <[f64; N]>::try_from(found).ok();
        if found.is_none() {
            self.wrong(element, format!("`{name}` has {count} numbers. Expected {N}"), "");
        }
        found
    }

    /// The first of the numbers of an attribute.
    pub(super) fn number(&mut self, element: &Element, class: &str, name: &str) -> Option<f64> {
        self.list(element, class, name, 3).map(|list| list[0])
    }

    pub(super) fn angle(&self, value: f64) -> f64 {
        if self.degrees { value.to_radians() } else { value }
    }

    /// A word of an attribute.
    pub(super) fn word(&self, element: &Element, class: &str, name: &str) -> Option<String> {
        self.value(element, class, name).map(str::to_owned)
    }

    /// The pose that an element states in the frame of its parent.
    pub(super) fn pose(&mut self, element: &Element, class: &str) -> Isometry3<f64> {
        let at = self.numbers::<3>(element, class, "pos").unwrap_or_default();
        if at.iter().any(|x| x.abs() > 100.0) {
            self.wrong(element, "`pos` is more than 100 m away", "positions are in metres");
        }
        Isometry3::from_parts(Translation3::from(at), self.rotation(element, class))
    }

    fn rotation(&mut self, element: &Element, class: &str) -> UnitQuaternion<f64> {
        const WAYS: [&str; 5] = ["quat", "axisangle", "xyaxes", "zaxis", "euler"];
        // One that the element states itself comes before those of its class.
        let stated: Vec<&str> = WAYS.into_iter().filter(|way| element.get(way).is_some()).collect();
        if stated.len() > 1 {
            let what = format!("<{}> states its orientation twice: `{}`", element.name, stated.join("` and `"));
            self.wrong(element, what, "leave one of them out");
        }
        let of_class = WAYS.into_iter().find(|way| self.value(element, class, way).is_some());
        let turned = match stated.first().copied().or(of_class) {
            Some("quat") => self
                .numbers::<4>(element, class, "quat")
                .and_then(|[w, x, y, z]| UnitQuaternion::try_new(nalgebra::Quaternion::new(w, x, y, z), 1e-9)),
            Some("axisangle") => self.numbers::<4>(element, class, "axisangle").and_then(|[x, y, z, angle]| {
                let axis = nalgebra::Unit::try_new(Vector3::new(x, y, z), 1e-9)?;
                Some(UnitQuaternion::from_axis_angle(&axis, self.angle(angle)))
            }),
            Some("xyaxes") => self.numbers::<6>(element, class, "xyaxes").and_then(|[a, b, c, d, e, f]| {
                let x = Vector3::new(a, b, c).try_normalize(1e-9)?;
                let y = Vector3::new(d, e, f);
                let y = (y - x * x.dot(&y)).try_normalize(1e-9)?;
                let axes = Matrix3::from_columns(&[x, y, x.cross(&y)]);
                Some(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes)))
            }),
            Some("zaxis") => self.numbers::<3>(element, class, "zaxis").and_then(|z| along(z.into())),
            Some(_) => self.numbers::<3>(element, class, "euler").map(|angles| self.euler(angles)),
            None => Some(UnitQuaternion::identity()),
        };
        turned.unwrap_or_else(|| {
            self.wrong(element, "the orientation is not a rotation", "an axis or a quaternion has a length above 0");
            UnitQuaternion::identity()
        })
    }

    /// Lower-case axes turn with the body, upper-case axes stay.
    fn euler(&self, angles: [f64; 3]) -> UnitQuaternion<f64> {
        let mut turned = UnitQuaternion::identity();
        for (axis, angle) in self.euler.iter().zip(angles) {
            let direction = match axis.to_ascii_lowercase() {
                'x' => Vector3::x_axis(),
                'y' => Vector3::y_axis(),
                _ => Vector3::z_axis(),
            };
            let turn = UnitQuaternion::from_axis_angle(&direction, self.angle(angle));
            turned = if axis.is_ascii_lowercase() { turned * turn } else { turn * turned };
        }
        turned
    }
}

/// The smallest rotation from the z axis to a direction.
pub(super) fn along(z: Vector3<f64>) -> Option<UnitQuaternion<f64>> {
    let z = z.try_normalize(1e-12)?;
    let opposite = || UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    Some(UnitQuaternion::rotation_between(&Vector3::z(), &z).unwrap_or_else(opposite))
}

/// Roll, pitch and yaw about the fixed axes, as text. Near a pitch of a quarter turn the yaw has the whole turn, because the roll is
/// lost in rounding there.
pub(super) fn rotation_text(rotation: &UnitQuaternion<f64>) -> String {
    let m = rotation.to_rotation_matrix();
    let [roll, pitch, yaw] = if m[(2, 0)].abs() > 1.0 - 1e-12 {
        let pitch = -m[(2, 0)].signum() * std::f64::consts::FRAC_PI_2;
        [0.0, pitch, (-m[(0, 1)]).atan2(m[(1, 1)])]
    } else {
        let (roll, pitch, yaw) = rotation.euler_angles();
        [roll, pitch, yaw]
    };
    format!("{roll}, {pitch}, {yaw} rad")
}

/// A position as text.
pub(super) fn position_text(at: &Vector3<f64>) -> String {
    format!("{}, {}, {} m", at.x, at.y, at.z)
}
