//! Bodies of MJCF files have the numbers that MuJoCo's own compiler finds, and broken files have problems with lines.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use crate::file::model::Model;
use crate::file::numbers::{Draws, Layout};
use crate::file::problem::Problem;

const TASK: &str = r#"format = "robogate-task/1"
name = "test"
instruction = "wait"
time_limit = "1 s"
[[mjcf]]
file = "models/scene.xml"
KEYS
[success]
when = "time() > 10 s"
"#;

const CUBE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\nf 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\n\
                    f 3 4 8 7\nf 4 1 5 8\n";

fn read(xml: &str, keys: &str) -> Result<Model, Vec<Problem>> {
    Model::read(&TASK.replace("KEYS", keys), &mut |name| match name {
        "models/scene.xml" => Ok(xml.as_bytes().to_vec()),
        "models/meshes/cube.obj" => Ok(CUBE.as_bytes().to_vec()),
        "models/meshes/open.obj" => Ok(CUBE.replace("f 4 1 5 8\n", "").into_bytes()),
        "models/more.xml" => Ok(b"<mujoco><geom type='box' size='.1 .1 .1'/></mujoco>".to_vec()),
        "models/again.xml" => Ok(b"<mujoco><include file='again.xml'/></mujoco>".to_vec()),
        _ => Err("there is no such file".to_owned()),
    })
}

/// Every way to state a pose, a shape, a mass and a joint.
const EVERYTHING: &str = r#"<mujoco model="all">
  <compiler angle="degree" eulerseq="zyX" meshdir="meshes" autolimits="true"/>
  <option timestep="0.001"/>
  <default>
    <geom density="700" friction="0.8 0.01 0.001"/>
    <default class="metal">
      <geom density="2700" rgba="0.5 0.5 0.5 1"/>
      <joint damping="3" frictionloss="0.4"/>
      <default class="light_metal"><geom density="1500"/></default>
    </default>
  </default>
  <asset>
    <mesh name="block" file="cube.obj" scale="0.1 0.2 0.05"/>
    <mesh name="shell" file="open.obj" scale="0.1 0.1 0.1"/>
    <material name="red" rgba="1 0 0 1"/>
  </asset>
  <worldbody>
    <light pos="0 0 3"/>
    <geom type="plane" size="2 2 0.1"/>
    <body name="rail" pos="0.6 -0.1 0.1" euler="20 10 -30">
      <geom type="box" size="0.02 0.3 0.02"/>
      <body name="bracket" pos="0 0.1 0.05" axisangle="0 1 1 40">
        <geom class="metal" type="cylinder" fromto="0 0 0 0.1 0.05 0.02" size="0.01"/>
      </body>
      <body name="carriage" pos="0.05 0 0.02" xyaxes="1 1 0 -1 1 0.2" childclass="metal">
        <joint name="slide" type="slide" axis="0 1 2" range="-0.1 0.2" stiffness="30" springref="0.05" ref="0.03"/>
        <geom type="box" size="0.03 0.02 0.01" material="red"/>
        <geom class="light_metal" type="sphere" size="0.02" pos="0.03 0 0.02"/>
        <body pos="0 0 0.05" zaxis="1 0 1">
          <geom type="capsule" size="0.01 0.04"/>
          <geom type="capsule" fromto="0 0 0 0.02 0.03 0.1" size="0.008" mass="0.3"/>
        </body>
      </body>
    </body>
    <frame pos="0.3 0.2 0.2" euler="0 0 90">
      <body name="flap" quat="0.9 0.1 -0.2 0.3">
        <joint name="flap" type="hinge" axis="1 0 0.5" pos="0.01 0.02 0" range="-30 120" ref="15" damping="0.1" springref="20" stiffness="0.4"/>
        <geom type="mesh" mesh="block" pos="0.01 0 0" quat="0.7 0 0.7 0.1"/>
      </body>
    </frame>
    <body name="free one" pos="0.5 0.3 0.3" euler="0 90 0">
      <freejoint/>
      <inertial pos="0.01 0.02 0.03" euler="10 20 30" mass="0.7" diaginertia="0.001 0.0015 0.002"/>
      <geom type="mesh" mesh="shell"/>
    </body>
    <body name="other" pos="0.4 -0.3 0.3">
      <joint type="free"/>
      <inertial pos="0 0 0.01" mass="0.5" fullinertia="0.001 0.0012 0.0014 0.0001 -0.0002 0.00005"/>
      <geom type="box" size="0.02 0.02 0.03"/>
      <body pos="0.05 0 0"><geom type="cylinder" size="0.01 0.02" mass="0.2"/></body>
    </body>
  </worldbody>
