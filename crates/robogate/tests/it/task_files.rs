//! Tasks from files: the guide, what a record contains, and what is refused.

use std::fs;
use std::path::Path;

use tempfile::TempDir;

use crate::harness::{assert_exit_in, robogate_in, text, verb};

fn shipped(task: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/tasks").join(task);
    folder.canonicalize().unwrap().to_str().unwrap().to_owned()
}

/// The commands of docs/guides/task-files.md, from an empty folder to a verdict.
#[test]
fn guide_leads_to_verdict() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/guides/task-files.md");
    let page = fs::read_to_string(page).unwrap();
    let commands = page.split("```sh\n").nth(1).unwrap().split("```").next().unwrap();
    let dir = TempDir::new().unwrap();
    let mut printed = Vec::new();
    for command in commands.lines() {
        let (command, comment) = command.split_once(" # ").unwrap_or((command, ""));
        let code = comment.strip_prefix("exit code ").map_or(0, |code| code[..1].parse().unwrap());
        let line = command.trim().strip_prefix("robogate ").unwrap();
        printed.push(verb(dir.path(), line, code, &[]));
    }
    assert!(printed[1].contains("expert: 1 of 1 nominal episodes succeed"), "{}", printed[1]);
    assert!(fs::read_to_string(dir.path().join("first.html")).unwrap().contains("open_drawer"));
    verb(dir.path(), "tasks init my_drawer", 2, &["task.toml exists", "Hint: name another folder"]);
}

/// A sash of 1 kg on a slide with more dry friction than its weight stays where it is, without and with less it falls.
#[test]
fn dry_friction_holds_a_joint() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    fs::create_dir(at.join("sash")).unwrap();
    let write = |range: &str| {
        let text = format!(
            r#"format = "robogate-task/1"
name = "sash"
version = 1
summary = "A sash on a slide"
instruction = "wait"
time_limit = "8 s"
[[fixture]]
name = "post"
at = "55, -20, 0 cm"
shapes = [ {{ box = "6, 6, 12 cm", at = "0, 0, 6 cm" }} ]
[[part]]
name = "sash"
in = "post"
at = "0, 0, 30 cm"
mass = "1 kg"
shapes = [ {{ box = "20, 3, 2 cm", at = "-10, 0, 0 cm" }} ]
[part.joint]
kind = "slide"
axis = "-z"
range = "0, 10 cm"
friction = "12 N"
[[parameter]]
name = "stick_n"
sets = "sash.joint.friction"
range = "{range}"
nominal = "12 N"
meaning = "dry friction of the slide"
[success]
when = "joint(sash) > 5 mm for 0.1 s"
[expert]
do = ["wait(7 s)"]
"#
        );
        fs::write(
            at.join("sash/task.toml"),
            text.replace("nominal = \"12 N\"\n", if range.starts_with('1') { "" } else { "nominal = \"4 N\"\n" }),
        )
        .unwrap();
    };
    write("12, 60 N");
    verb(at, "run --task sash -n 6 --design uniform --seed 2 --out holds", 0, &["success  0.0 %", "0 of 6"]);
    write("0, 6 N");
    verb(at, "run --task sash -n 6 --design uniform --seed 2 --out falls", 0, &["success 100.0 %", "6 of 6"]);
}

/// The record of a run contains its task: replay, evidence and rerun need no folder.
#[test]
fn record_contains_task() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    fs::create_dir(at.join("cell")).unwrap();
    let text = fs::read_to_string(Path::new(&shipped("button")).join("task.toml")).unwrap();
    fs::write(at.join("cell/task.toml"), &text).unwrap();
    verb(at, "run --task cell --nominal -n 6 --threads 1 --out one", 0, &[]);
    verb(at, "run --task cell --nominal -n 6 --threads 2 --out two", 0, &[]);
    assert_eq!(
        fs::read(at.join("one/dictionary.parquet")).unwrap(),
        fs::read(at.join("two/dictionary.parquet")).unwrap()
    );
    fs::remove_dir_all(at.join("cell")).unwrap();
    verb(at, "replay one 3", 0, &["gripper closes"]);
    verb(at, "evidence one evidence --requirements default", 3, &[]);
    verb(at, "verify evidence --rerun 2", 0, &["with the same outcome, measures and trajectory"]);
}

