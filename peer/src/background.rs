//! Long jobs beside the frames.

/// Runs a job on a thread of its own.
///
/// Where the system has none to give, the job is dropped; whoever waits for its result goes on
/// without it.
pub fn spawn(job: Box<dyn FnOnce() + Send>) {
    let name = "background".to_owned();
    if let Err(e) = std::thread::Builder::new().name(name).spawn(job) {
        tracing::warn!("no thread for the adjustment of the whole map, which is left out: {e}");
    }
}
