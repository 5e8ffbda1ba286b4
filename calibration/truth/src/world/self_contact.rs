//! Fingers that touch each other.

use nalgebra::Isometry3;
use palpate_robot_model::TactileLayout;

use super::elastomer::Layer;

/// Layers of two groups that press on each other, as `(pressed, pressing)` indices, both ways round.
pub(crate) fn pairs(layout: &TactileLayout, touching: &[[String; 2]]) -> Vec<(usize, usize)> {
    let of = |group: &String| {
        let named = move |&idx: &usize| layout.patches[idx].group == *group;
        (0..layout.patches.len()).filter(named).collect::<Vec<_>>()
    };
    let mut pairs = Vec::new();
    for [first, second] in touching {
        for &a in &of(first) {
            for &b in &of(second) {
                pairs.extend([(a, b), (b, a)]);
            }
        }
    }
    pairs
}

/// Lets the layers of each pair press on each other with the links at `frames`.
pub(crate) fn press(layers: &mut [Layer], pairs: &[(usize, usize)], frames: &[Isometry3<f64>]) {
    for &(pressed, pressing) in pairs {
        if let Ok([pressed, pressing]) = layers.get_disjoint_mut([pressed, pressing]) {
            let pressed_from_pressing = frames[pressed.link].inverse() * frames[pressing.link];
            pressed.approach_layer(pressing, &pressed_from_pressing);
        }
    }
}
