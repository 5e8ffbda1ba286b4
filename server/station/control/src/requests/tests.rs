use std::path::Path;

use palpate_robot_model::Station;
use palpate_safety::{JointReading, Measured, Phase};
use palpate_wire::proto::{
    Acquire, Arm, ClearFault, Heartbeat, LeadThrough, Release, ResetStop, Stop, Tare, Targets,
};

use super::*;

const MS: u64 = 1_000_000;

/// A desk before a supervisor whose joints all stand still at `at`.
struct Scene {
    desk: Desk,
    supervisor: Supervisor,
    now_ns: u64,
    commands: u64,
    busy: Busy,
    torque: bool,
    rest: Vec<f64>,
    sequences: BTreeMap<u64, u64>,
}

impl Scene {
    fn new() -> Self {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../assets/stations");
        let read = |path: &str| std::fs::read(dir.join(path)).map_err(|err| err.to_string());
        let station = Station::read("xarm6_leap.toml", read).expect("the shipped station reads");
        let (id, plan) = station.plans.first().expect("the station has plans");
        let plan = palpate_motion::Plan::from_text(id, plan).expect("the shipped plan reads");
        Self {
            desk: Desk::default(),
            supervisor: Supervisor::new(&station),
            now_ns: 0,
            commands: 0,
            busy: Busy::default(),
            torque: false,
            rest: plan.rest(&station),
            sequences: BTreeMap::new(),
        }
    }

    /// Time passes, and motors do as they are told.
    fn wait(&mut self, time_ns: u64) {
        let until_ns = self.now_ns + time_ns;
        while self.now_ns < until_ns {
            self.now_ns += 5 * MS;
            let mut measured = Measured::new(self.rest.len());
            for (dof, &position) in self.rest.iter().enumerate() {
                let torque_on = Some(self.torque);
                measured
                    .read(dof, JointReading { position, velocity: 0.0, torque_on, received_ns: self.now_ns });
            }
            self.supervisor.measured(self.now_ns, &measured);
            self.torque = self.supervisor.tick(self.now_ns).torque();
        }
    }

    fn numbered(
        &mut self,
        connection: u64,
        sequence: u64,
        lease: u64,
        request: Request,
    ) -> (ControlReply, Effect) {
        let request = ControlRequest { sequence, lease, request: Some(request) };
        let handled = self.desk.handle(
            Times { now_ns: self.now_ns, received_ns: self.now_ns },
            &mut self.supervisor,
            &mut self.commands,
            self.busy,
            &Caller { connection, peer: "test".into(), may_operate: true },
            &request,
        );
        let effect = handled.clone().unwrap_or(Effect::Nothing);
        let ended = handled.map(|_| ()).map_err(Refused::into_text);
        (self.desk.reply(self.now_ns, &self.supervisor, connection, sequence, ended), effect)
    }

    fn ask(&mut self, connection: u64, lease: u64, request: Request) -> (ControlReply, Effect) {
        let sequence = self.sequences.entry(connection).or_default();
        *sequence += 1;
        let sequence = *sequence;
        self.numbered(connection, sequence, lease, request)
    }

    fn accepted(&mut self, connection: u64, lease: u64, request: Request) -> ControlReply {
        let (reply, _) = self.ask(connection, lease, request);
        assert!(reply.accepted, "{}", reply.problem);
        reply
    }

    fn refused(&mut self, connection: u64, lease: u64, request: Request) -> String {
        let (reply, _) = self.ask(connection, lease, request);
        assert!(!reply.accepted && !reply.problem.is_empty(), "{reply:?}");
        reply.problem
    }

    fn phase(&self) -> Phase {
        self.supervisor.status(self.now_ns).phase
    }

    /// Connection 1 has control of an armed station; gives its lease.
    fn armed() -> (Self, u64) {
        let mut scene = Self::new();
        scene.wait(20 * MS);
        let lease = scene.accepted(1, 0, acquire("Ada", false)).lease;
        scene.accepted(1, lease, Request::Arm(Arm {}));
        for _ in 0..10 {
            scene.wait(50 * MS);
            scene.accepted(1, lease, Request::Heartbeat(Heartbeat {}));
        }
        assert_eq!(scene.phase(), Phase::Armed);
        (scene, lease)
    }
}

fn acquire(operator: &str, take_over: bool) -> Request {
    Request::Acquire(Acquire { operator: operator.to_owned(), take_over })
}

fn targets(dofs: &[u32], positions: &[f64]) -> Request {
    Request::Targets(Targets { dofs: dofs.to_vec(), positions: positions.to_vec() })
}

#[test]
fn a_lease_belongs_to_the_connection_that_acquired_it() {
    let (mut scene, lease) = Scene::armed();
    // Not even whoever has got hold of its number.
    assert!(scene.refused(2, lease, targets(&[7], &[0.4])).contains("not yours"));
    assert!(scene.refused(2, 0, targets(&[7], &[0.4])).contains("watch only"));
    for request in [Request::Release(Release {}), Request::Heartbeat(Heartbeat {}), Request::Tare(Tare {})] {
        scene.refused(2, lease, request);
    }
    assert!(scene.refused(2, 0, acquire("Bob", false)).contains("Ada"));
    scene.accepted(1, lease, targets(&[7], &[0.4]));
    assert_eq!(scene.phase(), Phase::Armed);
}

