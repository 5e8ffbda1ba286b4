//! Sessions whose process was killed while a take was written: they go on, and lose a second at most.

use std::{collections::BTreeSet, fs, path::Path};

use palpate_recording::{GrowingSession, PlannedStep, Session, SessionPlan, Take, TakeMeta, TakeState};
use palpate_reports::TakeVerdict;

use crate::{
    live::write_tick,
    support::{START_UNIX_NS, meta, station},
};

const PRIMITIVES: [&str; 2] = ["tap", "roll"];

fn plan() -> SessionPlan {
    let step = |primitive: &str| PlannedStep {
        object: "ball".to_owned(),
        primitive: primitive.to_owned(),
        added_because: None,
    };
    SessionPlan { plan: "two".to_owned(), steps: PRIMITIVES.map(step).into() }
}

fn open(dir: &Path) -> (GrowingSession, Vec<String>) {
    GrowingSession::open(dir, "finger", &plan(), "somebody", "2026-11-21T10:00:00Z")
        .expect("the session goes on")
}

fn meta_of(step: usize) -> TakeMeta {
    TakeMeta { primitive: PRIMITIVES[step].to_owned(), ..meta() }
}

fn record(growing: &mut GrowingSession, step: usize) -> String {
    let mut live = growing.start_take(step, &station(), &meta_of(step), START_UNIX_NS).unwrap();
    for tick_ms in (0..1000).step_by(5) {
        write_tick(&mut live, tick_ms).unwrap();
    }
    growing.end_take(live, "").unwrap().take
}

/// Records `duration_ms` of a take of step 1 and kills the process when `cut` (0 to 1) of the file was written. Gives the
/// moment at which so much was there, ms.
fn crash(mut growing: GrowingSession, duration_ms: u64, cut: f64) -> u64 {
    let mut live = growing.start_take(1, &station(), &meta_of(1), START_UNIX_NS).unwrap();
    let path = live.path().to_owned();
    let mut lengths = vec![(0, fs::metadata(&path).unwrap().len())];
    for tick_ms in (0..duration_ms).step_by(5) {
        write_tick(&mut live, tick_ms).unwrap();
        lengths.push((tick_ms, fs::metadata(&path).unwrap().len()));
    }
    let bytes = fs::read(&path).unwrap();
    // Dropping them writes an end; a killed process does not.
    drop((live, growing));
    let len = (bytes.len() as f64 * cut) as usize;
    fs::write(&path, &bytes[..len]).unwrap();
    lengths.iter().find(|&&(_, written)| written >= len as u64).map_or(duration_ms, |&(tick_ms, _)| tick_ms)
}

fn verdict(summary: &str) -> TakeVerdict {
    TakeVerdict {
        good: true,
        summary: summary.to_owned(),
        problems: Vec::new(),
        covered: Vec::new(),
        missed: Vec::new(),
        rates_hz: Vec::new(),
    }
}

fn names(growing: &GrowingSession) -> Vec<(&str, TakeState)> {
    growing.recording().takes.iter().map(|take| (take.file.as_str(), take.state)).collect()
}

#[test]
fn a_step_that_is_recovered_twice_goes_on() {
    use TakeState::{Accepted, Discarded, Review};
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path().join("monday");
    crash(open(&dir).0, 2000, 1.0);
    let (mut growing, _) = open(&dir);
    growing.set_verdict("take-02-recovered", verdict("the first"), true).unwrap();
    growing.set_aside("take-02-recovered").unwrap();
    crash(growing, 2500, 1.0);

    let (mut growing, mended) = open(&dir);
    assert!(mended[0].contains("take-02-recovered-2.mcap, which waits for a decision"), "{mended:?}");
    let expected = [("take-02-recovered.mcap", Discarded), ("take-02-recovered-2.mcap", Review)];
    assert_eq!(names(&growing), expected);
    // The verdict of the second is its own.
    assert!(growing.recording().takes[1].verdict.is_none());
    let read = Take::read(&growing.take_path("take-02-recovered-2").unwrap()).unwrap();
    assert!(read.duration_s() > 1.9, "{}", read.duration_s());
    growing.set_verdict("take-02-recovered-2", verdict("the second"), true).unwrap();
    assert_eq!(growing.recording().takes[0].verdict.as_ref().unwrap().summary, "the first");
    assert_eq!(growing.recording().takes[1].verdict.as_ref().unwrap().summary, "the second");
    drop(growing);
    let (mut growing, mended) = open(&dir);
    assert!(mended.is_empty(), "{mended:?}");
    growing.accept("take-02-recovered-2").unwrap();
    growing.set_aside("take-02-recovered-2").unwrap();
    growing.restore("take-02-recovered").unwrap();
    growing.accept("take-02-recovered").unwrap();
    assert_eq!(
        names(&growing),
        [("take-02-recovered.mcap", Accepted), ("take-02-recovered-2.mcap", Discarded)]
    );
}