</mujoco>"#;

#[cfg(feature = "mujoco")]
#[test]
fn numbers_are_those_of_mujoco() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("cube.obj"), CUBE).unwrap();
    std::fs::write(folder.path().join("open.obj"), CUBE.replace("f 4 1 5 8\n", "")).unwrap();
    let there = EVERYTHING.replace("meshdir=\"meshes\"", &format!("meshdir=\"{}\"", folder.path().display()));
    // MuJoCo has no volume for a surface that is not closed, but this body states its inertia.
    let mut theirs = robogate_physics::MujocoModel::from_xml(&there).unwrap();
    theirs.data_mut().forward();
    let data = theirs.data();
    let model = data.model();
    let ours = read(EVERYTHING, "").unwrap();
    let names: Vec<&str> = ours.parts.iter().map(|part| part.name.as_str()).collect();
    assert_eq!(names, ["carriage", "flap", "free_one", "other"]);
    assert_eq!(ours.fixtures.iter().map(|of| (of.name.as_str(), of.shapes.len())).collect::<Vec<_>>(), [("rail", 2)]);
    let layout = Layout::new(&ours.nominal, &ours.parents(), &[Draws::default(); 4]);
    // Bodies of the file in its order, with those that are welded to them.
    let bodies: [(&[usize], usize); 4] = [(&[3, 4], 0), (&[5], 1), (&[6], 2), (&[7, 8], 3)];
    for (bodies, part) in bodies {
        let part_of = &ours.nominal.parts[part];
        let joint = part_of.joint;
        let pose = layout.parts[part] * joint.map_or_else(nalgebra::Isometry3::identity, |of| of.motion(of.start));
        let mass = part_of.mass();
        let rotation = pose.rotation.to_rotation_matrix().into_inner();
        let (centre, inertia) =
            (pose * nalgebra::Point3::from(mass.centre), rotation * mass.inertia * rotation.transpose());
        let single: Vec<_> = bodies
            .iter()
            .map(|body| {
                let axes = Matrix3::from_row_slice(&data.ximat()[*body]);
                let own = Matrix3::from_diagonal(&Vector3::from(model.body_inertia()[*body]));
                robogate_physics::MassProperties {
                    mass_kg: model.body_mass()[*body],
                    centre: data.xipos()[*body].into(),
                    inertia: axes * own * axes.transpose(),
                }
            })
            .collect();
        let expected = robogate_physics::MassProperties::together(&single);
        let name = names[part];
        assert!((mass.mass_kg - expected.mass_kg).abs() < 1e-9, "{name}: {} {}", mass.mass_kg, expected.mass_kg);
        assert!((centre.coords - expected.centre).norm() < 1e-7, "{name}: {centre} {}", expected.centre);
        assert!(
            (inertia - expected.inertia).norm() < 1e-7 * inertia.norm().max(1.0),
            "{name}: {inertia} {}",
            expected.inertia
        );
    }
    // The first shape of each fixture and of parts without meshes.
    let near = |pose: nalgebra::Isometry3<f64>, geom: usize| {
        let axes = Matrix3::from_row_slice(&data.geom_xmat()[geom]);
        let off = (pose.translation.vector - Vector3::from(data.geom_xpos()[geom])).norm();
        // A capsule and a cylinder may be turned about their axis.
        let turned = (pose.rotation.to_rotation_matrix().into_inner().column(2) - axes.column(2)).norm();
        assert!(off < 1e-7 && turned < 1e-6, "geom {geom}: {off} {turned}");
    };
    for (geom, shape) in ours.fixtures[0].shapes.iter().enumerate() {
        near(layout.fixtures[0] * shape.pose, geom + 1);
    }
    let carriage = &ours.nominal.parts[0];
    let joint = carriage.joint.unwrap();
    let at_start = layout.parts[0] * joint.motion(joint.start);
    // A capsule is three shapes.
    for (geom, shape) in [(3, 0), (4, 1), (5, 2), (6, 5)] {
        near(at_start * carriage.shapes[shape].pose, geom);
    }
    for (index, part) in [(0, 0), (1, 1)] {
        let joint = ours.nominal.parts[part].joint.unwrap();
        let pose = layout.parts[part] * joint.motion(joint.start);
        let dof = model.jnt_dofadr()[index] as usize;
        let axis = pose * joint.axis;
        assert!((axis - Vector3::from(data.xaxis()[index])).norm() < 1e-9);
        let anchor = (pose * nalgebra::Point3::from(joint.anchor)).coords;
        if index == 1 {
            assert!((anchor - Vector3::from(data.xanchor()[index])).norm() < 1e-9);
        }
        for (ours, theirs) in [
            (joint.range[0], model.jnt_range()[index][0]),
            (joint.range[1], model.jnt_range()[index][1]),
            (joint.start, data.qpos()[model.jnt_qposadr()[index] as usize]),
            (joint.rest, model.qpos_spring()[model.jnt_qposadr()[index] as usize]),
            (joint.damping, model.dof_damping()[dof]),
            (joint.friction, model.dof_frictionloss()[dof]),
            (joint.stiffness, model.jnt_stiffness()[index]),
        ] {
            assert!((ours - theirs).abs() < 1e-9, "joint {index}: {ours} {theirs}");
        }
    }
    assert_eq!(ours.nominal.frictions, [Some(0.8)]);
    assert_eq!(ours.parts[0].color.map(|color| color.0), Some([255, 0, 0]));
    let note = &ours.figures.last().unwrap();
    for what in ["fixtures: rail; parts: carriage, flap, free_one, other", "<light>", "a plane", "options"] {
        assert!(note.contains(what), "{what}: {note}");
    }
}

