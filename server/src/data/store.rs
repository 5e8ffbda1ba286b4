//! The data folder: sessions, models, runs, and a trash from which they come back.

use std::{
    fs::{self, File, TryLockError},
    io::Write as _,
    path::{Path, PathBuf},
    sync::Mutex,
};

use palpate_calibration::stream_theta_report;
use palpate_jobs::rfc3339;
use palpate_recording::{
    GrowingSession, RecordingError, Session, SessionHold,
    files::{MAX_TEXT_BYTES, open_file, read_file, read_text, resolve_in},
};
use palpate_reports::{ModelEffect, ThetaReport};
use palpate_sim::{SensorModel, StreamTheta};
use palpate_wire::api::{ModelSummary, TrashEntry, TrashSort};

use super::{cache::lock, files, upload};
use crate::Error;

/// Locked by the studio that has the folder open; it holds the number of its process.
const LOCK_FILE: &str = "studio.lock";
/// Largest file of a run that is read, bytes: a report of a long session has some megabytes.
const MAX_RUN_BYTES: u64 = 256 << 20;

/// Plain files below one folder, which one studio at a time has open.
#[derive(Debug)]
pub struct Store {
    root: PathBuf,
    /// Held while a name is looked for and taken.
    naming: Mutex<()>,
    uploads: upload::Slots,
    /// Unlocked by the operating system, however this process ends. `None` where the file system knows no locks.
    _lock: Option<File>,
}

/// A document of a run as it was before there was a database.
pub(crate) struct RunFile {
    /// Id by its name.
    pub(crate) id: String,
    /// Where it is.
    pub(crate) path: PathBuf,
    /// What it holds.
    pub(crate) text: Result<String, Error>,
}

/// What the trash keeps apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Session,
    Model,
}

impl Kind {
    fn folder(self) -> &'static str {
        match self {
            Self::Session => "sessions",
            Self::Model => "models",
        }
    }

    fn what(self) -> &'static str {
        match self {
            Self::Session => "session",
            Self::Model => "model",
        }
    }

    fn file_name(self, id: &str) -> String {
        match self {
            Self::Session => id.to_owned(),
            Self::Model => format!("{id}.toml"),
        }
    }
}

impl Store {
    /// Opens `root`, making what is missing and removing what a killed studio left of uploads. Refused while another studio
    /// has it open: both would give the same names to different runs and models.
    pub fn open(root: &Path) -> Result<Self, Error> {
        fs::create_dir_all(root).map_err(Error::io("make", root))?;
        let lock = lock_folder(root)?;
        upload::remove_leftovers(root)?;
        for folder in ["sessions", "models", "objects", "runs", "trash/sessions", "trash/models"] {
            let path = root.join(folder);
            fs::create_dir_all(&path).map_err(Error::io("make", &path))?;
        }
        Ok(Self {
            root: root.to_owned(),
            naming: Mutex::default(),
            uploads: upload::Slots::default(),
            _lock: lock,
        })
    }

    /// The folder `root` for a job's own process, beside the studio that has it open: it reads, and makes what did not
    /// exist.
    pub(crate) fn of_job(root: &Path) -> Self {
        Self {
            root: root.to_owned(),
            naming: Mutex::default(),
            uploads: upload::Slots::default(),
            _lock: None,
        }
    }

    /// The data folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Places for uploads that are under way.
    pub(crate) fn uploads(&self) -> &upload::Slots {
        &self.uploads
    }

    /// `err` for a client, who knows sessions and files by their names and not by the folders of this computer.
    pub(crate) fn for_client(&self, err: Error) -> Error {
        upload::as_client_knows(err, &[&self.sessions_dir(), &self.root])
    }

    /// Where sessions are recorded to.
    pub(crate) fn sessions_dir(&self) -> PathBuf {
        self.root.join("sessions")
    }

    /// Remembers a latched stop of the live station over a restart.
    pub(crate) fn latch_path(&self) -> PathBuf {
        self.root.join("stop.txt")
    }

    /// The log of who moved or stopped the live station, and who changed what.
    pub(crate) fn audit_path(&self) -> PathBuf {
        self.root.join("audit.jsonl")
    }

    /// The takes that the live station's operator wants and that wait for a session.
    pub(crate) fn wanted_path(&self) -> PathBuf {
        self.root.join("wanted.json")
    }

    /// Ids of all sessions. What is neither a folder nor a plain file is among them, so that opening it says why not.
    pub(crate) fn sessions(&self) -> Result<Vec<String>, Error> {
        let entries = self.entries("sessions")?.into_iter();
        let is_listed = |path: &Path| path.symlink_metadata().is_ok_and(|meta| !meta.is_file());
        Ok(entries.filter(|(_, path)| is_listed(path)).map(|(id, _)| id).collect())
    }

