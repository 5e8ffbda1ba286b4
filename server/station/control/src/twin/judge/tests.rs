use std::path::Path;

use super::*;

const LOOK_S: f64 = 0.1;

fn station() -> Station {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../assets/stations");
    Station::read("xarm6_leap.toml", |path| std::fs::read(dir.join(path)).map_err(|err| err.to_string()))
        .expect("the shipped station reads")
}

/// A judge, and everything quiet around a zero of 500.
struct Scene {
    judge: Judge,
    num_channels: usize,
    threshold: f64,
    look: u32,
}

/// What channel 0 does at a moment.
#[derive(Clone, Copy, Default)]
struct Does {
    rise: f64,
    active: bool,
    frozen: bool,
    expected: bool,
}

impl Scene {
    fn new() -> Self {
        let station = station();
        let threshold = station.streams[station.layout.channels[0].stream].on_threshold;
        Self { judge: Judge::new(&station), num_channels: station.layout.num_channels(), threshold, look: 0 }
    }

    fn now_s(&self) -> f64 {
        f64::from(self.look) * LOOK_S
    }

    /// `seconds` in which channel 0 does as told; what is warned of at their end.
    fn run(&mut self, seconds: f64, object: bool, does: impl Fn(f64) -> Does) -> Vec<(u32, String)> {
        let begun_s = self.now_s();
        while self.now_s() < begun_s + seconds - 1e-9 {
            self.look += 1;
            let done = does(self.now_s() - begun_s);
            let noise = f64::from(self.look % 7) - 3.0;
            let mut readings =
                vec![
                    Some(Reading { raw: (500.0 + noise) as f32, reference: 500.0, active: false });
                    self.num_channels
                ];
            let noise = if done.frozen { 0.0 } else { noise };
            let raw = (500.0 + done.rise + noise) as f32;
            readings[0] = Some(Reading { raw, reference: 500.0, active: done.active });
            let mut active = vec![false; self.num_channels];
            active[0] = done.expected;
            let loads: Vec<f64> = active.iter().map(|on| if *on { 3.0 } else { 0.0 }).collect();
            let expected = Expected { active: &active, loads: &loads };
            self.judge.take_in(self.now_s(), &readings, object.then_some(expected));
        }
        let warnings = self.judge.warnings(self.now_s());
        assert!(warnings.iter().all(|warning| !warning.text.is_empty()));
        warnings.into_iter().map(|warning| (warning.channel, warning.kind)).collect()
    }
}

/// One second of touch in every three, as expected.
fn touches(time_s: f64) -> bool {
    time_s % 3.0 > 2.0
}

fn only(kind: &str) -> Vec<(u32, String)> {
    vec![(0, kind.to_owned())]
}

#[test]
fn agreement_is_the_share_of_the_last_ten_seconds() {
    let mut scene = Scene::new();
    assert!(scene.judge.agreement().is_empty());
    scene.run(3.0, false, |_| Does::default());
    assert!(scene.judge.agreement().is_empty(), "nobody knows what to expect without an object");
    scene.run(20.0, true, |_| Does::default());
    assert!(scene.judge.agreement().iter().all(|share| *share == 1.0));
    scene.run(2.5, true, |_| Does { expected: true, ..Does::default() });
    let agreement = scene.judge.agreement();
    assert!((agreement[0] - 0.75).abs() < 0.02, "{}", agreement[0]);
    assert!(agreement[1..].iter().all(|share| *share == 1.0));
    // What is longer ago does not count.
    scene.run(10.2, true, |_| Does::default());
    assert_eq!(scene.judge.agreement()[0], 1.0);
    scene.run(1.0, true, |_| Does { active: true, rise: 400.0, ..Does::default() });
    assert!(scene.judge.agreement()[0] < 0.95);
    scene.judge.forget_expectations();
    assert!(scene.judge.agreement().is_empty());
    scene.run(1.0, true, |_| Does::default());
    assert_eq!(scene.judge.agreement()[0], 1.0);
}

#[test]
fn a_channel_that_feels_what_it_should_is_believed() {
    let mut scene = Scene::new();
    let rise = 3.0 * scene.threshold;
    let does = |time_s| {
        let on = touches(time_s);
        Does { expected: on, active: on, rise: if on { rise } else { 0.0 }, ..Does::default() }
    };
    assert_eq!(scene.run(60.0, true, does), []);
    // So is one that is touched where nobody knows of an object.
    assert_eq!(scene.run(60.0, false, |time_s| Does { expected: false, ..does(time_s) }), []);
}

