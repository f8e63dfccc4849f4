//! Real roots of a polynomial of degree up to ten.

/// Room for the roots of a polynomial of degree ten.
const ROOT_COUNT_MAX: usize = 10;

/// Up to ten roots, ascending.
#[derive(Clone, Copy, Debug)]
pub(super) struct Roots {
    values: [f64; ROOT_COUNT_MAX],
    count: usize,
}

impl Roots {
    const NONE: Self = Self {
        values: [0.0; ROOT_COUNT_MAX],
        count: 0,
    };

    pub(super) fn iter(&self) -> std::slice::Iter<'_, f64> {
        self.values[..self.count].iter()
    }

    fn push(&mut self, root: f64) {
        if self.count < ROOT_COUNT_MAX {
            self.values[self.count] = root;
            self.count += 1;
        }
    }
}

/// The real roots of `Σ coefficients[i] xⁱ` at which it changes its sign.
///
/// Between two neighbouring roots of the derivative a polynomial is monotone and has at most one
/// root: so the derivatives are solved from the linear one up.
pub(super) fn real_roots(coefficients: &[f64; 11]) -> Roots {
    let largest = coefficients.iter().fold(0.0_f64, |m, c| m.max(c.abs()));
    if !largest.is_finite() {
        return Roots::NONE;
    }
    let significant = |c: &f64| c.abs() > 1e-14 * largest;
    let Some(degree) = coefficients
        .iter()
        .rposition(significant)
        .filter(|d| *d > 0)
    else {
        return Roots::NONE;
    };
    // Fujiwara's bound holds for all roots, and by Gauss and Lucas for those of the derivatives.
    let limit = (0..degree)
        .map(|power| {
            let ratio = (coefficients[power] / coefficients[degree]).abs();
            2.0 * ratio.powf(1.0 / (degree - power) as f64)
        })
        .fold(f64::MIN_POSITIVE, f64::max);
    let mut roots = Roots::NONE;
    for order in (0..degree).rev() {
        let (derivative, derivative_degree) = derivative(coefficients, degree, order);
        let derivative = &derivative[..=derivative_degree];
        let mut next = Roots::NONE;
        let mut low = -limit;
        for high in roots.iter().copied().chain(std::iter::once(limit)) {
            if let Some(root) = root_between(derivative, low, high) {
                next.push(root);
            }
            low = high;
        }
        roots = next;
    }
    roots
}

/// The derivative of this order, up to a factor, and its degree.
fn derivative(coefficients: &[f64; 11], degree: usize, order: usize) -> ([f64; 11], usize) {
    let mut derivative = [0.0; 11];
    for power in order..=degree {
        let factor: f64 = (0..order).map(|k| (power - k) as f64).product();
        derivative[power - order] = coefficients[power] * factor;
    }
    (derivative, degree - order)
}

fn value_and_slope(coefficients: &[f64], x: f64) -> (f64, f64) {
    let mut value = 0.0;
    let mut slope = 0.0;
    for coefficient in coefficients.iter().rev() {
        slope = slope * x + value;
        value = value * x + coefficient;
    }
    (value, slope)
}

/// Newton's method, held within a bracket by bisection, which also takes over where Newton's
/// steps do not shrink.
fn root_between(coefficients: &[f64], mut low: f64, mut high: f64) -> Option<f64> {
    let low_value = value_and_slope(coefficients, low).0;
    let high_value = value_and_slope(coefficients, high).0;
    if low_value == 0.0 {
        return Some(low);
    }
    if low_value.is_sign_positive() == high_value.is_sign_positive() {
        return None;
    }
    let mut x = 0.5 * (low + high);
    let mut last_step = high - low;
    // Halvings exhaust the digits in about 60 steps; Newton needs about six.
    for _ in 0..100 {
        let (value, slope) = value_and_slope(coefficients, x);
        if value == 0.0 {
            break;
        }
        if value.is_sign_positive() == low_value.is_sign_positive() {
            low = x;
        } else {
            high = x;
        }
        let newton = x - value / slope;
        let shrinks = (newton - x).abs() < 0.5 * last_step;
        let next = if newton > low && newton < high && shrinks {
            newton
        } else {
            0.5 * (low + high)
        };
        last_step = (next - x).abs();
        x = next;
        if last_step <= 1e-15 * x.abs() {
            break;
        }
    }
    Some(x)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn from_roots(roots: &[f64]) -> [f64; 11] {
        let mut coefficients = [0.0; 11];
        coefficients[0] = 1.0;
        for (degree, root) in roots.iter().enumerate() {
            for power in (0..=degree + 1).rev() {
                let lower = if power > 0 {
                    coefficients[power - 1]
                } else {
                    0.0
                };
                coefficients[power] = lower - root * coefficients[power];
            }
        }
        coefficients
    }

    proptest! {
        #[test]
        fn finds_separate_roots(
            gaps in prop::collection::vec(0.1_f64..0.7, 1..=10),
            start in -3.0_f64..0.0,
        ) {
            let expected: Vec<f64> = gaps
                .iter()
                .scan(start, |at, gap| { *at += gap; Some(*at) })
                .collect();
            let found = real_roots(&from_roots(&expected));
            prop_assert_eq!(found.iter().count(), expected.len());
            for (found, expected) in found.iter().zip(&expected) {
                prop_assert!((found - expected).abs() < 1e-4, "{found} {expected}");
            }
        }
    }

    #[test]
    fn degenerate_polynomials_have_no_roots() {
        assert_eq!(real_roots(&[0.0; 11]).iter().count(), 0);
        assert_eq!(real_roots(&[f64::NAN; 11]).iter().count(), 0);
        let mut constant = [0.0; 11];
        constant[0] = 1.0;
        assert_eq!(real_roots(&constant).iter().count(), 0);
        constant[10] = 1.0;
        assert_eq!(real_roots(&constant).iter().count(), 0);
    }
}
