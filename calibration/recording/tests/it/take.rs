//! What is written is read back.

use std::{collections::BTreeMap, fmt::Write as _, io::Cursor, path::Path};

use mcap::Summary;
use palpate_recording::{LogLevel, RecordingError, Span, SpanKind, TactileSampleRef, Take, TakeWriter};
use proptest::prelude::*;

use crate::support::{START_UNIX_NS, fixtures, meta, rewrite, station, take_bytes};

/// Strictly increasing times in ns, starting anywhere.
fn times_ns(max_len: usize) -> impl Strategy<Value = Vec<u64>> {
    prop::collection::vec(1..300_000_000_u64, 1..max_len).prop_map(|steps| {
        steps
            .iter()
            .scan(0, |time, step| {
                *time += step;
                Some(*time)
            })
            .collect()
    })
}

/// Times of a stream, and readings and activations of up to as many samples of `width` channels.
fn samples(width: usize) -> impl Strategy<Value = (Vec<u64>, Vec<f32>, Vec<bool>)> {
    (
        times_ns(30),
        prop::collection::vec(-1e6..1e6_f32, 30 * width),
        prop::collection::vec(any::<bool>(), 30 * width),
    )
}

fn secs(times_ns: &[u64]) -> Vec<f64> {
    times_ns.iter().map(|&time_ns| time_ns as f64 / 1e9).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn what_is_written_is_read_back(
        joint_times_ns in times_ns(20),
        positions in prop::collection::vec(-3.0..3.0_f64, 40),
        gel in samples(3),
        film in samples(2),
        gel_is_raw in any::<bool>(),
        device_offset_ns in prop::option::of(1..1_000_000_000_u64),
        spans in prop::collection::vec((0..9_000_u64, 1..9_000_u64), 0..4),
    ) {
        let station = station();
        let meta = meta();
        let mut writer = TakeWriter::new(Cursor::new(Vec::new()), &station, &meta, START_UNIX_NS).unwrap();
        let mut written_spans: Vec<Span> = spans
            .iter()
            .enumerate()
            .map(|(idx, &(start_ms, length_ms))| Span {
                kind: [SpanKind::Baseline, SpanKind::Repetition, SpanKind::Note][idx % 3],
                start_s: start_ms as f64 / 1e3,
                end_s: (start_ms + length_ms) as f64 / 1e3,
                label: format!("span {idx}"),
            })
            .collect();
        for (frame, &time_ns) in joint_times_ns.iter().enumerate() {
            writer.joints(time_ns, &positions[2 * frame..2 * frame + 2]).unwrap();
        }
        for (stream_idx, (times_ns, raw, active)) in [&gel, &film].into_iter().enumerate() {
            let width = [3, 2][stream_idx];
            for (row, &time_ns) in times_ns.iter().enumerate() {
                let cells = row * width..(row + 1) * width;
                let has_raw = stream_idx == 1 || gel_is_raw;
                writer.tactile(stream_idx, time_ns, TactileSampleRef {
                    raw: if has_raw { &raw[cells.clone()] } else { &[] },
                    active: &active[cells],
                    device_time_ns: device_offset_ns.map_or(0, |offset_ns| time_ns + offset_ns),
                }).unwrap();
            }
            writer.flush().unwrap();
        }
        for span in &written_spans {
            writer.span(span).unwrap();
        }
        let bytes = writer.finish().unwrap().into_inner();

        let take = Take::from_bytes(Path::new("some/take-07.mcap"), &bytes).unwrap();
        written_spans.sort_by(|a, b| a.start_s.total_cmp(&b.start_s));
        prop_assert_eq!(&take.id, "take-07");
        prop_assert_eq!(&take.meta, &meta);
        prop_assert_eq!(take.start_unix_ns, START_UNIX_NS);
        prop_assert_eq!(&take.station.files, &station.files);
        prop_assert_eq!(&take.spans, &written_spans);
        prop_assert_eq!(&take.joints.times_s, &secs(&joint_times_ns));
        prop_assert_eq!(&take.joints.positions, &positions[..2 * joint_times_ns.len()]);
        prop_assert!(take.commands.times_s.is_empty());
        for (stream_idx, (times_ns, raw, active)) in [&gel, &film].into_iter().enumerate() {
            let (log, num_cells) = (&take.streams[stream_idx], times_ns.len() * [3, 2][stream_idx]);
            let has_raw = stream_idx == 1 || gel_is_raw;
            prop_assert_eq!(&log.times_s, &secs(times_ns));
            prop_assert_eq!(&log.active, &active[..num_cells]);
            prop_assert_eq!(&log.raw, if has_raw { &raw[..num_cells] } else { &[] });
            prop_assert_eq!(log.reference.len(), if has_raw { [3, 2][stream_idx] } else { 0 });
            let device: Vec<u64> =
                device_offset_ns.iter().flat_map(|offset_ns| times_ns.iter().map(move |t| t + offset_ns)).collect();
            prop_assert_eq!(&log.device_times_s, &secs(&device));
        }

        // And so it is after another tool has put attachments and metadata at the end.
        let again = Take::from_bytes(Path::new("take-07.mcap"), &rewrite(&bytes, |_| {})).unwrap();
        prop_assert_eq!(&again.joints, &take.joints);
        prop_assert_eq!(&again.streams, &take.streams);
        prop_assert_eq!(&again.meta, &take.meta);
    }
}

