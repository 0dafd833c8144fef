//! Tests of valid and invalid parameter spaces and of the error messages.

use robogate_core::{Domain, Parameter, ParameterSpace, Scale, SpaceError, Value};

const FRANKA: &str = include_str!("../../../assets/spaces/franka.toml");

fn space(parameters: &str) -> Result<ParameterSpace, SpaceError> {
    ParameterSpace::from_toml(&format!("name = \"test\"\n{parameters}"))
}

fn number(name: &str, low: &str, high: &str, rest: &str) -> String {
    format!("[[parameter]]\nname = \"{name}\"\nkind = \"continuous\"\nlow = {low}\nhigh = {high}\n{rest}\n")
}

fn words(name: &str, choices: &str) -> String {
    format!("[[parameter]]\nname = \"{name}\"\nkind = \"categorical\"\nchoices = {choices}\n")
}

fn whole(name: &str, low: i64, high: i64) -> String {
    format!("[[parameter]]\nname = \"{name}\"\nkind = \"integer\"\nlow = {low}\nhigh = {high}\n")
}

#[test]
fn franka_space_keeps_order_and_kinds() {
    let franka = ParameterSpace::from_toml(FRANKA).unwrap();
    let names: Vec<&str> = franka.parameters().iter().map(|p| &*p.name).collect();
    let expected = ["friction", "mass_kg", "com_offset", "size_m", "ik_noise_rad", "obstacles", "shape", "placement"];
    assert_eq!(names, expected);
    assert_eq!(franka.name(), "franka");
    assert_eq!(franka.position("size_m"), Some(3));
    assert_eq!(franka.position("size"), None);
    let levels: Vec<_> = franka.parameters().iter().map(|p| p.domain.levels()).collect();
    assert_eq!(levels, [None, None, None, None, None, Some(6), Some(5), Some(14)]);
}

#[test]
fn empty_range_is_rejected() {
    let empty = |low, high| SpaceError::EmptyRange { parameter: "x".into(), low, high };
    assert_eq!(space(&number("x", "1.2", "0.1", "")).unwrap_err(), empty(1.2, 0.1));
    let one_value = SpaceError::OneValue { parameter: "x".into(), value: 0.5 };
    assert_eq!(space(&number("x", "0.5", "0.5", "")).unwrap_err(), one_value);
    assert!(one_value.to_string().contains("write `value = 0.5`"), "{one_value}");
    assert_eq!(space(&whole("x", 3, 2)).unwrap_err(), empty(3.0, 2.0));
    assert_eq!(empty(1.2, 0.1).to_string(), "parameter `x`: low 1.2 must be below high 0.1");
    assert!(space(&whole("x", 3, 3)).is_ok(), "one integer is a valid range");
}

#[test]
fn parameter_can_be_fixed() {
    let fixed = |value: &str| space(&format!("[[parameter]]\nname = \"x\"\nvalue = {value}\n")).unwrap();
    for (text, value) in [
        ("0.15", Value::Number(0.15)),
        ("-2e-3", Value::Number(-0.002)),
        ("3", Value::Integer(3)),
        ("\"box\"", Value::Category("box".into())),
    ] {
        let space = fixed(text);
        let domain = &space.parameters()[0].domain;
        for u in [0.0, 0.3, 1.0 - f64::EPSILON] {
            assert_eq!(domain.decode(domain.from_unit(u)), value, "{text}");
        }
        assert!((domain.to_unit(domain.from_unit(0.2)) - 0.5).abs() < 1e-12);
        let json = serde_json::to_string(&space).unwrap();
        assert_eq!(serde_json::from_str::<ParameterSpace>(&json).unwrap(), space, "{json}");
    }
    let error = space("[[parameter]]\nname = \"x\"\nvalue = 1.0\nlow = 0.0").unwrap_err().to_string();
    assert!(error.contains("`low`") && error.contains("line 2"), "{error}");
}

#[test]
fn infinite_range_is_rejected() {
    for (low, high) in [("nan", "1.0"), ("0.0", "nan"), ("-inf", "1.0"), ("0.0", "inf")] {
        let error = space(&number("x", low, high, "")).unwrap_err();
        assert_eq!(error, SpaceError::NotFinite { parameter: "x".into() }, "{low} {high}");
    }
}

#[test]
fn log_scale_rejects_zero() {
    for low in [0.0, -1.0] {
        let error = space(&number("x", &format!("{low:?}"), "1.0", "scale = \"log\"")).unwrap_err();
        assert_eq!(error, SpaceError::LogOfNonPositive { parameter: "x".into(), low });
    }
    assert!(space(&number("x", "0.0", "1.0", "scale = \"linear\"")).is_ok());
}

