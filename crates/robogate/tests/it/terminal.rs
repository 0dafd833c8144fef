//! What a terminal shows while a verb works and at its end, at several widths. Skipped without tmux.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use tempfile::TempDir;

use crate::harness::{assert_done, robogate_in, stderr, stdout};

/// Widths of the terminal in columns.
const WIDTHS: [usize; 4] = [60, 80, 120, 200];
/// The longest wait for the end of a command.
const PATIENCE: Duration = Duration::from_secs(120);

/// A terminal of its own server, which ends with the test.
struct Terminal {
    server: String,
}

impl Drop for Terminal {
    fn drop(&mut self) {
        drop(self.tmux(&["kill-server"]));
    }
}

impl Terminal {
    /// Runs a line of arguments in `folder`, in a terminal of this width.
    fn start(folder: &Path, columns: usize, line: &str, name: &str) -> Self {
        let terminal = Self { server: format!("robogate-{}-{name}-{columns}", std::process::id()) };
        let command =
            format!("TERM=xterm-256color '{}' {line}; echo \"exit $?\"; sleep 600", env!("CARGO_BIN_EXE_robogate"));
        let (columns, folder) = (columns.to_string(), folder.display().to_string());
        let begun = ["-f", "/dev/null", "new-session", "-d", "-x", &columns, "-y", "60", "-c", &folder, &command];
        assert!(terminal.tmux(&begun).is_some(), "tmux does not start");
        terminal
    }

    fn tmux(&self, arguments: &[&str]) -> Option<String> {
        let output = Command::new("tmux").args(["-L", &self.server]).args(arguments).stdin(Stdio::null()).output();
        let output = output.unwrap();
        output.status.success().then(|| String::from_utf8(output.stdout).unwrap())
    }

    /// All lines so far. A line that the terminal broke is one line.
    fn lines(&self) -> Vec<String> {
        let text = self.tmux(&["capture-pane", "-p", "-J", "-S", "-"]).unwrap_or_default();
        text.lines().map(|line| line.trim_end().to_owned()).collect()
    }
}

/// Whether a screen shows a running stage: its bar with the time left.
fn is_live(lines: &[String]) -> bool {
    lines.iter().any(|line| line.ends_with(" left") && line.contains("/s"))
}

/// Runs a verb at each width. Checks that no line is wider than the terminal at any time, that the live view is gone at the end,
/// and that the last screen has each of `parts`. Returns how many screens showed the live view.
fn fits(folder: &Path, name: &str, line: impl Fn(usize) -> String, code: i32, parts: &[&str]) -> usize {
    let mut live = 0;
    for columns in WIDTHS {
        let terminal = Terminal::start(folder, columns, &line(columns), name);
        let begun = Instant::now();
        let last = loop {
            let lines = terminal.lines();
            for line in &lines {
                let wide = line.chars().count();
                // A path or a command is not broken, so that it can be copied.
                let whole = line.split_whitespace().any(|word| word.chars().count() + 4 > columns);
                assert!(wide <= columns || whole, "{name}, {columns} columns: {wide} in {line:?}");
            }
            if lines.iter().any(|line| line.starts_with("exit ")) {
                break lines;
            }
            live += usize::from(is_live(&lines));
            assert!(begun.elapsed() < PATIENCE, "{name}, {columns} columns: {lines:#?}");
            std::thread::sleep(Duration::from_millis(50));
        };
        assert!(last.contains(&format!("exit {code}")), "{name}, {columns} columns: {last:#?}");
        assert!(!is_live(&last), "{name}, {columns} columns: {last:#?}");
        let text = last.join("\n");
        for part in parts {
            assert!(text.contains(part), "{name}, {columns} columns, `{part}`: {text}");
        }
    }
    live
}

/// Writes trials of a real pendulum: parameters of its space, and outcomes.
fn trials(folder: &Path) {
    let rows: String = (0..40)
        .map(|i| {
            let unit = |step: u32| f64::from((i * step + 11) % 97) / 97.0;
            let (success, mass) = (unit(37) > 0.3, 0.2 + 0.1 * unit(29));
            format!("{success},{},{mass}\n", if success { "" } else { "timeout" })
        })
        .collect();
    std::fs::write(folder.join("trials.csv"), format!("success,failure_mode,mass_kg\n{rows}")).unwrap();
}

