//! Pages are small self-contained files, are deterministic, and escape data.

use robogate_analysis::{Analysis, Source};
use robogate_report::{AnalysisReport, analysis_json, html, markdown};

use crate::synthetic::{analysed, law, space};

/// Checks that every element of a page is closed. The error names the first that is not.
pub(crate) fn balanced(page: &str) -> Result<(), String> {
    const VOID: [&str; 4] = ["meta", "link", "input", "br"];
    let mut open: Vec<&str> = Vec::new();
    let mut rest = page;
    while let Some(at) = rest.find('<') {
        rest = &rest[at + 1..];
        if rest.starts_with('!') {
            continue;
        }
        let end = rest.find('>').ok_or("a tag does not end")?;
        let tag = &rest[..end];
        rest = &rest[end + 1..];
        let name = tag.trim_start_matches('/').split([' ', '\n', '/']).next().unwrap_or_default();
        if let Some(closed) = tag.strip_prefix('/') {
            match open.pop() {
                Some(opened) if opened == closed => {}
                other => return Err(format!("</{closed}> closes {other:?}")),
            }
        } else if !tag.ends_with('/') && !VOID.contains(&name) {
            open.push(name);
        }
        // Their content is not markup.
        if (name == "script" || name == "style") && !tag.starts_with('/') {
            let end = rest.find(&format!("</{name}>")).ok_or("a script does not end")?;
            rest = &rest[end..];
        }
    }
    if open.is_empty() { Ok(()) } else { Err(format!("still open: {open:?}")) }
}

#[test]
fn page_is_small_and_self_contained() {
    let space = space(&["box", "sphere", "cylinder"]);
    for n in [0, 1, 3, 300, 5_000] {
        let page = html(&analysed(&space, law(&space, n)));
        balanced(&page).unwrap_or_else(|trouble| panic!("{n} episodes: {trouble}"));
        assert!(page.len() < 400 * 1024, "{n} episodes: {} bytes", page.len());
        for forbidden in ["http://", "https://", "src=", "@import", "url(http", "//cdn"] {
            assert!(!page.contains(forbidden), "{n} episodes: {forbidden}");
        }
    }
}

#[test]
fn wide_spaces_keep_pages_small() {
    use std::fmt::Write;
    let words: Vec<String> = (0..300).map(|i| format!("\"a_rather_long_word_{i}\"")).collect();
    let mut toml = "name = \"wide\"\n".to_owned();
    for i in 0..40 {
        write!(toml, "[[parameter]]\nname = \"p{i}\"\nkind = \"continuous\"\nlow = 0.0\nhigh = 1.0\n").unwrap();
    }
    for i in 0..4 {
        write!(toml, "[[parameter]]\nname = \"w{i}\"\nkind = \"categorical\"\nchoices = [{}]\n", words.join(","))
            .unwrap();
    }
    let space = robogate_core::ParameterSpace::from_toml(&toml).unwrap();
    let entries = (0..2_000).map(|i| {
        let went = if i % 3 == 0 {
            robogate_core::Outcome::Success
        } else {
            let modes = ["grasp_miss", "grip_loss", "collision", "timeout"];
            robogate_core::Outcome::Failure(robogate_core::FailureMode::constant(modes[(i % 4) as usize]))
        };
        crate::synthetic::entry(i, crate::synthetic::point(&space, i), went)
    });
    let analysis = analysed(&space, entries.collect());
    let page = html(&analysis);
    balanced(&page).unwrap();
    assert!(page.len() < 400 * 1024, "{} bytes", page.len());
    assert!(analysis.sampling.warnings[0].contains("2,000 for each"), "{:?}", analysis.sampling.warnings);
}

#[test]
fn same_rows_give_same_bytes() {
    let space = space(&["box", "sphere"]);
    let (one, two) = (analysed(&space, law(&space, 700)), analysed(&space, law(&space, 700)));
    assert_eq!(html(&one), html(&two));
    assert_eq!(markdown(&one), markdown(&two));
    assert_eq!(analysis_json(&one), analysis_json(&two));
}

