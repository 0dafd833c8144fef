//! Tasks imported from scenes of MuJoCo, objects of robosuite, URDF, and task files of LIBERO.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{Action, Command, Environment};
use robogate_physics::Side;
use robogate_tasks::file::{FileTask, Imported, UNFINISHED, Wishes, import};
use robogate_tasks::{ArmEnvironment, ArmTask, Rig};

use common::{EngineKind, scenario};

const CUBE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\nf 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\n\
                    f 3 4 8 7\nf 4 1 5 8\n";

fn wishes(goal: &str) -> Wishes {
    Wishes { name: "My scene".to_owned(), goal: Some(goal.to_owned()), ..Wishes::default() }
}

fn files(files: &[(&str, &str)]) -> impl FnMut(&str) -> Result<Vec<u8>, String> + use<> {
    let files: BTreeMap<String, Vec<u8>> =
        files.iter().map(|(name, text)| ((*name).to_owned(), text.as_bytes().to_vec())).collect();
    move |name| files.get(name).cloned().ok_or_else(|| format!("{name}: there is no such file"))
}

/// The task of an import, read as `tasks check` reads it.
fn task(imported: &Imported) -> FileTask {
    FileTask::read_with(&imported.text, &mut |name| imported.files.get(name).cloned().ok_or_else(|| name.to_owned()))
        .unwrap_or_else(|problems| panic!("{}\n{problems:#?}", imported.text))
}

/// The task runs: nothing falls through the table or flies away while the robot waits.
fn runs(task: &FileTask) -> ArmEnvironment {
    let rig = Rig { picture_px: [16; 2], ..Rig::default() };
    let mut environment = task.on(EngineKind::Mujoco.robot("franka").engine(), rig).unwrap();
    let start = environment.reset(&scenario(0, &[])).unwrap();
    let posture = start.observation.joint_positions().to_vec();
    for _ in 0..20 {
        let command = Command::JointPosition(posture.clone());
        environment.step(&Action { command, gripper: Some(Action::OPEN), phase: None }).unwrap();
    }
    environment
}

/// A scene as tutorials of MuJoCo have it: an arm in a file of its own, a floor, lights, a keyframe, a box to lift.
const TUTORIAL: &str = r#"<mujoco model="panda scene">
  <include file="arm/arm.xml"/>
  <statistic center="0.3 0 0.4" extent="1"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <visual><headlight diffuse="0.6 0.6 0.6"/></visual>
  <asset>
    <texture type="skybox" builtin="gradient" rgb1="0.3 0.5 0.7" rgb2="0 0 0" width="512" height="3072"/>
    <texture type="2d" name="groundplane" builtin="checker" rgb1="0.2 0.3 0.4" width="300" height="300"/>
    <material name="groundplane" texture="groundplane" texuniform="true"/>
    <material name="orange" rgba="0.9 0.5 0.1 1"/>
  </asset>
  <worldbody>
    <light pos="0 0 1.5" dir="0 0 -1" directional="true"/>
    <geom name="floor" size="0 0 0.05" type="plane" material="groundplane"/>
    <body name="target" mocap="true"><geom type="sphere" size="0.02" contype="0" conaffinity="0"/></body>
    <body name="box" pos="0.8 0.1 0.025">
      <freejoint name="box"/>
      <geom type="box" size="0.025 0.025 0.025" material="orange" mass="0.1" friction="1.2 0.005 0.0001" condim="4"/>
      <site name="grip" pos="0 0 0.01"/>
    </body>
  </worldbody>
  <contact><exclude body1="link0" body2="link1"/></contact>
  <equality><weld body1="hand" body2="target"/></equality>
  <keyframe><key name="home" qpos="0 0 0 0 0.8 0.1 0.025 1 0 0 0"/></keyframe>
  <sensor><framepos objtype="body" objname="box"/></sensor>
</mujoco>"#;

const ARM: &str = r#"<mujoco model="arm">
  <compiler angle="radian"/>
  <default><default class="arm"><joint armature="0.1" damping="1"/></default></default>
  <worldbody>
    <body name="link0" pos="0.3 0.1 0" childclass="arm">
      <geom type="cylinder" size="0.05 0.05"/>
      <body name="link1" pos="0 0 0.3"><joint name="j1" axis="0 0 1" range="-2.8 2.8"/><geom type="capsule" size="0.04 0.1"/>
        <body name="link2" pos="0 0 0.3"><joint name="j2" axis="0 1 0" range="-1.7 1.7"/><geom type="capsule" size="0.04 0.1"/>
          <body name="link3" pos="0 0 0.3"><joint name="j3" axis="0 1 0" range="-1.7 1.7"/><geom type="capsule" size="0.04 0.1"/>
            <body name="hand" pos="0 0 0.2"><joint name="j4" axis="0 0 1" range="-2.8 2.8"/><geom type="box" size="0.03 0.1 0.02"/></body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><position joint="j1" kp="100"/><position joint="j2"/><position joint="j3"/><position joint="j4"/></actuator>
  <tendon><fixed name="t"><joint joint="j1" coef="1"/></fixed></tendon>
