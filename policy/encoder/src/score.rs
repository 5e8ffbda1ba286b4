//! How good predictions are, in units that people know.

use serde::Serialize;

use crate::loss::mean_distance_m;
use crate::{Prediction, Sample};

/// What predictions are worth. The object is judged where something is felt, as it is learned; the rest everywhere.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Score {
    /// Samples.
    pub samples: usize,
    /// Samples in which something is felt.
    pub in_contact: usize,
    /// Mean distance between true and predicted place of the object, cm.
    pub position_cm: Option<f64>,
    /// Mean angle between true and predicted rotation of the object, degrees. Objects that look the same turned count as
    /// turned.
    pub rotation_deg: Option<f64>,
    /// Mean distance between points of the object and their nearest counterparts, both ways, mm.
    pub object_chamfer_mm: Option<f64>,
    /// The same of the hand, mm.
    pub hand_chamfer_mm: f64,
    /// Root mean square error of joints, rad or m.
    pub joint_rms: f64,
    /// Chance that an active channel has a higher logit than an idle one; nothing if all channels are the same.
    pub contact_auc: Option<f64>,
    /// Harmonic mean of precision and recall of channels with a logit above 0.
    pub contact_f1: Option<f64>,
}

/// Sums up a score.
#[derive(Clone, Debug, Default)]
struct Scorer {
    samples: usize,
    in_contact: usize,
    position_m: f64,
    rotation_rad: f64,
    object_m: f64,
    hand_m: f64,
    joint_squares: f64,
    num_joints: usize,
    /// Logit and truth of every channel of every sample.
    contacts: Vec<(f32, bool)>,
}

impl Score {
    /// Adds up what `predictions`, called with something to call for each sample, tell.
    ///
    /// # Errors
    /// Whatever `predictions` fails with.
    pub fn of<E>(
        predictions: impl FnOnce(&mut dyn FnMut(&Prediction, &Sample)) -> Result<(), E>,
    ) -> Result<Self, E> {
        let mut scorer = Scorer::default();
        predictions(&mut |prediction, sample| scorer.add(prediction, sample))?;
        Ok(scorer.finish())
    }
}

impl Scorer {
    fn add(&mut self, prediction: &Prediction, sample: &Sample) {
        self.samples += 1;
        self.hand_m += mean_distance_m(&prediction.hand_points, &sample.hand_points);
        let pairs = prediction.joints.iter().zip(&sample.joints);
        self.joint_squares += pairs.map(|(left, right)| f64::from(left - right).powi(2)).sum::<f64>();
        self.num_joints += sample.joints.len();
        let pairs = prediction.contact_logits.iter().zip(&sample.contacts);
        self.contacts.extend(pairs.map(|(&logit, &contact)| (logit, contact > 0.0)));
        if sample.in_contact() {
            self.in_contact += 1;
            let (predicted, pose) = (prediction.pose, sample.pose);
            let squares =
                predicted[..3].iter().zip(&pose[..3]).map(|(left, right)| f64::from(left - right).powi(2));
            self.position_m += squares.sum::<f64>().sqrt();
            self.rotation_rad += angle_rad(&predicted[3..], &pose[3..]);
            self.object_m += mean_distance_m(&prediction.object_points, &sample.object_points);
        }
    }

    fn finish(self) -> Score {
        let of_contact =
            |sum: f64, unit: f64| (self.in_contact > 0).then(|| sum * unit / self.in_contact as f64);
        Score {
            samples: self.samples,
            in_contact: self.in_contact,
            position_cm: of_contact(self.position_m, 1e2),
            rotation_deg: of_contact(self.rotation_rad.to_degrees(), 1.0),
            object_chamfer_mm: of_contact(self.object_m, 1e3),
            hand_chamfer_mm: 1e3 * self.hand_m / self.samples as f64,
            joint_rms: (self.joint_squares / self.num_joints as f64).sqrt(),
            contact_auc: auc(&self.contacts),
            contact_f1: f1(&self.contacts),
        }
    }
}

/// Smallest angle between two rotations, quaternions of any length and sign; half a turn for one of length zero.
fn angle_rad(left: &[f32], right: &[f32]) -> f64 {
    let dot = |left: &[f32], right: &[f32]| -> f64 {
        left.iter().zip(right).map(|(&left, &right)| f64::from(left) * f64::from(right)).sum()
    };
    let norms = (dot(left, left) * dot(right, right)).sqrt();
    if norms == 0.0 {
        return std::f64::consts::PI;
    }
    2.0 * (dot(left, right).abs() / norms).min(1.0).acos()
}

