//! Tasks imported from LIBERO, whose files some machines have, and its predicates compared with LIBERO's own code.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use std::fs;
use std::path::Path;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{Action, Command, Environment};
use robogate_physics::Side;
use robogate_tasks::file::{FileTask, Imported, UNFINISHED, Wishes, import};
use robogate_tasks::{ArmEnvironment, ArmTask, Rig};

use common::{EngineKind, runs, scenario};

fn libero() -> Option<String> {
    let data = robogate_testing::path("ROBOGATE_SHARED_DATA", "the folder of the released data")?;
    Some(data.join("libero/libero/libero").to_str()?.to_owned())
}

fn import_libero(path: &str) -> Result<Imported, String> {
    let wishes = Wishes { name: "libero".to_owned(), ..Wishes::default() };
    import(path, &wishes, &mut |name| fs::read(name).map_err(|why| format!("{name}: {why}")))
}

/// All task files of LIBERO's suites become tasks that run. A few goals have boxes that are turned, which no region can be.
#[test]
fn libero_suites_become_tasks() {
    let Some(libero) = libero() else { return };
    let (mut runs_of, mut open, mut failed) = (0, Vec::new(), Vec::new());
    for suite in ["libero_goal", "libero_object", "libero_spatial", "libero_10"] {
        let folder = Path::new(&libero).join("bddl_files").join(suite);
        let mut names: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        names.retain(|path| path.extension().is_some_and(|end| end == "bddl"));
        names.sort();
        for path in names {
            let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
            let imported = match import_libero(path.to_str().unwrap()) {
                Ok(imported) => imported,
                Err(why) => {
                    failed.push(format!("{name}: {why}"));
                    continue;
                }
            };
            if imported.text.contains(UNFINISHED) {
                open.push(format!("{name}: {}", imported.left_out.join("; ")));
                continue;
            }
            let read = FileTask::read_with(&imported.text, &mut |name| Ok(imported.files[name].clone()));
            match read {
                Ok(task) => {
                    runs(&task);
                    runs_of += 1;
                }
                Err(problems) => failed.push(format!("{name}: {problems:?}")),
            }
        }
    }
    println!("{runs_of} tasks run; without a goal:\n{}", open.join("\n"));
    assert_eq!(failed, [""; 0]);
    assert!(runs_of >= 36, "{runs_of}");
}

/// Evaluates LIBERO's own code on states: modules of LIBERO, with stand-ins for what they import from robosuite.
const ORACLE: &str = r#"
import importlib.util, json, sys, types
from unittest import mock
import numpy as np

libero, states = sys.argv[1], json.load(open(sys.argv[2]))
class Stub(types.ModuleType):
    def __getattr__(self, name):
        return mock.MagicMock()
for name in ("robosuite", "robosuite.utils", "robosuite.utils.transform_utils", "robosuite.models", "easydict", "libero", "libero.libero",
             "libero.libero.envs", "libero.libero.envs.objects"):
    sys.modules[name] = Stub(name)
mjcf = Stub("robosuite.utils.mjcf_utils")
mjcf.string_to_array = lambda text: np.array([float(x) for x in text.split()])
mjcf.array_to_string = lambda array: " ".join(str(x) for x in array)
sys.modules["robosuite.utils.mjcf_utils"] = mjcf
objects = Stub("robosuite.models.objects")
objects.MujocoXMLObject = object
sys.modules["robosuite.models.objects"] = objects
def load(name, path):
    spec = importlib.util.spec_from_file_location(name, f"{libero}/{path}")
    sys.modules[name] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
load("libero.libero.envs.base_object", "envs/base_object.py")
sites = load("libero.libero.envs.objects.site_object", "envs/objects/site_object.py")
zones = load("libero.libero.envs.objects.target_zones", "envs/objects/target_zones.py")
kinds = load("libero.libero.envs.objects.articulated_objects", "envs/objects/articulated_objects.py")
state = load("libero.libero.envs.object_states.base_object_states", "envs/object_states/base_object_states.py")
predicates = load("libero.libero.envs.predicates.base_predicates", "envs/predicates/base_predicates.py")

class World:
    """What the states of LIBERO ask of an environment."""
    def __init__(self, case):
        self.fixtures_dict, self.objects_dict, self.object_sites_dict, self.obj_body_id = {}, {}, {}, {}
        self.case = case
        self.sim = mock.MagicMock()
        self.sim.data.get_site_xpos = lambda name: np.array(case["site"]["pos"])
        self.sim.data.get_site_xmat = lambda name: np.array(case["site"]["mat"]).reshape(3, 3)
        self.sim.data.body_xpos = [np.array(x) for x in (case["object"], case.get("below", [0, 0, 0]))]
        self.sim.model.get_joint_qpos_addr = lambda joint: int(joint)
        self.sim.data.qpos = case.get("joints", [])
        self.obj_body_id = {"object": 0, "below": 1}
    def get_object(self, name):
        return self.objects_dict.get(name)
    def check_contact(self, one, other):
        return self.case["contact"]