/// What an earlier version left: the page showed the first one's verdict for both, and after a restart the session was
/// refused.
#[test]
fn a_list_that_has_a_name_twice_is_mended() {
    use TakeState::{Discarded, Review};
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path().join("monday");
    crash(open(&dir).0, 2000, 1.0);
    let (mut growing, _) = open(&dir);
    growing.set_aside("take-02-recovered").unwrap();
    let second = record(&mut growing, 1);
    growing.set_verdict(&second, verdict("of another take"), true).unwrap();
    drop(growing);
    let list = dir.join("recording.toml");
    let text = fs::read_to_string(&list).unwrap();
    fs::write(&list, text.replace(&format!("{second}.mcap"), "take-02-recovered.mcap")).unwrap();
    let wrong = dir.join("take-02-recovered.mcap");
    fs::rename(dir.join(format!("{second}.mcap")), &wrong).unwrap();
    let second = fs::read(&wrong).unwrap();

    let check = || {
        assert!(GrowingSession::steps_of(&dir).unwrap().is_some());
        let (growing, mended) = open(&dir);
        assert!(
            mended[0].contains("take-02-recovered was listed twice")
                && mended[0].contains("take-02-recovered-2"),
            "{mended:?}"
        );
        let expected = [("take-02-recovered.mcap", Discarded), ("take-02-recovered-2.mcap", Review)];
        assert_eq!(names(&growing), expected);
        assert!(growing.recording().takes[1].verdict.is_none(), "it is checked again");
        assert_eq!(fs::read(growing.take_path("take-02-recovered-2").unwrap()).unwrap(), second);
        assert!(growing.take_path("take-02-recovered").unwrap().is_file());
    };
    let broken = fs::read(&list).unwrap();
    check();
    // Killed after the file was moved and before that was written down.
    fs::write(&list, broken).unwrap();
    check();
    let (_, mended) = open(&dir);
    assert!(mended.is_empty(), "{mended:?}");
}

#[test]
fn a_crash_while_a_take_is_recovered_loses_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path().join("monday");
    crash(open(&dir).0, 2000, 1.0);
    let list = fs::read(dir.join("recording.toml")).unwrap();
    drop(open(&dir));
    fs::write(dir.join("recording.toml"), list).unwrap();
    let (growing, mended) = open(&dir);
    assert!(mended[0].contains("take-02 was recovered as take-02-recovered.mcap"), "{mended:?}");
    assert_eq!(names(&growing), [("take-02-recovered.mcap", TakeState::Review)]);
}

#[test]
fn the_highest_number_of_a_take_that_was_set_aside_does_not_wrap() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path().join("monday");
    let (mut growing, _) = open(&dir);
    let first = record(&mut growing, 0);
    growing.set_aside(&first).unwrap();
    let second = record(&mut growing, 0);
    drop(growing);
    let path = dir.join("recording.toml");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replace("set_aside = 1", "set_aside = 4294967295")).unwrap();
    let (mut growing, _) = open(&dir);
    growing.set_aside(&second).unwrap();
    assert_eq!(growing.last_set_aside().unwrap().id(), second);
    assert_eq!(growing.recording().takes[0].set_aside, 1);
}

/// Numbers from a seed (SplitMix64), 0 to 1.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = self.0;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((bits ^ (bits >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Every take can be read, none is listed twice, what was accepted stays, and the newest take of step 1 lacks less than a
/// second of what was recorded until `killed_ms`.
fn check(growing: &GrowingSession, dir: &Path, accepted: &str, killed_ms: u64, about: &str) {
    let takes = &growing.recording().takes;
    let files: BTreeSet<&str> = takes.iter().map(|take| take.file.as_str()).collect();
    assert_eq!(files.len(), takes.len(), "{about}: {files:?}");
    let session = Session::open(dir).unwrap();
    let listed: Vec<&str> = session.file.takes.iter().map(|take| take.id()).collect();
    assert_eq!(listed, [accepted], "{about}");
    let mut newest_s = 0.0_f64;
    for take in takes {
        if take.readable == Some(false) {
            continue;
        }
        let path = growing.take_path(take.id()).unwrap();
        let read = Take::read(&path).unwrap_or_else(|error| panic!("{about}: {error}"));
        if take.step == 1 && take.state == TakeState::Review {
            let times_s = [&read.joints.times_s, &read.streams[0].times_s, &read.streams[1].times_s];
            newest_s = times_s.iter().filter_map(|times_s| times_s.last()).copied().fold(newest_s, f64::max);
        }
    }
    let lost_s = killed_ms as f64 * 1e-3 - newest_s;
    assert!(lost_s <= 1.0, "{about}: {lost_s} s of {killed_ms} ms are lost: {takes:?}");
}

#[test]
fn whatever_a_crash_leaves_the_session_goes_on() {
    for seed in 0..50 {
        let mut random = Random(seed);
        let root = tempfile::tempdir().unwrap();
        let dir = root.path().join("monday");
        let (mut growing, _) = open(&dir);
        let accepted = record(&mut growing, 0);
        growing.accept(&accepted).unwrap();
        // Every third time the process is killed twice at the same step.
        for again in 0..=usize::from(seed % 3 == 0) {
            let killed_ms = crash(growing, 700 + (random.next() * 1800.0) as u64, random.next());
            let mut about = format!("seed {seed}, crash {again}, killed at {killed_ms} ms");
            // The list is replaced whole; a file system that lost a part of it all the same is no reason to lose takes.
            if random.next() < 0.5 {
                let path = dir.join("recording.toml");
                let text = fs::read(&path).unwrap();
                let len = (text.len() as f64 * random.next()) as usize;
                fs::write(&path, &text[..len]).unwrap();
                about += &format!(", list cut at {len} of {} bytes", text.len());
            }
            assert!(GrowingSession::steps_of(&dir).is_ok(), "{about}");
            growing = open(&dir).0;
            check(&growing, &dir, &accepted, killed_ms, &about);
            let waiting: Vec<String> = growing
                .recording()
                .takes
                .iter()
                .filter(|take| take.step == 1 && take.state == TakeState::Review)
                .map(|take| take.id().to_owned())
                .collect();
            for take in waiting {
                growing.set_aside(&take).unwrap();
            }
        }
        let good = record(&mut growing, 1);
        growing.accept(&good).unwrap();
        drop(growing);
        let (growing, mended) = open(&dir);
        assert!(mended.is_empty(), "seed {seed}: {mended:?}");
        assert_eq!(growing.session().accepted_takes().unwrap().len(), 2);
    }
}
