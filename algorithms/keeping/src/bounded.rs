//! A list in place: it never allocates and says when it is full.

use std::ops::{Deref, DerefMut};

/// At most `CAPACITY` entries.
#[derive(Clone, Copy, Debug)]
pub struct Bounded<T, const CAPACITY: usize> {
    entries: [T; CAPACITY],
    length: usize,
}

impl<T: Copy + Default, const CAPACITY: usize> Default for Bounded<T, CAPACITY> {
    fn default() -> Self {
        Self {
            entries: [T::default(); CAPACITY],
            length: 0,
        }
    }
}

impl<T: Copy, const CAPACITY: usize> Bounded<T, CAPACITY> {
    /// Appends, or gives the entry back if the list is full.
    pub fn push(&mut self, entry: T) -> Result<(), T> {
        match self.entries.get_mut(self.length) {
            Some(slot) => {
                *slot = entry;
                self.length += 1;
                Ok(())
            }
            None => Err(entry),
        }
    }

    pub fn clear(&mut self) {
        self.length = 0;
    }

    /// Keeps the entries that pass, in their order.
    pub fn retain(&mut self, mut is_kept: impl FnMut(&T) -> bool) {
        let mut kept = 0;
        for idx in 0..self.length {
            if is_kept(&self.entries[idx]) {
                self.entries[kept] = self.entries[idx];
                kept += 1;
            }
        }
        self.length = kept;
    }
}

impl<T, const CAPACITY: usize> Deref for Bounded<T, CAPACITY> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.entries[..self.length]
    }
}

impl<T, const CAPACITY: usize> DerefMut for Bounded<T, CAPACITY> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.entries[..self.length]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gives_back_what_does_not_fit_and_keeps_the_order() {
        let mut list: Bounded<u8, 3> = Bounded::default();
        for entry in 1..=3 {
            assert_eq!(list.push(entry), Ok(()));
        }
        assert_eq!(list.push(4), Err(4));
        list.retain(|entry| *entry != 2);
        assert_eq!(&list[..], &[1, 3]);
    }
}
