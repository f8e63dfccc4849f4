//! Who may know whom. The tree is the architecture, so a new arrow is a decision made here.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use serde_json::Value;

use super::Offence;

/// For every member: the members that it may depend on.
const LAYERS: [(&str, &[&str]); 13] = [
    ("geometry", &[]),
    ("camera", &["geometry"]),
    ("features", &["camera"]),
    ("geodesy", &["geometry"]),
    ("keeping", &["camera", "geometry"]),
    ("vslam", &["camera", "features", "geometry"]),
    ("registration", &["camera", "features", "geometry"]),
    ("protocol", &["geodesy", "geometry"]),
    (
        "anchor",
        &[
            "camera", "features", "geodesy", "geometry", "protocol", "vslam",
        ],
    ),
    ("sim", &["camera", "geometry"]),
    (
        "peer",
        &[
            "anchor",
            "camera",
            "features",
            "geodesy",
            "geometry",
            "keeping",
            "protocol",
            "registration",
            "sim",
            "vslam",
        ],
    ),
    (
        "tests",
        &[
            "camera",
            "geodesy",
            "geometry",
            "peer",
            "protocol",
            "registration",
            "sim",
            "vslam",
        ],
    ),
    ("xtask", &[]),
];

/// What tests and benches of a member may know beyond that: the simulator makes their input.
const LAYERS_OF_TESTS: [(&str, &[&str]); 1] = [("keeping", &["sim"])];

/// The members that may name zenoh: the link, and the tests that speak to it from outside.
const ZENOH_USERS: [&str; 2] = ["peer", "tests"];

/// The only place in `peer` that imports zenoh.
const ZENOH_HOME: &str = "peer/src/link";

/// Checks the manifests, and where zenoh is imported.
pub fn check(root: &Path) -> Result<Vec<Offence>> {
    let mut offences = Vec::new();
    let layers: BTreeMap<&str, &[&str]> = LAYERS.into_iter().collect();
    let layers_of_tests: BTreeMap<&str, &[&str]> = LAYERS_OF_TESTS.into_iter().collect();
    let members = member_dependencies(root)?;
    for (member, dependencies) in &members {
        let mut offend = |what: String| {
            offences.push(Offence {
                path: PathBuf::from(member),
                line: 0,
                what,
            });
        };
        let Some(allowed) = layers.get(member.as_str()) else {
            offend("a member without a line in the table of layers".to_owned());
            continue;
        };
        let allowed_in_tests = layers_of_tests.get(member.as_str()).copied();
        for Dependency {
            name: dependency,
            only_in_tests,
        } in dependencies
        {
            let is_allowed = allowed.contains(&dependency.as_str())
                || *only_in_tests
                    && allowed_in_tests.is_some_and(|list| list.contains(&dependency.as_str()));
            if members.contains_key(dependency) && !is_allowed {
                offend(format!("must not know {dependency}"));
            }
            if dependency.starts_with("zenoh") && !ZENOH_USERS.contains(&member.as_str()) {
                offend("must not know zenoh".to_owned());
            }
        }
    }
    find_zenoh_imports(root, &root.join("peer/src"), &mut offences)?;
    Ok(offences)
}

struct Dependency {
    name: String,
    only_in_tests: bool,
}

fn member_dependencies(root: &Path) -> Result<BTreeMap<String, Vec<Dependency>>> {
    let output = Command::new(env!("CARGO"))
        .args([
            "metadata",
            "--format-version",
            "1",
            "--no-deps",
            "--offline",
        ])
        .current_dir(root)
        .output()
        .context("cannot start cargo metadata")?;
    if !output.status.success() {
        bail!(
            "cargo metadata: {}",
            String::from_utf8_lossy(&output.stderr).trim()
        );
    }
    let metadata: Value = serde_json::from_slice(&output.stdout)?;
    let named = |list: &Value| -> Vec<Dependency> {
        let entries = list.as_array().into_iter().flatten();
        entries
            .filter_map(|entry| {
                Some(Dependency {
                    name: entry["name"].as_str()?.to_owned(),
                    only_in_tests: entry["kind"].as_str() == Some("dev"),
                })
            })
            .collect()
    };
    let packages = metadata["packages"]
        .as_array()
        .context("cargo metadata lists no packages")?;
    Ok(packages
        .iter()
        .filter_map(|package| {
            Some((
                package["name"].as_str()?.to_owned(),
                named(&package["dependencies"]),
            ))
        })
        .collect())
}

fn find_zenoh_imports(root: &Path, folder: &Path, offences: &mut Vec<Offence>) -> Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            find_zenoh_imports(root, &path, offences)?;
            continue;
        }
        let relative = path.strip_prefix(root).unwrap_or(&path).to_owned();
        if relative.to_string_lossy().starts_with(ZENOH_HOME) {
            continue;
        }
        let text = std::fs::read_to_string(&path).unwrap_or_default();
        for (idx, line) in text.lines().enumerate() {
            if line.contains("zenoh::") || line.trim_start().starts_with("use zenoh") {
                let what = format!("zenoh is imported only in {ZENOH_HOME}");
                offences.push(Offence {
                    path: relative.clone(),
                    line: idx + 1,
                    what,
                });
            }
        }
    }
    Ok(())
}
