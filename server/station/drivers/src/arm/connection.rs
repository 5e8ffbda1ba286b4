//! The sockets of one connection to the box, and the thread that reads its reports.

use std::io::{self, Read as _, Write as _};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, SyncSender, TrySendError};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

use palpate_device_protocol::xarm::{Report, ReportDecoder, ReportKind};

use crate::clock::HostClock;

/// Time for connecting to a port.
const CONNECT: Duration = Duration::from_secs(2);
const CHUNK: usize = 4096;
/// What waits for the driver's thread at most: a second of the quickest reports. More is dropped and counted, because old
/// reports are worth little and the thread that reads them must not wait.
const MAX_WAITING: usize = 256;
/// Time for the last words to a box that is left, and for its answers.
const FAREWELL: Duration = Duration::from_millis(300);
/// An arm that is told to stop has braked within this time; only then may its brakes take over.
const BRAKING: Duration = Duration::from_millis(100);
/// Bytes that the box may leave unread before the connection is given up.
const MOST_UNSENT: usize = 64 * 1024;
/// Reports of at least this size are those of port 30000, whose layout is its own.
const REALTIME_SIZE: u32 = 700;
/// Sizes of the reports of port 30003, with and without the force sensor. The smaller one is no different on the others.
const REAL_SIZES: [u32; 2] = [135, 87];

/// What the report thread has to say.
pub(crate) enum Received {
    /// Reports that came together.
    Reports {
        /// When.
        received_ns: u64,
        reports: Vec<Report>,
        /// Reports before these for which there was no room.
        num_dropped: u64,
    },
    /// So many more reports were none.
    Malformed(u64),
    /// There will be no more.
    Ended(String),
}

/// One connection to both ports. Closed when dropped.
#[derive(Debug)]
pub(crate) struct Connection {
    commands: TcpStream,
    unsent: Vec<u8>,
    reports: TcpStream,
    received: Receiver<Received>,
    thread: Option<JoinHandle<()>>,
}

impl Connection {
    /// Connects to both ports.
    pub(crate) fn open(
        id: &str,
        commands: SocketAddr,
        reports: SocketAddr,
        clock: &HostClock,
    ) -> Result<Self, String> {
        let commands = connect(commands, "commands")?;
        let reports = connect(reports, "reports")?;
        let set_up = || {
            commands.set_nonblocking(true)?;
            // Commands are small and must not wait for one another.
            commands.set_nodelay(true)?;
            reports.try_clone()
        };
        let stream = set_up()
            .map_err(|error| format!("the connection to the control box cannot be set up: {error}"))?;
        let (sender, received) = mpsc::sync_channel(MAX_WAITING);
        let clock = clock.clone();
        let thread = Builder::new()
            .name(format!("reports {id}"))
            .spawn(move || read_reports(stream, &clock, &sender))
            .map_err(|error| format!("no thread for the reports of the control box: {error}"))?;
        Ok(Self { commands, unsent: Vec::new(), reports, received, thread: Some(thread) })
    }

    /// Waits for reports, at most this long.
    pub(crate) fn wait(&self, most: Duration) -> Option<Received> {
        match self.received.recv_timeout(most) {
            Ok(received) => Some(received),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => Some(Received::Ended(HUNG_UP.to_owned())),
        }
    }

    /// Answers that are there.
    pub(crate) fn read(&mut self) -> Result<Vec<u8>, String> {
        let mut bytes = vec![0; CHUNK];
        match self.commands.read(&mut bytes) {
            Ok(0) => Err(HUNG_UP.to_owned()),
            Ok(count) => {
                bytes.truncate(count);
                Ok(bytes)
            }
            Err(error) if is_passing(&error) => Ok(Vec::new()),
            Err(error) => Err(format!("the connection to the control box broke: {error}")),
        }
    }

    /// Sends; what cannot be sent now is sent with the next bytes.
    pub(crate) fn write(&mut self, bytes: &[u8]) -> Result<(), String> {
        self.unsent.extend_from_slice(bytes);
        while !self.unsent.is_empty() {
            match self.commands.write(&self.unsent) {
                Ok(count) => {
                    self.unsent.drain(..count);
                }
                Err(error) if is_passing(&error) => {
                    if self.unsent.len() > MOST_UNSENT {
                        return Err("the control box does not take commands any more".to_owned());
                    }
                    return Ok(());
                }
                Err(error) => return Err(format!("the connection to the control box broke: {error}")),
            }
        }
        Ok(())
    }
}

