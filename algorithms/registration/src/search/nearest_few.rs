//! The nearest of many, as they are offered.

/// The nearest so far with their distances, nearest first; the first offered wins a tie.
#[derive(Clone, Copy)]
pub(super) struct NearestFew<Distance, const COUNT: usize>([(Distance, u32); COUNT]);

impl<Distance: Copy + PartialOrd, const COUNT: usize> NearestFew<Distance, COUNT> {
    /// - `farthest`: what is as far as this is not kept.
    pub fn new(farthest: Distance) -> Self {
        Self([(farthest, u32::MAX); COUNT])
    }

    /// What is as far as this is not kept.
    pub fn limit(&self) -> Distance {
        self.0[COUNT - 1].0
    }

    pub fn offer(&mut self, distance: Distance, idx: u32) {
        if distance >= self.limit() {
            return;
        }
        let mut place = COUNT - 1;
        while place > 0 && self.0[place - 1].0 > distance {
            self.0[place] = self.0[place - 1];
            place -= 1;
        }
        self.0[place] = (distance, idx);
    }

    pub fn known(&self) -> impl Iterator<Item = usize> + Clone {
        let known = self.0.iter().filter(|(_, idx)| *idx != u32::MAX);
        known.map(|(_, idx)| *idx as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_stay_and_the_first_of_equals() {
        let mut nearest = NearestFew::<u16, 3>::new(u16::MAX);
        assert_eq!(nearest.known().count(), 0);
        for (idx, distance) in [5, 9, 5, 7, 1, 5].into_iter().enumerate() {
            nearest.offer(distance, idx as u32);
        }
        assert_eq!(nearest.known().collect::<Vec<_>>(), [4, 0, 2]);
        assert_eq!(nearest.limit(), 5);
    }
}
