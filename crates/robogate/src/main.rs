//! The command line of `robogate`, with one file for each verb.

mod active_model;
mod answer;
mod arguments;
mod benchmark;
mod canvas;
mod commands;
mod compliance;
mod exit;
mod film;
mod hopeless;
#[cfg(feature = "mujoco")]
mod inspection;
mod interface;
mod number;
#[cfg(feature = "object-store")]
mod object_store;
mod picture;
mod place;
mod progress;
mod sharded;
mod source;
mod summary;
mod terminal;
mod transfer_view;
mod twins;
mod watch;

use std::panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind};
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use robogate_core::guard::{is_guarded, message};

use crate::exit::OrExit;

/// Deployment gate for robot manipulation policies.
///
/// Exit codes: 0 pass or done, 1 fail, 2 usage or configuration, 3 inconclusive, 4 invalid evidence or nothing
/// evaluated, 5 infrastructure or incomplete, 130 interrupted (resumable).
#[derive(Debug, Parser)]
#[command(version, max_term_width = 100)]
struct Arguments {
    /// Print results, warnings and errors only: no progress and no notes
    #[arg(long, short, global = true)]
    quiet: bool,
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Find where the policy fails: a campaign over the operating space, then where the outcome is uncertain
    Run(commands::run::Run),
    /// Resume an interrupted campaign
    Resume(commands::resume::Resume),
    /// Print the next shards of a campaign that several machines run, as commands
    Plan(commands::plan::Plan),
    /// Show which shards of a campaign are committed, and their outcomes so far
    Status(commands::status::Status),
    /// Merge the shards of a campaign to the files of a run on one machine
    Merge(commands::merge::Merge),
    /// Run policies x tasks x robots x engines as one resumable plan, and rank the policies on one page
    Matrix(commands::matrix::Matrix),
    /// Replay one episode bit for bit and print its timeline
    Replay(commands::replay::Replay),
    /// Render a scenario with the cameras of the cell
    Snapshot(commands::snapshot::Snapshot),
    /// Analyze a run or a dictionary: where the policy fails, effects of the parameters, confidence intervals
    Analyze(commands::analyze::Analyze),
    /// Compare robots, policies or simulators, and find where all of them fail
    Compare(commands::compare::Compare),
    /// Estimate the success rate of the real robot from a simulation and a few real trials
    Transfer(commands::transfer::TransferTo),
    /// Write a run or a dictionary as one page: HTML, Markdown or JSON
    Report(commands::report::Report),
    /// Explore the episodes of one or several runs in the browser, also while they run
    View(commands::view::View),
    /// Decide whether the policy may run: run a suite until the verdict is certain, or judge a finished run
    Gate(commands::gate::Gate),
    /// Estimate the share of a robot's units that meet the requirements, and find what distinguishes the others
    Fleet(commands::fleet::FleetOf),
    /// Write a run's figures to a file, as a baseline for other runs
    Baseline(commands::baseline::BaselineOf),
    /// Rank policies that ran the same scenarios
    Leaderboard(commands::leaderboard::Rank),
    /// Write a failure dictionary as CSV, JSON Lines or the published JSON
    Export(commands::export::Export),
    /// Import the results of another tool as a dictionary
    Import(commands::import::Import),
    /// Find rows that make a success rate wrong, in the results of any tool
    Audit(commands::audit::AuditOf),
    /// Compare boundary-focused and uniform sampling by experiment
    /// Record demonstrations of the scripted controller, with pictures, as a LeRobot dataset (v3.0)
    Demos(commands::demos::Demos),
    /// List, show and check suites: the scenarios on which a policy is judged
    Suites(commands::suites::Suites),
    /// List the profiles of policies, or check a policy server
    Policy(commands::policy::Policies),
    /// List the tasks, engines, robots, policies, spaces and suites of this build
    List(commands::list::List),
    /// List, install and inspect environments that run in Python: Meta-World, Fetch, or your own
    Env(commands::env::Environments),
    /// List the robots, or check one
    Robots(commands::robots::Robots),
    /// Write a folder with everything that a verdict depends on, so that others can check it
    Evidence(commands::evidence::Evidence),
    /// Verify a folder of evidence: files, signatures, and the verdict recomputed from the rows
    Verify(commands::verify::Verify),
    /// Create and identify the keys that sign evidence
    Keys(commands::keys::Keys),
    /// Monitor deployed robots for drift, with a guaranteed false-alarm rate
    Monitor(commands::monitor::Monitor),
    /// Serve a built-in environment over the bridge protocol
    Serve(commands::serve::Serve),
    /// Run the conformance tests against a simulator server
    Bridge(commands::bridge::Bridge),
    /// Check physics claims by experiment
    Check(commands::check::Check),
}

