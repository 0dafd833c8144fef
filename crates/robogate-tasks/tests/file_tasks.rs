//! Tasks from files: what is read, what is refused, and what the physics of the shipped tasks does.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use std::fs;
use std::path::Path;

use robogate_core::{Allowed, Assignment, Environment, FailureMode, Outcome, Policy, Value, check_applied, rollout};
use robogate_physics::Robot;
use robogate_tasks::file::{FILE, FileTask};
use robogate_tasks::{ArmDeclaration, ArmEnvironment, ArmTask, Rig};

use common::{EngineKind, Idle, scenario};

/// The shipped tasks with the robots that solve them.
const SHIPPED: [(&str, &[&str]); 11] = [
    ("drawer", &["franka", "ur5e", "ur10e"]),
    ("button", &["franka", "ur5e", "ur10e"]),
    ("door", &["franka", "ur5e", "ur10e"]),
    ("lid", &["franka", "ur5e", "ur10e"]),
    ("palletising", &["franka", "ur5e"]),
    ("machine_tending", &["franka", "ur5e"]),
    ("kitting", &["franka", "ur5e"]),
    ("bin_picking", &["franka", "ur5e"]),
    ("pipe_clamp", &["franka", "ur5e"]),
    // A UR5e succeeds in 37 of 40 (docs/reference/task-file.md).
    ("peg_board", &["franka"]),
    ("screw_start", &["franka", "ur5e"]),
];

fn text(task: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/tasks").join(task).join(FILE)).unwrap()
}

fn shipped(task: &str) -> FileTask {
    read(task, &text(task))
}

/// A text with the files of a shipped task beside it.
fn read(task: &str, text: &str) -> FileTask {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/tasks").join(task);
    FileTask::read_with(text, &mut |name| fs::read(folder.join(name)).map_err(|why| why.to_string())).unwrap()
}

fn robot(name: &str) -> Robot {
    EngineKind::Mujoco.robot(name).robot
}

fn environment(task: &FileTask, robot: &str) -> ArmEnvironment {
    task.on(EngineKind::Mujoco.robot(robot).engine(), Rig { picture_px: [16; 2], ..Rig::default() }).unwrap()
}

fn expert(task: &FileTask, environment: &ArmEnvironment, of: &str) -> Box<dyn Policy> {
    task.controller(robot(of), environment.engine().chain().clone())
}

/// Nominal scenarios: each has its own hidden draws, from small encoder errors.
fn nominal(index: u64) -> robogate_core::Scenario {
    scenario(index, &[("encoder_bias_rad", 0.002)])
}

#[test]
fn experts_solve_shipped_tasks() {
    const EPISODES: u64 = 20;
    let mut failures = Vec::new();
    for (name, robots) in SHIPPED {
        let task = shipped(name);
        for of in robots {
            let mut environment = environment(&task, of);
            let mut expert = expert(&task, &environment, of);
            let outcomes = (0..EPISODES).map(|index| rollout(&mut environment, &mut *expert, &nominal(index)).outcome);
            let failures_of: Vec<_> = outcomes.filter(|outcome| *outcome != Outcome::Success).collect();
            let failed = failures_of.len() as u64;
            println!("{name} on {of}: {} of {EPISODES} nominal episodes succeed {failures_of:?}", EPISODES - failed);
            if failed * 20 > EPISODES {
                failures.push((name, *of, failed));
            }
        }
    }
    assert_eq!(failures, []);
}

/// Every parameter is set to both ends of its range and read back.
#[test]
fn parameters_act_in_the_engine() {
    for (name, robots) in SHIPPED {
        let task = shipped(name);
        let mut environment = environment(&task, robots[0]);
        let spec = std::sync::Arc::clone(environment.task());
        let space = task.brought_space().unwrap();
        for parameter in spec.parameters.iter().filter(|parameter| space.position(&parameter.name).is_some()) {
            let Allowed::Continuous { low, high } = parameter.allowed else { panic!("{}", parameter.name) };
            for value in [low, 0.3 * low + 0.7 * high, high] {
                let scenario = scenario(3, &[(&*parameter.name, value)]);
                let start = environment.reset(&scenario).unwrap();
                check_applied(&scenario.requested, &start.applied).unwrap();
                assert_eq!(
                    start.applied.get(&parameter.name),
                    Some(&Value::Number(value)),
                    "{name}: {}",
                    parameter.name
                );
            }
        }
    }
}

