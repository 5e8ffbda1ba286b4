//! What an import understood, for people and scripts.

use palpate_reports::StreamCheck;
use serde::Serialize;

/// What was understood of a folder of recordings; `palpate import --explain`.
#[derive(Clone, Debug, Serialize)]
pub struct ImportReport {
    /// Whether all of it can be imported.
    pub ok: bool,
    /// Id of the station.
    pub station: String,
    /// Why it is that station.
    pub station_because: String,
    /// The mapping file, if one was used.
    pub mapping: Option<String>,
    /// The takes, by name.
    pub takes: Vec<TakeReport>,
}

/// What was understood of one take.
#[derive(Clone, Debug, Default, Serialize)]
pub struct TakeReport {
    /// Id that the take gets.
    pub take: String,
    /// Why it cannot be imported, if it cannot; then only what was found before is reported.
    pub problem: Option<String>,
    /// Object id.
    pub object: String,
    /// Primitive.
    pub primitive: String,
    /// Whether it has events instead of readings.
    pub binary: bool,
    /// Whether the fixture that held the object is trusted.
    pub fixture_trusted: bool,
    /// First time of any file, on the recording's own clock, s.
    pub first_s: f64,
    /// Last time of any file, s.
    pub last_s: f64,
    /// The first span without touch, on the recording's own clock, s.
    pub baseline_s: Option<[f64; 2]>,
    /// Later spans without touch, from each of which on readings count from what they are in it.
    pub later_baselines_s: Vec<[f64; 2]>,
    /// Where the repetitions come from: `marks` (of `take.toml` or the mapping file), `joint path` or `none`.
    pub repetitions_from: String,
    /// The repetitions, on the recording's own clock.
    pub repetitions: Vec<RepetitionReport>,
    /// The files, in the order of reading.
    pub files: Vec<FileReport>,
    /// Rates and gaps of joints and streams after everything was put together.
    pub streams: Vec<StreamCheck>,
    /// What is odd but does not prevent the import.
    pub warnings: Vec<String>,
    /// What was changed or put together on the way.
    pub notes: Vec<String>,
}

/// One repetition.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RepetitionReport {
    /// Start, s.
    pub start_s: f64,
    /// End, s.
    pub end_s: f64,
    /// Which motion.
    pub label: String,
}

/// What was understood of one file.
#[derive(Clone, Debug, Serialize)]
pub struct FileReport {
    /// Its name.
    pub file: String,
    /// How columns were recognised: `numbers`, `names`.
    pub columns_by: String,
    /// Rows.
    pub rows: usize,
    /// Where times come from: `column 1 (t_s), s` or `100 Hz, as stated`.
    pub time: String,
    /// First time, s.
    pub first_s: f64,
    /// Last time, s.
    pub last_s: f64,
    /// Columns that are read.
    pub columns: Vec<ColumnReport>,
    /// Columns that are not read.
    pub ignored: Vec<IgnoredColumn>,
}

/// A column that is read.
#[derive(Clone, Debug, Serialize)]
pub struct ColumnReport {
    /// From 1.
    pub column: usize,
    /// Its header; empty without one.
    pub header: String,
    /// `joint`, `channel`, `axis` or `object coordinate`.
    pub what: &'static str,
    /// The station's name for it.
    pub id: String,
    /// Unit of the file.
    pub unit: String,
    /// Unit of the station, in which the range below is.
    pub to_unit: String,
    /// What numbers were multiplied by first.
    pub scale: f64,
    /// What was added then.
    pub offset: f64,
    /// -1 where readings fall under load; they are kept as the device's lowest plus highest reading, minus the reading.
    pub polarity: i8,
    /// Lowest value as it is kept.
    pub min: f64,
    /// Highest value as it is kept.
    pub max: f64,
    /// Whether it never changes.
    pub constant: bool,
}

/// A column that is not read.
#[derive(Clone, Debug, Serialize)]
pub struct IgnoredColumn {
    /// From 1.
    pub column: usize,
    /// Its header.
    pub header: String,
    /// The name of the station that it may be a misspelling of.
    pub nearest: Option<String>,
}
