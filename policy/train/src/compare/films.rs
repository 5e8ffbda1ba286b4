//! Films of single trials: a session of takes that the studio plays back and `palpate session check` opens.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use anyhow::{Context as _, bail};
use nalgebra::Isometry3;
use palpate_grasp::trial::Ending;
use palpate_grasp::{GraspEnv, GraspScene};
use palpate_recording::{
    LogLevel, SessionDraft, SessionFile, SessionTake, Span, SpanKind, TactileSampleRef, TakeMeta, TakeWriter,
};
use palpate_robot_model::Station;

use crate::files::ObjectFiles;

/// Takes begin here, one after the other: a film's bytes depend on its trial alone, not on when it was made.
const START_UNIX_NS: u64 = 1_767_225_600_000_000_000;
/// The same for people.
const START: &str = "2026-01-01T00:00:00Z";
/// Between the beginnings of two takes: longer than any trial.
const BETWEEN_NS: u64 = 3_600_000_000_000;
/// Nothing is touched for at least half the time before the first touch; of that, so much is the take's baseline, s.
const BASELINE_S: f64 = 0.5;
const SOFTWARE: &str = concat!("palpate-train ", env!("CARGO_PKG_VERSION"));

/// A session in the making.
pub(super) struct Films {
    draft: SessionDraft,
    films: Vec<Film>,
    /// Files of the objects in them, by id.
    objects: BTreeMap<String, ObjectFiles>,
}

/// A trial as it went.
pub(super) struct Film {
    file: String,
    object: String,
    policy: String,
    control_rate_hz: f64,
    /// Whether readings are those of devices, and not distances and pressures.
    has_raw: bool,
    moments: Vec<Moment>,
    ending: String,
}

/// After a control step.
struct Moment {
    time_ns: u64,
    positions: Vec<f64>,
    /// Where joints were sent in the step before.
    targets: Vec<f64>,
    raw: Vec<f32>,
    active: Vec<bool>,
    base_from_object: Isometry3<f64>,
}

impl Film {
    /// A film called `name` of a trial of `policy`, of which nothing has been seen.
    pub(super) fn new(name: &str, policy: &str, scene: &GraspScene) -> Self {
        Self {
            file: format!("{name}.mcap"),
            object: scene.object().id.clone(),
            policy: policy.to_owned(),
            control_rate_hz: scene.config().control_rate_hz,
            has_raw: scene.reads_raw_units(),
            moments: Vec::new(),
            ending: String::new(),
        }
    }

    pub(super) fn see(&mut self, env: &GraspEnv) {
        let readings = env.readings();
        let raw =
            if self.has_raw { readings.raw.iter().map(|raw| *raw as f32).collect() } else { Vec::new() };
        self.moments.push(Moment {
            time_ns: (env.time_s() * 1e9).round() as u64,
            positions: env.positions().to_vec(),
            targets: env.targets().to_vec(),
            raw,
            active: readings.active.clone(),
            base_from_object: env.world().base_from_object(),
        });
    }

    /// How it ended.
    pub(super) fn end(&mut self, ending: &Ending) {
        let verdict = if ending.is_won() { "won" } else { "lost" };
        let outcome = serde_json::to_value(ending.outcome).ok();
        let outcome = outcome.as_ref().and_then(|outcome| outcome.as_str()).unwrap_or_default().to_owned();
        self.ending = format!("{verdict}: {outcome}");
    }

    /// A span at the start in which nothing is touched.
    fn baseline(&self) -> Span {
        let touched = self.moments.iter().find(|moment| moment.active.contains(&true));
        let touched_s = touched.map_or(f64::INFINITY, |moment| 1e-9 * moment.time_ns as f64);
        let end_s = BASELINE_S.min(0.5 * touched_s).max(0.5 / self.control_rate_hz);
        Span { kind: SpanKind::Baseline, start_s: 0.0, end_s, label: String::new() }
    }

