//! The connection to a studio: the command socket with its heartbeats, the live stream, and documents.
//!
//! Heartbeats go out from a thread of their own, but only while the thread of the policy has said lately that it is alive
//! ([`Link::alive`]): one that computes for too long or hangs is a policy that nobody stands behind.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use futures_util::{SinkExt as _, StreamExt as _};
use palpate_wire::proto::{
    Acquire, ControlReply, ControlRequest, Heartbeat, LiveFrame, Reflex, Release, StreamMessage,
    control_request::Request, stream_message,
};
use prost::Message as _;
use tokio::sync::mpsc;
use tokio_tungstenite::tungstenite::{ClientRequestBuilder, Message};

use crate::studio::Studio;

/// As pages send them: the station brakes after 0.15 s without one.
const HEARTBEAT: Duration = Duration::from_millis(50);
/// Heartbeats go on for so long after the policy was last heard of: two of its steps.
const ALIVE: Duration = Duration::from_millis(120);
/// A request that is not answered for so long failed. A stop takes a second at most to be confirmed.
const REPLY: Duration = Duration::from_secs(10);
/// Requests that wait to be sent: seconds of them.
const MOST_REQUESTS: usize = 256;
/// Frames that wait to be recorded; at 30 a second, one that waits for longer than a minute is dropped.
const MOST_FRAMES: usize = 2000;

/// Frames by which the station's clock is known: ten seconds of them, in which one comes fast, and clocks stay together.
const CLOCK_FRAMES: usize = 300;

/// A frame of the stream and when it came.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Counts frames of this link from 1.
    pub number: u64,
    /// When it was there.
    pub received: Instant,
    /// What it says.
    pub live: Arc<LiveFrame>,
}

/// An answer to a request that nobody waits for.
#[derive(Clone, Debug)]
pub struct Answered {
    /// What [`Link::send`] gave.
    pub sequence: u64,
    /// When it was there.
    pub received: Instant,
    /// What it says.
    pub reply: ControlReply,
}

#[derive(Default)]
struct State {
    newest: Option<Frame>,
    frames: VecDeque<Frame>,
    answers: VecDeque<Answered>,
    awaited: BTreeMap<u64, Option<ControlReply>>,
    /// Numbers of heartbeats that are not answered yet.
    beats: BTreeSet<u64>,
    /// The same of poses of the object.
    poses: BTreeSet<u64>,
    /// How many of those were refused since somebody asked, and why the last one was.
    refused_poses: Option<(u64, String)>,
    /// By how much this process's clock is ahead of the station's, s, as each of the last frames had it: the time that it took
    /// to arrive included.
    ahead_s: VecDeque<f64>,
    lease: u64,
    sequence: u64,
    alive_until: Option<Instant>,
    /// Why there is no control any more.
    ended: Option<String>,
}

struct Shared {
    /// What times of this process count from.
    begun: Instant,
    state: Mutex<State>,
    changed: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn end(&self, why: String) {
        self.lock().ended.get_or_insert(why);
        self.changed.notify_all();
    }
}

/// Control of a station through its studio, until this is dropped.
pub struct Link {
    shared: Arc<Shared>,
    requests: mpsc::Sender<ControlRequest>,
    network: Option<std::thread::JoinHandle<()>>,
}

impl Link {
    /// Takes control as `name` of what `studio` drives.
    ///
    /// # Errors
    /// A studio that cannot be reached, or that refuses because somebody else has control.
    pub fn connect(studio: &Studio, name: &str, take_over: bool) -> anyhow::Result<Self> {
        let studio = studio.clone();
        let (state, changed) = (Mutex::default(), Condvar::default());
        let shared = Arc::new(Shared { begun: Instant::now(), state, changed });
        let (requests, waiting) = mpsc::channel(MOST_REQUESTS);
        let (tell, told) = std::sync::mpsc::sync_channel(1);
        let network = {
            let shared = Arc::clone(&shared);
            let post = requests.downgrade();
            let run = move || {
                let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
                match runtime {
                    Ok(runtime) => runtime.block_on(converse(&studio, &shared, post, waiting, &tell)),
                    Err(err) => drop(tell.send(Err(err.into()))),
                }
                shared.end("the connection to the studio has ended".to_owned());
            };
            std::thread::Builder::new().name("network".to_owned()).spawn(run)?
        };
        told.recv().context("the network's thread ended")??;
        let link = Self { shared, requests, network: Some(network) };
        let acquire = Acquire { operator: name.to_owned(), take_over };
        let reply = link.ask(Request::Acquire(acquire))?;
        if !reply.accepted {
            bail!("the studio gives no control: {}", reply.problem);
        }
        link.alive();
        Ok(link)
    }

