//! A scene as JSON: names for people, and numbers for programs that compute the same elsewhere.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3};
use palpate_robot_model::{JointKind, ObjectShape, Place, SensorKind};
use palpate_sim::effects;
use palpate_sim::tactile::thresholds;
use serde::Serialize;

use crate::TouchScene;

/// What a scene is made of, by name.
#[derive(Serialize)]
struct Names<'a> {
    version: &'static str,
    station: &'a str,
    model: &'a str,
    object: &'a str,
    joints: Vec<&'a str>,
    channels: Vec<&'a str>,
    streams: Vec<StreamNames<'a>>,
    /// Per channel, what its raw reading is compared with, m or Pa.
    thresholds: Vec<f64>,
    /// Ids of the model's effects, in its order.
    effects: Vec<&'a str>,
    /// Those of which a frame depends on the frame after it.
    looks_ahead: Vec<&'a str>,
}

#[derive(Serialize)]
struct StreamNames<'a> {
    id: &'a str,
    kind: &'static str,
    rate_hz: f64,
    /// First channel, and the one after its last.
    channels: [usize; 2],
}

/// All that the readings of a scene are computed from.
#[derive(Serialize)]
struct Numbers<'a> {
    names: Names<'a>,
    /// Parents come before their children; the root is first.
    links: Vec<LinkNumbers<'a>>,
    patches: Vec<PatchNumbers>,
    /// What is touched: the object, then what stands still with its pose.
    bodies: Vec<BodyNumbers>,
    /// In the order in which they act.
    effects: Vec<EffectNumbers<'a>>,
    is_plain: bool,
    /// Per channel, the distance at which a proximity sensor begins to read.
    reaches_m: Vec<f64>,
    pad_softness_m: f64,
    near_m: f64,
    switching: SwitchingNumbers,
}

#[derive(Serialize)]
struct LinkNumbers<'a> {
    name: &'a str,
    parent: Option<usize>,
    kind: &'static str,
    dof: Option<usize>,
    parent_from_joint: [f64; 7],
    axis: [f64; 3],
}

#[derive(Serialize)]
struct PatchNumbers {
    id: String,
    kind: &'static str,
    link: usize,
    center: [f64; 3],
    radius_m: f64,
    nodes: Vec<[f64; 3]>,
    stiffness_pa_per_m: f64,
    channels: [usize; 2],
    /// `[node * taxels + taxel]`; none of a proximity patch.
    weights: Vec<f64>,
}

#[derive(Serialize)]
struct BodyNumbers {
    #[serde(flatten)]
    shape: ShapeNumbers,
    /// `None` for the object, which moves.
    base_from_body: Option<[f64; 7]>,
}

#[derive(Serialize)]
#[serde(tag = "shape", rename_all = "snake_case")]
enum ShapeNumbers {
    Sphere { radius_m: f64 },
    Cylinder { radius_m: f64, height_m: f64 },
    Capsule { radius_m: f64, length_m: f64 },
    Box { size_m: [f64; 3] },
    ConvexParts,
    Mesh,
    Compound,
}

#[derive(Serialize)]
struct EffectNumbers<'a> {
    id: &'a str,
    parameters: &'a BTreeMap<String, f64>,
    channels: Vec<usize>,
    streams: Vec<usize>,
    patches: Vec<usize>,
    dof: Option<usize>,
    object: Option<&'a str>,
    /// Of `electrical_crosstalk`, each channel with each of its neighbours on the cable.
    neighbours: Vec<[usize; 2]>,
}

/// Per channel.
#[derive(Serialize)]
struct SwitchingNumbers {
    on_loads: Vec<f64>,
    off_fractions: Vec<f64>,
    min_on_s: Vec<f64>,
    idle_activation: Vec<f64>,
    passed_shares: Vec<f64>,
}

impl TouchScene {
    /// Its names as JSON.
    pub fn names_json(&self) -> String {
        json(&self.names())
    }

    /// As JSON, all that its readings are computed from: kinematics, nodes and weights with the model's errors of mounting
    /// and decay, shapes, effects with their places looked up.
    pub fn numbers_json(&self) -> String {
        json(&self.numbers())
    }

