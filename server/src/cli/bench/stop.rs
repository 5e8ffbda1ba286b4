//! STOP while everything else is busy: from a client's message to the bytes that switch the servos off.
//!
//! The studio is a process of its own, as it is in a lab. The emulated devices and all clients are in this one; what presses
//! STOP and watches the servos runs in real time, so that it measures the studio and not itself.

mod load;

use std::{
    net::SocketAddr,
    path::Path,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use clap::Args;
use palpate_drivers::{PortOverride, priority};
use palpate_emulator::StationControl;
use palpate_server::{EmulatedDevices, Error, assets};
use palpate_sim::job::Progress as _;
use palpate_terminal::{Bar, cancel_on_ctrl_c};
use palpate_truth::record_session;
use palpate_wire::{
    api::LiveDocument,
    proto::{
        Acquire, Arm, ControlReply, ControlRequest, Heartbeat, ResetStop, Stop, Targets,
        control_request::Request,
    },
};
use prost::Message as _;
use serde::Serialize;
use tokio_tungstenite::tungstenite::{Message, WebSocket, connect, stream::MaybeTlsStream};

use super::{output, stream::operator::ask, studio::Studio};
use load::{Load, LoadReport};

/// A press that is not carried out in this time is unanswered.
const UNANSWERED: Duration = Duration::from_secs(20);
/// Heartbeats, as a page sends them.
const HEARTBEAT: Duration = Duration::from_millis(40);
/// The servos are looked at this often.
const LOOK: Duration = Duration::from_micros(200);
/// Arming is asked for this long, again and again: holding back is what a station does when its computer is too busy.
const ARMING: Duration = Duration::from_secs(60);
/// The motion goes on for this long before it is stopped: past easing in.
const MOTION: Duration = Duration::from_millis(300);

#[derive(Args)]
pub(crate) struct StopArgs {
    /// How often STOP is pressed
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u16).range(1..))]
    presses: u16,
    /// Press without any load, for comparison
    #[arg(long)]
    idle: bool,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

/// Of all presses, ms.
#[derive(Debug, Serialize)]
struct Delays {
    median: f64,
    p99: f64,
    max: f64,
}

#[derive(Debug, Serialize)]
struct StopBenchReport {
    presses: usize,
    /// Presses that were not carried out within 20 s.
    unanswered: usize,
    /// From before the message is sent until no servo of the hand has torque.
    message_to_torque_off_ms: Delays,
    /// From before the message is sent until the reply, which readings confirm.
    message_to_reply_ms: Delays,
    /// Replies that readings confirmed.
    confirmed: usize,
    /// Times at which the station held or disarmed though the operator sent heartbeats.
    nuisance_holds: usize,
    /// The control loop: mean rate, and rate of its worst second, Hz.
    loop_hz: [f64; 2],
    /// The studio's memory at its largest, MB.
    peak_memory_mb: f64,
    load: LoadReport,
}

pub(super) fn run(args: &StopArgs) -> Result<(), Error> {
    let (truth, unpacked) = assets::truth(Path::new("demo"))?;
    let data = tempfile::tempdir().map_err(Error::io("make", std::env::temp_dir()))?;
    let session = data.path().join("sessions/load");
    record_session(&truth, &session, 0, &Bar::new(), &cancel_on_ctrl_c())?;
    let devices = EmulatedDevices::start(&truth, 0)?;
    let studio = start_studio(data.path(), &devices)?;
    let load = match args.idle {
        true => None,
        false => Some(Load::start(studio.addr, &session)?),
    };
    let measured = presses(args, &studio, devices.control());
    let load = load.map(Load::end).unwrap_or_default();
    let report = measured.map(|measured| measured.report(load, &studio))?;
    drop(studio);
    drop(unpacked);
    if args.json {
        return output::json(&report);
    }
    let Delays { median, p99, max } = &report.message_to_torque_off_ms;
    output::line(&format!(
        "{} presses, {} unanswered: torque off after {median:.1} ms (median), {p99:.1} ms (99th percentile), {max:.1} ms \
         (longest); {} nuisance holds; control loop {:.1} Hz, worst second {:.1} Hz",
        report.presses, report.unanswered, report.nuisance_holds, report.loop_hz[0], report.loop_hz[1]
    ))
}

