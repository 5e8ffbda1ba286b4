//! Which column is which joint or channel, and how its numbers become the station's.

use std::{borrow::Cow, collections::BTreeMap, path::Path};

use palpate_robot_model::TaxelAxes;
use toml::Spanned;

use super::{
    config::{ColumnName, FileConfig, MapConfig, Mapping},
    name_pattern::{matched, nearest},
    targets::{Names, POSE_NAMES, Scope, Target},
    units,
};
use crate::RecordingError;

/// Names of time columns, without their unit.
const TIME_NAMES: [&str; 6] = ["t", "time", "timestamp", "time_stamp", "stamp", "elapsed"];
/// So many names are listed in a message; the rest is counted.
const MAX_LISTED: usize = 6;

/// One column that is read.
#[derive(Clone, Debug)]
pub(super) struct Cell {
    pub(super) target: Target,
    /// What the station calls it.
    pub(super) id: String,
    /// From 0.
    pub(super) column: usize,
    /// Empty where columns have no names.
    pub(super) header: String,
    /// Unit of the file's numbers, after scale and offset.
    pub(super) unit: String,
    /// Unit of the station.
    pub(super) to_unit: String,
    pub(super) scale: f64,
    pub(super) offset: f64,
    /// Lowest plus highest reading where readings fall under load: what is kept is this minus the reading.
    pub(super) mirrored_in: Option<f64>,
}

impl Cell {
    /// Where a value is, for errors.
    pub(super) fn place(&self, line: u64) -> String {
        let Self { header, column, .. } = self;
        let header = if header.is_empty() { String::new() } else { format!("{header}, ") };
        format!("line {line}, column {} ({header}{} {:?})", column + 1, self.what(), self.id)
    }

    pub(super) fn what(&self) -> &'static str {
        self.target.what()
    }

    pub(super) fn is_channel(&self) -> bool {
        self.target.channel().is_some()
    }

    /// The station's value of a number in the file. A column that needs no conversion keeps its bits.
    pub(super) fn converted(&self, number: f64) -> f64 {
        let plain = self.scale == 1.0 && self.offset == 0.0;
        let number = if plain { number } else { number * self.scale + self.offset };
        // The units were found to agree when the column was assigned.
        let value = units::converted(number, &self.unit, &self.to_unit).unwrap_or(number);
        self.mirrored_in.map_or(value, |sum| sum - value)
    }
}

/// Where times come from.
#[derive(Clone, Debug)]
pub(super) enum TimeSource {
    Column { column: usize, header: String, unit: &'static str, offset_s: f64 },
    Rate { rate_hz: f64, offset_s: f64 },
}

/// What the columns of a file are.
#[derive(Clone, Debug)]
pub(super) struct Assignment {
    pub(super) time: TimeSource,
    pub(super) cells: Vec<Cell>,
    /// Columns of headers that nobody asked for, with the name that each may be a misspelling of.
    pub(super) ignored: Vec<(usize, String, Option<String>)>,
    pub(super) num_columns: usize,
}

/// Assigns the columns of the file at `path`. `header` is its line and cells; without one, columns go by number and
/// there are `num_columns`.
pub(super) fn assign(
    names: &Names<'_>,
    path: &Path,
    header: Option<(u64, &[String])>,
    num_columns: usize,
    scope: Scope,
    config: &FileConfig,
    mapping: Option<&Mapping>,
) -> Result<Assignment, RecordingError> {
    let assigner = Assigner { names, path, header, num_columns, scope, config, mapping };
    assigner.assign()
}

struct Assigner<'a> {
    names: &'a Names<'a>,
    path: &'a Path,
    header: Option<(u64, &'a [String])>,
    num_columns: usize,
    scope: Scope,
    config: &'a FileConfig,
    mapping: Option<&'a Mapping>,
}

impl Assigner<'_> {
    fn assign(&self) -> Result<Assignment, RecordingError> {
        let mut cells: Vec<Cell> = Vec::new();
        for map in &self.config.map {
            if map.get_ref().columns.is_some() {
                cells.extend(self.mapped(map)?);
            }
        }
        let time = self.time(&cells)?;
        let time_column = match &time {
            TimeSource::Column { column, .. } => Some(*column),
            TimeSource::Rate { .. } => None,
        };
        if let Some(cell) = cells.iter().find(|cell| Some(cell.column) == time_column) {
            let problem = format!("is the time, and mapped to {} {:?}", cell.what(), cell.id);
            return Err(self.column_error(cell.column, problem));
        }
        let mut ignored = Vec::new();
        if let Some((_, headers)) = self.header {
            let taken: Vec<usize> = cells.iter().map(|cell| cell.column).chain(time_column).collect();
            let free: Vec<usize> = (0..headers.len()).filter(|column| !taken.contains(column)).collect();
            let numbered = self.numbered(&free);
            for column in free {
                match numbered.get(&column).copied().map_or_else(
                    || self.named(column),
                    |target| self.cell(column, target, None, None).map(Some),
                )? {
                    Some(cell) => cells.push(cell),
                    None if headers[column].is_empty() => {}
                    None => {
                        ignored.push((column, headers[column].clone(), self.suggestion(&headers[column])));
                    }
                }
            }
        }
        for map in self.config.map.iter().filter(|map| map.get_ref().columns.is_none()) {
            self.refine(map, &mut cells)?;
        }
        cells.sort_by_key(|cell| cell.column);
        if let Some(pair) = cells.windows(2).find(|pair| pair[0].column == pair[1].column) {
            let problem = format!("is mapped to both {:?} and {:?}", pair[0].id, pair[1].id);
            return Err(self.column_error(pair[0].column, problem));
        }
        let mut first: BTreeMap<Target, usize> = BTreeMap::new();
        for cell in &cells {
            if let Some(earlier) = first.insert(cell.target, cell.column) {
                let problem = format!(
                    "is {} {:?} a second time, after column {}; each must be there once",
                    cell.what(),
                    cell.id,
                    earlier + 1
                );
                return Err(self.column_error(cell.column, problem));
            }
        }
        Ok(Assignment { time, cells, ignored, num_columns: self.num_columns })
    }

