use std::path::Path;

use nalgebra::Isometry3;
use palpate_recording::load_station;

use super::*;
use crate::contact::NORMAL_TOLERANCE_RAD;

/// At each contact the taxel lies on the surface, facing it, and only its own links are near.
#[test]
fn contacts_meet_the_surface_squarely_within_limits() {
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets");
    for (station, plan, object, channels) in [
        (
            "xarm6_leap",
            "nine_takes",
            "sphere_50mm",
            ["index_tip.4", "thumb_tip.5", "palm_ring", "thumb_distal"],
        ),
        (
            "xarm6_leap",
            "nine_takes",
            "cylinder_25x100mm",
            ["ring_tip.0", "middle_tip.6", "index_medial", "ring_proximal"],
        ),
        ("probe_bench", "probe_bench", "sphere_50mm", ["cap.4", "cap.0", "film_2", "film_5"]),
    ] {
        let station = load_station(&assets.join(format!("stations/{station}.toml"))).unwrap();
        let plan = Plan::read(&assets.join(format!("plans/{plan}.toml"))).unwrap();
        let scene = plan.scene(&station, object).unwrap();
        let (robot, layout) = (&station.robot, &station.layout);
        for name in channels {
            let channel = channel_named(&station, name).unwrap();
            let postures = Postures {
                rest: &plan.rest(&station),
                away: &plan.away(&station),
                tilt_rad: plan.motion.tilt_rad,
                retreat_m: plan.motion.safe_clearance_m,
                depth_m: 0.002,
            };
            let mut rng = ChaCha8Rng::seed_from_u64(1);
            let contacts = find_contacts(&scene, channel, &postures, &mut rng);
            assert!(!contacts.is_empty(), "{}: no contact of {name}", plan.id);
            for contact in contacts {
                let mut frames: Vec<Isometry3<f64>> = Vec::new();
                robot.forward_kinematics(&contact.positions, &mut frames);
                let patch = &layout.patches[contact.patch];
                let taxel = layout.channels[channel].taxel;
                let taxel_pos = frames[patch.link] * patch.taxels_in_link[taxel];
                let distance_m = scene.object.distance_m(&(scene.base_from_object.inverse() * taxel_pos));
                assert!(distance_m.abs() < 0.2e-3, "{name}: {distance_m} m off the surface");
                let facing = frames[patch.link].rotation * patch.taxel_normals_in_link[taxel].into_inner();
                let angle = facing.angle(&-contact.normal.into_inner());
                assert!(angle <= NORMAL_TOLERANCE_RAD + 1e-3, "{name}: normals {angle} rad apart");
                let clearance = scene.clearance(&frames, Some(patch.link));
                assert!(clearance.others_m > 0.002, "{name}: {clearance:?}");
                for (joint, position) in robot.dofs().zip(&contact.positions) {
                    let limits = joint.limits.expect("every joint has limits");
                    assert!((limits.lower..=limits.upper).contains(position), "{name}: {}", joint.name);
                }
            }
        }
    }
}
