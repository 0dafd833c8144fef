//! The real success rate from a simulation and trials.

use std::fmt::Write as _;
use std::path::Path;

use robogate_analysis::transfer::{Transfer, TransferOptions};
use robogate_analysis::{AnalysisError, Source};
use robogate_core::{Outcome, Value};
use tempfile::TempDir;

use crate::synthetic::{law, outcome, point, space, write as write_rows};

/// A simulation of 900 episodes of the law.
fn simulation(folder: &TempDir) -> std::path::PathBuf {
    let space = space(&["box", "sphere"]);
    let path = folder.path().join("simulation.parquet");
    write_rows(&path, &space, law(&space, 900));
    path
}

/// `n` trials of the same law as CSV, without the column `leave_out`. `more` adds a cell to each row.
fn trials(n: u64, leave_out: &str, header: &str, more: impl Fn(u64) -> String) -> String {
    let space = space(&["box", "sphere"]);
    let names: Vec<&str> = space.parameters().iter().map(|p| &*p.name).filter(|name| *name != leave_out).collect();
    let mut text = format!("success,{}{header}\n", names.join(","));
    for i in 50_000..50_000 + n {
        let requested = point(&space, i);
        let success = outcome(i, &requested) == Outcome::Success;
        write!(text, "{success}").unwrap();
        for name in &names {
            let cell = match requested.get(name).unwrap() {
                Value::Number(x) => x.to_string(),
                Value::Integer(x) => x.to_string(),
                Value::Category(word) => word.to_string(),
            };
            write!(text, ",{cell}").unwrap();
        }
        writeln!(text, "{}", more(i)).unwrap();
    }
    text
}

fn transfer(simulation: &Path, text: &str, groups: &[&str]) -> Result<Transfer, AnalysisError> {
    over(simulation, text, groups, None)
}

/// As `transfer`, over the settings `population`.
fn over(simulation: &Path, text: &str, groups: &[&str], population: Option<&str>) -> Result<Transfer, AnalysisError> {
    let folder = TempDir::new().unwrap();
    let write = |name: &str, text: &str| {
        let file = folder.path().join(name);
        std::fs::write(&file, text).unwrap();
        file
    };
    let file = write("trials.csv", text);
    let source = Source::open(simulation)?;
    let groups = groups.iter().map(|group| (*group).to_owned()).collect();
    let population = population.map(|text| write("population.csv", text));
    Transfer::of(&source, simulation, &file, &TransferOptions { groups, population, policy: None })
}

#[test]
fn good_simulation_saves_trials() {
    let folder = TempDir::new().unwrap();
    let found = transfer(&simulation(&folder), &trials(60, "", "", |_| String::new()), &[]).unwrap();
    let rate = found.rate.estimated().unwrap();
    assert!(rate.worth_trials > 75.0 && rate.correlation.unwrap() > 0.4, "{rate:?}");
    // The rate of the law over the space.
    let truth = found.simulated.rate.unwrap();
    assert!(rate.interval_95[0] < truth && truth < rate.interval_95[1], "{rate:?} {truth}");
    let exact = found.exact.estimated().unwrap();
    assert_eq!(exact.strata.iter().map(|s| s.trials).sum::<u64>(), 60);
    assert!(exact.interval_95[0] < truth && truth < exact.interval_95[1], "{exact:?}");
    assert_eq!(found.different_parameters().count() + found.different_endings().count(), 0);
    let slope = found.correction.slope;
    assert!(slope.interval_95[0] < 1.0 && 1.0 < slope.interval_95[1], "{slope:?}");
    let next = found.next.unwrap();
    assert_eq!(next.settings.len(), 10);
    assert!(next.settings[0].simulated < next.settings[9].simulated);
    assert!(next.settings[0].setting.contains("mass") && next.expected_half_width < next.half_width);
    assert!(next.settings.iter().all(|trial| matches!(trial.values["mass_kg"], Value::Number(_))));
}

