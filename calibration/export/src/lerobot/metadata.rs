//! What the data set says about itself.

use parquet::file::metadata::KeyValue;
use serde_json::{Map, Value, json};

use crate::{
    columns::{Column, Values},
    source::{LeftOut, Origin, Outcome, RawKind},
    statistics::Statistics,
};

use super::{Action, FILES_PER_CHUNK, frames::Shape, integers};

/// Version of the format that this writes.
const CODEBASE_VERSION: &str = "v3.0";
/// The rule of the clock, for people.
const SAMPLING: &str = "Frame k of an episode lies k / fps after the first moment at which joints and every tactile stream \
    have a sample, and holds of each the newest sample at or before that moment: nothing is interpolated, and nothing of an \
    observation comes from the future. An episode ends with the log that ends first.";

/// What is known of an episode.
#[derive(Clone, Debug)]
pub(super) struct EpisodeNote {
    pub(super) task: String,
    /// Number of frames.
    pub(super) length: usize,
    pub(super) first_index: usize,
    /// Number of the file that holds its frames.
    pub(super) file: usize,
    /// When its first frame is, s since the recording's start.
    pub(super) first_s: f64,
    /// For joints, then each stream: the greatest age of what a frame holds, s.
    pub(super) longest_age_s: Vec<(String, f64)>,
    pub(super) outcome: Option<Outcome>,
    pub(super) origin: Origin,
    /// Of each feature.
    pub(super) statistics: Vec<(String, Statistics)>,
}

/// A data set whose frames are written.
pub(super) struct Described<'a> {
    pub(super) shape: &'a Shape,
    pub(super) num_frames: usize,
    pub(super) tasks: &'a [String],
    pub(super) episodes: &'a [EpisodeNote],
    pub(super) statistics: &'a [(String, Statistics)],
    pub(super) left_out: &'a [LeftOut],
}

