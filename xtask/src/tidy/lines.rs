//! Width, length, and words that do not belong in a finished line.

use std::path::Path;

use super::Offence;

const LINE_WIDTH_MAX: usize = 100;
const FILE_LINES_MAX: usize = 600;
const ARCHITECTURE_LINES_MAX: usize = 300;

/// Words, in two parts so that this file does not contain them.
const FORBIDDEN_WORDS: [(&str, &str); 5] = [
    ("TO", "DO"),
    ("FIX", "ME"),
    ("XX", "X"),
    ("todo", "!("),
    ("#[ig", "nore"),
];

/// Folders of one machine, in two parts likewise.
const MACHINE_PATHS: [(&str, &str); 4] = [
    ("/ro", "ot/"),
    ("/ho", "me/"),
    ("/wo", "rk/"),
    ("/fa", "rm/"),
];

/// Appends what is wrong with the lines of one file.
pub fn check(path: &Path, text: &str, offences: &mut Vec<Offence>) {
    let extension = path
        .extension()
        .and_then(|extension| extension.to_str())
        .unwrap_or_default();
    if path.ends_with("Cargo.lock") || extension == "svg" {
        return;
    }
    let mut offend = |line: usize, what: String| {
        offences.push(Offence {
            path: path.to_owned(),
            line,
            what,
        });
    };
    check_length(path, extension, text.lines().count(), &mut offend);
    for (idx, line) in text.lines().enumerate() {
        let width = line.chars().count();
        if extension == "rs" && width > LINE_WIDTH_MAX {
            offend(
                idx + 1,
                format!("{width} columns, the limit is {LINE_WIDTH_MAX}"),
            );
        }
        if line.ends_with([' ', '\t', '\r']) && extension != "hex" {
            offend(idx + 1, "white space at the end of the line".to_owned());
        }
        for (start, end) in FORBIDDEN_WORDS {
            if extension == "rs" && line.contains(&format!("{start}{end}")) {
                offend(idx + 1, format!("{start}{end} marks unfinished work"));
            }
        }
        for (start, end) in MACHINE_PATHS {
            if names_machine_path(line, &format!("{start}{end}")) {
                offend(idx + 1, format!("{start}{end} is a path of one machine"));
            }
        }
    }
    if !text.is_empty() && !text.ends_with('\n') {
        offend(
            text.lines().count(),
            "no line break at the end of the file".to_owned(),
        );
    }
}

fn check_length(
    path: &Path,
    extension: &str,
    line_count: usize,
    offend: &mut impl FnMut(usize, String),
) {
    let is_test = path.file_stem().is_some_and(|stem| stem == "tests")
        || path.components().any(|part| part.as_os_str() == "tests");
    if extension == "rs" && !is_test && line_count > FILE_LINES_MAX {
        offend(
            0,
            format!("{line_count} lines, the limit is {FILE_LINES_MAX}"),
        );
    }
    if path.ends_with("ARCHITECTURE.md") && line_count > ARCHITECTURE_LINES_MAX {
        offend(
            0,
            format!("{line_count} lines, the limit is {ARCHITECTURE_LINES_MAX}"),
        );
    }
}

/// Whether the path starts a word, so that `crates/work/` is no offence.
fn names_machine_path(line: &str, machine_path: &str) -> bool {
    line.match_indices(machine_path).any(|(start, _)| {
        let before = line[..start].chars().next_back();
        !before
            .is_some_and(|c| c.is_alphanumeric() || matches!(c, '_' | '.' | '-' | '}' | '*' | '/'))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn offences(path: &str, text: &str) -> Vec<String> {
        let mut offences = Vec::new();
        check(Path::new(path), text, &mut offences);
        offences.into_iter().map(|offence| offence.what).collect()
    }

    #[test]
    fn names_each_kind_of_offence() {
        assert_eq!(offences("a.rs", "fn f() {}\n"), Vec::<String>::new());
        assert_eq!(
            offences("a.rs", &format!("//{}\n", "x".repeat(99))).len(),
            1
        );
        assert_eq!(offences("a.rs", "x \n").len(), 1);
        assert_eq!(offences("a.rs", "x").len(), 1);
        assert_eq!(offences("a.rs", &format!("// TO{}\n", "DO")).len(), 1);
        assert_eq!(offences("a.md", &format!("see /ro{}x\n", "ot/")).len(), 1);
        assert_eq!(offences("a.rs", &"\n".repeat(601)).len(), 1);
        assert_eq!(offences("a/tests.rs", &"\n".repeat(601)).len(), 0);
    }
}
