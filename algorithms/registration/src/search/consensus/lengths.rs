//! Distances between correspondences, which an alignment changes by its scale only.

use super::Correspondence;

/// The distances from each correspondence to all others in both clouds, measured when needed.
pub(super) struct Lengths {
    count: usize,
    in_target: Vec<f32>,
    in_source: Vec<f32>,
    is_measured: Vec<bool>,
}

/// How far a length may be off: at least so much, and so much of its own length.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slack {
    pub absolute: f32,
    pub relative: f32,
}

impl Lengths {
    pub fn new(count: usize) -> Self {
        Self {
            count,
            in_target: vec![0.0; count * count],
            in_source: vec![0.0; count * count],
            is_measured: vec![false; count],
        }
    }

    /// Measures from these two to all others, unless that is done.
    pub fn measure(&mut self, pairs: &[Correspondence], ends: [usize; 2]) {
        for end in ends {
            if std::mem::replace(&mut self.is_measured[end], true) {
                continue;
            }
            let row = end * self.count..(end + 1) * self.count;
            let in_target = &mut self.in_target[row.clone()];
            let in_source = &mut self.in_source[row];
            for (idx, pair) in pairs.iter().enumerate() {
                in_target[idx] = (pair.in_target - pairs[end].in_target).norm() as f32;
                in_source[idx] = (pair.in_source - pairs[end].in_source).norm() as f32;
            }
        }
    }

    /// The distance of the two in the target and in the source, which are measured.
    pub fn between(&self, [first, second]: [usize; 2]) -> (f64, f64) {
        let idx = first * self.count + second;
        (
            f64::from(self.in_target[idx]),
            f64::from(self.in_source[idx]),
        )
    }

    /// How many have distances to both ends that keep the scale. Explained ones count too.
    pub fn follower_count(&self, ends: [usize; 2], scale: f64, slack: Slack) -> usize {
        let [first, second] = ends.map(|end| self.rows(end));
        let scale = scale as f32;
        let rows = first
            .0
            .iter()
            .zip(first.1)
            .zip(second.0.iter().zip(second.1));
        let counts = rows.map(|((a, b), (c, d))| {
            let follows = keeps(*a, *b, scale, slack) & keeps(*c, *d, scale, slack);
            u32::from(follows)
        });
        counts.sum::<u32>() as usize
    }

    /// As many as would keep the scale if all correspondences were wrong: each has the source
    /// point of the next.
    pub fn chance_count(&self, ends: [usize; 2], scale: f64, slack: Slack) -> usize {
        let [first, second] = ends.map(|end| self.rows(end));
        let scale = scale as f32;
        let follows = |idx: &usize| {
            let next = (idx + 1) % self.count;
            keeps(first.0[*idx], first.1[next], scale, slack)
                && keeps(second.0[*idx], second.1[next], scale, slack)
        };
        (0..self.count).filter(follows).count()
    }

    /// Which of `live` have distances to both ends that keep the scale, without the ends.
    pub fn followers(
        &self,
        ends: [usize; 2],
        scale: f64,
        slack: Slack,
        live: &[u32],
        followers: &mut Vec<u32>,
    ) {
        let [first, second] = ends.map(|end| self.rows(end));
        let scale = scale as f32;
        followers.clear();
        followers.extend(live.iter().copied().filter(|idx| {
            let idx = *idx as usize;
            !ends.contains(&idx)
                && keeps(first.0[idx], first.1[idx], scale, slack)
                && keeps(second.0[idx], second.1[idx], scale, slack)
        }));
    }

    fn rows(&self, end: usize) -> (&[f32], &[f32]) {
        let row = end * self.count..(end + 1) * self.count;
        (&self.in_target[row.clone()], &self.in_source[row])
    }
}

#[inline(always)]
fn keeps(in_target: f32, in_source: f32, scale: f32, slack: Slack) -> bool {
    let allowed = (slack.relative * in_target).max(slack.absolute);
    (in_target - scale * in_source).abs() < allowed
}
