//! Real roots of low-degree polynomials.

/// The real roots of `a x² + b x + c`, without cancellation; a linear equation has one.
pub(super) fn quadratic_roots(a: f64, b: f64, c: f64) -> [Option<f64>; 2] {
    let discriminant = b * b - 4.0 * a * c;
    // A double root may come out slightly negative.
    if discriminant < -1e-12 * b * b || !discriminant.is_finite() {
        return [None, None];
    }
    let q = -0.5 * (b + discriminant.max(0.0).sqrt().copysign(b));
    let finite = |root: f64| Some(root).filter(|root| root.is_finite());
    [finite(q / a), finite(c / q)]
}

/// The real roots of `coefficients[3] x³ + … + coefficients[0]`, polished by Newton's method.
pub(super) fn cubic_roots(coefficients: [f64; 4]) -> [Option<f64>; 3] {
    let [c0, c1, c2, c3] = coefficients;
    let largest = c0.abs().max(c1.abs()).max(c2.abs());
    if c3.abs() <= 1e-14 * largest {
        let [first, second] = quadratic_roots(c2, c1, c0);
        return [first, second, None];
    }
    let (a, b, c) = (c2 / c3, c1 / c3, c0 / c3);
    let q = (a * a - 3.0 * b) / 9.0;
    let r = (2.0 * a * a * a - 9.0 * a * b + 27.0 * c) / 54.0;
    let roots = if r * r < q * q * q {
        let angle = (r / (q * q * q).sqrt()).acos();
        let root = |turn: f64| {
            -2.0 * q.sqrt() * ((angle + turn * std::f64::consts::TAU) / 3.0).cos() - a / 3.0
        };
        [Some(root(0.0)), Some(root(1.0)), Some(root(-1.0))]
    } else {
        let large = -(r.abs() + (r * r - q * q * q).sqrt()).cbrt().copysign(r);
        let small = if large == 0.0 { 0.0 } else { q / large };
        [Some(large + small - a / 3.0), None, None]
    };
    roots.map(|root| root.map(|x| polish(x, a, b, c)).filter(|x| x.is_finite()))
}

/// Two Newton steps on the monic cubic `x³ + a x² + b x + c`.
fn polish(start: f64, a: f64, b: f64, c: f64) -> f64 {
    let mut x = start;
    for _ in 0..2 {
        let value = ((x + a) * x + b) * x + c;
        let slope = (3.0 * x + 2.0 * a) * x + b;
        if slope != 0.0 {
            x -= value / slope;
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn cubic_finds_every_real_root(mut roots in prop::array::uniform3(-5.0_f64..5.0)) {
            roots.sort_by(f64::total_cmp);
            prop_assume!(roots[1] - roots[0] > 1e-3 && roots[2] - roots[1] > 1e-3);
            let [a, b, c] = roots;
            let coefficients = [-a * b * c, a * b + b * c + a * c, -a - b - c, 1.0];
            let mut found: Vec<f64> = cubic_roots(coefficients).into_iter().flatten().collect();
            found.sort_by(f64::total_cmp);
            prop_assert_eq!(found.len(), 3);
            for (found, expected) in found.iter().zip(roots) {
                prop_assert!((found - expected).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn degenerate_polynomials_have_finite_roots_or_none() {
        assert_eq!(quadratic_roots(0.0, 0.0, 1.0), [None, None]);
        assert_eq!(quadratic_roots(f64::NAN, 1.0, 1.0), [None, None]);
        assert!(quadratic_roots(0.0, 2.0, -4.0).contains(&Some(2.0)));
        assert_eq!(cubic_roots([f64::NAN; 4]), [None, None, None]);
        assert!(cubic_roots([-8.0, 0.0, 0.0, 1.0]).contains(&Some(2.0)));
    }
}