#[test]
fn rotations_survive_texts() {
    for angles in [[0.1, 0.2, 0.3], [0.3, std::f64::consts::FRAC_PI_2, -1.0], [2.0, -std::f64::consts::FRAC_PI_2, 0.4]]
    {
        let wanted = UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]);
        let text = super::attributes::rotation_text(&wanted);
        let [roll, pitch, yaw] =
            crate::file::units::quantities::<3>(&text, crate::file::units::Dimension::ANGLE).unwrap();
        assert!(UnitQuaternion::from_euler_angles(roll, pitch, yaw).angle_to(&wanted) < 3e-6, "{text}");
    }
    // As files write it, with five digits.
    let wanted = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(1.0, 0.0, 1.0, 0.0));
    let [roll, pitch, yaw] = crate::file::units::quantities::<3>(
        &super::attributes::rotation_text(&wanted),
        crate::file::units::Dimension::ANGLE,
    )
    .unwrap();
    assert!(UnitQuaternion::from_euler_angles(roll, pitch, yaw).angle_to(&wanted) < 3e-6);
}

/// Names, keys that task.toml adds, and the sites.
#[test]
fn tables_add_keys_to_bodies() {
    let xml = r#"<mujoco><worldbody>
      <body name="Box 1" pos="0.5 0 0">
        <geom type="box" size="0.1 0.1 0.1"/>
        <site name="inner" type="box" size="0.05 0.04 0.03" pos="0 0 0.1" quat="0.70711 0 0 0.70711"/>
        <body name="lid" pos="0 0 0.1">
          <joint name="hinge" axis="0 1 0" range="0 90"/>
          <geom type="box" size="0.1 0.1 0.01"/>
          <site name="knob" pos="0.1 0 0"/>
          <body><joint name="latch"/><geom type="sphere" size="0.01" mass="0.02"/></body>
        </body>
      </body>
    </worldbody></mujoco>"#;
    let more = "name = \"chest\"\nat = \"10, 0, 0 cm\"\nweld = \"latch\"\n[[part]]\nname = \"chest_lid\"\nmass = \"2 kg\"\n\
                friction = 0.3\n[part.points.edge]\nat = \"1, 0, 0 cm\"\n[[fixture]]\nname = \"chest\"\ntouch = true\n\
                color = \"#102030\"";
    let model = read(xml, more).unwrap();
    assert_eq!((model.parts[0].name.as_str(), model.parts[0].parent), ("chest_lid", Some(0)));
    assert_eq!((model.fixtures[0].name.as_str(), model.fixtures[0].touch), ("chest", true));
    assert_eq!(model.fixtures[0].color.map(|color| color.0), Some([16, 32, 48]));
    let lid = &model.nominal.parts[0];
    assert_eq!((lid.mass_kg, lid.friction, lid.shapes.len()), (2.0, Some(0.3), 2));
    assert!((model.nominal.fixtures[0].at[0] - 0.6).abs() < 1e-12);
    let region = model.figures.last().unwrap();
    assert!(region.contains("models/scene.xml: fixtures: chest; parts: chest_lid"), "{region}");
    // One body at the top that moves freely.
    let model = read(xml, "name = \"chest\"\nweld = \"latch, hinge\"\nfree = true").unwrap_err();
    assert!(model.iter().all(|problem| !problem.what.contains("weld")), "{model:?}");
}

