//! Takes that are written while they happen: what is on disk can be read, however the writing ends.

use std::{
    cell::{Cell, RefCell},
    env, fs,
    io::{self, BufRead as _, BufReader, Cursor, Seek, SeekFrom, Write},
    path::Path,
    process::{Command, Stdio},
    rc::Rc,
};

use palpate_recording::{LiveTake, Session, SpanKind, TactileSampleRef, Take, close_partial};

use crate::support::{START_UNIX_NS, meta, station, tree};

const MS: u64 = 1_000_000;

/// Writes 5 ms of a take: joints at 10 Hz, the two streams at 100 and 40 Hz.
pub(crate) fn write_tick<W: Write + Seek>(
    live: &mut LiveTake<W>,
    tick_ms: u64,
) -> Result<(), palpate_recording::RecordingError> {
    if tick_ms.is_multiple_of(100) {
        live.joints(tick_ms * MS, &[tick_ms as f64 * 1e-4, -0.5])?;
    }
    for (stream_idx, width, period_ms) in [(0, 3, 10), (1, 2, 25)] {
        if tick_ms.is_multiple_of(period_ms) {
            let raw: Vec<f32> =
                (0..width).map(|channel| (tick_ms * 7 + channel * 31) as f32 % 411.0).collect();
            let active = vec![false; raw.len()];
            let sample = TactileSampleRef { raw: &raw, active: &active, device_time_ns: 0 };
            live.tactile(stream_idx, tick_ms * MS, sample)?;
        }
    }
    Ok(())
}

/// A disk: what is on it stays when the writer goes, and it is full after so many bytes.
#[derive(Clone)]
struct Disk {
    bytes: Rc<RefCell<Cursor<Vec<u8>>>>,
    left: Rc<Cell<usize>>,
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let granted = bytes.len().min(self.left.get());
        if granted == 0 && !bytes.is_empty() {
            return Err(io::ErrorKind::StorageFull.into());
        }
        self.left.set(self.left.get() - granted);
        self.bytes.borrow_mut().write(&bytes[..granted])
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Disk {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        self.bytes.borrow_mut().seek(position)
    }
}

#[test]
fn a_whole_take_is_read_like_any_other() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("take-01.mcap");
    let mut live = LiveTake::create(&path, &station(), &meta(), START_UNIX_NS).unwrap();
    for tick_ms in (0..2000).step_by(5) {
        write_tick(&mut live, tick_ms).unwrap();
    }
    live.note(700 * MS, "the cable is in the way").unwrap();
    live.note(900 * MS, "").unwrap();
    assert!((live.elapsed_s() - 1.99).abs() < 1e-9, "{}", live.elapsed_s());
    live.finish().unwrap();
    let take = Take::read(&path).unwrap();
    assert_eq!(take.num_frames(), 20);
    let notes: Vec<_> = take
        .spans
        .iter()
        .filter(|span| span.kind == SpanKind::Note)
        .map(|span| (span.start_s, span.label.as_str()))
        .collect();
    assert_eq!(notes, [(0.7, "the cable is in the way"), (0.9, "")]);
    // It is complete: nothing is mended.
    let before = tree(dir.path());
    assert_eq!(close_partial(&path).unwrap().damage, None);
    assert_eq!(tree(dir.path()), before);
}

#[test]
fn a_file_that_is_there_is_not_overwritten() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("take-01.mcap");
    fs::write(&path, "precious").unwrap();
    let error = LiveTake::create(&path, &station(), &meta(), START_UNIX_NS).map(|_| ()).unwrap_err();
    assert!(error.to_string().contains("failed to make"), "{error}");
    assert_eq!(fs::read_to_string(&path).unwrap(), "precious");
}

#[test]
fn a_refused_sample_leaves_the_take_as_it_was() {
    let mut live =
        LiveTake::new(Cursor::new(Vec::new()), Path::new("take-01.mcap"), &station(), &meta(), START_UNIX_NS)
            .unwrap();
    write_tick(&mut live, 0).unwrap();
    let error = live.joints(0, &[0.0, 0.0]).unwrap_err().to_string();
    assert!(
        error.starts_with("take-01.mcap: /joint_states: a sample at 0 ns follows one at 0 ns"),
        "{error}"
    );
    assert!(!live.failed());
    assert!(live.joints(10, &[0.0, f64::NAN]).unwrap_err().to_string().contains("is at NaN"));
    write_tick(&mut live, 100).unwrap();
    let bytes = live.finish().unwrap().into_inner();
    assert_eq!(Take::from_bytes(Path::new("take-01.mcap"), &bytes).unwrap().num_frames(), 2);
}

