//! Patches and streams as people ask for them, and where on a link a patch goes.

use std::{fmt::Write as _, str::FromStr};

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;

use super::explain::bounds;
use crate::{
    AxesReading, ModelError, Robot, SensorKind, TaxelAxes,
    config::{Source, check_id, finite, list, positive},
    layout::taxel_axes,
};

/// How far a patch may reach beyond the shape of its link before that is worth a warning, m.
const SLACK_M: f64 = 0.003;
/// Shortest and longest side of a patch, mm.
const SIDES_MM: [f64; 2] = [0.1, 2000.0];

/// The skin of a new station, as a file holds it.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SkinConfig {
    /// `[[stream]]`; none where the command line describes the only one.
    #[serde(default, rename = "stream")]
    pub streams: Vec<NewStream>,
    /// `[[patch]]`.
    #[serde(default, rename = "patch")]
    pub patches: Vec<NewPatch>,
}

impl SkinConfig {
    /// Reads the file called `file`.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, ModelError> {
        let source = Source { file, text };
        let config: Self = source.parse()?;
        if config.patches.is_empty() {
            return Err(source.error_at("whole file", "no [[patch]], expected at least one"));
        }
        Ok(config)
    }
}

/// A stream of a new station. What is left out has a value that is usual.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewStream {
    /// Id: letters, digits, `_` and `-`. Its file of a recording is called so.
    pub id: String,
    /// Name for people; made from the id.
    #[serde(default)]
    pub label: Option<String>,
    /// How its sensors turn contact into a reading.
    #[serde(default = "pressure", deserialize_with = "kind")]
    pub kind: SensorKind,
    /// Nominal rate, Hz.
    #[serde(default = "default_rate_hz")]
    pub rate_hz: f64,
    /// Unit of readings.
    #[serde(default = "default_unit")]
    pub unit: String,
    /// How many numbers a taxel measures; 1.
    #[serde(default)]
    pub axes: Option<usize>,
    /// How several become the one reading; `normal` where `normal_axis` is said, else `norm`.
    #[serde(default)]
    pub reading: Option<AxesReading>,
    /// The axis along the outward normal, with a minus where pressing makes it fall.
    #[serde(default)]
    pub normal_axis: Option<String>,
    /// Lowest reading that the device can give.
    #[serde(default)]
    pub raw_min: f64,
    /// Highest reading that the device can give.
    #[serde(default = "default_raw_max")]
    pub raw_max: f64,
    /// A channel is on above its reference plus this; a fiftieth of the range.
    #[serde(default)]
    pub on_threshold: Option<f64>,
    /// And off again below this; three quarters of `on_threshold`.
    #[serde(default)]
    pub off_threshold: Option<f64>,
}

fn pressure() -> SensorKind {
    SensorKind::Pressure
}

fn default_rate_hz() -> f64 {
    100.0
}

fn default_unit() -> String {
    "counts".to_owned()
}

fn default_raw_max() -> f64 {
    4095.0
}

fn kind<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<SensorKind, D::Error> {
    #[derive(Deserialize)]
    #[serde(rename_all = "snake_case")]
    enum Kind {
        Pressure,
        Proximity,
    }
    Ok(match Kind::deserialize(deserializer)? {
        Kind::Pressure => SensorKind::Pressure,
        Kind::Proximity => SensorKind::Proximity,
    })
}

impl NewStream {
    /// A stream of pressure readings, in counts of 12 bits at 100 Hz.
    pub fn pressure(id: &str) -> Self {
        Self {
            id: id.to_owned(),
            label: None,
            kind: SensorKind::Pressure,
            rate_hz: default_rate_hz(),
            unit: default_unit(),
            axes: None,
            reading: None,
            normal_axis: None,
            raw_min: 0.0,
            raw_max: default_raw_max(),
            on_threshold: None,
            off_threshold: None,
        }
    }

    /// The axes of its taxels.
    pub(super) fn taxel_axes(&self) -> Result<TaxelAxes, String> {
        let usual = || match (self.axes, &self.normal_axis) {
            (None | Some(0 | 1), None) => None,
            (_, Some(_)) => Some(AxesReading::Normal),
            (_, None) => Some(AxesReading::Norm),
        };
        taxel_axes(self.axes, self.reading.or_else(usual), self.normal_axis.as_deref())
    }

    /// Thresholds, on and off.
    pub(super) fn thresholds(&self) -> [f64; 2] {
        let on = self.on_threshold.unwrap_or_else(|| two_digits((self.raw_max - self.raw_min) / 50.0));
        [on, self.off_threshold.unwrap_or_else(|| two_digits(on * 0.75))]
    }

