//! Files are written here with the `mcap` crate, or record by record where that cannot compress.

use std::collections::BTreeMap;
use std::fs;
use std::io::{Read, Write};

use mcap::records::MessageHeader;
use tempfile::TempDir;

use super::*;
use crate::dataset::decode::Samples;
use crate::dataset::{Camera, CameraEvent, Dataset, DatasetCamera, DatasetError};

mod damage;
mod wire;

use wire::{Field, Style, protobuf_message, ros_message};

const COMPRESSED: &str = "sensor_msgs/msg/CompressedImage";
const RAW: &str = "sensor_msgs/msg/Image";
const CAMERA_INFO: &str = "sensor_msgs/msg/CameraInfo";

/// A message of a topic: topic, schema, encoding, log time in nanoseconds, bytes.
type TestMessage = (&'static str, &'static str, &'static str, u64, Vec<u8>);

fn pgm(shade: u8) -> Vec<u8> {
    let mut bytes = b"P5 32 24 255\n".to_vec();
    bytes.resize(bytes.len() + 32 * 24, shade);
    bytes
}

fn compressed(style: Style, seconds: u32, image: &[u8]) -> Vec<u8> {
    let header = [Field::Header(seconds, 500), Field::Text("camera")];
    let body = [Field::Text("pgm"), Field::Bytes(image)];
    ros_message(style, &[header, body].concat())
}

fn raw(style: Style, seconds: u32, shade: u8) -> Vec<u8> {
    // Rows of 32 pixels and 3 bytes more.
    let pixels = vec![shade; 35 * 24];
    ros_message(
        style,
        &[
            Field::Header(seconds, 500),
            Field::Text("camera"),
            Field::U32(24),
            Field::U32(32),
            Field::Text("mono8"),
            Field::U8(0),
            Field::U32(35),
            Field::Bytes(&pixels),
        ],
    )
}

fn camera_info(style: Style, fx: f64) -> Vec<u8> {
    camera_info_of(style, fx, (32, 24), [0; 6])
}

/// - `readout`: binning across and down, column, row, height and width of the region.
fn camera_info_of(style: Style, fx: f64, size_px: (u32, u32), readout: [u32; 6]) -> Vec<u8> {
    let k = [fx, 0.0, 16.0, 0.0, fx, 12.0, 0.0, 0.0, 1.0];
    let p = [
        40.0, 0.0, 15.0, 0.0, 0.0, 40.0, 11.0, 0.0, 0.0, 0.0, 1.0, 0.0,
    ];
    let fields = [
        Field::Header(1, 0),
        Field::Text("camera"),
        Field::U32(size_px.1),
        Field::U32(size_px.0),
        Field::Text("plumb_bob"),
        Field::U32(5),
    ];
    let numbers = [&[-0.1, 0.01, 0.0, 0.0, 0.0], &k[..], &[0.0; 9], &p].concat();
    let numbers = numbers.into_iter().map(Field::F64);
    let readout = readout.map(Field::U32).into_iter().chain([Field::U8(0)]);
    ros_message(
        style,
        &fields
            .into_iter()
            .chain(numbers)
            .chain(readout)
            .collect::<Vec<_>>(),
    )
}

fn write_with(options: mcap::WriteOptions, messages: &[TestMessage]) -> Vec<u8> {
    let mut file = std::io::Cursor::new(Vec::new());
    let mut writer = options.create(&mut file).unwrap();
    let mut channels = BTreeMap::new();
    for (topic, schema, encoding, log_time, data) in messages {
        let channel_id = *channels.entry(*topic).or_insert_with(|| {
            let schema_id = writer.add_schema(schema, "ros2msg", b"").unwrap();
            let metadata = BTreeMap::new();
            writer
                .add_channel(schema_id, topic, encoding, &metadata)
                .unwrap()
        });
        let header = MessageHeader {
            channel_id,
            sequence: 0,
            log_time: *log_time,
            publish_time: *log_time,
        };
        writer.write_to_known_channel(&header, data).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    file.into_inner()
}

fn write(messages: &[TestMessage]) -> Vec<u8> {
    write_with(mcap::WriteOptions::new().compression(None), messages)
}

fn in_file(bytes: &[u8]) -> (TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.mcap");
    fs::write(&path, bytes).unwrap();
    (folder, path)
}

fn shades(recording: &McapRecording) -> Vec<(i64, u8)> {
    let mut images = recording.images();
    let stamped = recording.stamped().iter();
    stamped
        .map(|(message_idx, captured_at)| {
            let raster = images.read(*message_idx).unwrap();
            assert_eq!(raster.size_px(), (32, 24));
            let shade = match raster.samples {
                Samples::Eight(values) => values[100],
                Samples::Sixteen { .. } => 0,
            };
            (captured_at.nanoseconds(), shade)
        })
        .collect()
}

/// Three images and a calibration.
fn flight() -> Vec<TestMessage> {
    let mut messages = vec![(
        "/cam/camera_info",
        CAMERA_INFO,
        "cdr",
        5,
        camera_info(Style::Cdr, 30.0),
    )];
    for idx in 1..4_u8 {
        let data = compressed(Style::Cdr, u32::from(idx), &pgm(10 * idx));
        messages.push((
            "/cam/image/compressed",
            COMPRESSED,
            "cdr",
            u64::from(idx),
            data,
        ));
    }
    messages
}

const FLIGHT: [(i64, u8); 3] = [
    (1_000_000_500, 10),
    (2_000_000_500, 20),
    (3_000_000_500, 30),
];

#[test]
fn every_way_of_writing_images_is_read() {
    let check = |style, encoding, names: [&'static str; 3]| {
        let mut messages = vec![("/info", names[2], encoding, 1, camera_info(style, 30.0))];
        for idx in 1..3_u8 {
            let (seconds, log_time) = (u32::from(idx), u64::from(idx));
            let data = compressed(style, seconds, &pgm(10 * idx));
            messages.push(("/a", names[0], encoding, log_time, data));
            let data = raw(style, seconds, 10 * idx);
            messages.push(("/b", names[1], encoding, log_time, data));
        }
        let (_folder, path) = in_file(&write(&messages));
        for topic in ["/a", "b"] {
            let recording = McapRecording::open(&path, Some(topic)).unwrap();
            assert_eq!(shades(&recording), FLIGHT[..2], "{topic} {style:?}");
            assert_eq!(recording.cut(), None);
        }
        let one_kind: Vec<TestMessage> = messages;
        let one_kind: Vec<_> = one_kind.into_iter().filter(|one| one.0 != "/b").collect();
        let (_folder, path) = in_file(&write(&one_kind));
        let recording = McapRecording::open(&path, None).unwrap();
        let camera = recording
            .calibration()
            .unwrap()
            .info
            .calibration()
            .unwrap()
            .camera;
        assert_eq!((camera.width(), camera.height()), (32, 24));
        assert_eq!(camera.intrinsics().fx, 30.0);
    };
    let ros_2 = [COMPRESSED, RAW, CAMERA_INFO];
    check(Style::Cdr, "cdr", ros_2);
    check(Style::CdrBigEndian, "cdr", ros_2);
    check(Style::Cdr2, "cdr", ros_2);
    let ros_1 = [
        "sensor_msgs/CompressedImage",
        "sensor_msgs/Image",
        "sensor_msgs/CameraInfo",
    ];
    check(Style::Ros1, "ros1", ros_1);
}

#[test]
fn foxgloves_own_messages_are_read() {
    let stamp = protobuf_message(&[(1, Field::Varint(7)), (2, Field::Varint(9))]);
    let image = pgm(40);
    let compressed = protobuf_message(&[
        (1, Field::Bytes(&stamp)),
        (4, Field::Text("camera")),
        (2, Field::Bytes(&image)),
        (3, Field::Text("pgm")),
    ]);
    let pixels = [50; 32 * 24];
    let raw = protobuf_message(&[
        (1, Field::Bytes(&stamp)),
        (2, Field::U32(32)),
        (3, Field::U32(24)),
        (4, Field::Text("mono8")),
        (5, Field::U32(32)),
        (6, Field::Bytes(&pixels)),
    ]);
    let packed = |numbers: &[f64]| -> Vec<u8> {
        numbers
            .iter()
            .flat_map(|number| number.to_le_bytes())
            .collect()
    };
    let d = packed(&[0.1, 0.0, 0.0, 0.0]);
    let k = packed(&[30.0, 0.0, 16.0, 0.0, 30.0, 12.0, 0.0, 0.0, 1.0]);
    let info = protobuf_message(&[
        (2, Field::U32(32)),
        (3, Field::U32(24)),
        (4, Field::Text("plumb_bob")),
        (5, Field::Bytes(&d)),
        (6, Field::Bytes(&k)),
    ]);
    let bytes = write(&[
        ("/a", "foxglove.CompressedImage", "protobuf", 1, compressed),
        ("/b", "foxglove.RawImage", "protobuf", 1, raw),
        (
            "/b/camera_info",
            "foxglove.CameraCalibration",
            "protobuf",
            1,
            info,
        ),
    ]);
    let (_folder, path) = in_file(&bytes);
    for (topic, shade) in [("/a", 40), ("/b", 50)] {
        let recording = McapRecording::open(&path, Some(topic)).unwrap();
        assert_eq!(shades(&recording), [(7_000_000_009, shade)]);
        let camera = recording
            .calibration()
            .map(|found| found.info.calibration().unwrap());
        assert_eq!(camera.is_some(), topic == "/b");
    }
}

#[test]
fn the_topic_is_chosen_where_it_is_not_clear() {
    let image = |topic, log_time| {
        let data = compressed(Style::Cdr, log_time as u32, &pgm(1));
        (topic, COMPRESSED, "cdr", log_time, data)
    };
    let odd = (
        "/odd",
        "foxglove.CompressedVideo",
        "protobuf",
        1,
        vec![1, 2],
    );
    let refusal = |messages: &[TestMessage], topic| {
        let (_folder, path) = in_file(&write(messages));
        McapRecording::open(&path, topic).unwrap_err().to_string()
    };
    let both = [image("/right", 1), image("/left", 1), odd.clone()];
    let several = refusal(&both, None);
    let expected = "choose one with --topic: /left (sensor_msgs/msg/CompressedImage, cdr), /right";
    assert!(several.contains(expected), "{several}");
    assert!(!several.contains("/odd"), "{several}");
    let unknown = refusal(&both, Some("/middle"));
    assert!(
        unknown.starts_with("no images on topic \"/middle\"; the topics are /left"),
        "{unknown}"
    );
    let none = refusal(&[odd], None);
    assert!(
        none.contains("got /odd (foxglove.CompressedVideo, protobuf)"),
        "{none}"
    );
    assert!(refusal(&[], None).ends_with("got none"));
}

#[test]
fn the_calibration_is_that_of_the_images() {
    let info = |topic, fx| (topic, CAMERA_INFO, "cdr", 1, camera_info(Style::Cdr, fx));
    let image = |topic| (topic, RAW, "cdr", 1, raw(Style::Cdr, 1, 7));
    let messages = [
        info("/left/camera_info", 31.0),
        info("/right/camera_info", 32.0),
        info("/right/camera_info", 99.0),
        image("/left/image_raw"),
        image("/right/image_raw/scaled"),
        image("/right/image_rect"),
        image("/third/image"),
    ];
    let (_folder, path) = in_file(&write(&messages));
    let check = |topic, expected: Option<(&str, f64)>| {
        let recording = McapRecording::open(&path, Some(topic)).unwrap();
        let found = recording.calibration().map(|found| {
            let camera = found.info.calibration().unwrap().camera;
            (found.topic.clone(), camera.intrinsics().fx)
        });
        let found = found.as_ref().map(|(topic, fx)| (topic.as_str(), *fx));
        assert_eq!(found, expected, "{topic}");
    };
    check("/left/image_raw", Some(("/left/camera_info", 31.0)));
    check(
        "/right/image_raw/scaled",
        Some(("/right/camera_info", 32.0)),
    );
    check("/right/image_rect", Some(("/right/camera_info", 40.0)));
    check("/third/image", None);
}

#[test]
fn a_camera_that_bins_and_crops_is_that_of_its_images() {
    let images = compressed(Style::Cdr, 1, &pgm(9));
    for (style, encoding) in [
        (Style::Cdr, "cdr"),
        (Style::Cdr2, "cdr"),
        (Style::Ros1, "ros1"),
    ] {
        // Half of the columns and rows of the middle of 96×72 pixels.
        let info = camera_info_of(style, 60.0, (96, 72), [2, 2, 0, 0, 48, 64]);
        let messages = [
            ("/cam/image", COMPRESSED, "cdr", 1, images.clone()),
            ("/cam/camera_info", CAMERA_INFO, encoding, 1, info),
        ];
        let (_folder, path) = in_file(&write(&messages));
        let dataset = Dataset::open(&path.display().to_string().parse().unwrap());
        let camera = dataset.map(|dataset| dataset.calibration().camera.clone());
        let camera = camera.unwrap();
        assert_eq!((camera.width(), camera.height()), (32, 24));
        let intrinsics = camera.intrinsics();
        assert_eq!(
            (intrinsics.fx, intrinsics.cx, intrinsics.cy),
            (30.0, 8.0, 6.0)
        );
    }
    // Images of the whole sensor are not what it says.
    let messages = [
        ("/cam/image", COMPRESSED, "cdr", 1, images),
        (
            "/cam/camera_info",
            CAMERA_INFO,
            "cdr",
            1,
            camera_info_of(Style::Cdr, 60.0, (96, 72), [2, 2, 0, 0, 0, 0]),
        ),
    ];
    let (_folder, path) = in_file(&write(&messages));
    let error = Dataset::open(&path.display().to_string().parse().unwrap()).unwrap_err();
    let error = error.to_string();
    assert!(
        error.contains("is for 48×36, the images have 32×24"),
        "{error}"
    );
}

#[test]
fn a_folder_with_one_file_is_that_recording_and_brings_its_calibration() {
    let open = |messages: &[TestMessage]| {
        let (folder, _) = in_file(&write(messages));
        let dataset = Dataset::open(&folder.path().display().to_string().parse().unwrap())?;
        let mut camera = DatasetCamera::inline(dataset.clone());
        let events = std::iter::from_fn(|| camera.next_event());
        let shades = events.filter_map(|event| match event {
            CameraEvent::Frame(frame) => Some(frame.image.get(5, 5)),
            CameraEvent::Unreadable { .. } => None,
        });
        let fx = dataset.calibration().camera.intrinsics().fx;
        Ok::<_, DatasetError>((fx, shades.collect::<Vec<u8>>()))
    };
    assert_eq!(open(&flight()).unwrap(), (30.0, vec![10, 20, 30]));
    let mut uncalibrated = flight();
    uncalibrated[0].4 = camera_info(Style::Cdr, 0.0);
    let error = open(&uncalibrated).unwrap_err().to_string();
    assert!(
        error.contains("(that which is there is empty), camera.yaml"),
        "{error}"
    );
    let error = open(&flight()[1..]).unwrap_err().to_string();
    let expected = "one of flight.yaml, camera_info in the file, camera.yaml";
    assert!(error.contains(expected), "{error}");
}

#[test]
fn images_without_stamps_count_as_taken_when_they_were_logged() {
    let image = |seconds, log_time| {
        let data = raw(Style::Cdr, seconds, seconds as u8);
        ("/a", RAW, "cdr", log_time, data)
    };
    let unstamped = |log_time| {
        let mut message = image(0, log_time);
        // Seconds and nanoseconds stand behind the encapsulation.
        message.4[4..12].fill(0);
        message
    };
    let (_folder, path) = in_file(&write(&[unstamped(70), unstamped(90)]));
    let recording = McapRecording::open(&path, None).unwrap();
    assert_eq!(shades(&recording), [(70, 0), (90, 0)]);
    // One that is out of order is left out, and the numbers of the others stay.
    let messages = [image(1, 1), image(5, 2), image(4, 3), image(6, 4)];
    let (_folder, path) = in_file(&write(&messages));
    let recording = McapRecording::open(&path, None).unwrap();
    let numbers: Vec<usize> = recording.stamped().iter().map(|one| one.0).collect();
    assert_eq!(
        (numbers, recording.out_of_order_count()),
        (vec![0, 1, 3], 1)
    );
    let seen: Vec<u8> = shades(&recording).iter().map(|one| one.1).collect();
    assert_eq!(seen, [1, 5, 6]);
}

/// The same file with its chunk compressed.
fn recompressed(bytes: &[u8], name: &str, compress: impl Fn(&[u8]) -> Vec<u8>) -> Vec<u8> {
    let options = mcap::sans_io::LinearReaderOptions::default().with_emit_chunks(true);
    let mut reader = mcap::sans_io::LinearReader::new_with_options(options);
    let mut rest = bytes;
    let mut file = mcap::MAGIC.to_vec();
    while let Some(event) = reader.next_event() {
        match event.unwrap() {
            mcap::sans_io::LinearReadEvent::ReadRequest(count) => {
                let read = rest.read(reader.insert(count)).unwrap();
                reader.notify_read(read);
            }
            mcap::sans_io::LinearReadEvent::Record { data, opcode } => {
                let body = match mcap::parse_record(opcode, data).unwrap() {
                    mcap::records::Record::Chunk { header, data } => {
                        let packed = compress(&data);
                        let mut body = header.message_start_time.to_le_bytes().to_vec();
                        body.extend(header.message_end_time.to_le_bytes());
                        body.extend((data.len() as u64).to_le_bytes());
                        body.extend(header.uncompressed_crc.to_le_bytes());
                        body.extend((name.len() as u32).to_le_bytes());
                        body.extend(name.as_bytes());
                        body.extend((packed.len() as u64).to_le_bytes());
                        body.extend(packed);
                        body
                    }
                    _ => data.to_vec(),
                };
                file.push(opcode);
                file.extend((body.len() as u64).to_le_bytes());
                file.extend(body);
            }
        }
    }
    file.extend(mcap::MAGIC);
    file
}

fn lz4(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn zstd(bytes: &[u8]) -> Vec<u8> {
    ruzstd::encoding::compress_to_vec(bytes, ruzstd::encoding::CompressionLevel::Fastest)
}

#[test]
fn chunks_may_be_compressed_or_absent() {
    let check = |bytes: &[u8]| {
        let (_folder, path) = in_file(bytes);
        let recording = McapRecording::open(&path, None).unwrap();
        assert_eq!(shades(&recording), FLIGHT);
        assert_eq!(recording.cut(), None);
        assert!(recording.calibration().is_some());
    };
    let plain = write(&flight());
    check(&plain);
    check(&write_with(
        mcap::WriteOptions::new().use_chunks(false),
        &flight(),
    ));
    let small = mcap::WriteOptions::new()
        .compression(None)
        .chunk_size(Some(900));
    check(&write_with(small, &flight()));
    let packed = recompressed(&plain, "lz4", lz4);
    assert!(packed.len() < plain.len());
    check(&packed);
    check(&recompressed(&plain, "zstd", zstd));
    let (_folder, path) = in_file(&recompressed(&plain, "brotli", <[u8]>::to_vec));
    let error = McapRecording::open(&path, None).unwrap_err().to_string();
    assert!(
        error.contains("\"brotli\" is not known, expected zstd or lz4"),
        "{error}"
    );
}