/// Area under the receiver operating characteristic: the statistic of Mann and Whitney, equal logits counting half.
fn auc(contacts: &[(f32, bool)]) -> Option<f64> {
    let mut ranked = contacts.to_vec();
    ranked.sort_by(|left, right| left.0.total_cmp(&right.0));
    let active = ranked.iter().filter(|(_, active)| *active).count();
    let idle = ranked.len() - active;
    if active == 0 || idle == 0 {
        return None;
    }
    let (mut below, mut wins) = (0_usize, 0.0);
    for equals in ranked.chunk_by(|left, right| left.0 == right.0) {
        let of_active = equals.iter().filter(|(_, active)| *active).count();
        let of_idle = equals.len() - of_active;
        wins += of_active as f64 * (below as f64 + 0.5 * of_idle as f64);
        below += of_idle;
    }
    Some(wins / (active as f64 * idle as f64))
}

fn f1(contacts: &[(f32, bool)]) -> Option<f64> {
    let count = |predicted: bool, active: bool| {
        contacts.iter().filter(|(logit, truth)| (*logit > 0.0) == predicted && *truth == active).count()
            as f64
    };
    let (hits, alarms, misses) = (count(true, true), count(true, false), count(false, true));
    let sum = 2.0 * hits + alarms + misses;
    (sum > 0.0).then(|| 2.0 * hits / sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_and_means_worked_by_hand() {
        let contacts = [(3.0, true), (1.0, false), (1.0, true), (-2.0, false), (-3.0, true)];
        // Pairs: 3 beats both, 1 draws and wins, -3 loses both.
        assert_eq!(auc(&contacts), Some((2.0 + 1.5) / 6.0));
        // Above 0: two hits, an alarm; below: a miss.
        assert_eq!(f1(&contacts), Some(4.0 / 6.0));
        assert_eq!(auc(&[(1.0, true)]), None);
        assert_eq!(f1(&[(-1.0, false)]), None);
    }

    #[test]
    fn angles_are_those_of_turns_about_an_axis() {
        let turn = |rad: f32| [(0.5 * rad).cos(), 0.0, (0.5 * rad).sin(), 0.0];
        assert!((angle_rad(&turn(0.2), &turn(1.4)) - 1.2).abs() < 1e-6);
        assert!((angle_rad(&turn(0.2).map(|value| -3.0 * value), &turn(1.4)) - 1.2).abs() < 1e-6);
        assert_eq!(angle_rad(&[0.0; 4], &turn(1.0)), std::f64::consts::PI);
    }

    #[test]
    fn a_perfect_prediction_is_perfect_and_an_object_that_nothing_feels_does_not_count() {
        let sample = |contact: f32| Sample {
            input: vec![],
            hand_points: vec![0.1, 0.0, 0.0, 0.0, 0.2, 0.0],
            object_points: vec![0.0, 0.0, 0.3, 0.1, 0.1, 0.1],
            pose: [0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0],
            joints: vec![0.5, -0.5],
            contacts: vec![contact, 0.0],
        };
        let truth = |sample: &Sample| Prediction {
            hand_points: sample.hand_points.clone(),
            object_points: sample.object_points.clone(),
            pose: sample.pose,
            joints: sample.joints.clone(),
            contact_logits: sample.contacts.iter().map(|contact| 2.0 * contact - 1.0).collect(),
        };
        let score = Score::of(|add| -> Result<(), ()> {
            add(&truth(&sample(1.0)), &sample(1.0));
            // Wrong about an object that nothing feels.
            add(&Prediction { pose: [9.0; 7], ..truth(&sample(0.0)) }, &sample(0.0));
            Ok(())
        })
        .expect("samples");
        assert_eq!((score.samples, score.in_contact), (2, 1));
        assert_eq!((score.position_cm, score.object_chamfer_mm), (Some(0.0), Some(0.0)));
        assert!(score.rotation_deg.expect("contact") < 1e-3);
        assert_eq!((score.hand_chamfer_mm, score.joint_rms), (0.0, 0.0));
        assert_eq!((score.contact_auc, score.contact_f1), (Some(1.0), Some(1.0)));
    }
}
