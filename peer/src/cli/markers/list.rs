//! Which images a folder has, and when they were taken.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context;
use geometry::Timestamp;

use crate::dataset::{DatasetError, Layout};

/// An image to look at.
pub struct ListedImage {
    pub path: PathBuf,
    pub captured_at: Timestamp,
    /// The time is that of a recording's list, not made up.
    pub is_stamped: bool,
}

const EXTENSIONS: [&str; 6] = ["png", "jpg", "jpeg", "pgm", "ppm", "pnm"];
/// Images without time stamps are taken as this far apart, as from the paper's camera.
const FRAME_TIME: Duration = Duration::from_millis(50);

/// The frames of a recording, or all images of a folder in the order of their names.
pub fn list_images(folder: &Path) -> anyhow::Result<Vec<ListedImage>> {
    match Layout::detect(folder) {
        Ok(layout) => {
            let frames = layout.list_frames(folder)?;
            let listed = frames.into_iter().map(|frame| ListedImage {
                path: frame.path,
                captured_at: frame.captured_at,
                is_stamped: true,
            });
            Ok(listed.collect())
        }
        Err(DatasetError::UnknownLayout { .. }) => list_folder(folder),
        Err(error) => Err(error.into()),
    }
}

fn list_folder(folder: &Path) -> anyhow::Result<Vec<ListedImage>> {
    let mut paths = Vec::new();
    let entries = std::fs::read_dir(folder)
        .with_context(|| format!("cannot list the folder {}", folder.display()))?;
    for entry in entries {
        let path = entry?.path();
        let extension = path.extension().unwrap_or_default().to_string_lossy();
        if EXTENSIONS.contains(&extension.to_ascii_lowercase().as_str()) {
            paths.push(path);
        }
    }
    anyhow::ensure!(
        !paths.is_empty(),
        "no images; expected names that end with one of {}, in {}",
        EXTENSIONS.join(", "),
        folder.display()
    );
    paths.sort();
    let mut captured_at = Timestamp::from_nanoseconds(0);
    let mut listed = Vec::with_capacity(paths.len());
    for path in paths {
        listed.push(ListedImage {
            path,
            captured_at,
            is_stamped: false,
        });
        captured_at = captured_at.after(FRAME_TIME);
    }
    Ok(listed)
}