fn main() -> ExitCode {
    std::panic::set_hook(Box::new(panicked));
    commands::matrix::end_with_parent();
    let arguments = Arguments::parse();
    terminal::show_notices();
    if arguments.quiet {
        terminal::be_quiet();
    }
    // A panic has been reported by the hook.
    let Ok(result) = catch_unwind(AssertUnwindSafe(|| execute(arguments.verb))) else {
        return ExitCode::from(exit::INFRASTRUCTURE);
    };
    match result.and_then(written) {
        Ok(code) => ExitCode::from(code),
        Err(exit) => {
            terminal::error(&exit);
            ExitCode::from(exit.code)
        }
    }
}

/// The exit code of a verb, unless its output is lost, for example on a full disk: a script must not take it for complete.
fn written(code: u8) -> Result<u8, exit::Exit> {
    match terminal::stdout_error() {
        None => Ok(code),
        Some(why) => Err(anyhow::anyhow!("cannot write to stdout: {why}")).or_broken(),
    }
}

/// Reports a panic as an error. A panic in a library that reads foreign data is reported by its caller.
fn panicked(panic: &PanicHookInfo<'_>) {
    if is_guarded() {
        return;
    }
    let place = panic.location().map(|place| format!(" ({}:{})", place.file(), place.line())).unwrap_or_default();
    let why = message(panic.payload());
    let error = anyhow::anyhow!(
        "internal error: {why}{place}\nHint: this is a defect of robogate. Report the command and this message"
    );
    terminal::error(&exit::Exit { code: exit::INFRASTRUCTURE, error });
}

fn execute(verb: Verb) -> Result<u8, exit::Exit> {
    match verb {
        Verb::Run(run) => run.execute(),
        Verb::Resume(resume) => resume.execute(),
        Verb::Plan(plan) => plan.execute(),
        Verb::Status(status) => status.execute(),
        Verb::Merge(merge) => merge.execute(),
        Verb::Matrix(matrix) => matrix.execute(),
        Verb::Replay(replay) => replay.execute(),
        Verb::Snapshot(snapshot) => snapshot.execute(),
        Verb::Analyze(analyze) => analyze.execute(),
        Verb::Compare(compare) => compare.execute(),
        Verb::Transfer(transfer) => transfer.execute(),
        Verb::Report(report) => report.execute(),
        Verb::View(view) => view.execute(),
        Verb::Gate(gate) => gate.execute(),
        Verb::Fleet(fleet) => fleet.execute(),
        Verb::Baseline(baseline) => baseline.execute(),
        Verb::Leaderboard(leaderboard) => leaderboard.execute(),
        Verb::Export(export) => export.execute(),
        Verb::Import(import) => import.execute(),
        Verb::Audit(audit) => audit.execute(),
        Verb::Demos(demos) => demos.execute(),
        Verb::Suites(suites) => suites.execute(),
        Verb::Policy(policy) => policy.execute(),
        Verb::List(list) => list.execute(),
        Verb::Env(environments) => environments.execute(),
        Verb::Robots(robots) => robots.execute(),
        Verb::Evidence(evidence) => evidence.execute(),
        Verb::Verify(verify) => verify.execute(),
        Verb::Keys(keys) => keys.execute(),
        Verb::Monitor(monitor) => monitor.execute(),
        Verb::Serve(serve) => serve.execute(),
        Verb::Bridge(bridge) => bridge.execute(),
        Verb::Check(check) => check.execute(),
    }
}
