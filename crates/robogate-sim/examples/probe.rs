//! probe
#![allow(clippy::print_stdout, clippy::unwrap_used, clippy::allow_attributes)]
use robogate_core::*;
use robogate_sim::*;
use std::collections::BTreeMap;
use std::sync::Arc;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let mode = args[1].as_str();
    let n: usize = args[2].parse().unwrap();
    let dt: f64 = args.get(3).map_or(0.002, |s| s.parse().unwrap());
    let robot = built_in_robot("franka").unwrap();
    let engine = MujocoEngine::new(robot.clone(), dt).unwrap();
    let chain = engine.chain().clone();
    println!("{:?}", engine.build());
    let mut sim = PickPlace::new(engine, None).unwrap();
    let mut policy = Scripted::new(robot, chain);
    let space = Arc::new(ParameterSpace::from_toml(FRANKA_SPACE).unwrap());
    if mode == "one" {
        let mut a = Assignment::default();
        for kv in &args[4..] {
            let (k, v) = kv.split_once('=').unwrap();
            let v = v
                .parse::<i64>()
                .map(Value::Integer)
                .or_else(|_| v.parse::<f64>().map(Value::Number))
                .unwrap_or_else(|_| Value::Category(v.into()));
            a.set(k, v);
        }
        let s = Scenario { index: n as u64, seed: Seed::campaign(1).episode(n as u64), requested: a };
        let e = rollout_with(&mut sim, &mut policy, &s, &mut |t| {
            if std::env::var("V").is_ok() {
                println!(
                    "{:.2} {:?} d {:?} slip {:?} open {:?}",
                    t.step.observation.time_s,
                    t.action.phase,
                    t.step.measures.target_distance_m,
                    t.step.measures.slip_m,
                    t.step.observation.gripper_opening_m
                );
            }
            for ev in &t.step.events {
                println!("{:.2} {:?} {}", t.step.observation.time_s, t.action.phase, ev);
            }
        });
        println!(
            "{:?} {:?} {:?} {:?} {:?} {:x}",
            e.outcome, e.time_s, e.phase, e.measures, e.contact, e.trajectory_hash
        );
        return;
    }
    let design = samplers::Uniform.design(&space, n, Seed::campaign(7).stream("x")).unwrap();
    let start = std::time::Instant::now();
    let mut counts: BTreeMap<String, (usize, f64, f64)> = BTreeMap::new();
    let mut ticks = 0u64;
    for i in 0..n {
        let mut a = design.assignment(i).unwrap();
        if mode == "easy" {
            let mut s = Seed::campaign(9).episode(i as u64).stream("easy");
            a.set("friction", Value::Number(s.between(0.6, 1.2)));
            a.set("mass_kg", Value::Number(s.between(0.05, 0.5)));
            a.set("size_m", Value::Number(s.between(0.03, 0.06)));
            a.set("com_offset", Value::Number(s.between(0.0, 0.1)));
            a.set("ik_noise_rad", Value::Number(0.0));
            a.set("obstacles", Value::Integer(0));
        }
        let s = Scenario { index: i as u64, seed: Seed::campaign(7).episode(i as u64), requested: a };
        let t = std::time::Instant::now();
        let e = rollout(&mut sim, &mut policy, &s);
        ticks += u64::from(e.ticks);
        let w = counts
            .entry(format!("{} {:?}", e.outcome.word(), e.phase.filter(|_| !matches!(e.outcome, Outcome::Success))))
            .or_default();
        w.0 += 1;
        w.1 += e.time_s;
        w.2 += t.elapsed().as_secs_f64();
        if mode == "easy" && !matches!(e.outcome, Outcome::Success) {
            println!("{i} {:?} {:.2} {:?} {:?} {:?}", e.outcome, e.time_s, e.phase, e.measures, e.contact);
            for (k, v) in s.requested.iter() {
                print!(" {k}={v}");
            }
            println!();
        }
    }
    let el = start.elapsed().as_secs_f64();
    for (k, v) in &counts {
        println!("{k:40} {:5} mean {:.2} s sim, {:.1} ms", v.0, v.1 / v.0 as f64, 1e3 * v.2 / v.0 as f64);
    }
    println!(
        "{n} episodes in {el:.1} s: {:.1}/s; {:.1} ticks mean, {:.0} steps/s",
        n as f64 / el,
        ticks as f64 / n as f64,
        ticks as f64 * 0.05 / dt / el
    );
}