#[test]
fn doing_nothing_is_a_timeout() {
    for (name, robots) in SHIPPED {
        let episode = rollout(&mut environment(&shipped(name), robots[0]), &mut Idle::default(), &scenario(0, &[]));
        // A carton that is left alone falls from the end of the belt.
        let expected = if name == "palletising" { FailureMode::constant("left_belt") } else { FailureMode::TIMEOUT };
        assert_eq!(episode.outcome, Outcome::Failure(expected), "{name}");
        assert_eq!(episode.measures.get("stages"), Some(0.0), "{name}");
    }
}

#[test]
fn declaration_contains_the_file() {
    let task = shipped("drawer");
    let spec = std::sync::Arc::clone(environment(&task, "franka").task());
    let again = FileTask::recorded(&spec).unwrap().unwrap();
    assert_eq!(again.text(), text("drawer"));
    assert_eq!(**environment(&again, "franka").task(), *spec);
}

/// A part above the table that falls, with one condition as the success.
fn falling(when: &str) -> String {
    format!(
        "format = 'robogate-task/1'\nname = 'fall'\ninstruction = 'wait'\ntime_limit = '1 s'\n\
         [[fixture]]\nname = 'shelf'\nat = '60, 20, 5 cm'\nshapes = [{{ box = '10, 10, 2 cm' }}]\n\
         [[part]]\nname = 'cube'\nat = '60, 20, 12 cm'\nmass = '200 g'\nshapes = [{{ box = '4, 4, 4 cm' }}]\n\
         [[part]]\nname = 'flap'\nat = '60, -20, 30 cm'\nmass = '100 g'\nshapes = [{{ box = '10, 4, 1 cm', at = '5, 0, 0 cm' }}]\n\
         [part.joint]\nkind = 'hinge'\naxis = 'y'\nrange = '0, 80 deg'\n\
         [[region]]\nname = 'top'\nat = '60, 20, 8 cm'\nsize = '6, 6, 2 cm'\n\
         [success]\nwhen = '{when}'\n"
    )
}

fn outcome(when: &str) -> (Outcome, f64) {
    let task = FileTask::read(&falling(when)).unwrap_or_else(|problems| panic!("{when}: {problems:?}"));
    let episode = rollout(&mut environment(&task, "franka"), &mut Idle::default(), &scenario(0, &[]));
    (episode.outcome, episode.time_s)
}

/// The cube falls 4 cm (0.09 s) and rests on the shelf. The flap falls to its stop at 80 degrees.
#[test]
fn conditions_follow_the_physics() {
    for (when, from, to) in [
        ("contact(cube, shelf)", 0.085, 0.1),
        ("on(cube, shelf)", 0.085, 0.1),
        ("on(cube, shelf) for 0.3 s", 0.385, 0.5),
        ("inside(cube, top)", 0.07, 0.095),
        ("once(inside(cube, top)) and at_rest(cube)", 0.085, 0.4),
        ("moved(cube) > 3 cm", 0.075, 0.082),
        ("height(cube) < 9 cm", 0.075, 0.082),
        ("speed(cube) > 50 cm/s", 0.05, 0.053),
        ("force(cube, shelf) > 1.9 N for 100 ms", 0.18, 0.5),
        ("distance(cube, shelf) < 4.5 cm", 0.065, 0.1),
        ("joint(flap) > 45 deg", 0.1, 0.3),
        ("joint(flap) > 45 deg before joint(flap) > 60 deg", 0.1, 0.3),
        ("tilt(flap) > 45 deg and not upright(flap)", 0.1, 0.3),
        ("speed(flap) > 90 deg/s", 0.005, 0.05),
        ("contact(cube, shelf) within 0.1 s of joint(flap) < 60 deg", 0.085, 0.1),
        ("time() > 0.2 s", 0.2, 0.21),
        ("moved(cube) > 2 cm + 1 cm or time() > 0.5 s", 0.075, 0.082),
    ] {
        let (outcome, time_s) = outcome(when);
        assert_eq!(outcome, Outcome::Success, "{when}");
        assert!((from..to).contains(&time_s), "{when}: {time_s} s");
    }
    for when in [
        "contact(robot, cube)",
        "contact(flap, shelf)",
        "joint(flap) > 100 deg",
        "held(cube)",
        "dropped(cube)",
        "joint(flap) > 60 deg before joint(flap) > 45 deg",
        "moved(flap) > 1 cm",
        "time() > 2 s",
    ] {
        assert_eq!(outcome(when).0, Outcome::Failure(FailureMode::TIMEOUT), "{when}");
    }
}