#[test]
fn unknown_key_is_located() {
    // The second [[parameter]] is on line 8.
    let second = number("y", "0.0", "1.0", "unit = \"m\"");
    let error = space(&format!("{}\n{second}", whole("x", 0, 1))).unwrap_err();
    let SpaceError::Syntax(text) = &error else { panic!("{error:?}") };
    assert!(text.contains("unknown field `unit`"), "{text}");
    assert!(text.contains("line 8"), "{text}");
    let error = ParameterSpace::from_toml("nam = \"test\"").unwrap_err();
    assert!(error.to_string().contains("line 1") && error.to_string().contains("`nam`"), "{error}");
}

#[test]
fn unknown_kind_lists_valid_kinds() {
    let error = space("[[parameter]]\nname = \"x\"\nkind = \"real\"\nlow = 0\nhigh = 1").unwrap_err().to_string();
    assert!(error.contains("`real`") && error.contains("`continuous`"), "{error}");
    let error = space(&number("x", "0.1", "1.0", "scale = \"ln\"")).unwrap_err().to_string();
    assert!(error.contains("`ln`") && error.contains("`log`"), "{error}");
}

#[test]
fn invalid_toml_is_located() {
    let error = ParameterSpace::from_toml("name = \"test\"\nparameter = [").unwrap_err().to_string();
    assert!(error.contains("line 2"), "{error}");
}

#[test]
fn empty_space_is_rejected() {
    assert_eq!(space("parameter = []").unwrap_err(), SpaceError::NoParameters);
    assert_eq!(ParameterSpace::new("none", Vec::new()).unwrap_err(), SpaceError::NoParameters);
    assert_eq!(space(&words("x", "[]")).unwrap_err(), SpaceError::NoChoices { parameter: "x".into() });
}

#[test]
fn duplicate_names_are_rejected() {
    let error = space(&format!("{}{}", number("x", "0.0", "1.0", ""), whole("x", 0, 1))).unwrap_err();
    assert_eq!(error, SpaceError::Duplicate { parameter: "x".into() });
    let error = space(&words("shape", "[\"box\", \"sphere\", \"box\"]")).unwrap_err();
    assert_eq!(error, SpaceError::DuplicateChoice { parameter: "shape".into(), choice: "box".into() });
}

#[test]
fn invalid_column_name_is_rejected() {
    for name in ["", "mass kg", "mass-kg", "µ", "a.b"] {
        assert_eq!(space(&number(name, "0.0", "1.0", "")).unwrap_err(), SpaceError::Name { parameter: name.into() });
    }
}

#[test]
fn huge_integer_range_is_rejected() {
    for (low, high) in [(0, 1 << 32), (i64::MIN, i64::MAX)] {
        assert_eq!(space(&whole("x", low, high)).unwrap_err(), SpaceError::TooManyLevels { parameter: "x".into() });
    }
    let most = space(&whole("x", -1, (1 << 32) - 2)).unwrap();
    assert_eq!(most.parameters()[0].domain.levels(), Some(1 << 32));
}

#[test]
fn default_scale_is_linear() {
    let linear = space(&number("x", "0.0", "1.0", "")).unwrap();
    assert_eq!(linear.parameters()[0].domain, Domain::Continuous { low: 0.0, high: 1.0, scale: Scale::Linear });
}

#[test]
fn unit_interval_round_trips() {
    let franka = ParameterSpace::from_toml(FRANKA).unwrap();
    for Parameter { name, domain } in franka.parameters() {
        for i in 0..1_000 {
            let u = (f64::from(i) + 0.5) / 1_000.0;
            let coded = domain.from_unit(u);
            match domain.levels() {
                None => assert!((domain.to_unit(coded) - u).abs() < 1e-14, "{name} {u}"),
                // A level maps back to the middle of its cell.
                Some(levels) => {
                    let back = domain.to_unit(coded);
                    assert!((back - u).abs() <= 0.5 / levels as f64 + 1e-12, "{name} {u}");
                    assert_eq!(domain.from_unit(back), coded, "{name} {u}");
                }
            }
        }
    }
}

#[test]
fn interval_ends_stay_in_range() {
    let almost_one = 1.0 - f64::EPSILON / 2.0;
    for Parameter { name, domain } in ParameterSpace::from_toml(FRANKA).unwrap().parameters() {
        let (first, last) = match domain {
            Domain::Continuous { low, high, .. } => (*low, *high),
            Domain::Integer { low, high } => (*low as f64, *high as f64),
            Domain::Categorical { choices } => (0.0, choices.len() as f64 - 1.0),
        };
        assert!((domain.from_unit(0.0) - first).abs() < 1e-15 && domain.from_unit(0.0) >= first, "{name}");
        assert!(domain.from_unit(almost_one) <= last, "{name}");
        assert!((domain.from_unit(almost_one) - last).abs() < 1e-12, "{name}");
    }
}

#[test]
fn log_scale_midpoint_is_geometric_mean() {
    let log = Domain::Continuous { low: 0.01, high: 1.0, scale: Scale::Log };
    assert!((log.from_unit(0.5) - 0.1).abs() < 1e-16);
    assert!((log.to_unit(0.1) - 0.5).abs() < 1e-15);
}

