//! A LeRobotDataset v3.0: tables in Parquet, their descriptions in JSON.
//!
//! | feature | what |
//! |---|---|
//! | `observation.state` | measured joint positions, rad or m |
//! | `action` | see [`Action`] |
//! | `observation.tactile.raw` | readings, each in the unit of its stream; only of streams that gave any |
//! | `observation.tactile.active` | activations, all channels |
//! | `observation.environment_state` | where the object is: x, y, z in m, then qw, qx, qy, qz, in the base frame; only where some recording has one that moves |
//!
//! `timestamp`, `frame_index`, `episode_index`, `index` and `task_index` are those that every such data set has. The table of
//! episodes says beside what LeRobot reads which file an episode is a copy of, and where that is known whether it was a
//! success (`success`) and how it failed (`failure_mode`). `meta/palpate.json` and `README.md` say what was sampled how.

mod frames;
mod metadata;

use std::path::{Path, PathBuf};

use palpate_sim::job::{Cancel, Progress};
use serde::Serialize;

use crate::{
    ExportError,
    columns::{Column, Table, Values, write_table},
    draft::Draft,
    source::{Episode, LeftOut, Setup, Source},
    statistics::Statistics,
};
use frames::{Frames, Shape};
use metadata::{Described, EpisodeNote};

/// Highest rate that is written, frames per second.
pub const MAX_FPS: u32 = 1000;
/// Another file of frames begins after this many bytes, as LeRobot's own recorder does it.
const MAX_FILE_BYTES: usize = 100 << 20;
/// Files in a folder.
const FILES_PER_CHUNK: usize = 1000;

/// How to export.
#[derive(Clone, Copy, Debug, Default)]
pub struct LerobotConfig {
    /// Frames per second; default: the nominal rate of the joint log, or of the policy's steps.
    pub fps: Option<u32>,
    /// What is written as action; default: commands where every recording has some, else none.
    pub action: Option<Action>,
}

/// What is written as `action`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// What joints were told last; before the first command where they were.
    Commands,
    /// Where joints are one frame later; in the last frame where they are. For recordings without commands, such as motions
    /// that a person led.
    NextState,
    /// No action: such a data set can be looked at, and not trained from.
    None,
}

/// What was exported.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LerobotReport {
    /// The data set's folder.
    pub out: PathBuf,
    /// Frames per second.
    pub fps: u32,
    /// Number of episodes.
    pub episodes: usize,
    /// Number of frames.
    pub frames: usize,
    /// Texts of the tasks, by index.
    pub tasks: Vec<String>,
    /// Features beside those that every data set has.
    pub features: Vec<FeatureSize>,
    /// What is written as action.
    pub action: Action,
    /// Episodes that are known to have been a success.
    pub successes: usize,
    /// Episodes that are known to have failed.
    pub failures: usize,
    /// Recordings that are no episodes.
    pub left_out: Vec<LeftOut>,
}

/// A feature of a data set.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FeatureSize {
    /// Its name, e.g. `observation.state`.
    pub name: String,
    /// How many numbers it has a frame.
    pub size: usize,
}

