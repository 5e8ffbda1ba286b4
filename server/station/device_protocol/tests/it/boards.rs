//! Lines and frames of tactile boards, whole and damaged.

use palpate_device_protocol::framed::{Sample, SampleDecoder};
use palpate_device_protocol::lines::{LineDecoder, LineErrors, RowAssembler, encode_fsr_row, encode_twintac};
use proptest::prelude::*;

use crate::streams::{assert_every_byte_is_accounted_for, cuts, pieces};

#[test]
fn lines_are_read_and_bad_ones_counted_with_their_reason() {
    let mut decoder = LineDecoder::new(3);
    let lines = decoder.feed(b"1 2 3\r\n 101325.00 -4 5e2\n\n1 2\n1 2 3 4\n1 x 3\n1 nan 3\n\xFF 2 3\n1 2");
    assert_eq!(lines, [[1.0, 2.0, 3.0], [101_325.0, -4.0, 500.0]]);
    assert_eq!(decoder.errors(), LineErrors { count: 2, number: 3, too_long: 0 });
    assert_eq!(decoder.counters().malformed, 5);
    assert_eq!(decoder.pending(), b"1 2");
    let mut endless = LineDecoder::new(1);
    assert!(endless.feed(&[b'1'; 3000]).is_empty());
    assert_eq!(endless.feed(b"1\n2\n"), [[2.0]], "the end of an endless line is no line");
    assert_eq!(endless.errors(), LineErrors { too_long: 1, ..LineErrors::default() });
}

#[test]
fn boards_write_what_is_read() {
    assert_eq!(encode_twintac(&[101_325.0, 101_330.123]), "101325.00 101330.12\n");
    assert_eq!(encode_fsr_row(&[0, 255, 17]), "0 255 17\n");
}

#[test]
fn a_pause_puts_a_matrix_back_in_step() {
    let mut rows = RowAssembler::new(3);
    assert_eq!(rows.push(vec![1.0, 2.0]), None);
    assert_eq!(rows.push(vec![3.0, 4.0]), None);
    // The third row was lost.
    rows.pause();
    assert_eq!(rows.dropped_rows(), 2);
    let frames: Vec<_> =
        [[5.0, 6.0], [7.0, 8.0], [9.0, 0.0]].iter().filter_map(|row| rows.push(row.to_vec())).collect();
    assert_eq!(frames, [[5.0, 6.0, 7.0, 8.0, 9.0, 0.0]]);
}

#[test]
fn the_frame_on_the_line_is_the_documented_one() {
    let sample = Sample { sequence: 7, device_time_us: 0x0102, raw: vec![1, 0xABCD] };
    let bytes = sample.encode().expect("two channels");
    let head = [0xA5, 0x5A, 1, 2, 7, 0, 0, 0, 2, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0xCD, 0xAB];
    assert_eq!(bytes[..20], head);
    assert_eq!(bytes.len(), 22);
    let message = Sample { raw: vec![], ..sample }.encode().expect_err("no channel").to_string();
    assert_eq!(message, "0 channels, expected 1 to 255 in a frame");
}

fn sample() -> impl Strategy<Value = Sample> {
    let raw = prop::collection::vec(prop_oneof![Just(0x5AA5), any::<u16>()], 1..20);
    (any::<u32>(), any::<u64>(), raw).prop_map(|(sequence, device_time_us, raw)| Sample {
        sequence,
        device_time_us,
        raw,
    })
}

fn rubbish() -> impl Strategy<Value = Vec<u8>> {
    let byte = prop_oneof![Just(0xA5), Just(0x5A), Just(1), Just(b' '), Just(b'\n'), any::<u8>()];
    prop::collection::vec(byte, 0..60)
}

proptest! {
    #[test]
    fn any_bytes_in_any_pieces_give_the_same_samples(
        parts in prop::collection::vec(
            prop_oneof![sample().prop_map(|sample| sample.encode().expect("channels")), rubbish()], 0..6),
        one in cuts(),
        other in cuts(),
    ) {
        let stream = parts.concat();
        let decode = |cuts: &[usize]| {
            let (mut decoder, mut lines) = (SampleDecoder::default(), LineDecoder::new(2));
            let (mut samples, mut rows, mut fed) = (Vec::new(), Vec::new(), 0);
            for piece in pieces(&stream, cuts) {
                samples.extend(decoder.feed(piece));
                rows.extend(lines.feed(piece));
                fed += piece.len();
                assert_every_byte_is_accounted_for(decoder.counters(), decoder.pending().len(), fed);
                assert_every_byte_is_accounted_for(lines.counters(), lines.pending().len(), fed);
            }
            (samples, rows, decoder.counters(), lines.counters(), lines.errors())
        };
        prop_assert_eq!(decode(&one), decode(&other));
    }

    #[test]
    fn damage_costs_no_other_sample(
        samples in prop::collection::vec(sample(), 3), at in any::<prop::sample::Index>(), flip in 1..=255_u8,
    ) {
        let mut frames: Vec<Vec<u8>> = samples.iter().map(|sample| sample.encode().expect("channels")).collect();
        let at = at.index(frames[1].len());
        frames[1][at] ^= flip;
        let mut decoder = SampleDecoder::default();
        prop_assert_eq!(decoder.feed(&frames.concat()), [samples[0].clone(), samples[2].clone()]);
        prop_assert_eq!(decoder.counters().dropped_bytes, frames[1].len() as u64);
    }

    #[test]
    fn lines_survive(values in prop::collection::vec(-1e6..1e6_f64, 1..9)) {
        let mut decoder = LineDecoder::new(values.len());
        let lines = decoder.feed(encode_twintac(&values).as_bytes());
        prop_assert_eq!(lines.len(), 1);
        for (read, value) in lines[0].iter().zip(&values) {
            prop_assert!((read - value).abs() <= 0.005_000_1);
        }
    }

    #[test]
    fn a_line_behind_any_rubbish_is_read(rubbish in prop::collection::vec(any::<u8>(), 0..1500)) {
        let mut decoder = LineDecoder::new(2);
        // The rubbish spoils the line it ends in and no further one.
        let lines = decoder.feed(&[&rubbish[..], b"\n12 -3\n"].concat());
        prop_assert_eq!(lines.last(), Some(&vec![12.0, -3.0]));
    }
}
