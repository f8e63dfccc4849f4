//! The Python client's packages, in an environment of their own below `target/`.

use std::path::PathBuf;
use std::process::{Command, Stdio};

use crate::check::workspace_root;

/// What the client of the README imports.
const PACKAGES: [&str; 3] = ["eclipse-zenoh==1.10.2", "cbor2>=5.6,<6", "numpy>=1.26,<3"];

/// Installs the packages; `None`, with the reason on stderr, where Python or its index is absent.
///
/// The tests that need them then say "skipped".
pub fn install() -> Option<PathBuf> {
    let environment = workspace_root().join("target/python");
    let interpreter = environment.join("bin/python");
    if !interpreter.exists()
        && !quiet(
            Command::new("python3")
                .arg("-m")
                .arg("venv")
                .arg(&environment),
        )
    {
        eprintln!("no Python with venv: the client's test will be skipped");
        return None;
    }
    if quiet(Command::new(&interpreter).args(["-c", "import zenoh, cbor2, numpy"])) {
        return Some(interpreter);
    }
    let pip = [
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
    ];
    if !quiet(Command::new(&interpreter).args(pip).args(PACKAGES)) {
        eprintln!("pip could not install {PACKAGES:?}: the client's test will be skipped");
        return None;
    }
    Some(interpreter)
}

fn quiet(command: &mut Command) -> bool {
    let status = command.stdout(Stdio::null()).stderr(Stdio::null()).status();
    status.is_ok_and(|status| status.success())
}
