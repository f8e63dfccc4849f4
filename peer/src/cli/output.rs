//! The one place that writes to stdout and stderr: results there, diagnostics here.

use serde::Serialize;

/// Prints one JSON object to stdout.
#[expect(
    clippy::print_stdout,
    reason = "results go to stdout, through this module"
)]
pub fn print_json(value: &impl Serialize) -> anyhow::Result<()> {
    println!("{}", serde_json::to_string_pretty(value)?);
    Ok(())
}

/// Prints one line of a result for a reader to stdout.
#[expect(
    clippy::print_stdout,
    reason = "results go to stdout, through this module"
)]
pub fn print_line(line: &str) {
    println!("{line}");
}

/// Prints one line of diagnostics to stderr.
pub fn diagnose(line: &str) {
    eprintln!("{line}");
}

/// Sends log lines to stderr; `RUST_LOG` chooses which, warnings of this project by default.
pub fn start_log() {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("warn,zenoh=error"));
    let subscriber = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .finish();
    // Fails only when a test has already installed one, which is then used.
    let _ = tracing::subscriber::set_global_default(subscriber);
}

/// A progress bar on stderr, drawn only on a terminal.
pub struct Progress {
    bar: indicatif::ProgressBar,
}

impl Progress {
    /// - `what`: the word before the bar.
    pub fn start(what: &'static str, length: u64) -> Self {
        let bar = indicatif::ProgressBar::new(length);
        let template = "{prefix} [{wide_bar}] {pos}/{len} {eta}";
        if let Ok(style) = indicatif::ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_prefix(what);
        Self { bar }
    }

    pub fn advance(&self, step: u64) {
        self.bar.inc(step);
    }

    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}
