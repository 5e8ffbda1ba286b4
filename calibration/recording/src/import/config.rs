//! What people write beside their recordings: `take.toml`, and the mapping file.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use palpate_robot_model::PoseConfig;
use serde::Deserialize;
use toml::Spanned;

use super::name_pattern;
use crate::{
    RecordingError,
    files::{MAX_TEXT_BYTES, read_text},
};

/// Name of the mapping file that an import takes by itself where it lies in the folder of the recordings.
pub const MAPPING_FILE: &str = "mapping.toml";

/// `take.toml`, and the fields of it that a mapping file gives for several takes.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TakeConfig {
    pub(super) object: Option<String>,
    pub(super) object_pose: Option<PoseConfig>,
    pub(super) primitive: Option<String>,
    pub(super) repetitions_s: Option<Vec<[f64; 2]>>,
    /// What each repetition does, one for each; absent: all do what the primitive says.
    pub(super) repetition_labels: Option<Vec<String>>,
    /// Spans without touch. Needed unless the take is binary or `baseline_first_s` is there.
    pub(super) baseline_s: Option<BaselineSpans>,
    /// As `baseline_s`, from the first sample on, s.
    pub(super) baseline_first_s: Option<f64>,
    pub(super) binary: Option<bool>,
    pub(super) fixture_trusted: Option<bool>,
    pub(super) operator: Option<String>,
}

impl TakeConfig {
    /// What `over` gives, and what this gives where that is silent.
    pub(super) fn overridden_by(self, over: Self) -> Self {
        // Either spelling of the baseline takes the place of the other.
        let has_baseline = over.baseline_s.is_some() || over.baseline_first_s.is_some();
        let baseline = if has_baseline {
            (over.baseline_s, over.baseline_first_s)
        } else {
            (self.baseline_s, self.baseline_first_s)
        };
        // Labels belong to the spans they were written for.
        let (repetitions_s, repetition_labels) = match over.repetitions_s {
            Some(spans) => (Some(spans), over.repetition_labels),
            None => (self.repetitions_s, over.repetition_labels.or(self.repetition_labels)),
        };
        Self {
            object: over.object.or(self.object),
            object_pose: over.object_pose.or(self.object_pose),
            primitive: over.primitive.or(self.primitive),
            repetitions_s,
            repetition_labels,
            baseline_s: baseline.0,
            baseline_first_s: baseline.1,
            binary: over.binary.or(self.binary),
            fixture_trusted: over.fixture_trusted.or(self.fixture_trusted),
            operator: over.operator.or(self.operator),
        }
    }
}

/// A mapping file: what the columns and files of recordings mean that were not written for this program.
#[derive(Clone, Debug)]
pub struct Mapping {
    pub(super) path: PathBuf,
    text: String,
    pub(super) config: MappingConfig,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MappingConfig {
    pub(super) format: Spanned<u32>,
    /// Station file, relative to the mapping file, or the id of a shipped one.
    station: Option<String>,
    #[serde(default)]
    pub(super) takes: Takes,
    /// Which files are takes, where each take is a file.
    pub(super) pattern: Option<Spanned<String>>,
    /// Patterns of files or folders that are no takes.
    #[serde(default)]
    pub(super) except: Vec<String>,
    /// Positions of joints that are in no file, rad or m.
    #[serde(default)]
    pub(super) fixed_joints: BTreeMap<Spanned<String>, f64>,
    #[serde(default)]
    take: Vec<Spanned<NamedTakeConfig>>,
    #[serde(default)]
    pub(super) file: Vec<Spanned<FileConfig>>,
}

/// What a take is: a folder, or a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Takes {
    #[default]
    Folders,
    Files,
}

/// `[[take]]`: fields of `take.toml` for the takes whose names fit.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct NamedTakeConfig {
    /// Pattern of names, `*` standing for anything; absent: every take.
    name: Option<String>,
    // Written out: flattening would let misspelt fields pass.
    object: Option<String>,
    object_pose: Option<PoseConfig>,
    primitive: Option<String>,
    repetitions_s: Option<Vec<[f64; 2]>>,
    repetition_labels: Option<Vec<String>>,
    baseline_s: Option<BaselineSpans>,
    baseline_first_s: Option<f64>,
    binary: Option<bool>,
    fixture_trusted: Option<bool>,
    operator: Option<String>,
}

