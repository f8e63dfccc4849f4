//! The tables over pairs of maps.

use super::common_view::CommonView;
use super::pairs::Counts;
use super::trial::{Answer, Miss};

/// One map that was sought in another.
pub(super) struct Pair {
    /// Those that bring it about.
    pub seeds: Vec<u64>,
    pub what: String,
    pub judged: Judged,
    /// Keyframe by keyframe, as in flight; with what spoke for it.
    pub localised: (Answer, String),
    /// Cloud in cloud; with what spoke for it.
    pub registered: (Answer, String),
}

/// What should come of a pair.
#[derive(Clone, Copy, Debug)]
pub(super) enum Judged {
    Common(CommonView),
    /// The same, in one of several rooms that look alike.
    Home,
    /// Maps of different rooms.
    Strangers,
    /// Maps of different rooms that look alike.
    Twins,
}

const HEADER: [&str; 2] = [
    "| overlap, angle between views | pairs | keyframes in chunks: aligned | rough | wrong \
     | refused | cloud in cloud: aligned | rough | wrong | refused |",
    "|---|---|---|---|---|---|---|---|---|---|",
];
const ANGLES_DEG: [f64; 5] = [0.0, 15.0, 30.0, 45.0, 60.0];
const OVERLAPS: [[f64; 2]; 3] = [[0.5, 1.01], [0.3, 0.5], [0.0, 0.3]];

pub(super) fn report(pairs: &[Pair], counts: &Counts, report: &mut impl FnMut(&str)) {
    HEADER.iter().for_each(|line| report(line));
    for [least, most] in OVERLAPS {
        for bin in ANGLES_DEG.windows(2) {
            let is_meant = |pair: &&Pair| match pair.judged {
                Judged::Common(view) => {
                    (least..most).contains(&view.overlap)
                        && (bin[0]..bin[1]).contains(&view.angle_deg)
                }
                _ => false,
            };
            let name = format!(
                "{:.0} to {:.0} %, {} to {}°",
                100.0 * least,
                100.0 * most.min(1.0),
                bin[0],
                bin[1]
            );
            row(&name, pairs.iter().filter(is_meant), report);
        }
    }
    let homes = pairs.iter().filter(|it| matches!(it.judged, Judged::Home));
    row("in a building of rooms that look alike", homes, report);
    let strangers = pairs
        .iter()
        .filter(|it| matches!(it.judged, Judged::Strangers));
    row("nothing in common", strangers, report);
    let twins = pairs.iter().filter(|it| matches!(it.judged, Judged::Twins));
    row("nothing in common, but rooms look alike", twins, report);
    report(&format!(
        "\n{} vehicles; {} without a map, {} with a map out of shape: left out",
        counts.vehicle_count, counts.unmapped_count, counts.bent_count
    ));
}

fn row<'a>(name: &str, pairs: impl Iterator<Item = &'a Pair>, report: &mut impl FnMut(&str)) {
    let pairs: Vec<&Pair> = pairs.collect();
    let mut line = format!("| {name} | {} |", pairs.len());
    for answer in [
        |pair: &Pair| pair.localised.0.clone(),
        |pair: &Pair| pair.registered.0.clone(),
    ] {
        let mut counts = [0; 4];
        for pair in &pairs {
            counts[match answer(pair) {
                Answer::Aligned(_) => 0,
                Answer::Rough(_) => 1,
                Answer::Wrong(_) => 2,
                Answer::Refused(_) => 3,
            }] += 1;
        }
        let share = 100.0 * counts[0] as f64 / pairs.len().max(1) as f64;
        line += &format!(" {} ({share:.0} %) |", counts[0]);
        counts[1..]
            .iter()
            .for_each(|it| line += &format!(" {it} |"));
    }
    report(&line);
}

/// Names each wrong alignment and how to repeat it; whether there is none.
pub(super) fn report_wrong(pairs: &[Pair], report: &mut impl FnMut(&str)) -> bool {
    let mut is_clean = true;
    for pair in pairs {
        let answers = [
            ("keyframes in chunks", &pair.localised.0),
            ("cloud in cloud", &pair.registered.0),
        ];
        for (way, answer) in answers {
            let Answer::Wrong(miss) = answer else {
                continue;
            };
            is_clean = false;
            let seeds: Vec<String> = pair.seeds.iter().map(u64::to_string).collect();
            report(&format!(
                "WRONG {way}: {}: {}\n  again: cargo xtask registration --only vehicles \
                 --vehicle-seeds {}",
                pair.what,
                described(miss),
                seeds.join(",")
            ));
        }
    }
    is_clean
}

/// What came of each pair.
pub(super) fn report_each(pairs: &[Pair], report: &mut impl FnMut(&str)) {
    let said = |answer: &Answer| match answer {
        Answer::Aligned(miss) => format!("aligned ({})", described(miss)),
        Answer::Rough(miss) => format!("ROUGH ({})", described(miss)),
        Answer::Wrong(miss) => format!("WRONG ({})", described(miss)),
        Answer::Refused(reason) => reason.clone(),
    };
    for pair in pairs {
        let view = match pair.judged {
            Judged::Common(view) => {
                format!("{:.0} %, {:.0}°", 100.0 * view.overlap, view.angle_deg)
            }
            Judged::Home => "home".to_owned(),
            Judged::Strangers => "strangers".to_owned(),
            Judged::Twins => "twins".to_owned(),
        };
        let [localised, registered] = [&pair.localised, &pair.registered]
            .map(|(answer, evidence)| format!("{}; {evidence}", said(answer)));
        let what = &pair.what;
        report(&format!(
            "{what}: {view}: keyframes {localised}; cloud {registered}"
        ));
    }
}

fn described(miss: &Miss) -> String {
    format!(
        "scale {:.1} %, {:.1}°, place {:.1} % of the depth",
        100.0 * miss.scale,
        miss.rotation_deg,
        100.0 * miss.position
    )
}