#[test]
fn markup_in_data_is_escaped() {
    let evil = "<script>alert(1)</script>";
    let space = space(&[evil, "\"><img src=x onerror=y>", "a|b"]);
    let mut provenance = crate::synthetic::provenance(space.clone());
    provenance.robot.name = evil.to_owned();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("dictionary.parquet");
    let entries = law(&space, 400).into_iter().map(Ok::<_, robogate_dictionary::DictionaryError>);
    robogate_dictionary::write_parquet(&path, &provenance, entries).unwrap();
    let source = Source::open(&path).unwrap();
    let analysis = Analysis::of(&source, &path, &[("shape".to_owned(), "friction".to_owned())]).unwrap();
    let page = html(&analysis);
    assert!(!page.contains("<script>alert"));
    assert!(!page.contains("<img"));
    assert_eq!(page.matches("<script>").count(), 1, "only the script of the page");
    assert!(page.contains("&lt;script&gt;alert(1)"));
    balanced(&page).unwrap();
    let text = markdown(&analysis);
    assert!(!text.contains("<script>") && !text.contains("<img"));
    assert!(text.contains("a\\|b"));
}

#[test]
fn markdown_is_up_to_date() {
    let space = space(&["box", "sphere"]);
    let text = markdown(&analysed(&space, law(&space, 240)));
    is_up_to_date("tests/golden/small.md", &text);
}

#[test]
fn schema_is_up_to_date() {
    is_up_to_date("tests/golden/analysis.schema.json", &schema::<AnalysisReport<'static>>());
}

/// The JSON Schema of a document, as a file.
pub(crate) fn schema<T: schemars::JsonSchema>() -> String {
    serde_json::to_string_pretty(&schemars::schema_for!(T)).unwrap() + "\n"
}

pub(crate) fn is_up_to_date(file: &str, text: &str) {
    let golden = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
    if std::env::var_os("ROBOGATE_UPDATE_GOLDEN").is_some() {
        std::fs::write(&golden, text).unwrap();
    }
    let committed = std::fs::read_to_string(&golden).unwrap();
    // Compared line by line, so that the message shows the first difference.
    for (i, (found, expected)) in text.lines().zip(committed.lines()).enumerate() {
        assert_eq!(found, expected, "{file}, line {}; update it with ROBOGATE_UPDATE_GOLDEN=1", i + 1);
    }
    assert_eq!(text.lines().count(), committed.lines().count());
}

#[test]
fn page_and_markdown_have_same_sections() {
    let space = space(&["box", "sphere"]);
    let analysis = analysed(&space, law(&space, 500));
    let (page, text) = (html(&analysis), markdown(&analysis));
    let mut at = (0, 0);
    for title in [
        "Drivers of success",
        "Operating envelope",
        "Failure modes",
        "Risk model",
        "Episodes worth replaying",
        "Figures of the RoboGate paper",
        "Sampling",
        "Provenance",
        "Limits",
    ] {
        let in_page = page.find(&format!("<h2>{title}</h2>")).unwrap_or_else(|| panic!("{title} in the page"));
        let in_text = text.find(&format!("## {title}\n")).unwrap_or_else(|| panic!("{title} in the text"));
        assert!(at.0 < in_page && at.1 < in_text, "{title} in order");
        at = (in_page, in_text);
    }
}

#[test]
fn schema_names_every_field() {
    let schema: serde_json::Value = serde_json::from_str(&schema::<AnalysisReport<'static>>()).unwrap();
    let space = space(&["box"]);
    let document: serde_json::Value =
        serde_json::from_str(&analysis_json(&analysed(&space, law(&space, 100)))).unwrap();
    for key in document.as_object().unwrap().keys() {
        assert!(schema["properties"].get(key).is_some(), "{key}");
    }
    assert_eq!(document["version"], Analysis::VERSION);
}
