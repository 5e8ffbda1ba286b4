//! How well models report the events of takes: gaps, waterfall, metrics.

use std::borrow::Cow;
use std::ops::Range;

use nalgebra::{Point3, Vector3};
use palpate_calibration::metrics::{MetricsSum, compare_take};
use palpate_robot_model::{ObjectPath, Station};
use palpate_sim::SensorModel;
use palpate_sim::effects::{Chain, Geometry};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::Observed;
use crate::DiagnosisError;

/// Events of one model on one take beside the real ones.
#[derive(Clone, Debug)]
pub(crate) struct Judged {
    /// Simulated activations, `[frame * num_channels + channel]`.
    pub(crate) active: Vec<bool>,
    /// Per channel.
    pub(crate) sums: Vec<MetricsSum>,
    /// Per part of the take ([`Observed::repetitions`]): mismatch summed over channels, channel-seconds.
    pub(crate) mismatch_s: Vec<f64>,
    /// Channel-seconds in the whole take.
    pub(crate) total_s: f64,
}

fn chain(model: &SensorModel) -> Chain<'_> {
    Chain::new(model.thetas(), &model.response, &model.effects, &[])
}

/// Where everything is in `takes` under `model`.
fn geometries(
    station: &Station,
    takes: &[&Observed<'_>],
    model: &SensorModel,
) -> Result<Vec<Geometry>, DiagnosisError> {
    let of_take = |observed: &&Observed<'_>| {
        chain(model)
            .geometry(&observed.scene_at_frames(station))
            .map_err(|error| DiagnosisError::Input(format!("take {:?}: {error}", observed.take.id)))
    };
    takes.par_iter().map(of_take).collect()
}

