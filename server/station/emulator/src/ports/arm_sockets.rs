//! The arm's TCP ports.

use std::io::{self, Read as _, Write as _};
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream};
use std::os::fd::{AsFd as _, BorrowedFd};

use super::{ArmPortNumbers, ArmPorts, PortsError};
use crate::{EmulatedStation, ReportPort};

/// Bytes that a client may leave unread before it is let go.
const MOST_UNREAD: usize = 256 * 1024;
const CHUNK: usize = 4096;

/// Everything that listens for the arm, and who is connected.
pub(super) struct ArmSockets {
    commands: TcpListener,
    reports: Vec<(ReportPort, TcpListener)>,
    command_clients: Vec<(u64, Client)>,
    report_clients: Vec<(ReportPort, Client)>,
}

struct Client {
    stream: TcpStream,
    /// What the client has not taken yet.
    unsent: Vec<u8>,
    gone: bool,
}

impl ArmSockets {
    /// Listens on the box's own ports, or on any that are free.
    pub(super) fn open(ip: IpAddr, ports: ArmPorts) -> Result<Self, PortsError> {
        Self::listen(
            ip,
            &match ports {
                ArmPorts::Standard => ArmPortNumbers::STANDARD,
                // Port 0 lets the system choose.
                ArmPorts::Any => ArmPortNumbers { command: 0, realtime: 0, normal: 0, rich: 0, real: 0 },
            },
        )
    }

    /// Listens on these ports.
    pub(super) fn listen(ip: IpAddr, ports: &ArmPortNumbers) -> Result<Self, PortsError> {
        let commands = listener(ip, ports.command)?;
        let report = |port: ReportPort| Ok((port, listener(ip, ports.report(port))?));
        let reports = ReportPort::ALL.into_iter().map(report).collect::<Result<_, PortsError>>()?;
        Ok(Self { commands, reports, command_clients: Vec::new(), report_clients: Vec::new() })
    }

    /// The ports that it listens on.
    pub(super) fn numbers(&self) -> Result<ArmPortNumbers, PortsError> {
        let number = |listener: &TcpListener| {
            listener.local_addr().map(|address| address.port()).map_err(PortsError::Wait)
        };
        let mut numbers = ArmPortNumbers { command: number(&self.commands)?, ..ArmPortNumbers::STANDARD };
        for (port, listener) in &self.reports {
            *numbers.report_mut(*port) = number(listener)?;
        }
        Ok(numbers)
    }

    /// Everybody hangs up; the station forgets who was connected.
    pub(super) fn close(self, station: &mut EmulatedStation) {
        for (connection, _) in &self.command_clients {
            station.disconnect(*connection);
        }
    }

    pub(super) fn for_each_fd<'a>(&'a self, visit: &mut dyn FnMut(BorrowedFd<'a>)) {
        visit(self.commands.as_fd());
        self.reports.iter().for_each(|(_, listener)| visit(listener.as_fd()));
        self.command_clients.iter().for_each(|(_, client)| visit(client.stream.as_fd()));
        self.report_clients.iter().for_each(|(_, client)| visit(client.stream.as_fd()));
    }

    /// Lets clients in, takes their requests and gives them answers and reports.
    pub(super) fn exchange(
        &mut self,
        station: &mut EmulatedStation,
        now_ns: u64,
        reports: &[(ReportPort, Vec<u8>)],
    ) {
        while let Some(client) = Client::accept(&self.commands) {
            self.command_clients.push((station.connect(), client));
        }
        for (port, listener) in &self.reports {
            while let Some(client) = Client::accept(listener) {
                self.report_clients.push((*port, client));
            }
        }
        for (connection, client) in &mut self.command_clients {
            let received = client.read();
            if !received.is_empty() {
                station.arm_input(*connection, &received, now_ns);
            }
            let answers = station.arm_output(*connection, now_ns);
            client.write(&answers);
            if client.gone {
                station.disconnect(*connection);
            }
        }
        self.command_clients.retain(|(_, client)| !client.gone);
        for (port, client) in &mut self.report_clients {
            // Whatever they say, nobody listens; but they may hang up.
            client.read();
            for (_, report) in reports.iter().filter(|(of, _)| of == port) {
                client.write(report);
            }
            client.write(&[]);
        }
        self.report_clients.retain(|(_, client)| !client.gone);
    }
}

impl Client {
    fn accept(listener: &TcpListener) -> Option<Self> {
        let (stream, _) = listener.accept().ok()?;
        stream.set_nonblocking(true).ok()?;
        // Answers are small and must not wait for one another; a link without this option still works.
        let _slower = stream.set_nodelay(true);
        Some(Self { stream, unsent: Vec::new(), gone: false })
    }

    fn read(&mut self) -> Vec<u8> {
        let mut bytes = vec![0; CHUNK];
        match self.stream.read(&mut bytes) {
            Ok(0) => self.gone = true,
            Ok(count) => {
                bytes.truncate(count);
                return bytes;
            }
            Err(error) => self.gone |= !is_passing(&error),
        }
        Vec::new()
    }

    fn write(&mut self, bytes: &[u8]) {
        self.unsent.extend_from_slice(bytes);
        while !self.unsent.is_empty() && !self.gone {
            match self.stream.write(&self.unsent) {
                Ok(count) => {
                    self.unsent.drain(..count);
                }
                Err(error) => {
                    self.gone |= !is_passing(&error) || self.unsent.len() > MOST_UNREAD;
                    return;
                }
            }
        }
    }
}

/// Whether it is only not the moment.
fn is_passing(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted)
}

fn listener(ip: IpAddr, port: u16) -> Result<TcpListener, PortsError> {
    let address = SocketAddr::new(ip, port);
    let failed = |source: io::Error| {
        let hint = match source.kind() {
            io::ErrorKind::PermissionDenied => {
                ": ports below 1024 need a permission, which one of these gives: `sudo sysctl \
                 net.ipv4.ip_unprivileged_port_start=502`, `sudo setcap cap_net_bind_service=+ep PALPATE`, or running \
                 it as root"
            }
            io::ErrorKind::AddrInUse => {
                ": something else listens there, maybe another emulation; end it, or choose another address of this \
                 machine with --xarm-ip, e.g. 127.0.0.2"
            }
            io::ErrorKind::AddrNotAvailable => {
                ": this machine does not have that address; choose one that it has with --xarm-ip"
            }
            _ => "",
        };
        PortsError::Listen { address, hint, source }
    };
    let listener = TcpListener::bind(address).map_err(failed)?;
    listener.set_nonblocking(true).map_err(failed)?;
    Ok(listener)
}