</mujoco>"#;

#[test]
fn scene_with_robot_becomes_task() {
    let mut find = files(&[("lab/scene.xml", TUTORIAL), ("lab/arm/arm.xml", ARM)]);
    let imported = import("lab/scene.xml", &wishes("height(box) > 20 cm for 0.5 s"), &mut find).unwrap();
    let task_of = task(&imported);
    let left_out = imported.left_out.join("\n");
    for what in ["robot: body `link0` with 4 joints", "a marker (mocap)", "<light>", "<keyframe>", "<actuator>", "<equality>", "<tendon>"] {
        assert!(left_out.contains(what), "{what}: {left_out}");
    }
    assert_eq!(imported.bodies, ["part box, which moves freely"]);
    let environment = runs(&task_of);
    // The box is where it was in front of the robot.
    let at = environment.engine().object().translation.vector;
    assert!((at.x - 0.5).abs() < 1e-3 && at.y.abs() < 1e-3 && (at.z - 0.025).abs() < 2e-3, "{at}");
    let read = environment.engine().read_back().unwrap();
    assert_eq!((read.mass_kg, &read.own_friction[..]), (0.1, &[(0, 1.2)][..]));
    // The file that stays is MJCF that MuJoCo reads.
    let xml = String::from_utf8(imported.files["scene.xml"].clone()).unwrap();
    robogate_physics::MujocoModel::from_xml(&xml).unwrap();
    assert!(!xml.contains("link1") && !xml.contains("texture"), "{xml}");
    // Without a goal, the file says that it is not finished.
    let open = import("lab/scene.xml", &Wishes { goal: None, ..wishes("") }, &mut find).unwrap();
    assert!(open.text.contains(UNFINISHED));
    let problems = FileTask::read_with(&open.text, &mut |name| Ok(open.files[name].clone())).unwrap_err();
    let line = 1 + open.text[..open.text.find(UNFINISHED).unwrap()].matches('\n').count();
    assert_eq!((problems.len(), problems[0].line), (1, line), "{problems:?}");
    assert!(problems[0].what.contains("the condition is not written yet"), "{problems:?}");
}

/// An object as robosuite has it: without a joint, with shapes that only show, and sites that mark its size.
const ROBOSUITE: &str = r#"<mujoco model="door">
  <asset>
    <mesh name="knob_vis" file="meshes/knob.msh"/>
    <mesh name="knob" file="meshes/knob.obj" scale="0.03 0.02 0.02"/>
    <texture file="../textures/wood.png" type="cube" name="tex-wood"/>
    <material name="wood" texture="tex-wood" rgba="0.6 0.4 0.2 1"/>
  </asset>
  <worldbody>
    <body>
      <body name="object">
        <body name="frame" pos="0 0.1 0.15">
          <geom type="box" pos="0 -0.15 0" size="0.02 0.01 0.15" group="0" friction="1 1 1" solref="0.02 1" rgba="0 0.5 0 1"/>
          <geom type="mesh" mesh="knob_vis" contype="0" conaffinity="0" group="1" material="wood"/>
          <body name="leaf" pos="0 -0.13 0">
            <joint name="hinge" axis="0 0 1" range="0 1.4" limited="true" damping="0.1" frictionloss="0.1"/>
            <geom type="box" pos="0 0.12 0" size="0.01 0.11 0.12" density="250" group="0"/>
            <geom type="mesh" mesh="knob" pos="-0.04 0.2 0" group="0" density="250"/>
            <body name="latch" pos="-0.03 0.2 0.05">
              <joint name="latch_joint" axis="1 0 0" range="0 1.57"/>
              <geom type="cylinder" size="0.01 0.03" euler="0 1.57 0" density="250"/>
            </body>
          </body>
        </body>
      </body>
      <site rgba="0 0 0 0" size="0.005" pos="0 0 -0.06" name="bottom_site"/>
    </body>
  </worldbody>
</mujoco>"#;

