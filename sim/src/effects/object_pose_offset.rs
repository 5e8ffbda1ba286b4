//! An object that is not where it is said to be.

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use palpate_robot_model::{ObjectShape, Place, Station};

use super::{Effect, EffectKind, Kinematics, Parameter, Stage, TakeScene, places};

/// Parameters along base x, y and z.
const TRANSLATIONS: [&str; 3] = ["translation_x_m", "translation_y_m", "translation_z_m"];

/// Parameters about the object's x, y and z axis.
const ROTATIONS: [&str; 3] = ["rotation_x_rad", "rotation_y_rad", "rotation_z_rad"];

/// The object stands elsewhere: translated in the base frame and turned about its own origin and axes, all the time where it
/// moves. Turns that its shape does not show have no parameter.
pub(super) struct ObjectPoseOffset;

impl EffectKind for ObjectPoseOffset {
    fn id(&self) -> &'static str {
        "object_pose_offset"
    }

    fn stage(&self) -> Stage {
        Stage::Kinematics
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        let of = |name: &&str| effect.parameters.get(*name).copied().unwrap_or(0.0);
        let [x, y, z] = TRANSLATIONS.map(|name| of(&name) * 1e3);
        let turn_rad = Vector3::from(ROTATIONS.map(|name| of(&name))).norm();
        let turn =
            if turn_rad > 0.0 { format!(", turned by {:.1} mrad", turn_rad * 1e3) } else { String::new() };
        format!(
            "{} stands ({x:+.2}, {y:+.2}, {z:+.2}) mm from where it is said to be{turn}.",
            places::title(&effect.place, station),
        )
    }

    fn signature(&self) -> &'static str {
        "every link meets the object early from one side and late from the other; constant in the object frame"
    }

    fn parameters(&self, place: &Place, station: &Station) -> Vec<Parameter> {
        let turns = match place {
            Place::Object(id) => station.objects.get(id).map_or(0, |object| turns(&object.shape)),
            _ => 0,
        };
        let translation = |name: &&str| Parameter::new(name, -0.02..=0.02, 0.0, 2.5e-4, 5e-4);
        let rotation = |name: &&str| Parameter::new(name, -0.3..=0.3, 0.0, 0.008, 0.015);
        TRANSLATIONS.iter().map(translation).chain(ROTATIONS[..turns].iter().map(rotation)).collect()
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::all_objects(station)
    }

    fn kinematics(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Kinematics<'_>) {
        if !matches!(&effect.place, Place::Object(id) if *id == scene.object.id) {
            return;
        }
        let of = |name: &str| effect.parameters.get(name).copied().unwrap_or(0.0);
        let shift_m = Vector3::from(TRANSLATIONS.map(of));
        let turn_rad = Vector3::from(ROTATIONS.map(of));
        for pose in state.base_from_object.poses_mut() {
            if shift_m != Vector3::zeros() {
                pose.translation = Translation3::from(pose.translation.vector + shift_m);
            }
            if turn_rad != Vector3::zeros() {
                pose.rotation *= UnitQuaternion::from_scaled_axis(turn_rad);
            }
        }
    }
}

/// About how many of its axes, from x, a turn of the shape shows.
fn turns(shape: &ObjectShape) -> usize {
    match shape {
        ObjectShape::Sphere { .. } => 0,
        ObjectShape::Cylinder { .. } | ObjectShape::Capsule { .. } => 2,
        ObjectShape::Box { .. }
        | ObjectShape::ConvexParts { .. }
        | ObjectShape::Mesh { .. }
        | ObjectShape::Compound { .. } => 3,
    }
}