/// `palpate serve` on emulated devices of this process.
fn start_studio(data: &Path, devices: &EmulatedDevices) -> Result<Studio, Error> {
    let mut args = vec!["--station".to_owned(), devices.station().id.clone()];
    for (id, port) in devices.ports() {
        let place = match port {
            PortOverride::Serial(path) => path.display().to_string(),
            PortOverride::Arm { address, command_port, report_port } => {
                format!("{address}:{command_port}/{report_port}")
            }
        };
        args.extend(["--port".to_owned(), format!("{id}={place}")]);
    }
    Studio::start(data, &args)
}

/// A command socket.
struct Client {
    socket: WebSocket<MaybeTlsStream<std::net::TcpStream>>,
    sequence: u64,
    lease: u64,
}

impl Client {
    fn connect(addr: SocketAddr) -> Result<Self, Error> {
        let (socket, _) = connect(format!("ws://{addr}/api/v1/control")).map_err(|err| broken(&err))?;
        if let MaybeTlsStream::Plain(stream) = socket.get_ref() {
            stream
                .set_nodelay(true)
                .and_then(|()| stream.set_read_timeout(Some(UNANSWERED)))
                .map_err(|err| broken(&err))?;
        }
        Ok(Self { socket, sequence: 0, lease: 0 })
    }

    fn send(&mut self, request: Request) -> Result<u64, Error> {
        self.sequence += 1;
        let request = ControlRequest { sequence: self.sequence, lease: self.lease, request: Some(request) };
        self.socket.send(Message::Binary(request.encode_to_vec().into())).map_err(|err| broken(&err))?;
        Ok(self.sequence)
    }

    fn reply(&mut self, sequence: u64) -> Result<ControlReply, Error> {
        loop {
            let message = self.socket.read().map_err(|err| broken(&err))?;
            if let Message::Binary(bytes) = message {
                let reply = ControlReply::decode(bytes).map_err(|err| broken(&err))?;
                if reply.sequence == sequence {
                    self.lease = reply.lease;
                    return Ok(reply);
                }
            }
        }
    }

    fn ask(&mut self, request: Request) -> Result<ControlReply, Error> {
        let sequence = self.send(request)?;
        self.reply(sequence)
    }
}

fn broken(err: &dyn std::fmt::Display) -> Error {
    Error::Internal(format!("a command failed: {err}"))
}

/// Somebody in control, whose heartbeats come from a thread in real time.
struct Operator {
    client: Arc<Mutex<Client>>,
    alive: Arc<AtomicBool>,
    heart: Option<thread::JoinHandle<()>>,
}

impl Operator {
    fn start(addr: SocketAddr) -> Result<Self, Error> {
        let mut client = Client::connect(addr)?;
        let acquired =
            client.ask(Request::Acquire(Acquire { operator: "Ada".to_owned(), take_over: false }))?;
        if !acquired.accepted {
            return Err(broken(&acquired.problem));
        }
        let client = Arc::new(Mutex::new(client));
        let alive = Arc::new(AtomicBool::new(true));
        let heart = thread::spawn({
            let (client, alive) = (client.clone(), alive.clone());
            move || {
                priority::real_time();
                while alive.load(Ordering::Relaxed) {
                    let beat = client
                        .lock()
                        .unwrap_or_else(PoisonError::into_inner)
                        .ask(Request::Heartbeat(Heartbeat {}));
                    if beat.is_err() {
                        return;
                    }
                    thread::sleep(HEARTBEAT);
                }
            }
        });
        Ok(Self { client, alive, heart: Some(heart) })
    }

    fn ask(&self, request: Request) -> Result<ControlReply, Error> {
        self.client.lock().unwrap_or_else(PoisonError::into_inner).ask(request)
    }
}

impl Drop for Operator {
    fn drop(&mut self) {
        self.alive.store(false, Ordering::Relaxed);
        if let Some(heart) = self.heart.take() {
            // A panic of it was printed.
            let _ = heart.join();
        }
    }
}

#[derive(Default)]
struct Measured {
    torque_off_ms: Vec<f64>,
    reply_ms: Vec<f64>,
    unanswered: usize,
    confirmed: usize,
    nuisance_holds: usize,
    loop_hz: [f64; 2],
}

impl Measured {
    fn report(self, load: LoadReport, studio: &Studio) -> StopBenchReport {
        StopBenchReport {
            presses: self.torque_off_ms.len() + self.unanswered,
            unanswered: self.unanswered,
            message_to_torque_off_ms: delays(&self.torque_off_ms),
            message_to_reply_ms: delays(&self.reply_ms),
            confirmed: self.confirmed,
            nuisance_holds: self.nuisance_holds,
            loop_hz: self.loop_hz,
            peak_memory_mb: studio.peak_memory_mb(),
            load,
        }
    }
}

