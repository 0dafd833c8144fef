//! Tests of suites and of the error message for each mistake in one.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use robogate_core::{Assignment, Domain, ParameterSpace, Seed, Suite, SuiteError, SuiteProblem, TaskSpec, Value, Word};

const TWO: &str = r#"
    schema = 1
    name = "two"
    version = "1.0.0"
    description = "Two groups."
    defaults = { friction = 0.8, mass_kg = 1, obstacles = 0, shape = "box", jitter_m = 0.003 }
    [[group]]
    name = "light"
    category = "nominal"
    scenarios = [
        { id = "light-1", mass_kg = 0.5 },
        { id = "light-2", mass_kg = { low = 0.1, high = 0.2 }, shape = ["sphere", "box"] },
    ]
    [[group]]
    name = "crowd"
    category = "adversarial"
    defaults = { obstacles = { low = 2, high = 4 } }
    scenarios = [{ id = "crowd-1" }, { id = "crowd-2", obstacles = 5 }]
"#;

fn two() -> Suite {
    Suite::from_toml(TWO).unwrap()
}

fn problems(text: &str) -> Vec<SuiteProblem> {
    match Suite::from_toml(text) {
        Err(SuiteError::Problems(problems)) => problems,
        other => panic!("{other:?}"),
    }
}

#[test]
fn defaults_apply_in_order() {
    let suite = two();
    let ids: Vec<&str> = suite.cases().iter().map(|case| case.id.as_str()).collect();
    assert_eq!(ids, ["light-1", "light-2", "crowd-1", "crowd-2"]);
    let of = |index: u64, name: &str| suite.scenario(Seed::campaign(1), index).requested.get(name).cloned().unwrap();
    assert_eq!(of(0, "mass_kg"), Value::Number(0.5));
    assert_eq!((of(2, "mass_kg"), of(2, "friction")), (Value::Number(1.0), Value::Number(0.8)));
    assert_eq!((of(0, "obstacles"), of(3, "obstacles")), (Value::Integer(0), Value::Integer(5)));
    assert_eq!((suite.case(2).group.as_str(), suite.case(2).category.as_str()), ("crowd", "adversarial"));
}

#[test]
fn ranges_are_sampled_each_round() {
    let suite = two();
    let seed = Seed::campaign(2026);
    let mut seen = (Vec::new(), Vec::new(), Vec::new());
    for round in 0..200 {
        let scenario = suite.scenario(seed, 4 * round + 1);
        assert_eq!((scenario.index, scenario.seed), (4 * round + 1, seed.episode(4 * round + 1)));
        assert_eq!(scenario.requested.number("friction"), Some(0.8));
        let mass = scenario.requested.number("mass_kg").unwrap();
        assert!((0.1..0.2).contains(&mass));
        seen.0.push(mass.to_bits());
        seen.1.push(scenario.requested.category("shape").unwrap().to_owned());
        let Some(Value::Integer(n)) = suite.scenario(seed, 4 * round + 2).requested.get("obstacles").cloned() else {
            panic!("expected an integer for obstacles")
        };
        seen.2.push(n);
    }
    seen.0.sort_unstable();
    seen.0.dedup();
    assert_eq!(seen.0.len(), 200, "every mass is different");
    assert!(["sphere", "box"].iter().all(|word| seen.1.iter().any(|seen| seen == word)));
    assert!([2, 3, 4].iter().all(|n| seen.2.contains(n)) && seen.2.iter().all(|n| (2..=4).contains(n)));
}

#[test]
fn episode_depends_on_seed_and_index() {
    let suite = two();
    let one = suite.scenario(Seed::campaign(7), 9);
    assert_eq!(one, suite.scenario(Seed::campaign(7).episode(3), 9));
    assert_ne!(one.requested, suite.scenario(Seed::campaign(8), 9).requested);
}

#[test]
fn parameters_have_separate_streams() {
    let wider = Suite::from_toml(&TWO.replace("friction = 0.8", "friction = { low = 0.7, high = 0.9 }")).unwrap();
    for index in 0..40 {
        let mass = |suite: &Suite| suite.scenario(Seed::campaign(3), index).requested.number("mass_kg");
        assert_eq!(mass(&wider), mass(&two()));
    }
}

