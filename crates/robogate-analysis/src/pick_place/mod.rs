//! The analysis plug-in of pick and place: the models and figures that the paper publishes for this task.
//!
//! Paper: the RoboGate paper, whose failure dictionaries are released for four robots.

mod collisions;

use crate::task::{InteractionModel, TaskAnalysis};

/// The plug-in of pick and place.
pub(crate) static PICK_PLACE: TaskAnalysis = TaskAnalysis {
    task: "pick_place",
    envelope: Some(["friction", "mass_kg"]),
    interactions: Some(INTERACTIONS),
    risk_parameters: &[
        "friction",
        "mass_kg",
        "com_offset",
        "size_m",
        "ik_noise_rad",
        "obstacles",
        "shape",
        "placement",
    ],
    risk_about: "The paper's nine features: five continuous parameters, obstacles, a shape penalty, a placement penalty and \
                 the intercept.",
    sensitivity: Some("mass_kg"),
    replay: collisions::hardest,
};

/// The paper's standardised model with interactions.
///
/// logit P(success) on six main effects (friction, mass, centre-of-mass offset, size, inverse-kinematics noise,
/// obstacles) and three products (friction x mass, friction x size, mass x obstacles). The paper counts ten features
/// and names these nine; with the intercept they are ten. Each main effect is standardised (mean 0, standard deviation
/// 1). The products are computed from standardised columns and standardised again, so that a main effect is that at the
/// mean of the others. The paper does not define the form of its products.
const INTERACTIONS: InteractionModel = InteractionModel {
    name: "paper's 10 features",
    main: &["friction", "mass_kg", "com_offset", "size_m", "ik_noise_rad", "obstacles"],
    products: &[(0, 1), (0, 3), (1, 5)],
    about: "the paper's logistic model: six standardised main effects, three interactions, the intercept. It uses neither \
            shape nor placement",
    note: "Six main effects and three products of standardised columns; with the intercept they are the paper's ten \
           features. The paper names these terms but does not define the form of its products.",
};
