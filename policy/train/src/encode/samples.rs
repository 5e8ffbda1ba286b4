//! Demonstrations as samples: what is felt, and what is there, both in the hand's frame.

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion};
use palpate_encoder::{Dataset, EncoderConfig, Sample, history_steps};
use palpate_robot_model::Robot;
use palpate_rollout::features::Taxels;
use rand::{RngExt, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use sha2::{Digest as _, Sha256};

use super::reader::{Demonstration, Demonstrations};
use super::surface::{Surface, share_out};

/// Everything that samples are made from.
pub(crate) struct World {
    data: Demonstrations,
    taxels: Taxels,
    /// Link and place in it of each point of the hand.
    hand_points: Vec<(usize, Point3<f64>)>,
    /// Points of each object, in its frame.
    object_points: Vec<Vec<Point3<f64>>>,
    history: usize,
}

/// The generator that `what` names, and it alone.
fn generator(seed: u64, what: &str) -> ChaCha8Rng {
    let mut hash = Sha256::new();
    hash.update(seed.to_le_bytes());
    hash.update(what.as_bytes());
    ChaCha8Rng::from_seed(hash.finalize().into())
}

impl World {
    /// Draws the points of hand and objects.
    pub(crate) fn new(data: Demonstrations, config: &EncoderConfig) -> anyhow::Result<Self> {
        let taxels = Taxels::new(&data.station, data.hand_root);
        let hand_points = hand_points(&data.station.robot, data.hand_root, config)?;
        let points = |object: &palpate_robot_model::ObjectModel| {
            let mut rng = generator(config.seed, &format!("points of {}", object.id));
            let drawn = Surface::new(&object.shape)
                .and_then(|surface| surface.points(config.object_points, &mut rng));
            drawn.map_err(|problem| anyhow::anyhow!("object {}: {problem}", object.id))
        };
        let object_points = data.objects.iter().map(points).collect::<anyhow::Result<_>>()?;
        Ok(Self { data, taxels, hand_points, object_points, history: config.history })
    }

    pub(crate) fn data(&self) -> &Demonstrations {
        &self.data
    }

    /// Samples to learn from and held-out ones. A demonstration is one or the other as the seed, its object and its trial say,
    /// whatever else there is.
    pub(crate) fn split(&self, config: &EncoderConfig) -> [Samples<'_>; 2] {
        let (mut train, mut held_out) = (Vec::new(), Vec::new());
        for (idx, one) in self.data.demonstrations.iter().enumerate() {
            let object = &self.data.objects[one.object].id;
            let what = format!("trial {} of {object}, seed {}", one.trial, one.seed);
            let mut rng = generator(config.seed, &what);
            let is_held_out = rng.random::<f64>() < config.held_out_share;
            // Not always the same phases of a grasp.
            let first = (rng.random::<f64>() * config.frame_stride as f64) as usize;
            let moments = (first..one.num_steps()).step_by(config.frame_stride).map(|step| (idx, step));
            if is_held_out { held_out.extend(moments) } else { train.extend(moments) }
        }
        [train, held_out].map(|moments| Samples { world: self, moments })
    }

    fn sample(&self, one: &Demonstration, step: usize) -> Sample {
        let robot = &self.data.station.robot;
        let (joints, channels) = (robot.num_dofs(), self.taxels.num_channels());
        let mut input: Vec<f32> = Vec::with_capacity(self.history * channels * 4);
        let mut last = None;
        for step in history_steps(step, self.history) {
            if last == Some(step) {
                input.extend_from_within(input.len() - channels * 4..);
                continue;
            }
            last = Some(step);
            let touch = one.touch[step * channels..][..channels].iter().map(|&on| f32::from(u8::from(on)));
            let read_joints = &one.read_joints[step * joints..][..joints];
            self.taxels.push_frame(robot, read_joints, touch, &mut input);
        }
        let exact = &one.exact_joints[step * joints..][..joints];
        let mut frames = Vec::new();
        kinematics(robot, exact, &mut frames);
        let hand_from_base = frames[self.data.hand_root].inverse();
        let hand_from_object = hand_from_base * pose(&one.object_poses[7 * step..7 * step + 7]);
        let (t, q) = (hand_from_object.translation.vector, hand_from_object.rotation);
        let in_hand = |point: Point3<f64>| [point.x as f32, point.y as f32, point.z as f32];
        let hand = self.hand_points.iter().map(|(link, place)| hand_from_base * (frames[*link] * place));
        let object = self.object_points[one.object].iter().map(|place| hand_from_object * place);
        let contacts = one.touch[step * channels..][..channels].iter();
        Sample {
            input,
            hand_points: hand.flat_map(in_hand).collect(),
            object_points: object.flat_map(in_hand).collect(),
            pose: [t.x, t.y, t.z, q.w, q.i, q.j, q.k].map(|value| value as f32),
            joints: exact.to_vec(),
            contacts: contacts.map(|&active| f32::from(u8::from(active))).collect(),
        }
    }
}

fn kinematics(robot: &Robot, joints: &[f32], frames: &mut Vec<Isometry3<f64>>) {
    let positions: Vec<f64> = joints.iter().map(|&position| f64::from(position)).collect();
    robot.forward_kinematics(&positions, frames);
}

/// x, y, z, then the quaternion, w first.
fn pose(numbers: &[f32]) -> Isometry3<f64> {
    let [x, y, z, w, i, j, k] = std::array::from_fn(|idx| f64::from(numbers[idx]));
    Isometry3::from_parts(
        Translation3::new(x, y, z),
        UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k)),
    )
}

