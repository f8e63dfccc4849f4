//! Connected components of a mask that is given as runs of pixels, in bounded memory and time.

/// Pixels `x_start..x_end` of row `y`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Run {
    pub y: u16,
    pub x_start: u16,
    pub x_end: u16,
}

/// Pixels that touch each other, also by a corner.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Component {
    pub area_px: u32,
    pub left: u16,
    pub top: u16,
    /// The last column and row that belong to it.
    pub right: u16,
    pub bottom: u16,
    sum_x: u64,
    sum_y: u64,
}

impl Component {
    fn of(run: Run) -> Self {
        let (start, end) = (u64::from(run.x_start), u64::from(run.x_end));
        let length = end - start;
        Self {
            area_px: length as u32,
            left: run.x_start,
            top: run.y,
            right: run.x_end - 1,
            bottom: run.y,
            sum_x: (start + end - 1) * length / 2,
            sum_y: length * u64::from(run.y),
        }
    }

    fn absorb(&mut self, other: &Self) {
        self.area_px += other.area_px;
        self.left = self.left.min(other.left);
        self.top = self.top.min(other.top);
        self.right = self.right.max(other.right);
        self.bottom = self.bottom.max(other.bottom);
        self.sum_x += other.sum_x;
        self.sum_y += other.sum_y;
    }

    pub fn centroid_px(&self) -> [f64; 2] {
        [self.sum_x, self.sum_y].map(|sum| sum as f64 / f64::from(self.area_px))
    }
}

/// The runs of a row's pixels that are at least as bright as a threshold.
pub(super) fn bright_runs(row: &[u8], y: usize, threshold: u8) -> impl Iterator<Item = Run> {
    let mut x = 0;
    std::iter::from_fn(move || {
        let start = x + row[x..].iter().position(|pixel| *pixel >= threshold)?;
        let length = row[start..].iter().position(|pixel| *pixel < threshold);
        x = length.map_or(row.len(), |length| start + length);
        Some(Run {
            y: y as u16,
            x_start: start as u16,
            x_end: x as u16,
        })
    })
}

/// More runs than there is room for: the picture is full of noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TooManyRuns;

/// Joins runs of neighbouring rows as they come, row by row from the top.
#[derive(Clone, Debug)]
pub(super) struct RunJoiner {
    run_count_max: usize,
    runs: Vec<Run>,
    /// For each run, another run of its component, nearer to the first; the first names itself.
    parents: Vec<u16>,
    components: Vec<Component>,
    /// Where in `runs` the row before the current one starts, and the current one.
    previous_start: usize,
    current_start: usize,
}

impl RunJoiner {
    pub fn with_run_count_max(run_count_max: u16) -> Self {
        let count = usize::from(run_count_max);
        Self {
            run_count_max: count,
            runs: Vec::with_capacity(count),
            parents: Vec::with_capacity(count),
            components: Vec::with_capacity(count),
            previous_start: 0,
            current_start: 0,
        }
    }

    pub fn clear(&mut self) {
        self.runs.clear();
        self.parents.clear();
        self.previous_start = 0;
        self.current_start = 0;
    }

    /// Adds a run; rows come in order, and runs of a row from left to right, not touching.
    pub fn push(&mut self, run: Run) -> Result<(), TooManyRuns> {
        if self.runs.len() == self.run_count_max {
            return Err(TooManyRuns);
        }
        self.start_row(run.y);
        let idx = self.runs.len();
        self.runs.push(run);
        self.parents.push(idx as u16);
        // Runs of the row above that end before this one starts cannot touch later ones either.
        while self.previous_start < self.current_start
            && self.runs[self.previous_start].x_end < run.x_start
        {
            self.previous_start += 1;
        }
        for above in self.previous_start..self.current_start {
            if self.runs[above].x_start > run.x_end {
                break;
            }
            self.join(above, idx);
        }
        Ok(())
    }

    /// All components, in the order of their first runs.
    pub fn components(&mut self) -> &[Component] {
        self.components.clear();
        for idx in 0..self.runs.len() {
            let piece = Component::of(self.runs[idx]);
            let root = self.root(idx);
            if root == idx {
                // Roots come before all others of their component, and now name their component.
                self.components.push(piece);
                self.parents[idx] = (self.components.len() - 1) as u16 | ROOT;
            } else {
                let component = usize::from(self.parents[root] & !ROOT);
                self.components[component].absorb(&piece);
                self.parents[idx] = root as u16;
            }
        }
        self.runs.clear();
        &self.components
    }

    fn start_row(&mut self, y: u16) {
        let Some(last) = self.runs.last() else {
            return;
        };
        if last.y == y {
            return;
        }
        let end = self.runs.len();
        let touches = last.y + 1 == y;
        self.previous_start = if touches { self.current_start } else { end };
        self.current_start = end;
    }

    fn root(&mut self, mut idx: usize) -> usize {
        loop {
            let parent = self.parents[idx];
            if parent & ROOT != 0 || usize::from(parent) == idx {
                return idx;
            }
            let grandparent = self.parents[usize::from(parent)];
            if grandparent & ROOT == 0 {
                self.parents[idx] = grandparent;
            }
            idx = usize::from(parent);
        }
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        let (first, second) = (a.min(b), a.max(b));
        self.parents[second] = first as u16;
    }
}

/// Marks a parent entry as the number of a component; run numbers stay below.
const ROOT: u16 = 1 << 15;
