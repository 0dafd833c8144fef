//! Claims about the physics of insertion: the limits of wedging and jamming of [`super::whitney`].

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_core::Assignment;
use robogate_physics::{Engine, GRAVITY, Gripper, Scene};

use super::parameters::Settings;
use super::{parts, whitney};
use crate::arm::claims::{self, Claim, ClaimResult, Ground, let_run, numbers, stream};

pub(super) const CLAIMS: [Claim; 5] = [
    Claim::new("ideal_peg", 0, ideal_peg),
    Claim::new("wedging", 0, wedging),
    Claim::new("jamming", 0, jamming),
    Claim::new("easy_region", 100, |ground, episodes| claims::easy_region(ground, episodes, easy)),
    Claim::new("joint_limits", 30, |ground, episodes| claims::joint_limits(ground, episodes, easy)),
];

/// Width of the peg and clearance, in metres.
const WIDTH_M: f64 = 0.03;
const CLEARANCE_M: f64 = 2e-4;

/// The scene of a peg that stands in the hole with its tip at this depth (m).
fn upright(depth: f64, friction: f64) -> Scene {
    let settings = Settings {
        width_m: WIDTH_M,
        clearance_m: CLEARANCE_M,
        mass_kg: 0.2,
        friction,
        arm_stiffness: 1.0,
        places: [[0.55, 0.2]; 2],
        ..Settings::default()
    };
    Scene { object_pose: Isometry3::translation(0.55, 0.2, parts::DEPTH_M - depth), ..settings.scene() }
}

/// As [`upright`], but the peg leans to two opposite walls, with its weight `lever` metres from the hole's axis.
fn leaning(depth: f64, lever: f64, friction: f64) -> Scene {
    let mut scene = upright(depth, friction);
    let tilt = 0.98 * CLEARANCE_M / depth;
    // The tip leans to one wall, the shaft to the opposite edge of the mouth.
    let tip = -0.49 * CLEARANCE_M;
    let offset = lever - tip - scene.object.mass.centre.z * tilt;
    scene.object = parts::peg(WIDTH_M, 0.2, offset);
    scene.object_pose = Isometry3::from_parts(
        Translation3::new(0.55 + tip, 0.2, parts::DEPTH_M - depth),
        UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt),
    );
    // The analysis is quasi-static: with a small weight the peg is slow while the contact forces build up.
    scene.gravity = 0.01 * GRAVITY;
    scene
}

/// The distance in metres by which a free peg sinks within this time in seconds.
fn sinks(engine: &mut dyn Engine, scene: &Scene, seconds: f64) -> Result<f64, String> {
    let_run(engine, scene, seconds)?;
    Ok(scene.object_pose.translation.z - engine.object().translation.z)
}

/// An upright peg with a centred weight falls to the bottom.
fn ideal_peg(ground: &Ground<'_>, _: usize) -> Result<ClaimResult, String> {
    let mut engine = ground.engine()?;
    let (mut figures, mut holds) = (Vec::new(), true);
    for friction in [0.1, 0.6] {
        let sunk = sinks(&mut *engine, &upright(0.005, friction), 1.0)?;
        holds &= (sunk - (parts::DEPTH_M - 0.005)).abs() < 1e-3;
        figures.push(format!("friction {friction}: sinks {:.2} mm", 1e3 * sunk));
    }
    Ok(ClaimResult::new("an upright peg with a centred weight falls to the bottom of the hole", holds, figures))
}

/// Leaning pegs (depth in m, lever in m, friction) stay where `stuck` says so and sink elsewhere.
fn obey(
    ground: &Ground<'_>,
    claim: &str,
    pegs: impl IntoIterator<Item = [f64; 3]>,
    stuck: impl Fn([f64; 3]) -> bool,
) -> Result<ClaimResult, String> {
    let mut engine = ground.engine()?;
    let (mut figures, mut holds) = (Vec::new(), true);
    for peg in pegs {
        let [depth, lever, friction] = peg;
        let sunk = sinks(&mut *engine, &leaning(depth, lever, friction), 2.0)?;
        holds &= if stuck(peg) { sunk < 1e-3 } else { sunk > 5e-3 };
        let at = [depth, lever, sunk].map(|metres| 1e3 * metres);
        figures.push(format!(
            "friction {friction}, {:.1} mm deep, load {:.1} mm off the axis: sinks {:.2} mm. Expected to stay: {}",
            at[0],
            at[1],
            at[2],
            stuck(peg)
        ));
    }
    Ok(ClaimResult::new(claim, holds, figures))
}

/// A quarter below and above a limit.
const SHARES: [f64; 2] = [0.75, 1.25];

/// A load at the peg's edge holds the peg where it can wedge, and pushes it in where it cannot.
fn wedging(ground: &Ground<'_>, _: usize) -> Result<ClaimResult, String> {
    let of = |friction: f64| SHARES.map(|share| [share * friction * WIDTH_M, 0.5 * WIDTH_M, friction]);
    let claim = "a load at its edge holds a leaning peg down to the depth where it can wedge (Whitney 1982)";
    obey(ground, claim, [0.3, 0.4, 0.6].into_iter().flat_map(of), |[depth, _, friction]| {
        whitney::can_wedge(depth, WIDTH_M, friction)
    })
}

/// The lever of the load decides whether it jams the peg.
fn jamming(ground: &Ground<'_>, _: usize) -> Result<ClaimResult, String> {
    let of = |(friction, lever): (f64, f64)| SHARES.map(|share| [share * 2.0 * friction * lever, lever, friction]);
    let claim = "a load jams a leaning peg down to the depth that follows from its lever (Whitney 1982)";
    obey(ground, claim, [(0.4, 0.012), (0.6, 0.008), (0.8, 0.007)].into_iter().flat_map(of), |[depth, lever, mu]| {
        whitney::jams(depth, lever, mu)
    })
}

fn easy(_: &Gripper, index: u64) -> Assignment {
    let mut stream = stream("claims/easy", index);
    let ranges = [
        ("friction", [0.1, 0.2]),
        ("mass_kg", [0.1, 0.3]),
        ("clearance_m", [0.001, 0.002]),
        ("chamfer_m", [0.001, 0.003]),
        ("hole_jitter_m", [0.0, 0.001]),
    ];
    numbers(ranges.map(|(name, [low, high])| (name, stream.between(low, high))))
}