#[test]
fn whoever_says_where_the_object_is_does_not_stand_behind_what_moves() {
    let (mut scene, lease) = Scene::armed();
    let pose = || Request::ObjectPose(ObjectPose::default());
    assert!(scene.refused(2, lease, pose()).contains("not yours"));
    let mut waited_ms = 0;
    // Poses go on while heartbeats do not: the station holds as it does without them.
    while scene.phase() == Phase::Armed {
        let (reply, effect) = scene.ask(1, lease, pose());
        assert!(reply.accepted && effect == Effect::ObjectPose(ObjectPose::default()), "{reply:?}");
        scene.wait(50 * MS);
        waited_ms += 50;
        assert!(waited_ms < 1000, "it goes on without anybody");
    }
    assert_eq!(scene.phase(), Phase::Holding);
}

#[test]
fn who_is_taken_over_from_has_no_lease_any_more() {
    let (mut scene, lease) = Scene::armed();
    let taken = scene.accepted(2, 0, acquire("Bob", true)).lease;
    assert_ne!(taken, lease);
    let (reply, _) = scene.ask(1, lease, Request::Heartbeat(Heartbeat {}));
    assert!(!reply.accepted && reply.lease == 0, "{reply:?}");
    assert!(reply.problem.contains("Bob"), "{}", reply.problem);
    // And the one who took over has to arm first.
    scene.refused(2, taken, targets(&[7], &[0.4]));
}

#[test]
fn acquiring_again_keeps_the_lease() {
    let (mut scene, lease) = Scene::armed();
    assert_eq!(scene.accepted(1, lease, acquire("Ada", false)).lease, lease);
    assert_eq!(scene.phase(), Phase::Armed);
}

#[test]
fn numbers_must_rise_and_a_stop_needs_none() {
    let (mut scene, lease) = Scene::armed();
    scene.accepted(1, lease, targets(&[7], &[0.3]));
    let newest = scene.sequences[&1];
    for sequence in [0, 1, newest] {
        let (reply, _) = scene.numbered(1, sequence, lease, targets(&[7], &[0.4]));
        assert!(!reply.accepted && reply.problem.contains("upwards"), "{reply:?}");
    }
    let (reply, _) = scene.numbered(1, 0, 0, Request::Stop(Stop {}));
    assert!(reply.accepted);
    assert_eq!(scene.phase(), Phase::Stopped);
}

#[test]
fn anybody_may_stop_and_only_the_holder_may_reset() {
    let (mut scene, lease) = Scene::armed();
    scene.accepted(9, 0, Request::Stop(Stop {}));
    scene.wait(50 * MS);
    assert!(!scene.torque);
    scene.refused(9, 0, Request::ResetStop(ResetStop {}));
    scene.refused(1, lease, targets(&[7], &[0.4]));
    scene.accepted(1, lease, Request::ResetStop(ResetStop {}));
    assert_eq!(scene.phase(), Phase::Disarmed);
}

#[test]
fn wrong_targets_are_refused_by_name() {
    let (mut scene, lease) = Scene::armed();
    assert!(scene.refused(1, lease, targets(&[7], &[f64::NAN])).contains("index_mcp_forward"));
    assert!(scene.refused(1, lease, targets(&[7], &[40.0])).contains("index_mcp_forward"));
    assert!(scene.refused(1, lease, targets(&[900], &[0.0])).contains("900"));
    assert!(scene.refused(1, lease, targets(&[7, 8], &[0.1])).contains("2 joints with 1 positions"));
    let empty = ControlRequest { sequence: 1000, lease, request: None };
    let Scene { desk, supervisor, now_ns, commands, busy, .. } = &mut scene;
    let times = Times { now_ns: *now_ns, received_ns: *now_ns };
    let caller = Caller { connection: 1, peer: "test".into(), may_operate: true };
    assert!(desk.handle(times, supervisor, commands, *busy, &caller, &empty).is_err());
}

#[test]
fn a_guided_motion_is_not_interfered_with() {
    let (mut scene, lease) = Scene::armed();
    scene.busy = Busy { guided_motion: true, recording: true };
    assert!(scene.refused(1, lease, targets(&[7], &[0.4])).contains("cancel"));
    scene.refused(1, lease, Request::LeadThrough(LeadThrough { on: true }));
    assert!(scene.refused(1, lease, Request::Tare(Tare {})).contains("zero"));
    // But it is kept alive by heartbeats, and ended by disarming.
    scene.accepted(1, lease, Request::Heartbeat(Heartbeat {}));
    scene.accepted(1, lease, Request::Disarm(palpate_wire::proto::Disarm {}));
}

