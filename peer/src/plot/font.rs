//! A small font of strokes, for pictures that must carry their own letters.

/// Columns and rows of a letter's grid, pixels: columns 0 to 4, rows 0 (top) to 6 (baseline).
const CELL_PX: f64 = 1.6;
const ADVANCE_PX: f64 = 6.0 * CELL_PX;

/// Strokes of a letter: runs of grid points, each a digit for the column and one for the row.
fn runs(letter: char) -> &'static str {
    match letter.to_ascii_uppercase() {
        'A' => "06 02 20 42 46,04 44",
        'B' => "06 00 30 41 42 33 03,33 44 45 36 06",
        'C' => "41 30 10 01 05 16 36 45",
        'D' => "06 00 20 42 44 26 06",
        'E' => "40 00 06 46,03 33",
        'F' => "40 00 06,03 33",
        'G' => "41 30 10 01 05 16 36 45 43 23",
        'H' => "00 06,40 46,03 43",
        'I' => "10 30,20 26,16 36",
        'J' => "40 45 36 16 05",
        'K' => "00 06,40 03 46",
        'L' => "00 06 46",
        'M' => "06 00 23 40 46",
        'N' => "06 00 46 40",
        'O' => "10 30 41 45 36 16 05 01 10",
        'P' => "06 00 30 41 42 33 03",
        'Q' => "10 30 41 45 36 16 05 01 10,24 46",
        'R' => "06 00 30 41 42 33 03,23 46",
        'S' => "41 30 10 01 02 13 33 44 45 36 16 05",
        'T' => "00 40,20 26",
        'U' => "00 05 16 36 45 40",
        'V' => "00 26 40",
        'W' => "00 16 23 36 40",
        'X' => "00 46,40 06",
        'Y' => "00 23 40,23 26",
        'Z' => "00 40 06 46",
        '0' => "10 30 41 45 36 16 05 01 10,41 05",
        '1' => "11 20 26,16 36",
        '2' => "01 10 30 41 42 06 46",
        '3' => "01 10 30 41 42 33 13,33 44 45 36 16 05",
        '4' => "36 30 04 44",
        '5' => "40 00 03 33 44 45 36 06",
        '6' => "40 20 02 05 16 36 45 44 33 03",
        '7' => "00 40 16",
        '8' => "10 30 41 42 33 13 02 01 10,13 04 05 16 36 45 44 33",
        '9' => "06 26 44 41 30 10 01 02 13 43",
        '-' | '−' | '–' => "13 33",
        '+' => "13 33,22 24",
        '=' => "12 32,14 34",
        '.' => "25 26",
        ',' => "25 17",
        ':' => "22 23,25 26",
        '/' => "06 40",
        '%' => "06 40,01 02,44 45",
        '(' | '[' => "30 20 11 15 26 36",
        ')' | ']' => "10 20 31 35 26 16",
        '_' => "06 46",
        '\'' => "20 21",
        '°' => "10 21 12 01 10",
        '→' => "03 43,32 43 34",
        ' ' => "",
        _ => "01 41 45 05 01",
    }
}

pub fn width_px(text: &str) -> f64 {
    text.chars().count() as f64 * ADVANCE_PX
}

/// The segments of a text that starts on the baseline at `start`.
pub fn strokes(start: [f64; 2], text: &str) -> Vec<[[f64; 2]; 2]> {
    let mut segments = Vec::new();
    for (letter_idx, letter) in text.chars().enumerate() {
        let left = start[0] + letter_idx as f64 * ADVANCE_PX;
        for run in runs(letter).split(',') {
            let points: Vec<[f64; 2]> = run
                .split_whitespace()
                .map(|cell| {
                    let [column, row] = [0, 1].map(|idx| f64::from(cell.as_bytes()[idx] - b'0'));
                    [left + column * CELL_PX, start[1] + (row - 6.0) * CELL_PX]
                })
                .collect();
            segments.extend(points.windows(2).map(|pair| [pair[0], pair[1]]));
        }
    }
    segments
}
