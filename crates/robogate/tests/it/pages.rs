//! Pages in a real browser: every control works, nothing is requested, and no error is reported. Skipped without Chromium.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::json;
use tempfile::TempDir;

use crate::browser::Browser;
use crate::harness::robogate_in;

/// The budget of a page with twelve episodes, in bytes.
const PAGE_BUDGET: u64 = 2_500_000;

/// The largest height of a page before a section is opened, in pixels.
const MOST_PX: u64 = 4_000;

/// Pixels of the screen for a pixel of the page. The 3-D view is drawn on the processor: a coarse screen shows the same.
const COARSE: f64 = 0.5;

/// Asserts that a page is short before a section is opened, and that no part of it is wider than a wide or a narrow window.
fn assert_fits(browser: &mut Browser, page: &Path) {
    for width in [400, 1280] {
        browser.resize(width, 1000, COARSE);
        browser.open(page);
        browser.wait("!document.querySelector('#reel') || !!document.querySelector('[data-ready]')");
        let size = |of: &str| format!("document.documentElement.{of}");
        let wide = browser.evaluate(&size("scrollWidth")).as_u64().unwrap();
        assert!(wide <= width, "{}: {wide} px wide in a window of {width} px", page.display());
        let tall = browser.evaluate(&size("scrollHeight")).as_u64().unwrap();
        assert!(width < 1280 || tall <= MOST_PX, "{}: {tall} px tall, at most {MOST_PX}", page.display());
    }
}

/// Runs the command, and returns its exit code.
fn robogate(folder: &Path, arguments: &[&str]) -> i32 {
    let output = robogate_in(folder, arguments);
    let code = output.status.code().unwrap();
    assert!([0, 1, 3].contains(&code), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    code
}

/// Plays, scrubs and opens the episodes of a page, and checks its accessibility in both themes.
fn operate(browser: &mut Browser, axe: Option<&PathBuf>, page: &Path) {
    assert_fits(browser, page);
    browser.wait("!!document.querySelector('[data-ready]')");
    let episodes = browser.evaluate("document.querySelectorAll('button[data-first]').length").as_u64().unwrap();
    assert!(episodes > 0, "no episode to watch");
    // Play, and let the time pass.
    browser.evaluate("document.querySelector('.view-play').click()");
    browser.wait("Number(document.querySelector('.view-bar input[type=range]').value) > 0.1");
    browser.evaluate("document.querySelector('.view-play').click()");
    // The keyboard moves by one frame, and to the end.
    browser.evaluate("document.querySelector('.view-stage canvas').focus()");
    let time = "Number(document.querySelector('.view-bar input[type=range]').value)";
    let before = browser.evaluate(time).as_f64().unwrap();
    browser.press("ArrowRight");
    browser.wait(&format!("{time} > {before}"));
    browser.press("End");
    browser.wait("document.querySelector('.view-phase').textContent.includes('ended')");
    // Scrub on the strip chart.
    browser.evaluate(
        "(() => { const box = document.querySelector('.strip').getBoundingClientRect(); \
         document.querySelector('.strip').dispatchEvent(new PointerEvent('pointerdown', { clientX: box.left + 300, clientY: \
         box.top + 40, bubbles: true, pointerId: 1 })) })()",
    );
    browser.wait("!document.querySelector('.view-phase').textContent.includes('ended')");
    // The picture changes with the camera.
    let picture = "document.querySelector('.view-stage canvas').toDataURL().length";
    browser.wait(&format!("{picture} > 1000"));
    // Open every other episode.
    for at in 1..episodes {
        browser.evaluate(&format!("document.querySelectorAll('button[data-first]')[{at}].click()"));
        browser.wait(&format!(
            "document.querySelectorAll('button[data-first]')[{at}].dataset.first === \
             document.querySelector('[data-ready]').dataset.ready"
        ));
    }
    // Fold everything open.
    browser.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true })");
    if browser.evaluate("!!document.querySelector('[data-pairs]')") == json!(true) {
        browser.wait("!!document.querySelector('.pairs-map rect')");
        browser.evaluate("document.querySelector('.pairs-map').focus()");
        browser.press("ArrowRight");
        // A click on a cell lists its episodes, and a recorded one is played.
        browser.evaluate(
            "[...document.querySelectorAll('.pairs-map rect')].every((cell) => { cell.dispatchEvent(new MouseEvent('click')); \
             return !document.querySelector('.pairs-list button') })",
        );
        browser.wait("document.querySelectorAll('.pairs-list li').length > 0");
        if browser.evaluate("!!document.querySelector('.pairs-list button')") == json!(true) {
            browser.evaluate("document.querySelector('.pairs-list button').click()");
            browser.wait(
                "document.querySelector('.pairs-list button').textContent.includes(document.querySelector('.view-label \
                 b').textContent + ':')",
            );
        }
        browser.wait("document.querySelector('.pairs-reading').textContent.includes('interval') || document.querySelector('.pairs-reading').textContent.includes('no episode')");
    }
    browser.assert_no_trouble();
    if let Some(axe) = axe {
        browser.assert_accessible(axe);
    }
    browser.assert_no_trouble();
}

