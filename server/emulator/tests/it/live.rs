//! The station in real time.

use palpate_emulator::LiveStation;
use tempfile::TempDir;

use crate::variant;

const TWO_SHORT_TAKES: &str = r#"
[[take]]
object = "sphere_50mm"
primitive = "tap"
duration_s = 12.0
touch = ["palm_middle"]

[[take]]
object = "cylinder_25x100mm"
primitive = "tap"
duration_s = 13.0
touch = ["index_tip.4"]
"#;

#[test]
fn live_station_goes_through_its_takes_for_ever() {
    let dir = TempDir::new().unwrap();
    let truth = variant(&dir, "live.toml", TWO_SHORT_TAKES, &[]);
    let mut station = LiveStation::new(&truth, 5).unwrap();
    let palm =
        station.station().layout.channels.iter().position(|channel| channel.id == "palm_middle").unwrap();
    let mut objects = Vec::new();
    let mut touched = false;
    let mut last = station.advance(0.0);
    for _ in 0..(2 * 25 * 20) {
        let sample = station.advance(0.05);
        assert!(sample.positions.iter().all(|position| position.is_finite()));
        assert!(sample.samples.iter().zip(&last.samples).all(|(now, before)| now >= before));
        assert!(!sample.activity.is_empty());
        touched |= sample.active[palm] && sample.raw[palm] > 0.0;
        let object = sample.object.clone().unwrap().0;
        if objects.last() != Some(&object) {
            objects.push(object);
        }
        last = sample;
    }
    assert!(touched, "the palm was never touched");
    assert!((last.time_s - 50.0).abs() < 1e-6, "{}", last.time_s);
    assert_eq!(objects[..4], ["sphere_50mm", "cylinder_25x100mm", "sphere_50mm", "cylinder_25x100mm"]);
    // Joints at 10 Hz, fingertips at 100 Hz, resistors at 40 Hz.
    for (samples, expected) in last.samples.iter().zip([500.0, 5000.0, 2000.0]) {
        assert!((*samples as f64 / expected - 1.0).abs() < 0.02, "{:?}", last.samples);
    }
}