#[test]
fn tare_and_faults_are_left_to_the_loop() {
    let (mut scene, lease) = Scene::armed();
    assert_eq!(scene.ask(1, lease, Request::Tare(Tare {})).1, Effect::Tare);
    let clear = || Request::ClearFault(ClearFault { device: "u2d2".to_owned() });
    assert!(scene.refused(1, lease, clear()).contains("disarm"));
    scene.accepted(1, lease, Request::Stop(Stop {}));
    assert_eq!(scene.ask(1, lease, clear()).1, Effect::ClearFault("u2d2".to_owned()));
}

#[test]
fn a_connection_that_is_lost_gives_nothing_back_and_keeps_nothing_alive() {
    let (mut scene, lease) = Scene::armed();
    scene.desk.lost(scene.now_ns, &mut scene.supervisor, 2);
    assert_eq!(scene.phase(), Phase::Armed, "that one moves nothing");
    scene.desk.lost(scene.now_ns, &mut scene.supervisor, 1);
    assert_eq!(scene.phase(), Phase::Holding);
    assert_eq!(scene.supervisor.status(scene.now_ns).holder, "Ada");
    // Whoever comes back under the same number starts anew.
    scene.sequences.clear();
    assert!(scene.refused(1, lease, Request::Heartbeat(Heartbeat {})).contains("not yours"));
    scene.wait(160 * MS);
    assert_eq!(scene.phase(), Phase::Holding);
    scene.wait(400 * MS);
    assert_eq!(scene.phase(), Phase::Disarmed);
}

#[test]
fn heartbeats_overtake_and_do_not_make_other_requests_old() {
    let (mut scene, lease) = Scene::armed();
    let newest = scene.sequences[&1];
    let (beat, _) = scene.numbered(1, newest + 2, lease, Request::Heartbeat(Heartbeat {}));
    assert!(beat.accepted);
    let (overtaken, _) = scene.numbered(1, newest + 1, lease, targets(&[7], &[0.4]));
    assert!(overtaken.accepted, "{}", overtaken.problem);
    let (old, _) = scene.numbered(1, newest + 1, lease, Request::Heartbeat(Heartbeat {}));
    assert!(!old.accepted);
}

#[test]
fn only_the_secret_number_of_an_open_connection_proves_who_is_the_operator() {
    let (mut scene, lease) = Scene::armed();
    assert!(lease > u64::from(u32::MAX), "small numbers could be tried out: {lease}");
    let operator = |scene: &Scene, lease: u64| {
        let claim = Claim { lease, peer: "10.0.0.7:4000".into() };
        scene.desk.operator(scene.now_ns, &scene.supervisor, &claim, "run a motion")
    };
    let who = operator(&scene, lease).unwrap().who;
    assert_eq!(who.name, "Ada");
    assert!(
        who.connection.contains("control 1") && who.connection.contains("10.0.0.7"),
        "{}",
        who.connection
    );
    for guess in (0..=10_000).chain([lease + 1, lease - 1, u64::MAX]) {
        let refused = operator(&scene, guess).unwrap_err();
        assert_eq!(refused, "only the operator may run a motion, and \"Ada\" has control");
    }
    scene.accepted(2, 0, acquire("Bob", true));
    assert!(operator(&scene, lease).unwrap_err().contains("Bob"), "an old lease proves nothing");
    let (mut scene, lease) = Scene::armed();
    scene.desk.lost(scene.now_ns, &mut scene.supervisor, 1);
    assert!(operator(&scene, lease).is_err(), "its connection is gone");
}

#[test]
fn whoever_may_not_operate_can_do_nothing_but_stop() {
    let (mut scene, lease) = Scene::armed();
    let viewer = Caller { connection: 7, peer: "10.0.0.7:4000 (eve)".into(), may_operate: false };
    let Scene { desk, supervisor, now_ns, commands, busy, .. } = &mut scene;
    let times = Times { now_ns: *now_ns, received_ns: *now_ns };
    let mut ask = |sequence, request| {
        // Even with the number of the lease in force.
        let request = ControlRequest { sequence, lease, request: Some(request) };
        desk.handle(times, supervisor, commands, *busy, &viewer, &request)
    };
    for (sequence, request) in [
        acquire("Eve", true),
        Request::Release(palpate_wire::proto::Release {}),
        Request::Heartbeat(Heartbeat {}),
        Request::Disarm(palpate_wire::proto::Disarm {}),
        targets(&[7], &[0.1]),
        Request::Tare(Tare {}),
    ]
    .into_iter()
    .enumerate()
    {
        let refused = ask(sequence as u64 + 1, request).unwrap_err().into_text();
        assert!(refused.contains("role of operator"), "{refused}");
    }
    assert_eq!(ask(1, Request::Stop(Stop {})), Ok(Effect::Nothing));
    assert_eq!(scene.phase(), Phase::Stopped);
    assert!(scene.supervisor.status(scene.now_ns).reason.contains("eve"));
}
