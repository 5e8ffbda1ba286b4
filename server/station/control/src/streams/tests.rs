use std::path::Path;

use proptest::prelude::*;

use super::*;

const MS: u64 = 1_000_000;

/// The probe bench: a gel of pressure sensors on two boards here, a film on one.
fn station() -> Station {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../assets/stations");
    Station::read("probe_bench.toml", |path| std::fs::read(dir.join(path)).map_err(|err| err.to_string()))
        .expect("the shipped station reads")
}

fn place(id: &str, stream: usize, first_channel: usize, num_channels: usize) -> BoardPlace {
    BoardPlace { id: id.to_owned(), stream, first_channel, num_channels }
}

/// Boards of 3 and the rest of the gel, and one for the whole film.
fn boards(station: &Station) -> Vec<BoardPlace> {
    let width = |stream: usize| station.layout.streams[stream].channels.len();
    vec![place("gel0", 0, 0, 3), place("gel1", 0, 3, width(0) - 3), place("film", 1, 0, width(1))]
}

fn read(streams: &mut Streams, place: &BoardPlace, host_ns: u64, raw: &[f32]) -> Vec<StreamSample> {
    let (stream, first_channel) = (place.stream, place.first_channel);
    streams.board(BoardReading { stream, first_channel, host_ns, device_ns: None, raw })
}

/// Quiet readings of every board every 10 ms, from `from_ns` to `until_ns`.
fn quiet(streams: &mut Streams, boards: &[BoardPlace], from_ns: u64, until_ns: u64, raw: f32) {
    for step in 0..=(until_ns - from_ns) / (10 * MS) {
        for place in boards {
            read(streams, place, from_ns + step * 10 * MS, &vec![raw; place.num_channels]);
        }
    }
}

#[test]
fn a_sample_is_whole_once_every_board_of_the_stream_has_spoken() {
    let station = station();
    let boards = boards(&station);
    let mut streams = Streams::new(&station, &boards, 0);
    quiet(&mut streams, &boards, 0, 50 * MS, 100.0);
    assert_eq!(read(&mut streams, &boards[0], 60 * MS, &[101.0; 3]), []);
    let rest = vec![102.0; boards[1].num_channels];
    let samples = read(&mut streams, &boards[1], 61 * MS, &rest);
    let [sample] = &samples[..] else { panic!("both boards have spoken: {samples:?}") };
    assert_eq!((sample.stream, sample.host_ns), (0, 61 * MS));
    assert_eq!(sample.raw[..3], [101.0; 3]);
    assert_eq!(sample.raw[3..], rest);
}

#[test]
fn hysteresis_is_that_of_the_recorded_firmware() {
    let station = station();
    let boards = boards(&station);
    let mut streams = Streams::new(&station, &boards, 100 * MS);
    quiet(&mut streams, &boards, 0, 200 * MS, 500.0);
    let config = &station.streams[1];
    let film = &boards[2];
    let (on, off) = (config.on_threshold as f32, config.off_threshold as f32);
    let mut now_ns = 300 * MS;
    // Exactly on a threshold is not above it.
    for (rise, active) in [
        (0.0, false),
        (on, false),
        (on + 1.0, true),
        (off + 1.0, true),
        (off, false),
        (off + 1.0, false),
        (on + 1.0, true),
        (0.0, false),
    ] {
        now_ns += 10 * MS;
        let samples = read(&mut streams, film, now_ns, &vec![500.0 + rise; film.num_channels]);
        let [sample] = &samples[..] else { panic!("it is alone: {samples:?}") };
        assert_eq!(sample.active, vec![active; film.num_channels], "rise {rise}");
        let touch = streams.touch(now_ns);
        let channels = station.layout.streams[1].channels.clone();
        assert_eq!(touch.active[channels.clone()], sample.active[..]);
        assert!(touch.raw[channels].iter().all(|&raw| (raw - rise).abs() < 1e-3));
    }
}

#[test]
fn nothing_is_felt_before_there_is_a_reference() {
    let station = station();
    let boards = boards(&station);
    let mut streams = Streams::new(&station, &boards, 500 * MS);
    quiet(&mut streams, &boards, 0, 300 * MS, 900.0);
    let film = &boards[2];
    let samples = read(&mut streams, film, 310 * MS, &vec![2000.0; film.num_channels]);
    assert_eq!(samples.len(), 1);
    assert!(!samples[0].active.contains(&true));
    assert!(streams.touch(310 * MS).raw.iter().all(|&raw| raw == 0.0));
}