    fn column_error(&self, column: usize, problem: impl std::fmt::Display) -> RecordingError {
        let header = self.header.and_then(|(_, headers)| headers.get(column));
        let place = match self.header {
            Some((line, _)) => format!("line {line}, column {}", column + 1),
            None => format!("column {}", column + 1),
        };
        let name = header.map(|header| format!("{header:?} ")).unwrap_or_default();
        RecordingError::content(self.path, place, format!("{name}{problem}"))
    }

    /// The cells of a `[[file.map]]` with columns.
    fn mapped(&self, map: &Spanned<MapConfig>) -> Result<Vec<Cell>, RecordingError> {
        let config = map.get_ref();
        let targets = self.targets(map)?;
        let mut columns = Vec::new();
        for name in config.columns.as_ref().map(|columns| columns.as_slice()).unwrap_or_default() {
            match name {
                ColumnName::Header(text) if number_range(text).is_some() => {
                    let (first, last) = number_range(text).unwrap_or_default();
                    if first > last || last > self.num_columns {
                        return Err(self.map_error(
                            map,
                            "columns",
                            self.no_column(&format!("columns {text}")),
                        ));
                    }
                    columns.extend((first..=last).map(|number| number.wrapping_sub(1)));
                }
                name => columns
                    .push(self.column(name).map_err(|problem| self.map_error(map, "columns", problem))?),
            }
        }
        if let Some(&column) = columns.iter().find(|&&column| column >= self.num_columns) {
            let what = format!("column {}", column.wrapping_add(1));
            return Err(self.map_error(map, "columns", self.no_column(&what)));
        }
        if columns.len() != targets.len() {
            let problem = format!(
                "{} columns for {} names ({}); expected one for each",
                columns.len(),
                targets.len(),
                listed(targets.iter().map(|&target| self.names.id(target)))
            );
            return Err(self.map_error(map, "columns", problem));
        }
        columns
            .into_iter()
            .zip(targets)
            .map(|(column, target)| self.cell(column, target, None, Some(map)))
            .collect()
    }

    fn no_column(&self, what: &str) -> String {
        format!(
            "{}: no {what}; the file has {} columns, counted from 1",
            self.path.display(),
            self.num_columns
        )
    }

    fn map_error(&self, map: &Spanned<MapConfig>, field: &str, problem: String) -> RecordingError {
        match self.mapping {
            Some(mapping) => mapping.error(map.span(), &format!("[[file.map]] {field}"), problem),
            None => RecordingError::content(self.path, field, problem),
        }
    }