    /// The lease, which HTTP requests that only the operator may make carry.
    pub fn lease(&self) -> u64 {
        self.shared.lock().lease
    }

    /// The policy is there: heartbeats go on for a little while.
    pub fn alive(&self) {
        self.shared.lock().alive_until = Some(Instant::now() + ALIVE);
    }

    /// Sends a request; its answer comes with [`Self::answers`]. Gives its number.
    pub fn send(&self, request: Request) -> u64 {
        self.post(request, false)
    }

    /// Says where the object is. Nobody waits for the answer, and this is no sign of life of the policy.
    pub(crate) fn tell_pose(&self, pose: Request) {
        let mut state = self.shared.lock();
        state.sequence += 1;
        let (sequence, lease) = (state.sequence, state.lease);
        state.poses.insert(sequence);
        // A pose that finds no room is left out: the next one comes soon.
        if self.requests.try_send(ControlRequest { sequence, lease, request: Some(pose) }).is_err() {
            state.poses.remove(&sequence);
        }
    }

    /// That poses were refused since the last call, and why, if any were.
    pub(crate) fn refused_poses(&self) -> Option<String> {
        let (num_refused, why) = self.shared.lock().refused_poses.take()?;
        Some(format!("{num_refused} poses of the object were refused, the last one: {why}"))
    }

    /// The station's time at `at`, as its live frames count it; `None` before the first frame.
    pub(crate) fn station_time_s(&self, at: Instant) -> Option<f64> {
        let at_s = at.saturating_duration_since(self.shared.begun).as_secs_f64();
        // The frame that came fastest tells best.
        let ahead_s = self.shared.lock().ahead_s.iter().copied().reduce(f64::min)?;
        Some(at_s - ahead_s)
    }

    fn post(&self, request: Request, is_awaited: bool) -> u64 {
        // Numbers must arrive in their order, so that nothing comes between counting and sending.
        let mut state = self.shared.lock();
        let is_acquire = matches!(request, Request::Acquire(_));
        state.sequence += 1;
        let sequence = state.sequence;
        if is_awaited {
            state.awaited.insert(sequence, None);
        }
        let lease = if is_acquire { 0 } else { state.lease };
        if self.requests.try_send(ControlRequest { sequence, lease, request: Some(request) }).is_err() {
            // A network that takes nothing for seconds is none.
            state
                .ended
                .get_or_insert_with(|| "the connection to the studio takes no more requests".to_owned());
        }
        sequence
    }

