//! The record of where the cameras truly were.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use geometry::{Camera, Enu, Timestamp, Transform};

use super::ServeError;

/// Writes a line per frame to `{id}.truth.tum`, or nothing without a folder.
pub struct Truth {
    path: PathBuf,
    file: Option<BufWriter<File>>,
}

impl Truth {
    pub fn create(folder: Option<&Path>, id: &str) -> Result<Self, ServeError> {
        let Some(folder) = folder else {
            return Ok(Self {
                path: PathBuf::new(),
                file: None,
            });
        };
        let path = folder.join(format!("{id}.truth.tum"));
        let opened = fs::create_dir_all(folder).and_then(|()| File::create(&path));
        match opened {
            Ok(file) => Ok(Self {
                path,
                file: Some(BufWriter::new(file)),
            }),
            Err(source) => Err(ServeError::Truth { source, path }),
        }
    }

    pub fn record(
        &mut self,
        captured_at: Timestamp,
        site_from_camera: &Transform<Enu, Camera>,
    ) -> Result<(), ServeError> {
        let line = tum_line(captured_at, site_from_camera);
        self.write(|file| writeln!(file, "{line}"))
    }

    /// Makes sure that everything is in the file.
    pub fn finish(mut self) -> Result<(), ServeError> {
        self.write(BufWriter::flush)
    }

    fn write(
        &mut self,
        write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
    ) -> Result<(), ServeError> {
        let Some(file) = &mut self.file else {
            return Ok(());
        };
        write(file).map_err(|source| ServeError::Truth {
            source,
            path: self.path.clone(),
        })
    }
}

/// `timestamp x y z qx qy qz qw`, as the TUM benchmark has it.
fn tum_line(captured_at: Timestamp, pose: &Transform<Enu, Camera>) -> String {
    let (t, q) = (pose.translation(), pose.rotation());
    format!(
        "{captured_at} {:.7} {:.7} {:.7} {:.8} {:.8} {:.8} {:.8}",
        t.x, t.y, t.z, q.i, q.j, q.k, q.w
    )
}
