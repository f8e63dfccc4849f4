//! `starling map`.

mod collect;

use std::path::PathBuf;
use std::time::Duration;

use anyhow::bail;
use clap::Subcommand;
use serde::Serialize;

use super::{Exit, output};
use crate::files::{PointCloud, write_cloud};
use crate::link::ask;
use collect::Collection;

#[derive(Subcommand)]
pub enum MapCommand {
    /// Ask the network for maps and export them.
    Get(GetArguments),
}

#[derive(clap::Args)]
pub struct GetArguments {
    /// A key expression: 'anchor/*/map' lists maps, 'anchor/*/map/*/*' brings chunks.
    pub selector: String,
    /// Where to ask; may be repeated.
    #[arg(long, value_name = "ENDPOINT", default_value = "tcp/127.0.0.1:7447")]
    pub connect: Vec<String>,
    /// Export the points; the extension chooses the format: ply, pcd, xyz or csv.
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

fn print(maps: Vec<MapSummary>, arguments: &GetArguments) -> anyhow::Result<()> {
    if arguments.json {
        return output::print_json(&MapJson {
            maps,
            out: arguments.out.clone(),
        });
    }
    for map in &maps {
        let known = |count: Option<u64>| count.map_or("?".to_owned(), |count| count.to_string());
        output::print_line(&format!(
            "{} {} ({}): {} of {} chunks held by {}; {} came, {} points",
            map.anchor,
            map.epoch,
            map.datum.as_deref().unwrap_or("no datum known"),
            known(map.held_count),
            known(map.chunk_count),
            map.holders.join(", "),
            map.received_count,
            map.point_count
        ));
    }
    Ok(())
}