#[test]
fn corrected_model_is_mapped() {
    let folder = TempDir::new().unwrap();
    let found = transfer(&simulation(&folder), &trials(60, "", "", |_| String::new()), &[]).unwrap();
    let named: Vec<&str> = found.effects.significant().map(|effect| &*effect.parameter).take(2).collect();
    let map = found.map.estimated().unwrap();
    assert_eq!([&*map.map.y.parameter, &*map.map.x.parameter], named[..]);
    // The valid ones of 900 episodes fill 5 x 5 cells with 25 each, but not 6 x 6.
    assert_eq!((map.map.cells.len(), map.settings), (25, 64));
    assert_eq!(map.map.cells.iter().map(|cell| cell.rate.n).sum::<u64>(), 60);
    let curves = map.contour.estimated().unwrap();
    let inside = |[x, y]: &[f64; 2]| {
        let on = |edges: &[f64], value: f64| edges[0] <= value && value <= edges[edges.len() - 1];
        on(&map.map.x.edges, *x) && on(&map.map.y.edges, *y)
    };
    assert!(!curves.is_empty() && curves.iter().flatten().all(inside), "{curves:?}");
    assert!(!map.band.is_empty() && map.band.iter().flatten().all(inside));
    // The interval contains the rate, and more trials make the band narrower.
    let models = map.map.cells.iter().filter_map(|cell| cell.model);
    assert!(models.clone().all(|model| model.interval_95[0] <= model.rate && model.rate <= model.interval_95[1]));
    let width = |of: &Transfer| {
        let cells = &of.map.estimated().unwrap().map.cells;
        cells.iter().filter_map(|cell| cell.model).map(|model| model.interval_95[1] - model.interval_95[0]).sum::<f64>()
    };
    let more = transfer(&simulation(&folder), &trials(400, "", "", |_| String::new()), &[]).unwrap();
    assert!(width(&more) < 0.6 * width(&found), "{} {}", width(&more), width(&found));
    // A document of an earlier version has no map.
    let mut old = serde_json::to_value(&found).unwrap();
    old.as_object_mut().unwrap().remove("map");
    old.as_object_mut().unwrap().remove("effects");
    let old: Transfer = serde_json::from_value(old).unwrap();
    assert!(old.map.because().is_some() && old.effects.ranked.is_empty());
}

#[test]
fn parameters_join_the_corrected_model() {
    let folder = TempDir::new().unwrap();
    let all = trials(200, "", "", |_| String::new());
    let plain = transfer(&simulation(&folder), &all, &[]).unwrap();
    assert!(plain.correction.parameters.is_empty(), "{:?}", plain.correction);
    // In reality, most spheres roll away.
    let real = |(i, row): (usize, &str)| {
        let lost = row.ends_with(",sphere") && i % 5 > 0;
        if lost { row.replacen("true", "false", 1) } else { row.to_owned() }
    };
    let text = all.lines().enumerate().map(real).collect::<Vec<_>>().join("\n");
    let found = transfer(&simulation(&folder), &text, &[]).unwrap();
    let [shape] = &found.correction.parameters[..] else { panic!("{:?}", found.correction.parameters) };
    assert_eq!(shape.parameter, "shape");
    // Both levels say the same.
    let sign = if shape.level.as_deref() == Some("sphere") { -1.0 } else { 1.0 };
    let ends = shape.effect.interval_95.map(|end| sign * end);
    assert!(sign * shape.effect.mean > 0.5 && ends[0].min(ends[1]) > 0.2, "{shape:?}");
    // The expected success of a proposed trial depends on its shape, and without the effect only on the simulation.
    let excess = |of: &Transfer, shape: &str| {
        let settings = &of.next.as_ref().unwrap().settings;
        let of_shape: Vec<f64> = settings
            .iter()
            .filter(|trial| trial.values["shape"] == Value::Category(shape.into()))
            .map(|trial| trial.expected - trial.simulated)
            .collect();
        assert!(!of_shape.is_empty(), "{settings:?}");
        of_shape.iter().sum::<f64>() / of_shape.len() as f64
    };
    assert!(excess(&found, "box") - excess(&found, "sphere") > 0.1, "{:?}", found.next);
    assert!((excess(&plain, "box") - excess(&plain, "sphere")).abs() < 0.2, "{:?}", plain.next);
    // The map's rates contain the effect too: their mean is near the real rate.
    let mean = |of: &Transfer| {
        let cells = &of.map.estimated().unwrap().map.cells;
        cells.iter().filter_map(|cell| cell.model).map(|model| model.rate).sum::<f64>() / cells.len() as f64
    };
    let lost = plain.alone.rate.unwrap() - found.alone.rate.unwrap();
    assert!((mean(&plain) - mean(&found) - lost).abs() < 0.08, "{} {} {lost}", mean(&plain), mean(&found));
}

