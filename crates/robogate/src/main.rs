//! The command line of `robogate`, with one file for each verb.

mod active_model;
mod answer;
mod arguments;
mod benchmark;
mod canvas;
mod changes;
mod commands;
mod compliance;
mod exit;
mod film;
mod force_limits;
mod given;
mod grouped;
mod help;
#[cfg(feature = "mujoco")]
mod inspection;
mod interface;
mod number;
mod picture;
mod place;
mod progress;
mod project;
mod summary;
mod terminal;
mod transfer_view;
mod twins;
mod watch;

use std::panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind};
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use robogate_core::guard::{is_guarded, message};
use robogate_session::Entered;

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
    /// Print the details of a result too: stages, tables by parameter, how it was judged, all groups of scenarios
    #[arg(long, short, global = true)]
    verbose: bool,
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Start with what you have: an environment, a policy, a robot, results or evidence; draft the files that are missing
    Init(commands::init::Init),
    /// Find where the policy fails: a campaign over the operating space, then where the outcome is uncertain
    Run(commands::run::Run),
    /// Decide whether the policy may run: run a suite until the verdict is certain, or judge a finished run
    Gate(commands::gate::Gate),
    /// Resume an interrupted campaign
    Resume(commands::resume::Resume),
    /// Compare robots, policies or simulators, and find where all of them fail
    Compare(commands::compare::Compare),
    /// Find the best of several policies: all run the same scenarios, and worse ones leave after each round
    Rank(commands::rank::Rank),
    /// Estimate the probability of a rare event, down to 1e-6, from a graded margin
    Rare(commands::rare::RareEvent),
    /// Rank policies that ran the same scenarios
    Leaderboard(commands::leaderboard::Rank),
    /// Run policies x tasks x robots x engines as one resumable plan, and rank the policies on one page
    Matrix(commands::matrix::Matrix),
    /// Estimate the share of a robot's units that meet the requirements, and find what distinguishes the others
    Fleet(commands::fleet::FleetOf),
    /// List the runs below a folder: when, what, verdict, success rate and size
    Runs(commands::runs::Runs),
    /// Analyze a run or a dictionary: where the policy fails, effects of the parameters, confidence intervals
    Analyze(commands::analyze::Analyze),
    /// Write a run or a dictionary as one page: HTML, Markdown or JSON
    Report(commands::report::Report),
    /// Write a figure of the page of a run as SVG, and its data as CSV
    Figure(commands::figure::FigureOf),
    /// Explore the episodes of one or several runs in the browser, also while they run
    View(commands::view::View),
    /// Replay one episode bit for bit and print its timeline, or render moments of an episode or a scenario
    Replay(commands::replay::Replay),
    /// Import the results of another tool as a dictionary
    Import(commands::import::Import),
    /// Write a failure dictionary as CSV, JSON Lines or the published JSON
    Export(commands::export::Export),
    /// Find rows that make a success rate wrong, in the results of any tool
    Audit(commands::audit::AuditOf),
    /// Install and inspect environments that run in Python: Meta-World, Fetch, or your own
    Env(commands::env::Environments),
    /// Check a policy server or a network against a profile and an environment
    Policy(commands::policy::Policies),
    /// Check a robot, or draft one of your own from its model
    Robots(commands::robots::Robots),
    /// Check a task of your own from a file, or start one from an example
    Tasks(commands::tasks::Tasks),
    /// Check the physics of the cell, a simulator server, or the file of a suite
    Check(commands::check::Check),
    /// Serve a built-in environment over the bridge protocol
    Serve(commands::serve::Serve),
    /// Record demonstrations of the scripted controller, with pictures, as a LeRobot dataset (v3.0)
    Demos(commands::demos::Demos),
    /// List what this build contains: tasks, settings, engines, robots, policies, profiles, environments, spaces, suites
    List(commands::list::List),
    /// Show the settings of the project file `robogate.toml`, and where each value comes from
    Config(commands::config::Config),
    /// Write the completions of a shell, or man pages
    Completions(commands::completions::Completions),
    /// Write a folder with everything that a verdict depends on, so that others can check it
    Evidence(commands::evidence::Evidence),
    /// Verify a folder of evidence: files, signatures, and the verdict recomputed from the rows
    Verify(commands::verify::Verify),
    /// Create and identify the keys that sign evidence
    Keys(commands::keys::Keys),
    /// Show the progress of a campaign that several machines run, or print its next shards as commands
    Plan(commands::plan::Plan),
    /// Merge the shards of a campaign to the files of a run on one machine
    Merge(commands::merge::Merge),
    /// Estimate the success rate of the real robot from a simulation and a few real trials
    Transfer(commands::transfer::TransferTo),
    /// Plan, run and judge trials of the real robot: randomised, blinded, with as few trials as possible
    Trial(commands::trial::Trial),
    /// Check that a deployed policy is the one that was judged
    Admit(commands::admit::Admit),
    /// Find out what an upgrade changes: another version of a package, a policy, a robot or an engine
    Requalify(commands::requalify::Requalify),
    /// Monitor deployed robots for drift, with a guaranteed false-alarm rate
    Monitor(commands::monitor::Monitor),
    /// Train and check a detector that warns within an episode, before it fails
    Warn(commands::warn::Warn),
}

