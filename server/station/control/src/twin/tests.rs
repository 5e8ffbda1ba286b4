use std::path::Path;

use palpate_recording::{Session, Take};
use palpate_sim::job::{Cancel, NoProgress};
use palpate_truth::record_session;

use super::*;

const LOOK_S: f64 = 1.0 / 15.0;

fn assets() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../assets"))
}

fn record(dir: &Path) -> Session {
    record_session(&assets().join("truth/small.toml"), dir, 5, &NoProgress, &Cancel::default())
        .expect("the shipped truth records")
}

/// A twin with the station's own model.
fn observer(take: &Take) -> Observer {
    let station = Arc::new(take.station.clone());
    let model = TwinModel::nominal(&station).expect("the shipped model fits");
    Observer::new(station, model)
}

/// Shows `take` to the twin, its readings changed by `spoil` (time, channel, reading); gives everything that it warned of,
/// and the last view.
fn watch_take(
    observer: &mut Observer,
    take: &Take,
    from_s: f64,
    spoil: &dyn Fn(f64, usize, &mut Reading),
) -> (Vec<TaxelWarning>, TwinView) {
    let layout = &take.station.layout;
    let num_dofs = take.station.robot.num_dofs();
    let (mut warned, mut view) = (Vec::<TaxelWarning>::new(), TwinView::default());
    let mut next_s = 0.0;
    for (frame, &time_s) in take.joints.times_s.iter().enumerate() {
        if time_s < next_s {
            continue;
        }
        next_s += LOOK_S;
        let readings = layout.channels.iter().enumerate().map(|(idx, channel)| {
            let (log, width) = (&take.streams[channel.stream], layout.streams[channel.stream].channels.len());
            let in_stream = idx - layout.streams[channel.stream].channels.start;
            let sample = log.times_s.partition_point(|sample_s| *sample_s <= time_s).checked_sub(1)?;
            let at = sample * width + in_stream;
            let reference = f64::from(log.reference[in_stream]);
            let mut reading = Reading { raw: log.raw[at], reference, active: log.active[at] };
            spoil(from_s + time_s, idx, &mut reading);
            Some(reading)
        });
        view = observer.look(&TwinFrame {
            at_s: from_s + time_s,
            positions: Some(take.joints.positions[frame * num_dofs..(frame + 1) * num_dofs].to_vec()),
            readings: readings.collect(),
            object: Some((take.meta.object.clone(), take.meta.base_from_object)),
        });
        for warning in &view.warnings {
            if !knows(&warned, warning) {
                warned.push(warning.clone());
            }
        }
    }
    (warned, view)
}

/// Whether it was warned of the same before.
fn knows(warned: &[TaxelWarning], warning: &TaxelWarning) -> bool {
    warned.iter().any(|known| (known.channel, &known.kind) == (warning.channel, &warning.kind))
}

/// All takes of the session one after another, twice; what was warned of.
fn watch_session(session: &Session, spoil: &dyn Fn(f64, usize, &mut Reading)) -> Vec<TaxelWarning> {
    let takes = session.accepted_takes().expect("the session reads");
    let mut observer = observer(&takes[0]);
    let mut from_s = 100.0;
    let mut warned = Vec::new();
    // Twice over, as a hand that goes on working.
    for take in takes.iter().chain(&takes) {
        for warning in watch_take(&mut observer, take, from_s, spoil).0 {
            if !knows(&warned, &warning) {
                warned.push(warning);
            }
        }
        from_s += take.duration_s() + 20.0;
    }
    warned
}

