//! `starling map`.

mod collect;

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::bail;
use clap::Subcommand;
use protocol::keys::MapParameters;
use serde::Serialize;

use super::{Exit, UsageError, output};
use crate::files::{PointCloud, check_cloud_name, check_destination, write_cloud};
use crate::link::{Question, ask};
use collect::Collection;

#[derive(Subcommand)]
pub enum MapCommand {
    /// Ask the network for maps and export them.
    Get(GetArguments),
}

#[derive(clap::Args)]
pub struct GetArguments {
    /// A key expression: 'anchor/*/map' lists maps, 'anchor/*/map/*/*' brings chunks. It may end
    /// with `?bbox=east_min,north_min,east_max,north_max` (metres in the manifest's datum) and
    /// `since=EPOCH:N`, separated by `;`.
    pub selector: String,
    /// Where to ask; may be repeated.
    #[arg(long, value_name = "ENDPOINT", default_value = "tcp/127.0.0.1:7447")]
    pub connect: Vec<String>,
    /// Export the points; the extension chooses the format: ply, pcd, xyz, csv or txt. Not built
    /// yet: las, geojson, mcap.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Print one JSON object.
    #[arg(long)]
    pub json: bool,
}

/// One map, as its holders describe it.
#[derive(Clone, Debug, Serialize)]
pub struct MapSummary {
    pub anchor: String,
    pub epoch: String,
    pub revision: Option<u32>,
    pub datum: Option<String>,
    /// How it came to its place: `fixed`, or `registered` to the maps of others, which says
    /// nothing of the Earth beside them.
    pub reference: Option<String>,
    /// Whose evidence a registered map rests on.
    pub provenance: Vec<String>,
    /// Chunks that exist, as far as those who answered know.
    pub chunk_count: Option<u64>,
    /// Chunks that somebody who answered holds.
    pub held_count: Option<u64>,
    pub holders: Vec<String>,
    /// `[east_min, north_min, up_min, east_max, north_max, up_max]` in the datum.
    pub bounding_box_m: Option<[f64; 6]>,
    /// Chunks that came with this answer.
    pub received_count: usize,
    /// Of those that came and are placed.
    pub point_count: usize,
}

#[derive(Serialize)]
struct MapJson {
    maps: Vec<MapSummary>,
    out: Option<PathBuf>,
}

const PATIENCE: Duration = Duration::from_secs(5);

pub fn run(command: &MapCommand) -> anyhow::Result<Exit> {
    let MapCommand::Get(arguments) = command;
    check_selector(&arguments.selector)?;
    if let Some(path) = &arguments.out {
        check_out(path)?;
    }
    let mut collection = Collection::default();
    let take = |collection: &mut Collection, selector: &str| -> anyhow::Result<usize> {
        let replies = ask(&arguments.connect, selector, PATIENCE)?;
        let count = replies.len();
        for reply in replies {
            collection.take(&reply);
        }
        Ok(count)
    };
    if take(&mut collection, &arguments.selector)? == 0 {
        bail!(
            "nobody answers {:?}; tried {:?}",
            arguments.selector,
            arguments.connect
        );
    }
    if arguments.out.is_some() || collection.has_chunks() {
        for map in collection.maps() {
            if !collection.has_chunks_of(&map) {
                take(
                    &mut collection,
                    &format!("anchor/{}/map/{}/*", map.anchor, map.epoch),
                )?;
            }
            let placements = format!("anchor/{}/placement/{}/**", map.anchor, map.epoch);
            take(&mut collection, &placements)?;
        }
    }
    let (summaries, points) = collection.summarise();
    if let Some(path) = &arguments.out {
        if points.is_empty() {
            bail!(
                "no point is placed yet, so nothing was written to {}",
                path.display()
            );
        }
        write_cloud(path, &PointCloud::from_points(points))?;
    }
    if collection.malformed_count > 0 {
        let count = collection.malformed_count;
        output::diagnose(&format!(
            "{count} replies are no messages and were left out"
        ));
    }
    print(summaries, arguments)?;
    Ok(if collection.malformed_count > 0 {
        Exit::DoneWithLoss
    } else {
        Exit::Done
    })
}