    /// Index of the column called `name`.
    fn column(&self, name: &ColumnName) -> Result<usize, String> {
        match name {
            ColumnName::Number(number) => match number.checked_sub(1) {
                Some(column) if column < self.num_columns => Ok(column),
                _ => Err(self.no_column(&format!("column {number}"))),
            },
            ColumnName::Header(text) => {
                let Some((_, headers)) = self.header else {
                    return Err(format!(
                        "{text:?}, but the file has no header; give the column's number, from 1"
                    ));
                };
                let with = |same: &dyn Fn(&str) -> bool| -> Vec<usize> {
                    (0..headers.len()).filter(|&column| same(&headers[column])).collect()
                };
                let exact = with(&|header| header == text);
                let found = if exact.is_empty() {
                    with(&|header| units::split(header, true).0 == text)
                } else {
                    exact
                };
                match found[..] {
                    [column] => Ok(column),
                    [] => {
                        let near = nearest(text, headers.iter().map(String::as_str));
                        let near = near.map(|near| format!("; is it {near:?}?")).unwrap_or_default();
                        Err(format!(
                            "{}: no column {text:?}{near} The file has {}",
                            self.path.display(),
                            listed(headers.iter().map(String::as_str))
                        ))
                    }
                    _ => Err(format!(
                        "{}: {} columns are called {text:?}; give its number",
                        self.path.display(),
                        found.len()
                    )),
                }
            }
        }
    }

    /// What a `[[file.map]]` is about.
    fn targets(&self, map: &Spanned<MapConfig>) -> Result<Vec<Target>, RecordingError> {
        let config = map.get_ref();
        let layout = &self.names.station.layout;
        let find = |field: &str, names: &[String], known: Vec<(Target, Cow<'_, str>)>| {
            let target = |name: &String| {
                known.iter().find(|(_, id)| id == name).map(|(target, _)| *target).ok_or_else(|| {
                    let problem = self.unknown(name, known.iter().map(|(_, id)| id.as_ref()));
                    self.map_error(map, field, problem)
                })
            };
            names.iter().map(target).collect::<Result<Vec<_>, _>>()
        };
        if let Some(joints) = &config.joints {
            return find("joints", joints.as_slice(), self.names.joints().collect());
        }
        if let Some(channels) = &config.channels {
            let known =
                (0..layout.num_channels()).map(Target::Channel).map(|target| (target, self.names.id(target)));
            return self.axes_of(map, find("channels", channels.as_slice(), known.collect())?);
        }
        if let Some(object) = &config.object {
            let known: Vec<(Target, &str)> = Names::pose().collect();
            let target = |name: &String| {
                let found = known.iter().find(|(_, id)| id == name).map(|&(target, _)| target);
                found.ok_or_else(|| {
                    let problem = format!(
                        "{name:?} is no number of a pose, expected some of {}",
                        POSE_NAMES.join(", ")
                    );
                    self.map_error(map, "object", problem)
                })
            };
            return object.as_slice().iter().map(target).collect();
        }
        if let Some(id) = &config.patch {
            let patch = layout.patches.iter().find(|patch| patch.id == *id).ok_or_else(|| {
                let problem = self.unknown(id, layout.patches.iter().map(|patch| patch.id.as_str()));
                self.map_error(map, "patch", problem)
            })?;
            return self.axes_of(map, patch.channels.clone().map(Target::Channel).collect());
        }
        let id = config.stream.as_deref().unwrap_or_default();
        let stream = layout.streams.iter().find(|stream| stream.id == id).ok_or_else(|| {
            self.map_error(
                map,
                "stream",
                self.unknown(id, layout.streams.iter().map(|stream| stream.id.as_str())),
            )
        })?;
        self.axes_of(map, stream.channels.clone().map(Target::Channel).collect())
    }

    /// The columns of `channels`: one for each, or one for each axis that `map` names, or for all where it names none.
    fn axes_of(
        &self,
        map: &Spanned<MapConfig>,
        channels: Vec<Target>,
    ) -> Result<Vec<Target>, RecordingError> {
        let stated = map.get_ref().axis.as_ref().map(|axis| axis.as_slice()).unwrap_or_default();
        let mut targets = Vec::new();
        for channel in channels.into_iter().filter_map(Target::channel) {
            let num_axes = self.names.num_axes(channel);
            if stated.is_empty() {
                targets.extend(self.names.of_channel(channel));
                continue;
            }
            let names = &TaxelAxes::NAMES[..num_axes];
            for name in stated {
                let axis = names.iter().position(|known| known == name).filter(|_| num_axes > 1);
                let axis = axis.ok_or_else(|| {
                    let id = &self.names.station.layout.channels[channel].id;
                    let problem = match num_axes {
                        1 => format!("channel {id:?} has one axis, which has no name; remove axis"),
                        _ => format!(
                            "channel {id:?} has no axis {name:?}, expected {}",
                            listed(names.iter().copied())
                        ),
                    };
                    self.map_error(map, "axis", problem)
                })?;
                targets.push(Target::Axis(channel, axis));
            }
        }
        Ok(targets)
    }

