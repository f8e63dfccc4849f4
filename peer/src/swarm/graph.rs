//! Who is near whom: components and the algebraic connectivity.

use nalgebra::Vector3;

/// The number of groups that nobody's reach joins.
pub fn component_count(positions: &[Vector3<f64>], reach_m: f64) -> usize {
    let mut is_reached = vec![false; positions.len()];
    let mut waiting = Vec::new();
    let mut count = 0;
    for start in 0..positions.len() {
        if std::mem::replace(&mut is_reached[start], true) {
            continue;
        }
        count += 1;
        waiting.push(start);
        while let Some(member) = waiting.pop() {
            for (other, position) in positions.iter().enumerate() {
                if !is_reached[other] && is_near(&positions[member], position, reach_m) {
                    is_reached[other] = true;
                    waiting.push(other);
                }
            }
        }
    }
    count
}

pub fn is_near(left: &Vector3<f64>, right: &Vector3<f64>, reach_m: f64) -> bool {
    (left - right).norm_squared() <= reach_m * reach_m
}

/// λ₂ / N, the second smallest eigenvalue of the Laplacian over the number of drones: zero if
/// the swarm is apart, one if everybody is near everybody.
///
/// Power iteration on `c I − L` beside its constant eigenvector.
pub fn connectivity(positions: &[Vector3<f64>], reach_m: f64) -> f64 {
    let count = positions.len();
    if count < 2 {
        return 1.0;
    }
    let neighbours: Vec<Vec<usize>> = positions
        .iter()
        .enumerate()
        .map(|(own, position)| {
            (0..count)
                .filter(|other| *other != own && is_near(position, &positions[*other], reach_m))
                .collect()
        })
        .collect();
    let shift = 2.0 * neighbours.iter().map(Vec::len).max().unwrap_or(0) as f64;
    // Anything that is not constant, and nowhere symmetric.
    let mut vector: Vec<f64> = (0..count)
        .map(|idx| (1.7 * idx as f64 + 0.3).sin())
        .collect();
    let mut eigenvalue = 0.0;
    for _ in 0..ITERATION_COUNT {
        let mean = vector.iter().sum::<f64>() / count as f64;
        vector.iter_mut().for_each(|value| *value -= mean);
        let length = vector.iter().map(|value| value * value).sum::<f64>().sqrt();
        if length <= 0.0 {
            break;
        }
        vector.iter_mut().for_each(|value| *value /= length);
        let next: Vec<f64> = (0..count)
            .map(|own| {
                let degree = neighbours[own].len() as f64;
                let sum: f64 = neighbours[own].iter().map(|other| vector[*other]).sum();
                (shift - degree) * vector[own] + sum
            })
            .collect();
        eigenvalue = vector
            .iter()
            .zip(&next)
            .map(|(left, right)| left * right)
            .sum();
        vector = next;
    }
    ((shift - eigenvalue) / count as f64).clamp(0.0, 1.0)
}

const ITERATION_COUNT: usize = 300;

#[cfg(test)]
mod tests {
    use super::*;

    fn line(count: usize) -> Vec<Vector3<f64>> {
        (0..count).map(|idx| Vector3::x() * idx as f64).collect()
    }

    #[test]
    fn groups_are_counted() {
        let mut positions = line(4);
        assert_eq!(component_count(&positions, 1.1), 1);
        positions.push(Vector3::x() * 9.0);
        assert_eq!(component_count(&positions, 1.1), 2);
        assert_eq!(component_count(&[], 1.0), 0);
    }

    #[test]
    fn connectivity_of_known_graphs() {
        // Everybody near everybody: λ₂ = N.
        assert!((connectivity(&line(4), 10.0) - 1.0).abs() < 1e-9);
        // A path of three: λ₂ = 1.
        assert!((connectivity(&line(3), 1.1) - 1.0 / 3.0).abs() < 1e-6);
        // A path of five: λ₂ = 2 − 2 cos 36°.
        let expected = (2.0 - 2.0 * 36_f64.to_radians().cos()) / 5.0;
        assert!((connectivity(&line(5), 1.1) - expected).abs() < 1e-6);
        let apart = [Vector3::zeros(), Vector3::x() * 9.0];
        assert!(connectivity(&apart, 1.0) < 1e-9);
    }
}
