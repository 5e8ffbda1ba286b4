//! `palpate effects`: the library of effects that a diagnosis chooses from.

use std::{path::Path, process::ExitCode};

use clap::Args;
use palpate_sim::{
    actuator::ACTUATOR,
    effects::{Parameter, TACTILE},
};
use serde::Serialize;

use super::{Outcome, import, output};

#[derive(Args)]
pub(crate) struct EffectsArgs {
    /// Station on which effects of touch act: its file, or the id of a shipped one
    #[arg(long, value_name = "STATION", default_value = "xarm6-leap")]
    station: String,
    /// Print the library as JSON
    #[arg(long)]
    json: bool,
}

/// An effect of the library.
#[derive(Serialize)]
struct Listed {
    id: &'static str,
    /// `tactile` or `actuator`.
    domain: &'static str,
    /// What sets it apart from its rivals.
    signature: &'static str,
    /// Of touch: at how many places of the station it could act.
    places: Option<usize>,
    /// At the first of these places; units are in the names.
    parameters: Vec<ListedParameter>,
}

#[derive(Serialize)]
struct ListedParameter {
    name: String,
    lower: f64,
    upper: f64,
    /// Where the effect is absent.
    neutral: f64,
    /// Distance from there below which it does not matter; none of what never matters by itself.
    smallest: Option<f64>,
}

impl From<Parameter> for ListedParameter {
    fn from(of: Parameter) -> Self {
        let smallest = of.smallest.is_finite().then_some(of.smallest);
        Self { name: of.name, lower: of.lower, upper: of.upper, neutral: of.neutral, smallest }
    }
}

pub(super) fn run(args: &EffectsArgs) -> Outcome {
    let station = import::named_station(&args.station, Path::new(""))?;
    let of_touch = TACTILE.iter().map(|kind| {
        let places = kind.places(&station);
        let parameters = places.first().map_or_else(Vec::new, |place| kind.parameters(place, &station));
        Listed {
            id: kind.id(),
            domain: "tactile",
            signature: kind.signature(),
            places: Some(places.len()),
            parameters: parameters.into_iter().map(Into::into).collect(),
        }
    });
    let of_actuators = ACTUATOR.iter().map(|kind| Listed {
        id: kind.id(),
        domain: "actuator",
        signature: kind.signature(),
        places: None,
        parameters: kind.parameters().into_iter().map(Into::into).collect(),
    });
    let listed: Vec<Listed> = of_touch.chain(of_actuators).collect();
    if args.json {
        output::json(&listed)?;
    } else {
        output::line(&listed.iter().map(text).collect::<Vec<_>>().join("\n"))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Parameters that are shown of an effect with one for every channel.
const SHOWN: usize = 3;

fn text(effect: &Listed) -> String {
    let places = effect.places.map_or_else(String::new, |count| format!(", {count} places"));
    let mut lines = vec![format!("{} ({}{places}): {}", effect.id, effect.domain, effect.signature)];
    lines.extend(effect.parameters.iter().take(SHOWN).map(|of| {
        let matters = of.smallest.map_or_else(String::new, |size| format!(", matters from {size} on"));
        format!(
            "    {} from {} to {}, {} where it is absent{matters}",
            of.name, of.lower, of.upper, of.neutral
        )
    }));
    let more = effect.parameters.len().saturating_sub(SHOWN);
    if more > 0 {
        lines.push(format!("    and {more} more like these"));
    }
    lines.join("\n")
}
