//! A text file that only ever holds whole lines.

use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use anyhow::Context;

/// Each line is in the file when [`Lines::append`] returns: whoever looks on, or finds it after a
/// crash, sees whole lines.
pub struct Lines {
    file: File,
    path: PathBuf,
    size_bytes: u64,
}

impl Lines {
    pub fn create(path: &Path) -> anyhow::Result<Self> {
        let file =
            File::create(path).with_context(|| format!("cannot write {}", path.display()))?;
        Ok(Self {
            file,
            path: path.to_owned(),
            size_bytes: 0,
        })
    }

    pub fn append(&mut self, line: &str) -> anyhow::Result<()> {
        let line = format!("{line}\n");
        if let Err(error) = self.file.write_all(line.as_bytes()) {
            // A part of the line must not become the head of the next one.
            let _ = self.file.set_len(self.size_bytes);
            let _ = self.file.seek(SeekFrom::Start(self.size_bytes));
            return Err(error).with_context(|| format!("cannot write {}", self.path.display()));
        }
        self.size_bytes += line.len() as u64;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_does_not_fit_leaves_nothing_of_itself() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("lines");
        let mut lines = Lines::create(&path).unwrap();
        lines.append("one").unwrap();
        let writable = std::mem::replace(&mut lines.file, File::open(&path).unwrap());
        assert!(lines.append("two").is_err());
        lines.file = writable;
        lines.append("three").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "one\nthree\n");
    }
}
