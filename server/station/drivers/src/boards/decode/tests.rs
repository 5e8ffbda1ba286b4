use palpate_device_protocol::framed;
use palpate_device_protocol::lines::{encode_fsr_row, encode_twintac};
use proptest::prelude::*;

use super::*;

const MS: u64 = 1_000_000;

fn raw(samples: &[Sample]) -> Vec<Vec<f32>> {
    samples.iter().map(|sample| sample.raw.clone()).collect()
}

/// A matrix of 3 rows of 4, whose readings say their frame and row.
fn matrix_rows(frame: i32) -> [String; 3] {
    std::array::from_fn(|row| {
        let first = 100 * frame + 10 * row as i32;
        encode_fsr_row(&[first, first + 1, first + 2, first + 3])
    })
}

fn matrix() -> BoardDecoder {
    BoardDecoder::new(12, 3)
}

/// Whether every sample is one whole frame: rows of one frame in their order.
fn are_whole(samples: &[Sample]) -> bool {
    samples.iter().all(|sample| {
        let first = sample.raw[0];
        let expected = (0..3).flat_map(|row| (0..4).map(move |column| first + (10 * row + column) as f32));
        sample.raw.iter().copied().eq(expected) && first % 100.0 == 0.0
    })
}

#[test]
fn the_line_under_way_when_the_port_is_opened_is_no_sample() {
    let mut decoder = BoardDecoder::new(3, 1);
    // Cut in the middle of its first number it would look like a line in order.
    let samples = decoder.feed(0, b"325.00 8001.00 8002.00\n8000.00 8001.00 8002.00\n");
    assert_eq!(raw(&samples), [[8000.0, 8001.0, 8002.0]]);
    assert_eq!(decoder.num_bad(), 0);
}

#[test]
fn lines_give_one_sample_each_and_bad_ones_are_counted() {
    let mut decoder = BoardDecoder::new(3, 1);
    decoder.feed(0, b"\n");
    let good = encode_twintac(&[1.0, 2.5, -3.25]);
    let text = format!("{good}1 2\n1 2 x\n\n{good}");
    let mut samples = Vec::new();
    for (idx, byte) in text.bytes().enumerate() {
        samples.extend(decoder.feed(idx as u64, &[byte]));
    }
    assert_eq!(raw(&samples), [[1.0, 2.5, -3.25], [1.0, 2.5, -3.25]]);
    assert_eq!(decoder.num_bad(), 2);
}

#[test]
fn rows_begin_after_a_pause_and_a_lost_row_costs_its_frame_alone() {
    let mut decoder = matrix();
    let mut samples = Vec::new();
    for frame in 0..40 {
        let at_ns = frame as u64 * 25 * MS;
        for (row, line) in matrix_rows(frame).iter().enumerate() {
            if frame != 20 || row != 1 {
                samples.extend(decoder.feed(at_ns + row as u64 * 200_000, line.as_bytes()));
            }
        }
    }
    assert!(are_whole(&samples), "{samples:?}");
    // The first begins before anybody knows; the twentieth lost a row.
    assert_eq!(samples.len(), 38);
    assert_eq!(decoder.num_bad(), 2, "the first is neither damaged nor missing");
}

#[test]
fn a_damaged_row_costs_its_frame_alone() {
    let mut decoder = matrix();
    let mut samples = Vec::new();
    for frame in 0..20 {
        let mut text = matrix_rows(frame).concat();
        if frame == 10 {
            text = text.replacen("1010", "1x10", 1);
        }
        samples.extend(decoder.feed(frame as u64 * 25 * MS, text.as_bytes()));
    }
    assert!(are_whole(&samples));
    assert_eq!(samples.len(), 18);
}

#[test]
fn frames_that_come_all_at_once_give_only_the_one_that_is_sure() {
    let mut decoder = matrix();
    decoder.feed(0, b"\n");
    decoder.feed(25 * MS, matrix_rows(0).concat().as_bytes());
    // Nobody read for 100 ms, in which a row was lost.
    let rows: Vec<String> = (1..5).flat_map(matrix_rows).collect();
    let text = [&rows[..4], &rows[5..]].concat().concat();
    let samples = decoder.feed(150 * MS, text.as_bytes());
    assert!(are_whole(&samples) && samples.len() == 1, "{samples:?}");
    assert_eq!(decoder.feed(175 * MS, matrix_rows(5).concat().as_bytes()).len(), 1);
}

#[test]
fn frames_that_come_all_at_once_are_believed_once_a_pause_shows_that_they_were_whole() {
    let mut decoder = matrix();
    // Where the first begins nobody knows.
    decoder.feed(0, format!("\n{}", matrix_rows(9).concat()).as_bytes());
    let mut samples = decoder.feed(25 * MS, matrix_rows(0).concat().as_bytes());
    let rows: Vec<String> = (1..4).flat_map(matrix_rows).collect();
    samples.extend(decoder.feed(100 * MS, rows.concat().as_bytes()));
    assert_eq!(samples.len(), 2);
    samples.extend(decoder.feed(125 * MS, matrix_rows(4).concat().as_bytes()));
    assert!(are_whole(&samples));
    let came: Vec<(f32, u64)> =
        samples.iter().map(|sample| (sample.raw[0], sample.received_ns / MS)).collect();
    assert_eq!(came, [(0.0, 25), (100.0, 100), (200.0, 100), (300.0, 100), (400.0, 125)]);
    assert_eq!(decoder.num_bad(), 0);
}

