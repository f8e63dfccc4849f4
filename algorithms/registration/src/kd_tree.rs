//! Nearest points in three dimensions.

/// Points in a leaf; a leaf's distances are computed together.
const LEAF_SIZE: usize = 16;
/// Deeper than any tree of 2³² points: each level halves, down to a leaf.
const STACK_SIZE: usize = 32;
/// Marks a node as a leaf.
const LEAF_AXIS: u32 = 3;

/// A k-d tree over points in single precision that takes more points as they come.
///
/// Split at the median of the longest side, with leaves of 16 points whose coordinates lie
/// together; 0.2 µs per query among 20,000 points (`BENCHMARKS.md` compares it with others).
/// Points that come later form trees of their own, which are merged as soon as the next is as
/// large (Bentley and Saxe 1980): a point is sorted anew log(map size) times in all.
#[derive(Clone, Debug, Default)]
pub struct KdTree {
    points: Vec<[f32; 3]>,
    /// Over consecutive points, large ones first.
    parts: Vec<Part>,
}

/// A tree over the points from `start` to the next part.
#[derive(Clone, Debug)]
struct Part {
    start: usize,
    nodes: Vec<Node>,
    leaves: Vec<Leaf>,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    split: f32,
    /// 0 to 2, or [`LEAF_AXIS`].
    axis: u32,
    /// The right child, or the leaf; the left child follows its parent.
    link: u32,
}

#[derive(Clone, Debug)]
struct Leaf {
    x: [f32; LEAF_SIZE],
    y: [f32; LEAF_SIZE],
    z: [f32; LEAF_SIZE],
    idx: [u32; LEAF_SIZE],
}

/// A point that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    pub idx: u32,
    pub distance_squared: f32,
}

/// The two nearest points: the second bounds how far the query may move before another
/// point than the first can be nearest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct NearestTwo {
    pub first: Neighbour,
    pub second: Neighbour,
}

impl KdTree {
    /// Points that are not finite are never found.
    pub fn new(points: &[[f32; 3]]) -> Self {
        let mut tree = Self::default();
        tree.extend(points);
        tree
    }

    pub(crate) fn point(&self, idx: u32) -> [f32; 3] {
        self.points[idx as usize]
    }

    /// Adds points; their indices follow those that are there.
    pub fn extend(&mut self, points: &[[f32; 3]]) {
        let mut start = self.points.len();
        self.points.extend_from_slice(points);
        // A part no larger than what comes after it is sorted together with that.
        while let Some(last) = self.parts.last() {
            if start - last.start > self.points.len() - start {
                break;
            }
            start = last.start;
            self.parts.pop();
        }
        if start < self.points.len() {
            self.parts.push(Part::new(&self.points, start));
        }
    }

    /// The nearest point within a distance; the lower index wins a tie within a leaf.
    pub fn nearest(&self, query: [f32; 3], distance_squared_max: f32) -> Option<Neighbour> {
        let mut best = Neighbour {
            idx: u32::MAX,
            distance_squared: distance_squared_max,
        };
        self.visit(
            query,
            |leaf, _| {
                let distances = leaf.distances_squared(query);
                if !any_below(&distances, best.distance_squared) {
                    return best.distance_squared;
                }
                for (distance_squared, idx) in distances.into_iter().zip(leaf.idx) {
                    if distance_squared < best.distance_squared {
                        best = Neighbour {
                            idx,
                            distance_squared,
                        };
                    }
                }
                best.distance_squared
            },
            distance_squared_max,
        );
        (best.idx != u32::MAX).then_some(best)
    }

    /// The two nearest points within a distance; of those that are not there the index is
    /// `u32::MAX` and the distance the limit.
    pub(crate) fn nearest_two(&self, query: [f32; 3], distance_squared_max: f32) -> NearestTwo {
        let nobody = Neighbour {
            idx: u32::MAX,
            distance_squared: distance_squared_max,
        };
        let (mut first, mut second) = (nobody, nobody);
        self.visit(
            query,
            |leaf, _| {
                let distances = leaf.distances_squared(query);
                if !any_below(&distances, second.distance_squared) {
                    return second.distance_squared;
                }
                for (distance_squared, idx) in distances.into_iter().zip(leaf.idx) {
                    let one = Neighbour {
                        idx,
                        distance_squared,
                    };
                    if distance_squared < first.distance_squared {
                        (first, second) = (one, first);
                    } else if distance_squared < second.distance_squared {
                        second = one;
                    }
                }
                second.distance_squared
            },
            distance_squared_max,
        );
        NearestTwo { first, second }
    }