#[test]
fn a_channel_that_misses_firm_touches_is_dead_until_it_feels_one() {
    let mut scene = Scene::new();
    let misses = |time_s| Does { expected: touches(time_s), ..Does::default() };
    assert_eq!(scene.run(12.9, true, misses), [], "it may be that nothing is where it should be");
    assert_eq!(scene.run(9.0, true, misses), only("dead"));
    scene.run(9.0, true, |time_s| {
        let on = touches(time_s);
        Does { expected: on, active: on, rise: if on { 900.0 } else { 0.0 }, ..Does::default() }
    });
    assert_eq!(scene.run(6.9, true, misses), [], "two may be chance");
    assert_eq!(scene.run(6.9, true, misses), only("dead"));
    let felt = Does { expected: true, active: true, rise: 900.0, ..Does::default() };
    assert_eq!(scene.run(0.3, true, |_| felt), []);
    // Weakly felt is felt: that is a matter of calibration.
    let weak = 0.5 * scene.threshold;
    let does = |time_s| {
        let on = touches(time_s);
        Does { expected: on, rise: if on { weak } else { 0.0 }, ..Does::default() }
    };
    assert_eq!(scene.run(30.0, true, does), []);
}

#[test]
fn a_channel_that_falls_to_the_bottom_and_stays_is_dead() {
    let mut scene = Scene::new();
    assert_eq!(scene.run(12.0, false, |_| Does::default()), []);
    let fallen = Does { rise: -500.0, frozen: true, ..Does::default() };
    assert_eq!(scene.run(11.0, false, |_| fallen), only("dead"));
    // And comes back by itself.
    assert_eq!(scene.run(12.0, false, |_| Does::default()), []);
}

#[test]
fn a_reading_that_never_changes_is_stuck() {
    let mut scene = Scene::new();
    let frozen = Does { rise: 1.0, frozen: true, ..Does::default() };
    assert_eq!(scene.run(9.0, false, |_| frozen), []);
    assert_eq!(scene.run(2.0, false, |_| frozen), only("stuck"));
    assert_eq!(scene.run(0.2, false, |_| Does::default()), []);
}

#[test]
fn a_channel_that_is_always_on_is_stuck() {
    let mut scene = Scene::new();
    let on = Does { rise: 3.0 * scene.threshold, active: true, ..Does::default() };
    assert_eq!(scene.run(12.0, true, |_| Does::default()), []);
    assert_eq!(scene.run(11.0, true, |_| on), only("stuck"));
    // Where nobody knows what the hand holds, it may hold something for a while.
    let mut scene = Scene::new();
    assert_eq!(scene.run(25.0, false, |_| on), []);
    assert_eq!(scene.run(7.0, false, |_| on), only("stuck"));
    // And where the touch is expected, all is well.
    let mut scene = Scene::new();
    assert_eq!(scene.run(60.0, true, |_| Does { expected: true, ..on }), []);
}

#[test]
fn a_quiet_reading_that_wanders_off_has_drifted_until_the_next_zero() {
    for (object, sign) in [(false, 1.0), (true, 1.0), (true, -1.0)] {
        let mut scene = Scene::new();
        let threshold = scene.threshold;
        // A third of a touch in 20 s: not yet.
        let slope = sign * threshold / 60.0;
        assert_eq!(scene.run(20.0, object, |time_s| Does { rise: slope * time_s, ..Does::default() }), []);
        let more = |time_s: f64| {
            let rise = slope * (20.0 + time_s);
            Does { rise, active: rise > threshold, ..Does::default() }
        };
        assert_eq!(scene.run(20.0, object, more), only("drifted"));
        // It stays drifted when it wanders so far that it is on all the time.
        assert_eq!(scene.run(100.0, object, |time_s| more(20.0 + time_s)), only("drifted"));
        let mut readings = vec![None; scene.num_channels];
        readings[0] = Some(Reading { raw: 800.0, reference: 800.0, active: false });
        scene.judge.take_in(scene.now_s() + LOOK_S, &readings, None);
        assert_eq!(scene.judge.warnings(scene.now_s() + LOOK_S), [], "a tare takes it back");
    }
}

#[test]
fn a_fast_drift_is_told_from_a_channel_that_switches_on_for_good() {
    let mut scene = Scene::new();
    let threshold = scene.threshold;
    scene.run(12.0, true, |_| Does::default());
    let does = |time_s: f64| {
        let rise = 0.8 * threshold * time_s;
        Does { rise, active: rise > threshold, ..Does::default() }
    };
    assert_eq!(scene.run(13.0, true, does), only("drifted"));
}

#[test]
fn a_silent_board_is_judged_by_its_device_alone() {
    let mut scene = Scene::new();
    scene.run(11.0, true, |_| Does { rise: 1.0, frozen: true, ..Does::default() });
    let silent = vec![None; scene.num_channels];
    scene.judge.take_in(scene.now_s() + LOOK_S, &silent, None);
    assert_eq!(scene.judge.warnings(scene.now_s() + LOOK_S), []);
}