#[test]
fn compared_engines_play_side_by_side() {
    let Some(chromium) = robogate_testing::program("chromium") else { return };
    let axe = robogate_testing::path("ROBOGATE_TEST_AXE", "the file axe.min.js of axe-core");
    let dir = TempDir::new().unwrap();
    for engine in ["mujoco", "rapier"] {
        // In the cell of the paper the engines disagree in some of these episodes.
        let paper = ["--space", "franka", "--set", "tolerance_m=0.03", "--set", "contact_force_limit_n=1000000"];
        let run = ["run", "-n", "36", "--seed", "7", "--engine", engine, "--out", engine];
        robogate(dir.path(), &[&run[..], &paper].concat());
    }
    robogate(dir.path(), &["compare", "mujoco", "rapier", "--paired", "--html", "compare.html"]);
    operate(&mut Browser::start(&chromium), axe.as_ref(), &dir.path().join("compare.html"));
}

#[test]
fn pages_work_in_a_browser() {
    let Some(chromium) = robogate_testing::program("chromium") else { return };
    let axe = robogate_testing::path("ROBOGATE_TEST_AXE", "the file axe.min.js of axe-core");
    let dir = TempDir::new().unwrap();
    let at = |name: &str| dir.path().join(name);
    robogate(dir.path(), &["run", "-n", "60", "--seed", "7", "--out", "mujoco"]);
    let page = at("mujoco/report.html");
    assert!(fs::metadata(&page).unwrap().len() < PAGE_BUDGET);
    let mut browser = Browser::start(&chromium);
    operate(&mut browser, axe.as_ref(), &page);
    // The same run gives the same page.
    let first = fs::read(&page).unwrap();
    robogate(dir.path(), &["report", "mujoco", "--out", "again.html"]);
    assert!(first == fs::read(at("again.html")).unwrap(), "the pages differ");
    // A gate opens with its verdict.
    robogate(dir.path(), &["gate", "--requirements", "paper", "--rounds", "1", "--out", "gate"]);
    let text = fs::read_to_string(at("gate/report.html")).unwrap();
    let verdict = text.find("class=\"verdict-word\"").unwrap();
    assert!(verdict < text.find("class=\"hero\"").unwrap(), "the verdict comes first");
    operate(&mut browser, axe.as_ref(), &at("gate/report.html"));
    printed(&mut browser, &at("gate/report.html"));
    printed(&mut browser, &page);
    robogate(
        dir.path(),
        &["gate", "--requirements", "paper", "--rounds", "1", "--set", "grip_force_n=2", "--out", "failed"],
    );
    printed(&mut browser, &at("failed/report.html"));
    monitor_works(&mut browser, axe.as_ref(), dir.path());
}

