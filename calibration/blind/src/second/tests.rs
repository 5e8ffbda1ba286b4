use std::path::Path;

use palpate_recording::{Span, SpanKind};

use super::imperfections::{Marks, OperatorConfig};
use super::*;

fn second() -> Second {
    let truth = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets/truth/small.toml"));
    Second::new(Stage::read(truth).unwrap())
}

#[test]
fn of_the_simulator_only_its_geometry_is_used() {
    let sources = [
        include_str!("../second.rs"),
        include_str!("electronics.rs"),
        include_str!("files.rs"),
        include_str!("imperfections.rs"),
        include_str!("operator.rs"),
        include_str!("skin.rs"),
    ];
    for used in sources.iter().flat_map(|source| source.split("palpate_sim::").skip(1)) {
        assert!(used.starts_with("geometry::"), "{}", used.lines().next().unwrap_or_default());
    }
}

#[test]
fn the_same_seed_has_the_same_bits_and_every_session_its_own_imperfections() {
    let second = second();
    let bits = |seed: u64, threads: usize| -> Vec<u32> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let takes = pool.install(|| second.record(&[], seed, Kept::Readings)).unwrap();
        takes
            .iter()
            .flat_map(|take| &take.streams)
            .flat_map(|log| &log.raw)
            .map(|raw| raw.to_bits())
            .collect()
    };
    let one = bits(1, 1);
    assert!(!one.is_empty() && one == bits(1, 3));
    let (a, b) = (second.imperfections(1), second.imperfections(2));
    assert!(a.encoder_zeros != b.encoder_zeros && a.gains != b.gains && a.mounts != b.mounts);
}

#[test]
fn a_world_with_one_part_has_it_as_in_the_whole_and_nothing_else() {
    let Second { stage, .. } = second();
    let whole = Second::new(stage.clone()).imperfections(1);
    let is_off = |of: &Imperfections| {
        [
            of.skins.iter().any(|skin| skin.exponent != 1.0 && skin.creep[0].0 > 0.0),
            of.boards.iter().any(|board| board.wander[0] > 0.0) && of.gains.iter().any(|gain| *gain != 1.0),
            of.encoder_zeros.iter().any(|zero| *zero != 0.0) && of.operator.pace > 0.0,
        ]
    };
    assert_eq!(is_off(&whole), [true; 3]);
    for (idx, part) in [Part::Skin, Part::Boards, Part::GeometryAndOperator].into_iter().enumerate() {
        let alone = Second::with_only(stage.clone(), part).imperfections(1);
        assert_eq!(is_off(&alone), std::array::from_fn(|other| other == idx), "{part:?}");
    }
}

/// When each channel that is touched is first on, s, of the first take.
fn onsets(take: &Take, stream: usize, width: usize) -> Vec<Option<f64>> {
    let log = &take.streams[stream];
    (0..width)
        .map(|idx| {
            (0..log.times_s.len()).find(|sample| log.active[sample * width + idx]).map(|at| log.times_s[at])
        })
        .collect()
}

#[test]
fn a_late_stream_arrives_late_and_a_dead_channel_is_never_on() {
    let second = second();
    let station = second.stage.station();
    let (stream, width) = (0, station.layout.streams[0].channels.len());
    let before = onsets(&second.record(&[], 3, Kept::Readings).unwrap()[0], stream, width);
    let touched = before.iter().position(Option::is_some).unwrap();
    let latency =
        Hidden::new("latency", Place::Stream(station.layout.streams[0].id.clone()), &[("delay_s", 0.1)]);
    let after = onsets(&second.record(&[latency], 3, Kept::Readings).unwrap()[0], stream, width);
    let late_s = after[touched].unwrap() - before[touched].unwrap();
    assert!((late_s - 0.1).abs() < 0.03, "{late_s}");
    let dead = Hidden::new("dead_channel", Place::Channel(station.layout.channels[touched].id.clone()), &[]);
    let takes = second.record(&[dead], 3, Kept::Readings).unwrap();
    assert!(takes.iter().all(|take| onsets(take, stream, width)[touched].is_none()));
}

#[test]
fn sessions_without_readings_have_events_alone() {
    let second = second();
    let takes = second.record(&[], 4, Kept::Events).unwrap();
    assert!(takes.iter().all(|take| !take.has_raw()));
    assert!(takes.iter().flat_map(|take| &take.streams).any(|log| log.active.contains(&true)));
}

#[test]
fn an_operator_waits_and_has_a_pace_of_his_own_and_marks_follow() {
    let span = |start_s: f64, end_s: f64| Span {
        kind: SpanKind::Repetition,
        start_s,
        end_s,
        label: "tap".to_owned(),
    };
    let operator = OperatorConfig { pace: 0.1, longest_pause_s: 1.0, mark_s: 0.1, marks: Marks::Plain };
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let pacing = Pacing::new(&[span(2.0, 4.0), span(5.0, 7.0)], 10.0, &operator, &mut rng);
    assert_eq!(pacing.motion_s(0.0), 0.0);
    assert!((pacing.motion_s(pacing.duration_s()) - 10.0).abs() < 1e-9);
    for motion_s in [0.5, 2.0, 3.0, 4.5, 6.0, 9.0] {
        assert!((pacing.motion_s(pacing.real_s(motion_s)) - motion_s).abs() < 1e-9);
    }
    let times: Vec<f64> = (0..1000).map(|step| pacing.motion_s(0.02 * f64::from(step))).collect();
    assert!(times.is_sorted());
    let lengths =
        [[2.0, 4.0], [5.0, 7.0]].map(|[start_s, end_s]| pacing.real_s(end_s) - pacing.real_s(start_s));
    assert!((lengths[0] - lengths[1]).abs() > 0.01, "{lengths:?}");
}