#[test]
fn frames_that_never_pause_are_not_kept_for_ever() {
    let mut decoder = matrix();
    // Where the first begins nobody knows.
    decoder.feed(0, format!("\n{}", matrix_rows(9).concat()).as_bytes());
    let rows: Vec<String> = (0..100).flat_map(matrix_rows).collect();
    assert_eq!(decoder.feed(25 * MS, rows.concat().as_bytes()).len(), 1);
    assert_eq!(decoder.num_bad(), 99 * 3);
}

#[test]
fn evenly_spaced_rows_are_no_frames_and_the_reason_is_told() {
    let mut decoder = matrix();
    let mut num_samples = 0;
    for frame in 0..60 {
        for (row, line) in matrix_rows(frame).iter().enumerate() {
            let at_ns = (frame as u64 * 3 + row as u64) * 8 * MS;
            num_samples += decoder.feed(at_ns, line.as_bytes()).len();
        }
    }
    assert_eq!(num_samples, 0);
    assert!(decoder.problem().contains("without a pause"), "{}", decoder.problem());
}

#[test]
fn problems_say_what_the_bytes_look_like() {
    let mut decoder = BoardDecoder::new(8, 1);
    decoder.feed(0, b"\n1 2 3\n1 2 3\n");
    assert!(
        decoder.problem().contains("another number of values than the 8 expected"),
        "{}",
        decoder.problem()
    );
    let mut decoder = BoardDecoder::new(8, 1);
    decoder.feed(0, b"\nhello world\n\x80\x81\n");
    assert!(decoder.problem().contains("check `baud`"), "{}", decoder.problem());
    let mut decoder = BoardDecoder::new(8, 1);
    let sample = framed::Sample { sequence: 0, device_time_us: 0, raw: vec![1; 12] };
    decoder.feed(0, &sample.encode().expect("12 channels"));
    assert!(decoder.problem().contains("12 channels, expected 8"), "{}", decoder.problem());
}

#[test]
fn frames_are_recognised_and_carry_time_and_count() {
    let mut decoder = BoardDecoder::new(2, 1);
    let frame = |sequence: u32| {
        let sample =
            framed::Sample { sequence, device_time_us: u64::from(sequence) * 10_000, raw: vec![7, 60_000] };
        sample.encode().expect("two channels")
    };
    let mut samples = Vec::new();
    for sequence in [u32::MAX - 1, u32::MAX, 0, 1, 5, 6] {
        samples.extend(decoder.feed(0, &frame(sequence)));
    }
    let mut damaged = frame(7);
    damaged[9] ^= 1;
    samples.extend(decoder.feed(0, &damaged));
    // Started anew.
    samples.extend(decoder.feed(0, &frame(3)));
    assert_eq!(samples.len(), 7);
    assert_eq!(samples[0].raw, [7.0, 60_000.0]);
    assert_eq!((samples[3].sequence, samples[3].device_us), (Some(1), Some(10_000)));
    assert_eq!((decoder.num_gaps(), decoder.num_bad()), (3, 1));
}

#[test]
fn samples_that_stay_away_are_gaps_and_a_burst_after_them_is_none() {
    let mut decoder = BoardDecoder::new(1, 1);
    decoder.feed(0, b"\n");
    for idx in 0..100 {
        decoder.feed(idx * 10 * MS, b"1\n");
    }
    assert_eq!(decoder.num_gaps(), 0);
    decoder.feed(1200 * MS, b"1\n1\n1\n");
    assert_eq!(decoder.num_gaps(), 20);
    decoder.feed(1210 * MS, b"1\n");
    assert_eq!(decoder.num_gaps(), 20);
}

proptest! {
    #[test]
    fn whatever_is_lost_garbled_or_late_a_frame_is_whole_or_missing(
        frames in prop::collection::vec((prop::collection::vec(0_u8..12, 3), 0_u64..4), 30..80),
    ) {
        let mut decoder = matrix();
        let mut samples = Vec::new();
        for (frame, (fates, jitter_ms)) in frames.iter().enumerate() {
            let at_ns = (frame as u64 * 25 + jitter_ms) * MS;
            for (row, line) in matrix_rows(frame as i32).iter().enumerate() {
                let line = match fates[row] {
                    0 => String::new(),
                    1 => format!("\u{7f}{line}"),
                    _ => line.clone(),
                };
                samples.extend(decoder.feed(at_ns + row as u64 * 300_000, line.as_bytes()));
            }
        }
        prop_assert!(are_whole(&samples), "{:?}", samples);
        let num_whole = frames.iter().skip(1).filter(|(fates, _)| fates.iter().all(|&fate| fate > 1)).count();
        prop_assert!(samples.len() <= num_whole + 1);
        // A frame in order between two in order is always there.
        prop_assert!(samples.len() * 2 >= num_whole, "{} of {num_whole}", samples.len());
    }

    #[test]
    fn bytes_at_random_never_panic(chunks in prop::collection::vec((prop::collection::vec(any::<u8>(), 0..60), 0_u64..100), 0..40), rows in 0_usize..4) {
        let mut decoder = BoardDecoder::new(12, rows);
        let mut now_ns = 0;
        for (bytes, wait_ms) in chunks {
            now_ns += wait_ms * MS;
            decoder.feed(now_ns, &bytes);
            let _text = decoder.problem();
        }
    }
}

#[test]
fn samples_that_are_read_all_together_at_first_make_no_endless_gaps() {
    let mut decoder = BoardDecoder::new(2, 1);
    let lines = b"10 20\n".repeat(40);
    assert!(decoder.feed(1_000_000_000, &lines).len() > 30);
    for beat in 1..4_u64 {
        decoder.feed(1_000_000_000 + beat * 50_000_000, &lines);
    }
    assert!(decoder.num_gaps() <= 3 * 500, "{}", decoder.num_gaps());
}