    /// The `count` nearest points, nearest first, into `found`; those that are not finite are
    /// near to nothing.
    pub fn nearest_many(&self, query: [f32; 3], count: usize, found: &mut Vec<Neighbour>) {
        found.clear();
        if count == 0 {
            return;
        }
        self.visit(
            query,
            |leaf, limit| {
                let mut limit = limit;
                let distances = leaf.distances_squared(query);
                if !any_below(&distances, limit) {
                    return limit;
                }
                for (distance_squared, idx) in distances.into_iter().zip(leaf.idx) {
                    if distance_squared.is_nan() || distance_squared >= limit {
                        continue;
                    }
                    if found.len() == count {
                        found.pop();
                    }
                    let place =
                        found.partition_point(|one| one.distance_squared <= distance_squared);
                    found.insert(
                        place,
                        Neighbour {
                            idx,
                            distance_squared,
                        },
                    );
                    if found.len() == count {
                        limit = found[count - 1].distance_squared;
                    }
                }
                limit
            },
            f32::INFINITY,
        );
    }

    /// All points within a radius, unordered but always in the same order, into `found`.
    pub fn within(&self, query: [f32; 3], radius: f32, found: &mut Vec<Neighbour>) {
        found.clear();
        let limit = radius * radius;
        self.visit(
            query,
            |leaf, _| {
                let distances = leaf.distances_squared(query);
                if !any_below(&distances, limit) {
                    return limit;
                }
                let near = distances.into_iter().zip(leaf.idx);
                found.extend(near.filter(|(squared, _)| *squared < limit).map(
                    |(distance_squared, idx)| Neighbour {
                        idx,
                        distance_squared,
                    },
                ));
                limit
            },
            limit,
        );
    }

    fn visit(&self, query: [f32; 3], mut leaf_visit: impl FnMut(&Leaf, f32) -> f32, limit: f32) {
        let mut limit = limit;
        for part in &self.parts {
            limit = part.visit(query, &mut leaf_visit, limit);
        }
    }
}

impl Part {
    fn new(points: &[[f32; 3]], start: usize) -> Self {
        let mut order: Vec<u32> = (start as u32..points.len() as u32).collect();
        order.retain(|idx| points[*idx as usize].iter().all(|one| one.is_finite()));
        let mut part = Self {
            start,
            nodes: Vec::new(),
            leaves: Vec::new(),
        };
        if !order.is_empty() {
            part.build(points, &mut order);
        }
        part
    }

    fn build(&mut self, points: &[[f32; 3]], order: &mut [u32]) {
        let node_idx = self.nodes.len();
        if order.len() <= LEAF_SIZE {
            self.nodes.push(Node {
                split: 0.0,
                axis: LEAF_AXIS,
                link: self.leaves.len() as u32,
            });
            self.leaves.push(Leaf::new(points, order));
            return;
        }
        let axis = longest_side(points, order);
        let middle = order.len() / 2;
        order.select_nth_unstable_by(middle, |a, b| {
            let (a_value, b_value) = (points[*a as usize][axis], points[*b as usize][axis]);
            a_value.total_cmp(&b_value).then(a.cmp(b))
        });
        self.nodes.push(Node {
            split: points[order[middle] as usize][axis],
            axis: axis as u32,
            link: 0,
        });
        let (left, right) = order.split_at_mut(middle);
        self.build(points, left);
        self.nodes[node_idx].link = self.nodes.len() as u32;
        self.build(points, right);
    }

    /// Visits leaves, near ones first, that may hold points nearer than the limit; each visit
    /// returns the limit from then on.
    #[inline]
    fn visit(
        &self,
        query: [f32; 3],
        leaf_visit: &mut impl FnMut(&Leaf, f32) -> f32,
        mut limit: f32,
    ) -> f32 {
        if self.nodes.is_empty() {
            return limit;
        }
        // Node, squared distance to its box, and the offsets to the box along the axes (Arya and
        // Mount 1993).
        let mut stack = [(0_u32, 0.0_f32, [0.0_f32; 3]); STACK_SIZE];
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let (mut node_idx, box_squared, offsets) = stack[height];
            if box_squared >= limit {
                continue;
            }
            loop {
                let node = self.nodes[node_idx as usize];
                if node.axis == LEAF_AXIS {
                    limit = leaf_visit(&self.leaves[node.link as usize], limit);
                    break;
                }
                let axis = node.axis as usize;
                let offset = query[axis] - node.split;
                let (near, far) = if offset < 0.0 {
                    (node_idx + 1, node.link)
                } else {
                    (node.link, node_idx + 1)
                };
                let old = offsets[axis];
                let far_squared = box_squared - old * old + offset * offset;
                if far_squared < limit {
                    let mut far_offsets = offsets;
                    far_offsets[axis] = offset;
                    stack[height] = (far, far_squared, far_offsets);
                    height += 1;
                }
                node_idx = near;
            }
        }
        limit
    }
}

