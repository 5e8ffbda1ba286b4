//! Whether the size of a response depends on how the finger is bent.
//!
//! Near contact the residual `r` of a reading is regressed on what the model says of it, `c`, both in standard deviations,
//! and on `c` times the angle `q` of a joint: `r = a c + b c q`, with an `a` for each object. A gain that is wrong, but
//! always the same, is `a`, and so is what skin feels of a sphere as against a block, which no model gets quite right; `b`
//! is the change of the response per radian. Over all rows together a change of 5 % is lost in what nothing models better
//! than so; along the joint that it goes with, it is not.

use std::collections::BTreeMap;

use palpate_reports::TooMuchLeft;
use palpate_robot_model::{Place, SensorKind, Station};

use super::adequacy::{CLIP, QUIET};
use super::{Signal, TactileDomain};
use crate::DiagnosisError;
use crate::engine::{Domain, Model};

/// How the size of a patch's response changes with a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct WithPosture {
    /// Index of the patch.
    patch: usize,
    /// Degree of freedom of the joint.
    dof: usize,
    /// Change of the response per rad, as a share of it.
    per_rad: f64,
    /// Squares of residuals that it removes, in variances.
    pub(crate) evidence: f64,
}

impl WithPosture {
    /// As a report has it.
    pub(crate) fn too_much_left(&self, station: &Station, limit: f64) -> TooMuchLeft {
        let joint = station.robot.dofs().nth(self.dof).map_or("a joint", |joint| joint.name.as_str());
        let (patch, percent) = (&station.layout.patches[self.patch], 100.0 * self.per_rad);
        TooMuchLeft {
            check: "posture".to_owned(),
            measured: self.evidence,
            limit,
            place: Some(Place::Patch(patch.id.clone())),
            sentence: format!(
                "What patch {} reads changes by {percent:+.0} % a rad of {joint}, which no name accounts for.",
                patch.label
            ),
        }
    }
}

/// What the regression is made of, for one patch and one object.
#[derive(Default)]
struct Sums {
    /// Of c c, and of c r.
    gain: [f64; 2],
    /// Of c c q, c c q q, and c q r, by degree of freedom.
    by_dof: Vec<[f64; 3]>,
}

impl Sums {
    fn add(&mut self, said: f64, left: f64, angles_rad: &[f64]) {
        self.gain[0] += said * said;
        self.gain[1] += said * left;
        self.by_dof.resize(angles_rad.len(), [0.0; 3]);
        for (sums, angle_rad) in self.by_dof.iter_mut().zip(angles_rad) {
            let bent = said * angle_rad;
            sums[0] += said * bent;
            sums[1] += bent * bent;
            sums[2] += bent * left;
        }
    }

    /// Of c c, and of c c q q and c q r with the gain projected out, where `q` is the angle of `dof`.
    fn projected(&self, dof: usize) -> Option<[f64; 3]> {
        let [gain, left] = self.gain;
        let [bent, square, product] = *self.by_dof.get(dof)?;
        (gain > 0.0).then(|| [gain, square - bent * bent / gain, product - bent * left / gain])
    }
}

/// Change per rad of `dof`, its root mean square, and the squares that it removes; `None` if the joint hardly turned.
fn change<'s>(by_object: impl Iterator<Item = &'s Sums>, dof: usize) -> Option<[f64; 3]> {
    let [gain, square, product] = by_object
        .filter_map(|sums| sums.projected(dof))
        .fold([0.0; 3], |sum, one| [0, 1, 2].map(|idx| sum[idx] + one[idx]));
    let turned_rad = (square / gain).sqrt();
    let per_rad = product / square;
    (turned_rad > LEAST_TURNED_RAD).then(|| [per_rad, per_rad.abs() * turned_rad, per_rad * product])
}

/// Root mean square turn of a joint near contact that shows what depends on it, rad.
const LEAST_TURNED_RAD: f64 = 0.01;