    fn write(&self, path: &Path, station: &Station, take_idx: usize) -> anyhow::Result<()> {
        let file = File::create(path).with_context(|| format!("failed to create {path:?}"))?;
        let Some(first) = self.moments.first() else { bail!("nothing was seen of the trial of {path:?}") };
        let meta = TakeMeta {
            object: self.object.clone(),
            base_from_object: first.base_from_object,
            primitive: "grasp".to_owned(),
            // The simulator knows where the object is.
            fixture_trusted: true,
            operator: self.policy.clone(),
            software: SOFTWARE.to_owned(),
            surroundings: Vec::new(),
        };
        let start_unix_ns = START_UNIX_NS + take_idx as u64 * BETWEEN_NS;
        let mut writer = TakeWriter::new(BufWriter::new(file), station, &meta, start_unix_ns)?;
        writer.log(0, LogLevel::Info, "palpate-train evaluate", &self.ending)?;
        writer.span(&self.baseline())?;
        let mut before_ns = None;
        for moment in &self.moments {
            // What a step is sent, it is sent at its beginning.
            if let Some(before_ns) = before_ns.replace(moment.time_ns) {
                writer.commands(before_ns, &moment.targets)?;
            }
            writer.joints(moment.time_ns, &moment.positions)?;
            writer.object_pose(moment.time_ns, &moment.base_from_object)?;
            for (stream_idx, stream) in station.layout.streams.iter().enumerate() {
                let raw = if self.has_raw { &moment.raw[stream.channels.clone()] } else { &[] };
                let active = &moment.active[stream.channels.clone()];
                let sample = TactileSampleRef { raw, active, device_time_ns: 0 };
                writer.tactile(stream_idx, moment.time_ns, sample)?;
            }
        }
        let end_s = self.moments.last().map_or(0.0, |moment| 1e-9 * moment.time_ns as f64);
        let step_s = 1.0 / self.control_rate_hz;
        let verdict = Span {
            kind: SpanKind::Note,
            start_s: (end_s - step_s).max(0.0),
            end_s: end_s.max(step_s),
            label: self.ending.clone(),
        };
        writer.span(&verdict)?;
        writer.finish()?;
        Ok(())
    }
}

impl Films {
    /// A session that will lie at `dir`, which must not exist yet.
    pub(super) fn begin(dir: &Path) -> anyhow::Result<Self> {
        let draft = SessionDraft::new(dir).context("--films")?;
        Ok(Self { draft, films: Vec::new(), objects: BTreeMap::new() })
    }

    /// Keeps what is needed to show `object` in films.
    pub(super) fn know(&mut self, object: String, files: ObjectFiles) {
        self.objects.insert(object, files);
    }

    /// Adds a film, unless there is one of the same policy, object and end.
    pub(super) fn add(&mut self, film: Film) {
        if self.films.iter().all(|other| other.file != film.file) {
            self.films.push(film);
        }
    }

    /// Writes all films, and the session.
    pub(super) fn finish(self, station: &Station) -> anyhow::Result<()> {
        let Self { draft, films, objects } = self;
        let Some(first) = films.first() else { bail!("--films: there is no trial to be filmed") };
        let station = filmed_station(station, &objects, first.control_rate_hz)?;
        for (take_idx, film) in films.iter().enumerate() {
            film.write(&draft.partial_dir().join(&film.file), &station, take_idx)?;
        }
        let takes = films.iter().map(|film| SessionTake {
            file: film.file.clone(),
            object: film.object.clone(),
            accepted: true,
        });
        draft.commit(SessionFile {
            format: 1,
            station: station.id.clone(),
            recorded: START.to_owned(),
            takes: takes.collect(),
        })?;
        Ok(())
    }
}

/// `station` with the objects of the films and their rate: the grasp world looks at joints and skin once a control step.
fn filmed_station(
    station: &Station,
    objects: &BTreeMap<String, ObjectFiles>,
    rate_hz: f64,
) -> anyhow::Result<Station> {
    let mut files = station.files.clone();
    let mut about: toml::Table = files.station_toml.parse().context("the station file")?;
    about.insert("joint_rate_hz".to_owned(), rate_hz.into());
    let listed = about.get_mut("objects").and_then(|objects| objects.as_array_mut());
    let listed = listed.context("the station file has no list of objects")?;
    for (id, own) in objects {
        if station.objects.contains_key(id) {
            if files.files.values().any(|bytes| bytes == own.text.as_bytes()) {
                continue;
            }
            bail!(
                "--films: station {:?} has another object called {id:?} than the one that is grasped; give one of them \
                 another id",
                station.id
            );
        }
        // A folder of its own: paths in there mean what they mean beside the object's file.
        let folder = format!("filmed/{id}");
        let path = format!("{folder}/object.toml");
        files.files.insert(path.clone(), own.text.clone().into_bytes());
        for (mesh, bytes) in &own.meshes {
            files.files.insert(format!("{folder}/{mesh}"), bytes.clone());
        }
        listed.push(path.into());
    }
    let layout_path = about.get("layout").and_then(|layout| layout.as_str()).unwrap_or_default().to_owned();
    let layout = files.files.get_mut(&layout_path).context("the station has no layout")?;
    let mut table: toml::Table =
        std::str::from_utf8(layout)?.parse().with_context(|| format!("layout {layout_path:?}"))?;
    let streams = table.get_mut("stream").and_then(|streams| streams.as_array_mut());
    for stream in streams.into_iter().flatten() {
        if let Some(stream) = stream.as_table_mut() {
            stream.insert("rate_hz".to_owned(), rate_hz.into());
        }
    }
    *layout = toml::to_string(&table)?.into_bytes();
    files.station_toml = toml::to_string(&about)?;
    Ok(Station::from_files(files)?)
}
