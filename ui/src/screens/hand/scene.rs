//! What is drawn: the parts of a station as meshes, made once, and where they stand in a frame.
//!
//! Pure: positions come from the robot's forward kinematics in double precision and become single only here.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Matrix4, Point3, Unit, UnitQuaternion, Vector3};
use palpate_robot_model::{FixedBox, LinkShape, ObjectShape, Patch, Robot, Station};

use super::{
    camera::{Bounds, Ray},
    hull::convex_hull,
    mesh::{Mesh, WHITE},
};
use crate::screens::capitalised;

/// Edges of boxes and cylinders are broken by at most this much, so that they catch the light.
const EDGE_RADIUS_M: f32 = 0.003;
/// Markers stand this far above the skin, so that they are not half sunk into it.
const MARKER_LIFT_M: f32 = 0.0004;
/// A taxel that lies this much deeper than the surface before it is behind it; markers themselves are thinner.
const OCCLUSION_SLACK_M: f32 = 0.004;
/// A link that is this far from where it is told to be has a ghost there.
const GHOST_FROM_M: f64 = 0.001;
const GHOST_FROM_RAD: f64 = 0.008;
/// Drawn size of a marker on a patch with one taxel, m.
const LONE_MARKER_RADIUS_M: f32 = 0.0035;

/// The parts of a station that can be drawn. Made once; the graphics card keeps a copy.
#[derive(Clone, Debug)]
pub(super) struct Geometry {
    /// All meshes; the others index into them.
    pub meshes: Vec<Mesh>,
    /// For each link: its mesh, if it has a shape.
    link_meshes: Vec<Option<usize>>,
    /// For each link: whether it belongs to the hand, as opposed to what carries it.
    in_hand: Vec<bool>,
    /// For each patch: its skin.
    patch_meshes: Vec<usize>,
    /// For each channel: radius of its marker, m.
    marker_radius_m: Vec<f32>,
    object_meshes: BTreeMap<String, usize>,
    marker_mesh: usize,
    axis_mesh: usize,
    /// A cube of one metre, which boxes are made of.
    box_mesh: usize,
    /// For each mesh: a ball around it.
    bounds: Vec<Option<Bounds>>,
    /// The link that all patches hang from.
    pub hand_root: usize,
    /// Pairs of a name and a direction to look from.
    pub views: Vec<View>,
}

/// A named place to look from.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct View {
    /// What the button says.
    pub label: String,
    /// What is looked at.
    pub subject: Subject,
}

/// What a view looks at, and from which side.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Subject {
    /// The whole hand, from the side that touches.
    Front,
    /// The whole hand, from the other side.
    Back,
    /// The patches of a group, from the side that touches.
    Group(String),
}

/// Something to draw: a mesh, where, and how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Instance {
    /// Index into [`Geometry::meshes`].
    pub mesh: usize,
    /// Mesh to root frame.
    pub root_from_mesh: Matrix4<f32>,
    /// Linear RGBA.
    pub color: [f32; 4],
    /// 0: lit like a solid. 1: its colour as it is, so that a scale can be read from it.
    pub unlit: f32,
    /// How strongly the rim glows, to mark what is picked.
    pub rim: f32,
}

/// How a taxel looks in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TaxelLook {
    /// Linear RGB.
    pub color: [f32; 3],
    /// Drawn larger: state is never colour alone.
    pub active: bool,
    /// Under the pointer, pinned or picked.
    pub marked: bool,
}

/// Colours of what carries no data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SceneColors {
    /// Links whose URDF gives no colour.
    pub body: [f32; 4],
    /// Skins with more than one taxel.
    pub skin: [f32; 4],
    /// The object.
    pub object: [f32; 4],
    /// Links where they are told to be.
    pub ghost: [f32; 4],
    /// What stands beside the object.
    pub surroundings: [f32; 4],
}

/// What of the scene is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shown {
    /// The touched object.
    pub object: bool,
    /// What carries the hand.
    pub arm: bool,
}

