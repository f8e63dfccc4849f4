//! What became of a vehicle that did not end as it should.

use std::fmt;
use std::path::PathBuf;
use std::process::ExitStatus;

/// Which vehicle, what happened to it, and where to read on.
#[derive(Debug)]
pub struct VehicleFailure {
    pub id: String,
    pub process: u32,
    pub trouble: Trouble,
    /// The last thing that it said.
    pub last_line: Option<String>,
    /// Why it says that it ended: not in its log if the disk is full.
    pub error: Option<String>,
    pub log: PathBuf,
}

#[derive(Debug, PartialEq)]
pub enum Trouble {
    Ended {
        how: String,
    },
    Silent {
        waited_s: f64,
    },
    /// Somebody else says so.
    Lost {
        reason: String,
    },
}

impl fmt::Display for VehicleFailure {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "vehicle {} (process {}) ", self.id, self.process)?;
        match &self.trouble {
            Trouble::Ended { how } => write!(out, "{how}")?,
            Trouble::Silent { waited_s } => {
                write!(out, "has not reported for {waited_s:.0} s; is it stopped?")?;
            }
            Trouble::Lost { reason } => write!(out, "{reason}")?,
        }
        match (&self.last_line, &self.error) {
            (Some(line), _) => {
                let log = self.log.display();
                write!(out, "; it last said {line:?}; all that it said: {log}")
            }
            (None, Some(error)) => write!(out, ": {error}; its log holds nothing"),
            (None, None) => write!(out, "; it said nothing of its own"),
        }
    }
}

impl std::error::Error for VehicleFailure {}

/// An exit status as the end of a sentence.
pub fn how_it_ended(status: ExitStatus) -> String {
    #[cfg(unix)]
    {
        use std::os::unix::process::ExitStatusExt;
        if let Some(number) = status.signal() {
            let name = match number {
                4 => " (SIGILL)",
                6 => " (SIGABRT)",
                7 => " (SIGBUS)",
                9 => " (SIGKILL; the system does that too when memory runs out)",
                11 => " (SIGSEGV)",
                15 => " (SIGTERM)",
                _ => "",
            };
            return format!("was killed by signal {number}{name}");
        }
    }
    match status.code() {
        Some(0) => "ended early".to_owned(),
        Some(code) => format!("ended with exit code {code}"),
        None => format!("ended: {status}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    #[test]
    fn names_the_signal_or_the_exit_code_and_the_log() {
        use std::os::unix::process::ExitStatusExt;
        let failure = |wait_status, last_line: Option<&str>, error: Option<&str>| VehicleFailure {
            id: "peer1".to_owned(),
            process: 42,
            trouble: Trouble::Ended {
                how: how_it_ended(ExitStatus::from_raw(wait_status)),
            },
            last_line: last_line.map(str::to_owned),
            error: error.map(str::to_owned),
            log: PathBuf::from("t/peer1.log"),
        };
        let killed = failure(11, None, None).to_string();
        assert_eq!(
            killed,
            "vehicle peer1 (process 42) was killed by signal 11 (SIGSEGV); it said nothing of its \
             own"
        );
        let failed = failure(1 << 8, Some("error: no room"), Some("no room")).to_string();
        assert_eq!(
            failed,
            "vehicle peer1 (process 42) ended with exit code 1; it last said \"error: no room\"; \
             all that it said: t/peer1.log"
        );
        let unlogged = failure(1 << 8, None, Some("disk full")).to_string();
        assert_eq!(
            unlogged,
            "vehicle peer1 (process 42) ended with exit code 1: disk full; its log holds nothing"
        );
    }
}
