//! Solids of revolution as convex parts with flat sides.

use std::f64::consts::{PI, TAU};

use nalgebra::Point3;
use serde::Deserialize;

use crate::config::finite;

/// Fewer sides are no curve, more are no longer told apart by touch.
const SEGMENTS: std::ops::RangeInclusive<u32> = 3..=256;

/// A convex profile turned about z.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RevolvedConfig {
    /// Corners of the profile as `[distance from z, z]`, m.
    pub(super) profile_m: Vec<[f64; 2]>,
    /// Flat sides that stand for the curve.
    pub(super) segments: u32,
    /// How far it is turned from x towards y; a full turn if left out.
    #[serde(default = "full_turn_rad")]
    pub(super) sweep_rad: f64,
}

fn full_turn_rad() -> f64 {
    std::f64::consts::TAU
}

/// The points of each convex part: one part where a full turn leaves no hole, else one for each segment. Parts of one
/// solid share faces and do not overlap. The profile counts as the hull of its corners.
pub(super) fn convex_parts(config: &RevolvedConfig) -> Result<Vec<Vec<Point3<f64>>>, String> {
    let &RevolvedConfig { ref profile_m, segments, sweep_rad } = config;
    if profile_m.len() < 3 {
        return Err(format!("profile_m has {} corners, expected at least three", profile_m.len()));
    }
    for (corner_idx, &[radius_m, z_m]) in profile_m.iter().enumerate() {
        finite(&format!("the distance of corner {corner_idx} of profile_m"), radius_m)?;
        finite(&format!("z of corner {corner_idx} of profile_m"), z_m)?;
        if radius_m < 0.0 {
            return Err(format!(
                "corner {corner_idx} of profile_m is at {radius_m} from the axis, expected zero or more"
            ));
        }
    }
    if !SEGMENTS.contains(&segments) {
        return Err(format!("segments is {segments}, expected {} to {}", SEGMENTS.start(), SEGMENTS.end()));
    }
    if !(sweep_rad > 0.0 && sweep_rad <= TAU) {
        return Err(format!("sweep_rad is {sweep_rad}, expected an angle above 0 and up to {TAU:.6}"));
    }
    let is_full_turn = TAU - sweep_rad < 1e-9;
    let segment_rad = sweep_rad / f64::from(segments);
    if segment_rad >= PI {
        return Err(format!(
            "a segment turns by {segment_rad} rad, expected less than half a turn; add segments"
        ));
    }
    let at = |segment: u32| {
        // The last face of a full turn is the first one, to the bit.
        let angle_rad =
            if is_full_turn && segment == segments { 0.0 } else { f64::from(segment) * segment_rad };
        let (sin, cos) = angle_rad.sin_cos();
        profile_m.iter().map(move |&[radius_m, z_m]| Point3::new(radius_m * cos, radius_m * sin, z_m))
    };
    let has_hole = profile_m.iter().all(|&[radius_m, _]| radius_m > 0.0);
    let parts = if is_full_turn && !has_hole {
        vec![(0..segments).flat_map(at).collect()]
    } else {
        (0..segments).map(|segment| at(segment).chain(at(segment + 1)).collect()).collect()
    };
    Ok(parts.into_iter().map(without_doubles).collect())
}

/// Corners on the axis come back with every turn.
fn without_doubles(points: Vec<Point3<f64>>) -> Vec<Point3<f64>> {
    let mut kept: Vec<Point3<f64>> = Vec::with_capacity(points.len());
    for point in points {
        if !kept.contains(&point) {
            kept.push(point);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parts(profile_m: &[[f64; 2]], segments: u32, sweep_rad: f64) -> Result<Vec<Vec<Point3<f64>>>, String> {
        convex_parts(&RevolvedConfig { profile_m: profile_m.to_vec(), segments, sweep_rad })
    }

    #[test]
    fn solid_is_one_part_and_hole_makes_segments() {
        let cone = parts(&[[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]], 8, TAU).unwrap();
        assert_eq!(cone.len(), 1);
        assert_eq!(cone[0].len(), 2 + 8, "foot and tip once, a rim of eight");
        let ring = [[1.0, 0.0], [2.0, 0.0], [2.0, 0.5], [1.0, 0.5]];
        let full = parts(&ring, 8, TAU).unwrap();
        assert_eq!((full.len(), full[0].len()), (8, 8));
        assert_eq!(full[7][4..], full[0][..4], "the ring closes");
        let open = parts(&ring, 6, PI).unwrap();
        assert_eq!(open.len(), 6);
        assert!((open[5][4] - Point3::new(-1.0, 0.0, 0.0)).norm() < 1e-12);
    }

    #[test]
    fn faults_say_what_was_expected() {
        let cone = [[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]];
        for (result, expected) in [
            (parts(&cone[..2], 8, TAU), "2 corners, expected at least three"),
            (parts(&[[0.0, 0.0], [-1.0, 0.0], [0.0, 2.0]], 8, TAU), "corner 1 of profile_m is at -1"),
            (parts(&[[0.0, 0.0], [1.0, f64::NAN], [0.0, 2.0]], 8, TAU), "z of corner 1 of profile_m is NaN"),
            (parts(&cone, 2, TAU), "segments is 2, expected 3 to 256"),
            (parts(&cone, 8, 7.0), "sweep_rad is 7"),
            (parts(&cone, 8, f64::NAN), "sweep_rad is NaN"),
        ] {
            let error = result.expect_err(expected);
            assert!(error.contains(expected), "{error}");
        }
    }
}