#[test]
fn unrelated_trials_have_no_contour() {
    let folder = TempDir::new().unwrap();
    let all = trials(60, "", "", |_| String::new());
    let mut rows = all.lines();
    let header = rows.next().unwrap();
    // Outcomes that do not depend on the setting.
    let row = |(i, row): (usize, &str)| format!("{}{}\n", i % 2 == 0, &row[row.find(',').unwrap()..]);
    let text: String = std::iter::once(format!("{header}\n")).chain(rows.enumerate().map(row)).collect();
    let found = transfer(&simulation(&folder), &text, &[]).unwrap();
    let map = found.map.estimated().unwrap();
    assert!(map.contour.because().unwrap().contains("slope") && map.band.is_empty());
}

#[test]
fn missing_parameters_are_averaged() {
    let folder = TempDir::new().unwrap();
    let found = transfer(&simulation(&folder), &trials(40, "friction", "", |_| String::new()), &[]).unwrap();
    assert_eq!(found.real.missing, ["friction"]);
    assert!(found.rate.estimated().unwrap().worth_trials > 30.0);
    // One stratum: the trials alone.
    let exact = found.exact.estimated().unwrap();
    assert_eq!((exact.strata[0].share, exact.strata[1].trials), (0.0, 40));
    assert!((exact.interval_95[0] - found.alone.clopper_pearson_95[0]).abs() < 1e-6);
}

#[test]
fn trials_of_another_policy_are_refused() {
    let folder = TempDir::new().unwrap();
    let sim = simulation(&folder);
    let policy = robogate_analysis::Source::open(&sim).unwrap().dictionary().provenance().policy.clone();
    let of = |name: &str| trials(20, "", ",policy", |_| format!(",{name}"));
    assert!(transfer(&sim, &of(&policy), &[]).is_ok());
    let other = transfer(&sim, &of("new"), &[]).unwrap_err().to_string();
    assert!(other.contains("a trial of the policy `new`") && other.contains("--policy new"), "{other}");
    let two = trials(20, "", ",policy", |at| if at % 2 == 0 { ",a".to_owned() } else { ",b".to_owned() });
    let two = transfer(&sim, &two, &[]).unwrap_err().to_string();
    assert!(two.contains("give the trials of one policy"), "{two}");
}

#[test]
fn repeated_settings_are_groups() {
    let folder = TempDir::new().unwrap();
    let once = trials(20, "", "", |_| String::new());
    let (header, rows) = once.split_once('\n').unwrap();
    let found = transfer(&simulation(&folder), &format!("{header}\n{rows}{rows}{rows}"), &[]).unwrap();
    assert_eq!(found.real.groupings, [("repeated setting".to_owned(), 20)]);
    assert_eq!(found.unlike().count(), 0);
    let single = transfer(&simulation(&folder), &once, &[]).unwrap();
    let width = |of: &Transfer| of.rate.estimated().map(|rate| rate.alone_95[1] - rate.alone_95[0]).unwrap();
    assert!((width(&found) / width(&single) - 1.0).abs() < 0.2);
}