impl Described<'_> {
    pub(super) fn tasks_table(&self) -> Vec<Column> {
        vec![
            integers("task_index", 0..self.tasks.len()),
            Column::plain("task", Values::Text(self.tasks.to_vec())),
        ]
    }

    pub(super) fn episodes_table(&self) -> Vec<Column> {
        let episodes = self.episodes;
        let each = |of: fn(&EpisodeNote) -> usize| episodes.iter().map(of);
        let texts = |of: fn(&EpisodeNote) -> &String| episodes.iter().map(|note| of(note).clone()).collect();
        let outcomes = || episodes.iter().map(|note| note.outcome.as_ref());
        let mut columns = vec![
            integers("episode_index", 0..episodes.len()),
            Column::list("tasks", 1, Values::Text(texts(|note| &note.task))),
            integers("length", each(|note| note.length)),
            integers("data/chunk_index", each(|note| note.file / FILES_PER_CHUNK)),
            integers("data/file_index", each(|note| note.file % FILES_PER_CHUNK)),
            integers("dataset_from_index", each(|note| note.first_index)),
            integers("dataset_to_index", each(|note| note.first_index + note.length)),
            integers("meta/episodes/chunk_index", each(|_| 0)),
            integers("meta/episodes/file_index", each(|_| 0)),
            Column::plain("source_folder", Values::Text(texts(|note| &note.origin.folder))),
            Column::plain("source_file", Values::Text(texts(|note| &note.origin.file))),
            Column::plain("success", Values::OptBool(outcomes().map(|of| Some(of?.success)).collect())),
            Column::plain(
                "failure_mode",
                Values::OptText(outcomes().map(|of| of?.failure_mode.clone()).collect()),
            ),
        ];
        let of_feature = |note: &EpisodeNote, feature: usize| note.statistics[feature].1.clone();
        for (feature, (name, all)) in self.statistics.iter().enumerate() {
            for (statistic, (key, values)) in all.by_name.iter().enumerate() {
                let of_episodes =
                    episodes.iter().flat_map(|note| of_feature(note, feature).by_name[statistic].1.clone());
                let values_of = Values::F64(of_episodes.collect());
                columns.push(Column::list(format!("stats/{name}/{key}"), values.len(), values_of));
            }
            let counts = episodes.iter().map(|note| of_feature(note, feature).count as i64).collect();
            columns.push(Column::list(format!("stats/{name}/count"), 1, Values::I64(counts)));
        }
        columns
    }

    /// `meta/info.json`.
    pub(super) fn info(&self) -> String {
        let plain = |dtype: &str| json!({ "dtype": dtype, "shape": [1], "names": null });
        let mut features: Map<String, Value> = self
            .shape
            .features()
            .map(|feature| {
                let about =
                    json!({ "dtype": feature.dtype, "shape": [feature.names.len()], "names": feature.names });
                (feature.name.to_owned(), about)
            })
            .collect();
        features.insert("timestamp".to_owned(), plain("float32"));
        for name in ["frame_index", "episode_index", "index", "task_index"] {
            features.insert(name.to_owned(), plain("int64"));
        }
        pretty(&json!({
            "codebase_version": CODEBASE_VERSION,
            "robot_type": self.shape.setup.station,
            "total_episodes": self.episodes.len(),
            "total_frames": self.num_frames,
            "total_tasks": self.tasks.len(),
            "chunks_size": FILES_PER_CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": self.shape.fps,
            "splits": { "train": format!("0:{}", self.episodes.len()) },
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": null,
            "features": features,
        }))
    }

    /// `meta/stats.json`.
    pub(super) fn stats(&self) -> String {
        let all: Map<String, Value> =
            self.statistics.iter().map(|(name, statistics)| (name.clone(), statistics.to_json())).collect();
        pretty(&Value::Object(all))
    }

    /// `meta/palpate.json`: what LeRobot has no place for.
    pub(super) fn about(&self) -> String {
        let episodes: Vec<Value> = self
            .episodes
            .iter()
            .enumerate()
            .map(|(episode, note)| {
                let ages: Map<String, Value> =
                    note.longest_age_s.iter().map(|(log, age_s)| (log.clone(), json!(age_s))).collect();
                json!({
                    "episode_index": episode,
                    "source": note.origin,
                    "first_frame_s": note.first_s,
                    "longest_age_s": ages,
                    "outcome": note.outcome,
                })
            })
            .collect();
        let mut about = json!({
            "format": 1,
            "software": format!("palpate {}", env!("CARGO_PKG_VERSION")),
            "truth": self.truth(),
            "sampling": SAMPLING,
            "station": self.shape.setup.station,
            "units": {
                "observation.state": "rad, or m for joints that slide",
                "action": "rad, or m for joints that slide",
                "observation.tactile.raw": self.raw(),
                "observation.tactile.active": "whether the channel is touched",
                "timestamp": "s since the episode's first frame",
            },
            "action": self.shape.action,
            "raw": self.shape.setup.raw,
            "streams": self.shape.setup.streams,
            "episodes": episodes,
            "left_out": self.left_out,
        });
        if self.shape.with_object {
            about["units"]["observation.environment_state"] = json!(
                "the object in the frame of the robot's base: x, y, z in m, unit quaternion qw, qx, qy, qz"
            );
        }
        pretty(&about)
    }

    /// `README.md`, as the Hugging Face hub shows it.
    pub(super) fn readme(&self) -> String {
        let features: String = self
            .shape
            .features()
            .map(|feature| format!("| `{}` | {} | {} |\n", feature.name, feature.dtype, feature.names.len()))
            .collect();
        let tasks: String = self.tasks.iter().map(|task| format!("- {task}\n")).collect();
        let action = match self.shape.action {
            Action::Commands => {
                "`action` is what joints were told last; before the first command it is where they were."
            }
            Action::NextState => "`action` is where joints are one frame later: no commands were recorded.",
            Action::None => "There is no `action`: no commands were recorded.",
        };
        format!(
            "---\ntask_categories:\n- robotics\ntags:\n- LeRobot\n- tactile\nconfigs:\n- config_name: default\n  \
             data_files: data/*/*.parquet\n---\n\n# Touch and motion of {station}\n\nLeRobotDataset {CODEBASE_VERSION}, written by \
             Palpate: {episodes} episodes, {frames} frames, {fps} frames per second.\n\n| feature | type | numbers |\n\
             |---|---|---|\n{features}\nPositions are in rad, or m for joints that slide. Readings: {raw}.\n{action}\n\n\
             {SAMPLING}\n\n{truth}\n\nThe table of episodes has four columns beside LeRobot's own: `source_folder`, `source_file`, and \
             where the recording says so `success` and `failure_mode`. Units, sources with SHA-256 and the greatest age of a \
             value are in `meta/palpate.json`.\n\n## Tasks\n\n{tasks}",
            station = self.shape.setup.station,
            episodes = self.episodes.len(),
            frames = self.num_frames,
            fps = self.shape.fps,
            raw = self.raw(),
            truth = self.truth(),
        )
    }

    /// What these files are copies of.
    fn truth(&self) -> &'static str {
        match self.shape.setup.raw {
            RawKind::AsRead => {
                "This data set is a copy for training. What was measured is in the takes (MCAP): every stream at its own rate, \
                 with device and host time."
            }
            RawKind::LessReference => {
                "This data set is a copy for training. What was seen and done is in the records of the trials (JSON lines)."
            }
        }
    }

    fn raw(&self) -> String {
        match self.shape.setup.raw {
            RawKind::AsRead => {
                let streams = self.shape.setup.streams.iter().zip(&self.shape.with_raw);
                let units = streams.map(|(stream, with_raw)| match with_raw {
                    true => format!("{} of {} as the device gives them", stream.raw_unit, stream.id),
                    false => format!("none of {}, which gives events only", stream.id),
                });
                units.collect::<Vec<_>>().join("; ")
            }
            RawKind::LessReference => {
                "the unit of each channel's stream, less the channel's reference value".to_owned()
            }
        }
    }
}

/// What makes pandas take the column `task` as index, as LeRobot expects it.
pub(super) fn pandas_of_tasks() -> KeyValue {
    let column = |name: &str, pandas_type: &str, numpy_type: &str| {
        json!({
            "name": name, "field_name": name, "pandas_type": pandas_type, "numpy_type": numpy_type, "metadata": null,
        })
    };
    let about = json!({
        "index_columns": ["task"],
        "column_indexes": [],
        "pandas_version": "2.0.0",
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
    });
    KeyValue::new("pandas".to_owned(), about.to_string())
}

fn pretty(document: &Value) -> String {
    format!("{document:#}\n")
}
