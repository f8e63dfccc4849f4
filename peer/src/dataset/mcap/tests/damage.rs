//! Files that were cut off, or whose bytes changed.

use super::*;

#[test]
fn a_file_cut_off_anywhere_has_the_images_before_the_cut() {
    let small = mcap::WriteOptions::new()
        .compression(None)
        .chunk_size(Some(900));
    let plain = write_with(small, &flight());
    for whole in [
        recompressed(&plain, "lz4", lz4),
        recompressed(&plain, "zstd", zstd),
        plain,
    ] {
        let data_end = find_data_end(&whole);
        let mut counts = Vec::new();
        for length in (0..whole.len()).step_by(11) {
            let (_folder, path) = in_file(&whole[..length]);
            match McapRecording::open(&path, None) {
                Ok(recording) => {
                    let images = shades(&recording);
                    assert_eq!(images, FLIGHT[..images.len()], "{length}");
                    assert_eq!(recording.cut().is_some(), length < data_end, "{length}");
                    counts.push(images.len());
                }
                Err(_) => counts.push(0),
            }
        }
        assert!(counts.is_sorted(), "{counts:?}");
        assert_eq!(counts.first().zip(counts.last()), Some((&0, &3)));
        assert!(counts.contains(&1), "{counts:?}");
    }
}

#[test]
fn a_file_of_which_next_to_nothing_is_left_is_called_cut() {
    let whole = write(&flight());
    for length in [0, 5, 8, 20, 60] {
        let (_folder, path) = in_file(&whole[..length]);
        let error = McapRecording::open(&path, None).unwrap_err().to_string();
        assert!(
            error.starts_with("cut off or damaged after "),
            "{length}: {error}"
        );
    }
    let (_folder, path) = in_file(b"no mcap at all");
    let error = McapRecording::open(&path, None).unwrap_err().to_string();
    assert!(error.starts_with("no MCAP file"), "{error}");
}

#[test]
fn a_chunk_whose_contents_changed_ends_the_recording_before_it() {
    let small = mcap::WriteOptions::new()
        .compression(None)
        .chunk_size(Some(700));
    let plain = write_with(small, &flight());
    let check = |bytes: &[u8], intact_count: usize| {
        let (_folder, path) = in_file(bytes);
        let recording = McapRecording::open(&path, None).unwrap();
        assert_eq!(shades(&recording), FLIGHT[..intact_count]);
        let cut = recording.cut().unwrap();
        assert!(cut.contains("its contents are damaged: checksum "), "{cut}");
        let number = format!("cannot read chunk {}, ", intact_count + 1);
        assert!(cut.starts_with(&number), "{cut}");
        let offset = cut.split("begins at byte ").nth(1).unwrap();
        let offset: usize = offset.split(':').next().unwrap().parse().unwrap();
        assert_eq!(bytes[offset], mcap::records::op::CHUNK, "{cut}");
    };
    for idx in 1..3 {
        // A row of an image, which nothing else looks like.
        let row = [10 * (idx as u8 + 1); 32];
        let damaged = |bytes: &[u8]| {
            let mut bytes = bytes.to_vec();
            if let Some(place) = bytes.windows(32).position(|window| window == row) {
                bytes[place + 5] ^= 1;
            }
            bytes
        };
        check(&damaged(&plain), idx);
        check(
            &recompressed(&plain, "lz4", |chunk| lz4(&damaged(chunk))),
            idx,
        );
        check(
            &recompressed(&plain, "zstd", |chunk| zstd(&damaged(chunk))),
            idx,
        );
    }
}

/// Where a file says that its data ends.
fn find_data_end(bytes: &[u8]) -> usize {
    let head = [&[mcap::records::op::DATA_END][..], &4_u64.to_le_bytes()].concat();
    let start = bytes.windows(9).position(|window| window == head);
    start.unwrap() + 9
}

#[test]
fn damage_ends_the_recording_and_nothing_panics() {
    let small = mcap::WriteOptions::new()
        .compression(None)
        .chunk_size(Some(900));
    let whole = write_with(small, &flight());
    for place in (0..whole.len()).step_by(13) {
        let mut bytes = whole.clone();
        bytes[place] ^= 0xff;
        let (_folder, path) = in_file(&bytes);
        if let Ok(recording) = McapRecording::open(&path, None) {
            let mut images = recording.images();
            for (message_idx, _) in recording.stamped() {
                let _ = images.read(*message_idx);
            }
        }
    }
}
