//! Fits the flexible model to the files of `tests/reference/flexible.py` and prints its predictions: name, share of boosting, then
//! the chance of success of each test row.

#![expect(clippy::print_stdout, reason = "an example prints its results")]

use std::error::Error;
use std::fs::{read_dir, read_to_string};
use std::path::Path;

use robogate_stats::boosting::Monotone;
use robogate_stats::flexible::{Calibrated, Flexible, Learner, Training};
use robogate_stats::parallel::all_processors;
use robogate_stats::roc::stratified_folds;

/// Parameters and outcomes.
type Rows = (Vec<Vec<f64>>, Vec<bool>);

fn rows(path: &Path) -> Result<Rows, Box<dyn Error>> {
    let (mut rows, mut outcomes) = (Vec::new(), Vec::new());
    for line in read_to_string(path)?.lines() {
        let mut row = line.split(',').map(str::parse).collect::<Result<Vec<f64>, _>>()?;
        outcomes.push(row.pop() == Some(1.0));
        rows.push(row);
    }
    Ok((rows, outcomes))
}

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).ok_or("expected a folder")?;
    let mut names: Vec<String> =
        read_dir(&folder)?.filter_map(|entry| entry.ok()?.file_name().into_string().ok()).collect();
    names.sort();
    for name in names.iter().filter_map(|name| name.strip_suffix(".train.csv")) {
        let of = |part: &str| rows(&Path::new(&folder).join(format!("{name}.{part}.csv")));
        let ((train, outcomes), (test, _)) = (of("train")?, of("test")?);
        let width = train.first().map_or(0, Vec::len);
        let columns: Vec<Vec<f64>> = (0..width).map(|at| train.iter().map(|row| row[at]).collect()).collect();
        let folds = stratified_folds(&outcomes, None, 5, 0);
        let (constraints, interacting) = (vec![Monotone::Free; width], (0..width).collect::<Vec<usize>>());
        let training =
            Training { columns: &columns, outcomes: &outcomes, constraints: &constraints, interacting: &interacting };
        let model = Flexible::fit(training, &folds, (Learner::Chosen, Calibrated::LineOrCurve), all_processors())?;
        let p = test.iter().map(|row| (1.0 / (1.0 + (-model.log_odds(row)).exp())).to_string());
        let words: Vec<String> =
            [name.to_owned(), model.choice().boosting_share.to_string()].into_iter().chain(p).collect();
        println!("{}", words.join(","));
    }
    Ok(())
}
