//! What the names in a [`Place`] mean on a station.

use palpate_robot_model::{JointKind, Patch, Place, SensorKind, Station, TactileLayout};

/// Indices of the streams that `place` names.
pub(super) fn streams_of<'a>(
    place: &'a Place,
    layout: &'a TactileLayout,
) -> impl Iterator<Item = usize> + 'a {
    let named = move |id: &String| matches!(place, Place::Stream(stream) if stream == id);
    layout.streams.iter().enumerate().filter(move |(_, stream)| named(&stream.id)).map(|(idx, _)| idx)
}

/// Indices of the patches that `place` names, or that belong to the stream or group it names.
pub(super) fn patches_of(place: &Place, layout: &TactileLayout) -> Vec<usize> {
    let counts = |patch: &Patch| match place {
        Place::Stream(id) => layout.streams[patch.stream].id == *id,
        Place::Patch(id) => patch.id == *id,
        Place::Group(id) => patch.group == *id,
        Place::Groups(ids) => ids.contains(&patch.group),
        Place::Channel(_) | Place::Channels(_) | Place::Joint(_) | Place::Object(_) => false,
    };
    (0..layout.patches.len()).filter(|&patch| counts(&layout.patches[patch])).collect()
}

/// Indices of the channels that `place` names, in its order, or that belong to the patches it names.
pub(super) fn channels_of(place: &Place, layout: &TactileLayout) -> Vec<usize> {
    let index = |id: &String| layout.channels.iter().position(|channel| channel.id == *id);
    match place {
        Place::Channel(id) => index(id).into_iter().collect(),
        Place::Channels(ids) => ids.iter().filter_map(index).collect(),
        _ => patches_of(place, layout)
            .into_iter()
            .flat_map(|patch| layout.patches[patch].channels.clone())
            .collect(),
    }
}

/// Every stream.
pub(super) fn all_streams(station: &Station) -> Vec<Place> {
    station.layout.streams.iter().map(|stream| Place::Stream(stream.id.clone())).collect()
}

/// Every channel.
pub(super) fn all_channels(station: &Station) -> Vec<Place> {
    station.layout.channels.iter().map(|channel| Place::Channel(channel.id.clone())).collect()
}

/// Every patch.
pub(super) fn all_patches(station: &Station) -> Vec<Place> {
    station.layout.patches.iter().map(|patch| Place::Patch(patch.id.clone())).collect()
}

/// Every object.
pub(super) fn all_objects(station: &Station) -> Vec<Place> {
    station.objects.keys().map(|id| Place::Object(id.clone())).collect()
}

/// Every joint that turns.
pub(super) fn revolute_joints(station: &Station) -> Vec<Place> {
    let turning = station.robot.dofs().filter(|joint| joint.kind == JointKind::Revolute);
    turning.map(|joint| Place::Joint(joint.name.clone())).collect()
}

/// Whether patch `patch` spreads pressure over several taxels.
pub(super) fn spreads(patch: &Patch, layout: &TactileLayout) -> bool {
    layout.streams[patch.stream].kind == SensorKind::Pressure && patch.channels.len() > 1
}

/// Degree of freedom that `place` names.
pub(super) fn dof_of(place: &Place, station: &Station) -> Option<usize> {
    let Place::Joint(name) = place else { return None };
    station.robot.dofs().position(|joint| joint.name == *name)
}

/// Names of channels that share a cable with channel `channel` next to it: its neighbours by number within its patch,
/// or within its stream where patches have one channel each.
pub(super) fn wiring_neighbours(channel: usize, layout: &TactileLayout) -> Vec<usize> {
    let own = &layout.channels[channel];
    let alone = |channel: usize| layout.patches[layout.channels[channel].patch].channels.len() == 1;
    let next = |other: usize| {
        let others = &layout.channels[other];
        others.patch == own.patch || (others.stream == own.stream && alone(channel) && alone(other))
    };
    let beside = [channel.checked_sub(1), Some(channel + 1).filter(|&other| other < layout.num_channels())];
    beside.into_iter().flatten().filter(|&other| next(other)).collect()
}

/// `place` for people, at the start of a sentence or after a "the".
pub(super) fn name(place: &Place, station: &Station) -> String {
    let layout = &station.layout;
    match place {
        Place::Stream(_) => match streams_of(place, layout).next() {
            Some(stream) => format!("{} stream", layout.streams[stream].label),
            None => "missing stream".to_owned(),
        },
        Place::Patch(id) => match patches_of(place, layout).first() {
            Some(&patch) => format!("patch {}", layout.patches[patch].label),
            None => format!("missing patch {id}"),
        },
        Place::Channel(id) => format!("channel {id}"),
        Place::Channels(ids) => format!("channels {}", ids.join(" and ")),
        Place::Joint(name) => format!("joint {name}"),
        Place::Group(id) => id.clone(),
        Place::Groups(ids) => ids.join(" and "),
        Place::Object(id) => match station.objects.get(id) {
            Some(object) => format!("object \"{}\"", object.label),
            None => format!("missing object {id}"),
        },
    }
}

/// [`name`] with a capital letter.
pub(super) fn title(place: &Place, station: &Station) -> String {
    let name = name(place, station);
    let mut letters = name.chars();
    letters
        .next()
        .map_or_else(String::new, |first| first.to_uppercase().collect::<String>() + letters.as_str())
}

/// What to add to the name of an effect that is there or not, where it is not quite certain.
pub(super) fn likely(presence: f64) -> String {
    if presence >= 0.95 { String::new() } else { format!(" ({:.0} % of the way)", presence * 1e2) }
}