#[test]
fn broken_fragments_are_problems_with_lines() {
    let body = |inner: &str| {
        format!("<mujoco>\n<worldbody>\n<body name='a'>\n<freejoint/>\n{inner}\n</body>\n</worldbody>\n</mujoco>")
    };
    let top = |inner: &str| format!("<mujoco>\n{inner}\n<worldbody>\n</worldbody>\n</mujoco>");
    let cube = "<geom type='box' size='.1 .1 .1'/>";
    let joint = |inner: &str| body("").replace("<freejoint/>", inner).replace("\n\n", &format!("\n{cube}\n"));
    let mesh = |inner: &str| {
        format!(
            "<mujoco><asset>\n{inner}</asset>\n{}",
            body("<geom type='mesh' mesh='m'/>").split_once('\n').unwrap().1
        )
    };
    for (xml, line, what, hint) in [
        (body("<geom type='box' size='.1 .1 .1'>"), 6, "expected 'geom' tag, not 'body'", "XML in UTF-8"),
        ("<!DOCTYPE m [<!ENTITY a 'b'>]><mujoco/>".to_owned(), 1, "DTD", "without a DTD"),
        ("<robot/>".to_owned(), 1, "the root element is <robot>", "robogate tasks import"),
        (body("<geom type='box' sise='.1 .1 .1'/>"), 5, "unknown attribute `sise` of <geom>: did you mean `size`?", ""),
        (body("<geom type='box' size='.1 .1 x'/>"), 5, "size=\".1 .1 x\" is not a list of numbers", ""),
        (body("<geom type='box' size='nan 1 1'/>"), 5, "is not a list of numbers", ""),
        (body("<geom type='ellipsoid' size='.1 .1 .1'/>"), 5, "geoms of type `ellipsoid`", ""),
        (body("<geom type='plane' size='1 1 1'/>"), 5, "a plane is not a shape of a body", "Use a box"),
        (body("<geom type='mesh' mesh='m'/>"), 5, "unknown mesh `m`", ""),
        (body("<geom type='box' size='.1 .1 .1' quat='0 0 0 0'/>"), 5, "not a rotation", ""),
        (body("<geom type='box' size='.1 .1 .1' euler='1 2 3' quat='1 0 0 0'/>"), 5, "orientation twice", "leave one"),
        (body("<geom type='box' size='0 .1 .1'/>"), 5, "is out of range. Expected 1 mm to 5 m", ""),
        (body("<geom type='box' size='.1 .1 .1' class='no'/>"), 5, "unknown default class `no`", ""),
        (body("<geom type='box' size='.1 .1 .1' mass='1e6'/>"), 5, "is out of range. Expected 0.001 to 100 kg", ""),
        (body("<geom type='capsule' fromto='0 0 0 0 0 0' size='.1'/>"), 5, "`fromto` has no length", ""),
        (body("<composite type='cable'/>"), 5, "<composite> is not simulated", "one by one"),
        (body(&format!("{cube}<joint/>")), 5, "a second joint of a body", "weld"),
        (body(&format!("{cube}<body>\n<joint/>{cube}</body>")), 6, "which moves itself", "weld"),
        (joint("<joint type='ball'/>"), 4, "joints of type `ball`", "hinge or on a slide"),
        (joint("<joint armature='0.1'/>"), 4, "`armature` of <joint> is not simulated", "inertia"),
        (joint("<joint axis='0 0 0'/>"), 4, "`axis` has no length", ""),
        (joint("<joint range='90 0'/>"), 4, "expected the lower stop first", ""),
        (joint("<joint type='slide' range='0 90'/>"), 4, "more than 10 away", ""),
        (joint("<inertial mass='1' pos='0 0 0' diaginertia='1 1 3'/><freejoint/>"), 3, "no body has the moments", ""),
        (joint("<inertial mass='1' pos='0 0 0'/><freejoint/>"), 4, "one of `diaginertia` and `fullinertia`", ""),
        (top("<tendon>\n<fixed/></tendon>"), 3, "<fixed> of <tendon> is not simulated", "remove the tendon"),
        (top("<actuator>\n<motor/></actuator>"), 3, "<motor> of <actuator>", "robot"),
        (top("<equality><weld/></equality>"), 2, "<weld> of <equality>", "one body"),
        (top("<contact><pair/></contact>"), 2, "<pair> of <contact>", ""),
        (top("<wordbody/>"), 2, "unknown element <wordbody>: did you mean `worldbody`?", ""),
        (top("<compiler coordinate='global'/>"), 2, "`coordinate` of <compiler>", "frames of the parents"),
        (top("<include file='../out.xml'/>"), 2, "", ""),
        (top("<include file='/etc/passwd'/>"), 2, "is not a file in the folder of the task", ""),
        (top("<include file='missing.xml'/>"), 2, "models/missing.xml: there is no such file", ""),
        (top("<include file='again.xml'/>"), 1, "included twice", "each file once"),
        (mesh("<mesh name='m' file='../../c.obj'/>"), 2, "is not a file in the folder of the task", ""),
        (mesh("<mesh name='m' file='c.msh'/>"), 2, "neither STL nor OBJ", ""),
        (mesh("<mesh name='m' vertex='0 0 0'/>"), 2, "`vertex` of <mesh>", "write the mesh to a file"),
        (mesh("<mesh name='m' file='meshes/cube.obj' scale='1 -1 1'/>"), 2, "is out of range", ""),
        (format!("{}<body/>{}", "<body>".repeat(70), "</body>".repeat(70)), 1, "more than 64 levels", ""),
    ] {
        let problems = read(&xml, "").unwrap_err();
        let found = problems.iter().find(|problem| problem.file.starts_with("models/") && problem.what.contains(what));
        let found = found.unwrap_or_else(|| panic!("{xml}: expected {what}, found {problems:#?}"));
        assert_eq!(found.line, line, "{xml}: {found}");
        assert!(found.hint.contains(hint), "{xml}: {found}");
        assert!(found.to_string().starts_with(&format!("{}, line {line}: ", found.file)), "{found}");
    }
    // Problems of the table itself.
    for (keys, what) in [
        ("weld = \"latch\"", "`weld` names the joint `latch`"),
        ("at = \"1, 2 m\"", "has 2 numbers. Expected 3"),
        ("[[part]]\nname = \"lid\"\nmass = \"1 kg\"", "`lid` has no shapes"),
    ] {
        let problems = read(&body(cube), keys).unwrap_err();
        assert!(problems.iter().any(|problem| problem.what.contains(what)), "{keys}: {problems:#?}");
    }
}

/// Random damage and deep nesting end in problems or in a task.
#[test]
fn damaged_fragments_never_panic() {
    let deep = format!("{}{}", "<a>".repeat(200_000), "</a>".repeat(200_000));
    assert!(read(&deep, "").is_err());
    let entities = "<!DOCTYPE m [<!ENTITY a 'aaaa'><!ENTITY b '&a;&a;&a;'>]><mujoco>&b;</mujoco>";
    assert!(read(entities, "").is_err());
    let mut stream = robogate_core::Seed::campaign(7).episode(0).stream("damage");
    for _ in 0..400 {
        let mut bytes = EVERYTHING.as_bytes().to_vec();
        for _ in 0..3 {
            let at = (stream.between(0.0, bytes.len() as f64)) as usize % bytes.len();
            match stream.between(0.0, 3.0) as usize {
                0 => bytes[at] = b"0<>/'\"-e. "[stream.between(0.0, 10.0) as usize % 10],
                1 => drop(bytes.drain(at..(at + 7).min(bytes.len()))),
                _ => {
                    let piece = bytes[at..(at + 40).min(bytes.len())].to_vec();
                    bytes.splice(at..at, piece);
                }
            }
        }
        let _ = read(&String::from_utf8_lossy(&bytes), "");
    }
}