    /// Refuses numbers that make no sense.
    pub(super) fn check(&self) -> Result<(), String> {
        check_id("id", &self.id)?;
        if self.id == "joints" {
            return Err("is called as the joint log of a recording; take another name".to_owned());
        }
        self.taxel_axes()?;
        positive("rate_hz", self.rate_hz)?;
        finite("raw_min", self.raw_min)?;
        finite("raw_max", self.raw_max)?;
        let range = self.raw_max - self.raw_min;
        if !(range.is_finite() && range > 0.0) {
            return Err(format!(
                "raw_min {} and raw_max {}: expected the lower one first",
                self.raw_min, self.raw_max
            ));
        }
        let [on, off] = self.thresholds();
        if !(on > 0.0 && on < range) {
            return Err(format!(
                "on_threshold is {on}, expected above 0 and below raw_max - raw_min, which is {range}"
            ));
        }
        if !(off > 0.0 && off <= on) {
            return Err(format!("off_threshold is {off}, expected above 0 and at most on_threshold, {on}"));
        }
        Ok(())
    }
}

/// `value`, which is positive, with two digits.
fn two_digits(value: f64) -> f64 {
    let unit = 10_f64.powf(value.log10().floor() - 1.0);
    let rounded = (value / unit).round() * unit;
    // A product such as 82 * 0.1 has an error in its last digit, which its text has not.
    let text = format!("{rounded:.9e}").parse().unwrap_or(rounded);
    if f64::is_finite(text) && text > 0.0 { text } else { value }
}

/// A rectangular patch of skin on a link.
///
/// As text: `NAME=LINK:ROWSxCOLUMNS@LENGTHxWIDTH`, then `:DIRECTION` and `:X,Y,Z`, which may be left out. Sizes and offset
/// are in mm.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewPatch {
    /// Id: letters, digits, `_` and `-`. Channels are called `ID.0`, `ID.1`, ..., or `ID` where there is one.
    pub id: String,
    /// Name for people; made from the id.
    #[serde(default)]
    pub label: Option<String>,
    /// Finger or part of the palm; made from the URDF.
    #[serde(default)]
    pub group: Option<String>,
    /// Its stream; the first if it names none.
    #[serde(default)]
    pub stream: Option<String>,
    /// Link that it is fixed to.
    pub link: String,
    /// Rows, which follow each other along the link, and columns.
    pub taxels: [usize; 2],
    /// Length along the rows' way and width, mm.
    pub size_mm: [f64; 2],
    /// Which way it faces, in the link's frame.
    #[serde(default)]
    pub outward: Outward,
    /// How far its middle is from the middle of the link's face, in the link's frame, mm.
    #[serde(default)]
    pub offset_mm: [f64; 3],
}

/// A direction along an axis of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub struct Outward {
    axis: usize,
    positive: bool,
}

impl Default for Outward {
    fn default() -> Self {
        Self { axis: 2, positive: true }
    }
}

impl Outward {
    fn vector(self) -> Vector3<f64> {
        let mut vector = Vector3::zeros();
        vector[self.axis] = if self.positive { 1.0 } else { -1.0 };
        vector
    }
}

impl FromStr for Outward {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (positive, axis) = match text.as_bytes() {
            [b'-', axis] => (false, *axis),
            [b'+', axis] | [axis] => (true, *axis),
            _ => (true, 0),
        };
        match b"xyz".iter().position(|&known| known == axis) {
            Some(axis) => Ok(Self { axis, positive }),
            None => Err(format!("direction {text:?}, expected one of +x, -x, +y, -y, +z, -z")),
        }
    }
}

impl TryFrom<String> for Outward {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl FromStr for NewPatch {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let form = |problem: &str| {
            format!(
                "{problem}; expected NAME=LINK:ROWSxCOLUMNS@LENGTHxWIDTH[:DIRECTION[:X,Y,Z]], in mm, as in \
                 index_tip=index_distal:4x3@20x15:-z"
            )
        };
        let (id, rest) = text.split_once('=').ok_or_else(|| form("no = in it"))?;
        let parts: Vec<&str> = rest.split(':').collect();
        // Names of links may have colons, so what looks like a grid is looked for from the end.
        let grid = parts.iter().rposition(|part| part.contains('@')).filter(|&at| at > 0);
        let grid = grid.ok_or_else(|| form("no LINK:ROWSxCOLUMNS@LENGTHxWIDTH after the ="))?;
        let (taxels, size) = parts[grid].split_once('@').unwrap_or_default();
        let size = size.trim_end_matches("mm").trim_end_matches('_');
        let taxels: [usize; 2] = pair(taxels)
            .ok_or_else(|| form(&format!("{taxels:?} is no number of rows and columns, such as 4x3")))?;
        let size_mm: [f64; 2] = pair(size)
            .ok_or_else(|| form(&format!("{size:?} is no length and width in mm, such as 20x15")))?;
        let outward = parts.get(grid + 1).map_or(Ok(Outward::default()), |text| text.parse())?;
        let offset_mm = match parts.get(grid + 2) {
            None => [0.0; 3],
            Some(text) => {
                let numbers: Vec<f64> =
                    text.split(',').filter_map(|number| number.trim().parse().ok()).collect();
                <[f64; 3]>::try_from(numbers)
                    .map_err(|_| form(&format!("{text:?} is no offset in mm, such as 0,0,2.5")))?
            }
        };
        if parts.len() > grid + 3 {
            return Err(form(&format!("{:?} is too much", parts[grid + 3])));
        }
        Ok(Self {
            id: id.trim().to_owned(),
            label: None,
            group: None,
            stream: None,
            link: parts[..grid].join(":"),
            taxels,
            size_mm,
            outward,
            offset_mm,
        })
    }
}