/// Writes the takes and trials of `sources` to the folder `out`, which must not exist yet; it appears whole or not at all.
///
/// # Errors
/// No source, a source that cannot be read, sources that do not fit together (other joints or channels, readings of another
/// kind), a recording whose logs do not overlap in time, something that is at `out` already, a disk that takes no more.
pub fn export(
    sources: &[PathBuf],
    out: &Path,
    config: LerobotConfig,
    progress: &impl Progress,
    cancel: &Cancel,
) -> Result<LerobotReport, ExportError> {
    if let Some(fps) = config.fps.filter(|fps| !(1..=MAX_FPS).contains(fps)) {
        return Err(ExportError::Argument(format!("{fps} frames per second; expected 1 to {MAX_FPS}")));
    }
    check_distinct(sources)?;
    let draft = Draft::new(out)?;
    let opened = sources.iter().map(|dir| Source::open(dir)).collect::<Result<Vec<_>, _>>()?;
    let mut left_out = Vec::new();
    let mut waiting = Vec::new();
    for source in &opened {
        waiting.extend(source.recordings(&mut left_out)?);
    }

    // Whether all have commands and readings is known once all were read; they are read again rather than kept.
    let mut survey = Survey::default();
    let num_waiting = waiting.len().max(1) as f64;
    for (idx, recording) in waiting.iter().enumerate() {
        progress.report(0.4 * idx as f64 / num_waiting, "reading");
        stop_if(cancel)?;
        match recording.read()? {
            Ok(episode) => survey.add(&recording.path, &episode)?,
            Err(unusable) => left_out.push(unusable),
        }
    }
    let shape = survey.shape(config, sources)?;

    let mut writer = Writer::new(&draft, shape);
    for (idx, recording) in waiting.iter().enumerate() {
        progress.report(0.4 + 0.5 * idx as f64 / num_waiting, "writing frames");
        stop_if(cancel)?;
        if let Ok(episode) = recording.read()? {
            writer.add(&recording.path, episode)?;
        }
    }
    progress.report(0.9, "statistics");
    stop_if(cancel)?;
    let report = writer.finish(out, left_out)?;
    draft.commit()?;
    progress.report(1.0, "done");
    Ok(report)
}

fn stop_if(cancel: &Cancel) -> Result<(), ExportError> {
    if cancel.is_cancelled() { Err(ExportError::Cancelled) } else { Ok(()) }
}

/// A folder that is given twice would be exported twice.
fn check_distinct(sources: &[PathBuf]) -> Result<(), ExportError> {
    if sources.is_empty() {
        return Err(ExportError::Argument("no source; give sessions or rollouts".to_owned()));
    }
    let resolved: Vec<PathBuf> =
        sources.iter().map(|dir| dir.canonicalize().unwrap_or_else(|_| dir.clone())).collect();
    for (idx, dir) in resolved.iter().enumerate() {
        if resolved[..idx].contains(dir) {
            return Err(ExportError::Argument(format!("{} is given twice", sources[idx].display())));
        }
    }
    Ok(())
}

/// What recordings have in common, and what only some have.
#[derive(Default)]
struct Survey {
    first: Option<(PathBuf, Setup)>,
    num_episodes: usize,
    without_commands: Vec<PathBuf>,
    /// Whether an object moves in any.
    has_moving_object: bool,
    /// For each stream, how many episodes have readings of it, and one that has none.
    readings: Vec<(usize, Option<PathBuf>)>,
}

impl Survey {
    fn add(&mut self, path: &Path, episode: &Episode) -> Result<(), ExportError> {
        match &self.first {
            None => self.first = Some((path.to_owned(), episode.setup.clone())),
            Some((first, setup)) => {
                if let Some(difference) = difference(setup, &episode.setup) {
                    let problem =
                        format!("{difference} in {}; export them to data sets of their own", first.display());
                    return Err(ExportError::content(path, problem));
                }
            }
        }
        self.num_episodes += 1;
        if episode.commands.times_ns.is_empty() {
            self.without_commands.push(path.to_owned());
        }
        self.has_moving_object |= episode.object_poses.times_ns.len() > 1;
        self.readings.resize(episode.streams.len(), (0, None));
        for ((num_with, without), stream) in self.readings.iter_mut().zip(&episode.streams) {
            match stream.raw.is_empty() {
                false => *num_with += 1,
                true => *without = Some(path.to_owned()),
            }
        }
        Ok(())
    }

