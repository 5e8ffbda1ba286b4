//! The end of a studio: whatever clients are up to, motion ends first, and the last word is true.

use std::{
    io::Write as _,
    net::TcpStream,
    time::{Duration, Instant},
};

use e2e::{Bench, Operator, Studio, Tools, Watcher, beside_a_station};
use serde_json::Value;

use crate::scene::{all_ready, set_in_motion};

/// A studio that is told to end has ended by then.
const DEADLINE: Duration = Duration::from_secs(3);
/// Tests do a few rounds; `PALPATE_ROUNDS=100` asks for more.
const ROUNDS: usize = 6;

/// Clients that have begun something and do not go on with it.
fn stall(studio: &Studio) -> anyhow::Result<Vec<TcpStream>> {
    let address = studio.url.trim_start_matches("http://");
    let host = format!("Host: {address}\r\n");
    let upload = format!(
        "POST /api/v1/sessions?name=stalled HTTP/1.1\r\n{host}Content-Type: application/zip\r\nContent-Length: 1000\r\n\r\nPK"
    );
    let body = format!(
        "POST /api/v1/calibrations HTTP/1.1\r\n{host}Content-Type: application/json\r\nContent-Length: 100\r\n\r\n{{"
    );
    let socket = |path: &str| {
        format!(
            "GET /api/v1/{path} HTTP/1.1\r\n{host}Connection: upgrade\r\nUpgrade: websocket\r\n\
             Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        )
    };
    let begun = ["GET / HTTP/1.1\r\nHost", &upload, &body, &socket("stream"), &socket("control"), ""];
    begun
        .into_iter()
        .map(|begun| {
            let mut stream = TcpStream::connect(address)?;
            stream.write_all(begun.as_bytes())?;
            Ok(stream)
        })
        .collect()
}

/// Somebody in control of the studio's armed station, and somebody who watches.
fn armed(studio: &Studio) -> anyhow::Result<(Operator, Watcher)> {
    let watcher = Watcher::connect(studio)?;
    watcher.wait_for("every device to be ready", all_ready)?;
    let mut operator = Operator::connect(studio)?;
    operator.take_control("Ada")?;
    operator.arm(&watcher)?;
    Ok((operator, watcher))
}

/// The last line of the audit log.
fn last_word(data: &std::path::Path) -> anyhow::Result<String> {
    let text = std::fs::read_to_string(data.join("audit.jsonl"))?;
    let last: Value = serde_json::from_str(text.lines().last().unwrap_or_default())?;
    Ok(last["what"].as_str().unwrap_or_default().to_owned())
}

#[test]
fn a_signal_while_moving_ends_with_torque_off_and_a_true_last_word() {
    let Some(tools) = Tools::find() else { return };
    let rounds =
        std::env::var("PALPATE_ROUNDS").ok().and_then(|rounds| rounds.parse().ok()).unwrap_or(ROUNDS);
    let bench = Bench::start(beside_a_station()).unwrap();
    let mut slowest = Duration::ZERO;
    for round in 0..rounds {
        let data = tempfile::tempdir().unwrap();
        let mut studio = Studio::serve(&tools, data.path(), bench.station_args()).unwrap();
        let (operator, _watcher) = armed(&studio).unwrap();
        let stalled = if round % 2 == 0 { stall(&studio).unwrap() } else { Vec::new() };
        set_in_motion(&bench, &operator).unwrap();
        studio.signal(if round % 3 == 0 { "INT" } else { "TERM" }).unwrap();
        let begun = Instant::now();
        let code = studio.ended(DEADLINE).unwrap();
        slowest = slowest.max(begun.elapsed());
        assert!(code.is_some(), "round {round}: the studio runs on after {DEADLINE:?}");
        let now = bench.control.snapshot();
        let word = last_word(data.path()).unwrap();
        assert!(!now.torque_on.contains(&true), "round {round}: torque is on; the log says {word:?}");
        assert_eq!(
            word, "the control loop has ended: readings show every joint without torque",
            "round {round}"
        );
        assert_eq!(code, Some(0), "round {round}");
        drop(stalled);
    }
    eprintln!("{rounds} rounds; the slowest end took {} ms", slowest.as_millis());
}

#[test]
fn a_second_signal_is_heard_and_an_end_without_confirmation_says_so() {
    let Some(tools) = Tools::find() else { return };
    let bench = Bench::start(beside_a_station()).unwrap();
    let data = tempfile::tempdir().unwrap();
    let mut studio = Studio::serve(&tools, data.path(), bench.station_args()).unwrap();
    let (_operator, _watcher) = armed(&studio).unwrap();
    // The arm's cable is pulled: nobody can know what it does.
    bench.set_faults("[[fault]]\nkind = \"unplug\"\ndevice = \"xarm\"\n").unwrap();
    studio.signal("TERM").unwrap();
    std::thread::sleep(Duration::from_millis(50));
    studio.signal("INT").unwrap();
    let code = studio.ended(DEADLINE).unwrap();
    assert_eq!(code, Some(1), "{}", studio.log());
    let word = last_word(data.path()).unwrap();
    assert!(word.contains("do not confirm it for joint1"), "{word}");
    assert!(studio.log().contains("check the robot"), "{}", studio.log());
    let now = bench.control.snapshot();
    let hand = bench.dof("index_pip").unwrap();
    assert!(!now.torque_on[hand], "the hand, which can be reached, has let go");
}

#[test]
fn a_terminal_that_stands_still_holds_up_neither_motion_nor_its_end() {
    let Some(tools) = Tools::find() else { return };
    let bench = Bench::start(beside_a_station()).unwrap();
    let data = tempfile::tempdir().unwrap();
    // Nobody reads its standard error.
    let mut studio = Studio::serve_unread(&tools, data.path(), bench.station_args()).unwrap();
    let (operator, watcher) = armed(&studio).unwrap();
    // Refusals are logged; these fill the pipe several times over.
    let stranger = Operator::connect(&studio).unwrap();
    for lease in 1..=3_000 {
        stranger.ask_under(lease, e2e::targets(&[(0, 0.0)])).unwrap();
    }
    for _ in 0..600 {
        let _ = studio.get(&format!("/no-such-thing-{}", "x".repeat(400)));
        let _ = studio.post_as("evil.example", "/recording/act");
    }
    operator.arm(&watcher).unwrap();
    set_in_motion(&bench, &operator).unwrap();
    studio.signal("TERM").unwrap();
    assert!(studio.ended(DEADLINE).unwrap().is_some(), "the studio runs on");
    assert!(!bench.control.snapshot().torque_on.contains(&true));
}
