//! An object that is larger or smaller than its model.

use palpate_robot_model::{Place, Station};

use super::{Effect, EffectKind, Kinematics, Parameter, Stage, TakeScene, places};

/// The object is `factor` times as large about its origin.
pub(super) struct ObjectScale;

impl EffectKind for ObjectScale {
    fn id(&self) -> &'static str {
        "object_scale"
    }

    fn stage(&self) -> Stage {
        Stage::Kinematics
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        format!(
            "{} is {:.1} % of its nominal size.",
            places::title(&effect.place, station),
            effect.parameter("factor") * 1e2
        )
    }

    fn signature(&self) -> &'static str {
        "every side of the object is met early, or every side late"
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        vec![Parameter::new("factor", 0.8..=1.25, 1.0, 0.006, 0.02)]
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::all_objects(station)
    }

    fn kinematics(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Kinematics<'_>) {
        if matches!(&effect.place, Place::Object(id) if *id == scene.object.id) {
            state.object_scale *= effect.parameter("factor");
        }
    }
}