impl Leaf {
    fn new(points: &[[f32; 3]], order: &mut [u32]) -> Self {
        order.sort_unstable();
        let mut leaf = Self {
            x: [f32::INFINITY; LEAF_SIZE],
            y: [f32::INFINITY; LEAF_SIZE],
            z: [f32::INFINITY; LEAF_SIZE],
            idx: [u32::MAX; LEAF_SIZE],
        };
        for (place, idx) in order.iter().enumerate() {
            let [x, y, z] = points[*idx as usize];
            (leaf.x[place], leaf.y[place], leaf.z[place], leaf.idx[place]) = (x, y, z, *idx);
        }
        leaf
    }

    #[inline]
    fn distances_squared(&self, query: [f32; 3]) -> [f32; LEAF_SIZE] {
        let mut distances = [0.0; LEAF_SIZE];
        for (place, distance) in distances.iter_mut().enumerate() {
            let x = self.x[place] - query[0];
            let y = self.y[place] - query[1];
            let z = self.z[place] - query[2];
            *distance = x * x + y * y + z * z;
        }
        distances
    }
}

/// Asked of all at once, since most leaves that are visited hold nothing nearer.
#[inline]
fn any_below(distances: &[f32; LEAF_SIZE], limit: f32) -> bool {
    let below = distances.iter();
    below.fold(false, |any, distance| any | (*distance < limit))
}

fn longest_side(points: &[[f32; 3]], order: &[u32]) -> usize {
    let mut lowest = [f32::INFINITY; 3];
    let mut highest = [f32::NEG_INFINITY; 3];
    for idx in order {
        for (axis, value) in points[*idx as usize].iter().enumerate() {
            lowest[axis] = lowest[axis].min(*value);
            highest[axis] = highest[axis].max(*value);
        }
    }
    let side = |axis: usize| highest[axis] - lowest[axis];
    let mut longest = 0;
    for axis in 1..3 {
        if side(axis) > side(longest) {
            longest = axis;
        }
    }
    longest
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn squared(a: [f32; 3], b: [f32; 3]) -> f32 {
        (0..3)
            .map(|axis| (a[axis] - b[axis]) * (a[axis] - b[axis]))
            .sum()
    }

    proptest! {
        /// Goal: the tree agrees with looking at every point.
        #[test]
        fn finds_what_looking_at_all_finds(
            points in prop::collection::vec(prop::array::uniform3(-2.0_f32..2.0), 0..300),
            query in prop::array::uniform3(-3.0_f32..3.0),
            count in 1_usize..20,
            part_size in 1_usize..300,
        ) {
            let mut tree = KdTree::default();
            for part in points.chunks(part_size) {
                tree.extend(part);
            }
            let mut all: Vec<f32> = points.iter().map(|one| squared(*one, query)).collect();
            all.sort_by(f32::total_cmp);
            let nearest = tree.nearest(query, f32::INFINITY);
            prop_assert_eq!(nearest.map(|one| one.distance_squared), all.first().copied());
            let two = tree.nearest_two(query, f32::INFINITY);
            let distances = [two.first, two.second].map(|one| one.distance_squared);
            prop_assert_eq!(&distances[..all.len().min(2)], &all[..all.len().min(2)]);
            let mut found = Vec::new();
            tree.nearest_many(query, count, &mut found);
            let distances: Vec<f32> = found.iter().map(|one| one.distance_squared).collect();
            prop_assert_eq!(&distances[..], &all[..count.min(all.len())]);
            tree.within(query, 1.5, &mut found);
            prop_assert_eq!(found.len(), all.iter().filter(|one| **one < 2.25).count());
        }
    }

    #[test]
    fn a_tree_that_grows_has_few_parts() {
        let mut tree = KdTree::default();
        for idx in 0..1000 {
            tree.extend(&[[idx as f32, 0.0, 0.0]; 7]);
            assert!(tree.parts.len() <= 13, "{}", tree.parts.len());
        }
        assert_eq!(tree.nearest([500.2, 0.0, 0.0], 1.0).unwrap().idx, 3500);
    }

    #[test]
    fn passes_over_points_that_are_not_finite() {
        let tree = KdTree::new(&[[f32::NAN, 0.0, 0.0], [5.0, 0.0, 0.0]]);
        assert_eq!(tree.nearest([0.0; 3], f32::INFINITY).unwrap().idx, 1);
        assert!(KdTree::new(&[]).nearest([0.0; 3], f32::INFINITY).is_none());
        let mut found = Vec::new();
        tree.nearest_many([0.0; 3], 2, &mut found);
        assert_eq!(found.iter().map(|one| one.idx).collect::<Vec<_>>(), [1]);
        tree.nearest_many([f32::NAN; 3], 2, &mut found);
        assert!(found.is_empty());
    }

    #[test]
    fn many_equal_points_do_not_overflow_the_stack() {
        let tree = KdTree::new(&vec![[1.0; 3]; 5000]);
        let mut found = Vec::new();
        tree.nearest_many([1.0; 3], 7, &mut found);
        assert_eq!(found.len(), 7);
    }
}