    /// Sends a request and waits for its answer, whatever it is. The caller is alive meanwhile.
    ///
    /// # Errors
    /// A connection that ends, and no answer within ten seconds.
    pub fn ask(&self, request: Request) -> anyhow::Result<ControlReply> {
        let sequence = self.post(request, true);
        let begun = Instant::now();
        let mut state = self.shared.lock();
        loop {
            if let Some(Some(_)) = state.awaited.get(&sequence)
                && let Some(Some(reply)) = state.awaited.remove(&sequence)
            {
                return Ok(reply);
            }
            if let Some(why) = &state.ended {
                bail!("{why}");
            }
            if begun.elapsed() > REPLY {
                bail!("the studio did not answer within {} s", REPLY.as_secs());
            }
            state.alive_until = Some(Instant::now() + ALIVE);
            let waited = self.shared.changed.wait_timeout(state, HEARTBEAT);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// The same for what must be accepted.
    ///
    /// # Errors
    /// The same, and a refusal with its reason.
    pub fn must(&self, what: &str, request: Request) -> anyhow::Result<ControlReply> {
        let reply = self.ask(request)?;
        if !reply.accepted {
            bail!("{what} was refused: {}", reply.problem);
        }
        Ok(reply)
    }

    /// The newest frame, if there is one.
    pub fn newest(&self) -> Option<Frame> {
        self.shared.lock().newest.clone()
    }

    /// Waits for a frame after `number`, for `patience` at most; says nothing of being alive.
    pub fn frame_after(&self, number: u64, patience: Duration) -> Option<Frame> {
        let until = Instant::now() + patience;
        let mut state = self.shared.lock();
        loop {
            if let Some(frame) = state.newest.as_ref().filter(|frame| frame.number > number) {
                return Some(frame.clone());
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() || state.ended.is_some() {
                return None;
            }
            let waited = self.shared.changed.wait_timeout(state, left);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Frames since the last call, in order.
    pub fn frames(&self) -> Vec<Frame> {
        self.shared.lock().frames.drain(..).collect()
    }

    /// Answers since the last call, in order.
    pub fn answers(&self) -> Vec<Answered> {
        self.shared.lock().answers.drain(..).collect()
    }

    /// Why there is no control any more, if there is none.
    pub fn ended(&self) -> Option<String> {
        self.shared.lock().ended.clone()
    }

    /// Gives control back, which disarms: joints come to rest, then torque goes off.
    pub fn release(&self) {
        if self.ended().is_none() {
            // Without a connection there is nothing to give back.
            let _ = self.ask(Request::Release(Release {}));
        }
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        let (closed, _) = mpsc::channel(MOST_REQUESTS);
        // Without senders the conversation ends.
        self.requests = closed;
        if let Some(network) = self.network.take() {
            let _ = network.join();
        }
    }
}

/// Both sockets until the requests end or the studio does.
async fn converse(
    studio: &Studio,
    shared: &Shared,
    post: mpsc::WeakSender<ControlRequest>,
    mut requests: mpsc::Receiver<ControlRequest>,
    opened: &std::sync::mpsc::SyncSender<anyhow::Result<()>>,
) {
    let open = async |path: &str| {
        let url = studio.socket_url(path);
        let mut request = ClientRequestBuilder::new(url.parse()?);
        if let Some(token) = studio.token() {
            request = request.with_header("Authorization", format!("Bearer {token}"));
        }
        let connected = async {
            let stream = studio.connect().await?;
            anyhow::Ok(tokio_tungstenite::client_async(request, stream).await?.0)
        };
        connected.await.with_context(|| format!("failed to connect to {url}"))
    };
    let sockets = async { anyhow::Ok((open("control").await?, open("stream").await?)) };
    let (control, mut stream) = match sockets.await {
        Ok(sockets) => sockets,
        Err(err) => return drop(opened.send(Err(err))),
    };
    drop(opened.send(Ok(())));
    let (mut commands, mut replies) = control.split();
    let send = async {
        let mut beats = tokio::time::interval(HEARTBEAT);
        beats.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            let request = tokio::select! {
                biased;
                request = requests.recv() => match request {
                    Some(request) => request,
                    None => {
                        let _ = commands.close().await;
                        return "control was given back".to_owned();
                    }
                },
                _ = beats.tick() => {
                    heartbeat(shared, &post);
                    continue;
                }
            };
            let message = Message::Binary(request.encode_to_vec().into());
            if let Err(err) = commands.send(message).await {
                return format!("the connection to the studio has ended: {err}");
            }
        }
    };
    let receive = async {
        loop {
            match replies.next().await {
                Some(Ok(Message::Binary(bytes))) => match ControlReply::decode(bytes) {
                    Ok(reply) => take_reply(shared, reply),
                    Err(err) => return format!("the studio's reply makes no sense: {err}"),
                },
                Some(Ok(Message::Close(close))) => {
                    let why = close.map(|close| close.reason.to_string()).unwrap_or_default();
                    return format!("the studio closed the connection: {why}");
                }
                Some(Ok(_)) => {}
                Some(Err(err)) => return format!("the connection to the studio has ended: {err}"),
                None => return "the studio closed the connection".to_owned(),
            }
        }
    };
    let watch = async {
        loop {
            match stream.next().await {
                Some(Ok(Message::Binary(bytes))) => match StreamMessage::decode(bytes) {
                    Ok(message) => {
                        if let Some(stream_message::Message::Live(live)) = message.message {
                            take_frame(shared, live);
                        }
                    }
                    Err(err) => return format!("the studio's stream makes no sense: {err}"),
                },
                Some(Ok(Message::Close(_))) | None => {
                    return "the connection to the studio has ended: it sends no more frames".to_owned();
                }
                Some(Ok(_)) => {}
                Some(Err(err)) => {
                    return format!("the connection to the studio has ended: no more frames: {err}");
                }
            }
        }
    };
    let why = tokio::select! {
        why = send => why,
        why = receive => why,
        why = watch => why,
    };
    shared.end(why);
}

/// Queues a heartbeat behind what was posted before it, if somebody is there to stand behind it.
fn heartbeat(shared: &Shared, post: &mpsc::WeakSender<ControlRequest>) {
    let mut state = shared.lock();
    let is_alive = state.alive_until.is_some_and(|until| Instant::now() < until);
    if let Some(post) = post.upgrade()
        && state.lease != 0
        && is_alive
    {
        state.sequence += 1;
        let sequence = state.sequence;
        state.beats.insert(sequence);
        let request = Some(Request::Heartbeat(Heartbeat {}));
        // Where so much waits that there is no room, the policy learns of it by its own requests.
        let _ = post.try_send(ControlRequest { sequence, lease: state.lease, request });
    }
}

fn take_reply(shared: &Shared, reply: ControlReply) {
    let mut state = shared.lock();
    if state.lease != 0 && reply.lease == 0 && !reply.accepted {
        state.ended.get_or_insert_with(|| format!("control was lost: {}", reply.problem));
    }
    state.lease = reply.lease;
    // Nobody asks what became of a heartbeat, and an accepted one says nothing of targets that were refused.
    if state.beats.remove(&reply.sequence) {
        drop(state);
        return shared.changed.notify_all();
    }
    if state.poses.remove(&reply.sequence) {
        if !reply.accepted {
            let before = state.refused_poses.take().map_or(0, |(num_refused, _)| num_refused);
            state.refused_poses = Some((before + 1, reply.problem));
        }
        return;
    }
    match state.awaited.get_mut(&reply.sequence) {
        Some(waiting) => *waiting = Some(reply),
        None => {
            let sequence = reply.sequence;
            if state.answers.len() < MOST_FRAMES {
                state.answers.push_back(Answered { sequence, received: Instant::now(), reply });
            }
        }
    }
    drop(state);
    shared.changed.notify_all();
}

fn take_frame(shared: &Shared, live: LiveFrame) {
    let mut state = shared.lock();
    let number = state.newest.as_ref().map_or(1, |newest| newest.number + 1);
    let frame = Frame { number, received: Instant::now(), live: Arc::new(live) };
    let received_s = frame.received.saturating_duration_since(shared.begun).as_secs_f64();
    if state.ahead_s.len() >= CLOCK_FRAMES {
        state.ahead_s.pop_front();
    }
    state.ahead_s.push_back(received_s - frame.live.time_s);
    if state.frames.len() >= MOST_FRAMES {
        state.frames.pop_front();
    }
    state.frames.push_back(frame.clone());
    state.newest = Some(frame);
    drop(state);
    shared.changed.notify_all();
}

/// Switches the studio's reflex on, if there is the text of its file. It ends with the lease.
pub(crate) fn switch_reflex_on(link: &Link, config_toml: Option<&str>) -> anyhow::Result<()> {
    let Some(config_toml) = config_toml else { return Ok(()) };
    let reflex = Reflex { on: true, config_toml: config_toml.to_owned() };
    link.must("switching the reflex on", Request::Reflex(reflex)).map(drop)
}
