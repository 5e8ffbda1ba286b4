//! Opens a zip archive whose directory is small, which is known before it is read into memory.
//!
//! The library reserves memory for as many entries as the end of the directory claims, and where that end is wrong it tries
//! every earlier one that it finds in the file. So the end is read here first, and the library sees no other.

use std::{
    cell::Cell,
    fs::File,
    io::{self, Read, Seek, SeekFrom},
    os::unix::fs::FileExt as _,
    path::Path,
    rc::Rc,
};

use zip::{ZipArchive, result::ZipError};

use crate::Error;

/// Most entries of an archive.
const MAX_ENTRIES: u64 = 10_000;
/// Largest directory of an archive that is read, bytes: an entry has 46 bytes and its name, and tools add a little.
const MAX_DIRECTORY_BYTES: u64 = 16 << 20;
/// The end of the directory (APPNOTE.TXT 4.3.16): signature, then numbers of disks and entries, size, place, comment.
const END_SIGNATURE: [u8; 4] = *b"PK\x05\x06";
const END_BYTES: usize = 4 + 4 * 2 + 2 * 4 + 2;
const MAX_COMMENT_BYTES: usize = u16::MAX as usize;
/// Says where the large end of the directory lies (4.3.15); right before the end.
const LARGE_LOCATOR_SIGNATURE: [u8; 4] = *b"PK\x06\x07";
const LARGE_LOCATOR_BYTES: usize = 20;
/// The end of the directory of large archives (4.3.14).
const LARGE_END_SIGNATURE: [u8; 4] = *b"PK\x06\x06";
const LARGE_END_BYTES: usize = 56;

/// What the end of the directory says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Directory {
    entries: u64,
    bytes: u64,
    /// Where it ends and its end begins.
    end: u64,
}

/// Opens the archive at `path`; one with more entries than allowed is refused before they are read.
pub(super) fn open(path: &Path) -> Result<ZipArchive<Masked>, Error> {
    let mut file = File::open(path).map_err(Error::io("read", path))?;
    let Some(directory) = find_directory(&mut file).map_err(Error::io("read", path))? else {
        return Err(unreadable("it has no end"));
    };
    if directory.entries > MAX_ENTRIES || directory.bytes > MAX_DIRECTORY_BYTES {
        return Err(too_many(&directory));
    }
    let Some(begin) = directory.end.checked_sub(directory.bytes) else {
        return Err(unreadable("its directory is longer than it is"));
    };
    if !has_one_end(&file, begin).map_err(Error::io("read", path))? {
        return Err(unreadable("its directory has several ends"));
    }
    let seen_from = Rc::new(Cell::new(begin));
    let archive =
        ZipArchive::new(Masked { file, position: 0, seen_from: seen_from.clone() }).map_err(not_a_zip)?;
    seen_from.set(0);
    Ok(archive)
}

fn too_many(directory: &Directory) -> Error {
    let Directory { entries, bytes, .. } = directory;
    Error::TooLarge(if *entries > MAX_ENTRIES {
        format!("the archive has {entries} entries, more than {MAX_ENTRIES}; upload fewer takes at a time")
    } else {
        format!(
            "the archive's directory has {} MB, more than {}; upload fewer takes at a time, or shorten names and comments",
            bytes.div_ceil(1 << 20),
            MAX_DIRECTORY_BYTES >> 20
        )
    })
}

pub(super) fn not_a_zip(err: ZipError) -> Error {
    unreadable(&err.to_string())
}

fn unreadable(why: &str) -> Error {
    Error::Content(format!("the upload is not a readable zip archive: {why}; zip the folder and try again"))
}

/// Whether nothing but one end, and one large end with its locator, lies from `begin` on.
fn has_one_end(file: &File, begin: u64) -> io::Result<bool> {
    let len = file.metadata()?.len();
    let mut bytes = vec![0; usize::try_from(len.saturating_sub(begin)).unwrap_or(usize::MAX)];
    file.read_exact_at(&mut bytes, begin)?;
    let count = |signature: [u8; 4]| bytes.windows(4).filter(|bytes| *bytes == signature).count();
    Ok(count(END_SIGNATURE) == 1 && count(LARGE_END_SIGNATURE) <= 1 && count(LARGE_LOCATOR_SIGNATURE) <= 1)
}

