//! The box that the tactile skin may move in.

use palpate_robot_model::{Station, SurfaceNode, WorkspaceBox};

/// A point that gets this much further out by rounding has not moved, m.
const ROUNDING_M: f64 = 1e-9;

/// Watches the skin: for each patch, the corners of the box around its surface nodes, in the frame of its link.
///
/// Where all corners are within the workspace, so are the nodes: both boxes are convex.
#[derive(Clone, Debug)]
pub(crate) struct Workspace {
    bounds: WorkspaceBox,
    /// Index of the patch and of its link.
    corners: Vec<(usize, usize, SurfaceNode)>,
}

/// How far a point is outside, with the point.
#[derive(Clone, Debug)]
pub(crate) struct Outside {
    depths_m: Vec<f64>,
    positions: Vec<[f64; 3]>,
}

impl Workspace {
    pub(crate) fn of(station: &Station) -> Option<Self> {
        let bounds = station.safety.workspace?;
        let mut corners = Vec::new();
        for (patch_idx, patch) in station.layout.patches.iter().enumerate() {
            let Some(&node) = patch.nodes.first() else { continue };
            let (mut min, mut max) = (node.pos_in_link, node.pos_in_link);
            for node in &patch.nodes {
                min = min.inf(&node.pos_in_link);
                max = max.sup(&node.pos_in_link);
            }
            for corner in 0..8_usize {
                let mut at = node;
                for axis in 0..3 {
                    at.pos_in_link[axis] = if corner >> axis & 1 == 0 { min[axis] } else { max[axis] };
                }
                corners.push((patch_idx, patch.link, at));
            }
        }
        Some(Self { bounds, corners })
    }

    /// How far each corner is outside with the joints at `positions`.
    pub(crate) fn outside(&self, station: &Station, positions: &[f64]) -> Outside {
        let mut root_from_link = Vec::new();
        station.robot.forward_kinematics(positions, &mut root_from_link);
        let (mut depths_m, mut found) =
            (Vec::with_capacity(self.corners.len()), Vec::with_capacity(self.corners.len()));
        for (_, link, corner) in &self.corners {
            let at = root_from_link[*link] * corner.pos_in_link;
            let beyond =
                |axis: usize| (self.bounds.min_m[axis] - at[axis]).max(at[axis] - self.bounds.max_m[axis]);
            depths_m.push((0..3).map(beyond).fold(0.0, f64::max));
            found.push([at.x, at.y, at.z]);
        }
        Outside { depths_m, positions: found }
    }

    /// Why the skin may not go from `now` to `next`: a point that would be outside, and further so than it is.
    pub(crate) fn objection(&self, station: &Station, now: &Outside, next: &Outside) -> Option<String> {
        let worse = |i: &usize| next.depths_m[*i] > now.depths_m[*i] + ROUNDING_M;
        let worst = (0..self.corners.len())
            .filter(worse)
            .max_by(|a, b| next.depths_m[*a].total_cmp(&next.depths_m[*b]))?;
        let patch = &station.layout.patches[self.corners[worst].0];
        let at = next.positions[worst];
        let axis =
            (0..3).find(|&axis| at[axis] < self.bounds.min_m[axis] || at[axis] > self.bounds.max_m[axis])?;
        let (side, limit) = if at[axis] < self.bounds.min_m[axis] {
            ("below", self.bounds.min_m[axis])
        } else {
            ("above", self.bounds.max_m[axis])
        };
        Some(format!(
            "patch {:?} would leave the workspace: {} = {:.3} m is {side} {limit:.3} m; move it another way",
            patch.id,
            ["x", "y", "z"][axis],
            at[axis]
        ))
    }
}