/// `AxB`.
fn pair<T: FromStr>(text: &str) -> Option<[T; 2]> {
    let (a, b) = text.split_once(['x', '*'])?;
    Some([a.trim().parse().ok()?, b.trim().parse().ok()?])
}

impl NewPatch {
    /// Refuses sizes that make no sense.
    pub(super) fn check(&self, kind: SensorKind) -> Result<(), String> {
        check_id("name", &self.id)?;
        let [rows, columns] = self.taxels;
        if rows == 0 || columns == 0 {
            return Err(format!("has {rows} x {columns} taxels, expected at least 1 x 1"));
        }
        if kind == SensorKind::Proximity && (rows, columns) != (1, 1) {
            return Err(format!(
                "has {rows} x {columns} taxels, but a proximity patch has one reading; make a patch of each, or the stream's \
                 kind pressure"
            ));
        }
        for (name, side_mm) in ["length", "width"].into_iter().zip(self.size_mm) {
            if !(SIDES_MM[0]..=SIDES_MM[1]).contains(&side_mm) {
                let [min, max] = SIDES_MM;
                return Err(format!("{name} is {side_mm} mm, expected {min} to {max} mm"));
            }
        }
        if !self.offset_mm.iter().all(|mm| mm.abs() <= 1e5) {
            return Err(format!("offset {:?} mm, expected at most 100 m", self.offset_mm));
        }
        Ok(())
    }

    /// Length and width, m.
    fn size_m(&self) -> [f64; 2] {
        self.size_mm.map(|mm| mm / 1e3)
    }

    /// Taxels in the patch, m: row by row from its lower end, in a row from left to right as seen from outside with the
    /// upper end up.
    pub(super) fn taxels_m(&self) -> Vec<[f64; 2]> {
        let ([rows, columns], [length_m, width_m]) = (self.taxels, self.size_m());
        let at = |idx: usize, count: usize, side_m: f64| ((idx as f64 + 0.5) / count as f64 - 0.5) * side_m;
        (0..rows)
            .flat_map(|row| {
                (0..columns).map(move |column| [at(row, rows, length_m), -at(column, columns, width_m)])
            })
            .collect()
    }

    /// How densely contact is computed, m: 2 mm, finer between taxels that are near each other, coarser where that would be
    /// too many nodes.
    pub(super) fn node_spacing_m(&self) -> f64 {
        let ([rows, columns], [length_m, width_m]) = (self.taxels, self.size_m());
        let pitch_m = (length_m / rows as f64).min(width_m / columns as f64);
        let coarsest = (length_m * width_m / 4000.0).sqrt();
        let spacing_m = (pitch_m / 2.0).clamp(0.0005, 0.002).max(coarsest);
        // A strip has as many nodes as its length has pieces, whatever its area.
        let spacing_m = spacing_m.max(length_m.max(width_m) / 4000.0);
        (spacing_m * 1e5).ceil() / 1e5
    }
}

