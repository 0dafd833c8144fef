//! Checks against published figures: the released UR5e dictionary.

use std::path::PathBuf;

use robogate_analysis::{Analysis, CriticalThreshold, Population, Source};

/// The released file, if the data folder is available.
fn ur5e() -> Option<PathBuf> {
    let data = robogate_testing::path("ROBOGATE_SHARED_DATA", "the folder of the released data")?;
    Some(data.join("published/ur5e_failure_dictionary.json"))
}

#[test]
fn released_dictionary_gives_published_danger_zones() {
    let Some(path) = ur5e() else { return };
    let source = Source::open(&path).unwrap();
    let analysis = Analysis::of(&source, &path, &[]).unwrap();
    assert_eq!((analysis.success.rate.successes, analysis.success.rate.n), (7_432, 10_000));
    assert_eq!(analysis.population, Population::AsImported);
    let mass = analysis.marginal_effects.iter().find(|a| a.parameter == "mass_kg").unwrap();
    let published = [(0.935, 1.230, 30.9), (1.230, 1.525, 25.3), (1.525, 1.819, 28.9), (1.819, 2.114, 28.1)];
    for (cell, (low, high, percent)) in mass.cells[3..7].iter().zip(published) {
        let range = cell.range.unwrap();
        assert!((range[0] - low).abs() < 1e-3 && (range[1] - high).abs() < 1e-3, "{range:?}");
        assert!((100.0 * cell.rate.rate.unwrap() - percent).abs() < 0.05);
        let zone = analysis.danger_zones.zones.iter().find(|z| z.range == cell.range).unwrap();
        assert!(zone.significant, "not significantly below 40 % after Holm");
    }
    assert_eq!(analysis.failure_modes.failures, 2_568);
    assert_eq!(analysis.failure_modes.dominant.estimated().unwrap(), "grasp_miss");
    assert!(matches!(mass.threshold.estimated(), Some(CriticalThreshold::Crosses { rising: false, .. })));
    assert!(analysis.interactions.because().unwrap().contains("friction"));
}