#[test]
fn one_operator_is_no_group() {
    let folder = TempDir::new().unwrap();
    let found = transfer(&simulation(&folder), &trials(30, "", ",operator", |_| ",ann".to_owned()), &[]).unwrap();
    assert_eq!(found.real.constant, [("operator".to_owned(), "ann".to_owned())]);
    assert!(found.real.groupings.is_empty() && found.rate.estimated().is_some() && found.exact.estimated().is_some());
    // Two columns of groups, one of them constant.
    let day = |i: u64| format!(",ann,{}", i % 6);
    let found = transfer(&simulation(&folder), &trials(30, "", ",operator,day", day), &["operator ", " day"]).unwrap();
    assert_eq!((found.real.groupings.len(), found.real.constant.len()), (1, 1));
}

#[test]
fn one_setting_says_nothing_about_others() {
    let folder = TempDir::new().unwrap();
    let one = trials(1, "", "", |_| String::new());
    let (header, row) = one.split_once('\n').unwrap();
    let found = transfer(&simulation(&folder), &format!("{header}\n{}", row.repeat(20)), &[]).unwrap();
    for because in [found.rate.because(), found.exact.because()] {
        assert!(because.unwrap().contains("same setting"), "{because:?}");
    }
    assert!(found.endings.is_empty() && found.not_compared.is_some());
}

#[test]
fn equal_levels_are_no_repeated_setting() {
    let folder = TempDir::new().unwrap();
    let rows: String = (0..40).map(|i| format!("{},{}\n", i % 3 == 0, ["box", "sphere"][i % 2])).collect();
    let found = transfer(&simulation(&folder), &format!("success,shape\n{rows}"), &[]).unwrap();
    assert!(found.real.groupings.is_empty() && found.real.constant.is_empty(), "{:?}", found.real);
    assert!(found.rate.estimated().is_some() && !found.settings.is_empty());
}

#[test]
fn endings_are_compared_where_they_can_be() {
    let folder = TempDir::new().unwrap();
    let simulation = simulation(&folder);
    // Failures without a mode.
    let unnamed = trials(60, "", ",failure_mode", |_| ",".to_owned());
    let found = transfer(&simulation, &unnamed, &[]).unwrap();
    assert_eq!(found.endings.iter().map(|ending| &*ending.ending).collect::<Vec<_>>(), ["success"]);
    assert!(found.not_compared.unwrap().starts_with("Failure modes are not compared"));
    assert_eq!(transfer(&simulation, &trials(60, "", "", |_| String::new()), &[]).unwrap().not_compared, None);
    // Light parts only, as the population says: the simulation is right, and nothing differs.
    let all = trials(300, "", "", |_| String::new());
    let (header, rows) = all.split_once('\n').unwrap();
    let light: Vec<&str> =
        rows.lines().filter(|row| row.split(',').nth(2).unwrap().parse::<f64>().unwrap() < 0.4).collect();
    let light = format!("{header}\n{}\n", light.join("\n"));
    let found = over(&simulation, &light, &[], Some(&light)).unwrap();
    assert!(found.rate.estimated().is_some() && found.endings.is_empty(), "{:?}", found.rate);
    assert!(found.not_compared.unwrap().contains("operating space"));
}

#[test]
fn a_population_may_have_few_settings() {
    let folder = TempDir::new().unwrap();
    let all = trials(3, "", "", |_| String::new());
    let (header, rows) = all.split_once('\n').unwrap();
    let text = format!("{header}\n{}", rows.repeat(10));
    let found = over(&simulation(&folder), &text, &[], Some(&all)).unwrap();
    let mut proposed: Vec<&str> = found.next.as_ref().unwrap().settings.iter().map(|trial| &*trial.setting).collect();
    assert_eq!(proposed.len(), 10);
    proposed.dedup();
    assert_eq!(proposed.len(), 3, "{proposed:?}");
}

