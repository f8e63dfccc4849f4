//! Which keyframes look like an image.
//!
//! A tree over descriptors that grows with them: a full leaf is divided around some of its own
//! descriptors, so nothing has to be trained or loaded (hierarchical clustering with random
//! centres, Muja & Lowe 2012). One index serves all maps of a machine, since ids are unique.

mod rank;
#[cfg(test)]
mod tests;

pub(crate) use rank::rank;

use features::Descriptor;

use crate::{Keyframe, KeyframeId, VslamMap};

/// Children of a node.
const BRANCH_COUNT: usize = 8;
/// A leaf with more entries is divided.
const LEAF_ENTRIES_MAX: usize = 160;
/// Leaves this deep are not divided: what they hold is too much alike.
const DEPTH_MAX: u8 = 10;
/// Entries in all, 36 bytes each; beyond, a new one takes the place of the oldest of its leaf.
const ENTRIES_MAX: usize = 400_000;
/// Rounds in which the centres of a new node are drawn to the middle of what is near them.
const CENTRE_ROUNDS: usize = 2;
/// Leaves in which a descriptor is looked for: noise sends some to the leaf beside.
const LEAVES_VISITED: usize = 3;
/// Bits in which two descriptors may differ to count as alike.
const DISTANCE_MAX: u32 = 50;

/// An index from descriptors to the keyframes that show them.
///
/// Deterministic. Memory: about 40 bytes per keypoint with a map point, bounded. Cost: a descriptor
/// is compared with about 30 centres, and when it is looked up with the entries of a few leaves:
/// one or two milliseconds for an image of a thousand keypoints, with 20 keyframes or 500.
#[derive(Clone, Debug)]
pub(crate) struct Places {
    nodes: Vec<Node>,
    entry_count: usize,
    keyframe_count: usize,
    /// Ids of all keyframes are below this.
    id_bound: usize,
}

#[derive(Clone, Debug)]
enum Node {
    /// The children are consecutive nodes.
    Branch {
        centres: Box<[Descriptor; BRANCH_COUNT]>,
        first_child: usize,
    },
    Leaf {
        depth: u8,
        entries: Vec<Entry>,
        /// Entries that gave their place to newer ones; the next to go is this, modulo their count.
        replaced_count: usize,
    },
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    descriptor: Descriptor,
    keyframe: KeyframeId,
}

/// A keyframe, and how much of an image looks like what it shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LookAlike {
    pub(crate) keyframe: KeyframeId,
    /// The sum over the image's descriptors of how telling they are.
    pub(crate) score: f32,
    /// Descriptors that it has in common with the image.
    pub(crate) shared_count: u32,
}

impl Default for Places {
    fn default() -> Self {
        Self {
            nodes: vec![Node::leaf(0)],
            entry_count: 0,
            keyframe_count: 0,
            id_bound: 0,
        }
    }
}

impl Node {
    fn leaf(depth: u8) -> Self {
        Self::Leaf {
            depth,
            entries: Vec::new(),
            replaced_count: 0,
        }
    }
}

impl Places {
    /// Adds all keyframes of a map that comes from elsewhere.
    pub(crate) fn insert_all(&mut self, map: &VslamMap) {
        for keyframe in map.keyframes() {
            self.insert(keyframe);
        }
    }

    /// Adds what a keyframe sees of the map.
    pub(crate) fn insert(&mut self, keyframe: &Keyframe) {
        self.keyframe_count += 1;
        self.id_bound = self.id_bound.max(keyframe.id.0 as usize + 1);
        let known = keyframe.observations.iter();
        for observation in known.filter(|one| one.point.is_some()) {
            self.insert_entry(Entry {
                descriptor: observation.descriptor,
                keyframe: keyframe.id,
            });
        }
    }

