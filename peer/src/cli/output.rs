//! The one place that writes to stdout and stderr: results there, diagnostics here.

use std::ffi::OsStr;
use std::io::{ErrorKind, IsTerminal, Write};

use anyhow::Context;
use serde::Serialize;

/// Prints one JSON object to stdout.
pub fn print_json(value: &impl Serialize) -> anyhow::Result<()> {
    write_line(&serde_json::to_string_pretty(value)?).context("cannot write to standard output")
}

/// Prints one line of a result for a reader to stdout.
pub fn print_line(line: &str) {
    if let Err(error) = write_line(line) {
        diagnose(&format!("cannot write to standard output: {error}"));
    }
}

/// A reader who has gone is no error; a full disk is.
fn write_line(line: &str) -> std::io::Result<()> {
    let mut stdout = std::io::stdout().lock();
    match writeln!(stdout, "{line}").and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(error),
        _ => Ok(()),
    }
}

/// Prints one line of diagnostics to stderr.
pub fn diagnose(line: &str) {
    // `eprintln!` would panic where nothing can be written; this is never an error.
    let _ = Diagnostics(std::io::stderr()).write_all(format!("{line}\n").as_bytes());
}

/// Takes everything and loses what cannot be written: nobody is left to be told, and a full disk
/// under a vehicle's log is no reason not to fly.
struct Diagnostics<W>(W);

impl<W: Write> Write for Diagnostics<W> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let _ = self.0.write_all(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        let _ = self.0.flush();
        Ok(())
    }
}

/// Sends log lines to stderr; `RUST_LOG` chooses which, warnings of this project by default.
pub fn start_log() {
    let default = format!("warn,{}", crate::link::LOG_LEVELS);
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new(default));
    let subscriber = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(wants_color(
            std::io::stderr().is_terminal(),
            std::env::var_os("NO_COLOR").as_deref(),
        ))
        .with_writer(|| Diagnostics(std::io::stderr()))
        // They would be told with `eprintln!`, which panics where nothing can be written.
        .log_internal_errors(false)
        .finish();
    // Fails only when a test has already installed one, which is then used.
    let _ = tracing::subscriber::set_global_default(subscriber);
}

/// Colour is for a person at a terminal who has not said no (<https://no-color.org>).
fn wants_color(is_terminal: bool, no_color: Option<&OsStr>) -> bool {
    is_terminal && no_color.is_none_or(OsStr::is_empty)
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A full disk.
    struct Full;

    impl Write for Full {
        fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
            Err(ErrorKind::StorageFull.into())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Err(ErrorKind::StorageFull.into())
        }
    }

    #[test]
    fn diagnostics_that_cannot_be_written_are_no_error() {
        let mut out = Diagnostics(Full);
        assert_eq!(out.write(b"lost").unwrap(), 4);
        out.flush().unwrap();
    }

    #[test]
    fn color_is_for_terminals_of_those_who_have_not_said_no() {
        assert!(wants_color(true, None));
        assert!(wants_color(true, Some(OsStr::new(""))));
        assert!(!wants_color(true, Some(OsStr::new("1"))));
        assert!(!wants_color(false, None));
    }
}