#[test]
fn live_views_fit_the_terminal() {
    let Some(_) = robogate_testing::program("tmux") else { return };
    let dir = TempDir::new().unwrap();
    let run = |columns| format!("run --task pendulum --design uniform -n 300 --seed 3 --threads 1 --out run-{columns}");
    let live = fits(dir.path(), "run", run, 0, &["uniform", "episodes in ", "success", "report"]);
    assert!(live > 0, "the run showed no progress");
    for k in 0..2 {
        let shard = format!("run --task pendulum --design uniform -n 300 --seed 3 --shard {k}/2 --out shards");
        assert_done(&robogate_in(dir.path(), &shard.split(' ').collect::<Vec<_>>()));
    }
    let merge = |columns| format!("merge shards --out merged-{columns}");
    fits(dir.path(), "merge", merge, 0, &["300 episodes in 2 shards", "success", "report"]);
    let gate = |columns| format!("gate --task pendulum --out gate-{columns}");
    let live = fits(dir.path(), "gate", gate, 1, &["FAIL", "success rate at least 92.0 %"]);
    assert!(live > 0, "the gate showed no progress");
    trials(dir.path());
    let transfer = |_| "transfer --sim run-60 --real trials.csv".to_owned();
    let live = fits(dir.path(), "transfer", transfer, 0, &["trials", "of the real robot", "fits in ", "Assumptions"]);
    assert!(live > 0, "the transfer showed no progress");
}

/// With --quiet, stderr is empty and stdout has the result.
#[test]
fn quiet_verbs_print_results_only() {
    let dir = TempDir::new().unwrap();
    for k in 0..2 {
        let shard = format!("run --task pendulum --design uniform -n 120 --seed 3 --shard {k}/2 --out shards");
        assert_done(&robogate_in(dir.path(), &shard.split(' ').collect::<Vec<_>>()));
    }
    trials(dir.path());
    for line in [
        "run --task pendulum -n 60 --seed 3 --out run --quiet",
        "merge shards --quiet",
        "gate --run run --quiet",
        "transfer --sim shards --real trials.csv --quiet",
    ] {
        let output = robogate_in(dir.path(), &line.split(' ').collect::<Vec<_>>());
        assert!([0, 1].contains(&output.status.code().unwrap()), "{line}: {}", stderr(&output));
        assert_eq!(stderr(&output), "", "{line}");
        assert!(stdout(&output).contains("success"), "{line}: {}", stdout(&output));
    }
}

/// A pseudo-terminal that is closed while a campaign draws on it: the campaign ends as after Ctrl-C, and can be resumed.
#[test]
fn lost_terminal_ends_a_campaign() {
    const CLOSE: &str = r#"
import os, pty, select, sys, time
child, terminal = pty.fork()
if child == 0:
    os.execv(sys.argv[1], sys.argv[1:])
begun, seen = time.monotonic(), b""
while b" left" not in seen:
    assert time.monotonic() - begun < 60, "no live view"
    if select.select([terminal], [], [], 0.1)[0]:
        seen += os.read(terminal, 65536)
os.close(terminal)
while time.monotonic() - begun < 120:
    ended, status = os.waitpid(child, os.WNOHANG)
    if ended:
        sys.exit(os.waitstatus_to_exitcode(status))
    time.sleep(0.02)
os.kill(child, 9)
sys.exit("the campaign hangs")
"#;
    let dir = TempDir::new().unwrap();
    let run = ["run", "--task", "stacking", "-n", "4000", "--design", "uniform", "--out", "r"];
    let program = env!("CARGO_BIN_EXE_robogate");
    let output =
        Command::new("python3").args(["-c", CLOSE, program]).args(run).current_dir(dir.path()).output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(dir.path().join("r/plan.json").is_file() && !dir.path().join("r/dictionary.parquet").exists());
    // No process locks the folder.
    let status = Command::new(program).args(["analyze", "r"]).current_dir(dir.path()).output().unwrap();
    assert!(!String::from_utf8_lossy(&status.stderr).contains("in use"));
}
