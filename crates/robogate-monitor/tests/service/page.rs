//! The page in a real browser with the width of a phone. The test is skipped without Chromium.

use std::process::Command;

use robogate_monitor::service::HttpSettings;

use crate::common::{Service, cycles, post};

#[test]
fn browser_shows_the_page() {
    let Some(chromium) = robogate_testing::program("chromium") else { return };
    let folder = tempfile::tempdir().unwrap();
    let service = Service::start(&folder.path().join("monitor.db"), HttpSettings::default(), None);
    assert_eq!(post(service.address, "/v1/cycles", &cycles(0..600, 0.05), None).0, 200);
    let hostile = cycles(600..900, 0.6).replace("cell-2", "<img src=x onerror=document.title=1>");
    assert_eq!(post(service.address, "/v1/cycles", &hostile, None).0, 200);
    let profile = tempfile::tempdir().unwrap();
    let output = Command::new(chromium)
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"])
        .args(["--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars"])
        .args(["--window-size=390,844", "--virtual-time-budget=4000", "--dump-dom"])
        .arg(format!("--user-data-dir={}", profile.path().display()))
        .arg(format!("http://{}/", service.address))
        .output()
        .unwrap();
    let page = String::from_utf8_lossy(&output.stdout);
    for text in [
        ">live<",
        "part-0",
        "failure rate",
        "critical",
        "cycles failed; the baseline is",
        "4 robots: their success rates differ",
        "Since cycle",
        "&lt;img src=x",
        "900 cycles accepted",
    ] {
        assert!(page.contains(text), "`{text}` is missing from the page: {page}");
    }
    assert!(!page.contains("<img"), "a sender's name was parsed as an element");
    service.end();
}
