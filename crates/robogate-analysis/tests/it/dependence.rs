//! Rows that depend on each other name nothing, and intervals count clusters.

use robogate_analysis::{Advice, Analysis, AnalysisOptions};

use crate::clusters::{DESIGNS, Design, Settings, analysed, compared, imported, table, true_rate};
use crate::named::named;

/// Reports of each design. The program `dependence` makes 400.
const REPORTS: u64 = 12;

#[test]
fn dependent_rows_name_nothing() {
    let (mut false_reports, mut all) = (0, 0);
    for design in &DESIGNS {
        for seed in 0..REPORTS {
            false_reports += usize::from(!named(&analysed(design, seed, 0.0)).is_empty());
            all += 1;
        }
    }
    assert!(false_reports * 20 <= all * 2, "{false_reports} of {all} reports name something");
}

#[test]
fn intervals_cover_the_rate_of_new_clusters() {
    let mut missed = 0;
    for design in &DESIGNS {
        for seed in 100..100 + REPORTS {
            let [low, high] = analysed(design, seed, 0.0).success.rate.wilson_95;
            let truth = true_rate(design.rates);
            missed += usize::from(truth < low || truth > high);
        }
    }
    let all = DESIGNS.len() * REPORTS as usize;
    assert!(missed * 10 <= all, "{missed} of {all} intervals miss the rate");
}

/// What identifies clusters, and how many there are.
fn clusters(analysis: &Analysis) -> (Vec<&str>, u64) {
    let of = analysis.clusters.as_ref().unwrap();
    (of.groupings.iter().map(|group| group.by.as_str()).collect(), of.clusters)
}

#[test]
fn clusters_are_found_by_name_and_by_settings() {
    let found = |name: &str| {
        let design = DESIGNS.iter().find(|design| design.name == name).unwrap();
        let analysis = analysed(design, 1, 0.0);
        let (by, count) = clusters(&analysis);
        (by.join("+"), count)
    };
    assert_eq!(found("15 scenarios x 60, no label"), ("equal settings".to_owned(), 15));
    assert_eq!(found("15 scenarios x 60, case and seed"), ("case".to_owned(), 15));
    assert_eq!(found("50 x 20, integer parameters"), ("equal settings".to_owned(), 50));
    assert_eq!(found("10 integer scenarios x 60"), ("equal settings".to_owned(), 10));
    assert_eq!(found("50 x 20, read-back noise 1e-4"), ("equal settings".to_owned(), 50));
    assert_eq!(found("20 sessions x 40, drifting settings"), ("session_id".to_owned(), 20));
    assert_eq!(found("9 robots x 80, settings of each robot"), ("robot_serial".to_owned(), 9));
    assert_eq!(found("10 unlabelled days x 60, new settings"), ("neighbouring rows".to_owned(), 10));
}

#[test]
fn independent_rows_have_no_clusters() {
    let independent = Design {
        name: "",
        clusters: 600,
        rows: 1,
        settings: Settings::EachRow,
        labels: &[],
        in_blocks: false,
        rates: [1.2, 0.0],
    };
    let found = (0..20).filter(|seed| analysed(&independent, *seed, 0.0).clusters.is_some()).count();
    assert!(found <= 1, "{found} of 20");
}

#[test]
fn few_clusters_allow_no_claim() {
    let few = Design { clusters: 6, ..DESIGNS[0] };
    let analysis = analysed(&few, 3, 8.0);
    let report = analysis.clusters.as_ref().unwrap();
    assert!(report.too_few && report.clusters == 6);
    assert_eq!(named(&analysis), Vec::<String>::new());
    assert!(!analysis.claims.advice.iter().any(|advice| matches!(advice, Advice::WholeSpace { .. })));
}

#[test]
fn effects_between_and_within_clusters_are_found() {
    // Between 20 scenarios, and within 8 days.
    let scenarios = Design { clusters: 20, rates: [1.2, 0.8], ..DESIGNS[0] };
    let days = DESIGNS[5];
    for (design, effect) in [(scenarios, 6.0), (days, 3.0)] {
        let found =
            (0..10).filter(|seed| named(&analysed(&design, *seed, effect)).contains(&"friction".to_owned())).count();
        assert!(found >= 8, "{}: {found} of 10", design.name);
    }
}

#[test]
fn named_columns_are_groups() {
    let folder = tempfile::tempdir().unwrap();
    let csv = table(&DESIGNS[5], 1, 0.0).replacen("day,", "fixture,", 1);
    let (source, path) = imported(folder.path(), "results", &csv);
    let of = |groups: &[&str]| {
        let groups = groups.iter().map(|name| (*name).to_owned()).collect();
        Analysis::with(&source, &path, &AnalysisOptions { models: false, groups, ..AnalysisOptions::default() })
    };
    assert_eq!(clusters(&of(&["fixture"]).unwrap()), (vec!["fixture"], 8));
    let error = of(&["fixtures"]).unwrap_err().to_string();
    assert!(error.contains("unknown column `fixtures`") && error.contains("fixture, friction"), "{error}");
}

#[test]
fn comparisons_count_scenarios() {
    let different = (0..60).filter(|seed| compared(8, 40, *seed) <= 0.05).count();
    assert!(different <= 8, "{different} of 60 comparisons of equal policies");
}