#[test]
fn problems_have_lines_and_hints() {
    let valid = text("drawer");
    for (from, to, expected) in [
        ("[success]", "[succes]", "unknown key `succes`: did you mean `success`?"),
        (
            "joint(drawer) > {opening_m} and",
            "jiont(drawer) > {opening_m} and",
            "unknown word `jiont`: did you mean `joint`?",
        ),
        (
            "joint(drawer) > {opening_m} and",
            "joint(drawr) > {opening_m} and",
            "unknown part `drawr`: did you mean `drawer`?",
        ),
        ("joint(drawer) > {opening_m} and", "joint(drawer) > 3 kg and", "the sides do not fit: a length"),
        (
            "joint(drawer) > {opening_m} and",
            "joint(drawer) > {opening} and",
            "unknown parameter `opening`: did you mean `opening_m`?",
        ),
        ("joint(drawer) > {opening_m} and", "joint(drawer) and", "`joint` is not a condition"),
        ("\"open the drawer by {opening_m}\"", "\"open by {openning_m}\"", "unknown parameter `openning_m`"),
        ("damping = \"10 N s/m\"", "damping = \"10 kg\"", "`10 kg` does not fit. Expected a quantity in N s/m"),
        ("damping = \"10 N s/m\"", "damping = \"-1 N s/m\"", "out of range. Expected 0 to 10000 N s/m"),
        ("sets = \"drawer.mass\"", "sets = \"drawer.mas\"", "`drawer` has no `mas`: did you mean `mass`?"),
        ("sets = \"drawer.joint.friction\"", "sets = \"cabinet.joint.friction\"", "`cabinet` has no `joint.friction`"),
        ("name = \"stick_n\"", "name = \"stick_m\"", "`stick_m` ends with the unit m, but its value is in N"),
        ("range = \"0.5, 8 kg\"", "range = \"8, 0.5 kg\"", "expected the smaller value first"),
        ("range = \"0.5, 8 kg\"", "range = \"-0.5, 8 kg\"", "the smallest possible value is 0.0001 kg"),
        ("range = \"0.5, 8 kg\"", "range = \"3, 8 kg\"", "the value in the file, 2 kg, is outside of the range"),
        ("in = \"cabinet\"", "in = \"cabint\"", "unknown body `cabint`: did you mean `cabinet`?"),
        ("name = \"drawer\"", "name = \"cabinet\"", "a second body or region `cabinet`"),
        ("name = \"forced\"", "name = \"timeout\"", "every task has the failure `timeout`"),
        ("value = \"max force", "value = \"most force", "found `most`. Expected `max VALUE`"),
        ("\"wait(0.5 s)\"", "\"waits(0.5 s)\"", "unknown skill `waits`: did you mean `wait`?"),
        ("\"wait(0.5 s)\"", "\"wait(0.5 m)\"", "the number does not fit. Expected a duration"),
        ("\"wait(0.5 s)\"", "\"pull(drawer)\"", "`pull` has other arguments. Expected `pull(PART, VALUE[, SPEED])`"),
        ("axis = \"-x\"", "axis = \"left\"", "unknown axis `left`. Expected x, y, z"),
        ("robogate-task/1", "robogate-task/9", "unknown format `robogate-task/9`"),
        ("name = \"open_drawer\"", "name = \"Open Drawer\"", "expected a name of lower-case letters"),
        ("time_limit = \"20 s\"", "time_limit = \"20.01 s\"", "expected a multiple of 0.05 s"),
        ("box = \"2, 29, 16 cm\"", "box = \"2, 29 cm\"", "has 2 numbers. Expected 3"),
        ("box = \"2, 29, 16 cm\"", "ball = \"2 cm\"", "unknown key `ball`"),
        ("at = \"62, 0, 0 cm\"", "belt = \"x\"", "`x` does not fit. Expected a text such as `x, 10 cm/s`"),
        ("at = \"62, 0, 0 cm\"", "belt = \"x, 10 cm\"", "`10 cm` does not fit. Expected a speed"),
        ("at = \"62, 0, 0 cm\"", "turn = \"up, 10 deg/s\"", "unknown axis `up`"),
        ("at = \"62, 0, 0 cm\"", "shuttle = \"x, 10 cm, 9 m/s\"", "`9 m/s` is out of range. Expected 0 to 2 m/s"),
        ("at = \"62, 0, 0 cm\"", "turn = \"z, 9 deg/s\"\nbelt = \"x, 1 cm/s\"", "a second motion"),
        ("sets = \"drawer.mass\"", "sets = \"cabinet.speed\"", "`cabinet` has no `speed`"),
    ] {
        assert!(valid.contains(from), "{from}");
        let broken = valid.replacen(from, to, 1);
        let line = 1 + valid[..valid.find(from).unwrap()].matches('\n').count();
        let problems = FileTask::read(&broken).unwrap_err();
        let found = problems.iter().find(|problem| problem.what.contains(expected));
        let found = found.unwrap_or_else(|| panic!("{to}: {problems:#?}"));
        assert_eq!(found.line, line, "{to}");
    }
}

