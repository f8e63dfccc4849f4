//! Things with consecutive ids, some of which were removed.

/// A vector from consecutive ids to boxed values; a removed one costs a pointer.
#[derive(Clone, Debug)]
pub(crate) struct Arena<T> {
    first_id: u32,
    slots: Vec<Option<Box<T>>>,
    len: usize,
}

impl<T> Arena<T> {
    /// An empty arena whose first value will have this id.
    pub(crate) fn starting_at(first_id: u32) -> Self {
        Self {
            first_id,
            slots: Vec::new(),
            len: 0,
        }
    }

    pub(crate) fn first_id(&self) -> u32 {
        self.first_id
    }

    /// The id that the next value will have.
    pub(crate) fn next_id(&self) -> u32 {
        self.first_id + u32::try_from(self.slots.len()).expect("ids are exhausted after 2^32 items")
    }

    /// Makes the next id at least this; the ids in between stay empty.
    pub(crate) fn skip_to(&mut self, next_id: u32) {
        let slot_count = next_id.saturating_sub(self.first_id) as usize;
        if slot_count > self.slots.len() {
            self.slots.resize_with(slot_count, || None);
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.len
    }

    pub(crate) fn push(&mut self, value: T) -> u32 {
        let id = self.next_id();
        self.slots.push(Some(Box::new(value)));
        self.len += 1;
        id
    }

    /// Puts a value where there is none, also before the first id.
    pub(crate) fn insert(&mut self, id: u32, value: T) {
        if id < self.first_id {
            let missing = (self.first_id - id) as usize;
            self.slots.splice(0..0, (0..missing).map(|_| None));
            self.first_id = id;
        }
        self.skip_to(id + 1);
        let slot = &mut self.slots[(id - self.first_id) as usize];
        assert!(slot.is_none(), "ids are unique over all maps");
        *slot = Some(Box::new(value));
        self.len += 1;
    }

    pub(crate) fn get(&self, id: u32) -> Option<&T> {
        self.slots.get(self.slot(id)?)?.as_deref()
    }

    pub(crate) fn get_mut(&mut self, id: u32) -> Option<&mut T> {
        let slot = self.slot(id)?;
        self.slots.get_mut(slot)?.as_deref_mut()
    }

    pub(crate) fn remove(&mut self, id: u32) -> Option<T> {
        let slot = self.slot(id)?;
        let removed = self.slots.get_mut(slot)?.take()?;
        self.len -= 1;
        Some(*removed)
    }

    /// All values, oldest first.
    pub(crate) fn iter(&self) -> impl DoubleEndedIterator<Item = &T> {
        self.slots.iter().filter_map(|slot| slot.as_deref())
    }

    /// All values, oldest first.
    pub(crate) fn into_values(self) -> impl Iterator<Item = T> {
        self.slots.into_iter().flatten().map(|value| *value)
    }

    fn slot(&self, id: u32) -> Option<usize> {
        id.checked_sub(self.first_id).map(|slot| slot as usize)
    }
}