/// Prints a page, and checks that the paper has the verdict, all requirements and all listed episodes.
fn printed(browser: &mut Browser, page: &Path) {
    let Some(pdftotext) = robogate_testing::program("pdftotext") else { return };
    let file = page.with_extension("pdf");
    fs::write(&file, browser.print(page)).unwrap();
    let output = Command::new(pdftotext).arg("-layout").arg(&file).arg("-").output().unwrap();
    let paper = String::from_utf8(output.stdout).unwrap();
    let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let text = fs::read_to_string(page).unwrap();
    if let Some((_, verdict)) = text.split_once("class=\"verdict-word\"") {
        let word = verdict.split(['>', '<']).nth(1).unwrap();
        // The first page has the verdict with its requirements.
        let first = words(paper.split('\x0c').next().unwrap());
        let folder = page.parent().unwrap();
        let gate: serde_json::Value = serde_json::from_slice(&fs::read(folder.join("gate.json")).unwrap()).unwrap();
        assert_eq!(word.to_lowercase(), gate["verdict"].as_str().unwrap());
        for needed in
            [word, "Next step", "success rate at least", "mean of cycle time", "collision", "grip loss", "grasp miss"]
        {
            assert!(first.contains(needed), "`{needed}` is missing: {first}");
        }
    }
    // The list of episodes is complete, and folded sections are open.
    let listed = text.matches("class=\"watch-command\"").count();
    // "What to change" above the list names some of its commands too.
    let list = paper.split("Episodes worth watching").last().unwrap();
    let commands = list.split("Drivers of success").next().unwrap().matches("robogate replay .").count();
    assert_eq!(commands, listed, "{paper}");
    assert!(words(&paper).contains("Provenance dataset hash"), "{paper}");
}

/// Pages of all kinds of runs: each design, a gate with controls, other results and a server of another task.
#[test]
fn pages_are_short() {
    let Some(chromium) = robogate_testing::program("chromium") else { return };
    let dir = TempDir::new().unwrap();
    let mut pages = Vec::new();
    for design in ["active", "two-stage", "uniform"] {
        let arguments = ["run", "--task", "pendulum", "--design", design, "-n", "600", "--seed", "3", "--out", design];
        robogate(dir.path(), &arguments);
        pages.push(format!("{design}/report.html"));
    }
    robogate(dir.path(), &["gate", "--task", "pendulum", "--out", "gate"]);
    pages.push("gate/report.html".to_owned());
    robogate(dir.path(), &["compare", "active", "two-stage", "uniform", "--html", "compare.html"]);
    pages.push("compare.html".to_owned());
    let rows: String = (0..900)
        .map(|i| {
            let unit = |step: u32| f64::from((i * step + 11) % 97) / 97.0;
            let mode = if unit(37) > 0.4 + 0.3 * unit(29) {
                ""
            } else if unit(53) > 0.5 {
                "slip"
            } else {
                "jam"
            };
            format!("{},{mode},{},{},{}\n", mode.is_empty(), unit(37), unit(29), ["steel", "oiled"][i as usize % 2])
        })
        .collect();
    fs::write(dir.path().join("rows.csv"), format!("success,failure_mode,mass_kg,speed_m_s,surface\n{rows}")).unwrap();
    robogate(dir.path(), &["import", "rows.csv", "rows.parquet"]);
    robogate(dir.path(), &["report", "rows.parquet", "--out", "imported.html"]);
    pages.push("imported.html".to_owned());
    // An environment in a process of its own. The end of the run and `report` record its episodes.
    if let Some(python) = robogate_testing::path("ROBOGATE_METAWORLD_PYTHON", "a Python with Meta-World") {
        let python = python.to_str().unwrap();
        let environment = ["--env", "metaworld:drawer-open-v3", "-n", "3", "--seed", "5", "--out", "remote"];
        robogate(dir.path(), &[&["run"], &environment[..], &["--python", python]].concat());
        let page = dir.path().join("remote/report.html");
        assert!(fs::read_to_string(&page).unwrap().contains("id=\"reel\""), "recorded while its process still runs");
        fs::remove_file(&page).unwrap();
        robogate(dir.path(), &["report", "remote", "--python", python]);
        pages.push("remote/report.html".to_owned());
        // Its own policy acts, and the final state is filmed too.
        let film = ["replay", "remote", "0", "--gif", "remote.gif", "--camera", "corner2.plain"];
        assert_eq!(robogate(dir.path(), &[&film[..], &["--python", python]].concat()), 0);
        assert!(fs::metadata(dir.path().join("remote.gif")).unwrap().len() > 10_000);
    }
    let mut browser = Browser::start(&chromium);
    for page in pages {
        assert_fits(&mut browser, &dir.path().join(&page));
        if page.starts_with("remote") {
            // Its bodies are shown in 3-D, and the drawer moves.
            browser.wait(
                "!!document.querySelector('[data-ready]') && !document.querySelector('.view-stage canvas').hidden",
            );
            browser.evaluate("document.querySelector('.view-stage canvas').focus()");
            browser.press("End");
            browser.wait("document.querySelector('.view-phase').textContent.includes('ended')");
        }
    }
    browser.assert_no_trouble();
}