    /// The keyframes that share descriptors with an image, the most alike first, the newer at a
    /// tie. Some may have been culled since, or be of a map that was dropped.
    pub(crate) fn look_alikes<'a>(
        &self,
        descriptors: impl Iterator<Item = &'a Descriptor>,
    ) -> Vec<LookAlike> {
        let mut votes = vec![(0.0_f32, 0_u32); self.id_bound];
        // The descriptor that voted last for each keyframe: no descriptor votes twice.
        let mut voted_by = vec![u32::MAX; self.id_bound];
        let (mut hits, mut leaves) = (Vec::new(), Vec::new());
        for (descriptor_idx, descriptor) in (0..).zip(descriptors) {
            hits.clear();
            let mut showing = 0.0_f32;
            self.nearest_leaves(descriptor, &mut leaves);
            for &(_, leaf_idx) in leaves.iter().take(LEAVES_VISITED) {
                let (entries, times_more) = self.entries(leaf_idx);
                for entry in entries {
                    let voter = &mut voted_by[entry.keyframe.0 as usize];
                    let alike = entry.descriptor.distance(descriptor) <= DISTANCE_MAX;
                    if alike && *voter != descriptor_idx {
                        *voter = descriptor_idx;
                        hits.push(entry.keyframe);
                        showing += times_more;
                    }
                }
            }
            // What many keyframes show tells little (inverse document frequency).
            let weight = (self.keyframe_count as f32 / showing).ln_1p();
            for keyframe in &hits {
                let vote = &mut votes[keyframe.0 as usize];
                *vote = (vote.0 + weight, vote.1 + 1);
            }
        }
        let mut alike: Vec<LookAlike> = (0..)
            .zip(votes)
            .filter(|(_, (_, shared_count))| *shared_count > 0)
            .map(|(id, (score, shared_count))| LookAlike {
                keyframe: KeyframeId(id),
                score,
                shared_count,
            })
            .collect();
        sort(&mut alike);
        alike
    }

    /// The entries of a leaf, and how many times more there have been.
    fn entries(&self, leaf_idx: usize) -> (&[Entry], f32) {
        match &self.nodes[leaf_idx] {
            Node::Leaf {
                entries,
                replaced_count,
                ..
            } => {
                let count = entries.len().max(1) as f32;
                (entries, 1.0 + *replaced_count as f32 / count)
            }
            Node::Branch { .. } => (&[], 1.0),
        }
    }

    /// The leaves whose centres a descriptor is nearest to, best first (Muja & Lowe, algorithm 2):
    /// `found` begins with them, each with by how many bits it was not the nearest on its way.
    fn nearest_leaves(&self, descriptor: &Descriptor, found: &mut Vec<(u32, usize)>) {
        found.clear();
        found.push((0, 0));
        let mut leaf_count = 0;
        while leaf_count < LEAVES_VISITED.min(found.len()) {
            let (excess, idx) = found[leaf_count];
            match &self.nodes[idx] {
                Node::Leaf { entries, .. } if entries.is_empty() => {
                    found.swap_remove(leaf_count);
                }
                Node::Leaf { .. } => leaf_count += 1,
                Node::Branch {
                    centres,
                    first_child,
                } => {
                    let distances = centres.each_ref().map(|one| one.distance(descriptor));
                    let least = distances.iter().min().copied().unwrap_or(0);
                    found.swap_remove(leaf_count);
                    let children = (*first_child..).zip(distances);
                    found.extend(children.map(|(child, one)| (excess + one - least, child)));
                }
            }
            // Only the nearest need to be in order.
            for slot in leaf_count..LEAVES_VISITED.min(found.len()) {
                let nearest = (slot..found.len()).min_by_key(|other| found[*other]);
                found.swap(slot, nearest.unwrap_or(slot));
            }
        }
    }

    fn leaf_idx(&self, descriptor: &Descriptor) -> usize {
        let mut idx = 0;
        while let Node::Branch {
            centres,
            first_child,
        } = &self.nodes[idx]
        {
            idx = first_child + nearest_centre(centres, descriptor);
        }
        idx
    }

    fn insert_entry(&mut self, entry: Entry) {
        let leaf_idx = self.leaf_idx(&entry.descriptor);
        let index_full = self.entry_count >= ENTRIES_MAX;
        let Node::Leaf {
            depth,
            entries,
            replaced_count,
        } = &mut self.nodes[leaf_idx]
        else {
            return;
        };
        let leaf_full = *depth >= DEPTH_MAX && entries.len() >= LEAF_ENTRIES_MAX;
        if (index_full || leaf_full) && !entries.is_empty() {
            let oldest = *replaced_count % entries.len();
            entries[oldest] = entry;
            *replaced_count += 1;
            return;
        }
        entries.push(entry);
        self.entry_count += 1;
        if entries.len() > LEAF_ENTRIES_MAX {
            self.divide(leaf_idx);
        }
    }

    fn divide(&mut self, leaf_idx: usize) {
        let Node::Leaf { depth, entries, .. } = &mut self.nodes[leaf_idx] else {
            return;
        };
        let (depth, entries) = (*depth + 1, std::mem::take(entries));
        let centres = centres_of(&entries);
        let mut children = vec![Vec::new(); BRANCH_COUNT];
        for entry in entries {
            children[nearest_centre(&centres, &entry.descriptor)].push(entry);
        }
        let first_child = self.nodes.len();
        self.nodes
            .extend(children.into_iter().map(|entries| Node::Leaf {
                depth,
                entries,
                replaced_count: 0,
            }));
        self.nodes[leaf_idx] = Node::Branch {
            centres: Box::new(centres),
            first_child,
        };
    }
}

/// The highest score first, the newer at a tie.
pub(crate) fn sort(alike: &mut [LookAlike]) {
    alike.sort_by(|a, b| {
        let by_score = b.score.total_cmp(&a.score);
        by_score.then(b.keyframe.cmp(&a.keyframe))
    });
}

fn nearest_centre(centres: &[Descriptor; BRANCH_COUNT], descriptor: &Descriptor) -> usize {
    let distances = centres.iter().map(|centre| centre.distance(descriptor));
    let nearest = distances.enumerate().min_by_key(|(_, distance)| *distance);
    nearest.map_or(0, |(idx, _)| idx)
}

/// Entries spread evenly over the leaf, each then drawn to the majority of those nearest to it.
fn centres_of(entries: &[Entry]) -> [Descriptor; BRANCH_COUNT] {
    let stride = entries.len() / BRANCH_COUNT;
    let mut centres: [Descriptor; BRANCH_COUNT] =
        std::array::from_fn(|idx| entries[idx * stride].descriptor);
    for _ in 0..CENTRE_ROUNDS {
        let mut groups: [Vec<Descriptor>; BRANCH_COUNT] = std::array::from_fn(|_| Vec::new());
        for entry in entries {
            groups[nearest_centre(&centres, &entry.descriptor)].push(entry.descriptor);
        }
        for (centre, group) in centres.iter_mut().zip(&groups) {
            *centre = majority(group).unwrap_or(*centre);
        }
    }
    centres
}

/// The descriptor whose bits most of the group have.
fn majority(group: &[Descriptor]) -> Option<Descriptor> {
    let half = group.len() / 2;
    let word = |word_idx: usize| {
        (0..64).fold(0_u64, |word, bit| {
            let set = group.iter().map(|one| (one.0[word_idx] >> bit) & 1);
            let count: u64 = set.sum();
            word | (u64::from(count as usize > half) << bit)
        })
    };
    (!group.is_empty()).then(|| Descriptor(std::array::from_fn(word)))
}
