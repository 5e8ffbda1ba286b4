//! Broken takes: a clear error that names the place, never a panic.

use std::{fs, path::Path, sync::LazyLock};

use palpate_messages::{foxglove::JointStates, proto::TactileSample};
use palpate_recording::Take;
use proptest::prelude::*;
use prost::Message as _;

use crate::support::{Edit, meta, rewrite, rewrite_all, take_bytes, tree};

static GOOD: LazyLock<Vec<u8>> = LazyLock::new(|| take_bytes(3000, &meta()));

fn error_of(bytes: &[u8]) -> String {
    Take::from_bytes(Path::new("take-01.mcap"), bytes).unwrap_err().to_string()
}

fn edit_tactile(edit: Edit<'_>, topic: &str, number: usize, change: impl FnOnce(&mut TactileSample)) {
    if edit.topic == topic && edit.number == number {
        let mut sample = TactileSample::decode(edit.data.as_slice()).unwrap();
        change(&mut sample);
        *edit.data = sample.encode_to_vec();
    }
}

fn edit_joints(edit: Edit<'_>, number: usize, change: impl FnOnce(&mut JointStates)) {
    if edit.topic == "/joint_states" && edit.number == number {
        let mut joints = JointStates::decode(edit.data.as_slice()).unwrap();
        change(&mut joints);
        *edit.data = joints.encode_to_vec();
    }
}

#[test]
fn every_fault_of_the_content_names_topic_message_and_channel() {
    let cases: Vec<(Vec<u8>, &str)> = vec![
        (
            rewrite(&GOOD, |edit| {
                edit_tactile(edit, "/tactile/gel", 7, |sample| {
                    sample.raw[1] = f32::NAN;
                });
            }),
            "take-01.mcap: /tactile/gel: message 8 at 0.070 s: channel \"tip.1\" reads NaN, expected a finite number",
        ),
        (
            rewrite(&GOOD, |edit| edit_tactile(edit, "/tactile/film", 4, |sample| sample.active.push(true))),
            "take-01.mcap: /tactile/film: message 5 at 0.100 s: 3 channels, the attached station has 2 in this stream",
        ),
        (
            rewrite(&GOOD, |edit| edit_tactile(edit, "/tactile/film", 4, |sample| sample.raw.truncate(1))),
            "take-01.mcap: /tactile/film: message 5 at 0.100 s: 1 raw readings, the attached station has 2 in this stream",
        ),
        (
            rewrite(&GOOD, |edit| edit_tactile(edit, "/tactile/film", 4, |sample| sample.raw.clear())),
            "some samples of this stream have raw readings and some have none",
        ),
        (
            rewrite(&GOOD, |edit| {
                edit_joints(edit, 3, |message| {
                    message.joints[1].position = Some(f64::NAN);
                });
            }),
            "take-01.mcap: /joint_states: message 4 at 0.300 s: joint \"curl\" is at NaN, expected a finite number",
        ),
        (
            rewrite(&GOOD, |edit| {
                edit_joints(edit, 3, |message| {
                    message.joints[0].position = None;
                });
            }),
            "/joint_states: message 4 at 0.300 s: joint \"slide\" has no position",
        ),
        (
            rewrite(&GOOD, |edit| edit_joints(edit, 0, |message| message.joints.swap(0, 1))),
            "/joint_states: message 1 at 0.000 s: joint 0 is \"curl\", the attached station has \"slide\" there",
        ),
        (
            rewrite(&GOOD, |edit| edit_joints(edit, 0, |message| message.joints.truncate(1))),
            "/joint_states: message 1 at 0.000 s: 1 joints, the attached station has 2",
        ),
        (
            rewrite(&GOOD, |edit| {
                if edit.topic == "/tactile/gel" && edit.number == 10 {
                    *edit.log_time -= 20_000_000;
                }
            }),
            "take-01.mcap: /tactile/gel: message 11: its time 0.08 s does not come after 0.09 s",
        ),
        (
            rewrite(&GOOD, |edit| {
                if edit.topic == "/joint_states" && edit.number == 2 {
                    *edit.log_time = 5;
                }
            }),
            "/joint_states: message 3: its time 5 ns lies before the take's start",
        ),
        (
            rewrite(&GOOD, |edit| {
                if edit.topic == "/tactile/film" {
                    *edit.topic = "/tactile/foil".to_owned();
                }
            }),
            "take-01.mcap: /tactile/foil: the attached station \"finger\" has no stream \"foil\", only \"gel\", \"film\"",
        ),
        (
            rewrite(&GOOD, |edit| *edit.dropped = edit.topic == "/tactile/film"),
            "take-01.mcap: /tactile/film: no messages, but the attached station \"finger\" has the stream \"film\"",
        ),
        (
            rewrite(&GOOD, |edit| *edit.dropped = edit.topic == "/joint_states"),
            "take-01.mcap: /joint_states: no messages",
        ),
        (
            rewrite(&GOOD, |edit| {
                if edit.topic == "/markers" {
                    *edit.schema = "palpate.Mark".to_owned();
                }
            }),
            "take-01.mcap: /markers: messages are palpate.Mark in \"protobuf\", expected palpate.Marker",
        ),
        (
            rewrite(&GOOD, |edit| {
                if edit.topic == "/tactile/gel" && edit.number == 1 {
                    *edit.data = vec![0xff; 9];
                }
            }),
            "take-01.mcap: /tactile/gel: message 2 at 0.010 s: failed to decode Protobuf message",
        ),
    ];
    for (bytes, expected) in cases {
        let error = error_of(&bytes);
        assert!(error.contains(expected), "{error}\nlacks\n{expected}");
    }
}

