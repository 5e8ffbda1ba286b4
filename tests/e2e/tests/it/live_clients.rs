//! Everybody watches while a station records: a page, a script of the Python client, and Foxglove.

use std::{
    collections::BTreeMap,
    io::{BufRead as _, BufReader, Read as _},
    net::TcpStream,
    path::Path,
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, bail};
use e2e::{Studio, Tools, alone, root};
use palpate_recording::Take;
use palpate_wire::proto::{LiveFrame, StreamMessage, control_state::Phase, stream_message};
use prost::Message as _;
use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::{
    Message, WebSocket, client::IntoClientRequest as _, connect, http::HeaderValue, stream::MaybeTlsStream,
};

use crate::scene::{Scene, recording};

/// For how long they watch, s, unless `PALPATE_MINUTES` says otherwise.
const WATCH_S: u64 = 8;
/// Frames are published so often, Hz.
const FRAMES_HZ: f64 = 30.0;
/// A client gets at least this share of them: the rest is what a busy machine may cost.
const MIN_SHARE: f64 = 0.9;
/// The control loop turns so often, Hz, and keeps these shares of it: on average, and in its worst second.
const LOOP_HZ: f64 = 200.0;
const LOOP_SHARES: [f64; 2] = [0.97, 0.8];
/// Boards send as often as the station says, but for so much: a busy machine moves the times of the first and last
/// sample.
const RATE_TOLERANCE: f64 = 0.02;
/// How often the checklist is looked at.
const LOOK: Duration = Duration::from_millis(50);

/// What a client of the stream saw.
#[derive(Clone, Debug, Default)]
struct Seen {
    frames: usize,
    /// From the first frame to the last, by the station's clock, s.
    station_s: f64,
    longest_step_s: f64,
    /// Frames that it was told it lost.
    dropped: u64,
    /// Turns of the control loop in the second before each frame, Hz.
    loop_hz: Vec<f64>,
    /// Samples that the recorder could not keep.
    lost_samples: u64,
    /// Frames of boards and servos that drivers could not read meanwhile.
    bad_frames: u64,
    /// Frames while a motion was recorded.
    recorded: usize,
}

type Socket = WebSocket<MaybeTlsStream<TcpStream>>;

fn open(url: &str, path: &str, protocol: Option<&'static str>) -> anyhow::Result<Socket> {
    let mut request = format!("{}/api/v1/{path}", url.replacen("http", "ws", 1)).into_client_request()?;
    if let Some(protocol) = protocol {
        request.headers_mut().insert("Sec-WebSocket-Protocol", HeaderValue::from_static(protocol));
    }
    let (socket, _) = connect(request).with_context(|| format!("failed to connect to {path}"))?;
    Ok(socket)
}

/// Reads the stream as the page does.
fn watch_page(url: &str, until: Instant) -> anyhow::Result<Seen> {
    let mut socket = open(url, "stream", None)?;
    let (mut seen, mut last_s, mut bad_before) = (Seen::default(), None, None);
    while Instant::now() < until {
        let Message::Binary(bytes) = socket.read()? else { continue };
        let message = StreamMessage::decode(bytes)?;
        seen.dropped = seen.dropped.max(message.dropped);
        let Some(stream_message::Message::Live(frame)) = message.message else { continue };
        seen.frames += 1;
        if let Some(before_s) = last_s.replace(frame.time_s) {
            let step_s: f64 = frame.time_s - before_s;
            anyhow::ensure!(step_s > 0.0, "a frame of {} s follows one of {before_s} s", frame.time_s);
            seen.station_s += step_s;
            seen.longest_step_s = seen.longest_step_s.max(step_s);
        }
        let control = frame.control.context("a frame without the state of control")?;
        seen.loop_hz.push(f64::from(control.loop_hz));
        let recording = recording(&control);
        seen.lost_samples = seen.lost_samples.max(recording.lost_samples);
        let bad_frames: u64 = control.devices.iter().map(|device| device.bad_frames).sum();
        seen.bad_frames = bad_frames - *bad_before.get_or_insert(bad_frames);
        seen.recorded += usize::from(recording.phase == "running");
    }
    Ok(seen)
}

/// Messages that a client of Foxglove's protocol got, by topic.
type Topics = BTreeMap<String, u64>;