/// A taxel's place in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TaxelPlace {
    /// Where, in the root frame.
    pub position: Point3<f32>,
    /// Outward, in the root frame.
    pub normal: Unit<Vector3<f32>>,
    /// Radius of its marker, m.
    pub radius_m: f32,
}

impl Geometry {
    /// The parts of `station`.
    pub(super) fn new(station: &Station) -> Self {
        let (robot, layout) = (&station.robot, &station.layout);
        let mut meshes = Vec::new();
        let mut add = |mesh: Mesh| {
            meshes.push(mesh);
            meshes.len() - 1
        };
        let link_meshes = robot
            .links
            .iter()
            .map(|link| {
                let shapes = if link.visuals.is_empty() { &link.collisions } else { &link.visuals };
                let mut mesh = Mesh::default();
                for shape in shapes {
                    mesh.append(
                        &link_mesh(&shape.shape, shape.rgba.unwrap_or(NO_COLOR)),
                        &shape.link_from_shape.cast(),
                    );
                }
                (!mesh.indices.is_empty()).then(|| add(mesh))
            })
            .collect();
        let patch_meshes = layout.patches.iter().map(|patch| add(skin_mesh(patch))).collect();
        let object_meshes = station
            .objects
            .iter()
            .map(|(id, object)| (id.clone(), add(object_mesh(&object.shape))))
            .collect();
        let marker_mesh = add(Mesh::lens(0.45, 20));
        let axis_mesh = add(axes_mesh());
        let box_mesh = add(Mesh::rounded_box([1.0; 3], 0.0005, WHITE));
        let bounds = meshes.iter().map(Mesh::bounds).collect();
        let hand_root = hand_root(station);
        Self {
            meshes,
            link_meshes,
            in_hand: below(robot, hand_root),
            patch_meshes,
            marker_radius_m: layout.patches.iter().flat_map(marker_radii).collect(),
            object_meshes,
            marker_mesh,
            axis_mesh,
            box_mesh,
            bounds,
            hand_root,
            views: views(station, hand_root),
        }
    }

    /// An object by itself: one mesh.
    pub(super) fn of_object(shape: &ObjectShape) -> Self {
        let mesh = object_mesh(shape);
        Self {
            bounds: vec![mesh.bounds()],
            meshes: vec![mesh],
            link_meshes: Vec::new(),
            in_hand: Vec::new(),
            patch_meshes: Vec::new(),
            marker_radius_m: Vec::new(),
            object_meshes: BTreeMap::new(),
            marker_mesh: 0,
            axis_mesh: 0,
            box_mesh: 0,
            hand_root: 0,
            views: Vec::new(),
        }
    }

