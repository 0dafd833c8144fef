//! Tests of task declarations and of the values derived from them.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use robogate_core::{Domain, FailureMode, TaskError, TaskSpec, Value};
use serde_json::{Value as Json, json};

fn door() -> Json {
    json!({
        "name": "open_door", "version": 3, "instruction": "open the door",
        "control_period_s": 0.02, "time_limit_s": 4.0,
        "failure_modes": [{ "name": "jam", "meaning": "The handle was blocked.", "severity": "critical" }],
        "measures": [{ "name": "angle_rad", "unit": "rad", "better": "higher" }],
        "parameters": [
            { "name": "friction", "kind": "continuous", "low": 0.1, "high": 2.0, "nominal": 0.5, "read_from": "contact" },
            { "name": "handles", "kind": "integer", "low": 1, "high": 1, "nominal": 1 },
            { "name": "color", "kind": "categorical", "choices": ["red", "blue"], "nominal": "red" }
        ],
        "observation": { "vectors": [{ "name": "angle", "length": 1, "unit": "rad" }] },
        "action": { "spaces": [{ "kind": "vector", "names": ["torque"], "low": [-1.0], "high": [1.0] }] }
    })
}

fn read(json: Json) -> TaskSpec {
    serde_json::from_value(json).unwrap()
}

#[test]
fn declaration_survives_json() {
    let task = read(door());
    task.check().unwrap();
    let again: TaskSpec = serde_json::from_str(&serde_json::to_string(&task).unwrap()).unwrap();
    assert_eq!(again, task);
}

#[test]
fn timeout_is_always_declared() {
    let task = read(door());
    let modes: Vec<&str> = task.modes().map(FailureMode::as_str).collect();
    assert_eq!(modes, ["jam", "timeout"]);
    assert!(task.declares(FailureMode::TIMEOUT));
    assert!(!task.declares(FailureMode::from_foreign("jammed")));
}

#[test]
fn declared_ranges_make_a_space() {
    let space = read(door()).declared_space().unwrap();
    let names: Vec<&str> = space.parameters().iter().map(|parameter| &*parameter.name).collect();
    assert_eq!(names, ["friction", "color"], "a constant parameter is not in the space");
    assert!(matches!(space.parameters()[0].domain, Domain::Continuous { .. }));
}

#[test]
fn contradictions_are_rejected() {
    let broken = |path: &str, value: Json| {
        let mut json = door();
        *json.pointer_mut(path).unwrap() = value;
        read(json).check().unwrap_err()
    };
    assert!(matches!(broken("/time_limit_s", json!(0.0)), TaskError::TimeLimit { .. }));
    assert!(matches!(broken("/parameters/0/nominal", json!(7.0)), TaskError::Parameter { .. }));
    assert!(matches!(broken("/parameters/0/low", json!(3.0)), TaskError::Parameter { .. }));
    assert!(matches!(broken("/parameters/1/name", json!("Friction")), TaskError::Duplicate { .. }));
    assert!(matches!(broken("/action/spaces/0/low", json!([2.0])), TaskError::Action(_)));
    assert!(matches!(broken("/action/spaces", json!([])), TaskError::Action(_)));
}

#[test]
fn reserved_modes_are_rejected() {
    let mut json = door();
    json["failure_modes"][0]["name"] = json!("success");
    assert!(serde_json::from_value::<TaskSpec>(json).is_err());
}

#[test]
fn values_are_checked_against_ranges() {
    let task = read(door());
    let parameter = |name| task.parameter(name).unwrap();
    assert!(parameter("friction").accepts(&Value::Number(2.0)).is_ok());
    assert!(parameter("friction").accepts(&Value::Number(f64::NAN)).is_err());
    assert!(parameter("handles").accepts(&Value::Number(1.5)).is_err());
    assert!(parameter("color").accepts(&Value::Category("green".into())).is_err());
}