fn delays(ms: &[f64]) -> Delays {
    let mut ms = ms.to_vec();
    ms.sort_by(f64::total_cmp);
    // The smallest value that at least the share of all is not above.
    let quantile = |share: f64| {
        let rank = (share * ms.len() as f64).ceil() as usize;
        ms.get(rank.clamp(1, ms.len().max(1)) - 1).copied().unwrap_or(f64::NAN)
    };
    Delays { median: quantile(0.5), p99: quantile(0.99), max: quantile(1.0) }
}

/// Arms, moves and stops again and again.
fn presses(args: &StopArgs, studio: &Studio, station: &StationControl) -> Result<Measured, Error> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|err| Error::Internal(format!("failed to start a runtime: {err}")))?;
    let live = || runtime.block_on(ask::<LiveDocument>(studio.addr, 0, "GET", "live", None::<&()>));
    let begun = Instant::now();
    while !live().is_ok_and(|live| {
        !live.devices.is_empty() && live.devices.iter().all(|device| device.link == "ready")
    }) {
        if begun.elapsed() > ARMING {
            return Err(Error::Internal("the devices were never all ready".to_owned()));
        }
        thread::sleep(Duration::from_millis(100));
    }
    priority::real_time();
    let operator = Operator::start(studio.addr)?;
    let mut stopper = Client::connect(studio.addr)?;
    let carrier = &station.station().carrier_dofs;
    let hand: Vec<usize> =
        (0..station.station().robot.num_dofs()).filter(|dof| !carrier.contains(dof)).collect();
    let bar = Bar::new();
    let mut measured = Measured::default();
    for press in 0..args.presses {
        measured.nuisance_holds += arm_and_move(&operator, station, &hand, press)?;
        let sent = Instant::now();
        let sequence = stopper.send(Request::Stop(Stop {}))?;
        let torque_off = loop {
            let torque_on = station.snapshot().torque_on;
            if hand.iter().all(|&dof| !torque_on[dof]) {
                break Some(sent.elapsed());
            }
            if sent.elapsed() > UNANSWERED {
                break None;
            }
            thread::sleep(LOOK);
        };
        match torque_off {
            Some(after) => measured.torque_off_ms.push(after.as_secs_f64() * 1e3),
            None => measured.unanswered += 1,
        }
        let reply = stopper.reply(sequence)?;
        measured.reply_ms.push(sent.elapsed().as_secs_f64() * 1e3);
        measured.confirmed += usize::from(reply.stop_confirmed);
        let reset = operator.ask(Request::ResetStop(ResetStop {}))?;
        if !reset.accepted {
            return Err(broken(&reset.problem));
        }
        bar.report(f64::from(press + 1) / f64::from(args.presses), "pressing STOP");
    }
    if let Ok(live) = live() {
        measured.loop_hz = [live.loop_hz[1], live.loop_hz[2]];
    }
    Ok(measured)
}

/// Has the hand move; gives how often the station held or let go before it should.
fn arm_and_move(
    operator: &Operator,
    station: &StationControl,
    hand: &[usize],
    press: u16,
) -> Result<usize, Error> {
    let begun = Instant::now();
    let mut holds = 0;
    let position = if press.is_multiple_of(2) { 0.6 } else { 0.2 };
    let dofs: Vec<u32> = hand.iter().filter_map(|&dof| u32::try_from(dof).ok()).take(3).collect();
    let targets = || Request::Targets(Targets { dofs: dofs.clone(), positions: vec![position; dofs.len()] });
    let mut was_armed = false;
    loop {
        if begun.elapsed() > ARMING {
            return Err(Error::Internal(format!(
                "the station could not be moved within {} s",
                ARMING.as_secs()
            )));
        }
        let armed = operator.ask(Request::Arm(Arm {}))?;
        let moved = operator.ask(targets())?;
        let is_hold = moved.problem.contains("holds:") || (was_armed && moved.problem.contains("disarmed"));
        holds += usize::from(is_hold);
        was_armed |= moved.accepted;
        if armed.accepted && moved.accepted {
            let until = Instant::now() + MOTION;
            while Instant::now() < until {
                let moved = operator.ask(targets())?;
                if !moved.accepted {
                    holds += 1;
                    break;
                }
                thread::sleep(Duration::from_millis(15));
            }
            let torque_on = station.snapshot().torque_on;
            if hand.iter().all(|&dof| torque_on[dof]) {
                return Ok(holds);
            }
        }
        thread::sleep(Duration::from_millis(30));
    }
}
