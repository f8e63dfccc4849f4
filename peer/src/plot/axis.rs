//! Ranges and ticks.

/// Values along one axis, `start < end`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    pub start: f64,
    pub end: f64,
}

impl Range {
    pub fn span(&self) -> f64 {
        self.end - self.start
    }

    fn middle(&self) -> f64 {
        0.5 * (self.start + self.end)
    }

    /// The range about the same middle with at least this span.
    pub fn widened_to(&self, span: f64) -> Self {
        let half = 0.5 * span.max(self.span());
        Self {
            start: self.middle() - half,
            end: self.middle() + half,
        }
    }

    pub fn united(&self, other: &Self) -> Self {
        Self {
            start: self.start.min(other.start),
            end: self.end.max(other.end),
        }
    }

    /// The range that leaves out this share of the values at either end; `None` without values.
    pub fn of(values: impl Iterator<Item = f64>, share_left_out: f64) -> Option<Self> {
        let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
        values.sort_by(f64::total_cmp);
        let left_out = (values.len() as f64 * share_left_out) as usize;
        let kept = values.get(left_out..values.len() - left_out)?;
        Some(Self {
            start: *kept.first()?,
            end: *kept.last()?,
        })
    }

    /// Round values with steps of 1, 2 or 5 times a power of ten, about `count` of them, and the
    /// number of decimals that tell them apart.
    pub fn ticks(&self, count: f64) -> (Vec<f64>, usize) {
        let rough = self.span() / count;
        let magnitude = 10_f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0]
            .into_iter()
            .map(|factor| factor * magnitude)
            .find(|step| *step >= rough)
            .unwrap_or(10.0 * magnitude);
        let first = (self.start / step).ceil() as i64;
        let last = (self.end / step).floor() as i64;
        let ticks = (first..=last).map(|idx| idx as f64 * step).collect();
        let decimals = (-(step * 1.001).log10().floor()).max(0.0) as usize;
        (ticks, decimals)
    }
}
