//! What the kinds that `palpate-train` works on share: what their requests refer to, and its arguments.

use std::{
    ffi::OsString,
    fs,
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use palpate_jobs::JobFolder;
use palpate_recording::files::{MAX_TEXT_BYTES, read_text};
use palpate_terminal::child::Listener;
use palpate_wire::api::{ArtifactSort, ExpertRequest, JobSpec, JobState, Resources};
use serde_json::Value;

use super::{JobKind, JobWork, LONG, names};
use crate::{Error, Store, assets, data::files, jobs::trainer::PROGRAM};

/// What a training learns.
pub(crate) const POLICY_FILE: &str = "policy.safetensors";
/// The script of a job: what a tuning found, or what an expert is learned on top of.
pub(crate) const SCRIPT_FILE: &str = "script.toml";
/// The encoder that a pretraining found.
pub(super) const ENCODER_FILE: &str = "encoder.safetensors";
/// Folder of a training: its checkpoint, configuration and metrics.
pub(super) const TRAINING_DIR: &str = "training";
/// Folder of demonstrations.
pub(super) const DEMONSTRATIONS_DIR: &str = "demonstrations";
/// Folder of an expert's trials.
pub(super) const TRIALS_DIR: &str = "trials";
/// Minutes to hours on every core.
const TRAINING: Resources = LONG;
/// Groups that a list of objects may name in place of objects.
const GROUPS: [&str; 3] = ["seen", "unseen", "all"];

/// Shipped policies that imitate an expert.
const IMITATIONS: &str = "policies/imitation";

/// The script where an object has none of its own.
const USUAL_SCRIPT: &str = "xarm6_leap_cube";

/// A kind that `palpate-train` works on.
pub(super) const fn training(
    name: &'static str,
    prefix: &'static str,
    makes: ArtifactSort,
    check: fn(&Store, &Value) -> Result<Vec<PathBuf>, Error>,
    work: fn(&JobWork<'_>, &Value) -> Result<(), Error>,
) -> JobKind {
    JobKind {
        name,
        prefix,
        resources: TRAINING,
        needs_trainer: true,
        makes: Some(makes),
        sharding: None,
        check,
        work,
    }
}

/// Arguments of `palpate-train`.
#[derive(Default)]
pub(super) struct Arguments(Vec<OsString>);

impl Arguments {
    pub(super) fn of(command: &str) -> Self {
        Self(vec![command.into()])
    }

    /// Says in the job's log what is run.
    pub(super) fn log(&self) {
        let shown: Vec<_> = self.0.iter().map(|arg| arg.to_string_lossy()).collect();
        println!("{PROGRAM} {}", shown.join(" "));
    }

    /// `--name value`.
    pub(super) fn with(mut self, name: &str, value: impl Into<OsString>) -> Self {
        self.0.extend([format!("--{name}").into(), value.into()]);
        self
    }

    /// `--name value`, if there is one.
    pub(super) fn maybe(self, name: &str, value: Option<impl ToString>) -> Self {
        match value {
            Some(value) => self.with(name, value.to_string()),
            None => self,
        }
    }

    /// `--name`, if it is wanted.
    pub(super) fn flag(mut self, name: &str, is_wanted: bool) -> Self {
        if is_wanted {
            self.0.push(format!("--{name}").into());
        }
        self
    }

    /// `--name path`, if there is one.
    pub(super) fn path(self, name: &str, path: Option<impl Into<OsString>>) -> Self {
        match path {
            Some(path) => self.with(name, path),
            None => self,
        }
    }
}

impl JobWork<'_> {
    /// Arguments of a `command` that learns in [`TRAINING_DIR`], by a preset or the text of a configuration, and goes on
    /// from its checkpoint; where there is none, curves begin again.
    pub(super) fn learning(
        &self,
        command: &str,
        preset: Option<String>,
        config: Option<&str>,
    ) -> Result<Arguments, Error> {
        let training = self.folder.file(TRAINING_DIR);
        if !training.join("checkpoint.safetensors").exists() {
            self.forget_metrics()?;
        }
        let config = self.configuration(config)?;
        Ok(Arguments::of(command)
            .maybe("preset", preset)
            .path("config", config)
            .with("seed", self.seed.to_string())
            .with("out", training)
            .flag("resume", true))
    }

    /// The text of a configuration as a file, if there is one.
    pub(super) fn configuration(&self, text: Option<&str>) -> Result<Option<PathBuf>, Error> {
        let Some(text) = text else { return Ok(None) };
        let path = self.folder.file("config.toml");
        files::write(&path, text.as_bytes())?;
        Ok(Some(path))
    }

    /// Runs `palpate-train` beside the shipped assets, and leaves its report.
    pub(super) fn train_and_report(&self, arguments: Arguments) -> Result<(), Error> {
        let report = self.train(arguments)?;
        self.save_report(&report)
    }

    /// Runs `palpate-train` beside the shipped assets; gives its report.
    pub(super) fn train(&self, arguments: Arguments) -> Result<Value, Error> {
        self.run_trainer(arguments)?.ok_or_else(|| {
            Error::Internal(
                "palpate-train ended without a report; is it of the same version as palpate?".to_owned(),
            )
        })
    }

    /// Runs it where no report is wanted.
    pub(super) fn run_trainer(&self, arguments: Arguments) -> Result<Option<Value>, Error> {
        arguments.log();
        self.run_trainer_in(&Workplace::make(self.folder)?, arguments)
    }

    /// Runs it beside assets that were added to.
    pub(super) fn run_trainer_in(
        &self,
        workplace: &Workplace,
        arguments: Arguments,
    ) -> Result<Option<Value>, Error> {
        let listener = Listener {
            progress: self.progress,
            metrics: &|point| (self.metrics)(&Value::Object(point.clone())),
            // The log may be on a full disk; the work goes on.
            log: &|line| drop(writeln!(io::stderr(), "{line}")),
            cancel: self.cancel,
        };
        self.trainer.run(&workplace.0, &arguments.0, &listener)
    }

    /// The text of a file that a request names.
    pub(super) fn text_of(&self, place: &Place) -> Result<String, Error> {
        match place {
            Place::Own(path) => Ok(read_text(path, MAX_TEXT_BYTES)?),
            Place::Shipped(path) => assets::text(path.trim_start_matches("assets/"))
                .map(str::to_owned)
                .ok_or_else(|| Error::Internal(format!("{path} is not shipped"))),
        }
    }

    /// Removes what an attempt that begins from the start left of its curves.
    pub(super) fn forget_metrics(&self) -> Result<(), Error> {
        let path = self.folder.file("metrics.jsonl");
        match fs::remove_file(&path) {
            Err(source) if source.kind() != io::ErrorKind::NotFound => {
                Err(Error::Io { action: "remove", path, source })
            }
            _ => Ok(()),
        }
    }
}

/// A folder that holds the shipped assets, as `palpate-train` looks for them. It goes when dropped.
pub(super) struct Workplace(PathBuf);

impl Workplace {
    /// In the folder of a job.
    pub(super) fn make(folder: &JobFolder) -> Result<Self, Error> {
        let path = folder.file("work");
        if path.exists() {
            // What an attempt that was killed left.
            fs::remove_dir_all(&path).map_err(Error::io("remove", &path))?;
        }
        let workplace = Self(path);
        assets::unpack_to(&workplace.0.join("assets"))?;
        Ok(workplace)
    }

    /// Where `assets` is.
    pub(super) fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Workplace {
    fn drop(&mut self) {
        // One that stays takes some megabytes until the job is deleted.
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// A policy that a request names.
pub(super) enum PolicyOf {
    /// It was trained with one object, on top of a script or without one.
    Expert { file: Place, object: String, script: Option<Place> },
    /// It imitates an expert, whatever the object.
    Imitation { file: Place },
}

/// Where something is.
pub(super) enum Place {
    /// A file of the data folder.
    Own(PathBuf),
    /// A shipped file, relative to the folder that palpate-train runs in.
    Shipped(String),
}

impl Place {
    /// As an argument.
    pub(super) fn argument(&self) -> OsString {
        match self {
            Self::Own(path) => path.into(),
            Self::Shipped(path) => path.into(),
        }
    }

    /// The file, if it is one that can change.
    pub(super) fn own(&self) -> Option<PathBuf> {
        match self {
            Self::Own(path) => Some(path.clone()),
            Self::Shipped(_) => None,
        }
    }
}

impl PolicyOf {
    /// The policy called `name`: a job of kind `expert`, `imitation` or `pipeline`, or a shipped one.
    pub(super) fn find(store: &Store, name: &str) -> Result<Self, Error> {
        files::check_id("policy", name)?;
        if let Some((folder, spec)) = job(store, name)? {
            let many = [names::IMITATION, names::PIPELINE].into_iter().find(|&kind| kind == spec.kind);
            if let Some(kind) = many {
                let file = outcome(&folder, &spec, name, kind, POLICY_FILE)?;
                return Ok(Self::Imitation { file: Place::Own(file) });
            }
            let file = outcome(&folder, &spec, name, names::EXPERT, POLICY_FILE)?;
            let request: ExpertRequest = super::parse(names::EXPERT, &spec.request)?;
            let script = (!request.without_script).then(|| Place::Own(folder.file(SCRIPT_FILE)));
            return Ok(Self::Expert { file: Place::Own(file), object: request.object, script });
        }
        let imitations = assets::names_in(IMITATIONS, ".safetensors");
        if imitations.contains(&name) {
            let file = Place::Shipped(format!("assets/{IMITATIONS}/{name}.safetensors"));
            return Ok(Self::Imitation { file });
        }
        let shipped = assets::names_in("policies", ".safetensors");
        if !shipped.contains(&name) {
            return Err(Error::Argument(format!(
                "no policy {name:?}: there is no such job of kind \"expert\", \"imitation\" or \"pipeline\", and shipped are {}",
                [shipped, imitations].concat().join(", ")
            )));
        }
        Ok(Self::Expert {
            file: Place::Shipped(format!("assets/policies/{name}.safetensors")),
            object: name.to_owned(),
            script: Some(script_for(store, None, name)?),
        })
    }

    /// The files of the data folder that it is made of.
    pub(super) fn own_files(&self, store: &Store) -> Vec<PathBuf> {
        match self {
            Self::Expert { file, object, script } => {
                let script = script.as_ref().and_then(Place::own);
                file.own().into_iter().chain(script).chain(object_file(store, object)).collect()
            }
            Self::Imitation { file } => file.own().into_iter().collect(),
        }
    }

    /// What tells palpate-train the task that it was trained for.
    pub(super) fn task(&self, arguments: Arguments, store: &Store) -> Arguments {
        match self {
            Self::Expert { file, object: id, script } => {
                let arguments = arguments.with("policy", file.argument()).with("object", object(store, id));
                match script {
                    Some(script) => arguments.with("script", script.argument()),
                    None => arguments.flag("without-script", true),
                }
            }
            Self::Imitation { file } => {
                let mut policy = OsString::from("clone:");
                policy.push(file.argument());
                arguments.with("policy", policy)
            }
        }
    }
}

/// The folder of job `id` and what it was asked, if there is such a job.
fn job(store: &Store, id: &str) -> Result<Option<(JobFolder, JobSpec)>, Error> {
    files::check_id("job", id)?;
    let folder = JobFolder::at(store.root().join("runs").join(id));
    if !folder.file("spec.json").is_file() {
        return Ok(None);
    }
    let spec = folder.spec()?;
    Ok(Some((folder, spec)))
}

/// File `name` of the job `id`, which must be of `kind` and done.
fn outcome(folder: &JobFolder, spec: &JobSpec, id: &str, kind: &str, name: &str) -> Result<PathBuf, Error> {
    if spec.kind != kind {
        return Err(Error::Argument(format!(
            "job {id:?} is of kind {:?}; give one of kind {:?}",
            spec.kind, kind
        )));
    }
    if folder.last_exit().is_none_or(|exit| exit.outcome != JobState::Done) {
        return Err(Error::Conflict(format!(
            "job {id:?} is not done; wait until it is, or give another one"
        )));
    }
    let path = folder.file(name);
    if !path.exists() {
        return Err(Error::Conflict(format!(
            "job {id:?} has no {name} any more; run it again, or give another one"
        )));
    }
    Ok(path)
}

/// The folder of the demonstrations of job `id`, and every file in it.
pub(super) fn demonstrations(store: &Store, id: &str) -> Result<(PathBuf, Vec<PathBuf>), Error> {
    folder_of(store, id, names::DEMONSTRATIONS, DEMONSTRATIONS_DIR)
}

/// The folder of the trials of job `id`, and every file in it.
pub(super) fn trials(store: &Store, id: &str) -> Result<(PathBuf, Vec<PathBuf>), Error> {
    folder_of(store, id, names::GATHERING, TRIALS_DIR)
}

/// The folder of job `id` and what it was asked; one of `kind` is expected.
fn named(store: &Store, id: &str, kind: &str) -> Result<(JobFolder, JobSpec), Error> {
    job(store, id)?.ok_or_else(|| {
        Error::Argument(format!(
            "no job {id:?}; give jobs of kind {kind:?}, which GET /api/v1/jobs?kind={kind} lists"
        ))
    })
}

/// The encoder of job `id`, which must be a pretraining that is done.
pub(super) fn encoder_file(store: &Store, id: &str) -> Result<PathBuf, Error> {
    let (folder, spec) = named(store, id, names::PRETRAINING)?;
    outcome(&folder, &spec, id, names::PRETRAINING, ENCODER_FILE)
}

/// What job `id` was asked.
pub(super) fn request_of(store: &Store, id: &str) -> Result<Value, Error> {
    Ok(named(store, id, names::GATHERING)?.1.request)
}

/// Folder `name` of job `id`, which must be of `kind` and done, and every file in it.
fn folder_of(store: &Store, id: &str, kind: &str, name: &str) -> Result<(PathBuf, Vec<PathBuf>), Error> {
    let (folder, spec) = named(store, id, kind)?;
    let dir = outcome(&folder, &spec, id, kind, name)?;
    let mut found = Vec::new();
    for entry in fs::read_dir(&dir).map_err(Error::io("read", &dir))? {
        let path = entry.map_err(Error::io("read", &dir))?.path();
        if path.is_file() {
            found.push(path);
        }
    }
    found.sort();
    Ok((dir, found))
}

/// Every file of the jobs `ids`, each of which `of` finds; refused where there are none.
pub(super) fn learned_from(
    field: &str,
    ids: &[String],
    of: impl Fn(&str) -> Result<(PathBuf, Vec<PathBuf>), Error>,
) -> Result<Vec<PathBuf>, Error> {
    if ids.is_empty() {
        return Err(Error::Argument(format!(
            "{field} is empty, so there is nothing to learn from; name jobs that made some"
        )));
    }
    let mut files = Vec::new();
    for (idx, id) in ids.iter().enumerate() {
        if ids[..idx].contains(id) {
            return Err(Error::Argument(format!("{field} names {id:?} twice")));
        }
        files.extend(of(id)?.1);
    }
    Ok(files)
}

/// The script called `name`, or the one for `object`.
pub(super) fn script_for(store: &Store, name: Option<&str>, object: &str) -> Result<Place, Error> {
    let shipped = assets::names_in("grasp/scripts", ".toml");
    let at = |name: &str| Place::Shipped(format!("assets/grasp/scripts/{name}.toml"));
    let Some(name) = name else {
        return Ok(at(if shipped.contains(&object) { object } else { USUAL_SCRIPT }));
    };
    if let Some((folder, spec)) = job(store, name)? {
        return Ok(Place::Own(outcome(&folder, &spec, name, names::TUNE, SCRIPT_FILE)?));
    }
    if !shipped.contains(&name) {
        return Err(Error::Argument(format!(
            "no script {name:?}: there is no such job of kind \"tune\", and shipped are {}",
            shipped.join(", ")
        )));
    }
    Ok(at(name))
}

/// The usual script.
pub(super) fn usual_script(store: &Store) -> Result<Place, Error> {
    script_for(store, Some(USUAL_SCRIPT), "")
}

/// Refuses an object that there is not; gives the files of one's own objects that are read.
pub(super) fn check_object(store: &Store, id: &str) -> Result<Option<PathBuf>, Error> {
    files::check_id("object", id)?;
    let own = object_file(store, id);
    let shipped = assets::names_in("objects", ".toml");
    if own.is_none() && !shipped.contains(&id) {
        return Err(Error::Argument(format!("no object {id:?}; shipped are {}", shipped.join(", "))));
    }
    Ok(own)
}

/// Refuses objects that there are not, and lists that palpate-train does not take; gives the files of one's own.
pub(super) fn check_objects(store: &Store, ids: &[String]) -> Result<Vec<PathBuf>, Error> {
    if let [group] = ids
        && GROUPS.contains(&group.as_str())
    {
        return Ok(Vec::new());
    }
    let mut own = Vec::new();
    for (idx, id) in ids.iter().enumerate() {
        if GROUPS.contains(&id.as_str()) {
            return Err(Error::Argument(format!(
                "objects: {id:?} is a group; name it alone, or objects by their ids"
            )));
        }
        if ids[..idx].contains(id) {
            return Err(Error::Argument(format!("objects names {id:?} twice")));
        }
        own.extend(check_object(store, id)?);
    }
    if let Some(path) = own.iter().find(|path| path.as_os_str().as_encoded_bytes().contains(&b',')) {
        return Err(Error::Argument(format!(
            "objects: the path {path:?} has a comma, which separates objects; move the data folder, or use shipped objects"
        )));
    }
    Ok(own)
}

/// Ids of the objects that a list names: groups are of shipped ones. A list without any means `group`.
pub(super) fn named_objects(ids: &[String], group: &str) -> Vec<String> {
    let group = match ids {
        [] => group,
        [one] if GROUPS.contains(&one.as_str()) => one,
        ids => return ids.to_vec(),
    };
    let is_in_group = |id: &&str| {
        let text = assets::text(&format!("objects/{id}.toml")).unwrap_or_default();
        let file: toml::Table = text.parse().unwrap_or_default();
        let of_object = file.get("group").and_then(toml::Value::as_str);
        of_object.is_some_and(|of_object| group == "all" || group == of_object)
    };
    assets::names_in("objects", ".toml").into_iter().filter(is_in_group).map(str::to_owned).collect()
}

/// Objects `ids` as palpate-train takes them.
pub(super) fn objects(store: &Store, ids: &[String]) -> OsString {
    let each: Vec<OsString> = ids.iter().map(|id| object(store, id)).collect();
    each.join(std::ffi::OsStr::new(","))
}

/// Refuses a protocol that is not shipped.
pub(super) fn check_protocol(name: &str) -> Result<(), Error> {
    let shipped = assets::names_in("grasp/protocols", ".toml");
    match shipped.contains(&name) {
        true => Ok(()),
        false => Err(Error::Argument(format!("no protocol {name:?}; shipped are {}", shipped.join(", ")))),
    }
}

/// The file of object `id`, if it is one's own.
fn object_file(store: &Store, id: &str) -> Option<PathBuf> {
    let path = store.root().join("objects").join(format!("{id}.toml"));
    path.is_file().then_some(path)
}

/// Object `id` as palpate-train takes it.
pub(super) fn object(store: &Store, id: &str) -> OsString {
    object_file(store, id).map_or_else(|| id.into(), Into::into)
}

/// The file of the saved model `id`, if one is wanted other than the station's own.
pub(super) fn model_file(store: &Store, id: Option<&str>) -> Result<Option<PathBuf>, Error> {
    match id {
        None | Some("nominal") => Ok(None),
        Some(id) => {
            store.model(id)?;
            store.model_file(id).map(Some)
        }
    }
}

/// Refuses numbers that make no sense before a job waits with them.
pub(super) fn check_counts(counts: &[(&str, Option<u64>)]) -> Result<(), Error> {
    match counts.iter().find(|(_, count)| *count == Some(0)) {
        Some((name, _)) => Err(Error::Argument(format!("{name} = 0; expected at least 1"))),
        None => Ok(()),
    }
}

/// Refuses places of starts that make no sense.
pub(super) fn check_start(start_cm: Option<f64>) -> Result<(), Error> {
    match start_cm {
        Some(start_cm) if !(start_cm.is_finite() && start_cm >= 0.0) => {
            Err(Error::Argument(format!("start_cm = {start_cm}; expected a number that is not negative")))
        }
        _ => Ok(()),
    }
}

/// Refuses a way to learn that there is not.
pub(super) fn check_preset(preset: Option<&str>, config: Option<&str>, known: &[&str]) -> Result<(), Error> {
    match (preset, config) {
        (Some(_), Some(_)) => {
            Err(Error::Argument("preset and config are two ways to learn; give one of them".to_owned()))
        }
        (Some(preset), _) if !known.contains(&preset) => {
            let known: Vec<String> = known.iter().map(|name| format!("{name:?}")).collect();
            Err(Error::Argument(format!("no preset {preset:?}; expected {}", known.join(" or "))))
        }
        (_, Some(config)) => match config.parse::<toml::Table>() {
            Ok(_) => Ok(()),
            Err(err) => Err(Error::Content(format!("config: {}", err.to_string().trim().replace('\n', " ")))),
        },
        _ => Ok(()),
    }
}