/// Wherever the disk is full, what was handed over before is a take.
#[test]
fn a_full_disk_ends_the_take_and_keeps_what_was_written() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("take-01.mcap.partial");
    let mut kept_s = Vec::new();
    for limit in [9_000, 12_345, 20_000, 31_000] {
        let disk = Disk { bytes: Rc::default(), left: Rc::new(Cell::new(usize::MAX)) };
        let mut live = LiveTake::new(disk.clone(), &path, &station(), &meta(), START_UNIX_NS).unwrap();
        disk.left.set(limit);
        let (failed_ms, error) = (0..60_000)
            .step_by(5)
            .find_map(|tick_ms| write_tick(&mut live, tick_ms).err().map(|error| (tick_ms, error)))
            .unwrap();
        assert!(error.is_disk_full() && error.to_string().contains("take-01.mcap.partial"), "{error}");
        assert!(live.failed());
        let again = write_tick(&mut live, 70_000).unwrap_err().to_string();
        assert!(again.contains("writing it failed before"), "{again}");
        drop(live);
        fs::write(&path, disk.bytes.borrow().get_ref()).unwrap();
        let closed = close_partial(&path).unwrap();
        assert!(closed.damage.unwrap().contains("was cut off"));
        let take = Take::read(&path).unwrap();
        assert!(take.duration_s() >= failed_ms as f64 * 1e-3 - 1.0, "{} {failed_ms}", take.duration_s());
        kept_s.push(take.duration_s());
    }
    assert!(kept_s.is_sorted() && kept_s[0] < kept_s[3], "{kept_s:?}");
}

/// Any prefix of the file that holds a take is given an end, and loses less than a second.
#[test]
fn a_file_cut_anywhere_is_closed_or_left_alone() {
    let mut live =
        LiveTake::new(Cursor::new(Vec::new()), Path::new("take-01.mcap"), &station(), &meta(), START_UNIX_NS)
            .unwrap();
    for tick_ms in (0..3000).step_by(5) {
        write_tick(&mut live, tick_ms).unwrap();
    }
    let bytes = live.finish().unwrap().into_inner();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("take-01.mcap");
    let (mut closed, mut durations_s) = (0, Vec::new());
    for cut in (0..bytes.len()).step_by(61) {
        fs::write(&path, &bytes[..cut]).unwrap();
        match close_partial(&path) {
            Ok(_) => {
                closed += 1;
                let take = Take::read(&path).unwrap();
                durations_s.push(take.duration_s());
                assert_eq!(take.joints.positions.len(), 2 * take.num_frames());
            }
            Err(error) => {
                assert!(error.to_string().starts_with(&format!("{}: ", path.display())), "{error}");
                assert_eq!(fs::read(&path).unwrap(), bytes[..cut], "left as it was");
            }
        }
    }
    assert!(closed > 20 && durations_s.is_sorted(), "{closed} {durations_s:?}");
    assert_eq!(*durations_s.last().unwrap(), 2.9);
}

#[test]
fn damage_in_the_middle_of_a_long_take_is_left_alone() {
    let mut live =
        LiveTake::new(Cursor::new(Vec::new()), Path::new("take-01.mcap"), &station(), &meta(), START_UNIX_NS)
            .unwrap();
    write_tick(&mut live, 0).unwrap();
    let mut bytes = live.finish().unwrap().into_inner();
    // Damage, and more after it than a writer can have left unfinished.
    let middle = bytes.len() - 40;
    bytes[middle..].fill(0xff);
    bytes.resize(bytes.len() + (5 << 20), 0xff);
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("take-01.mcap");
    fs::write(&path, &bytes).unwrap();
    assert!(close_partial(&path).is_err());
    assert_eq!(fs::read(&path).unwrap().len(), bytes.len());
}