impl Connection {
    /// The last words to the box, for a driver that cannot go on: `stop`, a pause in which the arm brakes, and `off`.
    /// Everything that was to be sent before goes first, because frames have no mark to begin at. Waits for the
    /// answers, or for [`FAREWELL`].
    pub(crate) fn say_last(&mut self, stop: &[u8], off: &[u8]) -> io::Result<()> {
        self.unsent.extend_from_slice(stop);
        self.commands.set_nonblocking(false)?;
        self.commands.set_write_timeout(Some(FAREWELL))?;
        self.commands.write_all(&self.unsent)?;
        self.unsent.clear();
        std::thread::sleep(BRAKING);
        self.commands.write_all(off)?;
        let begun = Instant::now();
        self.commands.shutdown(Shutdown::Write)?;
        // A connection that is closed with unread answers is reset, and a reset may overtake what was sent.
        let mut bytes = vec![0; CHUNK];
        while let Some(left) = FAREWELL.checked_sub(begun.elapsed()).filter(|left| !left.is_zero()) {
            self.commands.set_read_timeout(Some(left))?;
            match self.commands.read(&mut bytes) {
                Ok(0) => break,
                Ok(_) => {}
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) if is_passing(&error) => break,
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        // Either may be closed already.
        let _closed = (self.commands.shutdown(Shutdown::Both), self.reports.shutdown(Shutdown::Both));
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread of an arm's reports ended by a panic");
        }
    }
}

const HUNG_UP: &str = "the control box closed the connection; check its power, and that no more programs are connected \
                       than it serves";

fn connect(address: SocketAddr, what: &str) -> Result<TcpStream, String> {
    TcpStream::connect_timeout(&address, CONNECT).map_err(|error| {
        let mend = match error.kind() {
            io::ErrorKind::ConnectionRefused => {
                "something is there, but no control box listens: check the address"
            }
            io::ErrorKind::TimedOut => "nothing answers: check power, cable and address of the control box",
            _ => "check the network of this computer and the address in the station's file",
        };
        format!("cannot connect to {address} for {what} ({error}); {mend}")
    })
}

fn is_passing(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted | io::ErrorKind::TimedOut)
}

/// Reads until the stream is closed from either side.
fn read_reports(mut stream: TcpStream, clock: &HostClock, sender: &SyncSender<Received>) {
    let mut bytes = vec![0; CHUNK];
    let mut first = Vec::new();
    let mut decoder = None;
    let (mut num_malformed, mut num_dropped) = (0, 0);
    let problem = loop {
        let count = match stream.read(&mut bytes) {
            Ok(0) => break HUNG_UP.to_owned(),
            Ok(count) => count,
            Err(error) if is_passing(&error) => continue,
            Err(error) => break format!("the reports of the control box broke off: {error}"),
        };
        let received_ns = clock.now_ns();
        let decoder = match &mut decoder {
            Some(decoder) => {
                first.clear();
                first.extend_from_slice(&bytes[..count]);
                decoder
            }
            none => {
                // The first size says which stream this is.
                first.extend_from_slice(&bytes[..count]);
                let Some(kind) = kind_of(&first) else { continue };
                none.insert(ReportDecoder::new(kind))
            }
        };
        let reports = decoder.feed(&first);
        let malformed = decoder.counters().malformed;
        if malformed > num_malformed {
            match sender.try_send(Received::Malformed(malformed - num_malformed)) {
                Ok(()) => num_malformed = malformed,
                // They are counted with the next ones.
                Err(TrySendError::Full(_)) => {}
                Err(TrySendError::Disconnected(_)) => return,
            }
        }
        if reports.is_empty() {
            continue;
        }
        let num_reports = reports.len() as u64;
        match sender.try_send(Received::Reports { received_ns, reports, num_dropped }) {
            Ok(()) => num_dropped = 0,
            Err(TrySendError::Full(_)) => num_dropped += num_reports,
            Err(TrySendError::Disconnected(_)) => return,
        }
    };
    // Where there is no room, the end of the channel tells the same with less detail.
    let _nobody_waits = sender.try_send(Received::Ended(problem));
}

