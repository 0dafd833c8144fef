//! The command: one file per verb.

mod answer;
mod commands;
mod exit;
mod far;
mod guest;
#[cfg(feature = "mujoco")]
mod inspection;
mod picture;
mod progress;
mod renderer;
mod summary;
mod terminal;
mod world;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// The gate between a trained manipulation policy and a real robot cell.
///
/// Exit codes: 0 pass or done, 1 fail, 2 usage or configuration, 3 inconclusive, 4 invalid evidence or nothing
/// evaluated, 5 infrastructure or incomplete, 130 interrupted (resumable).
#[derive(Debug, Parser)]
#[command(version, max_term_width = 100)]
struct Arguments {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Find where the policy fails: a campaign over the operating space, then near the failure boundary
    Run(commands::run::Run),
    /// Go on with an interrupted campaign
    Resume(commands::resume::Resume),
    /// Run one episode of a campaign again, bit for bit, and tell its story
    Replay(commands::replay::Replay),
    /// Take pictures of a scenario with the cell's cameras
    Snapshot(commands::snapshot::Snapshot),
    /// Analyze a run or a dictionary: where the policy fails, effects of the parameters, confidence intervals
    Analyze(commands::analyze::Analyze),
    /// Compare robots, policies or simulators, and find where all of them fail
    Compare(commands::compare::Compare),
    /// Write a run or a dictionary as one page: HTML, Markdown or JSON
    Report(commands::report::Report),
    /// Answer: may this policy run? Run a suite until that is certain, or judge what was run
    Gate(commands::gate::Gate),
    /// Keep a run's figures, for others to be held against
    Baseline(commands::baseline::BaselineOf),
    /// Rank policies that ran the same scenarios
    Leaderboard(commands::leaderboard::Rank),
    /// Write a failure dictionary as CSV, JSON Lines or the published JSON
    Export(commands::export::Export),
    /// Read what another tool measured into Parquet
    Import(commands::import::Import),
    /// Ask by experiment whether boundary focusing is worth it
    Study(commands::study::Study),
    /// Record demonstrations of the scripted controller, with pictures, as a LeRobot dataset (v3.0)
    Demos(commands::demos::Demos),
    /// List, show and check suites: the scenarios on which a policy is judged
    Suites(commands::suites::Suites),
    /// List the profiles of policy servers, or probe a server
    Policy(commands::policy::Policies),
    /// List the robots, or say what is wrong with one
    Robots(commands::robots::Robots),
    /// Judge a run and put all that the verdict depends on into a folder that someone else can check
    Evidence(commands::evidence::Evidence),
    /// Check a folder of evidence: every file, the signatures, and the verdict anew from the rows
    Verify(commands::verify::Verify),
    /// Make and name the keys that sign evidence
    Keys(commands::keys::Keys),
    /// Watch a deployed robot: drift of its cycles, with alarms whose false-alarm rate is promised
    Monitor(commands::monitor::Monitor),
    /// Put the cell behind a socket, for a policy or a script of your own
    Serve(commands::serve::Serve),
    /// Hold simulators behind a socket to the bridge protocol
    Bridge(commands::bridge::Bridge),
    /// Check claims by experiment
    Check(commands::check::Check),
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let result = match arguments.verb {
        Verb::Run(run) => run.execute(),
        Verb::Resume(resume) => resume.execute(),
        Verb::Replay(replay) => replay.execute(),
        Verb::Snapshot(snapshot) => snapshot.execute(),
        Verb::Analyze(analyze) => analyze.execute(),
        Verb::Compare(compare) => compare.execute(),
        Verb::Report(report) => report.execute(),
        Verb::Gate(gate) => gate.execute(),
        Verb::Baseline(baseline) => baseline.execute(),
        Verb::Leaderboard(leaderboard) => leaderboard.execute(),
        Verb::Export(export) => export.execute(),
        Verb::Import(import) => import.execute(),
        Verb::Study(study) => study.execute(),
        Verb::Demos(demos) => demos.execute(),
        Verb::Suites(suites) => suites.execute(),
        Verb::Policy(policy) => policy.execute(),
        Verb::Robots(robots) => robots.execute(),
        Verb::Evidence(evidence) => evidence.execute(),
        Verb::Verify(verify) => verify.execute(),
        Verb::Keys(keys) => keys.execute(),
        Verb::Monitor(monitor) => monitor.execute(),
        Verb::Serve(serve) => serve.execute(),
        Verb::Bridge(bridge) => bridge.execute(),
        Verb::Check(check) => check.execute(),
    };
    match result {
        Ok(code) => ExitCode::from(code),
        Err(exit) => {
            terminal::error(&exit);
            ExitCode::from(exit.code)
        }
    }
}