/// Refuses what holders would take for no question, or answer as if it were not there.
fn check_selector(selector: &str) -> Result<(), UsageError> {
    let question = Question::parse(selector).ok_or_else(|| {
        UsageError(format!(
            "{selector:?} is no key expression; expected one such as 'anchor/*/map'"
        ))
    })?;
    MapParameters::parse(question.parameters()).map_err(UsageError::because)?;
    let names = question.parameters().split(';');
    let mut names = names.map(|part| part.split('=').next().unwrap_or_default());
    // zenoh's own begin with an underscore.
    let known = |name: &str| ["", "bbox", "since"].contains(&name) || name.starts_with('_');
    match names.find(|name| !known(name)) {
        Some(name) => Err(UsageError(format!(
            "{selector:?} has a parameter {name:?}; expected bbox=… or since=…, separated by ;"
        ))),
        None => Ok(()),
    }
}

fn check_out(path: &Path) -> anyhow::Result<()> {
    let extension = path.extension().unwrap_or_default().to_string_lossy();
    let extension = extension.to_ascii_lowercase();
    if ["las", "geojson", "mcap"].contains(&extension.as_str()) {
        bail!(
            "export as .{extension} is not built yet; use .ply, .pcd, .xyz, .csv or .txt: {}",
            path.display()
        );
    }
    check_cloud_name(path).map_err(UsageError::because)?;
    check_destination(path)?;
    Ok(())
}

fn print(maps: Vec<MapSummary>, arguments: &GetArguments) -> anyhow::Result<()> {
    if arguments.json {
        return output::print_json(&MapJson {
            maps,
            out: arguments.out.clone(),
        });
    }
    for map in &maps {
        let known = |count: Option<u64>| count.map_or("?".to_owned(), |count| count.to_string());
        // A question for chunks alone brings no manifest.
        let holders = if map.holders.is_empty() {
            String::new()
        } else {
            format!(
                "{} of {} chunks held by {}; ",
                known(map.held_count),
                known(map.chunk_count),
                map.holders.join(", ")
            )
        };
        let registered = if map.provenance.is_empty() {
            String::new()
        } else {
            format!("; registered, rests on {}", map.provenance.join(", "))
        };
        output::print_line(&format!(
            "{} {} ({}{registered}): {holders}{} came, {} points",
            map.anchor,
            map.epoch,
            map.datum.as_deref().unwrap_or("no datum known"),
            map.received_count,
            map.point_count
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_question_that_makes_no_sense_is_refused_with_the_form_expected() {
        for good in [
            "anchor/*/map",
            "anchor/*/map/**?bbox=1,2,3,4",
            "anchor/*/map/*/*?since=1-0000000a:7;bbox=-1,-2,3,4.5;_time=[now(-1s)..]",
        ] {
            assert!(check_selector(good).is_ok(), "{good}");
        }
        for (bad, expected) in [
            (
                "anchor/*/map?bbox=1",
                "east_min,north_min,east_max,north_max",
            ),
            ("anchor/*/map?since=zz", "{epoch}:{n}"),
            ("anchor/*/map?box=1,2,3,4", "parameter \"box\""),
            ("anchor//map", "is no key expression"),
            ("", "is no key expression"),
        ] {
            let error = check_selector(bad).unwrap_err().to_string();
            assert!(error.contains(expected), "{bad}: {error}");
        }
    }

    #[test]
    fn where_points_go_is_checked_before_anybody_is_asked() {
        let folder = tempfile::tempdir().unwrap();
        let refusal = |name: &str| check_out(&folder.path().join(name)).unwrap_err();
        for name in ["a.las", "a.GeoJSON", "a.mcap"] {
            let error = refusal(name);
            assert!(!error.is::<UsageError>(), "{error}");
            assert!(error.to_string().contains("is not built yet"), "{error}");
        }
        assert!(refusal("a.doc").is::<UsageError>());
        std::fs::create_dir(folder.path().join("a.ply")).unwrap();
        let error = refusal("a.ply").to_string();
        assert!(error.starts_with("this is a folder"), "{error}");
    }
}
