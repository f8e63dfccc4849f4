//! Starting the binary, and reading what it leaves behind.

use std::ffi::OsStr;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

pub fn starling() -> Command {
    Command::new(env!("CARGO_BIN_EXE_starling-tested"))
}

/// A flight with this anchor, told as JSON; its peers are still to be named.
///
/// - `anchor`: a recording, `FOLDER` or `FOLDER@A..B`.
pub fn team_of(anchor: impl AsRef<OsStr>, fixes: &Path, out: &Path) -> Command {
    let mut command = starling();
    command.args(["team", "--json", "--anchor"]).arg(anchor);
    command.arg("--fixes").arg(fixes).arg("--out").arg(out);
    command
}

/// Runs to the end; panics with its diagnostics if it fails.
pub fn succeed(command: &mut Command) -> Output {
    let output = command.output().unwrap();
    let diagnostics = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?} failed: {diagnostics}");
    output
}

/// The summary that a vehicle wrote.
pub fn summary(folder: &Path, id: &str) -> Value {
    let text = std::fs::read_to_string(folder.join(format!("{id}.json"))).unwrap();
    serde_json::from_str(&text).unwrap()
}

/// A vehicle that runs beside the test and is ended with it.
pub struct Vehicle {
    child: Child,
    pub endpoint: String,
}

impl Vehicle {
    /// Starts `run` on a configuration and waits until it listens.
    ///
    /// - `tables`: what comes after `id` and `out` in the configuration.
    pub fn start(folder: &Path, id: &str, connect: &[&str], tables: &str) -> Self {
        let path = folder.join(format!("{id}.toml"));
        let text = format!(
            "id = {id:?}\nout = {folder:?}\n{tables}\n\
             [zenoh]\nlisten = [\"tcp/127.0.0.1:0\"]\nconnect = {connect:?}\n\
             [estimation]\nseed = 1\n"
        );
        std::fs::write(&path, text).unwrap();
        let mut child = starling()
            .args(["run", "--config"])
            .arg(&path)
            .stderr(Stdio::piped())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let mut heard = Vec::new();
        let endpoint = loop {
            let line = lines
                .next()
                .unwrap_or_else(|| panic!("{id} ended early: {heard:?}"));
            let line = line.unwrap();
            if let Some(start) = line.find("tcp/127.0.0.1:") {
                let end = line[start..]
                    .find('"')
                    .map_or(line.len(), |end| start + end);
                break line[start..end].to_owned();
            }
            heard.push(line);
        };
        // What else it says is read away, so that its pipe never fills.
        std::thread::spawn(move || lines.map_while(Result::ok).for_each(drop));
        Self { child, endpoint }
    }

    /// Asks it to end, as Ctrl-C does.
    pub fn interrupt(&self) {
        succeed(Command::new("kill").args(["-INT", &self.child.id().to_string()]));
    }

    /// Waits until it ends by itself; its exit code.
    pub fn wait(mut self, patience: Duration) -> i32 {
        let deadline = Instant::now() + patience;
        while self.child.try_wait().unwrap().is_none() {
            assert!(Instant::now() < deadline, "the vehicle does not end");
            std::thread::sleep(Duration::from_millis(50));
        }
        let code = self.child.wait().unwrap().code();
        assert!(code == Some(0) || code == Some(3), "{code:?}");
        code.unwrap()
    }
}

impl Drop for Vehicle {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