#[test]
fn large_files_are_refused() {
    let long = format!("{}\n# {}", text("drawer"), "x".repeat(70_000));
    assert!(FileTask::read(&long).unwrap_err()[0].what.contains("bytes"));
    let many = format!("{}\n{}", text("drawer"), "[[region]]\nname = 'r'\nsize = '1, 1, 1 cm'\n".repeat(100));
    assert!(FileTask::read(&many).unwrap_err().iter().any(|problem| problem.what.contains("At most 64 are accepted")));
    for broken in ["", "format = 3", "[[part]]", "\u{0}", "a = [[[[[[[[[[1]]]]]]]]]]"] {
        assert!(FileTask::read(broken).is_err(), "{broken}");
    }
}

#[test]
fn lint_finds_what_can_never_happen() {
    let of = |text: &str, on: &str| problems(&FileTask::read(text).unwrap(), on);
    fn problems(task: &FileTask, on: &str) -> Vec<String> {
        let engine = EngineKind::Mujoco.robot(on).engine();
        task.lint(&robot(on), engine.chain()).into_iter().map(|problem| problem.to_string()).collect()
    }
    for (name, robots) in SHIPPED {
        robots.iter().for_each(|on| assert_eq!(problems(&shipped(name), on), [""; 0], "{name}"));
    }
    let beyond = text("drawer").replacen("range = \"8, 18 cm\"", "range = \"8, 30 cm\"", 1);
    let problems = of(&beyond, "franka");
    assert!(problems[0].contains("joint(drawer) is compared with 0.3, but it moves from 0 to 0.22"), "{problems:?}");
    let far = text("drawer").replacen("at = \"62, 0, 0 cm\"", "at = \"162, 0, 0 cm\"", 1);
    let far = far.replacen("range = \"59, 65 cm\"", "range = \"159, 165 cm\"", 1);
    let problems = of(&far, "franka");
    assert!(problems[0].contains("the expert cannot reach the goal of skill 1 (`reach`)"), "{problems:?}");
}

