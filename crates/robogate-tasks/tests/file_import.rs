//! Tasks imported from scenes of MuJoCo, objects of robosuite, and URDF.

mod common;

use std::collections::BTreeMap;

use robogate_tasks::file::{FileTask, Imported, UNFINISHED, Wishes, import};

use common::runs;

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
    for what in [
        "robot: body `link0` with 4 joints",
        "a marker (mocap)",
        "<light>",
        "<keyframe>",
        "<actuator>",
        "<equality>",
        "<tendon>",
    ] {
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
    let xml = String::from_utf8(imported.files["my_scene.xml"].clone()).unwrap();
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
    let problems = FileTask::read_with(&loose.text, &mut |name| Ok(loose.files[name].clone())).unwrap_err();
    let nested = problems.iter().find(|problem| problem.what.contains("which moves itself")).unwrap();
    assert!(nested.file == "my_scene.xml" && nested.line > 1 && nested.hint.contains("weld"), "{nested}");
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
    assert_eq!(import("door.xml", &free, &mut find).unwrap().bodies, ["part my_scene, which moves freely"]);
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
