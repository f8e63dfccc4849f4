//! Which stamps of a live driver can be believed.

use geometry::Timestamp;

/// A stamp this far beyond the one before is believed once the next one agrees with it.
const LEAP_S: f64 = 60.0;

/// Lets stamps through that increase, and no single one that would shut out all that follow.
#[derive(Debug, Default)]
pub struct StampGate {
    newest: Option<Timestamp>,
    leap: Option<Timestamp>,
}

impl StampGate {
    /// Takes the next stamp, or says why what bears it is left out.
    pub fn admit(&mut self, stamp: Timestamp) -> Result<(), String> {
        let leap = self.leap.take();
        let Some(newest) = self.newest else {
            self.newest = Some(stamp);
            return Ok(());
        };
        if stamp <= newest {
            return Err(format!(
                "its time stamp {stamp} is not after the one before, {newest}"
            ));
        }
        let agrees = leap.is_some_and(|leap| stamp > leap && stamp - leap < LEAP_S);
        if stamp - newest > LEAP_S && !agrees {
            self.leap = Some(stamp);
            return Err(format!(
                "its time stamp {stamp} leaps ahead of the one before, {newest}"
            ));
        }
        self.newest = Some(stamp);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lets_increasing_stamps_through_and_no_single_leap() {
        let check = |stamps: &[i64], expected: &[i64]| {
            let mut gate = StampGate::default();
            let admitted = stamps.iter().copied().filter(|seconds| {
                let stamp = Timestamp::from_nanoseconds(seconds * 1_000_000_000);
                gate.admit(stamp).is_ok()
            });
            assert_eq!(admitted.collect::<Vec<_>>(), expected, "{stamps:?}");
        };
        check(&[1, 2, 3], &[1, 2, 3]);
        check(&[1, 2, 2, 1, 3], &[1, 2, 3]);
        check(&[1, 9_000_000, 2, 3], &[1, 2, 3]);
        // The camera really stood still for long: one frame is the price.
        check(&[1, 500, 501, 502], &[1, 501, 502]);
        check(&[1, 500, 9_000, 2], &[1, 2]);
    }
}