#[test]
fn robosuite_object_becomes_task() {
    let mut find = files(&[("door.xml", ROBOSUITE), ("meshes/knob.obj", CUBE)]);
    let at = Some("60, 0, 0 cm".to_owned());
    let goal = wishes("joint(leaf) > 30 deg");
    let loose = import("door.xml", &Wishes { at: at.clone(), ..goal.clone() }, &mut find).unwrap();
    let problems =
        FileTask::read_with(&loose.text, &mut |name| Ok(loose.files[name].clone())).unwrap_err();
    let nested = problems.iter().find(|problem| problem.what.contains("which moves itself")).unwrap();
    assert!(nested.file == "scene.xml" && nested.line > 1 && nested.hint.contains("weld"), "{nested}");
    let welded = Wishes { at, weld: vec!["latch_joint".to_owned()], ..goal };
    let imported = import("door.xml", &welded, &mut find).unwrap();
    let environment = runs(&task(&imported));
    let read = environment.engine().read_back().unwrap();
    let box_kg = 250.0 * 8.0 * 0.01 * 0.11 * 0.12;
    let knob_kg = 250.0 * 0.03 * 0.02 * 0.02;
    let latch_kg = 250.0 * std::f64::consts::PI * 1e-4 * 0.06;
    assert!((read.mass_kg - box_kg - knob_kg - latch_kg).abs() < 1e-6, "{}", read.mass_kg);
    let joint = read.joints[0].1;
    // Degrees, because the file does not say radian.
    assert!((joint.range[1] - 1.4_f64.to_radians()).abs() < 1e-9 && (joint.friction - 0.1).abs() < 1e-9);
    assert!(imported.files.contains_key("meshes/knob.obj") && imported.files.len() == 2);
    // An object without joints moves freely if the user says so.
    let alone = ROBOSUITE.replace("<joint name=\"hinge\"", "<!-- ").replace("frictionloss=\"0.1\"/>", "-->");
    let alone = alone.replace("<joint name=\"latch_joint\" axis=\"1 0 0\" range=\"0 1.57\"/>", "");
    let mut find = files(&[("door.xml", &alone), ("meshes/knob.obj", CUBE)]);
    let free = Wishes { free: true, at: Some("50, 0, 30 cm".to_owned()), ..wishes("time() > 1 s") };
    assert_eq!(import("door.xml", &free, &mut find).unwrap().bodies, ["part scene, which moves freely"]);
}

/// A cabinet as PartNet-Mobility has it: links with pieces of meshes, revolute and prismatic joints.
const URDF: &str = r#"<?xml version="1.0" ?>
<robot name="partnet_45290">
  <material name="teal"><color rgba="0.1 0.6 0.5 1"/></material>
  <link name="base"/>
  <link name="link_2">
    <visual name="frame"><origin xyz="0 0 0"/><geometry><mesh filename="textured_objs/original-1.obj"/></geometry><material name="teal"/></visual>
    <collision><origin xyz="0 -0.21 0"/><geometry><box size="0.3 0.02 0.4"/></geometry></collision>
    <collision><origin xyz="0 0.21 0"/><geometry><box size="0.3 0.02 0.4"/></geometry></collision>
  </link>
  <joint name="joint_2" type="fixed"><origin rpy="0 0 3.141592653589793" xyz="0.6 0 0.2"/><parent link="base"/><child link="link_2"/></joint>
  <link name="link_0">
    <inertial><origin xyz="0.1 0 0" rpy="0 0 0.3"/><mass value="1.5"/><inertia ixx="0.01" iyy="0.02" izz="0.025" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0.1 0 0"/><geometry><mesh filename="package://partnet/textured_objs/original-2.obj" scale="0.02 0.38 0.15"/></geometry></collision>
    <collision><origin xyz="0.17 0 0" rpy="1.5708 0 0"/><geometry><cylinder radius="0.01" length="0.1"/></geometry></collision>
  </link>
  <joint name="joint_0" type="prismatic"><origin xyz="0 0 -0.1"/><axis xyz="1 0 0"/><parent link="link_2"/><child link="link_0"/>
    <limit lower="0" upper="0.25" effort="100" velocity="1"/><dynamics damping="5" friction="2"/></joint>
  <link name="link_1">
    <collision><origin xyz="0 0.19 0"/><geometry><box size="0.02 0.38 0.18"/></geometry></collision>
  </link>
  <joint name="joint_1" type="revolute"><origin xyz="0.16 -0.19 0.1"/><axis xyz="0 0 -1"/><parent link="link_2"/><child link="link_1"/>
    <limit lower="0" upper="1.57"/></joint>
  <transmission name="t"/>
</robot>"#;

