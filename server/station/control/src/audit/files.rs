//! The files of the audit log: `audit.jsonl`, which is written, and full ones before it, `audit-000001.jsonl` and so on.
//!
//! A file is full at the end of a line, and becomes the next number by one rename, so that no line is lost or cut whenever
//! the program is killed. A place in the log is a number and an offset, which stay what they are when files become full.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, BufWriter, ErrorKind, Read as _, Seek as _, SeekFrom, Write as _},
    path::{Path, PathBuf},
    str::FromStr,
};

use super::{AuditLine, AuditRotation};

/// How often files may become full while somebody reads, before that is given up.
const MAX_READS: usize = 8;

/// The file that is written.
#[derive(Debug)]
pub(super) struct LogFile {
    pub(super) path: PathBuf,
    rotation: AuditRotation,
    sink: BufWriter<File>,
    num_bytes: u64,
}

impl LogFile {
    pub(super) fn open(path: &Path, rotation: AuditRotation) -> io::Result<Self> {
        let (sink, num_bytes) = append_to(path)?;
        Ok(Self { path: path.to_owned(), rotation, sink, num_bytes })
    }

    pub(super) fn write(&mut self, line: &AuditLine) -> io::Result<()> {
        if self.num_bytes >= self.rotation.max_bytes {
            self.rotate()?;
        }
        let mut text = serde_json::to_vec(line).map_err(io::Error::from)?;
        text.push(b'\n');
        self.sink.write_all(&text)?;
        self.num_bytes += text.len() as u64;
        Ok(())
    }

    pub(super) fn flush(&mut self) -> io::Result<()> {
        self.sink.flush()
    }

    /// Begins another file. Where that fails the full one is written on, and nothing is lost.
    fn rotate(&mut self) -> io::Result<()> {
        self.sink.flush()?;
        let full = full_files(&self.path)?;
        let number = full.last().map_or(1, |&(number, _)| number + 1);
        fs::rename(&self.path, full_path(&self.path, number))?;
        (self.sink, self.num_bytes) = append_to(&self.path)?;
        let num_kept = full.len() + 1;
        for (_, path) in full.iter().take(num_kept.saturating_sub(self.rotation.keep.max(1))) {
            fs::remove_file(path)?;
        }
        Ok(())
    }
}

/// Opens `path` to append whole lines, and says how long it is.
fn append_to(path: &Path) -> io::Result<(BufWriter<File>, u64)> {
    let mut file = OpenOptions::new().create(true).append(true).read(true).open(path)?;
    let mut num_bytes = file.metadata()?.len();
    // A program that was killed while it wrote may have left the beginning of a line.
    let mut last = [b'\n'];
    if num_bytes > 0 && file.metadata()?.is_file() {
        file.seek(SeekFrom::End(-1))?;
        file.read_exact(&mut last)?;
    }
    if last != *b"\n" {
        file.write_all(b"\n")?;
        num_bytes += 1;
    }
    Ok((BufWriter::new(file), num_bytes))
}

fn full_path(path: &Path, number: u64) -> PathBuf {
    path.with_file_name(format!("{}-{number:06}.jsonl", stem(path)))
}

fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// The full files beside `path`, oldest first.
fn full_files(path: &Path) -> io::Result<Vec<(u64, PathBuf)>> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let prefix = format!("{}-", stem(path));
    let mut files = Vec::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name();
        let number = name
            .to_str()
            .and_then(|name| name.strip_prefix(&prefix)?.strip_suffix(".jsonl"))
            .filter(|digits| digits.len() >= 6 && digits.bytes().all(|byte| byte.is_ascii_digit()))
            .and_then(|digits| digits.parse::<u64>().ok());
        if let Some(number) = number.filter(|_| entry.file_type().is_ok_and(|kind| kind.is_file())) {
            files.push((number, entry.path()));
        }
    }
    files.sort_unstable();
    Ok(files)
}

/// A place between two lines of the log; written as `FILE:OFFSET`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct AuditPosition {
    file: u64,
    offset: u64,
}

impl std::fmt::Display for AuditPosition {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}:{}", self.file, self.offset)
    }
}

impl FromStr for AuditPosition {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = text
            .split_once(':')
            .and_then(|(file, offset)| Some(Self { file: file.parse().ok()?, offset: offset.parse().ok()? }));
        parsed.ok_or_else(|| {
            format!("{text:?} is no place in the audit log; take the one that the answer before gave")
        })
    }
}

/// Lines of the log, oldest first.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AuditPage {
    /// Whole lines.
    pub lines: Vec<u8>,
    /// Where the page before ends, if there is one.
    pub older: Option<AuditPosition>,
}

/// The last whole lines `before` a place, or of the whole log at `path`: `max_bytes` of them at most, from as many files as
/// that takes.
pub fn read_audit(path: &Path, before: Option<AuditPosition>, max_bytes: u64) -> io::Result<AuditPage> {
    let mut tries = 0;
    loop {
        let full = full_files(path).or_else(|err| match err.kind() {
            // Nothing has happened yet.
            ErrorKind::NotFound => Ok(Vec::new()),
            _ => Err(err),
        })?;
        let page = read_files(path, &full, before, max_bytes);
        tries += 1;
        // A file that became full meanwhile, or was removed, has another name now.
        let same = full_files(path).is_ok_and(|now| now == full);
        if same || tries >= MAX_READS || page.as_ref().is_err_and(|err| err.kind() != ErrorKind::NotFound) {
            return page;
        }
    }
}