#[test]
fn a_take_without_its_station_or_metadata_says_which_is_missing() {
    let without = |dropped: &str| error_of(&rewrite_all(&GOOD, |_| {}, |name| name != dropped, |_| {}));
    assert!(without("station.toml").contains("attachment \"station.toml\": missing"));
    assert!(without("palpate.take").contains("metadata \"palpate.take\": missing"));
    let layout_gone = rewrite_all(&GOOD, |_| {}, |name| name != "layout.toml", |_| {});
    let error = Take::from_bytes(Path::new("take-01.mcap"), &layout_gone).unwrap_err();
    assert_eq!(error.to_string(), "take-01.mcap: in the station's files");
    let source = std::error::Error::source(&error).unwrap().to_string();
    assert!(source.contains("layout.toml"), "{source}");
}

#[test]
fn wrong_metadata_is_named_by_key() {
    for (key, value, expected) in [
        ("format", "2", "\"2\", expected at most 1; a newer palpate wrote this take"),
        ("format", "one", "expected a number"),
        ("start_unix_ns", "-3", "expected ns since 1970"),
        ("object_position_m", "1 2", "expected three finite numbers"),
        ("object_position_m", "1 2 nan", "expected three finite numbers"),
        ("object_quaternion_wxyz", "0 0 0 0", "expected four finite numbers that make a rotation"),
        ("fixture_trusted", "maybe", "expected true or false"),
    ] {
        let changed = rewrite_all(
            &GOOD,
            |_| {},
            |_| true,
            |metadata| {
                metadata.insert(key.to_owned(), value.to_owned());
            },
        );
        let error = error_of(&changed);
        assert!(
            error.contains(&format!("metadata \"palpate.take\", {key}")) && error.contains(expected),
            "{error}"
        );
    }
    let gone = rewrite_all(
        &GOOD,
        |_| {},
        |_| true,
        |metadata| {
            metadata.remove("object");
        },
    );
    assert!(error_of(&gone).contains("metadata \"palpate.take\", object: missing"));
}

#[test]
fn what_is_no_mcap_file_is_called_so() {
    for bytes in [&b""[..], b"t_s,q0\n", &[0x89, b'M', b'C']] {
        let error = error_of(bytes);
        assert!(error.starts_with("take-01.mcap: byte "), "{error}");
    }
    assert!(error_of(b"t_s,q0,q1,q2\n0,0,0,0\n").contains("not an MCAP file"));
}

#[test]
fn a_truncated_file_says_how_far_it_is_intact() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("take-02.mcap");
    // The summary and a part of the last chunk are gone.
    let cut = GOOD.len() - GOOD.len() / 3;
    fs::write(&path, &GOOD[..cut]).unwrap();
    let before = tree(dir.path());
    let error = Take::read(&path).unwrap_err().to_string();
    assert!(
        error.contains(&format!("take-02.mcap: byte {cut} of {cut}: the recording is cut off")),
        "{error}"
    );
    assert!(
        error.contains("last intact message is at") && error.contains("palpate session check"),
        "{error}"
    );
    assert_eq!(tree(dir.path()), before);
}

#[test]
fn what_was_flushed_is_recovered() {
    let whole = Take::from_bytes(Path::new("take-03.mcap"), &GOOD).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("take-03.mcap");
    // Just before the summary section every chunk is there.
    let summary_start = usize::try_from(mcap::read::footer(&GOOD).unwrap().summary_start).unwrap();
    fs::write(&path, &GOOD[..summary_start - 20]).unwrap();
    let recovered = Take::recover(&path).unwrap();
    assert_eq!((&recovered.take.joints, &recovered.take.streams), (&whole.joints, &whole.streams));
    assert!(recovered.damage.unwrap().contains("cut off"));

    // A flush at 0, 1 and 2 s: what a cut in the last chunk leaves is the first two seconds and that sample.
    let chunks = mcap::Summary::read(&GOOD).unwrap().unwrap().chunk_indexes;
    let last_chunk = chunks.iter().map(|chunk| chunk.chunk_start_offset).max().unwrap();
    fs::write(&path, &GOOD[..usize::try_from(last_chunk).unwrap() + 60]).unwrap();
    let recovered = Take::recover(&path).unwrap();
    assert_eq!(recovered.take.num_frames(), 21);
    assert!(recovered.damage.unwrap().contains("last intact message is at 2.000 s"));

    fs::write(&path, &**GOOD).unwrap();
    assert_eq!(Take::recover(&path).unwrap().damage, None);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn a_cut_anywhere_is_refused_with_the_place(cut in 0..GOOD.len()) {
        let error = error_of(&GOOD[..cut]);
        prop_assert!(error.starts_with("take-01.mcap: byte "), "{}", error);
    }

    #[test]
    fn flipped_bytes_never_panic(flips in prop::collection::vec((0..GOOD.len(), 1..=255_u8), 1..6)) {
        let mut bytes = GOOD.clone();
        for (position, mask) in flips {
            bytes[position] ^= mask;
        }
        let _ = Take::from_bytes(Path::new("take-01.mcap"), &bytes);
    }
}
