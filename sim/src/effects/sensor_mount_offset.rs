//! A patch that is glued on beside its place.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use palpate_robot_model::{Patch, Place, Station};

use super::{Effect, EffectKind, Kinematics, Parameter, Stage, TakeScene, places};

/// The patch sits elsewhere on its link: moved in the plane of its own frame, which touches its surface at the origin, and
/// turned in it. A shift along the normal is not part of it, because to first order that is a preload.
pub(super) struct SensorMountOffset;

impl EffectKind for SensorMountOffset {
    fn id(&self) -> &'static str {
        "sensor_mount_offset"
    }

    fn stage(&self) -> Stage {
        Stage::Kinematics
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        let (x_mm, y_mm) =
            (effect.parameter("translation_x_m") * 1e3, effect.parameter("translation_y_m") * 1e3);
        format!(
            "{} sits ({x_mm:+.2}, {y_mm:+.2}) mm along its surface from its place, turned by {:+.0} mrad.",
            places::title(&effect.place, station),
            effect.parameter("rotation_rad") * 1e3
        )
    }

    fn signature(&self) -> &'static str {
        "one patch reads what a place beside it should read; its neighbours on the same link do not"
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        let translation = |name: &str| Parameter::new(name, -0.006..=0.006, 0.0, 5e-4, 8e-4);
        vec![
            translation("translation_x_m"),
            translation("translation_y_m"),
            Parameter::new("rotation_rad", -0.5..=0.5, 0.0, 0.06, 0.1),
        ]
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::all_patches(station)
    }

    fn kinematics(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Kinematics<'_>) {
        let of = |name: &str| effect.parameter(name);
        let (x_m, y_m, turn_rad) = (of("translation_x_m"), of("translation_y_m"), of("rotation_rad"));
        if (x_m, y_m, turn_rad) == (0.0, 0.0, 0.0) {
            return;
        }
        for patch in places::patches_of(&effect.place, &scene.station.layout) {
            let offset = &mut state.patch_offsets[patch];
            *offset = motion(&scene.station.layout.patches[patch], x_m, y_m, turn_rad) * *offset;
        }
    }
}

/// Motion of the patch in its link: along the x and y axes of the patch's frame, which touch its surface at its origin, and
/// about its z axis through the middle of its taxels.
fn motion(patch: &Patch, x_m: f64, y_m: f64, turn_rad: f64) -> Isometry3<f64> {
    let patch_from_link = patch.link_from_patch.inverse();
    let num_taxels = patch.taxels_in_link.len().max(1) as f64;
    let taxels = patch.taxels_in_link.iter().map(|taxel| (patch_from_link * taxel).coords);
    let middle = taxels.sum::<Vector3<f64>>() / num_taxels;
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn_rad);
    let shift = Vector3::new(x_m, y_m, 0.0);
    let in_patch = Isometry3::from_parts(Translation3::from(middle - turn * middle + shift), turn);
    patch.link_from_patch * in_patch * patch_from_link
}