#[test]
fn a_simulation_without_failures_adds_nothing() {
    let folder = TempDir::new().unwrap();
    let space = space(&["box", "sphere"]);
    let path = folder.path().join("perfect.parquet");
    let mut entries = law(&space, 400);
    entries.iter_mut().for_each(|entry| entry.episode.outcome = Outcome::Success);
    write_rows(&path, &space, entries);
    let found = transfer(&path, &trials(40, "", "", |_| String::new()), &[]).unwrap();
    let rate = found.rate.estimated().unwrap();
    assert!(
        (0..2).all(|end| (rate.interval_95[end] - rate.alone_95[end]).abs() < 1e-12) && rate.tuning < 1e-12,
        "{rate:?}"
    );
}

#[test]
fn few_trials_have_an_exact_interval() {
    let folder = TempDir::new().unwrap();
    let found = transfer(&simulation(&folder), &trials(12, "", "", |_| String::new()), &[]).unwrap();
    assert_eq!(found.rate.because(), Some("12 trials are too few. Expected at least 20"));
    let exact = found.exact.estimated().unwrap();
    assert!(exact.strata.iter().all(|stratum| stratum.trials > 0), "{exact:?}");
    // They still say which trials to run next.
    assert_eq!(found.next.unwrap().settings.len(), 10);
}

#[test]
fn groups_exclude_the_exact_test() {
    let folder = TempDir::new().unwrap();
    let day = |i: u64| format!(",{}", i % 6);
    let found = transfer(&simulation(&folder), &trials(60, "", ",day", day), &[]).unwrap();
    assert_eq!(found.real.groupings, [("day".to_owned(), 6)]);
    assert!(found.exact.because().unwrap().contains("day"));
    assert!(found.rate.estimated().is_some());
}

#[test]
fn selected_settings_are_refused() {
    let folder = TempDir::new().unwrap();
    let all = trials(300, "", "", |_| String::new());
    // Only light objects.
    let rows = all.lines().skip(1).filter(|row| row.split(',').nth(2).unwrap().parse::<f64>().unwrap() < 0.4);
    let text = format!("{}\n{}\n", all.lines().next().unwrap(), rows.collect::<Vec<_>>().join("\n"));
    let found = transfer(&simulation(&folder), &text, &[]).unwrap();
    assert_eq!(found.unlike().map(|check| &*check.parameter).collect::<Vec<_>>(), ["mass_kg"]);
    assert!(found.rate.because().unwrap().contains("values of mass differ"));
    assert!(found.next.is_none());
}

#[test]
fn problems_name_their_line() {
    let folder = TempDir::new().unwrap();
    let simulation = simulation(&folder);
    let error = |text: &str, groups: &[&str]| transfer(&simulation, text, groups).unwrap_err().to_string();
    assert!(error("mass_kg\n1\n", &[]).contains(":1: no column `success`"));
    assert!(error("success,colour\n1,red\n", &[]).contains("Expected some of friction"));
    assert!(error("success,mass_kg\n1,1\nmaybe,1\n", &[]).contains(":3: success: `maybe`"));
    assert!(error("success,mass_kg\n1,heavy\n", &[]).contains(":2: mass_kg: `heavy` is not a number"));
    assert!(error("success,shape\n1,cube\n", &[]).contains("Expected one of box, sphere"));
    assert!(error("success,mass_kg\n1,1,2\n", &[]).contains(":2:"));
    assert!(error("success,mass_kg\n1,1\n", &["robot"]).contains("no column `robot`"));
    assert!(error("success,mass_kg\n1,7\n", &[]).contains("no trial inside"));
    assert!(error("success,mass_kg,mass_kg\n1,1,1\n", &[]).contains("`mass_kg` occurs twice"));
    let many = "success,mass_kg\n".to_owned() + &"1,1\n".repeat(20_001);
    assert!(error(&many, &[]).contains(":20002: 20001 trials, at most 20000"));
    // Spreadsheets add columns without a name.
    assert!(transfer(&simulation, "success,mass_kg,,\n1,1,,\n", &[]).unwrap().real.ignored.is_empty());
}
