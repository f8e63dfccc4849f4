//! Where results will go, looked at before the work that makes them.

use std::collections::BTreeMap;
use std::fs::{self, OpenOptions};
use std::path::{Path, PathBuf};

use super::error::FileError;

/// A file, and what a person calls it: `--out`, `the recording's list of images`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NamedFile {
    pub name: String,
    pub path: PathBuf,
}

impl NamedFile {
    pub fn new(name: impl Into<String>, path: impl Into<PathBuf>) -> Self {
        Self {
            name: name.into(),
            path: path.into(),
        }
    }
}

/// Two names of one file, of which one is written.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Clash {
    #[error("{first} and {second} name the same file; give each its own: {path}")]
    Results {
        first: String,
        second: String,
        path: PathBuf,
    },
    #[error("{result} would overwrite {input}, which is read; name another file: {path}")]
    Input {
        result: String,
        input: String,
        path: PathBuf,
    },
}

/// Makes sure that no result goes to the file of another one, or of something that is read,
/// whatever it is called there: by links, by `./`, by another way to the same folder.
///
/// Pipes and devices may be named as often as one likes.
pub fn check_distinct(
    results: &[NamedFile],
    inputs: impl IntoIterator<Item = NamedFile>,
) -> Result<(), Clash> {
    let mut written: BTreeMap<Identity, &NamedFile> = BTreeMap::new();
    for result in results {
        let Some(identity) = Identity::of(&result.path) else {
            continue;
        };
        if let Some(first) = written.insert(identity, result) {
            return Err(Clash::Results {
                first: first.name.clone(),
                second: result.name.clone(),
                path: result.path.clone(),
            });
        }
    }
    // What is not there yet is not read: a recording's images need not be looked at.
    written.retain(|identity, _| matches!(identity, Identity::Existing { .. }));
    if written.is_empty() {
        return Ok(());
    }
    for input in inputs {
        let identity = Identity::of(&input.path);
        if let Some(result) = identity.and_then(|identity| written.get(&identity)) {
            return Err(Clash::Input {
                result: result.name.clone(),
                input: input.name,
                path: result.path.clone(),
            });
        }
    }
    Ok(())
}

/// What makes two paths the same file.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Identity {
    #[cfg(unix)]
    Existing { device: u64, inode: u64 },
    #[cfg(not(unix))]
    Existing { canonical: PathBuf },
    /// In a folder that is there, if it is, by its one true name.
    New { path: PathBuf },
}

impl Identity {
    /// `None` of pipes, devices and folders.
    fn of(path: &Path) -> Option<Self> {
        let path = behind_links(path);
        match path.metadata() {
            Ok(metadata) if !metadata.is_file() => None,
            #[cfg(unix)]
            Ok(metadata) => {
                use std::os::unix::fs::MetadataExt;
                Some(Self::Existing {
                    device: metadata.dev(),
                    inode: metadata.ino(),
                })
            }
            #[cfg(not(unix))]
            Ok(_) => Some(Self::Existing {
                canonical: path.canonicalize().unwrap_or(path),
            }),
            Err(_) => {
                let folder = folder_of(&path).canonicalize();
                let path = match (folder, path.file_name()) {
                    (Ok(folder), Some(name)) => folder.join(name),
                    _ => path,
                };
                Some(Self::New { path })
            }
        }
    }
}

/// More links in a row than any system follows.
const LINKS_MAX: usize = 40;

/// Where a link leads that leads to nothing yet; a file written through it appears there.
fn behind_links(path: &Path) -> PathBuf {
    let mut path = path.to_owned();
    for _ in 0..LINKS_MAX {
        let Ok(target) = fs::read_link(&path) else {
            break;
        };
        // An absolute target replaces the folder.
        path = folder_of(&path).join(target);
    }
    path
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    }
}