fn main() -> ExitCode {
    std::panic::set_hook(Box::new(panicked));
    let arguments = match robogate_session::enter(std::env::args_os().collect()) {
        Entered::Command(arguments) => arguments,
        Entered::Done(code) => return code,
    };
    commands::matrix::end_with_parent();
    let mut command = grouped::by_purpose(Arguments::command());
    command.build();
    let (line, settings) = match project::completed(&command, arguments).or_usage() {
        Ok(completed) => completed,
        Err(exit) => {
            terminal::error(&exit);
            return ExitCode::from(exit.code);
        }
    };
    let matches = match command.try_get_matches_from_mut(line.clone()) {
        Ok(matches) => matches,
        Err(why) => match help::asked(&command, &line).filter(|_| why.kind() == ErrorKind::DisplayHelp) {
            Some((verb, long)) => {
                help::show(verb, long);
                return ExitCode::SUCCESS;
            }
            None => {
                // The cause can be a line of the project file, which the command line does not show.
                for setting in settings.iter().filter(|setting| project::is_about(&why, setting)) {
                    terminal::warning(format_args!(
                        "{}: `{}` ({}) has this value",
                        project::FILE,
                        setting.option,
                        setting.place
                    ));
                }
                why.exit()
            }
        },
    };
    let arguments = Arguments::from_arg_matches(&matches).unwrap_or_else(|why| why.exit());
    terminal::show_notices();
    if arguments.quiet {
        terminal::be_quiet();
    }
    if arguments.verbose {
        terminal::be_verbose();
    }
    if !settings.is_empty() {
        let arguments: Vec<String> = settings.iter().flat_map(project::Setting::arguments).collect();
        terminal::note(format_args!("{}: {}", project::FILE, arguments.join(" ")));
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
        Verb::Init(verb) => verb.execute(),
        Verb::Run(verb) => verb.execute(),
        Verb::Gate(verb) => verb.execute(),
        Verb::Resume(verb) => verb.execute(),
        Verb::Compare(verb) => verb.execute(),
        Verb::Rank(verb) => verb.execute(),
        Verb::Rare(verb) => verb.execute(),
        Verb::Leaderboard(verb) => verb.execute(),
        Verb::Matrix(verb) => verb.execute(),
        Verb::Fleet(verb) => verb.execute(),
        Verb::Runs(verb) => verb.execute(),
        Verb::Analyze(verb) => verb.execute(),
        Verb::Report(verb) => verb.execute(),
        Verb::Figure(verb) => verb.execute(),
        Verb::View(verb) => verb.execute(),
        Verb::Replay(verb) => verb.execute(),
        Verb::Import(verb) => verb.execute(),
        Verb::Export(verb) => verb.execute(),
        Verb::Audit(verb) => verb.execute(),
        Verb::Env(verb) => verb.execute(),
        Verb::Policy(verb) => verb.execute(),
        Verb::Robots(verb) => verb.execute(),
        Verb::Tasks(verb) => verb.execute(),
        Verb::Check(verb) => verb.execute(),
        Verb::Serve(verb) => verb.execute(),
        Verb::Demos(verb) => verb.execute(),
        Verb::List(verb) => verb.execute(),
        Verb::Config(verb) => verb.execute(),
        Verb::Completions(verb) => verb.execute(),
        Verb::Evidence(verb) => verb.execute(),
        Verb::Verify(verb) => verb.execute(),
        Verb::Keys(verb) => verb.execute(),
        Verb::Plan(verb) => verb.execute(),
        Verb::Merge(verb) => verb.execute(),
        Verb::Transfer(verb) => verb.execute(),
        Verb::Trial(verb) => verb.execute(),
        Verb::Admit(verb) => verb.execute(),
        Verb::Requalify(verb) => verb.execute(),
        Verb::Monitor(verb) => verb.execute(),
        Verb::Warn(verb) => verb.execute(),
    }
}
