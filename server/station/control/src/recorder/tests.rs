use std::{
    fs,
    path::PathBuf,
    sync::{
        atomic::AtomicU64,
        mpsc::{SyncSender, sync_channel},
    },
    time::{Duration, Instant},
};

use nalgebra::Isometry3;
use palpate_recording::{PlannedStep, Session, SessionPlan, Take, load_station};

use super::*;

const MS: u64 = 1_000_000;
/// Host times count from the opening of the station, not from the take.
const START_NS: u64 = 77_000_000_123;

struct Bench {
    recorder: Recorder,
    dir: PathBuf,
    _temp: tempfile::TempDir,
}

fn station() -> Arc<Station> {
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../tests/fixtures/finger-station/station.toml");
    Arc::new(load_station(&path).expect("the fixture reads"))
}

fn open(dir: &Path) -> GrowingSession {
    let step = PlannedStep { object: "ball".to_owned(), primitive: "tap".to_owned(), added_because: None };
    let plan = SessionPlan { plan: "two".to_owned(), steps: vec![step.clone(), step] };
    GrowingSession::open(dir, "finger", &plan, "somebody", "").expect("the session opens").0
}

impl Bench {
    fn new(config: RecorderConfig) -> Self {
        let temp = tempfile::tempdir().expect("a folder");
        let dir = temp.path().join("monday");
        let recorder = Recorder::start(station(), config).expect("the thread starts");
        recorder.begin(open(&dir));
        Self { recorder, dir, _temp: temp }
    }

    /// The next event; a generous while for slow machines.
    fn event(&mut self) -> RecorderEvent {
        let patience = Instant::now();
        loop {
            if let Some(event) = self.recorder.poll() {
                return event;
            }
            assert!(patience.elapsed() < Duration::from_secs(60), "the recorder says nothing");
            thread::sleep(Duration::from_millis(1));
        }
    }

    fn start(&mut self, step: usize) -> String {
        self.recorder.command(start_take(step));
        match self.event() {
            RecorderEvent::TakeStarted { take } => take,
            other => panic!("{other:?}"),
        }
    }

    fn end(&mut self) -> (String, TakeVerdict) {
        self.recorder.command(RecorderCommand::EndTake { broken_off: String::new() });
        assert!(matches!(self.event(), RecorderEvent::TakeEnded { broken_off, .. } if broken_off.is_empty()));
        self.verdict()
    }

    fn verdict(&mut self) -> (String, TakeVerdict) {
        match self.event() {
            RecorderEvent::Checked { take, verdict, readable: true } => (take, verdict),
            other => panic!("{other:?}"),
        }
    }
}

fn start_take(step: usize) -> RecorderCommand {
    let meta = TakeMeta {
        object: "ball".to_owned(),
        base_from_object: Isometry3::identity(),
        primitive: "tap".to_owned(),
        fixture_trusted: true,
        operator: "somebody".to_owned(),
        software: "tests".to_owned(),
        surroundings: Vec::new(),
    };
    RecorderCommand::StartTake { step, meta, at_ns: START_NS, planned: vec![0, 3] }
}

/// Five milliseconds of a take of the finger: channels 0 and 3 are touched in every second second, the baseline is the
/// first.
fn feed(recorder: &Recorder, time_ms: u64) {
    let host_ns = START_NS + time_ms * MS;
    if time_ms.is_multiple_of(100) {
        let positions = [time_ms as f64 * 1e-5, -0.5];
        recorder.commands(host_ns, &positions);
        recorder.joints(host_ns, &positions);
    }
    let touched = time_ms / 1000 % 2 == 1;
    if time_ms.is_multiple_of(10) {
        let raw = [if touched { 400.0 } else { 200.0 }, 201.0 + (time_ms % 3) as f32, 202.0];
        recorder.tactile(0, host_ns, Some(host_ns / 2), &raw, &[touched, false, false]);
    }
    if time_ms.is_multiple_of(25) {
        let raw = [if touched { 400.0 } else { 200.0 }, 201.0];
        recorder.tactile(1, host_ns, None, &raw, &[touched, false]);
    }
}

fn feed_baseline(recorder: &Recorder) {
    recorder.command(RecorderCommand::Span {
        kind: SpanKind::Baseline,
        start_ns: START_NS,
        end_ns: START_NS + 900 * MS,
        label: String::new(),
    });
}