/// Pose in its link of a patch that `wanted` describes; warns where it does not lie on the shape of the link.
pub(super) fn place(
    wanted: &NewPatch,
    robot: &Robot,
    urdf_file: &str,
    warnings: &mut Vec<String>,
) -> Result<Isometry3<f64>, ModelError> {
    let Some(link_idx) = robot.link_index(&wanted.link) else {
        let near = near(&wanted.link, robot.links.iter().map(|link| link.name.as_str()));
        let problem = format!("{urdf_file} has no link {:?}; nearest are {}", wanted.link, list(near));
        return Err(ModelError::new("new station", format!("patch {:?}", wanted.id), problem));
    };
    let bounds = bounds(&robot.links[link_idx]);
    let normal = wanted.outward.vector();
    let [min, max] = bounds.unwrap_or([Point3::origin(); 2]);
    let mut middle = nalgebra::center(&min, &max);
    middle[wanted.outward.axis] =
        if wanted.outward.positive { max[wanted.outward.axis] } else { min[wanted.outward.axis] };
    let middle = middle + Vector3::from(wanted.offset_mm) / 1e3;
    // The way to the next joint, or to the middle of a link that has none.
    let next = robot.joints.iter().find(|joint| joint.parent_link == link_idx);
    let way =
        next.map_or(nalgebra::center(&min, &max).coords, |joint| joint.parent_from_joint.translation.vector);
    let along = along(wanted.outward.axis, way, max - min);
    let turn = Matrix3::from_columns(&[along, normal.cross(&along), normal]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turn));
    let link_from_patch = Isometry3::from_parts(Translation3::from(middle.coords), rotation);
    let place = format!("patch {:?} on link {:?}", wanted.id, wanted.link);
    if bounds.is_none() {
        warnings
            .push(format!("{place}: the link has no shape, so its pose is the link's origin; correct it"));
        return Ok(link_from_patch);
    }
    let [half_length_m, half_width_m] = wanted.size_m().map(|side_m| side_m / 2.0);
    let mut beyond_m = 0.0_f64;
    for (x, y) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
        let corner = link_from_patch * Point3::new(x * half_length_m, y * half_width_m, 0.0);
        for axis in 0..3 {
            beyond_m = beyond_m.max(min[axis] - corner[axis]).max(corner[axis] - max[axis]);
        }
    }
    if beyond_m > SLACK_M {
        let mut text =
            format!("{place}: reaches {:.1} mm beyond the box around the link's shape, ", beyond_m * 1e3);
        let size = (max - min) * 1e3;
        let _ = write!(
            text,
            "{:.1} x {:.1} x {:.1} mm; is it on the right link and side?",
            size.x, size.y, size.z
        );
        warnings.push(text);
    }
    let inside_m = (if wanted.outward.positive { max } else { min } - middle).dot(&normal);
    if inside_m > SLACK_M {
        warnings.push(format!(
            "{place}: lies {:.1} mm inside the link's shape; its offset leads inwards",
            inside_m * 1e3
        ));
    }
    Ok(link_from_patch)
}

/// The axis, other than that of the normal, which points most to where `way` leads; the longest side of the shape where it
/// leads nowhere.
fn along(normal_axis: usize, way: Vector3<f64>, size: Vector3<f64>) -> Vector3<f64> {
    let axes = || (0..3).filter(|&axis| axis != normal_axis);
    let longest = |of: &Vector3<f64>| {
        // The first of equal ones.
        axes().rev().max_by(|&a, &b| of[a].abs().total_cmp(&of[b].abs())).unwrap_or(0)
    };
    let axis = longest(&way);
    let mut along = Vector3::zeros();
    if way[axis].abs() > 1e-6 {
        along[axis] = way[axis].signum();
    } else {
        along[longest(&size)] = 1.0;
    }
    along
}

/// The finger or part of the palm that a link belongs to: the link that begins it, after the last one with several joints.
pub(super) fn group_of(robot: &Robot, link: &str) -> String {
    let mut at = robot.link_index(link).unwrap_or(0);
    // Joint i moves link i + 1.
    while let Some(joint) = at.checked_sub(1).map(|idx| &robot.joints[idx]) {
        let siblings = robot.joints.iter().filter(|other| other.parent_link == joint.parent_link).count();
        if siblings > 1 || joint.parent_link == 0 {
            break;
        }
        at = joint.parent_link;
    }
    robot.links[at].name.clone()
}

/// `index_tip` as `Index tip`.
pub(super) fn label_of(id: &str) -> String {
    let text = id.replace(['_', '-'], " ");
    let mut chars = text.chars();
    chars.next().map(|first| first.to_uppercase().chain(chars).collect()).unwrap_or_default()
}

/// Up to five of `known` that are most like `name`.
pub(super) fn near<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut known: Vec<&str> = known.collect();
    known.sort_by_cached_key(|other| distance(name, other));
    known.truncate(5);
    known
}

/// How many characters have to be put in, left out or replaced.
fn distance(a: &str, b: &str) -> usize {
    let plain = |text: &str| text.to_lowercase().chars().take(64).collect::<Vec<char>>();
    let (a, b) = (plain(a), plain(b));
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (idx_a, char_a) in a.iter().enumerate() {
        let mut before = row[0];
        row[0] = idx_a + 1;
        for (idx_b, char_b) in b.iter().enumerate() {
            let replaced = before + usize::from(char_a != char_b);
            before = row[idx_b + 1];
            row[idx_b + 1] = replaced.min(before + 1).min(row[idx_b] + 1);
        }
    }
    row[b.len()]
}
