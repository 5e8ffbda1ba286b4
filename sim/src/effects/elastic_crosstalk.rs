//! A gel that spreads pressure otherwise than the others.

use palpate_robot_model::{Place, Station};

use super::{Contact, Effect, EffectKind, Parameter, Stage, TakeScene, places};

/// The decay of pressure along the elastomer of one patch is `decay_factor` times that of the model.
pub(super) struct ElasticCrosstalk;

impl EffectKind for ElasticCrosstalk {
    fn id(&self) -> &'static str {
        "elastic_crosstalk"
    }

    fn stage(&self) -> Stage {
        Stage::Contact
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        format!(
            "Pressure decays {:.2} times as fast along the gel of {} as along the others.",
            effect.parameter("decay_factor"),
            places::name(&effect.place, station)
        )
    }

    fn signature(&self) -> &'static str {
        "taxels beside the touched one read too much or too little, by distance along the gel and not by wiring"
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        vec![Parameter::new("decay_factor", 0.2..=5.0, 1.0, 0.08, -0.3)]
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        let layout = &station.layout;
        let spreading = layout.patches.iter().filter(|patch| places::spreads(patch, layout));
        spreading.map(|patch| Place::Patch(patch.id.clone())).collect()
    }

    fn contact(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Contact<'_>) {
        for patch in places::patches_of(&effect.place, &scene.station.layout) {
            state.alpha_per_m[patch] *= effect.parameter("decay_factor");
        }
    }
}