#[test]
fn the_same_take_gives_the_same_bytes() {
    assert_eq!(take_bytes(2500, &meta()), take_bytes(2500, &meta()));
}

#[test]
fn topics_schemas_and_attachments_stay_as_they_are() {
    let station = station();
    let mut writer = TakeWriter::new(Cursor::new(Vec::new()), &station, &meta(), START_UNIX_NS).unwrap();
    writer.commands(0, &[0.0, 0.0]).unwrap();
    writer.log(0, LogLevel::Warning, "tests", "a line").unwrap();
    let bytes = writer.finish().unwrap().into_inner();
    let summary = Summary::read(&bytes).unwrap().unwrap();
    let mut text = String::new();
    let channels: BTreeMap<_, _> =
        summary.channels.values().map(|channel| (&channel.topic, channel)).collect();
    for (topic, channel) in channels {
        let schema = channel.schema.as_ref().unwrap();
        let (name, encoding) = (&schema.name, &schema.encoding);
        writeln!(text, "{topic}: {name} ({encoding}, {}) {:?}", channel.message_encoding, channel.metadata)
            .unwrap();
    }
    for index in &summary.attachment_indexes {
        writeln!(text, "attachment {} ({})", index.name, index.media_type).unwrap();
    }
    for index in &summary.metadata_indexes {
        let metadata = mcap::read::metadata(&bytes, index).unwrap();
        writeln!(text, "metadata {}", metadata.name).unwrap();
        for (key, value) in metadata.metadata {
            writeln!(text, "  {key} = {value}").unwrap();
        }
    }
    insta::assert_snapshot!(text);
}

#[test]
fn a_stored_take_of_format_1_still_opens() {
    let take = Take::read(&fixtures().join("take-format-1.mcap")).unwrap();
    assert_eq!(take.id, "take-format-1");
    assert_eq!((take.station.id.as_str(), take.meta.object.as_str()), ("finger", "ball"));
    assert_eq!(take.station.files, station().files, "the fixture's station is the one beside it");
    assert_eq!((take.num_frames(), take.commands.times_s.len()), (30, 30));
    assert_eq!(take.streams.iter().map(|log| log.times_s.len()).collect::<Vec<_>>(), [300, 120]);
    assert_eq!(take.streams[0].reference, [200.0; 3]);
    assert_eq!(take.spans.len(), 2);
    let per_channel: Vec<usize> = (0..5)
        .map(|channel| take.active_at_frames().chunks(5).filter(|frame| frame[channel]).count())
        .collect();
    assert_eq!(per_channel, [2, 2, 2, 2, 2]);
}