#[test]
fn a_take_is_written_checked_and_accepted() {
    let mut bench = Bench::new(RecorderConfig::default());
    // Before a take begins nothing is kept, and nothing is lost.
    feed(&bench.recorder, 0);
    assert_eq!(bench.start(0), "take-01");
    assert!(bench.recorder.recording());
    // Late samples of the time before do not count either.
    bench.recorder.joints(START_NS - 5 * MS, &[0.0, 0.0]);
    for time_ms in (0..4000).step_by(5) {
        feed(&bench.recorder, time_ms);
        if time_ms == 1500 {
            let at_ns = START_NS + 1500 * MS;
            bench.recorder.command(RecorderCommand::Note { at_ns, text: "it squeaks".to_owned() });
            bench.recorder.command(RecorderCommand::Log { at_ns, text: "a line".to_owned() });
        }
    }
    feed_baseline(&bench.recorder);
    let (take, verdict) = bench.end();
    assert!(!bench.recorder.recording());
    assert!(verdict.good, "{verdict:#?}");
    assert_eq!(
        (verdict.covered.as_slice(), verdict.missed.len()),
        (["tip.0".to_owned(), "pulp".to_owned()].as_slice(), 0)
    );

    bench.recorder.command(RecorderCommand::Annotate { take: take.clone(), text: "good one".to_owned() });
    bench.recorder.command(RecorderCommand::Accept { take: take.clone() });
    assert_eq!(bench.event(), RecorderEvent::Accepted { take: take.clone() });
    let session = Session::open(&bench.dir).unwrap();
    let read = session.take(0).unwrap();
    assert_eq!(read.num_frames(), 40);
    assert_eq!(read.commands.positions, read.joints.positions);
    assert_eq!(read.streams[0].times_s.len(), 400);
    assert_eq!(read.streams[0].raw[..3], [200.0, 201.0, 202.0]);
    assert_eq!(read.streams[0].reference[0], 200.0);
    assert_eq!(read.streams[0].device_times_s[1], ((START_NS + 10 * MS) / 2) as f64 / 1e9);
    assert!(read.streams[1].device_times_s.is_empty());
    let note = read.spans.iter().find(|span| span.kind == SpanKind::Note).unwrap();
    assert_eq!((note.start_s, note.label.as_str()), (1.5, "it squeaks"));

    bench.recorder.command(RecorderCommand::SetAside { take: take.clone() });
    assert_eq!(bench.event(), RecorderEvent::SetAside { take: take.clone() });
    bench.recorder.command(RecorderCommand::Restore { take: take.clone() });
    assert_eq!(bench.event(), RecorderEvent::Restored { take: take.clone() });
    bench.recorder.command(RecorderCommand::Restore { take: take.clone() });
    assert!(matches!(bench.event(), RecorderEvent::Failed { problem } if problem.contains("not set aside")));
    assert_eq!(bench.recorder.lost_samples(), 0);
    assert!(bench.recorder.free_bytes() > 0);

    bench.recorder.command(RecorderCommand::EndSession);
    assert_eq!(bench.event(), RecorderEvent::SessionEnded);
    let session = open(&bench.dir);
    let kept = &session.recording().takes[0];
    assert_eq!((kept.notes.as_slice(), kept.readable), (["good one".to_owned()].as_slice(), Some(true)));
    assert_eq!(kept.verdict.as_ref(), Some(&verdict));
}

/// A disk that stands still: its free space is only told when the test says so.
fn slow_disk() -> (RecorderConfig, SyncSender<()>) {
    let (go_on, wait) = sync_channel(1);
    let config = RecorderConfig {
        most_waiting: 50,
        free_bytes: Box::new(move |_| {
            let _ = wait.recv();
            Some(u64::MAX)
        }),
        ..RecorderConfig::default()
    };
    (config, go_on)
}

#[test]
fn a_slow_disk_loses_samples_and_counts_them() {
    let (config, go_on) = slow_disk();
    let mut bench = Bench::new(config);
    go_on.send(()).unwrap();
    bench.recorder.command(start_take(0));
    assert_eq!(bench.event(), RecorderEvent::TakeStarted { take: "take-01".to_owned() });
    // The thread waits for the disk now; the loop does not wait for the thread.
    for time_ms in (0..4000).step_by(5) {
        feed(&bench.recorder, time_ms);
    }
    let given = 400 + 160 + 40 + 40;
    assert_eq!(bench.recorder.lost_samples(), given - 50);
    drop(go_on);
    let (take, verdict) = bench.end();
    assert!(!verdict.good);
    let expected = format!("{} samples were lost: the disk was too slow", given - 50);
    assert!(verdict.problems.iter().any(|problem| problem.starts_with(&expected)), "{verdict:#?}");
    assert!(Take::read(&bench.dir.join(format!("{take}.mcap"))).is_ok());
}