#[test]
fn a_tare_takes_the_mean_of_its_time_and_names_what_moved() {
    let station = station();
    let boards = boards(&station);
    let mut streams = Streams::new(&station, &boards, 100 * MS);
    quiet(&mut streams, &boards, 0, 1000 * MS, 500.0);
    quiet(&mut streams, &boards, 1010 * MS, 1500 * MS, 700.0);
    assert!(streams.touch(1500 * MS).raw.iter().all(|&raw| (raw - 200.0).abs() < 1e-3));
    streams.tare(1500 * MS, 500 * MS);
    assert!(streams.finish_tare(1900 * MS).is_none());
    for step in 1..=60_u64 {
        let now_ns = (1500 + step * 10) * MS;
        for (idx, place) in boards.iter().enumerate() {
            let mut raw = vec![700.0; place.num_channels];
            if idx == 2 && step == 20 {
                // Somebody touches the film meanwhile.
                raw[1] += station.streams[1].on_threshold as f32 + 1.0;
            }
            read(&mut streams, place, now_ns, &raw);
        }
    }
    let outcome = streams.finish_tare(2100 * MS).expect("the tare is over");
    assert_eq!((outcome.num_boards, outcome.problems.len()), (3, 1));
    let moved = &station.layout.channels[station.layout.streams[1].channels.start + 1].id;
    assert!(outcome.problems[0].starts_with(moved.as_str()), "{outcome:?}");
    assert!(streams.finish_tare(3000 * MS).is_none());
    let touch = streams.touch(2100 * MS);
    assert!(touch.raw[0].abs() < 1e-3, "{:?}", touch.raw);
}

#[test]
fn a_board_that_is_away_keeps_its_reference_and_is_named() {
    let station = station();
    let boards = boards(&station);
    let mut streams = Streams::new(&station, &boards, 100 * MS);
    quiet(&mut streams, &boards, 0, 1000 * MS, 500.0);
    streams.tare(1000 * MS, 500 * MS);
    quiet(&mut streams, &boards[1..], 1010 * MS, 3000 * MS, 500.0);
    let outcome = streams.finish_tare(3000 * MS).expect("it has waited long enough");
    assert_eq!(outcome.num_boards, 2);
    assert!(outcome.problems[0].contains("gel0"), "{outcome:?}");
    // It is back with the reference it had.
    quiet(&mut streams, &boards, 3010 * MS, 3100 * MS, 530.0);
    assert!((streams.touch(3100 * MS).raw[0] - 30.0).abs() < 1e-3);
}

#[test]
fn a_silent_board_feels_nothing_while_others_go_on() {
    let station = station();
    let boards = boards(&station);
    let mut streams = Streams::new(&station, &boards, 100 * MS);
    quiet(&mut streams, &boards, 0, 500 * MS, 500.0);
    quiet(&mut streams, &boards, 510 * MS, 600 * MS, 2500.0);
    assert!(streams.touch(600 * MS).active[0]);
    // The second board alone keeps the stream going.
    let rest = vec![500.0; boards[1].num_channels];
    let samples: Vec<StreamSample> =
        (61..=200).flat_map(|step| read(&mut streams, &boards[1], step * 10 * MS, &rest)).collect();
    assert!(samples.len() > 130, "{}", samples.len());
    assert!(samples.last().is_some_and(|sample| !sample.active[0]));
    assert!(!streams.touch(2000 * MS).active[0]);
}

#[test]
fn readings_that_make_no_sense_are_left_out() {
    let station = station();
    let boards = boards(&station);
    let mut streams = Streams::new(&station, &boards, 100 * MS);
    quiet(&mut streams, &boards, 0, 500 * MS, 500.0);
    let film = &boards[2];
    let good = vec![500.0; film.num_channels];
    let mut with_nan = good.clone();
    with_nan[0] = f32::NAN;
    assert_eq!(read(&mut streams, film, 510 * MS, &with_nan), []);
    assert_eq!(read(&mut streams, film, 510 * MS, &good[1..]), []);
    assert_eq!(read(&mut streams, film, 500 * MS, &good), []);
    assert_eq!(read(&mut streams, &place("?", 9, 0, good.len()), 510 * MS, &good), []);
    assert_eq!(read(&mut streams, film, 510 * MS, &good).len(), 1);
}

proptest! {
    #[test]
    fn samples_are_in_time_and_of_the_streams_width(
        reports in prop::collection::vec((0_usize..3, 0_u64..20, -1e4_f32..1e4), 1..300)
    ) {
        let station = station();
        let boards = boards(&station);
        let mut streams = Streams::new(&station, &boards, 50 * MS);
        let mut last_ns = [None, None];
        let mut now_ns = 0;
        for (board, step, raw) in reports {
            now_ns += step * MS;
            let place = &boards[board];
            for sample in read(&mut streams, place, now_ns, &vec![raw; place.num_channels]) {
                let width = station.layout.streams[sample.stream].channels.len();
                prop_assert_eq!((sample.raw.len(), sample.active.len()), (width, width));
                prop_assert!(last_ns[sample.stream].is_none_or(|last| sample.host_ns > last));
                last_ns[sample.stream] = Some(sample.host_ns);
            }
        }
    }
}
