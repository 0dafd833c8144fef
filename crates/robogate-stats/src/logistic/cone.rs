//! Projection onto the cone of directions that make no angle above 90° with given rows.
//!
//! For rows aᵢ and a vector s, the projection is the d with aᵢ·d ≥ 0 for each row that is closest to s. By Moreau's theorem (1962)
//! it is the residual of non-negative least squares, d = s + Σ λᵢ aᵢ with λ ≥ 0, which the active set method of Lawson and Hanson
//! (1974, chapter 23) solves: a row that d violates enters the set, and rows whose λ would become negative leave it. Each step
//! shortens the residual. The cone has its tip at the origin, where every constraint is active: a simplex method makes thousands of
//! steps without progress there and loses all digits, while this one has at most as many rows in its set as there are dimensions.

use robogate_maths::dense::dot;

/// A residual that is shorter than its vector by this factor is projected again.
const SHORT: f64 = 1e-6;

/// The smallest cosine of the angle between a vector and its projection that is not a rounding error.
const ROUNDING: f64 = 1e-13;

/// The smallest part of a row outside of the span of the others with which it may enter the set, relative to its length.
const INDEPENDENT: f64 = 1e-10;

/// Steps of one projection for each dimension. A few are typical.
const STEPS: usize = 50;

/// The direction of the projection of `vector`, with a largest entry of 1. `None` if the projection is zero.
///
/// `allowed` is the violation of a row that counts as none, for that scale.
pub(super) fn project(vector: &[f64], rows: &[Vec<f64>], allowed: f64) -> Option<Vec<f64>> {
    let vector = scaled(vector)?;
    let is_short = |residual: &[f64], target: &[f64]| norm(residual) <= SHORT * norm(target);
    let mut direction = residual(&vector, rows, allowed);
    if is_short(&direction, &vector) {
        // Its relative error is large. A projection is its own projection, and that has the error of its own length; a rounding
        // error becomes short again, or has no part along the vector.
        let target = scaled(&direction)?;
        direction = residual(&target, rows, allowed);
        if is_short(&direction, &target) {
            return None;
        }
    }
    let direction = scaled(&direction)?;
    (dot(&vector, &direction) > ROUNDING * norm(&vector) * norm(&direction)).then_some(direction)
}

/// The residual of non-negative least squares.
fn residual(target: &[f64], rows: &[Vec<f64>], allowed: f64) -> Vec<f64> {
    let mut set = Active { rows, indices: Vec::new(), basis: Vec::new(), triangle: Vec::new() };
    let mut multipliers: Vec<f64> = Vec::new();
    let mut here = target.to_vec();
    // Rows that rounding keeps out of the set, until another one enters.
    let mut refused: Vec<usize> = Vec::new();
    for _ in 0..STEPS * target.len() {
        let limit = -allowed * largest(&here);
        let free = (0..rows.len()).filter(|i| !refused.contains(i) && !set.indices.contains(i));
        let violated = free.map(|i| (i, dot(&rows[i], &here))).filter(|(_, margin)| *margin < limit);
        let angles = violated.map(|(i, margin)| (i, margin / norm(&rows[i])));
        let Some((entering, _)) = angles.min_by(|a, b| a.1.total_cmp(&b.1)) else { break };
        if !set.push(entering, INDEPENDENT) {
            refused.push(entering);
            continue;
        }
        multipliers.push(0.0);
        let mut wanted = set.solve(target);
        if wanted.last().is_none_or(|last| *last <= 0.0) {
            multipliers.pop();
            set.remove(multipliers.len());
            refused.push(entering);
            continue;
        }
        // As far as no multiplier becomes negative.
        while let Some((leaving, step)) = shortest(&multipliers, &wanted) {
            for (now, then) in multipliers.iter_mut().zip(&wanted) {
                *now += step * (then - *now);
            }
            set.remove(leaving);
            multipliers.remove(leaving);
            wanted = set.solve(target);
        }
        multipliers = wanted;
        let next = set.remainder(target);
        // In exact arithmetic it becomes shorter with each row.
        if norm(&next) >= norm(&here) {
            refused.push(entering);
        } else {
            refused.clear();
        }
        here = next;
    }
    here
}

/// The multiplier that becomes zero first on the way from `now` to `wanted`, and the share of the way. `None` if all stay positive.
fn shortest(now: &[f64], wanted: &[f64]) -> Option<(usize, f64)> {
    let ends = now.iter().zip(wanted).enumerate().filter(|(_, (_, then))| **then <= 0.0);
    ends.map(|(position, (now, then))| (position, if *now > 0.0 { now / (now - then) } else { 0.0 }))
        .min_by(|a, b| a.1.total_cmp(&b.1))
}

/// Rows of the set, with an orthogonal basis of their span: row k = Σ triangle[k][j] basis[j].
struct Active<'a> {
    rows: &'a [Vec<f64>],
    indices: Vec<usize>,
    basis: Vec<Vec<f64>>,
    triangle: Vec<Vec<f64>>,
}

