//! Goal: what was missed in an outage is fetched after it. Method: cut all links for 5 s while
//! the anchor maps, and compare what it published with what the peer holds in the end.

use tempfile::TempDir;

use crate::processes::{succeed, summary, team_of};
use crate::recordings::RECORDINGS;

#[test]
fn what_was_missed_in_an_outage_is_fetched_after_it() {
    let folder = TempDir::new().unwrap();
    succeed(
        team_of(&RECORDINGS.ground, &RECORDINGS.fixes, folder.path())
            .args(["--outage", "6..11", "--peer"])
            .arg(&RECORDINGS.drone),
    );
    let (anchor, peer) = (
        summary(folder.path(), "anchor1"),
        summary(folder.path(), "peer1"),
    );
    let published = anchor["counters"]["chunks_published"].as_u64().unwrap();
    let received = peer["counters"]["chunks_received"].as_u64().unwrap();
    assert!(published > 10, "{anchor}");
    // What was published in the very last ticks may find the peer gone.
    assert!(
        received + 3 >= published,
        "{published} published, {received} received"
    );
    assert!(
        peer["counters"]["chunks_pulled"].as_u64().unwrap() > 0,
        "{peer}"
    );
    assert!(peer["without_link_s"].as_f64().unwrap() > 4.0, "{peer}");
    assert_eq!(peer["state"], "Global", "{peer}");
}