    /// Everything to draw, opaque parts first, equal meshes side by side.
    ///
    /// `root_from_link` has one pose per link, `looks` one entry per channel; `object` is an id and a pose.
    pub(super) fn instances(
        &self,
        station: &Station,
        root_from_link: &[Isometry3<f64>],
        looks: &[TaxelLook],
        object: Option<(&str, &Isometry3<f64>)>,
        colors: &SceneColors,
        shown: Shown,
    ) -> Vec<Instance> {
        let solid = |mesh: usize, pose: &Isometry3<f64>, color: [f32; 4]| Instance {
            mesh,
            root_from_mesh: pose.cast::<f32>().to_homogeneous(),
            color,
            unlit: 0.0,
            rim: 0.0,
        };
        let mut instances = vec![solid(self.axis_mesh, &Isometry3::identity(), WHITE)];
        for ((mesh, &in_hand), pose) in self.link_meshes.iter().zip(&self.in_hand).zip(root_from_link) {
            if let Some(mesh) = mesh
                && (in_hand || shown.arm)
            {
                instances.push(solid(*mesh, pose, colors.body));
            }
        }
        for (patch, &mesh) in station.layout.patches.iter().zip(&self.patch_meshes) {
            let Some(pose) = root_from_link.get(patch.link) else { continue };
            let lone = (patch.channels.len() == 1).then(|| looks.get(patch.channels.start)).flatten();
            let mut instance = solid(mesh, pose, colors.skin);
            // The skin of a patch with one channel is that channel.
            if let Some(look) = lone {
                instance.color = [look.color[0], look.color[1], look.color[2], 1.0];
                instance.unlit = 0.75;
                instance.rim = if look.marked { 1.0 } else { 0.0 };
            }
            instances.push(instance);
        }
        for (place, look) in self.taxels(station, root_from_link).iter().zip(looks) {
            let grown = if look.active { 1.3 } else { 1.0 } * if look.marked { 1.35 } else { 1.0 };
            let facing = UnitQuaternion::rotation_between(&Vector3::z(), &place.normal)
                .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f32::consts::PI));
            let pose = Isometry3::from_parts(
                (place.position + place.normal.into_inner() * MARKER_LIFT_M).coords.into(),
                facing,
            );
            instances.push(Instance {
                mesh: self.marker_mesh,
                root_from_mesh: pose.to_homogeneous() * Matrix4::new_scaling(place.radius_m * grown),
                color: [look.color[0], look.color[1], look.color[2], 1.0],
                unlit: 0.8,
                rim: if look.marked { 1.0 } else { 0.0 },
            });
        }
        if shown.object
            && let Some((id, pose)) = object
            && let Some(&mesh) = self.object_meshes.get(id)
        {
            instances.push(solid(mesh, pose, colors.object));
        }
        instances
    }

    /// Boxes that stand beside the object and do not move.
    pub(super) fn boxes(&self, boxes: &[FixedBox], color: [f32; 4]) -> Vec<Instance> {
        let instance = |fixed: &FixedBox| Instance {
            mesh: self.box_mesh,
            root_from_mesh: fixed.base_from_box.cast::<f32>().to_homogeneous()
                * Matrix4::new_nonuniform_scaling(&Vector3::from(fixed.size_m).cast()),
            color,
            unlit: 0.0,
            rim: 0.0,
        };
        boxes.iter().map(instance).collect()
    }

    /// The links that are not yet where they are told to be, translucent, there. Links that are would only flicker over
    /// their measured selves.
    pub(super) fn ghost(
        &self,
        root_from_link: &[Isometry3<f64>],
        commanded_from_link: &[Isometry3<f64>],
        color: [f32; 4],
        shown: Shown,
    ) -> Vec<Instance> {
        let links = self.link_meshes.iter().zip(&self.in_hand).zip(root_from_link).zip(commanded_from_link);
        links
            .filter_map(|(((mesh, in_hand), measured), commanded)| {
                let off_m = (measured.translation.vector - commanded.translation.vector).norm();
                let off_rad = measured.rotation.angle_to(&commanded.rotation);
                let apart = off_m > GHOST_FROM_M || off_rad > GHOST_FROM_RAD;
                (apart && (*in_hand || shown.arm)).then_some(Instance {
                    mesh: (*mesh)?,
                    root_from_mesh: commanded.cast::<f32>().to_homogeneous(),
                    color,
                    unlit: 0.3,
                    rim: 0.0,
                })
            })
            .collect()
    }

    /// Where each taxel is, in channel order.
    pub(super) fn taxels(&self, station: &Station, root_from_link: &[Isometry3<f64>]) -> Vec<TaxelPlace> {
        let mut places = Vec::with_capacity(station.layout.num_channels());
        for channel in &station.layout.channels {
            let patch = &station.layout.patches[channel.patch];
            let pose = root_from_link.get(patch.link).copied().unwrap_or_else(Isometry3::identity);
            places.push(TaxelPlace {
                position: (pose * patch.taxels_in_link[channel.taxel]).cast(),
                normal: (pose * patch.taxel_normals_in_link[channel.taxel]).cast(),
                radius_m: self.marker_radius_m[places.len()],
            });
        }
        places
    }

    /// The channel whose taxel `ray` meets first, if no part of the robot is before it. `slack_per_m` widens a marker
    /// by so much per metre from the eye, so that far ones can still be hit.
    pub(super) fn pick(
        &self,
        station: &Station,
        root_from_link: &[Isometry3<f64>],
        ray: &Ray,
        slack_per_m: f32,
        shown: Shown,
    ) -> Option<usize> {
        let (channel, along) = self
            .taxels(station, root_from_link)
            .iter()
            .enumerate()
            .filter_map(|(channel, place)| {
                let to_center = place.position - ray.origin;
                let along = to_center.dot(&ray.direction);
                let aside = (to_center - ray.direction.into_inner() * along).norm();
                let reach = place.radius_m.max(slack_per_m * along);
                let faces_eye = place.normal.dot(&ray.direction) < 0.25;
                (along > 0.0 && aside <= reach && faces_eye).then_some((channel, along, aside / reach))
            })
            // Where markers overlap on the screen: the one whose middle is nearest to the ray, preferring what is before.
            .min_by(|a, b| (a.1 + a.2 * 0.01).total_cmp(&(b.1 + b.2 * 0.01)))
            .map(|(channel, along, _)| (channel, along))?;
        let hidden = self.link_meshes.iter().enumerate().any(|(link, mesh)| {
            let (Some(mesh), Some(pose)) = (mesh, root_from_link.get(link)) else { return false };
            (self.in_hand[link] || shown.arm)
                && self
                    .hits(*mesh, &pose.cast(), ray)
                    .is_some_and(|distance| distance < along - OCCLUSION_SLACK_M)
        });
        (!hidden).then_some(channel)
    }

    /// Share of the taxels that nothing which carries the hand hides from `eye`; 1 without taxels.
    pub(super) fn share_in_sight(
        &self,
        station: &Station,
        root_from_link: &[Isometry3<f64>],
        eye: &Point3<f32>,
        shown: Shown,
    ) -> f32 {
        let places = self.taxels(station, root_from_link);
        let carriers: Vec<(usize, Isometry3<f32>)> = self
            .link_meshes
            .iter()
            .zip(&self.in_hand)
            .zip(root_from_link)
            .filter(|((_, in_hand), _)| shown.arm && !**in_hand)
            .filter_map(|((mesh, _), pose)| Some(((*mesh)?, pose.cast())))
            .collect();
        let in_sight = places.iter().filter(|place| {
            let Some((direction, distance)) = Unit::try_new_and_get(place.position - eye, 1e-6) else {
                return true;
            };
            let ray = Ray { origin: *eye, direction };
            !carriers.iter().any(|(mesh, pose)| {
                self.hits(*mesh, pose, &ray).is_some_and(|hit| hit < distance - OCCLUSION_SLACK_M)
            })
        });
        if places.is_empty() { 1.0 } else { in_sight.count() as f32 / places.len() as f32 }
    }

    /// A ball around what `subject` shows, and the directions to look from and to have up on the screen.
    pub(super) fn framing(
        &self,
        station: &Station,
        root_from_link: &[Isometry3<f64>],
        object: Option<(&str, &Isometry3<f64>)>,
        subject: &Subject,
    ) -> (Bounds, Vector3<f32>, Vector3<f32>) {
        let places = self.taxels(station, root_from_link);
        let root_pose = root_from_link.get(self.hand_root).copied().unwrap_or_else(Isometry3::identity);
        let front = self.front(station, &places);
        let touching = Bounds::around(places.iter().map(|place| place.position).collect::<Vec<_>>());
        let hand = match (self.hand_bounds(root_from_link), touching) {
            // A pad at the end of a long rod: the rod would make the pad tiny.
            (Some(hand), Some(touching)) if hand.radius_m > 3.0 * touching.radius_m => {
                Bounds { radius_m: 3.0 * touching.radius_m, ..touching }
            }
            (Some(hand), _) => hand,
            (None, _) => {
                Bounds { center: Point3::from(root_pose.translation.vector.cast::<f32>()), radius_m: 0.1 }
            }
        };
        // Fingers point up: from the root of the hand toward its taxels.
        let up = mean(places.iter().map(|place| place.position.coords))
            .map_or(Vector3::x(), |middle| middle - root_pose.translation.vector.cast::<f32>());
        match subject {
            Subject::Front => (self.with_object(hand, object), front, up),
            Subject::Back => (self.with_object(hand, object), -front, up),
            Subject::Group(group) => {
                let of_group = || {
                    station
                        .layout
                        .channels
                        .iter()
                        .zip(&places)
                        .filter(|(channel, _)| station.layout.patches[channel.patch].group == *group)
                        .map(|(_, place)| place)
                };
                let side = mean(of_group().map(|place| place.normal.into_inner()))
                    .filter(|side| side.norm() > 0.1)
                    .unwrap_or(front);
                let bounds = Bounds::around(of_group().map(|place| place.position).collect::<Vec<_>>())
                    .unwrap_or(hand);
                (Bounds { radius_m: (bounds.radius_m * 1.5).max(0.03), ..bounds }, side, up)
            }
        }
    }

    /// A ball around the links of the hand.
    pub(super) fn hand_bounds(&self, root_from_link: &[Isometry3<f64>]) -> Option<Bounds> {
        let balls: Vec<Bounds> = self
            .link_meshes
            .iter()
            .enumerate()
            .filter(|(link, _)| self.in_hand[*link])
            .filter_map(|(link, mesh)| {
                let ball = self.bounds[(*mesh)?]?;
                Some(Bounds { center: root_from_link.get(link)?.cast::<f32>() * ball.center, ..ball })
            })
            .collect();
        around_balls(&balls)
    }

    fn with_object(&self, hand: Bounds, object: Option<(&str, &Isometry3<f64>)>) -> Bounds {
        let ball = object.and_then(|(id, pose)| {
            let ball = self.bounds[*self.object_meshes.get(id)?]?;
            Some(Bounds { center: pose.cast::<f32>() * ball.center, ..ball })
        });
        // An object far away (on a table, while the hand is at home) would make the hand tiny.
        match ball {
            Some(ball) if (ball.center - hand.center).norm() < 2.5 * hand.radius_m => {
                around_balls(&[hand, ball]).unwrap_or(hand)
            }
            _ => hand,
        }
    }

    /// The side of the hand that touches: where the taxels on its root look, or all of them if the root has none.
    fn front(&self, station: &Station, places: &[TaxelPlace]) -> Vector3<f32> {
        let of = |on_root_only: bool| {
            mean(
                station
                    .layout
                    .channels
                    .iter()
                    .zip(places)
                    .filter(|(channel, _)| {
                        !on_root_only || station.layout.patches[channel.patch].link == self.hand_root
                    })
                    .map(|(_, place)| place.normal.into_inner()),
            )
            .filter(|side| side.norm() > 0.1)
        };
        of(true).or_else(|| of(false)).unwrap_or(Vector3::x())
    }

    fn hits(&self, mesh: usize, root_from_mesh: &Isometry3<f32>, ray: &Ray) -> Option<f32> {
        let local = Ray {
            origin: root_from_mesh.inverse_transform_point(&ray.origin),
            direction: root_from_mesh.inverse_transform_unit_vector(&ray.direction),
        };
        let ball = self.bounds[mesh]?;
        let to_center = ball.center - local.origin;
        let aside = (to_center - local.direction.into_inner() * to_center.dot(&local.direction)).norm();
        if aside > ball.radius_m { None } else { self.meshes[mesh].hit(&local) }
    }
}

