//! What a model has of its own that effects can say: lags of streams, skins that creep, patterns of patches that
//! are alike.

use std::collections::BTreeMap;

use palpate_robot_model::{Place, SensorKind, Station};
use palpate_sim::effects::Effect;

use super::reading::EXPONENTS;
use super::{Base, TactileDomain};
use crate::engine::{BaseParameter, Model};

/// Fitted along and never named: skins that creep by more are told as ones that stay dented (`viscoelastic_release`).
pub(super) const CREEP: &str = "creep";
/// Time constants with which a share of a force may come late, s. Soft polymers relax over many decades of time (J. D.
/// Ferry, "Viscoelastic Properties of Polymers", 1980), of which a take shows three, from a few frames to its length.
const CREEP_TIMES_S: [f64; 3] = [0.3, 3.0, 30.0];
/// A share that comes late with each of them and is no news: soft skins creep by some per cent of a load.
const MOST_CREEP: f64 = 0.1;

/// Power of the loads on a stream of `station` with which readings and forces grow, and what it is to begin with: the load
/// of a pad is a depth.
pub(super) fn exponent(station: &Station, stream: usize) -> (Base, BaseParameter, f64) {
    let described = &station.layout.streams[stream];
    let [lower, upper] = EXPONENTS;
    let name = format!("exponent.{}", described.id);
    let value = match described.kind {
        SensorKind::Proximity => 2.0,
        SensorKind::Pressure => 1.0,
    };
    (Base::Exponent(stream), BaseParameter { name, lower, upper, dose: 0.05 }, value)
}

/// How the skin of a stream of `station` may creep.
pub(super) fn creeps(station: &Station, stream: usize) -> impl Iterator<Item = (Base, BaseParameter)> {
    let id = &station.layout.streams[stream].id;
    CREEP_TIMES_S.iter().enumerate().map(move |(time, time_s)| {
        let name = format!("creep_{time_s}_s.{id}");
        (Base::Creep(stream, time), BaseParameter { name, lower: 0.0, upper: MOST_CREEP, dose: 0.02 })
    })
}

impl TactileDomain<'_> {
    /// Numbers of `model` as effects.
    pub(super) fn own_effects(&self, model: &Model) -> Vec<Effect> {
        let streams = &self.station.layout.streams;
        let of_stream = |id: &str, stream: usize, parameters: &[(&str, f64)]| Effect {
            id: id.to_owned(),
            place: Place::Stream(streams[stream].id.clone()),
            parameters: parameters.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect(),
            interval: BTreeMap::new(),
            takes: Vec::new(),
        };
        let of_base = self.kinds.iter().zip(&model.base).filter(|(_, value)| **value > 0.0);
        let of_streams = of_base.filter_map(|(kind, &value)| match *kind {
            Base::Lag(stream) => Some(of_stream("latency", stream, &[("delay_s", value)])),
            Base::Creep(stream, time) => {
                let (time_s, exponent) = (CREEP_TIMES_S[time], self.exponent(model, stream));
                let late = [("fraction", value), ("time_constant_s", time_s), ("exponent", exponent)];
                Some(of_stream(CREEP, stream, &late))
            }
            _ => None,
        });
        of_streams.chain(self.patterns(model)).collect()
    }

    /// Where joints of `model` stand from where they report, as effects.
    pub(super) fn zeros(&self, model: &Model) -> Vec<Effect> {
        let names: Vec<&str> = self.station.robot.dofs().map(|joint| joint.name.as_str()).collect();
        let of_base = self.kinds.iter().zip(&model.base).filter(|(_, value)| **value != 0.0);
        let zeros = of_base.filter_map(|(kind, &value)| match *kind {
            Base::Zero(dof) => Some(Effect {
                id: "joint_offset".to_owned(),
                place: Place::Joint(names[dof].to_owned()),
                parameters: [("offset_rad".to_owned(), value)].into(),
                interval: BTreeMap::new(),
                takes: Vec::new(),
            }),
            _ => None,
        });
        zeros.collect()
    }

    /// Of the loads on `stream`, with which its readings grow, and the forces that creep.
    fn exponent(&self, model: &Model, stream: usize) -> f64 {
        let mut of_base = self.kinds.iter().zip(&model.base);
        of_base.find(|(kind, _)| **kind == Base::Exponent(stream)).map_or(1.0, |(_, value)| *value)
    }

    /// As gains of the channels of a stream.
    fn patterns(&self, model: &Model) -> Vec<Effect> {
        let layout = &self.station.layout;
        let mut by_stream: BTreeMap<usize, BTreeMap<String, f64>> = BTreeMap::new();
        for (kind, &value) in self.kinds.iter().zip(&model.base) {
            let Base::Pattern(set, taxel) = *kind else { continue };
            for &patch in &self.alike[set] {
                let patch = &layout.patches[patch];
                by_stream
                    .entry(patch.stream)
                    .or_default()
                    .insert(self.gain_names[patch.channels.start + taxel].clone(), value);
            }
        }
        by_stream
            .into_iter()
            .map(|(stream, mut parameters)| {
                for channel in &layout.channels[layout.streams[stream].channels.clone()] {
                    parameters.entry(format!("gain_{}", channel.id)).or_insert(1.0);
                }
                Effect {
                    id: "sensitivity_spread".to_owned(),
                    place: Place::Stream(layout.streams[stream].id.clone()),
                    parameters,
                    interval: BTreeMap::new(),
                    takes: Vec::new(),
                }
            })
            .collect()
    }
}
