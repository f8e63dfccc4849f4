//! What vSLAM is measured over.

use sim::{Condition, RecordingWorld};

use super::variant::Selection;

/// One row of the table.
#[derive(Clone, Debug)]
pub struct Entry {
    pub name: String,
    pub source: Source,
    /// At the recording's own speed, late frames dropped.
    pub realtime: bool,
}

#[derive(Clone, Debug)]
pub enum Source {
    /// A folder below `$STARLING_DATA/video`, and which frames of it.
    Recorded {
        folder: &'static str,
        range: Option<&'static str>,
    },
    /// Frames of such a folder, left out or in another order.
    Variant {
        folder: &'static str,
        selection: Selection,
    },
    Rendered {
        world: RecordingWorld,
        conditions: Vec<Condition>,
    },
}

/// Recordings as they were made, variants of them, and rendered worlds.
pub fn entries() -> Vec<Entry> {
    let mut entries = recorded();
    entries.extend(variants());
    entries.extend(rendered());
    entries
}

fn recorded() -> Vec<Entry> {
    let whole = [
        ("sevenscenes_kitchen", None),
        ("sevenscenes_kitchen", Some("400..1000")),
        ("kitchen_pair/ground", None),
        ("kitchen_pair/drone", None),
        ("kitti00", None),
        ("crazyflie_hallway", None),
        ("euroc_v101_keyframes", None),
        ("caliterra_gnss", None),
    ];
    let entry = |(folder, range): (&'static str, Option<&'static str>)| Entry {
        name: range.map_or(folder.to_owned(), |range| format!("{folder}@{range}")),
        source: Source::Recorded { folder, range },
        realtime: true,
    };
    whole.into_iter().map(entry).collect()
}

/// What nobody tuned anything for.
fn variants() -> Vec<Entry> {
    let kitchen = "sevenscenes_kitchen";
    let mut variants = vec![
        (kitchen, Selection::Every(2)),
        (kitchen, Selection::Every(3)),
        (kitchen, Selection::Every(6)),
        (kitchen, Selection::Reversed),
    ];
    variants.extend((1..10).map(|part| (kitchen, Selection::From(90 * part))));
    for seed in 1..=2 {
        let share = 0.2;
        variants.push((kitchen, Selection::Dropped { share, seed }));
    }
    for folder in ["kitchen_pair/ground", "kitchen_pair/drone", "kitti00"] {
        variants.push((folder, Selection::Every(2)));
        variants.push((folder, Selection::Reversed));
        variants.push((folder, Selection::From(60)));
    }
    variants.push(("crazyflie_hallway", Selection::Reversed));
    let entry = |(folder, selection)| Entry {
        name: format!("{folder} {}", label(selection)),
        source: Source::Variant { folder, selection },
        realtime: false,
    };
    variants.into_iter().map(entry).collect()
}

fn label(selection: Selection) -> String {
    match selection {
        Selection::Every(stride) => format!("1 of {stride}"),
        Selection::From(start) => format!("from {start}"),
        Selection::Reversed => "reversed".to_owned(),
        Selection::Dropped { share, seed } => {
            format!("{:.0} % dropped ({seed})", 100.0 * share)
        }
    }
}

fn rendered() -> Vec<Entry> {
    let hard = [
        Condition::Blur,
        Condition::Radio,
        Condition::Exposure,
        Condition::Cover,
        Condition::Occlusion,
    ];
    let mut entries = Vec::new();
    for world in RecordingWorld::MOVING {
        entries.push((world, Vec::new()));
    }
    for condition in hard {
        entries.push((RecordingWorld::Round, vec![condition]));
    }
    let entry = |(world, conditions): (RecordingWorld, Vec<Condition>)| {
        let names: Vec<&str> = conditions.iter().map(|it| it.name()).collect();
        let with = if names.is_empty() { "" } else { " with " };
        Entry {
            name: format!("rendered {}{with}{}", world.name(), names.join(", ")),
            source: Source::Rendered { world, conditions },
            realtime: false,
        }
    };
    entries.into_iter().map(entry).collect()
}