#[test]
fn a_healthy_hand_is_believed_and_spoilt_channels_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let session = record(&dir.path().join("session"));
    let healthy = watch_session(&session, &|_, _, _| {});
    assert_eq!(healthy, [], "no channel of a healthy hand is accused");

    let take = &session.accepted_takes().unwrap()[0];
    let layout = &take.station.layout;
    let mut observer = observer(take);
    let (_, view) = watch_take(&mut observer, take, 100.0, &|_, _, _| {});
    assert_eq!(view.status.agreement.len(), layout.num_channels());
    let last_s = 100.0 + take.joints.times_s[take.num_frames() - 1];
    assert!(
        (last_s - 2.0 * LOOK_S..=last_s).contains(&view.status.time_s),
        "{} of {last_s}",
        view.status.time_s
    );
    assert_eq!(view.status.problem, "");
    let mean = view.status.agreement.iter().sum::<f32>() / layout.num_channels() as f32;
    assert!(mean > 0.8, "the nominal model agrees for most of the time: {mean}");

    // A channel of each stream that takes part in every take.
    for stream in &layout.streams {
        let felt = |channel: usize| -> usize {
            let takes = session.accepted_takes().unwrap();
            let log = |take: &Take| take.streams[layout.channels[channel].stream].active.clone();
            let (width, at) = (stream.channels.len(), channel - stream.channels.start);
            takes.iter().map(|take| log(take).iter().skip(at).step_by(width).filter(|on| **on).count()).sum()
        };
        let busiest = stream.channels.clone().max_by_key(|&channel| felt(channel)).unwrap();
        let kinds = |warned: &[TaxelWarning]| -> Vec<(usize, String)> {
            warned.iter().map(|warning| (warning.channel as usize, warning.kind.clone())).collect()
        };
        // From the second take on: noise about its zero, and no touch.
        let warned = watch_session(&session, &|at_s, channel, reading| {
            if channel == busiest && at_s > 100.0 + take.duration_s() {
                *reading = Reading {
                    raw: (reading.reference + 3.0 * (at_s * 91.7).sin()) as f32,
                    active: false,
                    ..*reading
                };
            }
        });
        assert_eq!(kinds(&warned), [(busiest, "dead".to_owned())], "{} {warned:?}", stream.id);
        assert!(warned[0].text.contains(&layout.channels[busiest].id));

        let threshold = take.station.streams[layout.channels[busiest].stream].on_threshold;
        let warned = watch_take(&mut self::observer(take), take, 100.0, &|at_s, channel, reading| {
            if channel == busiest {
                reading.raw += (0.04 * threshold * (at_s - 100.0)) as f32;
                reading.active = f64::from(reading.raw) - reading.reference > threshold;
            }
        })
        .0;
        assert_eq!(kinds(&warned), [(busiest, "drifted".to_owned())], "{} {warned:?}", stream.id);
    }
}

#[test]
fn frames_that_find_the_twin_busy_are_left_out() {
    let dir = tempfile::tempdir().unwrap();
    let session = record(&dir.path().join("session"));
    let take = &session.accepted_takes().unwrap()[0];
    let station = Arc::new(take.station.clone());
    let model = TwinModel::nominal(&station).unwrap();
    let mut twin = Twin::start(Arc::clone(&station), model, 0).unwrap();
    let mut at_s = 1.0;
    // As fast as it goes: nothing waits, and sooner or later something comes back.
    let found = loop {
        let frame = TwinFrame {
            at_s,
            positions: Some(take.joints.positions[..station.robot.num_dofs()].to_vec()),
            readings: vec![None; station.layout.num_channels()],
            object: Some((take.meta.object.clone(), take.meta.base_from_object)),
        };
        twin.show(frame);
        at_s += 1e-3;
        let view = twin.view();
        if !view.status.agreement.is_empty() {
            break view.clone();
        }
    };
    assert_eq!(found.status.agreement.len(), station.layout.num_channels());
    assert_eq!(found.warnings, []);
}

#[test]
fn a_model_that_does_not_fit_is_refused_and_the_station_s_own_comes_back() {
    let dir = tempfile::tempdir().unwrap();
    let session = record(&dir.path().join("session"));
    let station = session.accepted_takes().unwrap()[0].station.clone();
    let model = TwinModel::nominal(&station).unwrap();
    let nominal = model.get();
    let mut other = SensorModel::plain("mine", nominal.theta);
    assert_eq!(model.set(&station, Some(other.clone())), Ok("mine".to_owned()));
    assert_eq!(model.get().name, "mine");
    other.response.off_fractions.insert("no_such_stream".to_owned(), 0.5);
    assert!(model.set(&station, Some(other)).unwrap_err().contains("no_such_stream"));
    assert_eq!(model.get().name, "mine");
    assert_eq!(model.set(&station, None), Ok(nominal.name.clone()));
}
