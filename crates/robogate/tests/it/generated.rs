//! Tests that the generated files are up to date: the JSON Schemas, the command reference and the bridges' list of
//! parameters. `ROBOGATE_GENERATE=1 cargo test -p robogate --features full --test it generated` writes them.

use std::fs;
use std::path::Path;
use std::process::Command;

use schemars::schema_for;

fn check(file: &str, content: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(file);
    if std::env::var_os("ROBOGATE_GENERATE").is_some() {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, content).unwrap();
    }
    let there = fs::read_to_string(&path).unwrap_or_default();
    assert!(
        there == content,
        "{file} is stale: run ROBOGATE_GENERATE=1 cargo test -p robogate --features full --test it generated and commit it"
    );
}

#[test]
fn schemas_are_up_to_date() {
    for (name, schema) in [
        ("parameter-space", schema_for!(robogate_core::ParameterSpace)),
        ("suite", schema_for!(robogate_core::Suite)),
        ("task", schema_for!(robogate_core::TaskSpec)),
        ("task-file", schema_for!(robogate_tasks::file::Document)),
        ("plan", schema_for!(robogate_campaign::Plan)),
        ("robot", schema_for!(robogate_physics::RobotSettings)),
        ("run-settings", schema_for!(robogate_campaign::Settings)),
        ("summary", schema_for!(robogate_campaign::Summary)),
        ("boundary", schema_for!(robogate_campaign::BoundaryReport)),
        ("shard-status", schema_for!(robogate_campaign::shards::ShardStatus)),
        ("event", schema_for!(robogate_campaign::Event)),
        ("cycle", schema_for!(robogate_monitor::Cycle)),
        ("alarm", schema_for!(robogate_monitor::Alarm)),
        ("monitor-reference", schema_for!(robogate_monitor::Reference)),
        ("monitor-settings", schema_for!(robogate_monitor::service::ServiceSettings)),
        ("monitor-topics", schema_for!(robogate_monitor::service::TopicMap)),
        ("requirements", schema_for!(robogate_gate::Requirements)),
        ("baseline", schema_for!(robogate_gate::Baseline)),
        ("force-limits", schema_for!(robogate_gate::ForceLimits)),
        ("gate-question", schema_for!(robogate_gate::Asked)),
        ("gate-plan", schema_for!(robogate_gate::GatePlan)),
        ("evaluation", schema_for!(robogate_gate::Evaluation)),
        ("leaderboard", schema_for!(robogate_gate::Leaderboard)),
        ("fleet", schema_for!(robogate_gate::Fleet)),
        ("ranking", schema_for!(robogate_gate::Ranking)),
    ] {
        let text = serde_json::to_string_pretty(&schema).unwrap() + "\n";
        check(&format!("schemas/{name}.schema.json"), &text);
    }
}

#[test]
fn command_reference_is_up_to_date() {
    let help = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_robogate"))
            .args(arguments)
            .arg("--help")
            .env("COLUMNS", "100")
            .output()
            .unwrap();
        assert!(output.status.success());
        String::from_utf8(output.stdout)
            .unwrap()
            .lines()
            .map(|line| format!("{}\n", line.trim_end()))
            .collect::<String>()
    };
    let overview = help(&[]);
    let mut page = format!("# The command\n\nGenerated from `robogate --help`.\n\n```\n{overview}```\n");
    for verb in verbs(&overview) {
        let text = help(&[&verb]);
        page += &format!("\n## robogate {verb}\n\n```\n{text}```\n");
        for under in verbs(&text) {
            page += &format!("\n### robogate {verb} {under}\n\n```\n{}```\n", help(&[&verb, &under]));
        }
    }
    check("docs/reference/command.md", &page);
}

/// The verbs that a help text lists: under `Commands:`, or under their purposes.
fn verbs(help: &str) -> Vec<String> {
    let in_help = |line: &str| line.starts_with("  ") && !line.starts_with("   ");
    let is_heading = |line: &str| !line.is_empty() && !line.starts_with(' ');
    let mut listing = false;
    let mut verbs = Vec::new();
    for line in help.lines().take_while(|line| !line.starts_with("Options:") && !line.starts_with("Arguments:")) {
        if is_heading(line) {
            // A purpose has no full stop and is no usage line.
            listing = line == "Commands:" || !line.contains(['.', ':', '`']);
        } else if listing && in_help(line) {
            verbs.extend(line.split_whitespace().next().filter(|verb| *verb != "help").map(str::to_owned));
        }
    }
    verbs
}
