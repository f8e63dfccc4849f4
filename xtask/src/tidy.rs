//! The rules that neither the compiler nor clippy knows. Also run as a test.

mod layers;
mod lines;
mod links;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::check::workspace_root;

/// The largest file that may be committed, except the lock file.
const FILE_SIZE_BYTES_MAX: u64 = 512 * 1024;

/// Where a rule is broken, and how.
pub struct Offence {
    /// Relative to the root.
    pub path: PathBuf,
    /// From one; zero where the whole file offends.
    pub line: usize,
    pub what: String,
}

/// Checks every file that git knows.
pub fn run() -> Result<()> {
    let offences = check_tree(&workspace_root())?;
    for Offence { path, line, what } in &offences {
        eprintln!("{}:{line}: {what}", path.display());
    }
    if !offences.is_empty() {
        bail!("{} offences against the rules of tidy", offences.len());
    }
    Ok(())
}

fn check_tree(root: &Path) -> Result<Vec<Offence>> {
    let mut offences = layers::check(root)?;
    for path in tracked_files(root)? {
        let full_path = root.join(&path);
        let Ok(size) = fs::metadata(&full_path).map(|metadata| metadata.len()) else {
            continue;
        };
        if size > FILE_SIZE_BYTES_MAX && !path.ends_with("Cargo.lock") {
            let what = format!("{size} bytes, the limit is {FILE_SIZE_BYTES_MAX}");
            offences.push(Offence {
                path: path.clone(),
                line: 0,
                what,
            });
        }
        let Ok(text) = fs::read_to_string(&full_path) else {
            continue;
        };
        lines::check(&path, &text, &mut offences);
        links::check(root, &path, &text, &mut offences);
    }
    Ok(offences)
}

/// Files in the index and new ones that are not ignored.
fn tracked_files(root: &Path) -> Result<Vec<PathBuf>> {
    let output = Command::new("git")
        .args([
            "ls-files",
            "--cached",
            "--others",
            "--exclude-standard",
            "-z",
        ])
        .current_dir(root)
        .output()
        .context("cannot start git to list the files")?;
    if !output.status.success() {
        bail!(
            "git ls-files: {}",
            String::from_utf8_lossy(&output.stderr).trim()
        );
    }
    let list = String::from_utf8(output.stdout).context("a file name is not UTF-8")?;
    Ok(list
        .split('\0')
        .filter(|name| !name.is_empty())
        .map(PathBuf::from)
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tree_is_tidy() {
        // A source archive without git has nothing to list.
        if !workspace_root().join(".git").exists() {
            return;
        }
        let offences = check_tree(&workspace_root()).unwrap();
        let list: Vec<String> = offences
            .iter()
            .map(|o| format!("{}:{}: {}", o.path.display(), o.line, o.what))
            .collect();
        assert!(list.is_empty(), "{}", list.join("\n"));
    }
}