#[test]
fn space_contains_every_scenario() {
    let suite = two();
    let of = |name: &str| suite.space().parameters()[suite.space().position(name).unwrap()].domain.clone();
    assert!(matches!(of("mass_kg"), Domain::Continuous { low, high, .. } if (low, high) == (0.1, 1.0)));
    assert!(matches!(of("obstacles"), Domain::Integer { low: 0, high: 5 }));
    assert!(matches!(of("shape"), Domain::Categorical { choices } if choices.len() == 2));
    // A constant gets a narrow range, because a space has no constants.
    assert!(matches!(of("friction"), Domain::Continuous { low, high, .. } if low == 0.8 && high > 0.8 && high < 0.802));
    for index in 0..40 {
        let scenario = suite.scenario(Seed::campaign(3), index);
        assert_eq!(scenario.requested.len(), suite.space().len());
        for parameter in suite.space().parameters() {
            let code = parameter.domain.encode(scenario.requested.get(&parameter.name).unwrap()).unwrap();
            match &parameter.domain {
                Domain::Continuous { low, high, .. } => assert!((*low..=*high).contains(&code)),
                Domain::Integer { low, high } => assert!((*low as f64..=*high as f64).contains(&code)),
                Domain::Categorical { choices } => assert!(code < choices.len() as f64),
            }
        }
    }
}

#[test]
fn json_round_trips() {
    let json = serde_json::to_string(&two()).unwrap();
    assert_eq!(serde_json::from_str::<Suite>(&json).unwrap(), two());
}

#[test]
fn duplicate_id_is_named() {
    let error = Suite::from_toml(&TWO.replace("crowd-1", "light-2")).unwrap_err();
    assert_eq!(error.to_string(), "scenario id `light-2` is used twice");
}

#[test]
fn all_problems_are_reported_at_once() {
    let text = TWO
        .replace("schema = 1", "schema = 9")
        .replace("name = \"crowd\"", "name = \"a crowd\"")
        .replace("crowd-1", "light-1")
        .replace("{ low = 0.1, high = 0.2 }", "{ low = 0.3, high = 0.2 }")
        .replace("obstacles = 5", "obstacles = \"many\", glare = 1.0");
    let found = problems(&text);
    let message = SuiteError::Problems(found.clone()).to_string();
    for expected in [
        "schema = 9",
        "the name of a group in category `adversarial` is \"a crowd\"",
        "scenario id `light-1` is used twice",
        "scenario `light-2`: parameter `mass_kg`: low 0.3 must be below high 0.2",
        "`obstacles` is a number in scenario `light-1` and a word in `crowd-2`",
        "scenario `light-2` has no `glare`",
    ] {
        assert!(message.contains(expected), "{expected} is not in\n{message}");
    }
    assert_eq!(message.lines().count(), found.len());
}

#[test]
fn empty_suite_or_group_is_rejected() {
    let none = "schema = 1\nname = \"n\"\nversion = \"1\"\ndescription = \"\"\ngroup = []";
    assert_eq!(problems(none), [SuiteProblem::Empty]);
    let empty = format!("{TWO}\n[[group]]\nname = \"void\"\ncategory = \"nominal\"\nscenarios = []");
    assert_eq!(problems(&empty), [SuiteProblem::EmptyGroup { group: "void".to_owned() }]);
}

#[test]
fn syntax_error_names_line_and_expectation() {
    for (what, wrong, expected) in [
        ("mass_kg = 0.5", "mass_kg = true", "{ low, high }"),
        ("{ low = 0.1, high = 0.2 }", "{ low = 0.1, hihg = 0.2 }", "hihg"),
        ("{ id = \"light-1\", mass_kg = 0.5 }", "{ mass_kg = 0.5 }", "`id`"),
        ("category = \"nominal\"", "categroy = \"nominal\"", "categroy"),
        ("mass_kg = 0.5", "mass_kg = nan", "finite"),
    ] {
        let error = Suite::from_toml(&TWO.replace(what, wrong)).unwrap_err();
        assert!(error.to_string().contains(expected), "{error}");
        if let SuiteError::Syntax(text) = &error {
            assert!(text.contains("line "), "{text}");
        }
    }
}

/// A task with nominal values for friction and mass only.
fn task() -> TaskSpec {
    serde_json::from_value(serde_json::json!({
        "name": "door", "version": 1, "instruction": "open it", "control_period_s": 0.02, "time_limit_s": 4.0,
        "failure_modes": [], "measures": [],
        "parameters": [
            { "name": "friction", "kind": "continuous", "low": 0.1, "high": 2.0, "nominal": 0.5 },
            { "name": "mass_kg", "kind": "continuous", "low": 0.0, "high": 9.0, "nominal": 1.0 },
            { "name": "obstacles", "kind": "integer", "low": 0, "high": 9 }
        ],
        "observation": { "vectors": [] },
        "action": { "spaces": [{ "kind": "vector", "names": ["torque"], "low": [-1.0], "high": [1.0] }] }
    }))
    .unwrap()
}