/// Subscribes to every channel, as Foxglove does with a panel for each. Gives what came, and what the studio complained
/// of.
fn watch_foxglove(url: &str, until: Instant) -> anyhow::Result<(Topics, Vec<String>)> {
    let mut socket = open(url, "foxglove", Some("foxglove.sdk.v1"))?;
    let (mut topics, mut complaints) = (Topics::new(), Vec::new());
    let mut by_subscription: BTreeMap<u32, (String, u64)> = BTreeMap::new();
    while Instant::now() < until {
        match socket.read()? {
            Message::Text(text) => {
                let message: Value = serde_json::from_str(&text)?;
                match message["op"].as_str() {
                    Some("advertise") => {
                        let channels = message["channels"].as_array().context("no channels")?;
                        let wanted = channels.iter().enumerate().map(|(number, channel)| {
                            let topic = channel["topic"].as_str().unwrap_or_default().to_owned();
                            topics.entry(topic.clone()).or_default();
                            by_subscription.insert(number as u32, (topic, 0));
                            json!({ "id": number, "channelId": channel["id"] })
                        });
                        let wanted: Vec<Value> = wanted.collect();
                        let request = json!({ "op": "subscribe", "subscriptions": wanted });
                        socket.send(Message::Text(request.to_string().into()))?;
                    }
                    Some("status") => complaints.push(message["message"].to_string()),
                    _ => {}
                }
            }
            // 1, the subscription, ns since 1970, then the message.
            Message::Binary(bytes) if bytes.first() == Some(&1) && bytes.len() >= 13 => {
                let subscription = u32::from_le_bytes(bytes[1..5].try_into()?);
                let time_ns = u64::from_le_bytes(bytes[5..13].try_into()?);
                let (topic, last_ns) =
                    by_subscription.get_mut(&subscription).context("a message of no subscription")?;
                anyhow::ensure!(time_ns >= *last_ns, "{topic} goes back in time");
                *last_ns = time_ns;
                if topic == "/live" {
                    LiveFrame::decode(&bytes[13..])?;
                }
                *topics.entry(topic.clone()).or_default() += 1;
            }
            _ => {}
        }
    }
    Ok((topics, complaints))
}

/// The Python client, which watches from when this returns on.
fn start_python(
    tools: &Tools,
    url: &str,
    seconds: u64,
) -> anyhow::Result<(Child, BufReader<std::process::ChildStdout>)> {
    let mut process = Command::new(&tools.python)
        .arg(root().join("tests/e2e/python/watch_live.py"))
        .args([url, &seconds.to_string()])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()?;
    let mut output = BufReader::new(process.stdout.take().context("it has no standard output")?);
    let mut line = String::new();
    output.read_line(&mut line)?;
    anyhow::ensure!(line.contains("watching"), "the Python client did not begin: {line:?}");
    Ok((process, output))
}

/// Goes through the checklist until `until`, as an operator does; a take that runs then is cut off. Gives how often the
/// station held meanwhile, which it must where the machine is too slow.
fn record(scene: &Scene, until: Instant) -> anyhow::Result<usize> {
    let Scene { operator, watcher, studio, bench, .. } = scene;
    let lease = operator.lease();
    let act = |action: Value| studio.post_under(lease, "/recording/act", &action);
    let (mut holds, mut at_start) = (0, None);
    while Instant::now() < until {
        thread::sleep(LOOK);
        if watcher.wait_for("any state", |_| true)?.phase() != Phase::Armed {
            holds += 1;
            at_start = None;
            operator.arm(watcher)?;
        }
        let session = studio.get("/recording")?["session"].take();
        let step = session["current"].as_u64();
        let action = match session["phase"].as_str() {
            Some("place_object") => {
                let object = session["steps"][step.unwrap_or(0) as usize]["object"].as_str();
                bench.control.place_object(object)?;
                json!({ "action": "confirm_object", "fixture_trusted": true })
            }
            Some("start_pose") if at_start == step => json!({ "action": "run" }),
            Some("start_pose") => {
                at_start = step;
                json!({ "action": "go_to_start" })
            }
            Some("review") => json!({ "action": "accept" }),
            _ => continue,
        };
        // A step that a hold has undone is asked for again.
        if let Err(err) = act(action) {
            eprintln!("while recording: {err:#}");
            at_start = None;
        }
    }
    if recording(&watcher.wait_for("any state", |_| true)?).phase == "running" {
        act(json!({ "action": "cancel" }))?;
        watcher.wait_for("the take to end", |state| {
            matches!(recording(state).phase.as_str(), "review" | "place_object")
        })?;
    }
    Ok(holds)
}