    /// What the data set is like.
    fn shape(self, config: LerobotConfig, sources: &[PathBuf]) -> Result<Shape, ExportError> {
        let Some((first, setup)) = self.first else {
            let problem =
                "no accepted take and no trial with an outcome; accept takes, or give other folders";
            return Err(ExportError::content(&sources[0], problem));
        };
        let action = match (config.action, self.without_commands.first()) {
            (Some(Action::Commands) | None, None) => Action::Commands,
            (Some(Action::Commands), Some(path)) => {
                let problem = "has no commands; use --action next-state, or leave its session out";
                return Err(ExportError::content(path, problem));
            }
            (None, Some(path)) if self.without_commands.len() < self.num_episodes => {
                let problem = "has no commands, and others have some; say what to write with --action, or export them apart";
                return Err(ExportError::content(path, problem));
            }
            (None, Some(_)) => Action::None,
            (Some(action), _) => action,
        };
        let mut with_raw = Vec::with_capacity(self.readings.len());
        for (stream, (num_with, without)) in setup.streams.iter().zip(self.readings) {
            if let Some(path) = without.filter(|_| num_with > 0) {
                let problem = format!(
                    "has no readings of stream {:?}, and others have some; export them apart",
                    stream.id
                );
                return Err(ExportError::content(&path, problem));
            }
            with_raw.push(num_with > 0);
        }
        let nominal = setup.rate_hz.round();
        let fps = match config.fps {
            Some(fps) => fps,
            None if (1.0..=f64::from(MAX_FPS)).contains(&nominal) => nominal as u32,
            None => {
                let problem = format!("its joint log has {} Hz; choose a rate with --fps", setup.rate_hz);
                return Err(ExportError::content(&first, problem));
            }
        };
        Ok(Shape { setup, fps, action, with_raw, with_object: self.has_moving_object })
    }
}

/// In what two recordings differ so that they cannot be of one data set.
fn difference(first: &Setup, other: &Setup) -> Option<String> {
    if first.raw != other.raw {
        return Some(
            "readings of takes are as read, those of trials less their reference: not as".to_owned(),
        );
    }
    if first.joints != other.joints {
        return Some(format!("its {} joints are not the {}", other.joints.len(), first.joints.len()));
    }
    if first.streams.len() != other.streams.len() {
        return Some(format!("it has {} streams, not the {}", other.streams.len(), first.streams.len()));
    }
    let differs = |(first, other): &(_, _)| first != other;
    let pair = first.streams.iter().zip(&other.streams).find(differs);
    pair.map(|(stream, _)| format!("channels, unit or rate of stream {:?} are not as", stream.id))
}

/// Writes episodes one after the other.
struct Writer<'a> {
    draft: &'a Draft,
    shape: Shape,
    table: Option<Table>,
    /// Number of the file that `table` is.
    file: usize,
    num_frames: usize,
    tasks: Vec<String>,
    /// Columns of the table of episodes.
    episodes: Vec<EpisodeNote>,
    /// Values of every feature over all episodes.
    values: Vec<(String, usize, Vec<f64>)>,
}

/// Where the file of frames number `file` lies.
fn frames_path(file: usize) -> String {
    format!("data/chunk-{:03}/file-{:03}.parquet", file / FILES_PER_CHUNK, file % FILES_PER_CHUNK)
}

impl<'a> Writer<'a> {
    fn new(draft: &'a Draft, shape: Shape) -> Self {
        Self {
            draft,
            shape,
            table: None,
            file: 0,
            num_frames: 0,
            tasks: Vec::new(),
            episodes: Vec::new(),
            values: Vec::new(),
        }
    }

