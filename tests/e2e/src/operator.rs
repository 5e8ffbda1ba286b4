//! An operator at the command socket of a studio, and somebody who watches its stream.

use std::{
    net::TcpStream,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use anyhow::{Context as _, bail};
use palpate_wire::proto::{
    Acquire, Arm, ControlReply, ControlRequest, ControlState, Heartbeat, LiveFrame, StreamMessage, Targets,
    control_request::Request, control_state::Phase, stream_message,
};
use prost::Message as _;
use tokio_tungstenite::tungstenite::{Message, WebSocket, connect, stream::MaybeTlsStream};

use crate::Studio;

type Socket = WebSocket<MaybeTlsStream<TcpStream>>;

/// Pages send heartbeats at 20 Hz; here somewhat faster, because the machine has other things to do.
const HEARTBEAT: Duration = Duration::from_millis(25);
/// Whatever is waited for comes long before this, unless it never does.
const PATIENCE: Duration = Duration::from_secs(120);

fn open(studio_url: &str, path: &str) -> anyhow::Result<Socket> {
    let url = format!("{}/api/v1/{path}", studio_url.replacen("http", "ws", 1));
    let (socket, _) = connect(&url).with_context(|| format!("failed to connect to {url}"))?;
    Ok(socket)
}

/// The requests that set joints to positions.
pub fn targets(wanted: &[(usize, f64)]) -> Request {
    let (dofs, positions) = wanted.iter().map(|&(dof, position)| (dof as u32, position)).unzip();
    Request::Targets(Targets { dofs, positions })
}

/// One connection to `/api/v1/control`. With a heartbeat, somebody is there who holds the page open.
pub struct Operator {
    connection: Arc<Mutex<Connection>>,
    alive: Arc<AtomicBool>,
    heart: Option<JoinHandle<()>>,
}

struct Connection {
    socket: Option<Socket>,
    sequence: u64,
    lease: u64,
}

impl Connection {
    /// Sends one request under `lease` and waits for its answer, whatever it is.
    fn ask(&mut self, lease: u64, request: Request) -> anyhow::Result<ControlReply> {
        let socket = self.socket.as_mut().context("the operator is gone")?;
        self.sequence += 1;
        let message = ControlRequest { sequence: self.sequence, lease, request: Some(request) };
        socket.send(Message::Binary(message.encode_to_vec().into()))?;
        loop {
            if let Message::Binary(bytes) = socket.read()? {
                let reply = ControlReply::decode(bytes)?;
                if reply.sequence != self.sequence {
                    bail!("expected the answer to {}, found {reply:?}", self.sequence);
                }
                self.lease = reply.lease;
                return Ok(reply);
            }
        }
    }
}

impl Operator {
    /// Opens the page, so to speak.
    pub fn connect(studio: &Studio) -> anyhow::Result<Self> {
        Self::connect_to(&studio.url)
    }

    /// Opens the page of the studio at `url`.
    pub fn connect_to(url: &str) -> anyhow::Result<Self> {
        let connection = Connection { socket: Some(open(url, "control")?), sequence: 0, lease: 0 };
        Ok(Self {
            connection: Arc::new(Mutex::new(connection)),
            alive: Arc::new(AtomicBool::new(false)),
            heart: None,
        })
    }

    /// Asks under the lease that this operator holds, if any.
    pub fn ask(&self, request: Request) -> anyhow::Result<ControlReply> {
        let mut connection = self.connection();
        let lease = connection.lease;
        connection.ask(lease, request)
    }

    /// Asks under another lease.
    pub fn ask_under(&self, lease: u64, request: Request) -> anyhow::Result<ControlReply> {
        self.connection().ask(lease, request)
    }

    /// Asks for what must be accepted.
    pub fn must(&self, request: Request) -> anyhow::Result<()> {
        let asked = format!("{request:?}");
        let reply = self.ask(request)?;
        if !reply.accepted {
            bail!("{asked} was refused: {}", reply.problem);
        }
        Ok(())
    }

    /// Asks for what must be refused; gives the reason.
    pub fn refused(&self, request: Request) -> anyhow::Result<String> {
        let asked = format!("{request:?}");
        let reply = self.ask(request)?;
        if reply.accepted || reply.problem.is_empty() {
            bail!("{asked} was not refused: {reply:?}");
        }
        Ok(reply.problem)
    }

    /// The lease that this operator holds; 0 for none.
    pub fn lease(&self) -> u64 {
        self.connection().lease
    }

    /// Takes control, and is there from now on.
    pub fn take_control(&mut self, name: &str) -> anyhow::Result<()> {
        self.must(Request::Acquire(Acquire { operator: name.to_owned(), take_over: false }))?;
        self.alive.store(true, Ordering::Relaxed);
        let (connection, alive) = (Arc::clone(&self.connection), Arc::clone(&self.alive));
        self.heart = Some(thread::spawn(move || {
            while alive.load(Ordering::Relaxed) {
                let mut connection = connection.lock().unwrap_or_else(PoisonError::into_inner);
                let lease = connection.lease;
                // The studio may be gone: that is what some tests are about.
                if connection.ask(lease, Request::Heartbeat(Heartbeat {})).is_err() {
                    return;
                }
                drop(connection);
                thread::sleep(HEARTBEAT);
            }
        }));
        Ok(())
    }

    /// Arms, and waits until it is so. A station that is still being connected is asked again.
    pub fn arm(&self, watcher: &Watcher) -> anyhow::Result<()> {
        let begun = Instant::now();
        loop {
            let reply = self.ask(Request::Arm(Arm {}))?;
            if reply.accepted {
                break;
            }
            if begun.elapsed() > PATIENCE {
                bail!("cannot arm: {}", reply.problem);
            }
            thread::sleep(Duration::from_millis(100));
        }
        watcher.wait_for_phase(Phase::Armed).map(drop)
    }

    /// Is killed: its connection ends without a word.
    pub fn vanish(&mut self) {
        self.alive.store(false, Ordering::Relaxed);
        self.connection().socket = None;
    }

    fn connection(&self) -> MutexGuard<'_, Connection> {
        self.connection.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Operator {
    fn drop(&mut self) {
        self.vanish();
        if let Some(heart) = self.heart.take() {
            let _failed = heart.join();
        }
    }
}

/// One connection to `/api/v1/stream`. It knows the newest state, because it reads all the time.
pub struct Watcher {
    newest: Arc<Mutex<Newest>>,
}

/// What came last; ends with the reason why nothing comes any more.
#[derive(Default)]
struct Newest {
    frame: Option<LiveFrame>,
    count: u64,
    end: Option<String>,
}

impl Watcher {
    /// Opens the stream.
    pub fn connect(studio: &Studio) -> anyhow::Result<Self> {
        Self::connect_to(&studio.url)
    }

    /// Opens the stream of the studio at `url`.
    pub fn connect_to(url: &str) -> anyhow::Result<Self> {
        let mut socket = open(url, "stream")?;
        let newest = Arc::<Mutex<Newest>>::default();
        let shared = Arc::downgrade(&newest);
        thread::spawn(move || {
            loop {
                let read = read_frame(&mut socket);
                let Some(newest) = shared.upgrade() else { return };
                let mut newest = newest.lock().unwrap_or_else(PoisonError::into_inner);
                match read {
                    Ok(frame) => {
                        newest.frame = Some(frame);
                        newest.count += 1;
                    }
                    Err(err) => {
                        newest.end = Some(format!("{err:#}"));
                        return;
                    }
                }
            }
        });
        Ok(Self { newest })
    }

    /// Waits until the station's state, from now on, is as wanted.
    pub fn wait_for(
        &self,
        what: &str,
        wanted: impl Fn(&ControlState) -> bool,
    ) -> anyhow::Result<ControlState> {
        let begun = Instant::now();
        let lock = || self.newest.lock().unwrap_or_else(PoisonError::into_inner);
        let before = lock().count;
        loop {
            let newest = lock();
            let control = newest.frame.as_ref().and_then(|frame| frame.control.as_ref());
            if let Some(state) = control.filter(|state| newest.count > before && wanted(state)) {
                return Ok(state.clone());
            }
            if begun.elapsed() > PATIENCE || newest.end.is_some() {
                bail!("never {what}: {control:?} {:?}", newest.end);
            }
            drop(newest);
            thread::sleep(Duration::from_millis(2));
        }
    }

    /// What came last, for messages.
    pub fn newest(&self) -> Option<LiveFrame> {
        self.newest.lock().unwrap_or_else(PoisonError::into_inner).frame.clone()
    }

    /// Waits for a phase.
    pub fn wait_for_phase(&self, phase: Phase) -> anyhow::Result<ControlState> {
        self.wait_for(&format!("{phase:?}"), |state| state.phase() == phase)
    }
}

fn read_frame(socket: &mut Socket) -> anyhow::Result<LiveFrame> {
    loop {
        let Message::Binary(bytes) = socket.read()? else { continue };
        if let Some(stream_message::Message::Live(frame)) = StreamMessage::decode(bytes)?.message {
            return Ok(frame);
        }
    }
}
