//! The features of an encoder, or the points of a hand, for the frames of trials that were kept.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::Context as _;
use palpate_cloning::{CloneConfig, EncoderFile, Episode, Episodes, Robot, Shape};
use palpate_grasp::GraspConfig;
use palpate_robot_model::Station;
use palpate_rollout::features::{FeatureRun, Features};
use palpate_sim::job::{Cancel, Progress as _};
use palpate_terminal::Bar;
use rayon::prelude::*;

use crate::files;
use crate::gather::Gathered;
use crate::origin::{Origin, check_same_world};

fn origin((path, gathered): &(String, Gathered)) -> Origin<'_> {
    Origin { what: "trials", place: Path::new(path), sources: gathered.record.sources() }
}

/// The station that `gathered` were made with, and its world.
fn scene_of(gathered: &[(String, Gathered)]) -> anyhow::Result<(Arc<Station>, GraspConfig)> {
    let first = origin(gathered.first().context("--data names no folder")?);
    check_same_world(gathered.iter().map(origin))?;
    let station = Arc::new(first.station()?);
    let world = first.world(&station)?;
    Ok((station, world))
}

/// What makes features for the robot of some trials.
pub(super) struct Encoding {
    /// Nothing where features are the points themselves.
    file: Option<Arc<EncoderFile>>,
    features: Arc<Features>,
}

impl Encoding {
    /// The encoder at `path`, a file or a pretraining's folder, for the station that `gathered` were made with.
    ///
    /// # Errors
    /// Files that are no encoder or that do not fit; trials of several stations, or whose station has changed since.
    pub(super) fn open(
        path: &Path,
        config: &CloneConfig,
        gathered: &[(String, Gathered)],
    ) -> anyhow::Result<Self> {
        let encoder = crate::export::encoder(path)?;
        // What the policy brings along has 16 bits, so that is what it learns with.
        let bytes = encoder.to_bytes()?;
        let sha256 = files::sha256(&bytes);
        let file = Arc::new(EncoderFile { bytes, sha256, num_features: encoder.width() });
        let (station, world) = scene_of(gathered)?;
        let features = Features::new(&file, &config.observation, station, &world);
        let features = features.with_context(|| format!("--encoder is {path:?}, which does not fit"))?;
        Ok(Self { file: Some(file), features: Arc::new(features) })
    }

    /// The points of the hand of the station that `gathered` were made with.
    ///
    /// # Errors
    /// Trials of several stations, or whose station has changed since.
    pub(super) fn points(config: &CloneConfig, gathered: &[(String, Gathered)]) -> anyhow::Result<Self> {
        let (station, world) = scene_of(gathered)?;
        let features = Features::points(&config.observation, station, &world)?;
        Ok(Self { file: None, features: Arc::new(features) })
    }

    /// Of the file that the policy brings along.
    pub(super) fn sha256(&self) -> Option<&str> {
        self.file.as_ref().map(|file| file.sha256.as_str())
    }

    /// `episodes` of `robot` with the features of each frame; nothing if `cancel` was asked for. The same bits for any number
    /// of threads: an episode is encoded by one of them, frame by frame, as a policy sees it.
    pub(super) fn encode(
        &self,
        robot: &Robot,
        episodes: Vec<Episode>,
        bar: &Bar,
        cancel: &Cancel,
    ) -> anyhow::Result<Option<Episodes>> {
        let (plain, num_features) = (robot.shape(), self.features.num_features());
        let all: usize = episodes.iter().map(Episode::len).sum();
        let done = AtomicU64::new(0);
        let encoded = |episode: Episode| -> anyhow::Result<Option<Episode>> {
            let mut run = FeatureRun::new(Arc::clone(&self.features));
            let mut features = Vec::with_capacity(episode.len() * num_features);
            for frame in episode.frames.chunks_exact(plain.frame_len()) {
                if cancel.is_cancelled() {
                    return Ok(None);
                }
                features.extend(run.see_frame(frame)?);
            }
            let done = done.fetch_add(episode.len() as u64, Ordering::Relaxed) + episode.len() as u64;
            bar.report(done as f64 / all.max(1) as f64, "features");
            Ok(Some(episode.with_features(plain, num_features, &features)))
        };
        let encoded: Option<Vec<Episode>> =
            episodes.into_par_iter().map(encoded).collect::<anyhow::Result<_>>()?;
        let Some(encoded) = encoded else { return Ok(None) };
        let maker = if self.file.is_some() { "the encoder" } else { "the hand's kinematics" };
        bar.line(&format!("{maker} made {num_features} numbers of each of {all} steps"));
        let episodes = Episodes::new(Shape { features: num_features, ..plain }, encoded)?;
        Ok(Some(match &self.file {
            Some(file) => episodes.encoded_by(Arc::clone(file))?,
            None => episodes,
        }))
    }
}