#[test]
fn discrete_levels_have_equal_cells() {
    let five = Domain::Integer { low: -2, high: 2 };
    let counts = (0..1_000).fold([0; 5], |mut counts, i| {
        counts[(five.from_unit((f64::from(i) + 0.5) / 1_000.0) + 2.0) as usize] += 1;
        counts
    });
    assert_eq!(counts, [200; 5]);
}

#[test]
fn values_and_codes_round_trip() {
    let shape = Domain::Categorical { choices: vec!["box".into(), "sphere".into()] };
    assert_eq!(shape.encode(&Value::Category("sphere".into())), Some(1.0));
    assert_eq!(shape.decode(1.0), Value::Category("sphere".into()));
    assert_eq!(shape.encode(&Value::Category("cone".into())), None, "not one of the choices");
    assert_eq!(shape.encode(&Value::Number(1.0)), None, "a number is not a choice");
    let count = Domain::Integer { low: 0, high: 5 };
    assert_eq!(count.decode(3.0), Value::Integer(3));
    assert_eq!(count.encode(&Value::Integer(9)), Some(9.0), "data may have values outside the space");
    assert_eq!(count.encode(&Value::Category("3".into())), None);
    let size = Domain::Continuous { low: 0.0, high: 1.0, scale: Scale::Linear };
    assert_eq!(size.decode(0.25), Value::Number(0.25));
    assert_eq!(size.encode(&Value::Integer(1)), Some(1.0), "an integer is a number");
}

#[test]
fn toml_round_trips() {
    let all = format!(
        "{}{}{}{}",
        number("friction", "0.05", "1.2", "scale = \"log\""),
        number("size_m", "-1e-300", "0.1", ""),
        whole("obstacles", -3, 5),
        words("shape", "[\"box\", \"L shape\", \"\\\"quoted\\\"\"]"),
    );
    for written in [space(&all).unwrap(), ParameterSpace::from_toml(FRANKA).unwrap()] {
        let text = toml::to_string(&written).unwrap();
        assert_eq!(ParameterSpace::from_toml(&text).unwrap(), written, "{text}");
        let json = serde_json::to_string(&written).unwrap();
        assert_eq!(serde_json::from_str::<ParameterSpace>(&json).unwrap(), written, "{json}");
    }
}

#[test]
fn embedded_space_is_checked() {
    // Serde keeps only the text of the error, not its type.
    let error = toml::from_str::<ParameterSpace>(&format!("name = \"test\"\n{}", number("x", "2.0", "1.0", "")));
    assert!(error.unwrap_err().to_string().contains("low 2 must be below high 1"));
}

/// A space of three numbers, an integer and a word, with these `[[correlation]]` tables.
fn correlated(tables: &[(&str, &str, f64)]) -> Result<ParameterSpace, SpaceError> {
    let three: String = ["a", "b", "c"].iter().map(|name| number(name, "0.0", "1.0", "")).collect();
    let tables: String = tables
        .iter()
        .map(|(a, b, rank)| format!("[[correlation]]\nparameters = [{a:?}, {b:?}]\nrank = {rank:?}\n"))
        .collect();
    space(&format!("{three}{}{}{tables}", words("shape", "[\"box\", \"sphere\"]"), whole("count", 0, 5)))
}

#[test]
fn invalid_correlation_is_named() {
    for (tables, parts) in [
        (&[("a", "mass", 0.5)][..], &["`mass`", "a, b, c, shape, count"][..]),
        (&[("a", "shape", 0.5)], &["`shape`", "not continuous"]),
        (&[("count", "a", 0.5)], &["`count`", "not continuous"]),
        (&[("a", "a", 0.5)], &["`a`", "twice"]),
        (&[("a", "b", 1.0)], &["`a` and `b`", "rank 1"]),
        (&[("a", "b", -1.5)], &["`a` and `b`", "rank -1.5"]),
        (&[("a", "b", 0.5), ("b", "a", 0.4)], &["`b` and `a`", "twice"]),
        (&[("a", "b", 0.9), ("b", "c", 0.9), ("a", "c", -0.9)], &["`a`, `b`, `c`", "contradict"]),
    ] {
        let text = correlated(tables).unwrap_err().to_string();
        assert!(parts.iter().all(|part| text.contains(part)), "{tables:?}: {text}");
    }
}

#[test]
fn correlations_round_trip() {
    let written = correlated(&[("a", "b", 0.5), ("b", "c", -0.25)]).unwrap();
    assert_eq!(written.correlations().len(), 2);
    let text = toml::to_string(&written).unwrap();
    assert_eq!(ParameterSpace::from_toml(&text).unwrap(), written, "{text}");
    let json = serde_json::to_string(&written).unwrap();
    assert_eq!(serde_json::from_str::<ParameterSpace>(&json).unwrap(), written);
    let plain = serde_json::to_string(&correlated(&[]).unwrap()).unwrap();
    assert!(!plain.contains("correlation"), "{plain}");
}