/// Marks vertices whose colour the theme decides: the shader multiplies, so white.
const NO_COLOR: [f32; 4] = WHITE;

fn link_mesh(shape: &LinkShape, color: [f32; 4]) -> Mesh {
    let edge = |smallest: f64| EDGE_RADIUS_M.min(smallest as f32 * 0.2);
    match *shape {
        LinkShape::Box { size_m } => {
            let smallest = size_m.into_iter().fold(f64::INFINITY, f64::min);
            Mesh::rounded_box(size_m.map(|edge_m| edge_m as f32), edge(smallest), color)
        }
        LinkShape::Cylinder { radius_m, length_m } => {
            Mesh::cylinder(radius_m as f32, length_m as f32, edge(radius_m.min(length_m)), color)
        }
        LinkShape::Capsule { radius_m, length_m } => {
            Mesh::capsule(radius_m as f32, length_m as f32, 32, color)
        }
        LinkShape::Sphere { radius_m } => Mesh::sphere(radius_m as f32, 32, color),
    }
}

fn object_mesh(shape: &ObjectShape) -> Mesh {
    match shape {
        ObjectShape::Sphere { radius_m } => Mesh::sphere(*radius_m as f32, 64, WHITE),
        ObjectShape::Cylinder { radius_m, height_m } => {
            Mesh::cylinder(*radius_m as f32, *height_m as f32, 0.0005, WHITE)
        }
        ObjectShape::Capsule { radius_m, length_m } => {
            Mesh::capsule(*radius_m as f32, *length_m as f32, 48, WHITE)
        }
        ObjectShape::Box { size_m } => Mesh::rounded_box(size_m.map(|edge_m| edge_m as f32), 0.0005, WHITE),
        ObjectShape::ConvexParts { parts } => {
            let mut mesh = Mesh::default();
            for part in parts {
                let points: Vec<Point3<f32>> = part.iter().map(|point| point.cast()).collect();
                mesh.append(&Mesh::flat(&points, convex_hull(&points), WHITE), &Isometry3::identity());
            }
            mesh
        }
        ObjectShape::Mesh { vertices, triangles } => {
            let points: Vec<Point3<f32>> = vertices.iter().map(|point| point.cast()).collect();
            Mesh::flat(&points, triangles.iter().copied(), WHITE)
        }
        ObjectShape::Compound { parts } => {
            let mut mesh = Mesh::default();
            for (pose, part) in parts {
                mesh.append(&object_mesh(part), &pose.cast());
            }
            mesh
        }
    }
}

