//! Pages in a real browser: every control works, nothing is requested, and no error is reported. Skipped without Chromium.
#![cfg(all(feature = "mujoco", feature = "rapier"))]
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

#[expect(unreachable_pub, reason = "a module of a test")]
mod browser;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use browser::Browser;
use serde_json::json;
use tempfile::TempDir;

/// The budget of a page with twelve episodes, in bytes.
const PAGE_BUDGET: u64 = 2_500_000;

/// Runs the command, and returns its exit code.
fn robogate(folder: &Path, arguments: &[&str]) -> i32 {
    let output = Command::new(env!("CARGO_BIN_EXE_robogate")).args(arguments).current_dir(folder).output().unwrap();
    let code = output.status.code().unwrap();
    assert!([0, 1, 3].contains(&code), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    code
}

/// Plays, scrubs and opens the episodes of a page, and checks its accessibility in both themes.
fn operate(chromium: &Path, axe: Option<&PathBuf>, page: &Path) {
    let mut browser = Browser::start(chromium);
    browser.open(page);
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
        for theme in ["light", "dark"] {
            let media = json!({ "features": [{ "name": "prefers-color-scheme", "value": theme }] });
            browser.call("Emulation.setEmulatedMedia", media);
            browser.assert_accessible(axe);
        }
    }
    browser.assert_no_trouble();
}

#[test]
fn compared_engines_play_side_by_side() {
    let Some(chromium) = robogate_testing::program("chromium") else { return };
    let axe = robogate_testing::path("ROBOGATE_TEST_AXE", "the file axe.min.js of axe-core");
    let dir = TempDir::new().unwrap();
    for engine in ["mujoco", "rapier"] {
        robogate(dir.path(), &["run", "-n", "60", "--seed", "7", "--engine", engine, "--out", engine]);
    }
    robogate(dir.path(), &["compare", "mujoco", "rapier", "--paired", "--html", "compare.html"]);
    operate(&chromium, axe.as_ref(), &dir.path().join("compare.html"));
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
    operate(&chromium, axe.as_ref(), &page);
    // The same run gives the same page.
    let first = fs::read(&page).unwrap();
    robogate(dir.path(), &["report", "mujoco", "--out", "again.html"]);
    assert!(first == fs::read(at("again.html")).unwrap(), "the pages differ");
    // A gate opens with its verdict.
    robogate(dir.path(), &["gate", "--requirements", "paper", "--rounds", "1", "--out", "gate"]);
    let text = fs::read_to_string(at("gate/report.html")).unwrap();
    let verdict = text.find("class=\"verdict-word\"").unwrap();
    assert!(verdict < text.find("class=\"hero\"").unwrap(), "the verdict comes first");
    operate(&chromium, axe.as_ref(), &at("gate/report.html"));
}
