//! Gives a take that was cut off its end back, in place.

use std::{
    fs::OpenOptions,
    io::{Seek, SeekFrom, Write},
    path::Path,
};

use mcap::{
    parse_record,
    records::{Record, op},
};

use crate::{
    RecordingError, Take,
    files::{MAX_TAKE_BYTES, read_file},
};

/// A writer that was stopped leaves less than one chunk unfinished, and chunks have about 1 MiB.
const MAX_CUT_OFF: usize = 4 << 20;
/// Opcode and length in front of every record.
const RECORD_HEAD: usize = 1 + 8;

/// What [`close_partial`] made of a file.
#[derive(Clone, Debug)]
pub struct Closed {
    /// The take, whole again.
    pub take: Take,
    /// What was wrong with the file and how much of it was left out; `None` if it was whole.
    pub damage: Option<String>,
}

/// Makes the take at `path`, whose writer was killed or ran out of space, readable by everything: what follows the last
/// complete record goes, and an end takes its place. No more than that is changed, so a full disk is no obstacle.
///
/// A file of which no take can be read is left as it is, and the error says why. So is one that is damaged long before
/// its end, since what follows may be worth a closer look.
pub fn close_partial(path: &Path) -> Result<Closed, RecordingError> {
    let mut bytes = read_file(path, MAX_TAKE_BYTES)?;
    let error = match Take::from_bytes(path, &bytes) {
        Ok(take) => return Ok(Closed { take, damage: None }),
        Err(error) => error,
    };
    let len = bytes.len();
    let intact_len = intact_len(&bytes);
    if len - intact_len > MAX_CUT_OFF {
        return Err(error);
    }
    bytes.truncate(intact_len);
    bytes.extend_from_slice(&end());
    // What cannot be read as a take even with an end keeps its bytes, and its own error says most.
    let take = Take::from_bytes(path, &bytes).map_err(|_| error)?;
    let mut file = OpenOptions::new().write(true).open(path).map_err(RecordingError::io("open", path))?;
    file.set_len(intact_len as u64)
        .and_then(|()| file.seek(SeekFrom::End(0)))
        .and_then(|_| file.write_all(&end()))
        .and_then(|()| file.sync_all())
        .map_err(RecordingError::io("complete", path))?;
    let damage = format!(
        "the recording was cut off; {:.3} s could be read, {} bytes after that could not",
        take.duration_s(),
        len - intact_len
    );
    Ok(Closed { take, damage: Some(damage) })
}

/// How many bytes at the start are complete records of the data section.
fn intact_len(bytes: &[u8]) -> usize {
    let mut position = mcap::MAGIC.len();
    while let Some(head) = bytes.get(position..position + RECORD_HEAD) {
        let length =
            head[1..].try_into().map(u64::from_le_bytes).ok().and_then(|len| usize::try_from(len).ok());
        let content = length
            .and_then(|length| (position + RECORD_HEAD).checked_add(length))
            .and_then(|end| bytes.get(position + RECORD_HEAD..end));
        let Some(content) = content else { break };
        // The data section ends here; what follows is made anew.
        if matches!(head[0], op::DATA_END | op::FOOTER) || !is_intact(head[0], content) {
            break;
        }
        position += RECORD_HEAD + content.len();
    }
    position.min(bytes.len())
}

fn is_intact(opcode: u8, content: &[u8]) -> bool {
    match opcode {
        // Attachments were checked when the take was read, or it has none.
        op::ATTACHMENT => true,
        op::CHUNK => match parse_record(opcode, content) {
            Ok(Record::Chunk { header, data }) => mcap::read::ChunkReader::new(header, &data)
                .is_ok_and(|mut records| records.all(|record| record.is_ok())),
            _ => false,
        },
        _ => parse_record(opcode, content).is_ok(),
    }
}

/// The end of a file without a summary: an empty checksum stands for none.
fn end() -> Vec<u8> {
    let mut end = vec![op::DATA_END];
    end.extend_from_slice(&4_u64.to_le_bytes());
    end.extend_from_slice(&[0; 4]);
    end.push(op::FOOTER);
    end.extend_from_slice(&20_u64.to_le_bytes());
    end.extend_from_slice(&[0; 20]);
    end.extend_from_slice(mcap::MAGIC);
    end
}
