//! The middle of values, which a few wrong ones do not move.

use std::cmp::Ordering;

/// The upper median; `None` of nothing. The values are left in another order.
pub(crate) fn median<T: Copy>(values: &mut [T], order: fn(&T, &T) -> Ordering) -> Option<T> {
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    Some(*values.select_nth_unstable_by(middle, order).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_wrong_values_do_not_move_it() {
        assert_eq!(
            median(&mut [3.0, 1e9, 1.0, f64::NAN, 2.0], f64::total_cmp),
            Some(3.0)
        );
        assert_eq!(median(&mut [2.0, 1.0], f64::total_cmp), Some(2.0));
        assert_eq!(median(&mut [], f32::total_cmp), None);
    }
}
