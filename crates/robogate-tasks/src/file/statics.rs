//! Statics of a stack of cubes: when does it stand?
//!
//! A rigid body on a horizontal face stands if its line of gravity passes through its support polygon (the convex hull of
//! its contact points; Timoshenko and Young, Engineering Mechanics, 4th edition, chapter 3). For a stack this must hold
//! at each face for all parts above it together. Two consequences for equal homogeneous cubes of edge s: a cube may
//! overhang the one below by up to s/2, and three cubes with equal offsets stand up to an offset of s/3 each.

/// One cube of a stack: position of its centre (x, y) in metres, and mass in kilograms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Level {
    /// Horizontal position of the centre, in metres.
    pub at: [f64; 2],
    /// Mass in kilograms.
    pub mass_kg: f64,
}

/// The smallest distance in metres from the line of gravity of the parts above a face to the edges of that face, over
/// all faces of a stack from the bottom up. The stack stands if it is positive.
///
/// The cubes have the edge `size_m` and are homogeneous and aligned with the axes. The face of two cubes is the overlap of
/// their squares. Cubes that are rotated against each other overlap a little less or more than this.
pub fn margin(levels: &[Level], size_m: f64) -> f64 {
    let mut smallest = f64::INFINITY;
    for (i, pair) in levels.windows(2).enumerate() {
        let above = &levels[i + 1..];
        let mass: f64 = above.iter().map(|level| level.mass_kg).sum();
        for axis in 0..2 {
            let centre = above.iter().map(|level| level.mass_kg * level.at[axis]).sum::<f64>() / mass;
            let low = pair[0].at[axis].max(pair[1].at[axis]) - 0.5 * size_m;
            let high = pair[0].at[axis].min(pair[1].at[axis]) + 0.5 * size_m;
            smallest = smallest.min(centre - low).min(high - centre);
        }
    }
    smallest
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stack(offsets: &[f64], masses: &[f64]) -> f64 {
        let levels: Vec<Level> =
            offsets.iter().zip(masses).map(|(x, mass)| Level { at: [*x, 0.0], mass_kg: *mass }).collect();
        margin(&levels, 1.0)
    }

    #[test]
    fn half_is_the_limit_of_two() {
        assert!((stack(&[0.0, 0.4], &[1.0; 2]) - 0.1).abs() < 1e-12);
        assert!(stack(&[0.0, 0.51], &[1.0; 2]) < 0.0);
    }

    #[test]
    fn third_is_the_limit_of_three() {
        assert!(stack(&[0.0, 0.33, 0.66], &[1.0; 3]) > 0.0);
        assert!(stack(&[0.0, 0.34, 0.68], &[1.0; 3]) < 0.0);
    }

    /// The classical overhang of 1/2 and 1/4 from the top.
    #[test]
    fn harmonic_offsets_are_the_limit() {
        assert!(stack(&[0.0, 0.249, 0.748], &[1.0; 3]) > 0.0);
        assert!(stack(&[0.0, 0.251, 0.752], &[1.0; 3]) < 0.0);
    }

    #[test]
    fn counterweight_extends_the_overhang() {
        // A heavy part above the base holds a part that overhangs it.
        assert!(stack(&[0.0, 0.6, 0.2], &[1.0, 1.0, 1.0]) > 0.0);
        assert!(stack(&[0.0, 0.6, 0.2], &[1.0, 1.0, 0.2]) < 0.0);
    }
}
