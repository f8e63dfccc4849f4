//! Links between the project's own pages lead somewhere.

use std::path::Path;

use super::Offence;

/// Appends the relative links of a Markdown page that lead nowhere.
pub fn check(root: &Path, path: &Path, text: &str, offences: &mut Vec<Offence>) {
    if path.extension().is_none_or(|extension| extension != "md") {
        return;
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    for (idx, line) in text.lines().enumerate() {
        for target in relative_targets(line) {
            if !root.join(folder).join(target).exists() {
                let what = format!("the link to {target} leads nowhere");
                offences.push(Offence {
                    path: path.to_owned(),
                    line: idx + 1,
                    what,
                });
            }
        }
    }
}

/// The paths in `](path)` that are neither addresses nor anchors of the same page.
fn relative_targets(line: &str) -> impl Iterator<Item = &str> {
    line.split("](").skip(1).filter_map(|rest| {
        let target = rest.split(')').next()?;
        let path = target.split('#').next()?;
        (!path.is_empty() && !path.contains("://") && !path.starts_with("mailto:")).then_some(path)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_only_paths() {
        let line = "[a](b.md#c), [d](https://e.f), [g](#h) and ![i](j/k.svg)";
        assert_eq!(
            relative_targets(line).collect::<Vec<_>>(),
            ["b.md", "j/k.svg"]
        );
    }
}