#[test]
fn twins_have_nominal_values_and_the_same_seeds() {
    let suite = two();
    let twin = suite.nominal_twin(&task()).unwrap();
    let seed = Seed::campaign(5);
    for index in 0..12 {
        let (of, twin) = (suite.scenario(seed, index), twin.scenario(seed, index));
        assert_eq!(of.seed, twin.seed);
        assert_eq!((twin.requested.number("friction"), twin.requested.number("mass_kg")), (Some(0.5), Some(1.0)));
        // Values without a nominal one are kept, also if they are sampled in each round.
        for kept in ["obstacles", "shape", "jitter_m"] {
            assert_eq!(of.requested.get(kept), twin.requested.get(kept), "{kept} of {index}");
        }
    }
    assert_eq!(twin.case(2).group, "crowd");
    assert!(!suite.has_twins() && Suite::from_toml(&format!("nominal = true\n{TWO}")).unwrap().has_twins());
}

#[test]
fn families_vary_one_at_a_time() {
    let space = ParameterSpace::from_toml(
        "name = 'three'\n[[parameter]]\nname = 'friction'\nkind = 'continuous'\nlow = 0.1\nhigh = 2.0\n\
         [[parameter]]\nname = 'mass_kg'\nkind = 'continuous'\nlow = 2.0\nhigh = 9.0\n\
         [[parameter]]\nname = 'obstacles'\nkind = 'integer'\nlow = 0\nhigh = 9\n",
    )
    .unwrap();
    let families = [("load".to_owned(), vec!["mass_kg".to_owned()]), ("grip".to_owned(), vec!["friction".to_owned()])];
    let suite = Suite::of_families(&space, &task(), &families, 1).unwrap();
    assert!(suite.has_twins() && suite.case(0).group == "load" && suite.case(1).group == "grip");
    let twin = suite.nominal_twin(&task()).unwrap();
    let seed = Seed::campaign(5);
    for round in 0..5 {
        let [load, grip] = [2 * round, 2 * round + 1].map(|index| suite.scenario(seed, index).requested);
        assert_eq!((load.number("friction"), grip.number("mass_kg")), (Some(0.5), Some(1.0)));
        assert!(load.number("mass_kg") >= Some(2.0) && grip.number("friction") != Some(0.5));
        // Without a nominal value: sampled, and the same in the twin.
        assert_eq!(load.number("obstacles"), twin.scenario(seed, 2 * round).requested.number("obstacles"));
    }
    let none = [("crowd".to_owned(), vec!["obstacles".to_owned()])];
    assert!(matches!(Suite::of_families(&space, &task(), &none, 1), Err(SuiteError::NoNominal { .. })));
    let several = Suite::of_families(&space, &task(), &families, 2).unwrap();
    let ids: Vec<&str> = several.cases().iter().map(|case| case.id.as_str()).collect();
    assert_eq!(ids, ["load-1", "load-2", "grip-1", "grip-2"]);
}

#[test]
fn twins_of_points_are_one_scenario_or_one_each() {
    let point = |obstacles: Option<i64>, friction: f64| -> Assignment {
        let values = [("friction".into(), Value::Number(friction)), ("mass_kg".into(), Value::Number(3.0))];
        values.into_iter().chain(obstacles.map(|n| ("obstacles".into(), Value::Integer(n)))).collect()
    };
    let all = Suite::nominal_twins(&task(), &[point(None, 0.2), point(None, 0.9)]).unwrap();
    assert_eq!(all.cases().len(), 1);
    let some = Suite::nominal_twins(&task(), &[point(Some(3), 0.2), point(Some(4), 0.9)]).unwrap();
    let at = |index| some.scenario(Seed::campaign(1), index).requested;
    assert_eq!((at(0).number("obstacles"), at(1).number("obstacles")), (Some(3.0), Some(4.0)));
    assert_eq!(at(1).number("friction"), Some(0.5));
    let none: Assignment = [("shape".into(), Value::Category("box".into()))].into_iter().collect();
    assert!(matches!(Suite::nominal_twins(&task(), &[none]), Err(SuiteError::NoNominal { .. })));
}

