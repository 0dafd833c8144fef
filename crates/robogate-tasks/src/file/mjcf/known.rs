//! The elements and attributes of MJCF: those that are read, those without an effect here, and those that are refused.

use super::attributes::Source;
use super::xml::Element;

/// Attributes of every orientation.
const POSE: &[&str] = &["name", "class", "pos", "quat", "axisangle", "xyaxes", "zaxis", "euler", "user", "group"];

/// What is known about the attributes of an element.
struct Known {
    element: &'static str,
    /// They are read, besides those of a pose.
    read: &'static [&'static str],
    /// They set how soft contacts and stops are: those of the cell act instead.
    soft: &'static [&'static str],
    /// They change the physics in a way that a task cannot: an attribute, its value without an effect, and what to do.
    refused: &'static [(&'static str, &'static str, &'static str)],
}

const KNOWN: &[Known] = &[
    Known {
        element: "body",
        read: &["childclass", "sleep"],
        soft: &[],
        refused: &[
            ("mocap", "false", "a fixture of task.toml can move: `shuttle` or `turn`"),
            ("gravcomp", "0", "give it a joint with a spring or dry friction that carries its weight"),
        ],
    },
    Known {
        element: "geom",
        read: &[
            "type",
            "contype",
            "conaffinity",
            "size",
            "fromto",
            "mass",
            "density",
            "friction",
            "rgba",
            "material",
            "mesh",
        ],
        soft: &[
            "condim",
            "priority",
            "margin",
            "gap",
            "solref",
            "solimp",
            "solmix",
            "fluidshape",
            "fluidcoef",
            "fitscale",
        ],
        refused: &[
            ("hfield", "", "use a mesh or boxes"),
            ("shellinertia", "false", "state the inertia of the body in <inertial>"),
        ],
    },
    Known {
        element: "joint",
        read: &["type", "axis", "range", "limited", "ref", "damping", "stiffness", "springref", "frictionloss"],
        soft: &[
            "solreflimit",
            "solimplimit",
            "solreffriction",
            "solimpfriction",
            "margin",
            "actuatorfrcrange",
            "actuatorfrclimited",
            "actuatorgravcomp",
        ],
        refused: &[
            ("armature", "0", "add its inertia to the mass or the inertia of the body"),
            ("springdamper", "0 0", "state stiffness and damping"),
        ],
    },
    Known { element: "freejoint", read: &["align"], soft: &[], refused: &[] },
    Known { element: "inertial", read: &["mass", "diaginertia", "fullinertia"], soft: &[], refused: &[] },
    Known { element: "site", read: &["type", "size", "fromto", "rgba", "material"], soft: &[], refused: &[] },
    Known { element: "frame", read: &["childclass"], soft: &[], refused: &[] },
    Known {
        element: "mesh",
        read: &[
            "file",
            "scale",
            "content_type",
            "inertia",
            "maxhullvert",
            "smoothnormal",
            "texcoord",
            "normal",
            "texdir",
        ],
        soft: &[],
        refused: &[
            ("vertex", "", "write the mesh to a file, STL or OBJ"),
            ("refpos", "0 0 0", "move the geom instead"),
            ("refquat", "1 0 0 0", "turn the geom instead"),
            ("builtin", "", "write the mesh to a file, STL or OBJ"),
        ],
    },
    Known {
        element: "compiler",
        read: &[
            "angle",
            "eulerseq",
            "meshdir",
            "assetdir",
            "autolimits",
            "inertiafromgeom",
            "texturedir",
            "strippath",
            "discardvisual",
            "fusestatic",
            "balanceinertia",
            "usethread",
            "convexhull",
            "exactmeshinertia",
            "inertiagrouprange",
            "alignfree",
            "saveinertial",
            "boundmass",
            "boundinertia",
            "fitaabb",
        ],
        soft: &[],
        refused: &[
            ("coordinate", "local", "write positions in the frames of the parents"),
            ("settotalmass", "-1", "state the masses of the bodies"),
        ],
    },
];

/// Elements at the top of a file without an effect on the physics of a cell, and how they are called.
pub(super) const ASIDE: [(&str, &str); 7] = [
    ("option", "options of the simulation: those of the cell act"),
    ("size", "sizes of memory"),
    ("statistic", "statistics"),
    ("visual", "options of pictures"),
    ("custom", "custom numbers"),
    ("sensor", "sensors"),
    ("keyframe", "keyframes"),
];

/// Elements that are refused where they are not empty, and what to do.
pub(super) const REFUSED: [(&str, &str); 12] = [
    ("tendon", "a joint cannot be coupled: remove the tendon, or name joints that it holds in `weld`"),
    ("equality", "bodies cannot be coupled: put bodies that are welded into one body"),
    (
        "actuator",
        "nothing in a cell has a motor but the robot: remove the actuator, or let a fixture of task.toml `shuttle` or `turn`",
    ),
    ("deformable", "bodies are rigid: use a mesh"),
    ("extension", "plug-ins are code: remove them"),
    ("plugin", "plug-ins are code: remove them"),
    ("composite", "write its bodies one by one"),
    ("flexcomp", "bodies are rigid: use a mesh"),
    ("replicate", "write its bodies one by one"),
    ("attach", "put the bodies of the other file into this one, or name it in a further `[[mjcf]]`"),
    ("skin", "bodies are rigid: use a mesh"),
    ("model", "put the bodies of the other file into this one, or name it in a further `[[mjcf]]`"),
];

impl Source<'_, '_> {
    /// Checks the attributes of an element, its own ones and those of its default class.
    pub(super) fn check(&mut self, element: &Element, class: &str) {
        let Some(known) = KNOWN.iter().find(|known| known.element == element.name) else { return };
        let names =
            || POSE.iter().chain(known.read).chain(known.soft).copied().chain(known.refused.iter().map(|of| of.0));
        for (name, _) in &element.attributes {
            if !names().any(|known| known == name) {
                let hint = robogate_core::hint(name, names());
                self.wrong(element, format!("unknown attribute `{name}` of <{}>: {hint}", element.name), "");
            }
        }
        for (name, none, hint) in known.refused {
            let Some(value) = self.value(element, class, name) else { continue };
            let words = |text: &str| text.split_whitespace().map(|word| word.parse::<f64>().ok()).collect::<Vec<_>>();
            let same = words(value) == words(none) && !none.is_empty() && words(value).iter().all(Option::is_some);
            if value != *none && !same {
                let what = format!("`{name}` of <{}> is not simulated", element.name);
                self.wrong(element, what, hint);
            }
        }
        let soft = known.soft.iter().any(|name| self.value(element, class, name).is_some());
        if soft {
            self.leave_out("softness of contacts and stops: that of the cell acts");
        }
    }
}