const CHILD_DIR: &str = "PALPATE_TEST_CHILD_DIR";

/// Set for a process that ends its take as soon as it cannot be written any more.
const CHILD_ENDS: &str = "PALPATE_TEST_CHILD_ENDS";

/// A real file that may not grow: to the process as good as a full disk.
#[test]
fn a_process_whose_disk_is_full_ends_its_take_by_itself() {
    let dir = tempfile::tempdir().unwrap();
    let session = dir.path().join("monday");
    // The shell counts in units of 512 or 1024 bytes.
    let script = "trap '' XFSZ; ulimit -f 90; exec \"$0\" \"$@\"";
    let output = Command::new("sh")
        .args(["-c", script])
        .arg(env::current_exe().unwrap())
        .args(["--exact", "live::a_process_that_records_until_it_is_killed", "--nocapture"])
        .envs([(CHILD_DIR, session.as_os_str()), (CHILD_ENDS, "1".as_ref())])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    let reached_ms: u64 =
        said.lines().filter_map(|line| line.strip_prefix("at ")?.parse().ok()).max().unwrap();
    assert!(said.contains("failed to write") && said.contains("take-01.mcap.partial"), "{said}");

    let (growing, report) = crate::growing::open(&session).unwrap();
    assert!(report.is_empty(), "nothing was left to be mended: {report:?}");
    let take = &growing.recording().takes[0];
    assert!(take.file == "take-01.mcap" && take.broken_off == "no space", "{take:?}");
    let read = Take::read(&growing.take_path("take-01").unwrap()).unwrap();
    assert!(*read.streams[0].times_s.last().unwrap() >= reached_ms as f64 * 1e-3 - 1.0);
}

/// Not a test by itself: what [`a_killed_process_loses_less_than_a_second`] starts and kills.
#[test]
fn a_process_that_records_until_it_is_killed() {
    let Ok(dir) = env::var(CHILD_DIR) else { return };
    let mut growing = crate::growing::open(Path::new(&dir)).unwrap().0;
    let mut live = growing.start_take(0, &station(), &meta(), START_UNIX_NS).unwrap();
    for tick_ms in (0..).step_by(5) {
        if let Err(error) = write_tick(&mut live, tick_ms) {
            assert!(env::var(CHILD_ENDS).is_ok(), "{error}");
            println!("{error}");
            growing.end_take(live, "no space").unwrap();
            return;
        }
        if tick_ms % 100 == 0 {
            println!("at {tick_ms}");
        }
    }
}

#[test]
fn a_killed_process_loses_less_than_a_second() {
    for kill_at_ms in [1_700, 4_300] {
        let dir = tempfile::tempdir().unwrap();
        let session = dir.path().join("monday");
        let mut child = Command::new(env::current_exe().unwrap())
            .args(["--exact", "live::a_process_that_records_until_it_is_killed", "--nocapture"])
            .env(CHILD_DIR, &session)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut reached_ms = 0;
        for line in BufReader::new(child.stdout.take().unwrap()).lines() {
            if let Some(at) = line.unwrap().strip_prefix("at ") {
                reached_ms = at.parse().unwrap();
            }
            if reached_ms >= kill_at_ms {
                break;
            }
        }
        child.kill().unwrap();
        child.wait().unwrap();
        assert!(reached_ms >= kill_at_ms, "the other process recorded");

        let (growing, report) = crate::growing::open(&session).unwrap();
        assert!(report[0].contains("was being recorded when the program ended"), "{report:?}");
        let take = &growing.recording().takes[0];
        assert_eq!(take.file, "take-01-recovered.mcap");
        assert!(take.broken_off.contains("the program ended"), "{}", take.broken_off);
        let read = Take::read(&growing.take_path(take.id()).unwrap()).unwrap();
        let newest_s = read.streams[0].times_s.last().unwrap();
        assert!(*newest_s >= reached_ms as f64 * 1e-3 - 1.0, "{newest_s} s of {reached_ms} ms");
        // Nothing was accepted, and the session can be looked at all the same.
        assert!(Session::open(&session).unwrap().file.takes.is_empty());
    }
}
