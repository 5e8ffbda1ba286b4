//! Whatever many clients do at a time, the studio's memory is bounded, its control loop keeps its rate, and STOP is heard.

use std::{
    io::Write as _,
    net::TcpStream,
    thread,
    time::{Duration, Instant},
};

use e2e::{MS, Studio, Tools, alone, demo_session, read_status};
use palpate_wire::proto::{Stop, control_request::Request, control_state::Phase};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

use crate::scene::Scene;

/// Sockets that are opened and then send little or nothing.
const SOCKETS: usize = 2_000;
const UPLOADS: usize = 64;
const CHECKS: usize = 600;
const ZIP_ENTRIES: u64 = 1_000_000;
const HUGE_BODY_BYTES: u64 = 10_000_000_000;
/// The studio holds no more memory than this, bytes.
const MAX_MEMORY_BYTES: u64 = 1_500_000_000;
/// Turns of the control loop that are meant, Hz, and the share that a machine that runs all these clients must reach.
const LOOP_HZ: f32 = 200.0;
const LOOP_SHARE: f32 = 0.8;
/// Whatever is answered is answered before this.
const PATIENCE: Duration = Duration::from_secs(120);
/// From STOP to torque off, in the station's own time: braking comes first.
const STOP_NS: u64 = 1_000 * MS;

/// What became of requests of one kind.
#[derive(Debug)]
struct Answers {
    what: &'static str,
    codes: Vec<u16>,
    unanswered: Vec<String>,
}

impl Answers {
    fn of(what: &'static str, answers: impl IntoIterator<Item = anyhow::Result<u16>>) -> Self {
        let mut all = Self { what, codes: Vec::new(), unanswered: Vec::new() };
        for answer in answers {
            match answer {
                Ok(code) => all.codes.push(code),
                Err(err) => all.unanswered.push(format!("{err:#}")),
            }
        }
        all
    }

    fn count(&self, code: u16) -> usize {
        self.codes.iter().filter(|&&answered| answered == code).count()
    }

    /// Every request was answered by one of `expected`.
    fn must_be(&self, expected: &[u16]) {
        let summary: Vec<_> = expected.iter().map(|&code| (code, self.count(code))).collect();
        eprintln!("{}: {summary:?}, unanswered: {:?}", self.what, self.unanswered);
        let other: Vec<_> = self.codes.iter().filter(|code| !expected.contains(code)).collect();
        assert!(other.is_empty(), "{}: answered by {other:?}, expected {expected:?}", self.what);
    }
}

/// The head of a request whose body has a length, or comes in chunks.
fn post(studio: &Studio, path: &str, length: Option<u64>) -> String {
    let length = length.map_or_else(
        || "Transfer-Encoding: chunked".to_owned(),
        |length| format!("Content-Length: {length}"),
    );
    format!(
        "POST /api/v1{path} HTTP/1.1\r\nHost: {}\r\nContent-Type: application/zip\r\n{length}\r\nConnection: close\r\n\r\n",
        studio.address()
    )
}

/// Opens sockets that never finish a request; a byte of each comes now and then.
fn slow_sockets(address: &str) -> anyhow::Result<Vec<TcpStream>> {
    let open = || -> anyhow::Result<TcpStream> {
        let mut stream = TcpStream::connect(address)?;
        stream.set_write_timeout(Some(Duration::from_millis(100)))?;
        stream.write_all(b"GET /api/v1/info HTTP/1.1\r\nX-")?;
        Ok(stream)
    };
    (0..SOCKETS).map(|_| open()).collect()
}

fn trickle(sockets: &mut [TcpStream]) {
    for socket in sockets {
        // The studio may have closed it, which is right.
        let _ = socket.write_all(b"x");
    }
}