/// `[[file]]`: one file of each take.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FileConfig {
    /// Its name; `{take}` stands for the take's. Absent where each take is a file: that file.
    pub(super) file: Option<String>,
    /// Lines before everything else.
    #[serde(default)]
    pub(super) skip_lines: usize,
    #[serde(default = "yes")]
    pub(super) header: bool,
    #[serde(default)]
    pub(super) delimiter: Delimiter,
    #[serde(default)]
    pub(super) decimal_comma: bool,
    /// Lines that begin with this character are left out.
    pub(super) comment: Option<char>,
    /// How many lines make one row.
    #[serde(default = "one")]
    pub(super) lines_per_row: usize,
    pub(super) time: Option<TimeConfig>,
    /// How headers hold the names of joints and channels: `*` stands for the name.
    #[serde(default)]
    pub(super) names: Vec<String>,
    #[serde(default)]
    pub(super) map: Vec<Spanned<MapConfig>>,
}

impl FileConfig {
    /// Comma-separated, with a header, without a mapping.
    pub(super) fn plain() -> Self {
        Self {
            file: None,
            skip_lines: 0,
            header: true,
            delimiter: Delimiter::Comma,
            decimal_comma: false,
            comment: None,
            lines_per_row: 1,
            time: None,
            names: Vec::new(),
            map: Vec::new(),
        }
    }
}

fn yes() -> bool {
    true
}

fn one() -> usize {
    1
}

/// What stands between two values of a line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Delimiter {
    #[default]
    Comma,
    Semicolon,
    Tab,
    /// Any number of blanks and tabs.
    Blanks,
}

/// Where the times of a file come from: a column, or a rate.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TimeConfig {
    pub(super) column: Option<ColumnName>,
    pub(super) unit: Option<String>,
    pub(super) rate_hz: Option<f64>,
    /// Added to every time, s.
    #[serde(default)]
    pub(super) offset_s: f64,
}

/// A column by its header or its number, from 1.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(untagged)]
pub(super) enum ColumnName {
    Number(usize),
    Header(String),
}

/// `[[file.map]]`: what some columns are.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MapConfig {
    /// Absent: those that the file names as the station does.
    pub(super) columns: Option<OneOrMany<ColumnName>>,
    pub(super) joints: Option<OneOrMany<String>>,
    pub(super) channels: Option<OneOrMany<String>>,
    /// All channels of a patch, in order.
    pub(super) patch: Option<String>,
    /// All channels of a stream, in order.
    pub(super) stream: Option<String>,
    /// Of channels with several axes: which the columns are, of every channel in turn. Absent: all of them.
    pub(super) axis: Option<OneOrMany<String>>,
    /// Numbers of the object's pose: `x`, `y`, `z`, `qw`, `qx`, `qy`, `qz`.
    pub(super) object: Option<OneOrMany<String>>,
    pub(super) unit: Option<String>,
    #[serde(default = "unscaled")]
    pub(super) scale: f64,
    #[serde(default)]
    pub(super) offset: f64,
    /// -1 where a reading falls under load.
    #[serde(default = "rising")]
    pub(super) polarity: i8,
}

fn unscaled() -> f64 {
    1.0
}

fn rising() -> i8 {
    1
}

/// `[t0, t1]`, or a list of such spans.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(untagged, expecting = "expected a span [t0, t1] in s, or a list of spans [[t0, t1], [t0, t1]]")]
pub(super) enum BaselineSpans {
    One([f64; 2]),
    Many(Vec<[f64; 2]>),
}

impl BaselineSpans {
    pub(super) fn as_slice(&self) -> &[[f64; 2]] {
        match self {
            Self::One(span) => std::slice::from_ref(span),
            Self::Many(spans) => spans,
        }
    }
}

/// One, or a list.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(untagged)]
pub(super) enum OneOrMany<T> {
    One(T),
    Many(Vec<T>),
}

impl<T> OneOrMany<T> {
    pub(super) fn as_slice(&self) -> &[T] {
        match self {
            Self::One(one) => std::slice::from_ref(one),
            Self::Many(many) => many,
        }
    }
}

impl Mapping {
    /// Reads the mapping file at `path`.
    ///
    /// Refused, naming the line: unknown fields, other formats, numbers out of their range, contradictions.
    pub fn read(path: &Path) -> Result<Self, RecordingError> {
        Self::parse(path, &read_text(path, MAX_TEXT_BYTES)?)
    }