/// Judges `model` on `takes`.
pub(crate) fn judge(
    station: &Station,
    takes: &[&Observed<'_>],
    model: &SensorModel,
) -> Result<Vec<Judged>, DiagnosisError> {
    Ok(judge_at(station, takes, &geometries(station, takes, model)?, model))
}

/// [`judge`] where the geometry is known.
fn judge_at(
    station: &Station,
    takes: &[&Observed<'_>],
    geometries: &[Geometry],
    model: &SensorModel,
) -> Vec<Judged> {
    takes
        .par_iter()
        .zip(geometries)
        .map(|(observed, geometry)| {
            let sensed = chain(model).sense_contact(&observed.scene_at_frames(station), geometry);
            let active: Vec<bool> = sensed.activation.iter().map(|activation| *activation > 0.5).collect();
            let real = &observed.active;
            let num_channels = station.layout.num_channels();
            let times_s = &observed.take.joints.times_s;
            let lengths_s = frame_lengths_s(times_s);
            let mismatch = |frames: &Range<usize>| -> f64 {
                frames
                    .clone()
                    .map(|frame| {
                        let channels = frame * num_channels..(frame + 1) * num_channels;
                        let differ =
                            real[channels.clone()].iter().zip(&active[channels]).filter(|(a, b)| a != b);
                        differ.count() as f64 * lengths_s[frame]
                    })
                    .sum()
            };
            Judged {
                sums: compare_take(times_s, num_channels, real, &active),
                mismatch_s: observed.repetitions.iter().map(|(frames, _)| mismatch(frames)).collect(),
                total_s: lengths_s.iter().sum::<f64>() * num_channels as f64,
                active,
            }
        })
        .collect()
}

/// Which channels `model` says are on by chance at rest: nobody can say in which frames of `takes`.
pub(crate) fn flickering(station: &Station, takes: &[&Observed<'_>], model: &SensorModel) -> Vec<bool> {
    let mut flickering = vec![false; station.layout.num_channels()];
    for observed in takes {
        let idle = chain(model).switching(&observed.scene_at_frames(station)).idle_activation;
        let is_chance = idle.iter().map(|share| *share > 0.0 && *share < 1.0);
        flickering.iter_mut().zip(is_chance).for_each(|(flickers, by_chance)| *flickers |= by_chance);
    }
    flickering
}

/// How long each frame is in effect, s: until the next one.
pub(crate) fn frame_lengths_s(times_s: &[f64]) -> Vec<f64> {
    let typical = match times_s {
        [first, .., last] => (last - first) / (times_s.len() - 1) as f64,
        _ => 0.0,
    };
    let mut lengths: Vec<f64> = times_s.windows(2).map(|two| two[1] - two[0]).collect();
    lengths.resize(times_s.len(), typical);
    lengths
}

/// Mean mismatch, seconds a channel-second.
pub(crate) fn gap(judged: &[Judged]) -> f64 {
    let total_s: f64 = judged.iter().map(|take| take.total_s).sum();
    let mismatch_s: f64 = judged.iter().flat_map(|take| &take.mismatch_s).sum();
    if total_s > 0.0 { mismatch_s / total_s } else { 0.0 }
}

/// 95 % interval of [`gap`] from resampling repetitions; `None` with fewer than ten.
pub(crate) fn gap_interval(judged: &[Judged], resamples: usize, seed: u64) -> Option<[f64; 2]> {
    let parts: Vec<f64> = judged.iter().flat_map(|take| take.mismatch_s.iter().copied()).collect();
    let total_s: f64 = judged.iter().map(|take| take.total_s).sum();
    if parts.len() < 10 || total_s <= 0.0 || resamples == 0 {
        return None;
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut gaps: Vec<f64> = (0..resamples)
        .map(|_| (0..parts.len()).map(|_| parts[rng.random_range(0..parts.len())]).sum::<f64>() / total_s)
        .collect();
    gaps.sort_unstable_by(f64::total_cmp);
    let at = |share: f64| gaps[((gaps.len() - 1) as f64 * share).round() as usize];
    Some([at(0.025), at(0.975)])
}

/// Metrics over all channels and takes.
pub(crate) fn metrics(judged: &[Judged]) -> palpate_reports::Metrics {
    judged.iter().flat_map(|take| &take.sums).sum::<MetricsSum>().metrics()
}

/// What repetitions of the same motion differ by among themselves, seconds a channel-second: as good as any model can
/// be expected to get. `None` without repetitions.
pub(crate) fn noise_floor(station: &Station, takes: &[&Observed<'_>]) -> Option<f64> {
    let num_channels = station.layout.num_channels();
    let (mut differing, mut compared) = (0.0, 0.0);
    for observed in takes {
        let real = &observed.active;
        for (first, second) in repeated(observed) {
            for offset in 0..first.len().min(second.len()) {
                let (a, b) = ((first.start + offset) * num_channels, (second.start + offset) * num_channels);
                let differ = (0..num_channels).filter(|&channel| real[a + channel] != real[b + channel]);
                differing += differ.count() as f64;
                compared += num_channels as f64;
            }
        }
    }
    // Two repetitions each differ from their mean.
    (compared > 0.0).then(|| 0.5 * differing / compared)
}

/// Pairs of repetitions of the same motion that follow one another, as ranges of frames that go together one by one.
///
/// Marks of one label are taken to repeat a motion where the joints really take the same path, a few frames earlier or
/// later at most: an import may label every mark of a take alike, and people do not move at an even pace. An object that
/// moves must take the same path too: what else it does is felt.
pub(crate) fn repeated(observed: &Observed<'_>) -> Vec<(Range<usize>, Range<usize>)> {
    let num_frames = observed.take.joints.times_s.len();
    let rows = moved_rows(&observed.take.joints.positions, &observed.object_path, num_frames);
    let width = rows.len() / num_frames.max(1);
    labelled_alike(&observed.repetitions)
        .into_iter()
        .filter_map(|(first, second)| aligned(&rows, width, first, second))
        .collect()
}

/// Joint paths of repetitions that differ by less than this (root mean square of the joint that differs most), rad or
/// m, are of one motion. Frames are up to a tenth of a second apart, in which a finger turns by several times less.
const SAME_PATH: f64 = 0.1;
/// Marks of repetitions are at most this many frames early or late, those of people by half a second.
const MOST_SHIFTED: usize = 8;

/// A turn of a joint moves skin that is this far from it, m: so much of an object's motion counts as a radian of a joint's.
const LEVER_M: f64 = 0.1;

/// What moves in each frame, in a joint's units: the joints at `positions` and, of an object that moves, its origin and a point
/// on each of its axes.
fn moved_rows<'p>(positions: &'p [f64], path: &ObjectPath, num_frames: usize) -> Cow<'p, [f64]> {
    let ObjectPath::Moving(poses) = path else { return Cow::Borrowed(positions) };
    let num_dofs = positions.len() / num_frames.max(1);
    let on_axes = [Vector3::zeros(), Vector3::x(), Vector3::y(), Vector3::z()];
    let mut rows = Vec::with_capacity(positions.len() + 12 * poses.len());
    for (positions, pose) in positions.chunks_exact(num_dofs.max(1)).zip(poses) {
        rows.extend_from_slice(positions);
        for axis in on_axes {
            let point = pose * Point3::from(LEVER_M * axis);
            rows.extend(point.iter().map(|coordinate| coordinate / LEVER_M));
        }
    }
    Cow::Owned(rows)
}

/// The parts of two ranges of frames in which joints (and an object that moves) take the same path; `None` where they do not.
fn aligned(
    positions: &[f64],
    num_dofs: usize,
    first: Range<usize>,
    second: Range<usize>,
) -> Option<(Range<usize>, Range<usize>)> {
    let apart = |first: &Range<usize>, second: &Range<usize>| -> f64 {
        let frames = first.len().min(second.len());
        let of_dof = |dof: usize| {
            let square = |offset: usize| {
                let at = |start: usize| positions[(start + offset) * num_dofs + dof];
                (at(first.start) - at(second.start)).powi(2)
            };
            ((0..frames).map(square).sum::<f64>() / frames.max(1) as f64).sqrt()
        };
        (0..num_dofs).map(of_dof).fold(0.0, f64::max)
    };
    // As they are marked, if that will do.
    if apart(&first, &second) < SAME_PATH {
        return Some((first, second));
    }
    let least = first.len().min(second.len()) / 2;
    let shifted = (1..=MOST_SHIFTED).flat_map(|shift| {
        [(first.start + shift..first.end, second.clone()), (first.clone(), second.start + shift..second.end)]
    });
    shifted
        .filter(|(first, second)| first.len().min(second.len()) > least)
        .map(|(first, second)| (apart(&first, &second), (first, second)))
        .filter(|(apart, _)| *apart < SAME_PATH)
        .min_by(|(one, _), (other, _)| one.total_cmp(other))
        .map(|(_, pair)| pair)
}

/// Pairs of `repetitions` of one label that follow one another.
fn labelled_alike(repetitions: &[(Range<usize>, String)]) -> Vec<(Range<usize>, Range<usize>)> {
    let mut last: std::collections::BTreeMap<&str, &Range<usize>> = std::collections::BTreeMap::new();
    let mut pairs = Vec::new();
    for (frames, label) in repetitions.iter().filter(|(_, label)| !label.is_empty()) {
        if let Some(before) = last.insert(label.as_str(), frames) {
            pairs.push((before.clone(), frames.clone()));
        }
    }
    pairs
}

/// Sets the thresholds of `model` to what makes the least mismatch on `takes`: events are hard where a fit is soft, and
/// its optimum need not be theirs.
pub(crate) fn set_thresholds(
    station: &Station,
    takes: &[&Observed<'_>],
    model: &mut SensorModel,
) -> Result<(), DiagnosisError> {
    // Thresholds move nothing.
    let geometries = geometries(station, takes, model)?;
    let mut best = gap(&judge_at(station, takes, &geometries, model));
    let (start, own) = (model.theta, model.streams.clone());
    let mut attempt = |tried: SensorModel, model: &mut SensorModel| {
        let gap = gap(&judge_at(station, takes, &geometries, &tried));
        if gap < best {
            best = gap;
            *model = tried;
        }
    };
    for factor in [0.6, 0.7, 0.8, 0.9, 1.1, 1.25, 1.45, 1.7] {
        let mut tried = model.clone();
        tried.theta.lambda_pre_pa = start.lambda_pre_pa * factor;
        attempt(tried, model);
        for (id, lambda_pre_pa) in own.iter().filter_map(|(id, own)| Some((id, own.lambda_pre_pa?))) {
            let mut tried = model.clone();
            if let Some(own) = tried.streams.get_mut(id) {
                own.lambda_pre_pa = Some(lambda_pre_pa * factor);
            }
            attempt(tried, model);
        }
    }
    for shift_m in [-4e-4, -2.5e-4, -1.5e-4, -0.7e-4, 0.7e-4, 1.5e-4, 2.5e-4, 4e-4] {
        let mut tried = model.clone();
        tried.theta.lambda_con_m = start.lambda_con_m + shift_m;
        attempt(tried, model);
        for (id, lambda_con_m) in own.iter().filter_map(|(id, own)| Some((id, own.lambda_con_m?))) {
            let mut tried = model.clone();
            if let Some(own) = tried.streams.get_mut(id) {
                own.lambda_con_m = Some(lambda_con_m + shift_m);
            }
            attempt(tried, model);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;
    use palpate_robot_model::Place;
    use palpate_sim::effects::Effect;

    use super::*;
    use crate::testing::{Session, session};

    #[test]
    fn every_pair_of_a_planned_session_repeats_a_motion_within_a_frame_of_its_marks() {
        let Session { stage, takes, .. } = session("blind_tune");
        let mut num_pairs = 0;
        for take in &takes {
            let observed = Observed::new(stage.station(), take).unwrap();
            let (pairs, marked) = (repeated(&observed), labelled_alike(&observed.repetitions));
            assert_eq!(pairs.len(), marked.len(), "{}", take.id);
            for (pair, marked) in pairs.iter().zip(&marked) {
                // What is marked need not begin at a frame, and a fast roll turns by more than SAME_PATH in one.
                let shift = (pair.0.start - marked.0.start).max(pair.1.start - marked.1.start);
                assert!(shift <= 1, "{}: {pair:?} of {marked:?}", take.id);
            }
            num_pairs += pairs.len();
        }
        assert!(num_pairs > 20, "{num_pairs}");
    }

    #[test]
    fn marks_of_one_label_pair_up_where_the_joints_take_the_same_path() {
        // One joint bends and comes back three times, each time for 40 frames, the last time twice as far.
        let bend = |frame: usize| match frame {
            0..80 => (frame as f64 * std::f64::consts::TAU / 40.0).sin(),
            _ => 2.0 * (frame as f64 * std::f64::consts::TAU / 40.0).sin(),
        };
        let positions: Vec<f64> = (0..120).map(bend).collect();
        let pair = |first, second| aligned(&positions, 1, first, second);
        assert_eq!(pair(0..40, 40..80), Some((0..40, 40..80)));
        assert_eq!(pair(0..40, 43..80), Some((3..40, 43..80)), "the second mark is late");
        assert_eq!(pair(5..40, 40..80), Some((5..40, 45..80)), "the first is");
        assert_eq!(pair(40..80, 80..120), None, "another motion");
    }

    #[test]
    fn an_object_that_moves_otherwise_the_second_time_is_no_repetition() {
        // A hand that stands still, and an object that goes away by 0.2 m and comes back, twice; the second time aside or turned.
        let pair = |aside_m: f64, turn_rad: f64, second: Range<usize>| {
            let pose = |frame: usize| {
                let away_m = 0.2 * (frame as f64 * std::f64::consts::TAU / 40.0).sin();
                let (aside_m, turn_rad) = if frame < 40 { (0.0, 0.0) } else { (aside_m, turn_rad) };
                Isometry3::new(Vector3::new(away_m, aside_m, 0.1), Vector3::z() * turn_rad)
            };
            let path = ObjectPath::Moving((0..80).map(pose).collect());
            let rows = moved_rows(&[0.3; 80], &path, 80);
            aligned(&rows, rows.len() / 80, 0..40, second)
        };
        assert_eq!(pair(0.0, 0.0, 40..80), Some((0..40, 40..80)));
        assert_eq!(pair(0.005, 0.05, 40..80), Some((0..40, 40..80)), "no surface moves by a centimetre");
        assert_eq!(pair(0.02, 0.0, 40..80), None);
        assert_eq!(pair(0.0, 0.2, 40..80), None);
        assert_eq!(pair(0.0, 0.0, 43..80), Some((3..40, 43..80)), "the second mark is late");
        let still = moved_rows(&[0.3; 80], &Isometry3::identity().into(), 80);
        assert_eq!(aligned(&still, 1, 0..40, 40..80), Some((0..40, 40..80)));
    }

    #[test]
    fn only_what_is_on_by_chance_flickers() {
        let Session { stage, takes, nominal: mut model } = session("small");
        let station = stage.station();
        let observed = Observed::new(station, &takes[0]).unwrap();
        let channels = &station.layout.channels;
        for (id, channel) in [("integer_wrap", 0), ("stuck_channel", 1)] {
            model.effects.push(Effect {
                id: id.to_owned(),
                place: Place::Channel(channels[channel].id.clone()),
                parameters: [("presence".to_owned(), 1.0)].into(),
                interval: [].into(),
                takes: Vec::new(),
            });
        }
        let flickers = flickering(station, &[&observed], &model);
        assert_eq!((0..channels.len()).filter(|&channel| flickers[channel]).collect::<Vec<_>>(), [0]);
    }
}