#[test]
fn a_disk_that_fills_up_ends_the_take_and_says_why() {
    let free = Arc::new(AtomicU64::new(900 << 20));
    let told = Arc::clone(&free);
    let config = RecorderConfig {
        free_bytes: Box::new(move |_| Some(told.load(Ordering::Relaxed))),
        ..RecorderConfig::default()
    };
    let mut bench = Bench::new(config);
    bench.start(1);
    for time_ms in (0..3000).step_by(5) {
        feed(&bench.recorder, time_ms);
    }
    feed_baseline(&bench.recorder);
    // An answer to whatever shows that everything before is written.
    bench.recorder.command(RecorderCommand::Restore { take: "nothing".to_owned() });
    assert!(matches!(bench.event(), RecorderEvent::Failed { .. }));
    free.store(20 << 20, Ordering::Relaxed);
    for time_ms in (3000..6000).step_by(5) {
        feed(&bench.recorder, time_ms);
    }
    let RecorderEvent::TakeEnded { take, broken_off } = bench.event() else { panic!("it has to end") };
    assert!(broken_off.contains("the disk is nearly full (20 MB free, 32 MB are kept"), "{broken_off}");
    let (_, verdict) = bench.verdict();
    assert!(verdict.problems[0].contains("ended early: the disk is nearly full"), "{verdict:#?}");
    // What was recorded until then is a take like any other.
    let read = Take::read(&bench.dir.join(format!("{take}.mcap"))).unwrap();
    assert!(read.duration_s() >= 2.0, "{}", read.duration_s());
    assert!(!bench.recorder.recording());
    // Ending it again changes nothing, and the next one is refused by the same measure.
    bench.recorder.command(RecorderCommand::EndTake { broken_off: String::new() });
    bench.start(0);
    assert!(matches!(bench.event(), RecorderEvent::TakeLost { .. } | RecorderEvent::TakeEnded { .. }));
}

#[test]
fn samples_out_of_order_are_left_out_and_named() {
    let mut bench = Bench::new(RecorderConfig::default());
    bench.start(0);
    for time_ms in (0..4000).step_by(5) {
        feed(&bench.recorder, time_ms);
    }
    bench.recorder.joints(START_NS + 50 * MS, &[0.0, 0.0]);
    bench.recorder.joints(START_NS + 4000 * MS, &[f64::NAN, 0.0]);
    feed_baseline(&bench.recorder);
    let (_, verdict) = bench.end();
    assert_eq!(bench.recorder.lost_samples(), 2);
    assert_eq!(verdict.problems.len(), 1, "{verdict:#?}");
    assert!(verdict.problems[0].starts_with("2 samples were lost: the first one: "), "{verdict:#?}");
    assert!(verdict.problems[0].contains("follows one at"), "{verdict:#?}");
}

#[test]
fn what_cannot_be_started_or_kept_is_said() {
    let mut bench = Bench::new(RecorderConfig::default());
    bench.recorder.command(start_take(7));
    let RecorderEvent::TakeLost { problem } = bench.event() else { panic!("there is no such step") };
    assert!(problem.contains("there is no step 8, only 2"), "{problem}");
    assert!(!bench.recorder.recording());
    // A take without samples is none.
    bench.start(0);
    bench.recorder.command(RecorderCommand::EndTake { broken_off: "cancelled".to_owned() });
    let taken = bench.event();
    assert!(matches!(&taken, RecorderEvent::TakeEnded { .. }), "{taken:?}");
    let RecorderEvent::Checked { verdict, readable: false, .. } = bench.event() else {
        panic!("it is empty")
    };
    assert!(verdict.summary.contains("/joint_states: no messages"), "{verdict:?}");
    bench.recorder.command(RecorderCommand::EndSession);
    assert_eq!(bench.event(), RecorderEvent::SessionEnded);
    bench.recorder.command(start_take(0));
    assert!(
        matches!(bench.event(), RecorderEvent::TakeLost { problem } if problem.contains("no session is open"))
    );
}

#[test]
fn a_recorder_that_is_dropped_keeps_the_take() {
    let mut bench = Bench::new(RecorderConfig::default());
    bench.start(0);
    for time_ms in (0..1500).step_by(5) {
        feed(&bench.recorder, time_ms);
    }
    let Bench { recorder, dir, _temp } = bench;
    drop(recorder);
    let session = open(&dir);
    let take = &session.recording().takes[0];
    assert!(
        take.broken_off.contains("the session was left while the take was recorded"),
        "{}",
        take.broken_off
    );
    assert_eq!(Take::read(&dir.join(&take.file)).unwrap().num_frames(), 15);
    assert_eq!(fs::read_dir(&dir).unwrap().count(), 4, "take, two lists and the lock");
}
