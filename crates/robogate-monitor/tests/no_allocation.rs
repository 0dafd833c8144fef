//! Tests that a cycle allocates no memory, so that the detectors can run on a robot controller.
#![expect(unsafe_code, reason = "an allocator that counts must be one")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Arc;

use robogate_core::{Seed, SignalGroup, SignalKind, Signals};
use robogate_monitor::domain::{Domain, Predictor, PredictorColumn, Risk, RiskTerm, Validated};
use robogate_monitor::warn::{Features, Track, Warner, train};
use robogate_monitor::{Baseline, Count, Cycle, Monitor, ParameterValue, Settings};
use robogate_stats::flexible::Scorer;

struct Counting;

thread_local! {
    static CALLS: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: all calls go to the system's allocator unchanged; the counter is a thread-local number.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        CALLS.with(|calls| calls.set(calls.get() + 1));
        // SAFETY: the caller fulfils the contract.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller fulfils the contract.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A predictor with splines, a tree and a curve as calibration.
fn predictor() -> Option<Predictor> {
    let model = ["calibration 0.5 curve -3 -2 4 3", "spline 4", "line 0 0.4 0.2 -0.5", "start 3", "tree 0<0.45 =1 =-1"];
    let columns = vec![PredictorColumn { parameter: "mass_kg".to_owned(), category: None }];
    Scorer::parse(&model.map(str::to_owned), 1).ok().map(|model| Predictor::new(columns, model))
}

#[test]
fn cycles_without_alarm_allocate_nothing() {
    assert!(predictor().is_some());
    let baseline = Baseline {
        success: Some(Count { count: 900, of: 1_000 }),
        events: ["drop", "collision"].map(|event| (event.to_owned(), Count { count: 30, of: 1_000 })).into(),
        // All failures below are timeouts.
        failure_modes: Some([("timeout", 100)].into_iter().collect()),
        cycle_times_s: Some((0..1_000).map(|i| 3.5 + 0.001 * f64::from(i)).collect()),
    };
    let domain = Domain {
        envelope: [("mass_kg".to_owned(), Validated::Range([0.1, 0.8]))].into(),
        risk: Some(Risk {
            intercept: -6.0,
            terms: vec![RiskTerm { parameter: "mass_kg".to_owned(), coefficient: 6.0, log: false, penalties: None }],
            covariance: vec![0.1, 0.0, 0.0, 0.1],
            most_variance: 0.2,
            predictor: predictor(),
        }),
    };
    let mut monitor =
        Monitor::new(Settings { baseline, domain: Some(Arc::new(domain)), ..Settings::default() }).unwrap();
    let mut stream = Seed::campaign(1).stream("allocation");
    let mut cycle = Cycle {
        id: "a".to_owned(),
        robot: "r".to_owned(),
        recipe: "x".to_owned(),
        time_s: 0.0,
        success: true,
        failure_mode: Some("timeout".to_owned()),
        events: ["drop", "collision"].map(|event| (event.to_owned(), false)).into(),
        cycle_time_s: Some(4.0),
        parameters: [("mass_kg".to_owned(), ParameterValue::Number(0.3))].into(),
    };
    let mut other = "s".to_owned();
    let mut alarms = 0;
    let mut before = 0;
    for i in 0..20_000 {
        if i == 4 {
            // The first cycles created the recipe and its two robots.
            before = CALLS.with(Cell::get);
        }
        cycle.time_s += 4.0;
        cycle.success = stream.uniform() < 0.97;
        cycle.cycle_time_s = Some(stream.between(3.5, 4.5));
        std::mem::swap(&mut cycle.robot, &mut other);
        monitor.observe(&cycle, &mut |_| alarms += 1).unwrap();
    }
    assert_eq!((CALLS.with(Cell::get) - before, alarms), (0, 0));
}

/// A warning costs no memory in any control period, for trees and for a distance.
#[test]
fn control_periods_allocate_nothing() {
    let group = |name: &str, kind, length| SignalGroup { name: name.to_owned(), kind, length, unit: String::new() };
    let groups = vec![
        group("joint_positions", SignalKind::Observation, 7),
        group("joint_position", SignalKind::Command, 7),
        group("gripper", SignalKind::Gripper, 1),
    ];
    let signals = Signals { period_s: 0.05, groups, gripper_in_vector: None };
    let features = Features { signals, parameters: vec!["mass_kg".to_owned()] };
    let mut stream = Seed::campaign(1).stream("rows");
    let mut track = |index, fails: bool| Track {
        index,
        scenario: index,
        sampled: true,
        failure: fails.then(|| "lost".to_owned()),
        event_s: 3.0,
        times: (0..60).map(|i| 0.05 * i as f32).collect(),
        rows: (0..900).map(|_| stream.normal() as f32).collect(),
        parameters: vec![0.5],
        scenario_numbers: Vec::new(),
    };
    for failing in [2, u64::MAX] {
        let tracks: Vec<Track> = (0..60).map(|i| track(i, i % failing == 1)).collect();
        let detector = train(features.clone(), &tracks.iter().collect::<Vec<_>>(), 1).unwrap();
        let mut warner = Warner::new(&detector, 1e9);
        let before = CALLS.with(Cell::get);
        for track in &tracks {
            warner.start(&track.parameters);
            for (row, time_s) in track.rows.chunks_exact(15).zip(&track.times) {
                assert!(warner.observe(*time_s, row).is_some());
            }
        }
        assert_eq!(CALLS.with(Cell::get) - before, 0, "failing {failing}");
    }
}