out = []
for case in states:
    world = World(case)
    world.objects_dict["object"] = types.SimpleNamespace(joints=[])
    world.objects_dict["below"] = types.SimpleNamespace(joints=[])
    thing = state.ObjectState(world, "object")
    if case["kind"] == "site":
        box = sites.SiteObject("site", size=np.array(case["site"]["size"]))
        world.object_sites_dict["site"] = box
        place = state.SiteObjectState(world, "site", "below" if case["of_body"] else None)
    elif case["kind"] == "object":
        place = state.ObjectState(world, "below")
    else:
        kind = {"wooden_cabinet": kinds.WoodenCabinet, "flat_stove": kinds.FlatStove, "microwave": kinds.Microwave}[case["category"]]
        body = object.__new__(kind)
        ranges = {"wooden_cabinet": ([-0.16, -0.14], [0.0, 0.005]), "microwave": ([-2.094, -1.3], [-0.005, 0.0])}.get(case["category"])
        articulation = {"default_turnon_ranges": [0.5, 2.1], "default_turnoff_ranges": [-0.005, 0.0]}
        if ranges:
            articulation.update(default_open_ranges=ranges[0], default_close_ranges=ranges[1])
        body.object_properties = {"articulation": articulation, "vis_site_names": {}}
        body.naming_prefix, body.joints = "", [str(i) for i in range(len(case["joints"]))]
        world.objects_dict["below"] = body
        place = state.ObjectState(world, "below")
    verb = {"in": predicates.In, "on": predicates.On, "open": predicates.Open, "close": predicates.Close, "turnon": predicates.TurnOn}
    verb = object.__new__(verb[case["verb"]])
    out.append(bool(verb(place) if case["kind"] == "joints" else verb(thing, place)))
print(json.dumps(out))
"#;

/// An import with its first `when` and other texts replaced.
fn changed(imported: &Imported, changes: &[(String, String)]) -> FileTask {
    let mut text = imported.text.clone();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}: {text}");
        text = text.replacen(from, to, 1);
    }
    FileTask::read_with(&text, &mut |name| Ok(imported.files[name].clone()))
        .unwrap_or_else(|problems| panic!("{text}\n{problems:#?}"))
}

/// The table of a body in the text: from its name to the end of its `rotation`.
fn table<'t>(text: &'t str, name: &str) -> &'t str {
    let from = text.find(&format!("name = \"{name}\"")).unwrap();
    let rest = &text[from..];
    &rest[..rest.find("rotation").unwrap()]
}

