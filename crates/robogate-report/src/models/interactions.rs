//! The paper's standardised model with interactions.
//!
//! logit P(success) on six main effects (friction, mass, centre-of-mass offset, size, inverse-kinematics noise, obstacles)
//! and three products (friction x mass, friction x size, mass x obstacles). The paper counts ten features and
//! names these nine: with the intercept they are ten. Each main effect is standardised (mean 0, standard
//! deviation 1), the products are of standardised columns and standardised again, so that a main effect is
//! the one at the mean of the others. The paper does not say which form its products have.

use robogate_stats::logistic::{Data, Options, Scale, fit, interaction, standardized};

use super::{Regression, why};
use crate::Finding;
use crate::rows::Sample;
use crate::words::{listed, name};

pub(crate) const MAIN: [&str; 6] = ["friction", "mass_kg", "com_offset", "size_m", "ik_noise_rad", "obstacles"];
pub(crate) const PRODUCTS: [(usize, usize); 3] = [(0, 1), (0, 3), (1, 5)];

pub(crate) fn interactions(base: &Sample) -> Finding<Regression> {
    let missing: Vec<String> =
        MAIN.iter().filter(|m| base.parameter(m).is_none_or(|p| !p.is_numeric())).map(|m| name(m)).collect();
    if !missing.is_empty() {
        return Finding::not(format!("the dictionary has no {}, which the paper's model is made of", listed(&missing)));
    }
    let columns: Vec<&[f64]> = MAIN.iter().filter_map(|m| base.parameter(m)).map(|p| p.values.as_slice()).collect();
    // A constant column stays as it is: the fit will name it.
    let scaled: Vec<Vec<f64>> = columns.iter().map(|c| standardized(c).unwrap_or_else(|| c.to_vec())).collect();
    let products: Vec<Vec<f64>> = PRODUCTS.iter().map(|(a, b)| interaction(&scaled[*a], &scaled[*b])).collect();
    let all: Vec<&[f64]> = scaled.iter().chain(&products).map(Vec::as_slice).collect();
    let names: Vec<String> = MAIN
        .iter()
        .map(|m| name(m))
        .chain(PRODUCTS.iter().map(|(a, b)| format!("{} \u{d7} {}", name(MAIN[*a]), name(MAIN[*b]))))
        .collect();
    let options = Options { scale: Scale::Standardized, ..Options::default() };
    let found = Data::new(&all, &base.success, None).and_then(|data| fit(data, options));
    match found {
        Ok(fit) => Finding::Estimated(Regression::of(&fit, "success", &names, true)),
        Err(error) => Finding::not(why(&error, &names)),
    }
}
