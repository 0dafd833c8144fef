//! Wedging and jamming of a peg in a hole.
//!
//! Whitney (1982), Quasi-static assembly of compliantly supported rigid parts, ASME Journal of Dynamic Systems, Measurement,
//! and Control 104, pages 65 to 77. A peg of width d that has entered a hole to the depth l touches it at two points: its
//! tip at one wall, and the mouth of the hole at the opposite side. With Coulomb friction of coefficient mu:
//!
//! - **Wedging**: the two contact forces can balance each other without any load if each lies in the friction cone of the
//!   other contact. For a small tilt this needs l <= mu d. A wedged peg cannot be pushed in with any force.
//! - **Jamming**: a load with the axial force F and the moment M about the middle of the tip, without a lateral force, moves
//!   the peg only if |M| / F < l / (2 mu). A different load moves a jammed peg.
//!
//! The analysis is planar and quasi-static, the parts are rigid, and the tilt is small.

/// Depth (m) down to which a peg of this width (m) can wedge.
pub fn wedging_depth(width_m: f64, friction: f64) -> f64 {
    friction * width_m
}

/// Whether a peg of this width (m) can wedge at this depth (m).
pub fn can_wedge(depth_m: f64, width_m: f64, friction: f64) -> bool {
    depth_m <= wedging_depth(width_m, friction)
}

/// Whether an axial load at this distance (m) from the peg's axis jams a peg in two-point contact at this depth (m).
pub fn jams(depth_m: f64, lever_m: f64, friction: f64) -> bool {
    lever_m.abs() >= depth_m / (2.0 * friction)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A load within the peg's width cannot jam a peg that is too deep to wedge.
    #[test]
    fn limits_agree_at_the_edge() {
        for friction in [0.1, 0.3, 0.8] {
            let width = 0.03;
            let limit = friction * width;
            assert!(can_wedge(0.99 * limit, width, friction) && jams(0.99 * limit, 0.5 * width, friction));
            assert!(!can_wedge(1.01 * limit, width, friction) && !jams(1.01 * limit, 0.5 * width, friction));
        }
    }
}