#[test]
fn episodes_repeat_bit_for_bit() {
    let task = shipped("lid");
    let run = || {
        let mut environment = environment(&task, "franka");
        let mut expert = expert(&task, &environment, "franka");
        let requested = [("lid_spread_m".into(), Value::Number(0.01))].into_iter().collect::<Assignment>();
        let mut scenario = scenario(5, &[]);
        scenario.requested = requested;
        rollout(&mut environment, &mut *expert, &scenario)
    };
    assert_eq!(run(), run());
}

/// Two cubes start anywhere in a region, beside each other. The expert is told where, and brings one to the tray.
const SORT: &str = "format = 'robogate-task/1'
name = 'sort'
instruction = 'put the red cube on the tray'
time_limit = '20 s'
[[fixture]]
name = 'tray'
at = '50, 20, 0.5 cm'
shapes = [{ box = '14, 14, 1 cm' }]
[[part]]
name = 'red'
at = '0, 0, 2.5 cm'
start = 'source'
spin = '40 deg'
mass = '100 g'
shapes = [{ box = '5, 5, 5 cm' }]
[[part]]
name = 'blue'
at = '0, 0, 2.5 cm'
start = 'source'
mass = '100 g'
shapes = [{ box = '5, 5, 5 cm' }]
[[region]]
name = 'source'
at = '50, -12, 2.5 cm'
size = '22, 30, 1 cm'
[[region]]
name = 'goal'
in = 'tray'
at = '0, 0, 3 cm'
size = '10, 10, 2 cm'
[success]
when = 'inside(red, goal) and on(red, tray) and at_rest(red) and not held(red) for 0.2 s'
[[failure]]
name = 'disturbed'
when = 'moved(blue) > 1 cm'
[[failure]]
name = 'dropped'
when = 'dropped(red)'
[expert]
do = ['approach(red, 12 cm)', 'grasp(red)', 'lift(12 cm)', 'carry(goal, 8 cm)', 'carry(goal, 2 mm, 5 cm/s)', 'release()', 'lift(8 cm)']
";

#[test]
fn starts_are_drawn_from_regions() {
    let task = FileTask::read(SORT).unwrap();
    let mut environment = environment(&task, "franka");
    let mut expert = expert(&task, &environment, "franka");
    let (mut places, mut solved) = (Vec::new(), 0);
    for index in 0..12 {
        let start = environment.reset(&scenario(index, &[])).unwrap();
        let at = |part: &str| -> Vec<f64> {
            let pose = &start.instance.details["parts"][part]["position"];
            pose.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
        };
        let (red, blue) = (at("red"), at("blue"));
        for part in [&red, &blue] {
            assert!((part[0] - 0.5).abs() <= 0.11 && (part[1] + 0.12).abs() <= 0.15 && part[2] == 0.025, "{part:?}");
        }
        assert!((red[0] - blue[0]).hypot(red[1] - blue[1]) > 0.07, "{red:?} {blue:?}");
        places.push(red[0].to_bits());
        solved += u32::from(rollout(&mut environment, &mut *expert, &scenario(index, &[])).outcome == Outcome::Success);
    }
    places.sort_unstable();
    places.dedup();
    assert_eq!(places.len(), 12);
    assert!(solved >= 10, "{solved} of 12");
}

#[test]
fn crowded_region_is_a_setup_fault() {
    let crowded = SORT.replace("size = '22, 30, 1 cm'", "size = '3, 3, 1 cm'");
    let task = FileTask::read(&crowded).unwrap();
    let fault = environment(&task, "franka").reset(&scenario(0, &[])).unwrap_err();
    assert!(fault.to_string().contains("the parts do not fit beside each other"), "{fault}");
}

/// The start in a region takes the place of these numbers, so a parameter that sets one would do nothing.
#[test]
fn parameters_of_drawn_places_are_refused() {
    for path in ["red.at.x", "red.spread"] {
        let parameter =
            format!("[[parameter]]\nname = 'here_m'\nsets = '{path}'\nrange = '0, 1 cm'\nmeaning = 'Where.'\n");
        let broken = SORT.replacen("[success]", &format!("{parameter}[success]"), 1);
        let problems = FileTask::read(&broken).unwrap_err();
        assert!(problems[0].what.contains("has no effect: the part starts anywhere"), "{path}: {problems:?}");
    }
}