/// How what patches of pressure sensors read changes with a joint that moves them, the one with which it changes most; nothing of
/// patches where chance or the model's own misfit may make as much.
pub(crate) fn with_posture(
    domain: &TactileDomain<'_>,
    model: &Model,
    takes: &[usize],
    least: Least,
) -> Result<Vec<WithPosture>, DiagnosisError> {
    let (station, num_dofs) = (domain.station, domain.station.robot.num_dofs());
    let (patches, streams) = (&station.layout.patches, &station.layout.streams);
    let is_pressure = |&patch: &usize| streams[patches[patch].stream].kind == SensorKind::Pressure;
    let pressed: Vec<usize> = (0..patches.len()).filter(is_pressure).collect();
    let mut sums: Vec<BTreeMap<&str, Sums>> = pressed.iter().map(|_| BTreeMap::new()).collect();
    for &take in takes {
        let observed = domain.take(take);
        let prediction = domain.predict(take, model)?;
        let angles_rad = &observed.take.joints.positions;
        for (patch, by_object) in pressed.iter().zip(&mut sums) {
            let sums = by_object.entry(observed.object.id.as_str()).or_default();
            for signal in patches[*patch].channels.clone().map(|channel| Signal::Reading.of(channel)) {
                let predicted = &prediction[signal];
                let weights = domain.weights(take, signal, predicted);
                let rows = observed.signals[signal].iter().zip(predicted.iter()).zip(&weights);
                for (((row, predicted), weight), angles_rad) in
                    rows.zip(angles_rad.chunks_exact(num_dofs.max(1)))
                {
                    let left = (row - predicted) * weight;
                    if left.is_finite() && *predicted > QUIET {
                        sums.add(predicted * weight, left.clamp(-CLIP, CLIP), angles_rad);
                    }
                }
            }
        }
    }
    let of_limb = |patch: usize, dof: usize| {
        !station.carrier_dofs.contains(&dof) && domain.moves[dof][patches[patch].channels.start]
    };
    let most = pressed.iter().zip(&sums).filter_map(|(&patch, by_object)| {
        let changes = (0..num_dofs).filter(|&dof| of_limb(patch, dof)).filter_map(|dof| {
            let [per_rad, share, evidence] = change(by_object.values(), dof)?;
            let is_there = evidence > least.evidence && share > least.share;
            is_there.then_some(WithPosture { patch, dof, per_rad, evidence })
        });
        changes.max_by(|one, other| one.evidence.total_cmp(&other.evidence))
    });
    Ok(most.collect())
}

/// From where on a change is more than what chance and misfit make.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Least {
    /// Squares that it removes, in variances.
    pub(crate) evidence: f64,
    /// Root mean square of the change, as a share of the response.
    pub(crate) share: f64,
}

impl Least {
    /// Any change.
    pub(crate) const ANY: Self = Self { evidence: 0.0, share: 0.0 };
    /// Of a session in which nothing is missing: on the tuning stations a change of at most 3.5 %, with an evidence of at most
    /// 65.
    pub(crate) const SHIPPED: Self = Self { evidence: 110.0, share: 0.036 };
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sums over a finger that bends and presses one object, with a gain that is off by `gain` and by `per_rad` times the angle.
    fn bending(gain: f64, per_rad: f64) -> Sums {
        let mut sums = Sums::default();
        for row in 0..400 {
            let at = f64::from(row);
            let (said, angle_rad) = (10.0 + 5.0 * (0.3 * at).sin(), 0.4 + 0.3 * (0.07 * at).cos());
            let noise = (12.9 * at).sin();
            let left = said * (gain + per_rad * angle_rad) + noise;
            sums.add(said, left, &[angle_rad, 0.4]);
        }
        sums
    }

    #[test]
    fn a_gain_that_bends_is_told_from_one_that_is_wrong() {
        // Of one object the gain is off by more than of the other.
        let two = |per_rad: f64| [bending(0.1, per_rad), bending(-0.2, per_rad)];
        let [per_rad, share, evidence] = change(two(0.2).iter(), 0).unwrap();
        assert!((per_rad - 0.2).abs() < 0.02, "{per_rad}");
        // The angle's root mean square is 0.3 / sqrt(2).
        assert!((share - 0.042).abs() < 0.005, "{share}");
        assert!(evidence > 100.0, "{evidence}");
        let [per_rad, share, evidence] = change(two(0.0).iter(), 0).unwrap();
        assert!(per_rad.abs() < 0.02 && share < 0.005 && evidence < 4.0, "{per_rad} {share} {evidence}");
    }

    #[test]
    fn a_joint_that_does_not_turn_shows_nothing() {
        assert_eq!(change([bending(0.1, 0.2)].iter(), 1), None);
        assert_eq!(change([Sums::default()].iter(), 0), None);
        assert_eq!(change([].iter(), 0), None);
    }
}