/// The task with two declared families.
fn task_with_families() -> TaskSpec {
    let mut task = task();
    task.parameters[0].family = Some(Word::constant("contact"));
    task.parameters[1].family = Some(Word::constant("load"));
    task
}

#[test]
fn declared_families_perturb_one_block_each() {
    let task = task_with_families();
    let families = task.families_among(["mass_kg", "friction", "obstacles"].into_iter());
    let names: Vec<&str> = families.iter().map(|(family, _)| family.as_str()).collect();
    assert_eq!(names, ["contact", "load"]);
    let point = |friction: f64, mass: f64, obstacles: i64| -> Assignment {
        let values = [("friction".into(), Value::Number(friction)), ("mass_kg".into(), Value::Number(mass))];
        values.into_iter().chain([("obstacles".into(), Value::Integer(obstacles))]).collect()
    };
    let points: Vec<Assignment> = (0..5).map(|i| point(0.1 * f64::from(i + 1), 2.0 + f64::from(i), i.into())).collect();
    let suite = Suite::points_with_one_family(&task, &families, &points).unwrap();
    let seed = Seed::campaign(5);
    for (i, point) in points.iter().enumerate() {
        let of = suite.scenario(seed, i as u64).requested;
        let (contact, load) = (point.number("friction"), point.number("mass_kg"));
        // Three points of the first family and two of the second.
        let expected = if i < 3 { (contact, Some(1.0)) } else { (Some(0.5), load) };
        assert_eq!((of.number("friction"), of.number("mass_kg")), expected, "{i}");
        assert_eq!(suite.case(i as u64).group, if i < 3 { "contact" } else { "load" });
        // Without a nominal value, the parameter keeps its value.
        assert_eq!(of.number("obstacles"), point.number("obstacles"));
    }
    // The scenarios of a suite keep their order, so their seeds are those of the suite.
    let suite = two();
    let one = suite.one_family_each(&task, &families).unwrap();
    assert_eq!(one.cases().len(), suite.cases().len());
    for index in 0..suite.cases().len() as u64 {
        assert_eq!(one.case(index).id, suite.case(index).id);
        assert_eq!(one.scenario(seed, index).seed, suite.scenario(seed, index).seed);
    }
    assert!(suite.perturbed(&task).contains(&"mass_kg") && !suite.perturbed(&task).contains(&"obstacles"));
}

#[test]
fn family_needs_a_nominal_value() {
    let mut task = task_with_families();
    assert_eq!(task.check(), Ok(()));
    task.parameters[2].family = Some(Word::constant("crowd"));
    let error = task.check().unwrap_err().to_string();
    assert!(error.contains("obstacles") && error.contains("nominal"), "{error}");
}

#[test]
fn fresh_points_cover_the_space() {
    let space = ParameterSpace::from_toml(
        r#"
        name = "cell"
        [[parameter]]
        name = "friction"
        kind = "continuous"
        low = 0.01
        high = 1.0
        scale = "log"
        [[parameter]]
        name = "mass_kg"
        kind = "continuous"
        low = 0.5
        high = 2.0
        [[parameter]]
        name = "obstacles"
        kind = "integer"
        low = 0
        high = 3
        [[parameter]]
        name = "shape"
        kind = "categorical"
        choices = ["box", "sphere"]
        "#,
    )
    .unwrap();
    let suite = Suite::fresh(&space, 8).unwrap();
    assert!(suite.is_fresh() && !two().is_fresh());
    assert_eq!((suite.name(), suite.cases().len()), ("cell", 8));
    assert_eq!(suite.space().parameters(), space.parameters());
    // A plan stores the suite as JSON.
    let stored: Suite = serde_json::from_value(serde_json::to_value(&suite).unwrap()).unwrap();
    assert_eq!(stored, suite);
    // No point is repeated, and the logarithm of friction is uniform: half of it is below the geometric mean.
    let seed = Seed::campaign(3);
    let points: Vec<f64> =
        (0..800).map(|index| suite.scenario(seed, index).requested.number("friction").unwrap()).collect();
    let mut distinct: Vec<u64> = points.iter().map(|point| point.to_bits()).collect();
    distinct.sort_unstable();
    distinct.dedup();
    assert_eq!(distinct.len(), 800);
    let below = points.iter().filter(|friction| **friction < 0.1).count();
    assert!((340..=460).contains(&below), "{below} of 800");
}
