//! A session: a folder of takes with a `session.toml`.

use std::{
    fs,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};

use crate::{
    RecordingError, Take,
    files::{self, MAX_TAKE_BYTES, MAX_TEXT_BYTES, replace_file, sibling},
};

const SESSION_FILE: &str = "session.toml";
/// Beside `session.toml` while a session is recorded step by step, and afterwards: see
/// [`RecordingFile`](crate::RecordingFile).
pub(crate) const RECORDING_FILE: &str = "recording.toml";
const SESSION_FORMAT: u32 = 1;

/// `session.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SessionFile {
    /// Version of the format; 1.
    pub format: u32,
    /// Station id.
    pub station: String,
    /// When it was recorded, RFC 3339; empty if unknown.
    #[serde(default)]
    pub recorded: String,
    /// Takes, in order.
    #[serde(rename = "take", default)]
    pub takes: Vec<SessionTake>,
}

/// One take in `session.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SessionTake {
    /// File name in the session's folder, e.g. `take-01.mcap`.
    pub file: String,
    /// Object id.
    pub object: String,
    /// Whether the operator accepted it.
    pub accepted: bool,
}

impl SessionTake {
    /// Id of the take: the file's stem.
    pub fn id(&self) -> &str {
        self.file.strip_suffix(".mcap").unwrap_or(&self.file)
    }
}

/// An opened session.
#[derive(Clone, Debug)]
pub struct Session {
    /// Its folder.
    pub dir: PathBuf,
    /// Id: the folder's name.
    pub id: String,
    /// `session.toml`.
    pub file: SessionFile,
}

impl Session {
    /// Reads `session.toml` in `dir`. A session without takes is refused, unless it is being recorded: a
    /// `recording.toml` lies beside it. So is a `session.toml` that is no regular file or lies elsewhere.
    pub fn open(dir: &Path) -> Result<Self, RecordingError> {
        let path = dir.join(SESSION_FILE);
        files::resolve_in(dir, &path)?;
        let text = files::read_text(&path, MAX_TEXT_BYTES)?;
        let file: SessionFile = toml::from_str(&text).map_err(RecordingError::toml(&path, &text))?;
        check_file(&path, &file)?;
        Ok(Self { dir: dir.to_owned(), id: folder_name(dir), file })
    }

    /// Reads one take by index; checks that its station and streams are the session's.
    pub fn take(&self, take_idx: usize) -> Result<Take, RecordingError> {
        let Some(entry) = self.file.takes.get(take_idx) else {
            let problem = format!("there is no take {take_idx}, only {}", self.file.takes.len());
            return Err(RecordingError::content(self.dir.join(SESSION_FILE), "takes", problem));
        };
        let take = Take::from_bytes(&self.take_path(entry), &self.take_bytes(entry)?)?;
        self.check_belongs(entry, &take)?;
        Ok(take)
    }

    /// The bytes of a take; refused where the file is not regular, or is a link that leads out of the session's folder.
    pub(crate) fn take_bytes(&self, entry: &SessionTake) -> Result<Vec<u8>, RecordingError> {
        let path = self.take_path(entry);
        files::resolve_in(&self.dir, &path)?;
        files::read_file(&path, MAX_TAKE_BYTES)
    }

    /// Reads every accepted take, in order; checks that they share one station, so that they can be compared.
    pub fn accepted_takes(&self) -> Result<Vec<Take>, RecordingError> {
        let mut takes: Vec<Take> = Vec::new();
        for (take_idx, entry) in self.file.takes.iter().enumerate().filter(|(_, entry)| entry.accepted) {
            let take = self.take(take_idx)?;
            if let Some(difference) = takes.first().and_then(|first| station_difference(first, &take)) {
                return Err(RecordingError::content(self.take_path(entry), "attached station", difference));
            }
            takes.push(take);
        }
        if takes.is_empty() {
            return Err(RecordingError::content(
                self.dir.join(SESSION_FILE),
                "take",
                "no take is accepted; accept good ones, or set `accepted = true` for them",
            ));
        }
        Ok(takes)
    }

    /// Writes `session.toml` of a new session (atomically: temporary file, then rename).
    ///
    /// Makes the folder if there is none; a session that is there already is refused. To have takes and `session.toml`
    /// appear at once, use a [`SessionDraft`].
    pub fn create(dir: &Path, file: SessionFile) -> Result<Self, RecordingError> {
        let path = dir.join(SESSION_FILE);
        check_file(&path, &file)?;
        if path.exists() {
            return Err(RecordingError::content(path, "file", "is there already; choose another folder"));
        }
        fs::create_dir_all(dir).map_err(RecordingError::io("make", dir))?;
        let session = Self { dir: dir.to_owned(), id: folder_name(dir), file };
        session.save()?;
        Ok(session)
    }

    /// Replaces `session.toml` by [`Session::file`], atomically.
    pub fn save(&self) -> Result<(), RecordingError> {
        let path = self.dir.join(SESSION_FILE);
        check_file(&path, &self.file)?;
        let text = toml::to_string(&self.file)
            .map_err(|error| RecordingError::content(&path, "file", error.to_string()))?;
        replace_file(&path, &text)
    }

    /// Where a take of this session lies.
    pub fn take_path(&self, entry: &SessionTake) -> PathBuf {
        self.dir.join(&entry.file)
    }