/// A monitor that is ended on drop.
struct Monitor(std::process::Child);

impl Drop for Monitor {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Cycles of two recipes on three robots; one recipe fails more often from its cycle 1,500 on.
fn cycles() -> String {
    let cycle = |i: u64| {
        let chance = (i.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as f64 / f64::from(1 << 24);
        let part = if i.is_multiple_of(2) { "part-a" } else { "part-b" };
        let failed = chance < if i.is_multiple_of(2) && i > 3000 { 0.4 } else { 0.03 };
        let mut cycle = json!({
            "id": format!("c{i}"), "robot": format!("cell-{}", i % 3), "recipe": part, "time_s": 1_760_000_000 + 4 * i,
            "success": !failed, "events": { "drop": failed && i.is_multiple_of(4) }, "cycle_time_s": 4.0 + chance,
            "parameters": { "mass_kg": 0.2 + chance, "friction": 0.6 },
        });
        if failed {
            cycle["failure_mode"] = json!("grip_loss");
        }
        cycle.to_string() + "\n"
    };
    (0..4000).map(cycle).collect()
}

/// Plays the simulated episode that is most similar to an alarm, and returns to the monitor.
fn alarm_is_replayed(browser: &mut Browser, axe: Option<&PathBuf>) {
    browser.evaluate("document.querySelector('#alarms a[href^=\"/replay#\"]').click()");
    browser.wait("location.pathname === '/replay' && document.querySelector('[data-ready]') !== null");
    // The failed cycle, its failure, and the passing twin beside it on one clock.
    browser.wait("document.querySelector('.sub').textContent.includes('of part-a before the alarm at cycle c')");
    browser.wait("document.querySelectorAll('.view-label').length === 2 && document.querySelector('.view-label .chip.bad') !== null");
    // The first choice is a failure with the mode of the cycle.
    let first = browser.evaluate("document.querySelector('.watch-list button').textContent");
    assert!(first.as_str().unwrap().starts_with("Nearest grip lossgrip loss"), "{first}");
    assert_eq!(
        browser.evaluate("document.querySelectorAll('.watch .scroll tbody tr').length"),
        json!(2),
        "mass and friction"
    );
    browser.evaluate("document.querySelector('.view-play').click()");
    browser.wait("Number(document.querySelector('.view-bar input[type=range]').value) > 0.1");
    browser.evaluate("document.querySelector('.view-play').click()");
    // The nearest episode of any outcome, if it is another one.
    let other = "document.querySelector('.watch-list button[aria-pressed=false]')";
    if browser.evaluate(&format!("{other} !== null")) == json!(true) {
        let index = browser.evaluate(&format!("{other}.dataset.index"));
        browser.evaluate(&format!("{other}.click()"));
        browser.wait(&format!(
            "document.querySelector('.view-label b').textContent === 'Episode ' + {index} && document.querySelector('.watch-list button[data-index=' + CSS.escape({index}) + '][aria-pressed=true]') !== null"
        ));
    }
    if let Some(axe) = axe {
        browser.assert_accessible(axe);
    }
    browser.assert_no_trouble();
    browser.evaluate("document.querySelector('.brand a').click()");
    browser.wait("location.pathname === '/' && document.querySelector('#state')?.textContent === 'live'");
}

/// Filters the monitor's page, and opens the cycles of an alarm.
fn monitor_works(browser: &mut Browser, axe: Option<&PathBuf>, folder: &Path) {
    use std::io::{BufRead, BufReader};
    fs::write(folder.join("cycles.jsonl"), cycles()).unwrap();
    // The reference names the run of its episodes, from its own folder.
    fs::create_dir_all(folder.join("monitor")).unwrap();
    robogate(folder, &["monitor", "reference", "mujoco", "--learn-baseline", "--out", "monitor/reference.json"]);
    let child = Command::new(env!("CARGO_BIN_EXE_robogate"))
        .args(["monitor", "serve", "cycles.jsonl", "--store", "monitor.db", "--listen", "127.0.0.1:0"])
        .args(["--reference", "monitor/reference.json"])
        .current_dir(folder)
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut monitor = Monitor(child);
    let mut said = BufReader::new(monitor.0.stderr.take().unwrap()).lines().map(Result::unwrap);
    let address = said.find_map(|line| line.strip_prefix("Listening on ").map(str::to_owned)).unwrap();
    // The pipe must be read, or the monitor stops when it is full.
    std::thread::spawn(move || said.for_each(drop));
    browser.open(format!("{}/", address.trim_end_matches('/')));
    browser.wait("document.querySelector('#state').textContent === 'live'");
    browser.wait("document.querySelector('#intake').textContent.includes('4,000 cycles accepted')");
    browser.wait("document.querySelectorAll('#recipes .charts svg').length >= 6");
    // The chart of the failure rate has a baseline, and the alarm is marked on it.
    browser.wait(
        "!!document.querySelector('#recipes svg .base') && !!document.querySelector('#recipes svg .mark.critical')",
    );
    // One card for each event: warning and critical alarm of a metric are one.
    let cards = "[...document.querySelectorAll('#alarms .card h3 span:first-child')].map((one) => one.textContent)";
    let shown = browser.evaluate(cards);
    assert!(!shown.as_array().unwrap().is_empty(), "no event");
    // The cycles of an alarm, with the nearest simulated episode.
    browser.evaluate("document.querySelector('#alarms button').click()");
    browser.wait("document.querySelector('#around').textContent.match(/robogate replay \\S*mujoco \\d+/) !== null");
    browser.wait("document.querySelectorAll('#cycles tr').length === 30");
    browser.wait("[...document.querySelectorAll('#cycles tr')].every((row) => row.textContent.includes('part-a'))");
    browser.evaluate("document.querySelector('#around button').click()");
    browser.wait("document.querySelectorAll('#cycles tr').length === 20");
    alarm_is_replayed(browser, axe);
    // Filters.
    let choose = |id: &str, value: &str| {
        format!(
            "(() => {{ const one = document.querySelector('#{id}'); one.value = '{value}'; \
             one.dispatchEvent(new Event('change')) }})()"
        )
    };
    browser.evaluate(&choose("of-recipe", "part-b"));
    browser.wait("document.querySelectorAll('#recipes > .card').length === 1");
    browser.wait("document.querySelector('#alarms').textContent.includes('No alarms')");
    browser.evaluate(&choose("of-robot", "cell-1"));
    browser.wait("[...document.querySelectorAll('#cycles tr')].every((row) => row.textContent.includes('cell-1'))");
    browser.evaluate(&choose("of-recipe", ""));
    browser.evaluate(&choose("of-robot", ""));
    browser.wait("document.querySelectorAll('#recipes > .card').length === 2");
    browser.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true })");
    if let Some(axe) = axe {
        browser.assert_accessible(axe);
    }
    browser.assert_no_trouble();
}
