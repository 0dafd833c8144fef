//! Tests of valid and invalid plans.

use robogate_campaign::{Plan, PlanError, Preset};
use robogate_core::ParameterSpace;

use crate::world;

fn franka() -> ParameterSpace {
    ParameterSpace::from_toml(include_str!("../../../../assets/spaces/franka.toml")).unwrap()
}

#[test]
fn presets_match_the_paper() {
    let [quick, paper] = Preset::ALL.map(|preset| preset.plan().unwrap());
    assert_eq!((quick.uniform.episodes, quick.boundary.episodes, quick.episodes()), (750, 0, 3_000));
    let quick = quick.with_two_stages();
    assert_eq!((quick.uniform.episodes, quick.boundary.episodes), (2_000, 1_000));
    assert_eq!((paper.uniform.episodes, paper.boundary.episodes), (10_000, 10_000));
    assert_eq!(paper.clone().with_total(3_000), quick);
    for plan in [quick, paper] {
        plan.check(&franka()).unwrap();
        let stage = &plan.boundary;
        assert_eq!(
            (plan.seed, plan.sampler.as_str(), stage.bins, stage.band),
            (2026, "latin_hypercube", 10, [0.30, 0.70])
        );
        let emphasis = stage.emphasis.as_ref().unwrap();
        let ranges = |ranges: &[robogate_campaign::Range]| -> Vec<_> {
            ranges.iter().map(|r| (r.parameter.clone(), r.low, r.high)).collect()
        };
        let range = |name: &str, low, high| (name.to_owned(), low, high);
        assert!((emphasis.share - 0.30).abs() < 1e-15);
        assert_eq!(
            ranges(&emphasis.conditions),
            [range("friction", None, Some(0.3)), range("mass_kg", Some(0.5), None)]
        );
        let fallback = [
            ("friction", 0.05, 0.40),
            ("mass_kg", 0.3, 2.0),
            ("com_offset", 0.1, 0.4),
            ("size_m", 0.015, 0.05),
            ("ik_noise_rad", 0.01, 0.04),
        ];
        assert_eq!(ranges(&stage.fallback), fallback.map(|(name, low, high)| range(name, Some(low), Some(high))));
        assert_eq!(ranges(&stage.restrict), [range("obstacles", Some(1.0), Some(5.0))]);
    }
}

#[test]
fn total_is_split_two_to_one() {
    let split = |n| {
        let plan = Preset::Quick.plan().unwrap().with_total(n).with_two_stages();
        (plan.uniform.episodes, plan.boundary.episodes)
    };
    assert_eq!(
        [split(3_000), split(1), split(2), split(3), split(100)],
        [(2_000, 1_000), (1, 0), (2, 0), (2, 1), (67, 33)]
    );
    let nothing = Preset::Quick.plan().unwrap().with_total(0);
    assert!(matches!(nothing.check(&franka()), Err(PlanError::NoEpisodes)));
}

#[test]
fn defaults_may_be_omitted() {
    let plan = Plan::from_toml("[uniform]\nepisodes = 10").unwrap();
    assert_eq!(
        (plan.seed, plan.sampler.as_str(), plan.boundary.episodes, plan.boundary.bins),
        (2026, "latin_hypercube", 0, 10)
    );
    let written = serde_json::to_value(&plan).unwrap();
    assert_eq!(serde_json::from_value::<Plan>(written).unwrap(), plan);
}

