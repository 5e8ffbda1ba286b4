//! A robot, an object and a sensor model, read from files.

use std::path::Path;
use std::sync::Arc;

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use palpate_robot_model::{ObjectModel, ObjectPath, ObjectShape, Station};
use palpate_sim::SensorModel;
use palpate_sim::effects::TakeScene;
use palpate_sim::geometry::SignedDistance;
use palpate_sim::live::LiveScene;
use palpate_sim::replay::{ReplayError, contact_trace};
use palpate_sim::tactile::Readings;

use crate::TouchError;

/// A robot, the object that it touches, things that stand still, and how its skin feels them.
#[derive(Debug)]
pub struct TouchScene {
    station: Arc<Station>,
    object: ObjectModel,
    model: SensorModel,
    fixed: Vec<(Isometry3<f64>, ObjectShape)>,
    live: Arc<LiveScene>,
}

/// Something that stands still: an object as [`TouchScene::open`] takes it, and its pose as [`pose`] does.
#[derive(Clone, Debug)]
pub struct FixedBody<'a> {
    /// Id of an object of the station, or the path of its file.
    pub object: &'a str,
    /// Its pose in the base.
    pub base_from_body: [f64; 7],
}

impl TouchScene {
    /// Reads the station at the path `station` with everything that it names. `model` is the name and the text of a sensor
    /// model's file (`None`: the station's nominal model), `object` the id of an object of the station or the path of an
    /// object's file.
    pub fn open(
        station: &str,
        model: Option<(&str, &str)>,
        object: &str,
        fixed: &[FixedBody<'_>],
    ) -> Result<Self, TouchError> {
        let path = Path::new(station);
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        let name = path.file_name().and_then(|name| name.to_str());
        let name = name.ok_or_else(|| {
            TouchError::File(format!(
                "station {station:?} names no file, expected the path of a station's TOML"
            ))
        })?;
        let read = |file: &str| std::fs::read(folder.join(file)).map_err(|err| err.to_string());
        let station = Station::read(name, read).map_err(|err| {
            TouchError::File(format!("station in {:?}: {err}", folder.display().to_string()))
        })?;
        let (file, text) = model.unwrap_or(("nominal model", &station.nominal_model_toml));
        let model = SensorModel::from_toml(file, text).map_err(|err| TouchError::File(err.to_string()))?;
        let object = find_object(&station, object)?;
        let fixed = fixed
            .iter()
            .enumerate()
            .map(|(idx, body)| {
                let base_from_body = pose(&body.base_from_body)
                    .map_err(|problem| TouchError::Input(format!("fixed body {idx}: {problem}")))?;
                Ok((base_from_body, find_object(&station, body.object)?.shape))
            })
            .collect::<Result<Vec<_>, TouchError>>()?;
        let station = Arc::new(station);
        let live =
            LiveScene::new(Arc::clone(&station), &object, &model, &fixed).map_err(|err| match err {
                ReplayError::Model(problem) => TouchError::File(problem),
                other => TouchError::File(format!("object {:?}: {other}", object.id)),
            })?;
        Ok(Self { station, object, model, fixed, live: Arc::new(live) })
    }

    /// Its station.
    pub fn station(&self) -> &Station {
        &self.station
    }

    /// The object that is touched.
    pub fn object(&self) -> &ObjectModel {
        &self.object
    }

    /// Its sensor model.
    pub fn model(&self) -> &SensorModel {
        &self.model
    }

    /// What stands still: base_from_body and shape.
    pub fn fixed(&self) -> &[(Isometry3<f64>, ObjectShape)] {
        &self.fixed
    }

    /// What environments share.
    pub fn live(&self) -> &Arc<LiveScene> {
        &self.live
    }

    /// Readings of a whole take, as `palpate replay` computes them: `positions` has a row of joint positions for each of
    /// `times_s`, and the object stays at `base_from_object` ([`pose`]).
    ///
    /// Refuses a scene with things that stand still, which takes do not have.
    pub fn replay(
        &self,
        times_s: &[f64],
        positions: &[f64],
        base_from_object: &[f64; 7],
    ) -> Result<Readings, TouchError> {
        if !self.fixed.is_empty() {
            let problem =
                "a replay knows one object and nothing that stands still; open a scene without fixed bodies";
            return Err(TouchError::Input(problem.to_owned()));
        }
        let base_from_object = ObjectPath::Still(pose(base_from_object).map_err(TouchError::Input)?);
        let num_dofs = self.station.robot.num_dofs();
        if positions.len() != times_s.len() * num_dofs {
            return Err(TouchError::Input(format!(
                "{} joint positions for {} frames, expected {num_dofs} for each",
                positions.len(),
                times_s.len()
            )));
        }
        let mut before_s = f64::NEG_INFINITY;
        for (frame, &time_s) in times_s.iter().enumerate() {
            if !(time_s > before_s && time_s.is_finite()) {
                let error = ReplayError::TimeNotIncreasing { time_s, before_s };
                return Err(TouchError::of("frame", frame, &error));
            }
            before_s = time_s;
        }
        let fail = |error: ReplayError| match error {
            ReplayError::NonFinitePosition { frame, .. } => TouchError::of("frame", frame, &error),
            other => TouchError::Input(other.to_string()),
        };
        let distance = SignedDistance::new(&self.object.shape).map_err(TouchError::File)?;
        let contact =
            contact_trace(&self.station.robot, &self.station.layout, &distance, &base_from_object, positions)
                .map_err(fail)?;
        let take = TakeScene {
            station: &self.station,
            object: &self.object,
            base_from_object: &base_from_object,
            surroundings: &[],
            frame_times_s: times_s,
            positions,
            arrival_times_s: &[],
            frozen_for_s: &[],
            tares: &[],
        };
        self.model.readings(&take, &contact).map_err(fail)
    }
}

/// How far the norm of a quaternion may be from 1.
const MAX_NORM_ERROR: f64 = 1e-3;

/// A pose from its position in m and its unit quaternion, scalar first: `x y z qw qx qy qz`.
pub(crate) fn pose(values: &[f64; 7]) -> Result<Isometry3<f64>, String> {
    let [x, y, z, qw, qx, qy, qz] = *values;
    if !values.iter().all(|value| value.is_finite()) {
        return Err(format!("pose {values:?} must be finite"));
    }
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    if (quaternion.norm() - 1.0).abs() > MAX_NORM_ERROR {
        return Err(format!(
            "pose {values:?} has a quaternion of norm {}, expected 1: x y z qw qx qy qz, scalar first",
            quaternion.norm()
        ));
    }
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(quaternion)))
}

fn find_object(station: &Station, name: &str) -> Result<ObjectModel, TouchError> {
    if let Some(object) = station.objects.get(name) {
        return Ok(object.clone());
    }
    let path = Path::new(name);
    let text = std::fs::read_to_string(path).map_err(|err| {
        let known: Vec<&str> = station.objects.keys().map(String::as_str).collect();
        TouchError::File(format!(
            "object {name:?} is none of station {:?} (it has {}), and no file that can be read: {err}",
            station.id,
            known.join(", ")
        ))
    })?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let mesh = |file: &str| std::fs::read(folder.join(file)).map_err(|err| err.to_string());
    ObjectModel::from_toml(name, &text, mesh).map_err(|err| TouchError::File(err.to_string()))
}