/// A yaw is read back beyond half a turn too, and beside a pitch of 90 degrees.
#[test]
fn yaw_is_read_back() {
    for (turn, yaw) in [("0, 0, 0 deg", 3.3), ("0, 90, 0 deg", 0.4), ("20, -30, 0 deg", -3.0)] {
        let parameter = "[[parameter]]\nname = 'yaw_rad'\nsets = 'tray.yaw'\nrange = '-200, 200 deg'\nmeaning = 'Yaw of the tray.'\n";
        let text = SORT.replacen("[success]", &format!("{parameter}[success]"), 1);
        let text = text.replacen("at = '50, 20, 0.5 cm'", &format!("at = '50, 20, 12 cm'\nrotation = '{turn}'"), 1);
        let task = FileTask::read(&text).unwrap_or_else(|why| panic!("{why:?}"));
        let scenario = scenario(1, &[("yaw_rad", yaw)]);
        let start = environment(&task, "franka").reset(&scenario).unwrap();
        assert_eq!(start.applied.number("yaw_rad"), Some(yaw), "{turn}");
    }
}

/// Numbers of a skill that no robot can follow are a failure of the expert, and no request for memory.
#[test]
fn endless_skills_are_refused() {
    for skill in ["lift(1000000000 m)", "carry(goal, 2 mm, 0.000000001 cm/s)"] {
        let text = SORT.replacen("'lift(12 cm)'", &format!("'{skill}'"), 1);
        let Ok(task) = FileTask::read(&text) else { continue };
        let mut environment = environment(&task, "franka");
        let mut expert = expert(&task, &environment, "franka");
        let episode = rollout(&mut environment, &mut *expert, &scenario(0, &[]));
        assert_ne!(episode.outcome, Outcome::Success, "{skill}");
    }
}

/// A part on a fixture that moves, and one condition as the success. The policy does nothing.
fn carried(motion: &str, at: &str, when: &str, on: EngineKind) -> (Outcome, f64) {
    let text = format!(
        "format = 'robogate-task/1'\nname = 'carry'\ninstruction = 'wait'\ntime_limit = '4 s'\n\
         [[fixture]]\nname = 'carrier'\nat = '50, 0, 4 cm'\n{motion}\nshapes = [{{ box = '40, 50, 2 cm' }}]\n\
         [[part]]\nname = 'cube'\nin = 'carrier'\nat = '{at}'\nmass = '200 g'\nshapes = [{{ box = '4, 4, 4 cm' }}]\n\
         [[region]]\nname = 'spot'\nin = 'carrier'\nat = '{at}'\nsize = '1, 1, 1 cm'\n\
         [success]\nwhen = '{when}'\n"
    );
    let task = FileTask::read(&text).unwrap_or_else(|problems| panic!("{motion}: {problems:?}"));
    let rig = Rig { picture_px: [16; 2], ..Rig::default() };
    let mut environment = task.on(on.robot("franka").engine(), rig).unwrap();
    let episode = rollout(&mut environment, &mut Idle::default(), &scenario(0, &[]));
    (episode.outcome, episode.time_s)
}

/// A belt carries a part at its speed, and its own places stand still. A shuttle and a turn carry part and places along.
#[test]
fn moving_fixtures_carry_parts() {
    let mut engines = vec![EngineKind::Mujoco];
    #[cfg(feature = "rapier")]
    engines.push(EngineKind::Rapier);
    let (belt, shuttle, turn) = ("belt = '-y, 10 cm/s'", "shuttle = 'y, 20 cm, 10 cm/s'", "turn = 'z, 30 deg/s'");
    for on in engines {
        for (motion, at, when, from, to) in [
            (belt, "0, 0, 3 cm", "moved(cube) > 15 cm", 1.5, 1.55),
            (belt, "0, 0, 3 cm", "not inside(cube, spot)", 0.05, 0.08),
            // 0.1 m (1 - cos(t / s)) is 0.197 m after 2.896 s.
            (shuttle, "0, 0, 3 cm", "moved(cube) > 19.7 cm and inside(cube, spot)", 2.89, 2.91),
            (turn, "12, 0, 3 cm", "moved(cube) > 12 cm and inside(cube, spot)", 1.98, 2.05),
        ] {
            let (outcome, time_s) = carried(motion, at, when, on);
            assert_eq!(outcome, Outcome::Success, "{motion}: {when}");
            assert!((from..to).contains(&time_s), "{motion}: {when}: {time_s} s");
        }
    }
}