/// Sends a body for as long as it is taken in, up to `length` bytes; gives the answer.
fn huge_body(studio: &Studio, length: Option<u64>) -> anyhow::Result<u16> {
    let mut stream = TcpStream::connect(studio.address())?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    stream.write_all(post(studio, "/sessions?name=huge", length).as_bytes())?;
    let piece = vec![b'P'; 1 << 20];
    let head = format!("{:x}\r\n", piece.len());
    let mut sent = 0;
    while sent < HUGE_BODY_BYTES {
        let part = match length {
            Some(_) => stream.write_all(&piece),
            None => stream
                .write_all(head.as_bytes())
                .and_then(|()| stream.write_all(&piece))
                .and_then(|()| stream.write_all(b"\r\n")),
        };
        if part.is_err() {
            break;
        }
        sent += piece.len() as u64;
    }
    eprintln!(
        "of a body of {HUGE_BODY_BYTES} bytes (said so before: {}) {sent} were taken in",
        length.is_some()
    );
    assert!(sent < HUGE_BODY_BYTES, "all of it was taken in");
    read_status(stream)
}

/// An archive of empty files, a million of them, as the format has it (APPNOTE 4.3).
fn archive_of_many() -> Vec<u8> {
    let mut local = Vec::new();
    let mut central = Vec::new();
    for entry in 0..ZIP_ENTRIES {
        let name = format!("{entry:07}");
        let offset = local.len() as u32;
        // Version 2.0, no flags, stored, no time, no checksum, no bytes.
        let common =
            [&[20, 0, 0, 0, 0, 0, 0, 0, 0, 0][..], &[0; 12], &(name.len() as u16).to_le_bytes(), &[0, 0]]
                .concat();
        local.extend(b"PK\x03\x04");
        local.extend(&common);
        local.extend(name.as_bytes());
        central.extend(b"PK\x01\x02");
        central.extend([20, 0]);
        central.extend(&common);
        central.extend([0; 10]);
        central.extend(offset.to_le_bytes());
        central.extend(name.as_bytes());
    }
    let (start, size) = (local.len() as u64, central.len() as u64);
    let mut archive = local;
    archive.extend(central);
    let end64 = archive.len() as u64;
    archive.extend(b"PK\x06\x06");
    archive.extend(44_u64.to_le_bytes());
    archive.extend([45, 0, 45, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    for value in [ZIP_ENTRIES, ZIP_ENTRIES, size, start] {
        archive.extend(value.to_le_bytes());
    }
    archive.extend(b"PK\x06\x07");
    archive.extend(0_u32.to_le_bytes());
    archive.extend(end64.to_le_bytes());
    archive.extend(1_u32.to_le_bytes());
    archive.extend(b"PK\x05\x06");
    archive.extend([0; 4]);
    archive.extend([0xFF; 12]);
    archive.extend([0xFF; 4]);
    archive.extend([0; 2]);
    archive
}

/// Bodies that are too much, beside checks; then uploads, beside each other.
fn flood(studio: &Studio) {
    let check = format!(
        "GET /api/v1/sessions/demo/check HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\r\n",
        studio.address()
    );
    thread::scope(|scope| {
        let many = scope.spawn(|| {
            let archive = archive_of_many();
            let head = post(studio, "/sessions?name=many", Some(archive.len() as u64));
            let request = [head.as_bytes(), &archive].concat();
            // Where too many computations wait, it comes again, as it is told to.
            let begun = Instant::now();
            loop {
                match studio.raw(&request, PATIENCE) {
                    Ok(503) if begun.elapsed() < PATIENCE => thread::sleep(Duration::from_millis(500)),
                    answer => return answer,
                }
            }
        });
        let said = scope.spawn(|| huge_body(studio, Some(HUGE_BODY_BYTES)));
        let unsaid = scope.spawn(|| huge_body(studio, None));
        let checks: Vec<anyhow::Result<TcpStream>> = (0..CHECKS)
            .map(|_| {
                let mut stream = TcpStream::connect(studio.address())?;
                stream.set_read_timeout(Some(PATIENCE))?;
                stream.write_all(check.as_bytes())?;
                Ok(stream)
            })
            .collect();
        let checks = Answers::of("checks", checks.into_iter().map(|stream| stream.and_then(read_status)));
        // Too many wait, or a connection that asked nothing for longest has to give way.
        checks.must_be(&[200, 503]);
        assert!(checks.count(200) > 0, "no check was done: {checks:?}");
        let joined = |thread: thread::ScopedJoinHandle<'_, _>| thread.join().expect("a client");
        // A refusal may be lost where the connection is closed while more of the body comes.
        Answers::of("the archive of a million files", [joined(many)]).must_be(&[413, 422]);
        Answers::of("the body of 10 GB", [joined(said)]).must_be(&[413]);
        Answers::of("the body that says no length", [joined(unsaid)]).must_be(&[413, 507]);
    });
    thread::scope(|scope| {
        let upload = |number: usize| {
            let body = vec![b'P'; 4 << 20];
            let head = post(studio, &format!("/sessions?name=upload-{number}"), Some(body.len() as u64));
            studio.raw(&[head.as_bytes(), &body].concat(), PATIENCE)
        };
        let uploads: Vec<_> = (0..UPLOADS).map(|number| scope.spawn(move || upload(number))).collect();
        let uploads = uploads.into_iter().map(|thread| thread.join().expect("a client"));
        Answers::of("uploads", uploads).must_be(&[422, 503, 507]);
    });
}

#[test]
fn a_flood_of_clients_is_refused_or_bounded_and_the_loop_keeps_its_rate() {
    let Some(tools) = Tools::find() else { return };
    let files = getrlimit(Resource::Nofile);
    setrlimit(Resource::Nofile, Rlimit { current: files.maximum, maximum: files.maximum }).unwrap();
    let recorded = demo_session(&tools).unwrap().join("sessions/demo");
    let scene = Scene::armed_with(alone(), |data, station| {
        let session = data.join("sessions/demo");
        std::fs::create_dir_all(&session)?;
        for entry in std::fs::read_dir(&recorded)? {
            let entry = entry?;
            std::fs::copy(entry.path(), session.join(entry.file_name()))?;
        }
        Studio::serve(&tools, data, station)
    })
    .unwrap();
    let Scene { operator, watcher, studio, bench, .. } = &scene;

    let mut sockets = slow_sockets(studio.address()).unwrap();
    let (mut slowest_hz, mut holds) = (f32::INFINITY, 0);
    thread::scope(|scope| {
        let clients = scope.spawn(|| flood(studio));
        let mut trickled = Instant::now();
        let mut is_held = false;
        while !clients.is_finished() {
            thread::sleep(Duration::from_millis(50));
            if trickled.elapsed() > Duration::from_secs(1) {
                trickle(&mut sockets);
                trickled = Instant::now();
            }
            let Some(state) = watcher.newest().and_then(|frame| frame.control) else { continue };
            slowest_hz = slowest_hz.min(state.loop_hz);
            let holds_now = state.phase() != Phase::Armed;
            holds += usize::from(holds_now && !is_held);
            is_held = holds_now;
        }
        clients.join().expect("the clients");
    });
    let memory = studio.peak_memory_bytes().unwrap();
    eprintln!(
        "flood: {slowest_hz:.0} Hz in the loop's worst second, {holds} holds, {:.2} GB at most",
        memory as f64 * 1e-9
    );
    assert!(memory < MAX_MEMORY_BYTES, "{memory} bytes were held");
    assert!(slowest_hz > LOOP_SHARE * LOOP_HZ, "the loop went down to {slowest_hz} Hz");

    // With all the sockets still there, whoever has control can stop.
    let pressed_ns = bench.now_ns();
    operator.must(Request::Stop(Stop {})).unwrap();
    let limp_ns = bench.wait_until_limp().unwrap();
    assert!(limp_ns - pressed_ns < STOP_NS, "limp after {} ms", (limp_ns - pressed_ns) / MS);
    drop(sockets);
}