    pub(crate) fn check_belongs(&self, entry: &SessionTake, take: &Take) -> Result<(), RecordingError> {
        let wrong = |place: &str, found: &str, expected: &str| {
            let problem = format!(
                "{found:?}, but {SESSION_FILE} says {expected:?}; the take belongs to another session, or \
                 {SESSION_FILE} was edited"
            );
            Err(RecordingError::content(self.take_path(entry), place, problem))
        };
        if take.station.id != self.file.station {
            return wrong("attached station", &take.station.id, &self.file.station);
        }
        if take.meta.object != entry.object {
            return wrong("object", &take.meta.object, &entry.object);
        }
        Ok(())
    }
}

/// In what the attached stations of two takes differ so that the takes cannot be compared.
pub(crate) fn station_difference(first: &Take, other: &Take) -> Option<String> {
    let channel_ids = |take: &Take| -> Vec<(String, String)> {
        let layout = &take.station.layout;
        let stream_id = |stream: usize| layout.streams[stream].id.clone();
        layout.channels.iter().map(|channel| (stream_id(channel.stream), channel.id.clone())).collect()
    };
    let (expected, found) = (channel_ids(first), channel_ids(other));
    if expected.len() != found.len() {
        return Some(format!("{} channels, take {:?} has {}", found.len(), first.id, expected.len()));
    }
    if let Some(channel) = (0..found.len()).find(|&channel| found[channel] != expected[channel]) {
        return Some(format!(
            "channel {channel} is {:?} of stream {:?}, in take {:?} it is {:?} of {:?}",
            found[channel].1, found[channel].0, first.id, expected[channel].1, expected[channel].0
        ));
    }
    if first.station.robot.num_dofs() != other.station.robot.num_dofs() {
        return Some(format!(
            "{} joints, take {:?} has {}",
            other.station.robot.num_dofs(),
            first.id,
            first.station.robot.num_dofs()
        ));
    }
    None
}

/// A session in the making: a hidden folder beside the final one, which [`SessionDraft::commit`] renames. Dropped
/// without, it takes what was written with it.
#[derive(Debug)]
pub struct SessionDraft {
    partial_dir: PathBuf,
    dir: PathBuf,
    committed: bool,
}

impl SessionDraft {
    /// Starts a session that will lie at `dir`, which must not exist yet.
    pub fn new(dir: &Path) -> Result<Self, RecordingError> {
        refuse_existing(dir)?;
        let partial_dir = sibling(dir);
        if let Some(parent) = partial_dir.parent() {
            fs::create_dir_all(parent).map_err(RecordingError::io("make", parent))?;
        }
        fs::create_dir(&partial_dir).map_err(RecordingError::io("make", &partial_dir))?;
        Ok(Self { partial_dir, dir: dir.to_owned(), committed: false })
    }

    /// Where to write takes until [`SessionDraft::commit`].
    pub fn partial_dir(&self) -> &Path {
        &self.partial_dir
    }

    /// Adds `session.toml` and puts the folder in its place.
    pub fn commit(mut self, file: SessionFile) -> Result<Session, RecordingError> {
        let draft = Session::create(&self.partial_dir, file)?;
        refuse_existing(&self.dir)?;
        fs::rename(&self.partial_dir, &self.dir).map_err(RecordingError::io("make", &self.dir))?;
        self.committed = true;
        Ok(Session { dir: self.dir.clone(), id: folder_name(&self.dir), file: draft.file })
    }
}

impl Drop for SessionDraft {
    fn drop(&mut self) {
        if !self.committed {
            // Nobody is left to tell, and a hidden leftover harms nothing.
            let _ = fs::remove_dir_all(&self.partial_dir);
        }
    }
}

/// Refuses a folder that is there already.
pub(crate) fn refuse_existing(dir: &Path) -> Result<(), RecordingError> {
    // Also true of a dangling link, unlike `exists`.
    if dir.symlink_metadata().is_ok() {
        return Err(RecordingError::content(
            dir,
            "session",
            "is there already; choose another folder or remove it",
        ));
    }
    if dir.file_name().is_none() {
        return Err(RecordingError::content(dir, "session", "names no folder; give the folder to be made"));
    }
    Ok(())
}

pub(crate) fn check_file(path: &Path, file: &SessionFile) -> Result<(), RecordingError> {
    if file.format != SESSION_FORMAT {
        let problem =
            format!("{}, expected {SESSION_FORMAT}; read it with the palpate that wrote it", file.format);
        return Err(RecordingError::content(path, "format", problem));
    }
    let growing = path.with_file_name(RECORDING_FILE).is_file();
    if file.takes.is_empty() && !growing {
        let problem = "the session has no takes; record or import at least one";
        return Err(RecordingError::content(path, "take", problem));
    }
    for (take_idx, entry) in file.takes.iter().enumerate() {
        let place = format!("take {}", take_idx + 1);
        // A session stays within its folder, whoever wrote the file.
        if Path::new(&entry.file).file_name().is_none_or(|name| name != entry.file.as_str()) {
            let problem = format!("file {:?} must be the name of a file in the session's folder", entry.file);
            return Err(RecordingError::content(path, place, problem));
        }
        if file.takes[..take_idx].iter().any(|other| other.id() == entry.id()) {
            return Err(RecordingError::content(path, place, format!("{:?} is listed twice", entry.file)));
        }
    }
    Ok(())
}

pub(crate) fn folder_name(dir: &Path) -> String {
    // `sessions/demo/..` and `.` have no name of their own.
    let resolved = if dir.file_name().is_none() { dir.canonicalize().ok() } else { None };
    let named = resolved.as_deref().unwrap_or(dir);
    named.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}
