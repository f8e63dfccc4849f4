//! Python packages that are no part of the product, in environments of their own below `target/`.

use std::path::PathBuf;
use std::process::{Command, Stdio};

use crate::check::workspace_root;

/// What the client of the README imports.
const PACKAGES: [&str; 3] = ["eclipse-zenoh==1.10.2", "cbor2>=5.6,<6", "numpy>=1.26,<3"];

/// What our registration is compared with.
const PEER_PACKAGES: [&str; 2] = ["small_gicp==1.0.1", "numpy>=1.26,<3"];

/// Installs the client's packages; `None`, with the reason on stderr, where Python or its index is
/// absent.
///
/// The tests that need them then say "skipped".
pub fn install() -> Option<PathBuf> {
    let installed = install_into("target/python", "import zenoh, cbor2, numpy", &PACKAGES);
    if installed.is_none() {
        eprintln!("the client's test will be skipped");
    }
    installed
}

/// Installs what ours is compared with, apart from the client's packages.
pub fn install_peers() -> Option<PathBuf> {
    let check = "import small_gicp, numpy";
    install_into("target/python-peers", check, &PEER_PACKAGES)
}

/// - `check`: a program that fails unless the packages are there.
fn install_into(folder: &str, check: &str, packages: &[&str]) -> Option<PathBuf> {
    let environment = workspace_root().join(folder);
    let interpreter = environment.join("bin/python");
    if !interpreter.exists()
        && !quiet(
            Command::new("python3")
                .arg("-m")
                .arg("venv")
                .arg(&environment),
        )
    {
        eprintln!("no Python with venv");
        return None;
    }
    if quiet(Command::new(&interpreter).args(["-c", check])) {
        return Some(interpreter);
    }
    let pip = [
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
    ];
    if !quiet(Command::new(&interpreter).args(pip).args(packages)) {
        eprintln!("pip could not install {packages:?}");
        return None;
    }
    Some(interpreter)
}

fn quiet(command: &mut Command) -> bool {
    let status = command.stdout(Stdio::null()).stderr(Stdio::null()).status();
    status.is_ok_and(|status| status.success())
}