/// The same for a task with meshes: evidence has them, and the page of episodes draws them.
#[test]
fn record_contains_meshes() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    let cell = at.join("cell");
    fs::create_dir_all(cell.join("meshes")).unwrap();
    for file in ["task.toml", "meshes/clamp.obj", "meshes/saddle.obj"] {
        fs::copy(Path::new(&shipped("pipe_clamp")).join(file), cell.join(file)).unwrap();
    }
    verb(
        at,
        "tasks check cell",
        0,
        &["mesh meshes/clamp.obj: 104 triangles", "convex pieces in contacts", "% of its volume"],
    );
    verb(at, "run --task cell -n 4 --threads 1 --out one", 0, &[]);
    verb(at, "report one --out one.html", 0, &[]);
    fs::remove_dir_all(&cell).unwrap();
    verb(at, "replay one 2", 0, &["gripper closes"]);
    verb(at, "evidence one evidence --requirements default", 3, &[]);
    verb(at, "verify evidence --rerun 1", 0, &["with the same outcome, measures and trajectory"]);
    let plan = fs::read_to_string(at.join("one/plan.json")).unwrap();
    assert!(plan.contains("\"meshes/clamp.obj\""), "{plan}");
    // A changed mesh in the record is another one.
    let changed = plan.replacen("IyBBIH", "IyBCIH", 1);
    assert_ne!(plan, changed);
    fs::write(at.join("one/plan.json"), changed).unwrap();
    assert_ne!(robogate_in(at, &["verify", "one"]).status.code(), Some(0));
}

#[test]
fn unreadable_meshes_are_usage_errors() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    let cell = at.join("cell");
    fs::create_dir_all(cell.join("meshes")).unwrap();
    let from = shipped("pipe_clamp");
    fs::copy(Path::new(&from).join("task.toml"), cell.join("task.toml")).unwrap();
    fs::copy(Path::new(&from).join("meshes/saddle.obj"), cell.join("meshes/saddle.obj")).unwrap();
    let check =
        |expected: &str| assert_exit_in(at, &["tasks", "check", "cell"], 2, &["cell/task.toml", "line 24", expected]);
    check("meshes/clamp.obj: there is no such file in the folder of the task");
    fs::write(cell.join("meshes/clamp.obj"), "version https://git-lfs.github.com/spec/v1\noid sha256:0\n").unwrap();
    check("Fetch the file with `git lfs pull`");
    #[cfg(unix)]
    {
        fs::remove_file(cell.join("meshes/clamp.obj")).unwrap();
        std::os::unix::fs::symlink(Path::new(&from).join("meshes/clamp.obj"), cell.join("meshes/clamp.obj")).unwrap();
        check("it is a link to a file outside of the folder of the task");
    }
}

#[test]
fn broken_tasks_are_usage_errors() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    fs::create_dir(at.join("cell")).unwrap();
    let text = fs::read_to_string(Path::new(&shipped("drawer")).join("task.toml")).unwrap();
    for (from, to, expected) in [
        (
            "joint(drawer) > {opening_m} and",
            "jiont(drawer) > {opening_m} and",
            "unknown word `jiont`: did you mean `joint`?",
        ),
        (
            "(joint(drawer) > {opening_m} and speed(drawer) < 2 cm/s) for 0.3 s",
            "joint(drawer) < 5 cm",
            "a policy that does nothing succeeds",
        ),
        (
            "when = \"speed(drawer) > 60 cm/s\"",
            "when = \"time() > 0.1 s\"",
            "a policy that does nothing ends with `flung_open`",
        ),
        ("pull(drawer, {opening_m} + 4 cm", "pull(drawer, {opening_m} - 6 cm", "the expert fails at nominal: timeout"),
        ("range = \"8, 18 cm\"", "range = \"8, 28 cm\"", "joint(drawer) is compared with 0.28"),
    ] {
        assert!(text.contains(from), "{from}");
        fs::write(at.join("cell/task.toml"), text.replacen(from, to, 1)).unwrap();
        assert_exit_in(at, &["tasks", "check", "cell"], 2, &["cell/task.toml", expected]);
    }
    assert_exit_in(at, &["run", "--task", "./none", "-n", "1"], 2, &["--task ./none: no such folder"]);
    fs::remove_file(at.join("cell/task.toml")).unwrap();
    assert_exit_in(
        at,
        &["run", "--task", "cell", "-n", "1"],
        2,
        &["cannot read cell/task.toml", "robogate tasks init cell"],
    );
}

/// A task without an expert runs with a policy, and says so without one.
#[test]
fn expert_is_optional() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    fs::create_dir(at.join("cell")).unwrap();
    let full = fs::read_to_string(Path::new(&shipped("button")).join("task.toml")).unwrap();
    fs::write(at.join("cell/task.toml"), full.split("[expert]").next().unwrap()).unwrap();
    let checked = robogate_in(at, &["tasks", "check", "cell"]);
    assert!(text(&checked).contains("whether the task can be solved is not checked"), "{}", text(&checked));
    assert_exit_in(at, &["run", "--task", "cell", "-n", "1"], 2, &["has no expert", "--policy"]);
}
