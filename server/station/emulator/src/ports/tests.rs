//! The station behind real terminals and sockets.

use std::io::{Read as _, Write as _};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::sync::mpsc;

use palpate_device_protocol::xarm::{Command, FrameDecoder, Protocol, Reply, ReportDecoder, ReportKind};

use super::*;
use crate::Fault;

const IP: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
/// Longer than anything here takes on a machine that has other things to do.
const PATIENCE: Duration = Duration::from_secs(60);

fn station() -> EmulatedStation {
    let truth = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../assets/truth/demo.toml");
    EmulatedStation::new(&truth, 0).expect("the demonstration's station")
}

/// Serves `station` in a folder of its own while `client` runs.
fn while_served(
    mut station: EmulatedStation,
    client: impl FnOnce(&DevicePorts, &Path),
) -> (EmulatedStation, Vec<String>) {
    let dir = tempfile::tempdir().expect("a folder");
    let config = PortsConfig { dir: dir.path().to_path_buf(), arm_ip: IP, arm_ports: ArmPorts::Any };
    let stop = AtomicBool::new(false);
    let (tell, told) = mpsc::sync_channel(1);
    let mut notices = Vec::new();
    std::thread::scope(|scope| {
        let served = scope.spawn(|| {
            let mut ready = |ports: &DevicePorts| tell.send(ports.clone()).expect("somebody waits");
            serve_devices(&mut station, &config, &stop, &mut ready, &mut |notice| notices.push(notice))
        });
        let ports = told.recv_timeout(PATIENCE).expect("the station is ready");
        // The devices end even where the client's checks fail.
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| client(&ports, dir.path())));
        stop.store(true, Ordering::Relaxed);
        served.join().expect("no panic").expect("served");
        outcome.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
    });
    (station, notices)
}

fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let start = Instant::now();
    while !is_so() {
        assert!(start.elapsed() < PATIENCE, "{what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn connect(port: u16) -> Option<TcpStream> {
    let stream = TcpStream::connect((IP, port)).ok()?;
    stream.set_read_timeout(Some(PATIENCE)).ok()?;
    Some(stream)
}

/// The box's answer to a question on its command port.
fn ask(stream: &mut TcpStream, command: &Command) -> Reply {
    let frame = command.to_frame(1, Protocol::Plain).and_then(|frame| frame.encode()).expect("a frame");
    stream.write_all(&frame).expect("a box that listens");
    let mut decoder = FrameDecoder::default();
    let mut bytes = [0; 256];
    loop {
        let count = stream.read(&mut bytes).expect("an answer");
        assert!(count > 0, "the box hung up");
        if let Some(answer) = decoder.feed(&bytes[..count]).first() {
            return Reply::from_frame(answer).expect("a reply").1;
        }
    }
}

#[test]
fn free_ports_are_told_work_and_come_back_after_the_arm_was_unplugged() {
    let (_, notices) = while_served(station(), |ports, dir| {
        let arm = ports.arm_ports;
        let mut all = vec![arm.command, arm.realtime, arm.normal, arm.rich, arm.real];
        all.sort_unstable();
        all.dedup();
        assert!(all.len() == 5 && all[0] >= 1024, "{arm:?}");
        assert!(ports.links.iter().all(|(name, link)| *link == dir.join(name) && link.exists()));

        let mut client = connect(arm.command).expect("the command port");
        assert!(matches!(ask(&mut client, &Command::GetState {}), Reply::State { state: 4 }));
        for (port, kind) in [
            (arm.realtime, ReportKind::Realtime),
            (arm.normal, ReportKind::Normal),
            (arm.rich, ReportKind::Normal),
            (arm.real, ReportKind::Real),
        ] {
            let mut stream = connect(port).expect("a report port");
            let mut decoder = ReportDecoder::new(kind);
            let mut bytes = [0; 1024];
            let mut reports = Vec::new();
            while reports.is_empty() {
                let count = stream.read(&mut bytes).expect("a report");
                assert!(count > 0, "{kind:?}: the box hung up");
                reports = decoder.feed(&bytes[..count]);
            }
            assert_eq!(decoder.counters().malformed, 0, "{kind:?}");
        }

        let file = dir.join(FAULTS_FILE);
        std::fs::write(&file, "[[fault]]\nkind = \"unplug\"\ndevice = \"xarm\"\n").expect("a file");
        until("the arm's ports stay", || connect(arm.command).is_none() && connect(arm.real).is_none());
        until("the client keeps its link", || matches!(client.read(&mut [0; 16]), Ok(0) | Err(_)));
        // Somebody else is on one of the ports when the arm comes back.
        let thief = TcpListener::bind((IP, arm.rich));
        std::fs::remove_file(&file).expect("the file");
        std::thread::sleep(2 * FAULTS_EVERY);
        drop(thief);
        until("the arm does not come back", || connect(arm.real).is_some());
        let mut client = connect(arm.command).expect("the same port");
        assert!(matches!(ask(&mut client, &Command::GetState {}), Reply::State { state: 4 }));
    });
    assert!(
        notices.iter().all(|notice| notice.contains("come back") || notice.contains("fell behind")),
        "{notices:?}"
    );
}

#[test]
fn a_handle_works_while_the_station_runs_and_a_file_of_faults_that_changes_has_the_last_word() {
    let station = station();
    let control = station.control();
    let unplugged = |device: &str| Faults { faults: vec![Fault::Unplug { device: device.into() }] };
    let (_, notices) = while_served(station, |ports, dir| {
        until("time stands still", || control.snapshot().device_ns > 10_000_000);
        control.set_faults(unplugged("fsr")).expect("faults");
        let gone = |name: &str| !dir.join(name).exists();
        until("the board is there", || gone("fsr"));
        control.set_faults(unplugged("xarm")).expect("faults");
        until("the board stays away", || !gone("fsr"));
        until("the arm is there", || connect(ports.arm_ports.command).is_none());
        std::fs::write(dir.join(FAULTS_FILE), "[[fault]]\nkind = \"unplug\"\ndevice = \"twintac0\"\n")
            .expect("a file");
        until("the file is not read", || gone("twintac0") && control.faults() == unplugged("twintac0"));
        until("the arm stays away", || connect(ports.arm_ports.command).is_some());
        control.place_object(None).expect("nothing");
        until("the object stays", || control.snapshot().object.is_none());
    });
    assert!(notices.iter().all(|n| n.contains("come back") || n.contains("fell behind")), "{notices:?}");
}
