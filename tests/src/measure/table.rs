//! The table of accuracy, and its place in a document.

use anyhow::{Context, Result};

use super::accuracy::{Outcome, Row, Run};

pub const HEADER: [&str; 2] = [
    "| recording | runs | tracked | live | lost | dropped | RMSE | of the way | drift per metre | \
     scale drift | ms p50 | ms p99 | peak memory |",
    "|---|---|---|---|---|---|---|---|---|---|---|---|---|",
];
const COLUMN_COUNT: usize = 13;

/// The table stands between these lines.
pub const BEGIN: &str = "<!-- accuracy: written by `cargo xtask accuracy --write` -->";
pub const END: &str = "<!-- accuracy: end -->";

pub fn whole(rows: &[Row]) -> String {
    let lines = HEADER.iter().map(|line| (*line).to_owned());
    let lines: Vec<String> = lines.chain(rows.iter().map(line)).collect();
    lines.join("\n") + "\n"
}

/// One row; of several runs the median, and of the tracked share also the least.
pub fn line(row: &Row) -> String {
    let cells = match &row.outcome {
        Outcome::Skipped(reason) => vec![format!("skipped: {reason}")],
        Outcome::Failed(reason) => vec![format!("failed: {}", reason.replace('\n', " "))],
        Outcome::Runs(runs) => cells(runs),
    };
    let blank = std::iter::repeat_n(String::new(), COLUMN_COUNT - 1 - cells.len());
    let cells: Vec<String> = cells.into_iter().chain(blank).collect();
    format!("| {} | {} |", row.name, cells.join(" | "))
}

fn cells(runs: &[Run]) -> Vec<String> {
    let share = |count: fn(&Run) -> usize| {
        move |run: &Run| Some(count(run) as f64 / run.summary.frames.max(1) as f64)
    };
    let tracked = share(|run| run.summary.tracked);
    let least = runs.iter().filter_map(tracked).fold(1.0, f64::min);
    let of_the_way = |run: &Run| {
        let rmse_m = run.score.rmse_m?;
        (run.score.length_m > 0.0).then(|| rmse_m / run.score.length_m)
    };
    let percent = |value: f64| format!("{:.2} %", 100.0 * value);
    let whole = |value: f64| format!("{value:.0}");
    let milliseconds = |value: f64| format!("{value:.1}");
    let text = |value: Option<f64>, format: &dyn Fn(f64) -> String| {
        value.map_or_else(|| "–".to_owned(), format)
    };
    let median_tracked = text(median(runs, tracked), &percent_whole);
    vec![
        runs.len().to_string(),
        if runs.len() > 1 {
            format!("{median_tracked} (≥ {})", percent_whole(least))
        } else {
            median_tracked
        },
        text(
            median(runs, share(|run| run.summary.tracked_live)),
            &percent_whole,
        ),
        text(median(runs, |run| Some(run.summary.lost as f64)), &whole),
        text(median(runs, |run| Some(run.summary.dropped as f64)), &whole),
        text(median(runs, |run| run.score.rmse_m), &|metres| {
            format!("{metres:.4} m")
        }),
        text(median(runs, of_the_way), &percent),
        text(median(runs, |run| run.score.drift), &percent),
        text(
            median(runs, |run| run.score.scale_drift.map(f64::abs)),
            &percent,
        ),
        text(
            median(runs, |run| run.summary.ms_per_frame_p50),
            &milliseconds,
        ),
        text(
            median(runs, |run| run.summary.ms_per_frame_p99),
            &milliseconds,
        ),
        text(
            median(runs, |run| {
                run.summary.peak_rss_bytes.map(|bytes| bytes as f64)
            }),
            &|bytes| format!("{:.0} MB", bytes / 1e6),
        ),
    ]
}

fn percent_whole(value: f64) -> String {
    format!("{:.1} %", 100.0 * value)
}

/// Of the runs that have an answer; of an even number the better one.
fn median(runs: &[Run], value: impl Fn(&Run) -> Option<f64>) -> Option<f64> {
    let mut values: Vec<f64> = runs.iter().filter_map(value).collect();
    values.sort_by(f64::total_cmp);
    let middle = values.len().checked_sub(1)? / 2;
    values.get(middle).copied()
}

/// The document with the table in its place.
pub fn placed(document: &str, table: &str) -> Result<String> {
    let (before, rest) = document
        .split_once(BEGIN)
        .with_context(|| format!("the document has no line {BEGIN:?}"))?;
    let (_, after) = rest
        .split_once(END)
        .with_context(|| format!("the document has no line {END:?} after {BEGIN:?}"))?;
    Ok(format!("{before}{BEGIN}\n\n{table}\n{END}{after}"))
}

#[cfg(test)]
mod tests {
    use super::super::Score;
    use super::super::accuracy::Summary;
    use super::*;

    fn run(tracked: usize, rmse_m: Option<f64>) -> Run {
        Run {
            summary: Summary {
                frames: 200,
                tracked,
                ..Summary::default()
            },
            score: Score {
                rmse_m,
                length_m: 10.0,
                ..Score::default()
            },
            gaps: Vec::new(),
        }
    }

    #[test]
    fn a_row_has_the_median_and_says_what_is_missing() {
        let row = |outcome| Row {
            name: "hall".to_owned(),
            outcome,
        };
        let runs = vec![
            run(100, Some(0.5)),
            run(200, Some(0.1)),
            run(180, Some(0.2)),
        ];
        let line = line(&row(Outcome::Runs(runs)));
        let expected = "| hall | 3 | 90.0 % (≥ 50.0 %) | 0.0 % | 0 | 0 | 0.2000 m | 2.00 % | – |";
        assert!(line.starts_with(expected), "{line}");
        let columns = HEADER[0].matches('|').count();
        assert_eq!(line.matches('|').count(), columns);
        let skipped = super::line(&row(Outcome::Skipped("no data".to_owned())));
        assert!(
            skipped.starts_with("| hall | skipped: no data |"),
            "{skipped}"
        );
        assert_eq!(skipped.matches('|').count(), columns);
    }

    #[test]
    fn the_table_replaces_what_was_between_the_marks() {
        let document = format!("a\n{BEGIN}\nold\n{END}\nb\n");
        let placed_once = placed(&document, "new\n").unwrap();
        assert_eq!(placed_once, format!("a\n{BEGIN}\n\nnew\n\n{END}\nb\n"));
        assert_eq!(placed(&placed_once, "new\n").unwrap(), placed_once);
        assert!(placed("nothing", "new").is_err());
    }
}
