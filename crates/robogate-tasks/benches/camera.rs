//! Benchmark: cost of a rendered image.
//!
//! `cargo bench -p robogate-tasks --bench camera [-- FOLDER]` prints processor milliseconds per image (mean of front
//! and wrist, 256 x 256 pixels, with shadows and antialiasing), and the ratio to the time without acceleration
//! structures. With a folder it writes the images there as PPM.
#![expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
#![expect(clippy::print_stdout, clippy::unwrap_used, reason = "a benchmark prints its results")]

use std::time::SystemTime;

use robogate_camera::{Cameras, Posture};
use robogate_core::{Assignment, Seed, Value};
use robogate_physics::{Robot, Scene, built_in_robot};
use robogate_tasks::pick_place::{self, Placement, SceneParameters};

fn main() {
    let folder = std::env::args().skip(1).find(|argument| !argument.starts_with("--"));
    println!("robot    scene         ms a picture: median    least   exhaustive: ratio");
    for name in ["franka", "ur5e"] {
        let robot = built_in_robot(name).unwrap();
        for (label, settings) in scenes() {
            let (scene, posture) = at_home(&robot, settings);
            let mut cameras = Cameras::new(&robot).unwrap();
            cameras.set_up(&scene);
            let mut exhaustive = Cameras::new(&robot).unwrap().exhaustive();
            exhaustive.set_up(&scene);
            let images = cameras.render(&posture);
            let (mut quick, mut slow) = (Vec::new(), Vec::new());
            for _ in 0..7 {
                quick.push(milliseconds(|| cameras.render(&posture)));
                slow.push(milliseconds(|| exhaustive.render(&posture)));
            }
            quick.sort_by(f64::total_cmp);
            slow.sort_by(f64::total_cmp);
            let ratio = slow[0] / quick[0];
            println!("{name:<8} {label:<12} {:>22.2} {:>8.2} {ratio:>25.1}", quick[3], quick[0]);
            if let Some(folder) = &folder {
                for image in images {
                    let mut bytes = format!("P6 {} {} 255\n", image.width, image.height).into_bytes();
                    bytes.extend(&image.rgb);
                    std::fs::write(format!("{folder}/{name}-{label}-{}.ppm", image.camera), bytes).unwrap();
                }
            }
        }
    }
}

/// Processor time per image, in milliseconds.
fn milliseconds<T>(work: impl Fn() -> T) -> f64 {
    /// Repeats per measurement, because one image takes less than the system's clock tick.
    const REPEATS: u32 = 12;
    let start = busy();
    for _ in 0..REPEATS {
        std::hint::black_box(work());
    }
    (busy() - start) * 1e3 / f64::from(2 * REPEATS)
}

/// Processor time of this process in seconds, which excludes other load. Wall time if the system does not report it.
fn busy() -> f64 {
    let nanoseconds = std::fs::read_to_string("/proc/self/schedstat")
        .ok()
        .and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
    let clock = || SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_secs_f64();
    nanoseconds.map_or_else(clock, |nanoseconds| nanoseconds * 1e-9)
}

fn at_home(robot: &Robot, settings: Vec<(&'static str, Value)>) -> (Scene, Posture) {
    let mut requested = Assignment::default();
    for (parameter, value) in settings {
        requested.set(parameter, value);
    }
    let parameters = SceneParameters::from_assignment(&requested, &robot.settings.gripper).unwrap();
    let placement = Placement::from_name(&parameters.placement).unwrap();
    let scene = pick_place::scene(&parameters, &placement, 1.0, &mut Seed::campaign(1).stream("obstacles")).unwrap();
    let posture = Posture {
        joints: robot.settings.arm.home_rad.clone(),
        opening_m: robot.settings.gripper.jaw().map(|jaw| jaw.opening_m),
        cup_travel_m: 0.0,
        object: scene.object_pose,
        others: Vec::new(),
        fixtures: scene.fixtures.iter().map(|fixture| fixture.part.pose).collect(),
    };
    (scene, posture)
}

fn scenes() -> Vec<(&'static str, Vec<(&'static str, Value)>)> {
    let word = |word: &'static str| Value::Category(word.into());
    vec![
        ("plain", vec![]),
        ("steel", vec![("table_material", word("steel")), ("shape", word("cylinder"))]),
        ("laminate", vec![("table_material", word("laminate")), ("shape", word("sphere"))]),
        ("rubber", vec![("table_material", word("rubber")), ("shape", word("L_shape"))]),
        ("cardboard", vec![("table_material", word("cardboard")), ("shape", word("irregular"))]),
        (
            "crowded",
            vec![
                ("obstacles", Value::Integer(5)),
                ("occluders", Value::Integer(3)),
                ("disturbance_speed_m_s", Value::Number(0.2)),
                ("object_transparency", Value::Number(0.7)),
            ],
        ),
    ]
}
