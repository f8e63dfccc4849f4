//! The record of where the cameras truly were.

use geometry::{Camera, Enu, Timestamp, Transform};

/// `timestamp x y z qx qy qz qw` and a line break, as the TUM benchmark has it.
pub fn tum_line(captured_at: Timestamp, pose: &Transform<Enu, Camera>) -> String {
    let (t, q) = (pose.translation(), pose.rotation());
    format!(
        "{captured_at} {:.7} {:.7} {:.7} {:.8} {:.8} {:.8} {:.8}\n",
        t.x, t.y, t.z, q.i, q.j, q.k, q.w
    )
}
