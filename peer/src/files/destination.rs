//! Where results will go, looked at before the work that makes them.

use std::fs::{self, OpenOptions};
use std::path::Path;

use super::error::FileError;

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
            fs::remove_file(path)
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
}