#[test]
fn frames_see_the_newest_sample_at_or_before_them() {
    let station = station();
    let mut writer = TakeWriter::new(Cursor::new(Vec::new()), &station, &meta(), START_UNIX_NS).unwrap();
    let ms = 1_000_000;
    for time_ms in [0, 100, 200, 300] {
        writer.joints(time_ms * ms, &[0.0, 0.0]).unwrap();
    }
    let mut sample = |stream_idx, time_ns, active: &[bool]| {
        writer
            .tactile(stream_idx, time_ns, TactileSampleRef { raw: &[], active, device_time_ns: 0 })
            .unwrap();
    };
    // The gel speaks up late; its first sample stands for what came before.
    sample(0, 50 * ms, &[true, false, false]);
    sample(0, 100 * ms, &[false, true, false]);
    sample(0, 101 * ms, &[false, false, true]);
    sample(1, 0, &[false, true]);
    sample(1, 200 * ms + 1, &[true, false]);
    let bytes = writer.finish().unwrap().into_inner();
    let take = Take::from_bytes(Path::new("t.mcap"), &bytes).unwrap();
    let frames: Vec<Vec<u8>> = take
        .active_at_frames()
        .chunks(5)
        .map(|frame| frame.iter().map(|&on| u8::from(on)).collect())
        .collect();
    assert_eq!(
        frames,
        [[1, 0, 0, 0, 1], [0, 1, 0, 0, 1], [0, 0, 1, 0, 1], [0, 0, 1, 1, 0]].map(|frame| frame.to_vec())
    );
}

#[test]
fn reference_readings_are_the_mean_over_the_baseline() {
    let station = station();
    let mut writer = TakeWriter::new(Cursor::new(Vec::new()), &station, &meta(), START_UNIX_NS).unwrap();
    writer.joints(0, &[0.0, 0.0]).unwrap();
    for (time_ns, first) in [(0, 7.0), (1_000_000_000, 10.0), (2_000_000_000, 14.0), (3_000_000_000, 900.0)] {
        let raw = [first, 1.0, 2.0];
        let sample = TactileSampleRef { raw: &raw, active: &[false; 3], device_time_ns: 0 };
        writer.tactile(0, time_ns, sample).unwrap();
    }
    let sample = TactileSampleRef { raw: &[5.0, 6.0], active: &[false; 2], device_time_ns: 0 };
    writer.tactile(1, 4_000_000_000, sample).unwrap();
    writer.span(&Span { kind: SpanKind::Baseline, start_s: 1.0, end_s: 2.0, label: String::new() }).unwrap();
    let take = Take::from_bytes(Path::new("t.mcap"), &writer.finish().unwrap().into_inner()).unwrap();
    assert_eq!(take.streams[0].reference, [12.0, 1.0, 2.0]);
    assert_eq!(take.streams[1].reference, [5.0, 6.0], "no sample in the baseline: the first reading");
}

#[test]
fn a_reference_counts_until_the_next_baseline_begins() {
    let station = station();
    let mut writer = TakeWriter::new(Cursor::new(Vec::new()), &station, &meta(), START_UNIX_NS).unwrap();
    writer.joints(0, &[0.0, 0.0]).unwrap();
    for (second, first) in [10.0_f32, 20.0, 30.0, 900.0, 50.0].into_iter().enumerate() {
        let raw = [first, 1.0, 2.0];
        let sample = TactileSampleRef { raw: &raw, active: &[false; 3], device_time_ns: 0 };
        writer.tactile(0, second as u64 * 1_000_000_000, sample).unwrap();
    }
    let sample = TactileSampleRef { raw: &[5.0, 6.0], active: &[false; 2], device_time_ns: 0 };
    writer.tactile(1, 0, sample).unwrap();
    // Out of order, as a tool may have written them.
    for [start_s, end_s] in [[3.5, 4.5], [0.5, 2.5]] {
        writer.span(&Span { kind: SpanKind::Baseline, start_s, end_s, label: String::new() }).unwrap();
    }
    let take = Take::from_bytes(Path::new("t.mcap"), &writer.finish().unwrap().into_inner()).unwrap();
    let gel = &take.streams[0];
    let counts = |time_s| gel.reference_at(time_s)[0];
    assert_eq!([0.0, 2.0, 3.4, 3.5, 9.0].map(counts), [25.0, 25.0, 25.0, 50.0, 50.0]);
    let above: Vec<f64> = gel.above_reference(0, 3).collect();
    assert_eq!(above, [-15.0, -5.0, 5.0, 875.0, 0.0]);
    assert_eq!((take.tares().len(), take.tares()[0].taken_s), (1, 4.0));
    let film = &take.streams[1];
    assert_eq!((&film.reference[..], film.later_references.len()), (&[5.0, 6.0][..], 0), "its only sample");
}