    /// `(file name, path)` of every object file of one's own, by name. Reading it says whether it is one.
    pub(crate) fn object_files(&self) -> Result<Vec<(String, PathBuf)>, Error> {
        let entries = self.entries("objects")?;
        Ok(entries.into_iter().filter(|(name, path)| name.ends_with(".toml") && !path.is_dir()).collect())
    }

    /// The session called `id`.
    pub(crate) fn session(&self, id: &str) -> Result<Session, Error> {
        let dir = self.existing(Kind::Session, id)?;
        Ok(Session::open(&dir)?)
    }

    /// Puts the folder `dir`, which must be on the same file system, in place as session `id`.
    pub(crate) fn adopt_session(&self, id: &str, dir: &Path) -> Result<Session, Error> {
        let _naming = lock(&self.naming);
        let target = self.free_session_dir(id)?;
        fs::rename(dir, &target).map_err(Error::io("make", &target))?;
        Ok(Session::open(&target)?)
    }

    /// Where session `id` would lie; refused if there is one.
    pub(crate) fn free_session_dir(&self, id: &str) -> Result<PathBuf, Error> {
        files::check_id("session", id)?;
        let target = self.path(Kind::Session, id);
        // Also true of a link that leads nowhere, unlike `exists`.
        if target.symlink_metadata().is_ok() {
            return Err(Error::Exists(format!("there is a session {id:?} already; choose another name")));
        }
        Ok(target)
    }

    /// Every model that can be read, by id.
    pub(crate) fn models(&self) -> Result<Vec<ModelSummary>, Error> {
        let mut models = Vec::new();
        for (file_name, path) in self.entries("models")? {
            let Some(id) = file_name.strip_suffix(".toml") else { continue };
            match self.model_summary(id) {
                Ok(summary) => models.push(summary),
                Err(err) => {
                    tracing::warn!(path = %path.display(), err = crate::chain(&err), "left out a model");
                }
            }
        }
        Ok(models)
    }

    /// The model called `id`, and its text.
    pub(crate) fn model(&self, id: &str) -> Result<(SensorModel, String), Error> {
        let path = self.existing(Kind::Model, id)?;
        let text = read_text(&path, MAX_TEXT_BYTES)?;
        let model = SensorModel::from_toml(&path.display().to_string(), &text)?;
        Ok((model, text))
    }

    /// Saves `model` under an id made from its name; an older model of that name stays.
    pub(crate) fn save_model(&self, model: &SensorModel) -> Result<ModelSummary, Error> {
        let slug = files::slug(&model.name)?;
        let _naming = lock(&self.naming);
        let numbered = (2..).map(|number| format!("{slug}-{number}"));
        let id = std::iter::once(slug.clone())
            .chain(numbered)
            // "nominal" always means the station's own.
            // Earlier versions of one that was deleted are not those of another.
            .find(|id| {
                id != "nominal" && !self.path(Kind::Model, id).exists() && !self.earlier_dir(id).exists()
            })
            .unwrap_or(slug);
        files::write(&self.path(Kind::Model, &id), model.to_toml().as_bytes())?;
        self.model_summary(&id)
    }

    /// Puts `model` in place of the one called `id`, whose file is kept as an earlier version. `by` names the run whose
    /// doing it is.
    pub(crate) fn replace_model(
        &self,
        id: &str,
        model: &SensorModel,
        by: &str,
    ) -> Result<ModelSummary, Error> {
        files::check_id("run", by)?;
        let path = self.existing(Kind::Model, id)?;
        {
            let _naming = lock(&self.naming);
            let text = read_file(&path, MAX_TEXT_BYTES)?;
            let dir = self.earlier_dir(id);
            fs::create_dir_all(&dir).map_err(Error::io("make", &dir))?;
            let number = self.earlier_versions(id)?.len() + 1;
            files::write(&dir.join(format!("{number:04}-{by}.toml")), &text)?;
            files::write(&path, model.to_toml().as_bytes())?;
        }
        self.model_summary(id)
    }

    /// Puts the newest earlier version of model `id` back, byte for byte, and says by whose doing it had been replaced.
    pub(crate) fn undo_model(&self, id: &str) -> Result<(ModelSummary, String), Error> {
        let path = self.existing(Kind::Model, id)?;
        let by = {
            let _naming = lock(&self.naming);
            let Some(newest) = self.earlier_versions(id)?.pop() else {
                return Err(Error::Conflict(format!(
                    "model {id:?} has no earlier version to go back to; delete it if it should go"
                )));
            };
            fs::rename(&newest, &path).map_err(Error::io("move", &newest))?;
            let name = newest.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            name.split_once('-').map_or(String::new(), |(_, by)| by.to_owned())
        };
        Ok((self.model_summary(id)?, by))
    }