    fn unknown<'n>(&self, name: &str, known: impl Iterator<Item = &'n str> + Clone) -> String {
        let near = match nearest(name, known.clone()) {
            Some(near) => format!("is it {near:?}?"),
            None => format!("expected one of {}", listed(known)),
        };
        format!("station {:?} has no {name:?}; {near}", self.names.station.id)
    }

    /// A column as `map` or its header has it.
    fn cell(
        &self,
        column: usize,
        target: Target,
        stated: Option<&str>,
        map: Option<&Spanned<MapConfig>>,
    ) -> Result<Cell, RecordingError> {
        let header = self.header.and_then(|(_, headers)| headers.get(column)).cloned().unwrap_or_default();
        let to_unit = self.names.unit(target);
        // A mapped column may state its unit in the header too, unless that is the unit of what `scale` starts from.
        let of_header = units::split(&header, map.is_some()).1;
        let of_header =
            of_header.filter(|unit| map.is_none() || units::converted(1.0, unit, to_unit).is_some());
        let from_map = map.and_then(|map| map.get_ref().unit.as_deref());
        let unit = from_map.or(stated).or(of_header).unwrap_or(to_unit);
        let unit = units::known(unit).unwrap_or(unit).to_owned();
        if units::converted(1.0, &unit, to_unit).is_none() {
            let what = target.what();
            let problem = format!(
                "unit {unit:?} of {what} {:?} cannot be converted to {to_unit}; expected one of {}, or a scale in a \
                 mapping file",
                self.names.id(target),
                units::convertible_to(to_unit)
            );
            return Err(match map.filter(|_| from_map.is_some()) {
                Some(map) => self.map_error(map, "unit", problem),
                None => self.column_error(column, problem),
            });
        }
        let config = map.map(Spanned::get_ref);
        let falls = config.is_some_and(|map| map.polarity == -1);
        if let (Some(map), true, Target::Axis(..)) = (map, falls, target) {
            let problem = "-1 is for a reading, and this is an axis of one; say reading = \"normal\", normal_axis = \"-z\" in the \
                           layout, or turn the axis round with scale = -1";
            return Err(self.map_error(map, "polarity", problem.to_owned()));
        }
        Ok(Cell {
            target,
            id: self.names.id(target).into_owned(),
            column,
            header,
            unit,
            to_unit: to_unit.to_owned(),
            scale: config.map_or(1.0, |map| map.scale),
            offset: config.map_or(0.0, |map| map.offset),
            mirrored_in: self.names.range_sum(target).filter(|_| falls),
        })
    }

    /// Columns in the station's order under `q0,q1,...` or `v0,v1,...`, if all that are `free` are such.
    fn numbered(&self, free: &[usize]) -> BTreeMap<usize, Target> {
        let (prefix, targets) = match self.scope {
            Scope::Joints => ('q', self.names.of(self.scope)),
            Scope::Stream(_) => ('v', self.names.of(self.scope)),
            Scope::Object | Scope::All => return BTreeMap::new(),
        };
        let headers = self.header.map(|(_, headers)| headers).unwrap_or_default();
        let number = |column: &usize| headers[*column].strip_prefix(prefix)?.parse::<usize>().ok();
        let found: BTreeMap<usize, Target> =
            free.iter().filter_map(|column| Some((*column, targets.get(number(column)?)?.0))).collect();
        if found.len() == free.len() { found } else { BTreeMap::new() }
    }

    /// The cell of a column whose header holds a name of the station.
    fn named(&self, column: usize) -> Result<Option<Cell>, RecordingError> {
        let Some((_, headers)) = self.header else { return Ok(None) };
        let header = headers[column].as_str();
        let known = self.names.of(self.scope);
        let find = |name: &str| -> Vec<Target> {
            known.iter().filter(|(_, id)| id == name).map(|(target, _)| *target).collect()
        };
        let whole = [(header, None), units::split(header, false), units::split(header, true)];
        let by_pattern = self.config.names.iter().flat_map(|pattern| {
            whole.into_iter().filter_map(move |(name, unit)| Some((matched(pattern, name)?, unit)))
        });
        for (name, unit) in by_pattern.chain(whole) {
            match find(name)[..] {
                [] => {}
                [target] => return self.cell(column, target, unit, None).map(Some),
                _ => {
                    let problem = "is both a joint and a channel; say which in a mapping file";
                    return Err(self.column_error(column, problem));
                }
            }
        }
        Ok(None)
    }

    /// Applies a `[[file.map]]` without columns to those that were found by name.
    fn refine(&self, map: &Spanned<MapConfig>, cells: &mut [Cell]) -> Result<(), RecordingError> {
        let targets = self.targets(map)?;
        let mut num_found = 0;
        for cell in cells.iter_mut().filter(|cell| targets.contains(&cell.target)) {
            *cell = self.cell(cell.column, cell.target, Some(&cell.unit.clone()), Some(map))?;
            num_found += 1;
        }
        if num_found == 0 {
            let problem = format!(
                "{}: no column is called like one of {}; say which columns they are: columns = [...]",
                self.path.display(),
                listed(targets.iter().map(|&target| self.names.id(target)))
            );
            return Err(self.map_error(map, "columns", problem));
        }
        Ok(())
    }

    fn time(&self, cells: &[Cell]) -> Result<TimeSource, RecordingError> {
        let time = self.config.time.clone().unwrap_or_default();
        if let Some(rate_hz) = time.rate_hz {
            return Ok(TimeSource::Rate { rate_hz, offset_s: time.offset_s });
        }
        let headers = self.header.map(|(_, headers)| headers).unwrap_or_default();
        let column = match &time.column {
            Some(name) => self.column(name).map_err(|problem| match self.mapping {
                Some(mapping) => RecordingError::content(&mapping.path, "[[file]] time", problem),
                None => RecordingError::content(self.path, "time", problem),
            })?,
            None => {
                let known = self.names.of(self.scope);
                let is_time = |header: &str| {
                    let name = units::split(header, true).0.to_lowercase();
                    TIME_NAMES.contains(&name.as_str()) && !known.iter().any(|(_, id)| id == header)
                };
                let found: Vec<usize> = (0..headers.len())
                    .filter(|&column| {
                        is_time(&headers[column]) && !cells.iter().any(|cell| cell.column == column)
                    })
                    .collect();
                match found[..] {
                    [column] => column,
                    [] => {
                        let place = self.header.map_or("file".to_owned(), |(line, _)| format!("line {line}"));
                        let mut problem = "no time column, expected t_s, t_ms, t_us or t_ns (or time, timestamp, stamp, \
                                           elapsed with a unit); without one, state a rate in a mapping file: \
                                           time = { rate_hz = 100.0 }"
                            .to_owned();
                        if let [only] = headers
                            && let Some(name) = [(';', "semicolon"), ('\t', "tab"), (' ', "blanks")]
                                .iter()
                                .find_map(|&(delimiter, name)| only.contains(delimiter).then_some(name))
                        {
                            problem = format!(
                                "one column only, {only:?}; if it is {name} that separates columns, say delimiter = {name:?} in \
                                 a mapping file"
                            );
                        }
                        return Err(RecordingError::content(self.path, place, problem));
                    }
                    [first, second, ..] => {
                        let problem = format!(
                            "may be the time, as column {} {:?} may; say which in a mapping file: time = {{ column = ... }}",
                            first + 1,
                            headers[first]
                        );
                        return Err(self.column_error(second, problem));
                    }
                }
            }
        };
        let header = headers.get(column).cloned().unwrap_or_default();
        let stated = units::split(&header, true).1;
        let unit = time.unit.as_deref().or(stated).unwrap_or("s");
        match units::known(unit).filter(|unit| units::converted(1.0, unit, "s").is_some()) {
            Some(unit) => Ok(TimeSource::Column { column, header, unit, offset_s: time.offset_s }),
            None => {
                let problem =
                    format!("unit {unit:?} is none of a time, expected {}", units::convertible_to("s"));
                Err(self.column_error(column, problem))
            }
        }
    }

    /// The name that `header` may be a misspelling of.
    fn suggestion(&self, header: &str) -> Option<String> {
        let known = self.names.of(self.scope);
        let name = units::split(header, true).0;
        nearest(name, known.iter().map(|(_, id)| id.as_ref())).map(str::to_owned)
    }
}

/// `3..9` as numbers from 1, both ends included.
fn number_range(text: &str) -> Option<(usize, usize)> {
    let (first, last) = text.split_once("..")?;
    let number = |text: &str| text.trim().parse::<usize>().ok();
    number(first).zip(number(last)).filter(|&(first, _)| first > 0)
}

/// Names for a message, the first few in full.
pub(super) fn listed<T: AsRef<str>>(names: impl IntoIterator<Item = T>) -> String {
    let names: Vec<T> = names.into_iter().collect();
    let mut text = names
        .iter()
        .take(MAX_LISTED)
        .map(|name| format!("{:?}", name.as_ref()))
        .collect::<Vec<_>>()
        .join(", ");
    match names.len().saturating_sub(MAX_LISTED) {
        0 => {}
        more => text += &format!(" and {more} more"),
    }
    text
}
