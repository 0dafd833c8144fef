//! A scene that was written for plain MuJoCo moves there as in the engine.

use std::fs;
use std::path::Path;
use std::sync::{Arc, Mutex};

use mujoco_rs::prelude::*;
use nalgebra::{Isometry3, Vector3};
use robogate_physics::{
    Engine, Fixture, FixtureKind, GRAVITY, GripperUnit, JointTargets, MassProperties, Mesh, Motion, MujocoEngine,
    Object, Part, Pieces, Primitive, Scene, Tape, Triangles, Visual, built_in_robot,
};

#[expect(clippy::unwrap_used, reason = "a test fails by panicking")]
fn scene(with_piece: bool) -> Scene {
    let part = |half: [f64; 3]| Part { primitive: Primitive::Box { half }, pose: Isometry3::identity() };
    let parts = vec![part([0.025; 3])];
    let mut wall = part([0.01, 0.1, 0.1]);
    wall.pose = Isometry3::translation(0.5, -0.3, 0.1);
    let tetrahedron = b"v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n";
    let mesh = Mesh::new(&Triangles::read(tetrahedron, 4).unwrap(), 1.0).unwrap();
    let mut piece = Pieces::of(&mesh, 1).unwrap().parts.remove(0);
    piece.pose.translation.vector += Vector3::new(0.45, -0.02, 0.0);
    let motion = Motion::Straight { velocity: Vector3::new(0.0, 0.2, 0.0), starts_s: 0.01, ends_s: 0.5 };
    Scene {
        object: Object { mass: MassProperties::homogeneous(&parts, 0.3), parts, joint: None, friction: None },
        object_pose: Isometry3::translation(0.5, 0.0, 0.1),
        others: Vec::new(),
        friction: 0.8,
        table_friction: None,
        arm_stiffness: 1.0,
        gripper: GripperUnit::default(),
        fixtures: vec![
            Fixture::table(),
            Fixture {
                name: "wall".to_owned(),
                kind: FixtureKind::Obstacle,
                part: wall,
                motion: Some(motion),
                friction: None,
                color: None,
            },
        ]
        .into_iter()
        .chain(with_piece.then(|| Fixture {
            name: "piece".to_owned(),
            kind: FixtureKind::Receptacle,
            part: piece,
            motion: None,
            friction: None,
            color: None,
        }))
        .collect(),
        gravity: GRAVITY,
        marker: None,
        visual: Visual::default(),
    }
}

#[test]
fn exported_scene_moves_the_same() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("scene-export");
    fs::create_dir_all(&folder).unwrap();
    // The compiler finds the frame of a piece of a mesh again, with other last digits.
    for (robot, with_piece, tolerance) in [("franka", false, 1e-9), ("ur5e", false, 1e-9), ("franka", true, 1e-7)] {
        let tape: Arc<Mutex<Tape>> = Arc::default();
        let engine = MujocoEngine::new(built_in_robot(robot).unwrap(), MujocoEngine::TIME_STEP_S).unwrap();
        let mut engine = engine.taped(Arc::clone(&tape));
        let home = engine.robot().settings.arm.home_rad.clone();
        engine.load(&scene(with_piece), &home).unwrap();
        let mut targets = JointTargets { velocities: vec![0.0; home.len()], positions: home, finger: 0.04 };
        for k in 0..200 {
            targets.positions[1] += 1e-3 * f64::from(k).sin();
            targets.finger = 0.03;
            if k == 100 {
                engine.attach();
            }
            engine.advance(&targets);
        }
        let tape = tape.lock().unwrap();
        let [actuators, fixtures, welds] =
            engine.write_scene(tape.scene.as_ref().unwrap(), &tape.start, &folder, "scene.xml").unwrap();
        assert_eq!((fixtures.len(), welds.len()), (1, usize::from(robot == "ur5e")));
        let mut data = MjData::new(Box::new(MjModel::from_xml(folder.join("scene.xml")).unwrap()));
        assert_eq!(data.ctrl().len(), actuators.len());
        data.qpos_mut().copy_from_slice(&tape.start);
        data.forward();
        let model = data.model();
        let joint = model.name_to_id(MjtObjBase::mjOBJ_JOINT, &fixtures[0]).unwrap();
        let (qpos, qvel) = (model.jnt_qposadr()[joint] as usize, model.jnt_dofadr()[joint] as usize);
        let weld = welds.first().map(|name| model.name_to_id(MjtObjBase::mjOBJ_EQUALITY, name).unwrap());
        let mut worst = 0.0_f64;
        for (input, positions) in tape.inputs.iter().zip(&tape.positions) {
            data.ctrl_mut().copy_from_slice(&input.controls);
            data.qpos_mut()[qpos] = input.fixtures[0][0];
            data.qvel_mut()[qvel] = input.fixtures[0][1];
            if let (Some(weld), Some(Some(numbers))) = (weld, input.welds.first()) {
                // SAFETY: only numbers of an equality change.
                #[expect(unsafe_code, reason = "the binding has no safe setter")]
                let data_of_welds = unsafe { data.model_mut().eq_data_mut() };
                data_of_welds[weld][..numbers.len()].copy_from_slice(numbers);
                data.eq_active_mut()[weld] = true;
            }
            data.step();
            let off = |(i, (a, b)): (usize, (&f64, &f64))| if i == qpos { 0.0 } else { (a - b).abs() };
            worst = data.qpos().iter().zip(positions).enumerate().map(off).fold(worst, f64::max);
        }
        assert!(worst < tolerance, "{robot}: {worst}");
    }
}
