//! The beacon: what a vehicle holds of every map, in one small message.

use serde::{Deserialize, Serialize};

use crate::codec::{Message, VERSION, encode};
use crate::{ChunkNumber, MapId, Ranges, VehicleId, wire};

/// A beacon fits into one packet.
pub const MAX_BEACON_BYTES: usize = 1200;
/// More entries than this cannot fit: one has at least 16 bytes.
const ENTRY_COUNT_MAX: usize = 75;

/// What a vehicle holds. If it holds more maps than fit, successive beacons rotate through them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Have {
    /// Whose beacon it is.
    pub vehicle: VehicleId,
    /// How many maps it holds altogether: more than `entries` where the beacon rotates.
    pub map_count: u32,
    /// What it holds of some maps.
    pub entries: Vec<HaveEntry>,
}

/// What a vehicle holds of one map.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HaveEntry {
    /// Which map.
    pub map: MapId,
    /// The highest chunk number; `None` if it holds no chunk.
    pub highest: Option<ChunkNumber>,
    /// How many chunks.
    pub count: u64,
    /// [`Ranges::digest`] of their numbers.
    pub digest: u64,
    /// The highest revision of a placement or a page.
    pub placement_revision: u32,
    /// A digest over the revisions of the placement and of all pages; zero without any.
    pub placement_digest: u64,
}

impl HaveEntry {
    /// What is to be said of a map of which these chunks are held.
    pub fn new(map: MapId, held: &Ranges, placement_revision: u32, placement_digest: u64) -> Self {
        Self {
            map,
            highest: held.highest(),
            count: held.count(),
            digest: held.digest(),
            placement_revision,
            placement_digest,
        }
    }
}

impl Have {
    /// A beacon with as many entries, from `first_idx` on and around, as fit; and the index with
    /// which the next beacon should begin.
    pub fn rotate(vehicle: VehicleId, all: &[HaveEntry], first_idx: usize) -> (Self, usize) {
        let mut beacon = Self {
            vehicle,
            map_count: u32::try_from(all.len()).unwrap_or(u32::MAX),
            entries: Vec::new(),
        };
        let mut size_bytes = encode(&beacon).len() + 2;
        let mut taken_count = 0;
        while taken_count < all.len() && taken_count < ENTRY_COUNT_MAX {
            let entry = &all[(first_idx + taken_count) % all.len()];
            size_bytes += entry_size_bytes(entry);
            if size_bytes > MAX_BEACON_BYTES {
                break;
            }
            beacon.entries.push(entry.clone());
            taken_count += 1;
        }
        let next_idx = if all.is_empty() {
            0
        } else {
            (first_idx + taken_count) % all.len()
        };
        (beacon, next_idx)
    }
}

type EntryWire = (String, String, Option<u32>, u64, u64, u32, u64);

fn entry_to_wire(entry: &HaveEntry) -> EntryWire {
    (
        entry.map.anchor.to_string(),
        entry.map.epoch.to_string(),
        entry.highest.map(|number| number.0),
        entry.count,
        entry.digest,
        entry.placement_revision,
        entry.placement_digest,
    )
}

fn entry_from_wire(wire: &EntryWire) -> Result<HaveEntry, String> {
    let (anchor, epoch, highest, count, digest, placement_revision, placement_digest) = wire;
    let room = highest.map_or(0, |number| u64::from(number) + 1);
    if *count > room || (*count == 0) != highest.is_none() {
        return Err(format!("{count} chunks of at most {room}"));
    }
    Ok(HaveEntry {
        map: wire::map_from_wire(anchor, epoch)?,
        highest: highest.map(ChunkNumber),
        count: *count,
        digest: *digest,
        placement_revision: *placement_revision,
        placement_digest: *placement_digest,
    })
}

/// An upper bound: the ids as they are, and every number at its longest.
fn entry_size_bytes(entry: &HaveEntry) -> usize {
    let ids = entry.map.anchor.as_str().len() + entry.map.epoch.to_string().len();
    1 + ids + 2 * 2 + 5 + 9 + 9 + 5 + 9
}

/// The beacon's fields in the order in which they are written.
#[derive(Serialize, Deserialize)]
pub struct HaveWire {
    version: [u16; 2],
    vehicle: String,
    map_count: u32,
    #[serde(deserialize_with = "wire::list::<_, _, ENTRY_COUNT_MAX>")]
    entries: Vec<EntryWire>,
}

impl Message for Have {
    const KIND: &'static str = "have";
    const SIZE_BYTES_MAX: usize = MAX_BEACON_BYTES;
    type Wire = HaveWire;

    fn to_wire(&self) -> HaveWire {
        HaveWire {
            version: VERSION,
            vehicle: self.vehicle.to_string(),
            map_count: self.map_count,
            entries: self.entries.iter().map(entry_to_wire).collect(),
        }
    }

    fn from_wire(wire: HaveWire) -> Result<Self, String> {
        Ok(Self {
            vehicle: VehicleId::new(&wire.vehicle).map_err(|error| error.to_string())?,
            map_count: wire.map_count,
            entries: wire
                .entries
                .iter()
                .map(entry_from_wire)
                .collect::<Result<_, _>>()?,
        })
    }
}