/// Tiles over a patch's surface nodes, large enough to leave no holes on a square grid.
fn skin_mesh(patch: &Patch) -> Mesh {
    let nodes: Vec<Point3<f64>> = patch.nodes.iter().map(|node| node.pos_in_link).collect();
    let radius_m =
        median_nearest(&nodes).map_or(0.001, |spacing_m| spacing_m as f32 * 0.78).clamp(0.0004, 0.006);
    Mesh::tiles(
        patch.nodes.iter().map(|node| {
            let normal = node.normal_in_link.into_inner().cast::<f32>();
            (node.pos_in_link.cast() + normal * MARKER_LIFT_M, normal)
        }),
        radius_m,
    )
}

/// Radius of the marker of each taxel of a patch: neighbours stay apart.
fn marker_radii(patch: &Patch) -> Vec<f32> {
    let lone = match patch.taxels_in_link.len() {
        1 => Some(LONE_MARKER_RADIUS_M),
        _ => nearest(&patch.taxels_in_link)
            .into_iter()
            .reduce(f64::min)
            .map(|gap_m| (gap_m as f32 * 0.33).clamp(0.0008, LONE_MARKER_RADIUS_M)),
    };
    vec![lone.unwrap_or(LONE_MARKER_RADIUS_M); patch.taxels_in_link.len()]
}

