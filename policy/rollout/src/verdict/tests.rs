use std::path::Path;

use palpate_wire::proto::{ControlState, DeviceStatus};

use super::*;

/// What the stream says 30 times a second.
const FRAME_S: f64 = 1.0 / 30.0;

struct Trial {
    station: Station,
    world: GraspConfig,
    watch: Watch,
    time_s: f64,
}

impl Trial {
    fn begin() -> Self {
        let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets");
        let folder = assets.join("stations");
        let read = |path: &str| std::fs::read(folder.join(path)).map_err(|err| err.to_string());
        let station = Station::read("xarm6_leap.toml", read).expect("the shipped station");
        let text = std::fs::read_to_string(assets.join("grasp/xarm6_leap.toml")).expect("the shipped world");
        let world = GraspConfig::from_toml("world", &text, &station.robot).expect("the shipped world");
        Self { watch: Watch::new(&station, &world), station, world, time_s: 0.0 }
    }

    fn dof(&self, name: &str) -> usize {
        self.station.robot.dofs().position(|joint| joint.name == name).expect("a joint")
    }

    /// A while in which the joints `stopped` do not get where they are told to be, `num_active` channels feel something, and the
    /// hand is `raised` (0.05 rad of the shoulder are more than 15 mm). Whether it had the object at the end.
    fn spend(&mut self, seconds: f64, stopped: &[&str], num_active: usize, raised: bool) -> bool {
        let mut positions = self.world.start_positions(&self.station.robot);
        // The shoulder turned forward is a hand that is lower.
        positions[self.dof("joint2")] += if raised { 0.0 } else { 0.1 };
        let mut commanded = positions.clone();
        for name in stopped {
            commanded[self.dof(name)] += 0.2;
        }
        let active = (0..self.station.layout.num_channels()).map(|channel| channel < num_active);
        let single = |values: &[f64]| values.iter().map(|&value| value as f32).collect();
        let control = ControlState { commanded: single(&commanded), ..ControlState::default() };
        let live = LiveFrame {
            joint_positions: single(&positions),
            active: bits::pack(active),
            control: Some(control),
            ..LiveFrame::default()
        };
        let mut has_it = false;
        for _ in 0..(seconds / FRAME_S).round() as usize {
            self.time_s += FRAME_S;
            has_it = self.watch.look(&self.station, self.time_s, &live);
        }
        has_it
    }
}

/// Joints of a thumb and a finger.
const GRIP: &[&str] = &["thumb_mcp", "index_pip"];

#[test]
fn a_grip_that_is_felt_and_raised_for_long_enough_is_a_success() {
    let mut trial = Trial::begin();
    assert!(!trial.spend(1.0, &[], 0, false));
    assert!(!trial.spend(0.5, GRIP, 3, false));
    assert!(!trial.spend(0.9, GRIP, 3, true));
    assert!(!trial.spend(0.3, GRIP, 3, true), "somebody may still be looking");
    let suggestion = trial.watch.suggest(None);
    assert_eq!(suggestion.verdict, TrialVerdict::Success);
    let at_s = suggestion.time_to_grasp_s.expect("it gripped");
    assert!((at_s - 1.0).abs() < 0.1, "{at_s} s");
    assert!((suggestion.held_s - 1.2).abs() < 0.1, "{suggestion:?}");
    assert!(trial.spend(1.0, GRIP, 3, true));
}

#[test]
fn what_is_lost_in_the_air_slipped_and_what_was_never_up_was_an_empty_grasp() {
    let mut trial = Trial::begin();
    trial.spend(0.5, GRIP, 3, false);
    trial.spend(0.5, GRIP, 3, true);
    trial.spend(2.0, &[], 0, true);
    assert_eq!(trial.watch.suggest(None).verdict, TrialVerdict::Slip);
    for (stopped, num_active, why) in [
        (&[][..], 4, "fingers that get where they are told to be hold nothing"),
        (&["index_pip", "index_dip"], 4, "one digit holds nothing"),
        (&["joint1", "joint3"], 4, "the arm is no digit"),
    ] {
        let mut trial = Trial::begin();
        trial.spend(0.5, stopped, num_active, false);
        trial.spend(2.0, stopped, num_active, true);
        assert_eq!(trial.watch.suggest(None).verdict, TrialVerdict::EmptyGrasp, "{why}");
    }
    // A grip that no taxel feels is one, and says so.
    let mut trial = Trial::begin();
    trial.spend(0.5, GRIP, 0, false);
    trial.spend(2.0, GRIP, 0, true);
    let unfelt = trial.watch.suggest(None);
    assert_eq!(unfelt.verdict, TrialVerdict::Success);
    assert!(unfelt.reasons.iter().any(|reason| reason.contains("no channel felt anything")), "{unfelt:?}");
    let mut trial = Trial::begin();
    trial.spend(3.0, GRIP, 3, false);
    assert_eq!(trial.watch.suggest(None).verdict, TrialVerdict::EmptyGrasp, "it was never raised");
}

#[test]
fn a_trial_that_was_broken_off_is_never_counted_as_anything_else() {
    let mut trial = Trial::begin();
    trial.spend(0.5, GRIP, 3, false);
    trial.spend(2.0, GRIP, 3, true);
    for (broken, verdict) in [
        (Break::Void("the studio is gone".to_owned()), TrialVerdict::Void),
        (Break::Station("the button was pressed".to_owned()), TrialVerdict::EmergencyStop),
    ] {
        let suggestion = trial.watch.suggest(Some(&broken));
        assert_eq!(suggestion.verdict, verdict);
        let (Break::Void(why) | Break::Station(why)) = broken;
        assert_eq!(suggestion.reasons.first(), Some(&why));
    }
}

#[test]
fn frames_that_say_nothing_of_commands_count_for_nothing() {
    let mut trial = Trial::begin();
    let has_it = trial.watch.look(&trial.station, 1.0, &LiveFrame::default());
    assert!(!has_it);
    assert_eq!(trial.watch.suggest(None).verdict, TrialVerdict::EmptyGrasp);
}

#[test]
fn a_station_that_let_go_says_which_device_was_at_fault() {
    let device = DeviceStatus {
        id: "xarm".to_owned(),
        problem: "emergency stop".to_owned(),
        link: Link::Fault.into(),
        ..DeviceStatus::default()
    };
    let frame = |phase: Phase| {
        let control =
            ControlState { phase: phase.into(), devices: vec![device.clone()], ..ControlState::default() };
        LiveFrame { control: Some(control), ..LiveFrame::default() }
    };
    assert_eq!(not_following(&frame(Phase::Armed)), None);
    let why = not_following(&frame(Phase::Disarmed)).expect("it does not follow");
    assert!(why.contains("disarmed") && why.contains("xarm: emergency stop"), "{why}");
    assert_eq!(lost_device(&frame(Phase::Armed)), None);
}