    /// The entry of model `id` in the list of models.
    pub(crate) fn model_summary(&self, id: &str) -> Result<ModelSummary, Error> {
        let (model, _) = self.model(id)?;
        let own = |(id, theta): (&String, &StreamTheta)| (id.clone(), stream_theta_report(theta));
        let streams = model.streams.iter().map(own).collect();
        let effects = model.effects.into_iter().map(|effect| ModelEffect {
            id: effect.id,
            place: effect.place,
            parameters: effect.parameters,
        });
        Ok(ModelSummary {
            id: id.to_owned(),
            name: model.name,
            theta: ThetaReport {
                lambda_con_m: model.theta.lambda_con_m,
                alpha_per_m: model.theta.alpha_per_m,
                lambda_pre_pa: model.theta.lambda_pre_pa,
            },
            streams,
            provenance: model.provenance,
            effects: effects.collect(),
            earlier_versions: self.earlier_versions(id)?.len(),
        })
    }

    fn earlier_dir(&self, id: &str) -> PathBuf {
        self.root.join("models/.earlier").join(id)
    }

    /// Files of the earlier versions of model `id`, oldest first.
    fn earlier_versions(&self, id: &str) -> Result<Vec<PathBuf>, Error> {
        let dir = self.earlier_dir(id);
        let entries = match fs::read_dir(&dir) {
            Ok(entries) => entries,
            Err(err) if err.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(source) => return Err(Error::Io { action: "read", path: dir, source }),
        };
        let mut versions = Vec::new();
        for entry in entries {
            let path = entry.map_err(Error::io("read", &dir))?.path();
            if path.extension().is_some_and(|extension| extension == "toml") {
                versions.push(path);
            }
        }
        versions.sort();
        Ok(versions)
    }

    /// Moves an entry to the trash; refused for a session that is being recorded, by whatever process.
    pub(crate) fn discard(&self, kind: Kind, id: &str) -> Result<(), Error> {
        let path = self.named(kind, id)?;
        let _naming = lock(&self.naming);
        let _held = hold(kind, id, &path, "delete it")?;
        let target = self.trash_path(kind, id);
        if target.symlink_metadata().is_ok() {
            // An older one of that name steps aside and can be brought back by hand.
            let aside = (2..)
                .map(|number| target.with_file_name(format!(".{number}-{}", kind.file_name(id))))
                .find(|aside| aside.symlink_metadata().is_err())
                .unwrap_or_else(|| target.clone());
            fs::rename(&target, &aside).map_err(Error::io("move", &target))?;
        }
        fs::rename(&path, &target).map_err(Error::io("move", &path))
    }

    /// What [`Self::restore`] brings back, the one that was deleted last first. One that stepped aside for a later one of
    /// its name is not among them.
    pub(crate) fn trash(&self) -> Result<Vec<TrashEntry>, Error> {
        let mut found = Vec::new();
        for (sort, kind) in [(TrashSort::Session, Kind::Session), (TrashSort::Model, Kind::Model)] {
            for (name, path) in self.entries(&format!("trash/{}", kind.folder()))? {
                let id = match kind {
                    Kind::Session => Some(name.as_str()),
                    Kind::Model => name.strip_suffix(".toml"),
                };
                let Some(id) = id.filter(|id| files::check_id(kind.what(), id).is_ok()) else { continue };
                // It may be restored or emptied meanwhile.
                let Ok(deleted) = files::moved_at(&path) else { continue };
                found.push((deleted, TrashEntry { sort, id: id.to_owned(), deleted: rfc3339(deleted) }));
            }
        }
        found.sort_by_key(|(deleted, _)| std::cmp::Reverse(*deleted));
        Ok(found.into_iter().map(|(_, entry)| entry).collect())
    }

    /// Brings an entry back from the trash.
    pub(crate) fn restore(&self, kind: Kind, id: &str) -> Result<(), Error> {
        files::check_id(kind.what(), id)?;
        let _naming = lock(&self.naming);
        let (path, target) = (self.trash_path(kind, id), self.path(kind, id));
        if path.symlink_metadata().is_err() {
            return Err(Error::NotFound {
                what: kind.what(),
                id: id.to_owned(),
                hint: "it is not in the trash",
            });
        }
        if target.symlink_metadata().is_ok() {
            hold(kind, id, &target, "restore the other one under another name")?;
            let what = kind.what();
            return Err(Error::Exists(format!(
                "there is another {what} {id:?} now; rename or delete that one first"
            )));
        }
        fs::rename(&path, &target).map_err(Error::io("move", &path))
    }

    /// Documents of runs, `runs/ID.json`, by name, with their text or why it cannot be read.
    pub(crate) fn run_documents(&self) -> Result<Vec<RunFile>, Error> {
        let entries = self.entries("runs")?.into_iter();
        let documents = entries.filter_map(|(name, path)| {
            let id = name.strip_suffix(".json")?.to_owned();
            let text = self.own_text("runs", &path, MAX_RUN_BYTES);
            Some(RunFile { id, path, text })
        });
        Ok(documents.collect())
    }

