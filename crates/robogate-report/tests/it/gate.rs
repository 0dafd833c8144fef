//! Gate evaluations as JUnit and Markdown, and leaderboards as pages.

use robogate_gate::{Evaluation, Leaderboard, Question, Record, Requirements, Sampling};
use robogate_report::{evaluation_markdown, junit, leaderboard_html, leaderboard_markdown};
use tempfile::TempDir;

use crate::runs::{boxes, saved};
use crate::synthetic::law;

const EVIL: &str = "<img src=x onerror=\"y()\"> & 'z'";

fn requirements() -> Requirements {
    let toml = format!(
        "name = '''{EVIL}'''\nmode = \"confidence\"\n\
         [[requirement]]\nmetric = \"success\"\nat_least = 0.1\n\
         [[requirement]]\nmetric = \"failure:collision\"\nat_most = 0.01\n\
         [[score]]\nname = \"success\"\nmetric = \"success\"\nweight = 1.0\n\
         scoring = {{ form = \"linear\", full_at = 0.9 }}\n"
    );
    Requirements::from_toml(&toml).unwrap()
}

/// 300 episodes of the law. About a third succeed and some collide.
fn record() -> Record {
    let (dir, space) = (TempDir::new().unwrap(), boxes());
    let (source, _) = saved(&dir, "robot", &space, law(&space, 300));
    Record::of(source.dictionary()).unwrap()
}

fn evaluation() -> Evaluation {
    let requirements = requirements();
    let question = Question { requirements: &requirements, baseline: None, against: None, sampling: Sampling::Fixed };
    question.evaluate(&record()).unwrap()
}

#[test]
fn junit_counts_match() {
    let text = junit(&evaluation());
    let document = roxmltree::Document::parse(&text).unwrap();
    let suite = document.descendants().find(|node| node.has_tag_name("testsuite")).unwrap();
    assert_eq!(suite.attribute("name"), Some(format!("gate {EVIL}").as_str()));
    let count = |name: &str| document.descendants().filter(|node| node.has_tag_name(name)).count().to_string();
    assert_eq!((count("testcase").as_str(), count("failure").as_str(), count("error").as_str()), ("2", "1", "0"));
    for (attribute, element) in [("tests", "testcase"), ("failures", "failure"), ("errors", "error")] {
        assert_eq!(suite.attribute(attribute), Some(count(element).as_str()));
    }
}

#[test]
fn markdown_states_the_verdict() {
    let text = evaluation_markdown(&evaluation());
    assert!(text.contains("RoboGate: FAIL") && text.contains("rate of collision at most"), "{text}");
}

#[test]
fn leaderboard_names_are_escaped() {
    let entries = [(EVIL.to_owned(), record(), Sampling::Fixed)];
    let board = Leaderboard::of(&entries, &requirements().score, None).unwrap();
    let page = leaderboard_html(&board);
    crate::pages::balanced(&page).unwrap();
    assert!(!page.contains("<img") && page.contains("&lt;img"));
    let text = leaderboard_markdown(&board);
    assert!(!text.contains("<img") && text.contains("exact 95 % interval") && !text.contains("confidence sequences"));
}

#[test]
fn leaderboards_mark_gates_that_stop_early() {
    let entries = [("gate".to_owned(), record(), Sampling::Sequential)];
    let board = Leaderboard::of(&entries, &requirements().score, None).unwrap();
    for text in [leaderboard_html(&board), leaderboard_markdown(&board)] {
        assert!(text.contains("confidence sequences") && !text.contains("exact 95 % interval"), "{text}");
    }
}