/// Reads what the end of the directory says; `None` if there is no such end, or only a half of it.
fn find_directory(file: &mut (impl Read + Seek)) -> io::Result<Option<Directory>> {
    let len = file.seek(SeekFrom::End(0))?;
    let tail_len = len.min((LARGE_LOCATOR_BYTES + END_BYTES + MAX_COMMENT_BYTES) as u64);
    file.seek(SeekFrom::Start(len - tail_len))?;
    let mut tail = Vec::new();
    file.take(tail_len).read_to_end(&mut tail)?;
    let ends = (0..(tail.len() + 1).saturating_sub(END_BYTES)).rev();
    // The comment may hold such bytes too; at the true end its length is right.
    let is_end = |&begin: &usize| {
        tail[begin..].starts_with(&END_SIGNATURE)
            && begin + END_BYTES + usize::from(u16_at(&tail, begin + 20)) == tail.len()
    };
    let Some(begin) = ends.into_iter().find(is_end) else { return Ok(None) };
    let mut directory = Directory {
        entries: u16_at(&tail, begin + 10).into(),
        bytes: u32_at(&tail, begin + 12).into(),
        end: len - tail_len + begin as u64,
    };
    let locator = begin.checked_sub(LARGE_LOCATOR_BYTES).map(|locator| &tail[locator..begin]);
    if let Some(locator) = locator.filter(|locator| locator.starts_with(&LARGE_LOCATOR_SIGNATURE)) {
        let mut large = [0; LARGE_END_BYTES];
        let large_begin = u64_at(locator, 8);
        file.seek(SeekFrom::Start(large_begin))?;
        let is_whole = match file.read_exact(&mut large) {
            Ok(()) => large.starts_with(&LARGE_END_SIGNATURE),
            Err(err) if err.kind() == io::ErrorKind::UnexpectedEof => false,
            Err(err) => return Err(err),
        };
        if !is_whole {
            return Ok(None);
        }
        // Readers differ in what they believe where the short end is not full.
        let is_full = directory.entries == u64::from(u16::MAX);
        let entries = u64_at(&large, 32);
        directory.entries = if is_full { entries } else { directory.entries.max(entries) };
        directory.bytes = u64_at(&large, 40);
        directory.end = large_begin;
    }
    Ok(Some(directory))
}

fn u16_at(bytes: &[u8], begin: usize) -> u16 {
    bytes.get(begin..begin + 2).and_then(|bytes| bytes.try_into().ok()).map_or(0, u16::from_le_bytes)
}

fn u32_at(bytes: &[u8], begin: usize) -> u32 {
    bytes.get(begin..begin + 4).and_then(|bytes| bytes.try_into().ok()).map_or(0, u32::from_le_bytes)
}

fn u64_at(bytes: &[u8], begin: usize) -> u64 {
    bytes.get(begin..begin + 8).and_then(|bytes| bytes.try_into().ok()).map_or(0, u64::from_le_bytes)
}

/// A file that reads as zeros before a certain byte.
pub(super) struct Masked {
    file: File,
    position: u64,
    seen_from: Rc<Cell<u64>>,
}

impl Read for Masked {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let masked = self.seen_from.get().saturating_sub(self.position);
        let read = if masked > 0 {
            let len = bytes.len().min(usize::try_from(masked).unwrap_or(usize::MAX));
            bytes[..len].fill(0);
            len
        } else {
            self.file.read_at(bytes, self.position)?
        };
        self.position += read as u64;
        Ok(read)
    }
}