fn read_files(
    path: &Path,
    full: &[(u64, PathBuf)],
    before: Option<AuditPosition>,
    max_bytes: u64,
) -> io::Result<AuditPage> {
    let newest = full.last().map_or(1, |&(number, _)| number + 1);
    let mut files = full.to_vec();
    files.push((newest, path.to_owned()));
    let end = before.unwrap_or(AuditPosition { file: newest, offset: u64::MAX });
    let mut parts: Vec<Vec<u8>> = Vec::new();
    let mut room = max_bytes;
    let mut older = None;
    for (idx, (number, path)) in files.iter().enumerate().rev().filter(|(_, (number, _))| *number <= end.file)
    {
        let has_older = idx > 0;
        let file = match File::open(path) {
            Ok(file) => file,
            Err(err) if err.kind() == ErrorKind::NotFound && *number == newest => continue,
            Err(err) => return Err(err),
        };
        let meta = file.metadata()?;
        if !meta.is_file() {
            return Err(io::Error::new(ErrorKind::InvalidInput, "the audit log is no plain file"));
        }
        let len = meta.len();
        let to = if *number == end.file { end.offset.min(len) } else { len };
        let from = to.saturating_sub(room);
        let (part, begin) = whole_lines(file, from, to)?;
        room = room.saturating_sub(to - from);
        parts.push(part);
        older = match (begin, has_older) {
            (0, false) => None,
            (offset, _) => Some(AuditPosition { file: *number, offset }),
        };
        if from > 0 || room == 0 {
            break;
        }
    }
    parts.reverse();
    Ok(AuditPage { lines: parts.concat(), older })
}

/// The whole lines of `file` between two offsets, and where they begin.
fn whole_lines(mut file: File, from: u64, to: u64) -> io::Result<(Vec<u8>, u64)> {
    // The byte before tells whether a line begins there.
    let begin = from.saturating_sub(1);
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(begin))?;
    file.take(to - begin).read_to_end(&mut bytes)?;
    let skipped = match from {
        0 => 0,
        _ => bytes.iter().position(|&byte| byte == b'\n').map_or(bytes.len(), |end| end + 1),
    };
    bytes.drain(..skipped);
    // What is being written has no end yet.
    let end = bytes.iter().rposition(|&byte| byte == b'\n').map_or(0, |end| end + 1);
    bytes.truncate(end);
    Ok((bytes, begin + skipped as u64))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::audit::{AuditFile, AuditRotation};

    fn whats(lines: &[u8]) -> Vec<String> {
        let text = std::str::from_utf8(lines).unwrap();
        text.lines().map(|line| serde_json::from_str::<AuditLine>(line).unwrap().what).collect()
    }

    /// Everything that can be read, page by page from the newest.
    fn read_all(path: &Path, max_bytes: u64) -> Vec<String> {
        let (mut all, mut before) = (Vec::new(), None);
        loop {
            let AuditPage { lines, older } = read_audit(path, before, max_bytes).unwrap();
            all.splice(0..0, whats(&lines));
            match older {
                Some(older) => {
                    assert!(before.is_none_or(|before| older < before), "{older} after {before:?}");
                    before = Some(older);
                }
                None => return all,
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        /// Whatever the sizes of lines, files and pages: every line is there once, in its order, also over a restart.
        #[test]
        fn nothing_is_lost_by_rotation(
            lengths in prop::collection::vec(0_usize..300, 1..60),
            max_bytes in 1_u64..2000,
            page_bytes in 600_u64..3000,
            restart in 0_usize..60,
        ) {
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("audit.jsonl");
            let open = || AuditFile::open(&path, AuditRotation { max_bytes, keep: 1000 }).unwrap();
            let mut file = open();
            let mut expected = Vec::new();
            for (number, length) in lengths.iter().enumerate() {
                if number == restart {
                    drop(file);
                    file = open();
                }
                let what = format!("{number} {}", "x".repeat(*length));
                file.note("ada", "", &what);
                expected.push(what);
            }
            prop_assert!(file.flush(std::time::Duration::from_secs(60)));
            prop_assert_eq!(read_all(&path, page_bytes), expected);
        }
    }

    #[test]
    fn oldest_files_go_and_a_line_cut_by_a_crash_stays_alone() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("audit.jsonl");
        assert_eq!(read_audit(&path, None, 1000).unwrap(), AuditPage::default(), "before anything happened");
        fs::write(&path, "{\"time\":\"cut off").unwrap();
        let file = AuditFile::open(&path, AuditRotation { max_bytes: 1, keep: 3 }).unwrap();
        for number in 0..10 {
            file.note("ada", "", &number.to_string());
        }
        drop(file);
        let mut names: Vec<String> = dir
            .path()
            .read_dir()
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        assert_eq!(names, ["audit-000008.jsonl", "audit-000009.jsonl", "audit-000010.jsonl", "audit.jsonl"]);
        assert_eq!(read_all(&path, 1 << 20), ["6", "7", "8", "9"]);
    }

    #[test]
    fn places_are_those_that_were_given() {
        for text in ["", "1", "x:1", "1:-1", "1:2:3"] {
            assert!(text.parse::<AuditPosition>().unwrap_err().contains("no place"), "{text}");
        }
        let place = AuditPosition { file: 3, offset: 77 };
        assert_eq!(place.to_string().parse(), Ok(place));
        // Beyond the end is the end.
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("audit.jsonl");
        let file = AuditFile::open(&path, AuditRotation::default()).unwrap();
        file.note("ada", "", "armed");
        assert!(file.flush(std::time::Duration::from_secs(60)));
        let page = read_audit(&path, Some(AuditPosition { file: 9, offset: 1 << 40 }), 1 << 20).unwrap();
        assert_eq!((whats(&page.lines), page.older), (vec!["armed".to_owned()], None));
    }
}
