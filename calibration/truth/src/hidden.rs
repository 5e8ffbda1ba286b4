//! What a world hides: effects by id, with a place and sizes, as truth files and the blind bench write them.

mod table;

use std::collections::BTreeMap;

use palpate_robot_model::{Place, Station};
use serde::{Deserialize, Serialize};

use table::{Choice, EFFECTS, Effect, Joint};

/// An effect that the world has and the description of its station does not mention.
///
/// In a truth file, an entry of `[[hidden]]`:
///
/// ```toml
/// [[hidden]]
/// id = "latency"
/// where = { stream = "fsr" }
/// delay_s = 0.05
/// ```
///
/// Every effect, the places that it can be at and its parameters are listed by [`Hidden::describe`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hidden {
    /// Which effect.
    pub id: String,
    /// Where it acts.
    #[serde(rename = "where")]
    pub place: Place,
    /// The joint that drives it, for effects that depend on a posture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joint: Option<String>,
    /// Its sizes by name, SI units, raw units where the name says so.
    #[serde(flatten)]
    pub parameters: BTreeMap<String, f64>,
}

impl Hidden {
    /// The effect `id` at `place` with `parameters`; whether that can be is checked where it is used.
    pub fn new(id: &str, place: Place, parameters: &[(&str, f64)]) -> Self {
        let parameters = parameters.iter().map(|&(name, value)| (name.to_owned(), value)).collect();
        Self { id: id.to_owned(), place, joint: None, parameters }
    }

    /// The same, driven by `joint`.
    #[must_use]
    pub fn driven_by(mut self, joint: &str) -> Self {
        self.joint = Some(joint.to_owned());
        self
    }

    /// One line for each effect: id, places, parameters with their ranges, and what it does.
    pub fn describe() -> String {
        EFFECTS.iter().map(|effect| effect.to_string() + "\n").collect()
    }

    /// The value of a parameter, or what the effect has where the entry leaves it out.
    pub(crate) fn value(&self, name: &str) -> f64 {
        let default = || {
            let effect = EFFECTS.iter().find(|effect| effect.id == self.id)?;
            effect.sizes.iter().find(|size| size.name == name)?.default
        };
        self.parameters.get(name).copied().or_else(default).unwrap_or(0.0)
    }

    /// Why this entry cannot be, if it cannot.
    pub(crate) fn check(&self, station: &Station) -> Result<(), String> {
        let Some(effect) = EFFECTS.iter().find(|effect| effect.id == self.id) else {
            let ids: Vec<&str> = EFFECTS.iter().map(|effect| effect.id).collect();
            return Err(format!("there is no effect {:?}: use one of {}", self.id, ids.join(", ")));
        };
        self.check_place(effect, station)?;
        match (&self.joint, effect.joint) {
            (None, Joint::Driving) => {
                return Err(format!("{:?} needs the joint that drives it: add joint = \"...\"", self.id));
            }
            (Some(joint), Joint::None) => {
                return Err(format!("{:?} is driven by no joint: leave out joint = {joint:?}", self.id));
            }
            (Some(joint), Joint::Driving) => check_joint(station, joint)?,
            (None, Joint::None) => {}
        }
        for (name, &value) in &self.parameters {
            let Some(size) = effect.sizes.iter().find(|size| size.name == name) else {
                let names: Vec<&str> = effect.sizes.iter().map(|size| size.name).collect();
                let known = if names.is_empty() { "it has none".into() } else { names.join(", ") };
                return Err(format!("{:?} has no parameter {name:?}: {known}", self.id));
            };
            if !(size.lower..=size.upper).contains(&value) {
                return Err(format!("{name} = {value} must be within {}..{}", size.lower, size.upper));
            }
        }
        if let Some(missing) = effect
            .sizes
            .iter()
            .find(|size| size.default.is_none() && !self.parameters.contains_key(size.name))
        {
            return Err(format!("{:?} needs its parameter {}", self.id, missing.name));
        }
        Ok(())
    }

    fn check_place(&self, effect: &Effect, station: &Station) -> Result<(), String> {
        let layout = &station.layout;
        let choice = Choice::of(&self.place);
        if !effect.places.contains(&choice) {
            let fits: Vec<String> = effect.places.iter().map(Choice::to_string).collect();
            return Err(format!(
                "{:?} cannot be at a {choice}: its where names a {}",
                self.id,
                fits.join(" or a ")
            ));
        }
        let channel = |id: &String| {
            let found = layout.channels.iter().find(|channel| channel.id == *id);
            found.ok_or_else(|| format!("the layout has no channel {id:?}"))
        };
        let group = |id: &String| {
            if layout.patches.iter().any(|patch| patch.group == *id) {
                Ok(())
            } else {
                Err(format!("the layout has no group {id:?}"))
            }
        };
        match &self.place {
            Place::Stream(id) => {
                layout.stream_index(id).map(|_| ()).ok_or_else(|| format!("the layout has no stream {id:?}"))
            }
            Place::Patch(id) if layout.patches.iter().any(|patch| patch.id == *id) => Ok(()),
            Place::Patch(id) => Err(format!("the layout has no patch {id:?}")),
            Place::Channel(id) => channel(id).map(|_| ()),
            Place::Channels(ids) => {
                let [first, second] = &ids[..] else {
                    return Err(format!("{} channels, expected two", ids.len()));
                };
                if first == second {
                    return Err(format!("channel {first:?} is named twice"));
                }
                if channel(first)?.stream != channel(second)?.stream {
                    return Err(format!("channels {first:?} and {second:?} are of different streams"));
                }
                Ok(())
            }
            Place::Joint(name) => check_joint(station, name),
            Place::Group(id) => group(id),
            Place::Groups(ids) => {
                let [first, second] = &ids[..] else {
                    return Err(format!("{} groups, expected two", ids.len()));
                };
                if first == second {
                    return Err(format!("group {first:?} is named twice"));
                }
                group(first)?;
                group(second)
            }
            Place::Object(id) if station.objects.contains_key(id) => Ok(()),
            Place::Object(id) => Err(format!("the station has no object {id:?}")),
        }
    }

    /// Channels of the layout that the place takes in, in order; none for joints and objects.
    pub(crate) fn channels(&self, station: &Station) -> Vec<usize> {
        let layout = &station.layout;
        let named = |id: &String| layout.channels.iter().position(|channel| channel.id == *id);
        let of = |keep: &dyn Fn(usize) -> bool| (0..layout.num_channels()).filter(|&idx| keep(idx)).collect();
        let patch = |idx: usize| &layout.patches[layout.channels[idx].patch];
        match &self.place {
            Place::Stream(id) => of(&|idx| layout.streams[layout.channels[idx].stream].id == *id),
            Place::Patch(id) => of(&|idx| patch(idx).id == *id),
            Place::Group(id) => of(&|idx| patch(idx).group == *id),
            Place::Groups(ids) => of(&|idx| ids.contains(&patch(idx).group)),
            Place::Channel(id) => named(id).into_iter().collect(),
            Place::Channels(ids) => ids.iter().filter_map(named).collect(),
            Place::Joint(_) | Place::Object(_) => Vec::new(),
        }
    }
}

fn check_joint(station: &Station, name: &str) -> Result<(), String> {
    if station.robot.dofs().any(|joint| joint.name == name) {
        Ok(())
    } else {
        Err(format!("the station has no moving joint {name:?}"))
    }
}