/// Points of the hand's links, even by area.
fn hand_points(
    robot: &Robot,
    hand_root: usize,
    config: &EncoderConfig,
) -> anyhow::Result<Vec<(usize, Point3<f64>)>> {
    let mut of_hand = vec![false; robot.links.len()];
    of_hand[hand_root] = true;
    for joint in &robot.joints {
        of_hand[joint.child_link] |= of_hand[joint.parent_link];
    }
    let mut surfaces = Vec::new();
    for (idx, link) in robot.links.iter().enumerate().filter(|(idx, _)| of_hand[*idx]) {
        let error = |problem: String| anyhow::anyhow!("link {}: {problem}", link.name);
        let rng = generator(config.seed, &format!("points of link {}", link.name));
        if let Some(surface) = Surface::of_link(link).map_err(error)? {
            surfaces.push((idx, surface, rng));
        }
    }
    if surfaces.is_empty() {
        anyhow::bail!(
            "no link from {} on has a collision shape to draw points from",
            robot.links[hand_root].name
        );
    }
    let areas: Vec<f64> = surfaces.iter_mut().map(|(_, surface, rng)| surface.area_m2(rng)).collect();
    let mut points = Vec::new();
    for ((link, surface, mut rng), count) in surfaces.into_iter().zip(share_out(config.hand_points, &areas)) {
        let drawn = surface.points(count, &mut rng);
        let drawn = drawn.map_err(|problem| anyhow::anyhow!("link {}: {problem}", robot.links[link].name))?;
        points.extend(drawn.into_iter().map(|point| (link, point)));
    }
    Ok(points)
}

/// Moments of demonstrations.
pub(crate) struct Samples<'a> {
    world: &'a World,
    /// Demonstration and step.
    moments: Vec<(usize, usize)>,
}

impl Dataset for Samples<'_> {
    fn len(&self) -> usize {
        self.moments.len()
    }

    fn num_channels(&self) -> usize {
        self.world.taxels.num_channels()
    }

    fn num_joints(&self) -> usize {
        self.world.data.station.robot.num_dofs()
    }

    fn sample(&self, idx: usize) -> Sample {
        let (demonstration, step) = self.moments[idx];
        self.world.sample(&self.world.data.demonstrations[demonstration], step)
    }
}

#[cfg(test)]
mod tests;