    /// `(id, path)` of every folder in `runs/`, by name.
    pub(crate) fn run_folders(&self) -> Result<Vec<(String, PathBuf)>, Error> {
        let entries = self.entries("runs")?.into_iter();
        let is_folder = |path: &Path| path.symlink_metadata().is_ok_and(|meta| meta.is_dir());
        Ok(entries.filter(|(_, path)| is_folder(path)).collect())
    }

    /// The file of model `id`.
    pub(crate) fn model_file(&self, id: &str) -> Result<PathBuf, Error> {
        self.existing(Kind::Model, id)
    }

    /// The text of the file at `path`, which must lie in `folder`.
    fn own_text(&self, folder: &str, path: &Path, max_bytes: u64) -> Result<String, Error> {
        resolve_in(&self.root.join(folder), path)?;
        Ok(read_text(path, max_bytes)?)
    }

    fn path(&self, kind: Kind, id: &str) -> PathBuf {
        self.root.join(kind.folder()).join(kind.file_name(id))
    }

    fn trash_path(&self, kind: Kind, id: &str) -> PathBuf {
        self.root.join("trash").join(kind.folder()).join(kind.file_name(id))
    }

    /// The entry called `id`, which may be opened.
    fn existing(&self, kind: Kind, id: &str) -> Result<PathBuf, Error> {
        let path = self.named(kind, id)?;
        resolve_in(&self.root.join(kind.folder()), &path)?;
        Ok(path)
    }

    /// The entry called `id`. It may be a link that leads elsewhere.
    fn named(&self, kind: Kind, id: &str) -> Result<PathBuf, Error> {
        files::check_id(kind.what(), id)?;
        let path = self.path(kind, id);
        if path.symlink_metadata().is_err() {
            let hint = match kind {
                Kind::Session => "GET /api/v1/sessions lists them",
                Kind::Model => "GET /api/v1/models lists them; \"nominal\" is the station's own",
            };
            return Err(Error::NotFound { what: kind.what(), id: id.to_owned(), hint });
        }
        Ok(path)
    }

    /// `(name, path)` of what lies in `folder`, by name; hidden entries are work in progress.
    fn entries(&self, folder: &str) -> Result<Vec<(String, PathBuf)>, Error> {
        let dir = self.root.join(folder);
        let mut entries = Vec::new();
        for entry in fs::read_dir(&dir).map_err(Error::io("read", &dir))? {
            let entry = entry.map_err(Error::io("read", &dir))?;
            let name = entry.file_name().to_string_lossy().into_owned();
            if !name.starts_with('.') {
                entries.push((name, entry.path()));
            }
        }
        entries.sort();
        Ok(entries)
    }
}

/// Locks the data folder for this process.
fn lock_folder(root: &Path) -> Result<Option<File>, Error> {
    let path = root.join(LOCK_FILE);
    if path.symlink_metadata().is_ok() {
        // Opening a named pipe for writing would wait for its reader.
        open_file(&path)?;
    }
    let mut file = File::options()
        .create(true)
        .truncate(false)
        .write(true)
        .open(&path)
        .map_err(Error::io("make", &path))?;
    match file.try_lock() {
        Ok(()) => {
            file.set_len(0)
                .and_then(|()| writeln!(file, "{}", std::process::id()))
                .map_err(Error::io("write", &path))?;
            Ok(Some(file))
        }
        Err(TryLockError::WouldBlock) => {
            let holder = read_text(&path, 100).unwrap_or_default();
            let holder = match holder.trim() {
                "" => "another process".to_owned(),
                pid => format!("process {pid}"),
            };
            Err(Error::Conflict(format!(
                "the data folder {root:?} is in use by a studio already ({holder}); use that one, end it first, or start \
                 this one with another folder (--data)"
            )))
        }
        Err(TryLockError::Error(err)) => {
            tracing::warn!(path = %path.display(), %err, "no lock: start no second studio on this data folder");
            Ok(None)
        }
    }
}

/// Keeps a session from being recorded while it is moved; refused while it is. `then` is what may be done once it is left.
fn hold(kind: Kind, id: &str, path: &Path, then: &str) -> Result<Option<SessionHold>, Error> {
    if kind != Kind::Session {
        return Ok(None);
    }
    match GrowingSession::hold(path) {
        Ok(hold) => Ok(Some(hold)),
        Err(RecordingError::Content { place, .. }) if place == "session" => Err(Error::Conflict(format!(
            "session {id:?} is being recorded; leave it on the Record screen, or end the process that records it, then \
             {then}"
        ))),
        // What cannot be locked cannot be recorded into either.
        Err(_) => Ok(None),
    }
}