    /// As [`Mapping::read`], from its text. `path` names it in errors.
    pub fn parse(path: &Path, text: &str) -> Result<Self, RecordingError> {
        let config: MappingConfig = toml::from_str(text).map_err(RecordingError::toml(path, text))?;
        let mapping = Self { path: path.to_owned(), text: text.to_owned(), config };
        mapping.check()?;
        Ok(mapping)
    }

    /// The station it is for, if it says so: a path relative to the mapping file, or an id.
    pub fn station(&self) -> Option<&str> {
        self.config.station.as_deref()
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// An error about what stands at `span`.
    pub(super) fn error(
        &self,
        span: std::ops::Range<usize>,
        field: &str,
        problem: impl Into<String>,
    ) -> RecordingError {
        let before = &self.text.as_bytes()[..span.start.min(self.text.len())];
        let line = before.iter().filter(|&&byte| byte == b'\n').count() + 1;
        RecordingError::content(&self.path, format!("line {line}, {field}"), problem)
    }

    /// The fields of `take.toml` for the take called `name`: of the entries that fit, later ones win.
    pub(super) fn take(&self, name: &str) -> TakeConfig {
        let fits = |pattern: &Option<String>| {
            pattern.as_ref().is_none_or(|pattern| name_pattern::matched(pattern, name).is_some())
        };
        self.config.take.iter().map(Spanned::get_ref).filter(|take| fits(&take.name)).fold(
            TakeConfig::default(),
            |config, take| {
                config.overridden_by(TakeConfig {
                    object: take.object.clone(),
                    object_pose: take.object_pose,
                    primitive: take.primitive.clone(),
                    repetitions_s: take.repetitions_s.clone(),
                    repetition_labels: take.repetition_labels.clone(),
                    baseline_s: take.baseline_s.clone(),
                    baseline_first_s: take.baseline_first_s,
                    binary: take.binary,
                    fixture_trusted: take.fixture_trusted,
                    operator: take.operator.clone(),
                })
            },
        )
    }

    fn check(&self) -> Result<(), RecordingError> {
        let format = &self.config.format;
        if *format.get_ref() != 1 {
            let problem =
                format!("{}, expected 1, the only format that this palpate reads", format.get_ref());
            return Err(self.error(format.span(), "format", problem));
        }
        for (name, &position) in &self.config.fixed_joints {
            if !position.is_finite() {
                let problem = format!("joint {:?} is {position}, expected a finite position", name.get_ref());
                return Err(self.error(name.span(), "fixed_joints", problem));
            }
        }
        let files_are_takes = self.config.takes == Takes::Files;
        match &self.config.pattern {
            Some(pattern) if !files_are_takes => {
                let problem =
                    "only makes sense with takes = \"files\"; remove it, or say that each take is a file";
                return Err(self.error(pattern.span(), "pattern", problem));
            }
            Some(pattern)
                if pattern.get_ref().matches('*').count() != 1 || pattern.get_ref().contains('/') =>
            {
                let problem = format!(
                    "{:?}, expected the name of a file with one `*`, which stands for the take's name, as in \"*.csv\"",
                    pattern.get_ref()
                );
                return Err(self.error(pattern.span(), "pattern", problem));
            }
            _ => {}
        }
        for take in &self.config.take {
            if let Some(name) = &take.get_ref().name
                && name.matches('*').count() > 1
            {
                let problem = format!("{name:?} has more than one `*`, expected at most one");
                return Err(self.error(take.span(), "[[take]] name", problem));
            }
        }
        for file in &self.config.file {
            self.check_file(file, files_are_takes)?;
        }
        Ok(())
    }

    fn check_file(&self, file: &Spanned<FileConfig>, files_are_takes: bool) -> Result<(), RecordingError> {
        let (span, config) = (file.span(), file.get_ref());
        let error = |field: &str, problem: String| {
            Err(self.error(span.clone(), &format!("[[file]] {field}"), problem))
        };
        match &config.file {
            None if !files_are_takes => {
                return error(
                    "file",
                    "missing, expected the name of a file in each take's folder".to_owned(),
                );
            }
            Some(name) if name.is_empty() || name.contains('/') || name.contains('\\') || name == ".." => {
                return error(
                    "file",
                    format!("{name:?}, expected the name of a file beside the take's others"),
                );
            }
            _ => {}
        }
        const MAX_LINES_PER_ROW: usize = 1000;
        if !(1..=MAX_LINES_PER_ROW).contains(&config.lines_per_row) {
            let problem = format!("{}, expected 1 to {MAX_LINES_PER_ROW}", config.lines_per_row);
            return error("lines_per_row", problem);
        }
        if config.header && config.lines_per_row > 1 {
            let problem = format!(
                "{} lines for a row need header = false and columns by number, counted through these lines",
                config.lines_per_row
            );
            return error("lines_per_row", problem);
        }
        if config.decimal_comma && config.delimiter == Delimiter::Comma {
            let problem = "decimal commas need another delimiter than commas: semicolon, tab or blanks";
            return error("decimal_comma", problem.to_owned());
        }
        if let Some(comment) =
            config.comment.filter(|comment| !comment.is_ascii() || comment.is_ascii_control())
        {
            return error(
                "comment",
                format!("{comment:?}, expected a printable ASCII character such as '#'"),
            );
        }
        if let Some(pattern) = config.names.iter().find(|pattern| pattern.matches('*').count() != 1) {
            return error("names", format!("{pattern:?}, expected one `*`, which stands for the name"));
        }
        match &config.time {
            Some(TimeConfig { column: Some(_), rate_hz: Some(_), .. }) => {
                return error("time", "both a column and a rate_hz, expected one of them".to_owned());
            }
            Some(TimeConfig { unit: Some(_), rate_hz: Some(_), .. }) => {
                return error(
                    "time",
                    "a rate_hz and a unit, but the unit is that of a time column".to_owned(),
                );
            }
            Some(TimeConfig { rate_hz: Some(rate_hz), .. }) if !(*rate_hz > 0.0 && rate_hz.is_finite()) => {
                return error("time", format!("rate_hz is {rate_hz}, expected a finite number above zero"));
            }
            Some(TimeConfig { offset_s, .. }) if !offset_s.is_finite() => {
                return error("time", format!("offset_s is {offset_s}, expected a finite number"));
            }
            None if !config.header => {
                let problem =
                    "missing; a file without header needs time = { column = NUMBER } or { rate_hz = RATE }";
                return error("time", problem.to_owned());
            }
            _ => {}
        }
        for map in &config.map {
            let (span, map) = (map.span(), map.get_ref());
            let error = |field: &str, problem: String| {
                Err(self.error(span.clone(), &format!("[[file.map]] {field}"), problem))
            };
            let named = [
                map.joints.is_some(),
                map.channels.is_some(),
                map.patch.is_some(),
                map.stream.is_some(),
                map.object.is_some(),
            ];
            if named.iter().filter(|&&named| named).count() != 1 {
                let problem = "expected exactly one of joints, channels, patch, stream and object: what the columns are";
                return error("joints", problem.to_owned());
            }
            if map.axis.is_some() && (map.joints.is_some() || map.object.is_some()) {
                return error("axis", "is for channels, a patch or a stream; remove it".to_owned());
            }
            if !(map.scale.is_finite() && map.scale != 0.0) {
                return error("scale", format!("{}, expected a finite number that is not zero", map.scale));
            }
            if !map.offset.is_finite() {
                return error("offset", format!("{}, expected a finite number", map.offset));
            }
            if map.polarity != 1 && map.polarity != -1 {
                return error(
                    "polarity",
                    format!("{}, expected 1, or -1 where readings fall under load", map.polarity),
                );
            }
            if map.polarity == -1 && (map.joints.is_some() || map.object.is_some()) {
                let problem = "-1 is for readings that fall under load; turn a joint or a coordinate round with scale = -1";
                return error("polarity", problem.to_owned());
            }
        }
        Ok(())
    }
}

/// The fields of every struct that people write, by the name of the section they stand in.
#[cfg(test)]
pub(super) fn documented_fields() -> Vec<(&'static str, Vec<String>)> {
    /// The reader's own complaint about an unknown field lists those that it knows.
    fn fields<T: serde::de::DeserializeOwned>() -> Vec<String> {
        match toml::from_str::<T>("no_such_field = 1") {
            Ok(_) => Vec::new(),
            Err(error) => listed_fields(error.message()),
        }
    }
    vec![
        ("take.toml", fields::<TakeConfig>()),
        ("mapping file", fields::<MappingConfig>()),
        ("[[take]]", fields::<NamedTakeConfig>()),
        ("[[file]]", fields::<FileConfig>()),
        ("time", fields::<TimeConfig>()),
        ("[[file.map]]", fields::<MapConfig>()),
    ]
}

/// The fields in serde's complaint about an unknown one.
#[cfg(test)]
pub(super) fn listed_fields(complaint: &str) -> Vec<String> {
    let (_, known) = complaint.split_once("expected").unwrap_or_default();
    known.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}