#[test]
fn errors_name_their_key() {
    let cases = [
        ("[uniform]\nepisodes = 0", "`uniform.episodes` and `boundary.episodes` are both 0"),
        ("[uniform]\nepisodes = 0\n[boundary]\nepisodes = 5", "found from the uniform stage"),
        ("[uniform]\nepisodes = -1", "line 2"),
        ("[uniform]\nepisodes = 1_000_000_000_000", "`uniform.episodes` is 1000000000000"),
        ("[uniform]\nepisode = 5", "unknown field `episode`"),
        ("seeed = 5\n[uniform]\nepisodes = 5", "unknown field `seeed`"),
        ("[uniform\nepisodes = 5", "line 1"),
        ("sampler = \"sobo\"\n[uniform]\nepisodes = 5", "did you mean `sobol`?"),
        ("sampler = \"grid\"\n[uniform]\nepisodes = 5", "expected one of: latin_hypercube, sobol, uniform"),
        ("[uniform]\nepisodes = 5\n[boundary]\nbins = 1", "`boundary.bins` is 1"),
        ("[uniform]\nepisodes = 5\n[boundary]\nband = [0.7, 0.3]", "`boundary.band` is [0.7, 0.3]"),
        ("[uniform]\nepisodes = 5\n[boundary]\nband = [0.3, 70]", "`boundary.band`"),
        ("[uniform]\nepisodes = 5\n[boundary]\nband = [nan, 0.7]", "`boundary.band`"),
        ("[uniform]\nepisodes = 5\n[boundary]\nband = [0.3]", "band"),
        (
            "[uniform]\nepisodes = 5\n[boundary.emphasis]\nshare = 30\nwhere = [{parameter = \"friction\", high = 1}]",
            "write 30 % as 0.30",
        ),
        ("[uniform]\nepisodes = 5\n[boundary.emphasis]\nshare = 0.3\nwhere = []", "has no [[boundary.emphasis.where]]"),
        (
            "[uniform]\nepisodes = 5\n[[boundary.fallback]]\nparameter = \"friction\"",
            "`boundary.fallback[0]`: `friction` has neither",
        ),
        (
            "[uniform]\nepisodes = 5\n[[boundary.fallback]]\nparameter = \"friction\"\nlow = 1\nhigh = 0.5",
            "`low` 1 of `friction` is above `high` 0.5",
        ),
        ("[uniform]\nepisodes = 5\n[[boundary.fallback]]\nparameter = \"friction\"\nlow = inf", "finite"),
        (
            "[uniform]\nepisodes = 5\n[boundary]\nrestrict = [{parameter = \"obstacles\", low = 1}, {parameter = \"obstacles\", high = 4}]",
            "`boundary.restrict[1]`: `obstacles` is in this list twice",
        ),
        (
            "[uniform]\nepisodes = 5\n[[boundary.fallback]]\nparameter = \"frictoin\"\nlow = 1",
            "did you mean `friction`?",
        ),
        ("[uniform]\nepisodes = 5\n[[boundary.fallback]]\nparameter = \"mass\"\nlow = 1", "did you mean `mass_kg`?"),
        (
            "[uniform]\nepisodes = 5\n[[boundary.fallback]]\nparameter = \"obstacles\"\nlow = 1",
            "is not a continuous parameter",
        ),
        (
            "[uniform]\nepisodes = 5\n[[boundary.restrict]]\nparameter = \"friction\"\nlow = 1",
            "is not an integer parameter",
        ),
        (
            "[uniform]\nepisodes = 5\n[[boundary.restrict]]\nparameter = \"shape\"\nlow = 1",
            "is not an integer parameter",
        ),
        ("[uniform]\nepisodes = 5\n[[boundary.restrict]]\nparameter = \"obstacles\"\nlow = 1.5", "must be integers"),
        (
            "[uniform]\nepisodes = 5\n[[boundary.fallback]]\nparameter = \"friction\"\nlow = 1.5",
            "the range of `friction` is outside the operating space: expected values from 0.05 to 1.2",
        ),
    ];
    for (text, expected) in cases {
        let error = Plan::from_toml(text).and_then(|plan| plan.check(&franka())).unwrap_err().to_string();
        assert!(error.contains(expected), "{text}\ngave\n{error}\nwithout\n{expected}");
    }
}

#[test]
fn file_errors_name_the_file() {
    let base = tempfile::tempdir().unwrap();
    let path = base.path().join("my-plan.toml");
    let error = Plan::load(&path).unwrap_err().to_string();
    assert!(error.contains("cannot read") && error.contains("my-plan.toml"), "{error}");
    std::fs::write(&path, "[uniform]\nepisodes = 5\n[boundary]\nbins = 0").unwrap();
    let error = Plan::load(&path).unwrap_err().to_string();
    assert!(error.contains("my-plan.toml") && error.contains("boundary.bins"), "{error}");
}

#[test]
fn preset_fits_other_spaces() {
    let plan = Preset::Quick.plan().unwrap();
    assert_eq!(plan.clone().fitted_to(&franka()), (plan.clone(), Vec::new()));
    assert!(plan.check(&world::space()).is_err());
    let (fitted, left_out) = plan.fitted_to(&world::space());
    fitted.check(&world::space()).unwrap();
    let fallback: Vec<&str> = fitted.boundary.fallback.iter().map(|range| range.parameter.as_str()).collect();
    assert_eq!(fallback, ["friction", "mass_kg", "size_m"]);
    assert!(left_out.len() == 2 && left_out[0].contains("com_offset"), "{left_out:?}");
}

#[test]
fn plan_has_json_schema() {
    for (schema, words) in [
        (schemars::schema_for!(Plan), &["\"where\"", "\"band\"", "\"additionalProperties\""][..]),
        (schemars::schema_for!(robogate_campaign::Summary), &["\"dataset_hash\"", "\"interval_95\""]),
        (schemars::schema_for!(robogate_campaign::Event), &["\"boundary_found\"", "\"already_done\""]),
        (schemars::schema_for!(robogate_campaign::BoundaryReport), &["\"drawn_from\"", "\"in_band\""]),
        (schemars::schema_for!(robogate_campaign::Settings), &["\"provenance\""]),
    ] {
        let text = serde_json::to_string(&schema).unwrap();
        assert!(words.iter().all(|word| text.contains(word)), "{text}");
    }
}

#[test]
fn boundary_stage_rejects_correlations() {
    let correlation = robogate_core::Correlation { parameters: ["friction".into(), "mass_kg".into()], rank: 0.5 };
    let space = world::space().with_correlations(vec![correlation]).unwrap();
    let error = world::plan(10, 5).check(&space).unwrap_err().to_string();
    assert!(["`friction`", "`mass_kg`", "without a [boundary]"].iter().all(|part| error.contains(part)), "{error}");
    world::plan(10, 0).check(&space).unwrap();
}