/// Goals of LIBERO hold in the states in which LIBERO's own code says so: an object is put at random places about its goal, and its state is
/// compared in every control period while it falls and comes to rest. For joints, all values are compared.
#[test]
fn libero_predicates_agree_with_its_code() {
    let Some(libero) = libero() else { return };
    let Some(python) = robogate_testing::path("ROBOGATE_METAWORLD_PYTHON", "a Python with NumPy") else { return };
    let mut states = Vec::new();
    let mut ours = Vec::new();
    let mut stream = robogate_core::Seed::campaign(11).episode(0).stream("places");
    for (file, object, goal, verb) in PLACES {
        let path = format!("{libero}/bddl_files/{file}.bddl");
        let imported = import_libero(&path).unwrap();
        let near = goal.place(&imported);
        for _ in 0..8 {
            let offset = [stream.between(-1.0, 1.0), stream.between(-1.0, 1.0), stream.between(0.0, 1.0)];
            let at: Vec<f64> = (0..3).map(|i| near.centre[i] + near.around[i] * offset[i]).collect();
            let old = table(&imported.text, object);
            let new: Vec<String> = old
                .lines()
                .map(|line| {
                    let moved = format!("at = \"{}, {}, {} m\"", at[0], at[1], at[2]);
                    if line.starts_with("at = ") { moved } else { line.to_owned() }
                })
                .collect();
            let mut changes = vec![(old.to_owned(), format!("{}\n", new.join("\n")))];
            let start = format!("\n[[part]]\nname = \"{object}\"\nspread = ");
            if imported.text.contains(&start) {
                changes.push((start.clone(), start.replace("spread = ", "# spread = ")));
            }
            let task = changed(&imported, &changes);
            let rig = Rig { picture_px: [16; 2], ..Rig::default() };
            let mut environment = task.on(EngineKind::Mujoco.robot("franka").engine(), rig).unwrap();
            let posture = environment.reset(&scenario(0, &[])).unwrap().observation.joint_positions().to_vec();
            for _ in 0..6 {
                let command = Command::JointPosition(posture.clone());
                let step = environment.step(&Action { command, gripper: Some(Action::OPEN), phase: None }).unwrap();
                let success = step.ending.as_ref().is_some_and(|ending| ending.failure.is_none());
                let mut state = goal.state(&environment, &imported, object, verb);
                if success {
                    // Conditions are evaluated after every time step, LIBERO's after every control period: in between, an object that
                    // bounces may have left what it touched. Its place is compared nevertheless.
                    state["contact"] = true.into();
                }
                states.push(state);
                ours.push((success, format!("{file} at {at:?}")));
                if step.ending.is_some() {
                    break;
                }
            }
        }
    }
    for (category, verb, count, condition, [low, high]) in [
        ("wooden_cabinet", "open", 3, "<", [-0.16, 0.01]),
        ("wooden_cabinet", "close", 3, "all>", [-0.16, 0.01]),
        ("flat_stove", "turnon", 1, ">=", [-0.005, 2.1]),
        ("microwave", "open", 1, "<", [-2.094, 0.0]),
        ("microwave", "close", 1, "all>", [-2.094, 0.0]),
    ] {
        let edge = match (category, verb) {
            ("wooden_cabinet", "open") => -0.14,
            ("wooden_cabinet", _) => 0.0,
            ("flat_stove", _) => 0.5,
            (_, "open") => -1.3,
            _ => -0.005,
        };
        for _ in 0..20 {
            let near = stream.between(0.0, 1.0) < 0.5;
            let joints: Vec<f64> = (0..count)
                .map(|_| if near { edge + stream.between(-0.01, 0.01) } else { stream.between(low, high) })
                .collect();
            let holds = match condition {
                "<" => joints.iter().any(|x| *x < edge),
                ">=" => joints.iter().any(|x| *x > edge),
                _ => joints.iter().all(|x| *x > edge),
            };
            states.push(serde_json::json!({
                "kind": "joints", "verb": verb, "category": category, "joints": joints, "contact": false,
                "object": [0.0, 0.0, 0.0], "site": {"pos": [0.0, 0.0, 0.0], "mat": [1, 0, 0, 0, 1, 0, 0, 0, 1]},
            }));
            ours.push((holds, format!("{category} {verb} {joints:?}")));
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let (script, data) = (folder.path().join("oracle.py"), folder.path().join("states.json"));
    fs::write(&script, ORACLE).unwrap();
    fs::write(&data, serde_json::to_string(&states).unwrap()).unwrap();
    let output = std::process::Command::new(python).arg(&script).arg(&libero).arg(&data).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let theirs: Vec<bool> = serde_json::from_slice(&output.stdout).unwrap();
    let wrong: Vec<_> =
        ours.iter().zip(&theirs).zip(&states).filter(|(((ours, _), theirs), _)| ours != *theirs).collect();
    let (hold, fail) = (theirs.iter().filter(|of| **of).count(), theirs.iter().filter(|of| !**of).count());
    println!("{} states: {hold} hold, {fail} do not; {} differ", theirs.len(), wrong.len());
    assert!(hold > 40 && fail > 40, "{hold} {fail}");
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// What an object is put on or into.
enum Goal {
    /// A box of a fixture or part, as its region in task.toml: name of the site, its body, its pose in that body and its half edges.
    Site { body: &'static str, at: [f64; 3], quat: [f64; 4], half: [f64; 3], of_body: bool },
    /// Another object.
    Object(&'static str),
}

/// Where an object is put.
struct Near {
    centre: [f64; 3],
    around: [f64; 3],
}

const PLACES: [(&str, &str, Goal, &str); 5] = [
    ("libero_goal/put_the_bowl_on_the_plate", "akita_black_bowl_1", Goal::Object("plate_1"), "on"),
    ("libero_goal/put_the_cream_cheese_in_the_bowl", "cream_cheese_1", Goal::Object("akita_black_bowl_1"), "on"),
    (
        "libero_goal/put_the_bowl_on_the_stove",
        "akita_black_bowl_1",
        Goal::Site {
            body: "flat_stove_1",
            at: [0.15, 0.0, 0.0],
            quat: [1.0, 0.0, 0.0, 0.0],
            half: [0.075, 0.075, 0.0025],
            of_body: true,
        },
        "on",
    ),
    (
        "libero_goal/put_the_bowl_on_top_of_the_cabinet",
        "akita_black_bowl_1",
        Goal::Site {
            body: "wooden_cabinet_1",
            at: [0.00354, 0.01567, 0.22152],
            quat: [1.0, 0.0, 0.0, 0.0],
            half: [0.12534, 0.09438, 0.00147],
            of_body: true,
        },
        "on",
    ),
    (
        "libero_object/pick_up_the_alphabet_soup_and_place_it_in_the_basket",
        "alphabet_soup_1",
        Goal::Site {
            body: "basket_1",
            at: [0.0, 0.0, 0.07185],
            quat: [0.0, 0.0, 0.0, 1.0],
            half: [0.06108, 0.06108, 0.06949],
            of_body: true,
        },
        "in",
    ),
];

/// The pose that task.toml states for a body.
fn stated(imported: &Imported, body: &str) -> Isometry3<f64> {
    let lines: Vec<&str> = imported.text.lines().skip_while(|line| *line != format!("name = \"{body}\"")).collect();
    let numbers = |key: &str| {
        let line = lines.iter().find(|line| line.starts_with(key)).unwrap();
        let text = line.split('"').nth(1).unwrap().trim_end_matches(char::is_alphabetic);
        let found: Vec<f64> = text.split(',').map(|x| x.trim().parse().unwrap()).collect();
        Vector3::from_column_slice(&found)
    };
    let (at, turn) = (numbers("at = "), numbers("rotation = "));
    let turn = UnitQuaternion::from_euler_angles(turn.x, turn.y, turn.z);
    Isometry3::from_parts(Translation3::from(at), turn)
}

/// The index of a part.
fn part(imported: &Imported, name: &str) -> Option<usize> {
    let parts = imported.bodies.iter().filter_map(|line| line.strip_prefix("part "));
    parts.map(|line| line.split([' ', ',']).next().unwrap()).position(|part| part == name)
}

impl Goal {
    fn site(at: [f64; 3], quat: [f64; 4]) -> Isometry3<f64> {
        robogate_physics::isometry(&at, &quat)
    }

    /// The place in the text, with some room around it.
    fn place(&self, imported: &Imported) -> Near {
        match self {
            Self::Object(below) => {
                let at = stated(imported, below).translation.vector;
                Near { centre: [at.x, at.y, at.z], around: [0.05, 0.05, 0.1] }
            }
            Self::Site { body, at, quat, half, .. } => {
                let site = stated(imported, body) * Self::site(*at, *quat);
                let room = (site.rotation.to_rotation_matrix().into_inner() * Vector3::from(*half)).abs();
                let centre = site.translation.vector;
                Near { centre: [centre.x, centre.y, centre.z], around: [1.4 * room.x, 1.4 * room.y, room.z + 0.1] }
            }
        }
    }

    /// The state as the oracle reads it.
    fn state(&self, environment: &ArmEnvironment, imported: &Imported, object: &str, verb: &str) -> serde_json::Value {
        let engine = environment.engine();
        let body = part(imported, object).unwrap();
        let list = |at: Vector3<f64>| [at.x, at.y, at.z];
        let at = |index: usize| list(engine.free_body(index).translation.vector);
        let touches = |side: Side| engine.force_between(Side::Body(body), side).is_some();
        match self {
            Self::Object(below) => {
                let below = part(imported, below).unwrap();
                serde_json::json!({
                    "kind": "object", "verb": verb, "object": at(body), "below": at(below), "contact": touches(Side::Body(below)),
                    "site": {"pos": [0.0, 0.0, 0.0], "mat": [1, 0, 0, 0, 1, 0, 0, 0, 1]},
                })
            }
            Self::Site { body: owner, at: centre, quat, half, of_body } => {
                let frame =
                    part(imported, owner).map_or_else(|| stated(imported, owner), |index| engine.free_body(index));
                let site = frame * Self::site(*centre, *quat);
                let axes = site.rotation.to_rotation_matrix().into_inner().transpose();
                let fixtures = engine.read_back().unwrap().fixtures.len();
                let jointed = engine.read_back().unwrap().joints;
                let contact = (1..fixtures).any(|of| touches(Side::Fixture(of)))
                    || jointed.iter().any(|(of, _)| touches(Side::Body(*of)));
                serde_json::json!({
                    "kind": "site", "verb": verb, "object": at(body), "contact": contact, "of_body": of_body,
                    "site": {"pos": list(site.translation.vector), "mat": axes.as_slice(), "size": half},
                })
            }
        }
    }
}
