//! Benchmarks a million episodes from the file to the page: `cargo bench -p robogate-report [-- ROWS [FILE]]`.
//!
//! Writes a synthetic dictionary of the paper's eight parameters (kept if FILE is given), then measures analysis and
//! page, and the peak memory of the process. Exits with code 1 if a million rows take more than 10 s or 1 GB.

#![expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
#![expect(clippy::print_stdout, reason = "a benchmark prints what it measured")]
#![expect(clippy::unwrap_used, reason = "a benchmark that cannot run should stop")]

use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Instant;

use robogate_analysis::{Analysis, Source};
use robogate_core::{Assignment, Episode, FailureMode, Outcome, ParameterSpace, Scenario, Seed, Word};
use robogate_dictionary::{DictionaryWriter, Engine, Entry, Label, Provenance, Robot, SCHEMA_VERSION, Tool};
use robogate_report::html;

const SPACE: &str = include_str!("../../../assets/spaces/franka.toml");

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with("--")).collect();
    let rows: u64 = words.first().map_or(1_000_000, |word| word.parse().unwrap());
    let scratch = tempfile::tempdir().unwrap();
    let path =
        words.get(1).map_or_else(|| scratch.path().join("dictionary.parquet"), |file| Path::new(file).to_owned());
    let begun = Instant::now();
    if !path.exists() {
        write(&path, rows);
    }
    println!("write      {:>8.2} s  {rows} rows", begun.elapsed().as_secs_f64());
    // The memory for writing must not count for the analysis.
    let before = peak_mb();
    let begun = Instant::now();
    let source = Source::open(&path).unwrap();
    let analysis = Analysis::of(&source, &path, &[]).unwrap();
    let analysed = begun.elapsed().as_secs_f64();
    let page = html(&analysis);
    let all = begun.elapsed().as_secs_f64();
    let peak = peak_mb();
    println!("analyse    {analysed:>8.2} s");
    println!("page       {:>8.2} s  {} KB", all - analysed, page.len() / 1024);
    println!("together   {all:>8.2} s");
    println!("peak       {peak:>8.0} MB (before: {before:.0})");
    let within = all < 10.0 && peak < 1000.0 && page.len() < 400 * 1024;
    if within || rows < 1_000_000 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Peak memory of the process in megabytes. 0 if the system does not report it.
fn peak_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM:"));
    line.and_then(|line| line.split_whitespace().nth(1)?.parse::<f64>().ok()).map_or(0.0, |kb| kb / 1024.0)
}

fn unit(i: u64, salt: u64) -> f64 {
    let mut x = i.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ salt.wrapping_mul(0xBF58_476D_1CE4_E5B9);
    for by in [0xBF58_476D_1CE4_E5B9, 0x94D0_49BB_1331_11EB] {
        x ^= x >> 29;
        x = x.wrapping_mul(by);
    }
    x ^= x >> 31;
    (x >> 11) as f64 / (1_u64 << 53) as f64
}

fn write(path: &Path, rows: u64) {
    let space = ParameterSpace::from_toml(SPACE).unwrap();
    let provenance = Provenance {
        tool: Tool::robogate(),
        schema_version: SCHEMA_VERSION,
        build: None,
        engine: Engine { name: "none".to_owned(), version: None, build_sha256: None },
        task: Arc::new(robogate_dictionary::v1::task()),
        robot: Robot { name: "franka".to_owned(), sha256: None, dimensions: None },
        policy: "made up".to_owned(),
        world: None,
        space: space.clone(),
        plan: serde_json::Value::Null,
        seed: 1,
        question_sha256: None,
        platform: None,
        source: None,
    };
    let mut writer = DictionaryWriter::create(path, &provenance).unwrap();
    let modes = ["grasp_miss", "grip_loss", "collision", "timeout"].map(FailureMode::constant);
    for i in 0..rows {
        let parameters = space.parameters().iter().enumerate();
        let requested: Assignment = parameters
            .map(|(p, of)| (Arc::clone(&of.name), of.domain.decode(of.domain.from_unit(unit(i, p as u64 + 1)))))
            .collect();
        let (friction, mass) = (requested.number("friction").unwrap(), requested.number("mass_kg").unwrap());
        let noise = requested.number("ik_noise_rad").unwrap();
        let p = 1.0 / (1.0 + (1.469 - 3.691 * friction + 0.419 * mass + 1.4 * friction * mass + 30.0 * noise).exp());
        let outcome = if unit(i, 99) < p {
            Outcome::Success
        } else {
            let at = (4.0 * unit(i, 98)).min(3.0) as usize;
            Outcome::Failure(modes[if friction < 0.3 { at.max(1) } else { at }])
        };
        let measures = [(Word::constant("peak_contact_force_n"), Some(100.0 * unit(i, 97)))].into_iter().collect();
        writer
            .push(&Entry {
                stage: "uniform".to_owned(),
                design: "uniform".to_owned(),
                weight: 1.0,
                label: Label::default(),
                episode: Episode {
                    scenario: Scenario { index: i, seed: Seed::campaign(1).episode(i), requested: requested.clone() },
                    applied: requested,
                    outcome,
                    time_s: 5.0 * unit(i, 96),
                    phase: None,
                    contact: None,
                    measures,
                    draws: Default::default(),
                    ticks: 100,
                    trajectory_hash: i,
                },
            })
            .unwrap();
    }
    writer.finish().unwrap();
}