/// The layout of a stream that begins with these bytes.
fn kind_of(bytes: &[u8]) -> Option<ReportKind> {
    let size = u32::from_be_bytes(*bytes.first_chunk::<4>()?);
    Some(match size {
        REALTIME_SIZE.. => ReportKind::Realtime,
        size if REAL_SIZES.contains(&size) => ReportKind::Real,
        _ => ReportKind::Normal,
    })
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;

    use super::*;

    /// A box that sends `reports` and hangs up.
    fn received(reports: &[u8]) -> Vec<Received> {
        let listen = || TcpListener::bind("127.0.0.1:0").expect("a port");
        let (commands, report_port) = (listen(), listen());
        let address = |listener: &TcpListener| listener.local_addr().expect("its address");
        let clock = HostClock::start();
        let connection =
            Connection::open("xarm", address(&commands), address(&report_port), &clock).expect("both listen");
        let (mut client, _) = report_port.accept().expect("a client");
        client.write_all(reports).expect("it reads");
        drop(client);
        let mut all = Vec::new();
        while let Some(received) = connection.wait(Duration::from_secs(60)) {
            let is_end = matches!(received, Received::Ended(_));
            all.push(received);
            if is_end {
                break;
            }
        }
        all
    }

    fn report(kind: ReportKind, size: usize) -> Vec<u8> {
        let joint_rad = [0.1, -0.2, 0.3, 0.0, 0.0, 0.0, 0.0];
        let mut report =
            Report { declared_size: size as u32, state: 2, mode: 1, joint_rad, ..Report::default() };
        report.tail = vec![0; size - report.encode(kind).expect("finite").len()];
        report.encode(kind).expect("finite")
    }

    #[test]
    fn the_size_of_the_first_report_tells_the_stream() {
        for (kind, size) in [(ReportKind::Real, 135), (ReportKind::Real, 87), (ReportKind::Realtime, 804)] {
            let bytes = report(kind, size).repeat(2);
            let joints: Vec<f64> = received(&bytes)
                .into_iter()
                .filter_map(|received| match received {
                    Received::Reports { reports, .. } => Some(reports),
                    _ => None,
                })
                .flatten()
                .map(|report| report.joint_rad[1])
                .collect();
            assert_eq!(joints.len(), 2, "{size}");
            assert!(joints.iter().all(|joint| (joint + 0.2).abs() < 1e-6), "{joints:?}");
        }
        assert_eq!(kind_of(&145_u32.to_be_bytes()), Some(ReportKind::Normal));
        assert_eq!(kind_of(&[0, 0]), None);
    }

    #[test]
    fn bytes_that_are_no_report_are_counted_and_the_end_is_told() {
        let mut bytes = vec![0xFF; 10];
        bytes.extend(report(ReportKind::Realtime, 804));
        let all = received(&bytes);
        assert!(all.iter().any(|received| matches!(received, Received::Malformed(1))));
        assert!(matches!(all.last(), Some(Received::Ended(problem)) if problem.contains("closed")));
    }

    #[test]
    fn a_driver_that_takes_no_reports_gets_the_first_ones_and_the_number_of_those_without_room() {
        let listen = || TcpListener::bind("127.0.0.1:0").expect("a port");
        let listener = listen();
        let mut client = TcpStream::connect(listener.local_addr().expect("its address")).expect("it listens");
        let (stream, _) = listener.accept().expect("a client");
        let (sender, received) = mpsc::sync_channel(2);
        let reader = std::thread::spawn(move || read_reports(stream, &HostClock::start(), &sender));
        let one = report(ReportKind::Real, 135);
        let mut first = Vec::new();
        // Each comes by itself, until there must have been some without room.
        for _ in 0..50 {
            client.write_all(&one).expect("it reads");
            std::thread::sleep(Duration::from_millis(2));
        }
        while first.len() < 2 {
            first.push(received.recv().expect("the first ones"));
        }
        client.write_all(&one).expect("it reads");
        let last = received.recv().expect("the last one");
        drop(client);
        reader.join().expect("it ends by itself");
        let count = |received: &Received| match received {
            Received::Reports { reports, num_dropped, .. } => (reports.len() as u64, *num_dropped),
            _ => (0, 0),
        };
        let (kept, dropped) =
            first.iter().chain([&last]).map(count).fold((0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        assert!(kept + dropped == 51 && dropped > 0, "{kept} reports, {dropped} without room");
    }

    #[test]
    fn a_port_without_a_listener_is_explained() {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = listener.local_addr().expect("its address");
        drop(listener);
        let problem =
            Connection::open("xarm", address, address, &HostClock::start()).map(|_| ()).unwrap_err();
        assert!(problem.contains(&address.to_string()) && problem.contains("check the address"), "{problem}");
    }
}