impl Seek for Masked {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let (from, by) = match to {
            SeekFrom::Start(position) => (position, 0),
            SeekFrom::End(by) => (self.file.metadata()?.len(), by),
            SeekFrom::Current(by) => (self.position, by),
        };
        let invalid = || io::Error::new(io::ErrorKind::InvalidInput, "a place before the file's first byte");
        self.position = from.checked_add_signed(by).ok_or_else(invalid)?;
        Ok(self.position)
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Cursor, Write as _};

    use zip::{ZipWriter, write::SimpleFileOptions};

    use super::*;

    fn archive(entries: usize, comment: &str) -> Vec<u8> {
        let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
        writer.set_comment(comment);
        for entry in 0..entries {
            writer.start_file(format!("{entry}"), SimpleFileOptions::default()).unwrap();
        }
        writer.finish().unwrap().into_inner()
    }

    fn open_bytes(bytes: &[u8]) -> Result<usize, Error> {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(bytes).unwrap();
        open(file.path()).map(|archive| archive.len())
    }

    #[test]
    fn the_number_of_entries_is_read_from_the_end() {
        for (entries, comment) in [(0, ""), (3, "a comment"), (9_999, "")] {
            let bytes = archive(entries, comment);
            let found = find_directory(&mut Cursor::new(&bytes)).unwrap().unwrap();
            assert_eq!(found.entries, entries as u64, "{comment:?}");
            assert_eq!(open_bytes(&bytes).unwrap(), entries);
        }
        // More than the short end can say.
        let large = archive(70_000, "");
        assert_eq!(find_directory(&mut Cursor::new(&large)).unwrap().unwrap().entries, 70_000);
        let err = open_bytes(&large).unwrap_err();
        assert!(matches!(err, Error::TooLarge(_)) && err.to_string().contains("70000 entries"), "{err}");
        assert_eq!(find_directory(&mut Cursor::new(b"no archive")).unwrap(), None);
        assert_eq!(find_directory(&mut Cursor::new(b"")).unwrap(), None);
    }

    /// A directory of 300,000 entries, of which the end tells or says nothing.
    #[test]
    fn a_huge_directory_is_refused_without_reading_it() {
        let one = archive(1, "");
        let begin = one.windows(4).position(|bytes| bytes == b"PK\x01\x02").unwrap();
        let end = one.windows(4).position(|bytes| bytes == END_SIGNATURE).unwrap();
        const ENTRIES: u32 = 300_000;
        let mut bytes = one[..begin].to_vec();
        let entry = &one[begin..end];
        for _ in 0..ENTRIES {
            bytes.extend_from_slice(entry);
        }
        let directory_bytes = u32::try_from(bytes.len() - begin).unwrap();
        let large_end = bytes.len() as u64;
        let mut large = [0; LARGE_END_BYTES];
        large[..4].copy_from_slice(&LARGE_END_SIGNATURE);
        large[4..12].copy_from_slice(&44_u64.to_le_bytes());
        large[12..14].copy_from_slice(&45_u16.to_le_bytes());
        large[14..16].copy_from_slice(&45_u16.to_le_bytes());
        for (at, value) in
            [(24, ENTRIES.into()), (32, ENTRIES.into()), (40, directory_bytes.into()), (48, begin as u64)]
        {
            large[at..at + 8].copy_from_slice(&u64::to_le_bytes(value));
        }
        let mut locator = [0; LARGE_LOCATOR_BYTES];
        locator[..4].copy_from_slice(&LARGE_LOCATOR_SIGNATURE);
        locator[8..16].copy_from_slice(&large_end.to_le_bytes());
        locator[16..20].copy_from_slice(&1_u32.to_le_bytes());
        let mut short = one[end..].to_vec();
        short[8..12].fill(0xff);
        short[12..20].fill(0xff);
        let honest = [&bytes[..], &large, &locator, &short].concat();
        let err = open_bytes(&honest).unwrap_err();
        assert!(matches!(err, Error::TooLarge(_)) && err.to_string().contains("300000 entries"), "{err}");
        // A second end after it, which says that there is one entry and is wrong about where: the library would go back to
        // the first one.
        for bytes in [directory_bytes, 46] {
            let mut lie = one[end..].to_vec();
            lie[12..16].copy_from_slice(&bytes.to_le_bytes());
            lie[16..20].copy_from_slice(&3_u32.to_le_bytes());
            let err = open_bytes(&[&honest[..], &lie].concat()).unwrap_err();
            assert!(!matches!(err, Error::Io { .. }), "{err}");
        }
        // The same within the directory that the end tells of.
        let mut hidden = one.clone();
        hidden.splice(end..end, short.clone());
        let directory_bytes = u32::try_from(end - begin + short.len()).unwrap();
        let at = hidden.len() - END_BYTES + 12;
        hidden[at..at + 4].copy_from_slice(&directory_bytes.to_le_bytes());
        let err = open_bytes(&hidden).unwrap_err().to_string();
        assert!(err.contains("several ends"), "{err}");
    }

    #[test]
    fn what_lies_before_the_directory_is_read_once_it_is_open() {
        let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
        // An archive in the archive has an end of its own.
        let inner = archive(2, "");
        let stored = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
        writer.start_file("inner.zip", stored).unwrap();
        writer.write_all(&inner).unwrap();
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(&writer.finish().unwrap().into_inner()).unwrap();
        let mut read = Vec::new();
        open(file.path()).unwrap().by_index(0).unwrap().read_to_end(&mut read).unwrap();
        assert_eq!(read, inner);
    }
}