    fn names(&self) -> Names<'_> {
        let (station, model) = (self.station(), self.model());
        let layout = &station.layout;
        let ids = || model.effects.iter().map(|effect| effect.id.as_str());
        let looks_ahead = |id: &&str| effects::tactile(id).is_some_and(|kind| kind.looks_ahead());
        let stream = |stream: &palpate_robot_model::Stream| [stream.channels.start, stream.channels.end];
        Names {
            version: env!("CARGO_PKG_VERSION"),
            station: &station.id,
            model: &model.name,
            object: &self.object().id,
            joints: station.robot.dofs().map(|joint| joint.name.as_str()).collect(),
            channels: layout.channels.iter().map(|channel| channel.id.as_str()).collect(),
            streams: layout
                .streams
                .iter()
                .map(|of| StreamNames {
                    id: &of.id,
                    kind: kind(of.kind),
                    rate_hz: of.rate_hz,
                    channels: stream(of),
                })
                .collect(),
            thresholds: thresholds(layout, &model.thetas()),
            effects: ids().collect(),
            looks_ahead: ids().filter(looks_ahead).collect(),
        }
    }

    fn numbers(&self) -> Numbers<'_> {
        let (station, model, live) = (self.station(), self.model(), self.live());
        let layout = live.layout();
        let links = &station.robot.links;
        let root = LinkNumbers {
            name: &links[0].name,
            parent: None,
            kind: "fixed",
            dof: None,
            parent_from_joint: pose(&Isometry3::identity()),
            axis: [0.0, 0.0, 1.0],
        };
        let moved = station.robot.joints.iter().map(|joint| LinkNumbers {
            name: &links[joint.child_link].name,
            parent: Some(joint.parent_link),
            kind: match joint.kind {
                JointKind::Fixed => "fixed",
                JointKind::Revolute => "revolute",
                JointKind::Prismatic => "prismatic",
            },
            dof: joint.dof,
            parent_from_joint: pose(&joint.parent_from_joint),
            axis: joint.axis_in_joint.into_inner().into(),
        });
        let thetas = model.thetas().by_stream(layout);
        let reaches = layout.channels.iter().map(|of| model.response.reach_m(&thetas[of.stream]));
        let patches = layout.patches.iter().zip(live.patch_balls()).zip(live.propagation());
        let object = BodyNumbers { shape: shape(live.object_shape()), base_from_body: None };
        let fixed = self.fixed().iter().map(|(base_from_body, body)| BodyNumbers {
            shape: shape(body),
            base_from_body: Some(pose(base_from_body)),
        });
        // Stable, so that effects of one kind stay in the model's order.
        let mut effects: Vec<&effects::Effect> = model.effects.iter().collect();
        effects.sort_by_key(|effect| effects::TACTILE.iter().position(|kind| kind.id() == effect.id));
        Numbers {
            names: self.names(),
            links: std::iter::once(root).chain(moved).collect(),
            patches: patches
                .map(|((patch, (center, radius_m)), propagation)| PatchNumbers {
                    id: patch.id.clone(),
                    kind: kind(layout.streams[patch.stream].kind),
                    link: patch.link,
                    center: point(&center),
                    radius_m,
                    nodes: patch.nodes.iter().map(|node| point(&node.pos_in_link)).collect(),
                    stiffness_pa_per_m: patch.stiffness_pa_per_m,
                    channels: [patch.channels.start, patch.channels.end],
                    weights: propagation.weights.clone(),
                })
                .collect(),
            bodies: std::iter::once(object).chain(fixed).collect(),
            effects: effects.into_iter().map(|effect| self.effect(effect)).collect(),
            is_plain: model.is_plain(),
            reaches_m: reaches.collect(),
            pad_softness_m: model.response.pad_softness_m,
            near_m: palpate_sim::replay::NEAR_M,
            switching: self.switching(),
        }
    }

    fn effect<'a>(&self, effect: &'a effects::Effect) -> EffectNumbers<'a> {
        let station = self.station();
        let layout = &station.layout;
        EffectNumbers {
            id: &effect.id,
            parameters: &effect.parameters,
            channels: effect.channels(layout),
            streams: effect.streams(layout),
            patches: effect.patches(layout),
            dof: effect.dof(station),
            object: match &effect.place {
                Place::Object(id) => Some(id),
                _ => None,
            },
            neighbours: effect.wiring_neighbours(layout),
        }
    }

    fn switching(&self) -> SwitchingNumbers {
        let Some(of) = self.live().switching() else {
            let none = Vec::new;
            return SwitchingNumbers {
                on_loads: none(),
                off_fractions: none(),
                min_on_s: none(),
                idle_activation: none(),
                passed_shares: none(),
            };
        };
        SwitchingNumbers {
            on_loads: of.on_loads.clone(),
            off_fractions: of.off_fractions.clone(),
            min_on_s: of.min_on_s.clone(),
            idle_activation: of.idle_activation.clone(),
            passed_shares: of.passed_shares.clone(),
        }
    }
}

fn json(document: &impl Serialize) -> String {
    serde_json::to_string(document).expect("numbers, texts and lists of them have a JSON form")
}

fn kind(kind: SensorKind) -> &'static str {
    match kind {
        SensorKind::Proximity => "proximity",
        SensorKind::Pressure => "pressure",
    }
}

fn point(point: &Point3<f64>) -> [f64; 3] {
    [point.x, point.y, point.z]
}

/// As [`TouchScene::replay`] takes it.
fn pose(parent_from_child: &Isometry3<f64>) -> [f64; 7] {
    let (t, q) = (parent_from_child.translation.vector, parent_from_child.rotation);
    [t.x, t.y, t.z, q.w, q.i, q.j, q.k]
}

fn shape(shape: &ObjectShape) -> ShapeNumbers {
    match *shape {
        ObjectShape::Sphere { radius_m } => ShapeNumbers::Sphere { radius_m },
        ObjectShape::Cylinder { radius_m, height_m } => ShapeNumbers::Cylinder { radius_m, height_m },
        ObjectShape::Capsule { radius_m, length_m } => ShapeNumbers::Capsule { radius_m, length_m },
        ObjectShape::Box { size_m } => ShapeNumbers::Box { size_m },
        ObjectShape::ConvexParts { .. } => ShapeNumbers::ConvexParts,
        ObjectShape::Mesh { .. } => ShapeNumbers::Mesh,
        ObjectShape::Compound { .. } => ShapeNumbers::Compound,
    }
}