impl Active<'_> {
    /// Adds a row, unless the others span all but the fraction `least` of it.
    fn push(&mut self, index: usize, least: f64) -> bool {
        let row = &self.rows[index];
        let mut rest = row.clone();
        let mut parts = vec![0.0; self.basis.len()];
        // Twice is enough for an orthogonal basis.
        for _ in 0..2 {
            for (part, unit) in parts.iter_mut().zip(&self.basis) {
                let along = dot(unit, &rest);
                *part += along;
                subtract(&mut rest, along, unit);
            }
        }
        let length = norm(&rest);
        if length <= least * norm(row) {
            return false;
        }
        rest.iter_mut().for_each(|v| *v /= length);
        parts.push(length);
        self.basis.push(rest);
        self.triangle.push(parts);
        self.indices.push(index);
        true
    }

    /// Removes the row at this position.
    fn remove(&mut self, position: usize) {
        let later = self.indices.split_off(position).split_off(1);
        self.basis.truncate(position);
        self.triangle.truncate(position);
        for index in later {
            // It was independent of more rows than these, so it is not refused here.
            self.push(index, 0.0);
        }
    }

    /// The multipliers that make the residual of `target` shortest, of any sign.
    fn solve(&self, target: &[f64]) -> Vec<f64> {
        let mut rest = target.to_vec();
        let mut multipliers: Vec<f64> = self
            .basis
            .iter()
            .map(|unit| {
                let along = dot(unit, &rest);
                subtract(&mut rest, along, unit);
                -along
            })
            .collect();
        for k in (0..multipliers.len()).rev() {
            let value = multipliers[k] / self.triangle[k][k];
            multipliers[k] = value;
            for (earlier, part) in multipliers[..k].iter_mut().zip(&self.triangle[k]) {
                *earlier -= part * value;
            }
        }
        multipliers
    }

    /// What is left of `target` without its part in the span of the rows.
    fn remainder(&self, target: &[f64]) -> Vec<f64> {
        let mut rest = target.to_vec();
        for _ in 0..2 {
            for unit in &self.basis {
                let along = dot(unit, &rest);
                subtract(&mut rest, along, unit);
            }
        }
        rest
    }
}

fn norm(a: &[f64]) -> f64 {
    dot(a, a).sqrt()
}

fn subtract(from: &mut [f64], factor: f64, vector: &[f64]) {
    from.iter_mut().zip(vector).for_each(|(f, v)| *f -= factor * v);
}

fn largest(vector: &[f64]) -> f64 {
    vector.iter().fold(0.0, |m: f64, v| m.max(v.abs()))
}

/// A vector with a largest entry of 1. `None` for the zero vector.
fn scaled(vector: &[f64]) -> Option<Vec<f64>> {
    let largest = largest(vector);
    (largest > 0.0).then(|| vector.iter().map(|v| v / largest).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALLOWED: f64 = 1e-8;

    #[test]
    fn inside_stays() {
        let d = project(&[0.5, 1.0], &[vec![1.0, 0.0], vec![0.0, 2.0]], ALLOWED).unwrap();
        assert_eq!(d, [0.5, 1.0]);
    }

    #[test]
    fn nearest_face_is_found() {
        // d0 >= d1 >= 0: the nearest point to (0, 1) is on the diagonal.
        let d = project(&[0.0, 1.0], &[vec![1.0, -1.0], vec![0.0, 1.0]], ALLOWED).unwrap();
        assert!((d[0] - 1.0).abs() < 1e-12 && (d[1] - 1.0).abs() < 1e-12, "{d:?}");
    }

    #[test]
    fn opposed_rows_leave_the_origin() {
        let rows = [vec![1.0, 0.0], vec![-1.0, 0.0], vec![0.0, 1.0], vec![1.0, -1.0]];
        assert_eq!(project(&[1.0, 0.5], &rows, ALLOWED), None);
        assert_eq!(project(&[0.0, 0.0], &rows, ALLOWED), None);
    }

    #[test]
    fn thin_cones_have_a_direction() {
        // All rows but one allow the second axis alone, and the vector is nearly orthogonal to it.
        let rows = [vec![1.0, 0.0], vec![-1.0, 0.0], vec![0.0, 1.0]];
        let d = project(&[1.0, 1e-9], &rows, ALLOWED).unwrap();
        assert!(d[0].abs() < 1e-12 && d[1] == 1.0, "{d:?}");
    }

    /// Moreau's conditions at random: no row is violated, and the vector minus its projection is orthogonal to it.
    #[test]
    fn projections_fulfil_their_conditions() {
        let mut state = 7_u64;
        let mut unit = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        let mut directions = 0;
        for case in 0..300 {
            let q = 1 + case % 12;
            let rows: Vec<Vec<f64>> =
                (0..1 + case % 30).map(|_| (0..q).map(|j| unit() + if j == 0 { 0.3 } else { 0.0 }).collect()).collect();
            let vector = scaled(&(0..q).map(|_| unit()).collect::<Vec<_>>()).unwrap();
            let Some(d) = project(&vector, &rows, ALLOWED) else { continue };
            directions += 1;
            for row in &rows {
                assert!(dot(row, &d) >= -1e-8, "case {case}: {}", dot(row, &d));
            }
            // The projection has its length along the vector.
            let length = dot(&vector, &d) / dot(&d, &d);
            assert!(length > 0.0);
            let rest: Vec<f64> = vector.iter().zip(&d).map(|(v, d)| v - length * d).collect();
            assert!(dot(&rest, &d).abs() < 1e-9, "case {case}");
            // The rest is in the polar cone: it leads away from any other direction of the cone.
            let other: Vec<f64> = (0..q).map(|_| unit()).collect();
            if let Some(other) = project(&other, &rows, ALLOWED) {
                assert!(dot(&rest, &other) < 1e-6, "case {case}: {}", dot(&rest, &other));
            }
        }
        assert!(directions > 150, "{directions}");
    }
}
