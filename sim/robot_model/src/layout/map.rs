//! The flat map: palm and fingers unrolled, in millimetres, each patch seen from outside.

use super::{
    SensorKind,
    config::{MapConfig, PatchConfig},
};

/// Layout units of the map in a metre: the map is in millimetres.
const UNITS_PER_M: f64 = 1000.0;
/// Free space between two patches on the map.
const GAP: f64 = 8.0;

/// Map positions of every taxel of every patch; patches that the file does not place stand in one column a group, in
/// the order of the file, from the bottom up.
pub(super) fn positions(patches: &[&PatchConfig], kinds: &[SensorKind]) -> Vec<Vec<[f64; 2]>> {
    let width = |patch: &PatchConfig| {
        let [_, [min_y, max_y]] = patch.shape.plan_bounds_m();
        (max_y - min_y) * UNITS_PER_M
    };
    let column_width = GAP + patches.iter().map(|patch| width(patch)).fold(0.0, f64::max);
    // Groups in order of first appearance, with the height that each column has reached.
    let mut columns: Vec<(&str, f64)> = Vec::new();
    let mut all = Vec::with_capacity(patches.len());
    for (patch, &kind) in patches.iter().zip(kinds) {
        let taxels = patch.taxels(kind);
        let place = |at: [f64; 2], turn_rad: f64| -> Vec<[f64; 2]> {
            let (sin, cos) = turn_rad.sin_cos();
            taxels
                .iter()
                .map(|&[x, y]| {
                    // With x up and z towards the reader, y points left.
                    let [right, up] = [-y * UNITS_PER_M, x * UNITS_PER_M];
                    [at[0] + right * cos - up * sin, at[1] + right * sin + up * cos]
                })
                .collect()
        };
        all.push(match &patch.map {
            Some(MapConfig::Positions { positions }) => positions.clone(),
            Some(MapConfig::At { at, turn_rad }) => place(*at, *turn_rad),
            None => {
                let column =
                    columns.iter().position(|(group, _)| *group == patch.group).unwrap_or_else(|| {
                        columns.push((&patch.group, 0.0));
                        columns.len() - 1
                    });
                let [[min_x, max_x], _] = patch.shape.plan_bounds_m();
                let bottom = columns[column].1;
                columns[column].1 = bottom + (max_x - min_x) * UNITS_PER_M + GAP;
                place([column as f64 * column_width, bottom - min_x * UNITS_PER_M], 0.0)
            }
        });
    }
    all
}