/// For each point, how far its nearest neighbour is; empty for fewer than two.
fn nearest(points: &[Point3<f64>]) -> Vec<f64> {
    points
        .iter()
        .enumerate()
        .filter_map(|(i, p)| {
            points.iter().enumerate().filter(|(j, _)| i != *j).map(|(_, q)| (p - q).norm()).reduce(f64::min)
        })
        .collect()
}

fn median_nearest(points: &[Point3<f64>]) -> Option<f64> {
    let mut gaps = nearest(points);
    gaps.sort_by(f64::total_cmp);
    gaps.get(gaps.len() / 2).copied()
}

/// Red, green and blue rods from the base along x, y and z.
fn axes_mesh() -> Mesh {
    const LENGTH_M: f32 = 0.1;
    let mut mesh = Mesh::default();
    for (axis, color) in [
        (Vector3::x(), [0.75, 0.06, 0.06, 1.0]),
        (Vector3::y(), [0.04, 0.45, 0.06, 1.0]),
        (Vector3::z(), [0.05, 0.12, 0.8, 1.0]),
    ] {
        let facing = UnitQuaternion::rotation_between(&Vector3::z(), &axis).unwrap_or_default();
        let pose = Isometry3::from_parts((axis * (LENGTH_M / 2.0)).into(), facing);
        mesh.append(&Mesh::capsule(0.002, LENGTH_M, 12, color), &pose);
    }
    mesh
}