/// A part on a joint stands in the world of the engine, so nothing can carry it.
#[test]
fn jointed_parts_are_not_carried() {
    let at = "at = \"62, 0, 0 cm\"";
    let broken = text("drawer").replacen(at, &format!("{at}\nshuttle = \"y, 10 cm, 5 cm/s\""), 1);
    let problems = FileTask::read(&broken).unwrap_err();
    assert!(problems[0].what.contains("so a part on a joint cannot be in it"), "{problems:?}");
}

/// The expert takes a part at the stop of a belt, from a turning table, and puts one on a tray that shuttles.
#[test]
fn expert_meets_what_moves() {
    let task = |fixtures: &str, part: &str, success: &str, skills: &str| {
        let text = format!(
            "format = 'robogate-task/1'\nname = 'meet'\ninstruction = 'take it'\ntime_limit = '30 s'\n{fixtures}\n\
             [[part]]\nname = 'cube'\n{part}\nmass = '200 g'\nshapes = [{{ box = '5, 5, 5 cm' }}]\n\
             [success]\nwhen = '{success}'\n[expert]\ndo = [{skills}]\n"
        );
        FileTask::read(&text).unwrap_or_else(|problems| panic!("{problems:?}"))
    };
    let take = "'approach(cube, 10 cm)', 'grasp(cube)', 'lift(10 cm)'";
    let held = "held(cube) and height(cube) > 12 cm";
    let belt = "[[fixture]]\nname = 'belt'\nat = '50, -20, 2.5 cm'\nbelt = 'y, 8 cm/s'\nshapes = [{ box = '12, 60, 5 cm' }]\n\
                [[fixture]]\nname = 'stop'\nat = '50, 13, 3.1 cm'\nshapes = [{ box = '12, 2, 6.2 cm' }]\n\
                [[region]]\nname = 'pick'\nat = '50, 9.5, 7.5 cm'\nsize = '2, 2, 2 cm'";
    let table = "[[fixture]]\nname = 'table_top'\nat = '50, 0, 2.5 cm'\nturn = 'z, 15 deg/s'\nshapes = [{ cylinder = '36, 5 cm' }]";
    let tray = "[[fixture]]\nname = 'tray'\nat = '42, 12, 1 cm'\nshuttle = 'y, 12 cm, 3 cm/s'\nshapes = [{ box = '14, 14, 2 cm' }]\n\
                [[region]]\nname = 'goal'\nin = 'tray'\nat = '0, 0, 3.5 cm'\nsize = '4, 4, 2 cm'";
    let put = format!("{take}, 'carry(goal, 8 cm, 25 cm/s)', 'carry(goal, 1 mm, 8 cm/s)', 'release()', 'lift(8 cm)'");
    let there = "(inside(cube, goal) and on(cube, tray) and not contact(robot, cube)) for 2 s";
    for of in ["franka", "ur5e"] {
        for (name, task) in [
            ("stop", task(belt, "in = 'belt'\nat = '0, -15, 5 cm'", held, &format!("'await(cube, pick)', {take}"))),
            ("turn", task(table, "in = 'table_top'\nat = '-12, 0, 5 cm'", held, take)),
            ("shuttle", task(tray, "at = '52, -15, 2.5 cm'", there, &put)),
        ] {
            let mut environment = environment(&task, of);
            let mut expert = expert(&task, &environment, of);
            let episode = rollout(&mut environment, &mut *expert, &nominal(0));
            assert_eq!(
                episode.outcome,
                Outcome::Success,
                "{name} on {of}: {:?} at {} s",
                episode.phase,
                episode.time_s
            );
        }
    }
}
