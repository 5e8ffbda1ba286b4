//! The box that the robot may move in.

use nalgebra::{Isometry3, Point3};
use palpate_robot_model::{LinkGeometry, LinkShape, Station, WorkspaceBox};

/// What gets this much further out by rounding has not moved, m.
const ROUNDING_M: f64 = 1e-9;

/// Watches every collision shape of the links, and for each patch of skin the box around its surface nodes.
///
/// A shape is within the workspace where its lowest and highest coordinates are.
#[derive(Clone, Debug)]
pub(crate) struct Workspace {
    bounds: WorkspaceBox,
    bodies: Vec<Body>,
}

/// Something that stays within the workspace.
#[derive(Clone, Debug)]
struct Body {
    part: Part,
    /// Index of the link that it is fixed to.
    link: usize,
    geometry: LinkGeometry,
}

/// What a body belongs to, by index.
#[derive(Clone, Copy, Debug)]
enum Part {
    Link(usize),
    Patch(usize),
}

/// How far each body is outside on each side, with its lowest and highest coordinates.
#[derive(Clone, Debug)]
pub(crate) struct Outside {
    reaches: Vec<[Point3<f64>; 2]>,
}

impl Workspace {
    pub(crate) fn of(station: &Station) -> Option<Self> {
        let bounds = station.safety.workspace?;
        let links = station.robot.links.iter().enumerate().flat_map(|(link, shapes)| {
            let body = move |geometry: &LinkGeometry| Body {
                part: Part::Link(link),
                link,
                geometry: geometry.clone(),
            };
            shapes.collisions.iter().map(body)
        });
        let patches = station.layout.patches.iter().enumerate().filter_map(|(patch_idx, patch)| {
            let first = patch.nodes.first()?.pos_in_link;
            let around = |[min, max]: [Point3<f64>; 2], pos: Point3<f64>| [min.inf(&pos), max.sup(&pos)];
            let [min, max] = patch.nodes.iter().map(|node| node.pos_in_link).fold([first; 2], around);
            let centre = nalgebra::center(&min, &max);
            let geometry = LinkGeometry {
                link_from_shape: Isometry3::translation(centre.x, centre.y, centre.z),
                shape: LinkShape::Box { size_m: (max - min).into() },
                rgba: None,
            };
            Some(Body { part: Part::Patch(patch_idx), link: patch.link, geometry })
        });
        Some(Self { bounds, bodies: links.chain(patches).collect() })
    }

    /// Where each body is with the joints at `positions`.
    pub(crate) fn outside(&self, station: &Station, positions: &[f64]) -> Outside {
        let mut root_from_link = Vec::new();
        station.robot.forward_kinematics(positions, &mut root_from_link);
        let reaches = self.bodies.iter().map(|body| body.geometry.bounds(&root_from_link[body.link]));
        Outside { reaches: reaches.collect() }
    }

    /// Why the robot may not go from `now` to `next`: a body that would be outside, and on that side further so than it
    /// is.
    pub(crate) fn objection(&self, station: &Station, now: &Outside, next: &Outside) -> Option<String> {
        let bodies = self.bodies.iter().zip(now.reaches.iter().zip(&next.reaches));
        let worse = bodies.flat_map(|(body, (now, next))| {
            let sides = (0..3).flat_map(|axis| [(axis, Side::Below), (axis, Side::Above)]);
            sides.filter_map(move |(axis, side)| {
                let depth_m = self.depth_m(next, axis, side);
                let is_worse = depth_m > self.depth_m(now, axis, side).max(0.0) + ROUNDING_M;
                is_worse.then_some((depth_m, body.part, axis, side, next))
            })
        });
        let (_, part, axis, side, reach) = worse.max_by(|a, b| a.0.total_cmp(&b.0))?;
        let what = match part {
            Part::Link(link) => format!("link {:?}", station.robot.links[link].name),
            Part::Patch(patch) => format!("patch {:?}", station.layout.patches[patch].id),
        };
        let (at_m, side, limit_m) = match side {
            Side::Below => (reach[0][axis], "below", self.bounds.min_m[axis]),
            Side::Above => (reach[1][axis], "above", self.bounds.max_m[axis]),
        };
        Some(format!(
            "{what} would leave the workspace: {} = {at_m:.3} m is {side} {limit_m:.3} m; move it another way",
            ["x", "y", "z"][axis],
        ))
    }

    /// How far what reaches from `reach[0]` to `reach[1]` is outside, m; negative inside.
    fn depth_m(&self, reach: &[Point3<f64>; 2], axis: usize, side: Side) -> f64 {
        match side {
            Side::Below => self.bounds.min_m[axis] - reach[0][axis],
            Side::Above => reach[1][axis] - self.bounds.max_m[axis],
        }
    }
}

#[derive(Clone, Copy, Debug)]
enum Side {
    Below,
    Above,
}