/// Counts what lies in the takes of `session`, and refuses streams that lack samples: their rate is that of the
/// station. Gives takes, samples, seconds of all, and the longest time between two samples.
fn check_takes(session: &Path) -> anyhow::Result<(usize, usize, f64, f64)> {
    let (mut num_takes, mut num_samples, mut length_s, mut longest_s) = (0, 0, 0.0, 0.0_f64);
    for entry in std::fs::read_dir(session)? {
        let path = entry?.path();
        if path.extension().is_none_or(|extension| extension != "mcap") {
            continue;
        }
        let take = Take::read(&path)?;
        (num_takes, length_s) = (num_takes + 1, length_s + take.duration_s());
        for (stream, log) in take.station.layout.streams.iter().zip(&take.streams) {
            let [first_s, .., last_s] = log.times_s[..] else {
                bail!("{}: stream {} has {} samples", take.id, stream.id, log.times_s.len());
            };
            let rate_hz = (log.times_s.len() - 1) as f64 / (last_s - first_s);
            anyhow::ensure!(
                (rate_hz / stream.rate_hz - 1.0).abs() < RATE_TOLERANCE,
                "{}: stream {} has {rate_hz} samples a second, the station says {}",
                take.id,
                stream.id,
                stream.rate_hz
            );
            longest_s = log.times_s.windows(2).map(|pair| pair[1] - pair[0]).fold(longest_s, f64::max);
            num_samples += log.times_s.len();
        }
    }
    Ok((num_takes, num_samples, length_s, longest_s))
}

#[test]
fn page_script_and_foxglove_watch_while_a_session_is_recorded_and_nothing_is_lost() {
    let Some(tools) = Tools::find() else { return };
    let minutes = std::env::var("PALPATE_MINUTES").ok().and_then(|minutes| minutes.parse::<f64>().ok());
    let seconds = minutes.map_or(WATCH_S, |minutes| (minutes * 60.0).ceil() as u64);
    let scene = Scene::armed_with(alone(), |data, station| Studio::serve(&tools, data, station)).unwrap();
    scene.begin_session().unwrap();
    let url = scene.studio.url.as_str();
    let (mut script, mut output) = start_python(&tools, url, seconds).unwrap();
    let until = Instant::now() + Duration::from_secs(seconds);
    let (page, foxglove, holds) = thread::scope(|scope| {
        let page = scope.spawn(|| watch_page(url, until));
        let foxglove = scope.spawn(|| watch_foxglove(url, until));
        let holds = record(&scene, until);
        let page = page.join().expect("the page").unwrap();
        let foxglove = foxglove.join().expect("Foxglove").unwrap();
        (page, foxglove, holds.unwrap())
    });
    let mut text = String::new();
    output.read_to_string(&mut text).unwrap();
    assert!(script.wait().unwrap().success(), "the Python client failed; its output is above");
    let script: Value = serde_json::from_str(&text).unwrap();

    let (num_takes, num_samples, takes_s, longest_s) =
        check_takes(&scene.data.path().join("sessions/monday")).unwrap();
    let mean_hz = page.loop_hz.iter().sum::<f64>() / page.loop_hz.len().max(1) as f64;
    let worst_hz = page.loop_hz.iter().copied().fold(f64::INFINITY, f64::min);
    let (topics, complaints) = foxglove;
    eprintln!(
        "live clients, {seconds} s: loop {mean_hz:.1} Hz on average, {worst_hz:.1} Hz in the worst second, {holds} holds; {} samples \
         lost by the recorder's count; {num_takes} takes of {takes_s:.1} s in all, {num_samples} samples of boards, longest step {longest_s:.3} s, {} bad frames; page \
         {} frames, longest step {:.3} s, {} dropped; Python {script}; Foxglove {topics:?} {complaints:?}",
        page.lost_samples, page.bad_frames, page.frames, page.longest_step_s, page.dropped
    );
    let least_frames = MIN_SHARE * FRAMES_HZ * seconds as f64;
    assert!(
        mean_hz > LOOP_SHARES[0] * LOOP_HZ && worst_hz > LOOP_SHARES[1] * LOOP_HZ,
        "{mean_hz} {worst_hz}"
    );
    assert_eq!(page.lost_samples, 0, "by the recorder's count");
    assert!(num_takes > 0 && takes_s > 0.2 * seconds as f64, "{num_takes} takes of {takes_s} s");
    assert!(page.frames as f64 > least_frames && page.dropped == 0, "{page:?}");
    assert!(page.recorded as f64 > 0.2 * page.frames as f64, "{} frames of a motion", page.recorded);
    assert!(script["frames"].as_f64().unwrap() > least_frames, "{script}");
    for topic in ["/joint_states", "/tf", "/live", "/tactile/twintac", "/tactile/fsr"] {
        let count = topics.get(topic).copied().unwrap_or(0);
        assert!(count as f64 > least_frames, "{topic}: {count} messages of {topics:?}");
    }
    assert!(topics["/joint_commands"] > 0 && complaints.is_empty(), "{topics:?} {complaints:?}");
}