#[test]
fn axes_are_written_beside_their_sample_and_come_back() {
    let fixture = fixtures().join("finger-station");
    let read = |path: &str| {
        let text = std::fs::read_to_string(fixture.join(path)).map_err(|error| error.to_string())?;
        let axes = "raw_unit = \"counts\"\naxes = 2\nreading = \"norm\"";
        Ok(if path == "layout.toml" { text.replacen("raw_unit = \"counts\"", axes, 1) } else { text }
            .into_bytes())
    };
    let station = palpate_robot_model::Station::read("station.toml", read).unwrap();
    let mut writer = TakeWriter::new(Cursor::new(Vec::new()), &station, &meta(), START_UNIX_NS).unwrap();
    writer.joints(0, &[0.0, 0.0]).unwrap();
    for time_ns in [0, 5] {
        let raw = [3.0, 4.0, 5.0];
        writer
            .tactile(0, time_ns, TactileSampleRef { raw: &raw, active: &[false; 3], device_time_ns: 0 })
            .unwrap();
    }
    writer
        .tactile(1, 0, TactileSampleRef { raw: &[5.0, 6.0], active: &[false; 2], device_time_ns: 0 })
        .unwrap();
    let values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
    writer.axes(0, 5, &values).unwrap();
    for (stream, time_ns, values, expected) in [
        (0, 6, &values[..5], "5 numbers, the layout has 3 channels and axes [\"x\", \"y\"] for each"),
        (0, 6, &[1.0, 2.0, 3.0, f32::NAN, 5.0, 6.0], "channel \"tip.1\", axis y, reads NaN"),
        (0, 5, &values, "times must increase"),
        (1, 6, &values[..2], "2 numbers, the layout has 2 channels and axes [\"x\"] for each"),
        (2, 6, &values, "stream 2 of a layout with 2 streams"),
    ] {
        let error = writer.axes(stream, time_ns, values).unwrap_err().to_string();
        assert!(error.contains(expected), "{expected}: {error}");
    }
    let take = Take::from_bytes(Path::new("t.mcap"), &writer.finish().unwrap().into_inner()).unwrap();
    let axes = &take.streams[0].axes;
    assert_eq!((&axes.times_s[..], &axes.values[..]), (&[5e-9][..], &values[..]));
    assert!(take.streams[1].axes.values.is_empty());
}

#[test]
fn the_writer_refuses_what_the_reader_would() {
    let station = station();
    let mut writer = TakeWriter::new(Cursor::new(Vec::new()), &station, &meta(), START_UNIX_NS).unwrap();
    let mut errors = Vec::new();
    let mut note = |result: Result<(), RecordingError>| errors.push(result.unwrap_err().to_string());
    note(writer.joints(0, &[0.0]));
    note(writer.joints(0, &[0.0, f64::NAN]));
    note(writer.commands(0, &[f64::INFINITY, 0.0]));
    writer.joints(5, &[0.0, 0.0]).unwrap();
    note(writer.joints(5, &[0.0, 0.0]));
    let sample = |raw, active| TactileSampleRef { raw, active, device_time_ns: 0 };
    note(writer.tactile(2, 0, sample(&[], &[true])));
    note(writer.tactile(0, 0, sample(&[], &[true])));
    note(writer.tactile(0, 0, sample(&[1.0], &[true; 3])));
    note(writer.tactile(0, 0, sample(&[1.0, f32::NAN, 1.0], &[true; 3])));
    writer.tactile(0, 0, sample(&[], &[true; 3])).unwrap();
    note(writer.tactile(0, 1, sample(&[1.0; 3], &[true; 3])));
    let span = |start_s, end_s| Span { kind: SpanKind::Note, start_s, end_s, label: String::new() };
    note(writer.span(&span(-1.0, 1.0)));
    note(writer.span(&span(1.0, 1.0)));
    note(writer.span(&span(0.0, f64::NAN)));
    insta::assert_snapshot!(errors.join("\n"));
}