/// Makes sure that a file can be written, and makes its folder; a file that is there is kept.
pub fn check_destination(path: &Path) -> Result<(), FileError> {
    if path.is_dir() {
        return Err(FileError::Content {
            reason: "this is a folder, expected the name of a file".to_owned(),
            path: path.to_owned(),
        });
    }
    if let Some(folder) = path.parent() {
        create_folder(folder)?;
    }
    let is_new = match path.metadata() {
        // A pipe or a device is not opened twice.
        Ok(metadata) if !metadata.is_file() => return Ok(()),
        Ok(_) => false,
        Err(_) => true,
    };
    let mut options = OpenOptions::new();
    let opened = options.write(true).create(true).truncate(false).open(path);
    let probed = opened.and_then(|_| {
        if is_new {
            fs::remove_file(behind_links(path))
        } else {
            Ok(())
        }
    });
    probed.map_err(|error| FileError::Write {
        error,
        path: path.to_owned(),
    })
}

/// Makes a folder with those above it, unless it is there.
pub fn create_folder(path: &Path) -> Result<(), FileError> {
    if path.is_file() {
        return Err(FileError::Content {
            reason: "this is a file, expected a folder".to_owned(),
            path: path.to_owned(),
        });
    }
    fs::create_dir_all(path).map_err(|error| FileError::Write {
        error,
        path: path.to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_destination_is_checked_and_nothing_is_left_or_lost() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        check_destination(&path("new/deep/a.tum")).unwrap();
        assert!(path("new/deep").is_dir() && !path("new/deep/a.tum").exists());
        fs::write(path("old.tum"), "kept").unwrap();
        check_destination(&path("old.tum")).unwrap();
        assert_eq!(fs::read_to_string(path("old.tum")).unwrap(), "kept");
        check_destination(Path::new("/dev/null")).unwrap();

        let refusal = |result: Result<(), FileError>| result.unwrap_err().to_string();
        let error = refusal(check_destination(folder.path()));
        assert!(error.starts_with("this is a folder"), "{error}");
        let error = refusal(check_destination(&path("old.tum/below.tum")));
        assert!(error.starts_with("this is a file"), "{error}");
        let error = refusal(create_folder(&path("old.tum")));
        assert!(
            error.starts_with("this is a file, expected a folder"),
            "{error}"
        );
        assert!(error.ends_with("old.tum"), "{error}");
        let error = refusal(create_folder(&path("old.tum/below")));
        assert!(error.starts_with("cannot write"), "{error}");
    }

    /// One file under many names.
    #[cfg(unix)]
    #[test]
    fn a_file_is_the_same_whatever_it_is_called() {
        use std::os::unix::fs::symlink;

        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::create_dir(path("real")).unwrap();
        symlink(path("real"), path("other")).unwrap();
        fs::write(path("real/list"), "kept").unwrap();
        symlink("list", path("real/link")).unwrap();
        fs::hard_link(path("real/list"), path("hard")).unwrap();
        symlink("new", path("real/to_new")).unwrap();
        let named = |name: &str| NamedFile::new(name, path(name));
        let check = |results: &[&str], inputs: &[&str]| {
            let results: Vec<NamedFile> = results.iter().map(|name| named(name)).collect();
            check_distinct(&results, inputs.iter().map(|name| named(name)))
        };
        for alias in [
            "real/./list",
            "other/list",
            "real/../real/list",
            "real/link",
            "hard",
        ] {
            let clash = check(&["elsewhere", alias], &["real", "real/list"]).unwrap_err();
            assert_eq!(
                clash.to_string(),
                format!(
                    "{alias} would overwrite real/list, which is read; name another file: {}",
                    path(alias).display()
                )
            );
            assert!(check(&["real/list", alias], &[]).is_err(), "{alias}");
        }
        // Of files that are not there yet the folder decides, and where a link leads.
        for alias in ["other/new", "real/../other/./new", "real/to_new"] {
            let clash = check(&["real/new", alias], &[]).unwrap_err();
            assert!(matches!(clash, Clash::Results { .. }), "{clash}");
        }
        check(&["real/new", "new", "other/news"], &["real/list", "absent"]).unwrap();
        let null = || NamedFile::new("--out", "/dev/null");
        check_distinct(&[null(), null()], [null()]).unwrap();
        // A link to nothing is kept when it is tried.
        check_destination(&path("real/to_new")).unwrap();
        assert!(path("real/to_new").is_symlink() && !path("real/new").exists());
    }
}