/// The deepest link from which all patches hang.
fn hand_root(station: &Station) -> usize {
    let robot = &station.robot;
    let ancestors = |link: usize| {
        let mut chain = vec![link];
        while let Some(joint) = robot.joints.iter().find(|joint| Some(&joint.child_link) == chain.last()) {
            chain.push(joint.parent_link);
        }
        chain.reverse();
        chain
    };
    let mut common: Option<Vec<usize>> = None;
    for patch in &station.layout.patches {
        let chain = ancestors(patch.link);
        common = Some(match common {
            None => chain,
            Some(before) => before.iter().zip(&chain).take_while(|(a, b)| a == b).map(|(a, _)| *a).collect(),
        });
    }
    common.and_then(|chain| chain.last().copied()).unwrap_or(0)
}

/// For each link, whether it is `root` or hangs from it.
fn below(robot: &Robot, root: usize) -> Vec<bool> {
    let mut below = vec![false; robot.links.len()];
    below[root] = true;
    // Parents come before children.
    for joint in &robot.joints {
        below[joint.child_link] |= below[joint.parent_link];
    }
    below
}

fn views(station: &Station, hand_root: usize) -> Vec<View> {
    let mut groups: Vec<&str> = Vec::new();
    for patch in &station.layout.patches {
        if !groups.contains(&patch.group.as_str()) {
            groups.push(&patch.group);
        }
    }
    let on_root = |group: &str| {
        station
            .layout
            .patches
            .iter()
            .filter(|patch| patch.group == group)
            .all(|patch| patch.link == hand_root)
    };
    // The one group on the root of a hand is its palm, and the front view shows it; a pad is all root.
    let rooted: Vec<&str> = groups.iter().copied().filter(|group| on_root(group)).collect();
    let palm = if let [only] = rooted[..]
        && groups.len() > 1
    {
        Some(only)
    } else {
        None
    };
    let front = View { label: palm.map_or_else(|| "Front".to_owned(), capitalised), subject: Subject::Front };
    let back = View { label: "Back".to_owned(), subject: Subject::Back };
    let others = groups
        .iter()
        .filter(|group| groups.len() > 1 && Some(**group) != palm)
        .map(|group| View { label: capitalised(group), subject: Subject::Group((*group).to_owned()) });
    [front, back].into_iter().chain(others).collect()
}

fn mean(vectors: impl Iterator<Item = Vector3<f32>>) -> Option<Vector3<f32>> {
    let (sum, count) =
        vectors.fold((Vector3::zeros(), 0u32), |(sum, count), vector| (sum + vector, count + 1));
    (count > 0).then(|| sum / count as f32)
}

/// A ball around balls: about the middle of their bounding box.
fn around_balls(balls: &[Bounds]) -> Option<Bounds> {
    let corner = |ball: &Bounds, sign: f32| ball.center + Vector3::repeat(sign * ball.radius_m);
    let corners: Vec<Point3<f32>> =
        balls.iter().flat_map(|ball| [corner(ball, -1.0), corner(ball, 1.0)]).collect();
    let center = Bounds::around(corners)?.center;
    let radius_m = balls.iter().map(|ball| (ball.center - center).norm() + ball.radius_m).fold(0.0, f32::max);
    Some(Bounds { center, radius_m })
}