#[test]
fn urdf_cabinet_becomes_task() {
    let open = CUBE.replace("f 4 1 5 8\n", "");
    let mut find = files(&[("cab/mobility.urdf", URDF), ("cab/textured_objs/original-2.obj", &open)]);
    let imported = import("cab/mobility.urdf", &wishes("joint(link_0) > 15 cm"), &mut find).unwrap();
    let task_of = task(&imported);
    assert_eq!(
        imported.bodies,
        [
            "fixture base",
            "part link_0 on a slide from 0.0000 to 0.2500 m",
            "part link_1 on a hinge from 0.0000 to 1.5700 rad"
        ]
    );
    let environment = runs(&task_of);
    let read = environment.engine().read_back().unwrap();
    let drawer = read.joints[0].1;
    assert_eq!((drawer.range, drawer.damping, drawer.friction), ([0.0, 0.25], 5.0, 2.0));
    assert!((read.mass_kg - 1.5).abs() < 1e-9 && (read.centre_of_mass.x - 0.1).abs() < 1e-9);
    // The cabinet is turned to the robot: the drawer opens towards it.
    let opens = read.object.rotation * drawer.axis;
    assert!((opens.x + 1.0).abs() < 1e-6, "{opens}");
    // 1,000 kg/m3, as MuJoCo assumes for a link without <inertial>.
    assert!((read.others[0].mass_kg - 1000.0 * 0.02 * 0.38 * 0.18).abs() < 1e-9);
    for (from, to, expected) in [
        ("type=\"revolute\"", "type=\"planar\"", "joints of type `planar` are not simulated"),
        ("<limit lower=\"0\" upper=\"1.57\"/>", "<mimic joint=\"joint_0\"/>", "<mimic>"),
        ("<child link=\"link_1\"/>", "<child link=\"link_9\"/>", "`link_9`, which the file does not have"),
        ("original-2.obj", "original-3.obj", "there is no such file"),
        ("size=\"0.02 0.38 0.18\"", "size=\"0.02 0.38\"", "is not 3 numbers"),
        ("<child link=\"link_2\"/>", "<child link=\"base\"/>", "no link that is not the child"),
    ] {
        let broken = URDF.replacen(from, to, 1);
        let broken = if expected.starts_with("no link") { broken.replace("link_2", "base") } else { broken };
        let mut find = files(&[("cab/m.urdf", &broken), ("cab/textured_objs/original-2.obj", CUBE)]);
        let why = import("cab/m.urdf", &wishes("time() > 1 s"), &mut find).unwrap_err();
        assert!(why.contains(expected), "{to}: {why}");
    }
}

#[test]
fn unusable_files_are_explained() {
    for (name, text, expected) in [
        ("a.usd", "", "unknown kind of file"),
        ("a.xml", "<mujoco>", "a.xml, line 1: "),
        ("a.xml", "<sdf/>", "the root element is <sdf>"),
        ("a.bddl", "(define (problem x) (:goal (On a b)))", "unknown problem `x`"),
    ] {
        let why = import(name, &wishes("time() > 1 s"), &mut files(&[(name, text)])).unwrap_err();
        assert!(why.contains(expected), "{name}: {why}");
    }
}

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
            let start = format!("\n[[part]]\nname = \"{object}\"\nstart = ");
            if imported.text.contains(&start) {
                changes.push((start.clone(), start.replace("start = ", "# start = ")));
            }
            let task = changed(&imported, &changes);
            let rig = Rig { picture_px: [16; 2], ..Rig::default() };
            let mut environment = task.on(EngineKind::Mujoco.robot("franka").engine(), rig).unwrap();
            let posture = environment.reset(&scenario(0, &[])).unwrap().observation.joint_positions().to_vec();
            for _ in 0..6 {
                let command = Command::JointPosition(posture.clone());
                let step = environment.step(&Action { command, gripper: Some(Action::OPEN), phase: None }).unwrap();
                let success = step.ending.as_ref().is_some_and(|ending| ending.failure.is_none());
                states.push(goal.state(&environment, &imported, object, verb));
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
    let wrong: Vec<_> = ours.iter().zip(&theirs).zip(&states).filter(|(((ours, _), theirs), _)| ours != *theirs).collect();
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
        Goal::Site { body: "flat_stove_1", at: [0.15, 0.0, 0.0], quat: [1.0, 0.0, 0.0, 0.0], half: [0.075, 0.075, 0.0025], of_body: true },
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
        Goal::Site { body: "basket_1", at: [0.0, 0.0, 0.07185], quat: [0.0, 0.0, 0.0, 1.0], half: [0.06108, 0.06108, 0.06949], of_body: true },
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
                let frame = part(imported, owner).map_or_else(|| stated(imported, owner), |index| engine.free_body(index));
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