    fn add(&mut self, path: &Path, episode: Episode) -> Result<(), ExportError> {
        let task = match self.tasks.iter().position(|task| *task == episode.task) {
            Some(task) => task,
            None => {
                self.tasks.push(episode.task.clone());
                self.tasks.len() - 1
            }
        };
        let place = frames::Place { episode: self.episodes.len(), first_index: self.num_frames, task };
        let Some(frames) = Frames::sample(&self.shape, &episode, place) else {
            let problem = "joints and touch do not overlap in time; leave the take out of session.toml";
            return Err(ExportError::content(path, problem));
        };
        if self.table.as_ref().is_some_and(|table| table.num_bytes() > MAX_FILE_BYTES) {
            self.close_file()?;
        }
        let file_path = self.draft.path(&frames_path(self.file))?;
        let table = match &mut self.table {
            Some(table) => table,
            None => self.table.insert(Table::create(&file_path, &frames.columns, None)?),
        };
        table.append(&frames.columns).map_err(ExportError::parquet(&file_path))?;

        let mut statistics = Vec::with_capacity(frames.columns.len());
        for (idx, column) in frames.columns.iter().enumerate() {
            let (width, values) = (column.per_row.unwrap_or(1), numbers(&column.values));
            statistics.push((column.name.clone(), Statistics::of(&values, width)));
            match self.values.get_mut(idx) {
                Some((_, _, all)) => all.extend(values),
                None => self.values.push((column.name.clone(), width, values)),
            }
        }
        self.episodes.push(EpisodeNote {
            task: episode.task,
            length: frames.num_frames,
            first_index: self.num_frames,
            file: self.file,
            first_s: frames.first_s,
            longest_age_s: frames.longest_age_s,
            outcome: episode.outcome,
            origin: episode.origin,
            statistics,
        });
        self.num_frames += frames.num_frames;
        Ok(())
    }

    fn close_file(&mut self) -> Result<(), ExportError> {
        let Some(table) = self.table.take() else { return Ok(()) };
        let path = self.draft.path(&frames_path(self.file))?;
        table.finish().map_err(ExportError::parquet(&path))?;
        self.file += 1;
        Ok(())
    }

    fn finish(mut self, out: &Path, left_out: Vec<LeftOut>) -> Result<LerobotReport, ExportError> {
        self.close_file()?;
        let all: Vec<(String, Statistics)> = self
            .values
            .iter()
            .map(|(name, width, values)| (name.clone(), Statistics::of(values, *width)))
            .collect();
        let described = Described {
            shape: &self.shape,
            num_frames: self.num_frames,
            tasks: &self.tasks,
            episodes: &self.episodes,
            statistics: &all,
            left_out: &left_out,
        };
        let tables = [
            ("meta/tasks.parquet", described.tasks_table(), Some(metadata::pandas_of_tasks())),
            ("meta/episodes/chunk-000/file-000.parquet", described.episodes_table(), None),
        ];
        for (file, columns, about) in tables {
            write_table(&self.draft.path(file)?, &columns, about)?;
        }
        self.draft.write("meta/info.json", &described.info())?;
        self.draft.write("meta/stats.json", &described.stats())?;
        self.draft.write("meta/palpate.json", &described.about())?;
        self.draft.write("README.md", &described.readme())?;
        let count = |success: bool| {
            let is_so = |note: &&EpisodeNote| note.outcome.as_ref().is_some_and(|of| of.success == success);
            self.episodes.iter().filter(is_so).count()
        };
        Ok(LerobotReport {
            out: out.to_owned(),
            fps: self.shape.fps,
            episodes: self.episodes.len(),
            frames: self.num_frames,
            features: self
                .shape
                .features()
                .map(|feature| FeatureSize { name: feature.name.to_owned(), size: feature.names.len() })
                .collect(),
            action: self.shape.action,
            successes: count(true),
            failures: count(false),
            tasks: self.tasks,
            left_out,
        })
    }
}

/// The values of a column as numbers; frames have no others.
fn numbers(values: &Values) -> Vec<f64> {
    match values {
        Values::F32(values) => values.iter().map(|&value| f64::from(value)).collect(),
        Values::F64(values) => values.clone(),
        Values::I64(values) => values.iter().map(|&value| value as f64).collect(),
        Values::Bool(values) => values.iter().map(|&value| f64::from(u8::from(value))).collect(),
        Values::Text(_) | Values::OptBool(_) | Values::OptText(_) => Vec::new(),
    }
}

/// A column of one integer a row.
fn integers(name: &str, values: impl Iterator<Item = usize>) -> Column {
    Column::plain(name, Values::I64(values.map(|value| value as i64).collect()))
}
