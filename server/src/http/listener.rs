//! Connections: accepted within limits, closed when they stall, and ended within a deadline.
//!
//! A connection that does not finish a request's head in time is closed, as is one whose peer takes in nothing of what is
//! sent. When there are too many connections, the one that has asked for nothing for the longest time gives way to a new
//! one: whoever opens the page to press STOP must get in. Sockets of the stream give way last, and command sockets never.

use std::{
    collections::BTreeMap,
    convert::Infallible,
    io,
    net::SocketAddr,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use axum::{
    Router,
    body::Body,
    extract::{ConnectInfo, Request},
    http::{StatusCode, header},
    response::Response,
};
use hyper::{body::Incoming, server::conn::http1, service::service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::{
    io::AsyncWriteExt as _,
    net::{TcpListener, TcpStream},
    sync::{Notify, watch},
    task::JoinSet,
    time::timeout,
};
use tokio_rustls::{TlsAcceptor, server::TlsStream};
use tower::ServiceExt as _;

use super::{
    bucket::Bucket,
    connection::{Connection, Movable},
    problem::problem_response,
};

/// A request's head comes in within this time, also the next one of a connection that is kept open.
const HEAD_TIMEOUT: Duration = Duration::from_secs(15);
/// A peer that takes in nothing for this long is taken for gone.
const UNSENT_TIMEOUT: Duration = Duration::from_secs(20);
/// A TLS handshake is finished within this time.
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(5);
/// The answer to plain HTTP where TLS is spoken.
const SPEAK_TLS: &[u8] = b"HTTP/1.1 400 Bad Request\r\nConnection: close\r\nContent-Type: text/plain\r\n\r\n\
    This studio speaks HTTPS: open https:// instead of http://\n";
/// Requests that are under way when the server ends get this long.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(500);
/// Requests of one connection: a page that scrubs through takes makes some tens a second.
const REQUESTS_PER_S: f64 = 200.0;
const REQUESTS_BURST: f64 = 1000.0;
/// Connections at a time, where the system permits that many open files.
const MAX_CONNECTIONS: usize = 4096;
/// Open files that are kept for everything else: data, devices, the runtime.
const RESERVED_FILES: u64 = 192;

/// All open connections.
#[derive(Debug)]
struct Connections {
    limit: usize,
    open: Mutex<Open>,
}

#[derive(Debug, Default)]
struct Open {
    next: u64,
    by_number: BTreeMap<u64, Entry>,
}

#[derive(Debug)]
struct Entry {
    /// When it asked for something last.
    asked: Instant,
    rank: Rank,
    give_way: Arc<Notify>,
}

/// Which connections give way first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Rank {
    /// Requests and answers.
    Plain,
    /// A socket of the stream: whoever watches comes back by itself.
    Stream,
    /// A command socket: somebody may hold the robot by it. Never gives way.
    Command,
}

/// One connection; it leaves the list when this is dropped.
#[derive(Debug)]
struct Entered {
    number: u64,
    connections: Arc<Connections>,
    give_way: Arc<Notify>,
}

impl Connections {
    /// Adds a connection, in the place of the one that has been idle for the longest time if there are too many. `None`
    /// where none can give way.
    fn enter(self: &Arc<Self>, now: Instant) -> Option<Entered> {
        let mut open = self.lock();
        if open.by_number.len() >= self.limit {
            let may_go = open.by_number.iter().filter(|(_, entry)| entry.rank < Rank::Command);
            let number = *may_go.min_by_key(|(_, entry)| (entry.rank, entry.asked))?.0;
            let entry = open.by_number.remove(&number)?;
            entry.give_way.notify_one();
        }
        let number = open.next;
        open.next += 1;
        let give_way = Arc::new(Notify::new());
        let entry = Entry { asked: now, rank: Rank::Plain, give_way: give_way.clone() };
        open.by_number.insert(number, entry);
        Some(Entered { number, connections: self.clone(), give_way })
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Open> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Entered {
    fn asks(&self, now: Instant, rank: Rank) {
        if let Some(entry) = self.connections.lock().by_number.get_mut(&self.number) {
            (entry.asked, entry.rank) = (now, rank);
        }
    }
}

impl Drop for Entered {
    fn drop(&mut self) {
        self.connections.lock().by_number.remove(&self.number);
    }
}

/// Connections that the system permits, after raising the limit of open files as far as it goes.
fn max_connections() -> usize {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let limit = getrlimit(Resource::Nofile);
    // Where it cannot be raised it stays as it is.
    let _ = setrlimit(Resource::Nofile, Rlimit { current: limit.maximum, maximum: limit.maximum });
    let files = getrlimit(Resource::Nofile).current.unwrap_or(u64::MAX);
    let connections = files.saturating_sub(RESERVED_FILES).max(16);
    usize::try_from(connections).unwrap_or(MAX_CONNECTIONS).min(MAX_CONNECTIONS)
}

/// Serves `app` on `listener` until `stop` completes; requests that are under way then have half a second to end.
pub(crate) async fn listen(
    listener: TcpListener,
    tls: Option<TlsAcceptor>,
    app: Router,
    stop: impl Future<Output = ()>,
) {
    let connections = Arc::new(Connections { limit: max_connections(), open: Mutex::default() });
    let (close, closing) = watch::channel(false);
    let mut tasks = JoinSet::new();
    tokio::pin!(stop);
    loop {
        tokio::select! {
            () = &mut stop => break,
            _ = tasks.join_next(), if !tasks.is_empty() => {}
            accepted = listener.accept() => match accepted {
                Ok((socket, peer)) => match connections.enter(Instant::now()) {
                    Some(connection) => {
                        _ = tasks.spawn(serve_connection(socket, tls.clone(), peer, app.clone(), connection, closing.clone()));
                    }
                    None => tracing::warn!(%peer, "too many command sockets are open; a connection was refused"),
                },
                Err(err) => {
                    tracing::warn!(%err, "a connection could not be accepted");
                    tokio::time::sleep(Duration::from_millis(20)).await;
                }
            },
        }
    }
    drop(listener);
    close.send_replace(true);
    // Whoever stalls is cut off when the tasks are dropped.
    let _ = timeout(CLOSE_TIMEOUT, async { while tasks.join_next().await.is_some() {} }).await;
}

async fn serve_connection(
    socket: TcpStream,
    tls: Option<TlsAcceptor>,
    peer: SocketAddr,
    app: Router,
    connection: Entered,
    mut closing: watch::Receiver<bool>,
) {
    // Replies and frames are small, and late if they wait for more to be sent.
    if let Err(err) = socket.set_nodelay(true) {
        tracing::debug!(%err, "a connection may delay small messages");
    }
    let unsent_ms = u32::try_from(UNSENT_TIMEOUT.as_millis()).unwrap_or(u32::MAX);
    if let Err(err) = rustix::net::sockopt::set_tcp_user_timeout(&socket, unsent_ms) {
        tracing::debug!(%err, "a peer that takes in nothing is not noticed");
    }
    let give_way = connection.give_way.clone();
    let io = match tls {
        None => Connection::Plain(Movable::new(socket)),
        Some(tls) => {
            let secured = tokio::select! {
                secured = timeout(HANDSHAKE_TIMEOUT, secure(socket, tls)) => secured,
                () = give_way.notified() => return,
                _ = closing.wait_for(|&closes| closes) => return,
            };
            match secured {
                Ok(Ok(stream)) => Connection::Tls(Box::new(stream)),
                Ok(Err(err)) => return tracing::debug!(%peer, %err, "a TLS handshake failed"),
                Err(_) => return tracing::debug!(%peer, "a TLS handshake was not finished in time"),
            }
        }
    };
    let connection = Arc::new(connection);
    let bucket = Arc::new(Mutex::new(Bucket::new(REQUESTS_PER_S, REQUESTS_BURST, Instant::now())));
    let service = service_fn(move |request: Request<Incoming>| {
        let now = Instant::now();
        let rank = match (request.headers().contains_key(header::UPGRADE), request.uri().path()) {
            (false, _) => Rank::Plain,
            (true, "/api/v1/control") => Rank::Command,
            (true, _) => Rank::Stream,
        };
        connection.asks(now, rank);
        let passes = bucket.lock().unwrap_or_else(PoisonError::into_inner).take(now);
        answer(app.clone(), request.map(Body::new), peer, connection.clone(), passes)
    });
    let serving = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_TIMEOUT)
        .serve_connection(TokioIo::new(io), service)
        .with_upgrades();
    tokio::pin!(serving);
    let closes = async {
        // Without a sender the server is gone already.
        let _ = closing.wait_for(|&closes| closes).await;
    };
    let ended = tokio::select! {
        ended = serving.as_mut() => Some(ended),
        () = give_way.notified() => return,
        () = closes => None,
    };
    let ended = match ended {
        Some(ended) => ended,
        None => {
            serving.as_mut().graceful_shutdown();
            serving.await
        }
    };
    if let Err(err) = ended {
        tracing::debug!(%peer, %err, "a connection ended");
    }
}

/// Answers the TLS handshake; whoever speaks plain HTTP is told to use HTTPS.
async fn secure(mut socket: TcpStream, tls: TlsAcceptor) -> io::Result<TlsStream<Movable>> {
    let mut first = [0];
    if socket.peek(&mut first).await? == 1 && first[0].is_ascii_uppercase() {
        socket.write_all(SPEAK_TLS).await?;
        socket.shutdown().await?;
        return Err(io::Error::other("plain HTTP"));
    }
    tls.accept(Movable::new(socket)).await
}

async fn answer(
    app: Router,
    mut request: Request,
    peer: SocketAddr,
    connection: Arc<Entered>,
    passes: bool,
) -> Result<Response, Infallible> {
    if !passes {
        let detail =
            format!("more than {REQUESTS_PER_S} requests a second came on this connection; ask less often");
        return Ok(problem_response(StatusCode::TOO_MANY_REQUESTS, &detail));
    }
    request.extensions_mut().insert(ConnectInfo(peer));
    request.extensions_mut().insert(KeepOpen { connection });
    app.oneshot(request).await
}

/// Travels with a request, so that an upgraded connection counts until its socket is closed.
#[derive(Clone, Debug)]
pub(crate) struct KeepOpen {
    connection: Arc<Entered>,
}

impl KeepOpen {
    /// Completes when the connection has to give way to a new one.
    pub(crate) async fn gives_way(&self) {
        self.connection.give_way.notified().await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_connection_that_was_idle_longest_gives_way_then_streams_and_command_sockets_never() {
        let connections = Arc::new(Connections { limit: 3, open: Mutex::default() });
        let begun = Instant::now();
        let at = |ms| begun + Duration::from_millis(ms);
        let enter = |ms| connections.enter(at(ms));
        let (first, second, third) = (enter(0).unwrap(), enter(1).unwrap(), enter(2).unwrap());
        first.asks(at(3), Rank::Stream);
        second.asks(at(4), Rank::Plain);
        let fourth = enter(5).expect("the third gives way");
        let open = || connections.lock().by_number.keys().copied().collect::<Vec<_>>();
        assert_eq!(open(), [first.number, second.number, fourth.number]);
        drop(third);
        assert_eq!(open().len(), 3);
        second.asks(at(6), Rank::Command);
        fourth.asks(at(7), Rank::Command);
        let fifth = enter(8).expect("the stream gives way");
        assert_eq!(open(), [second.number, fourth.number, fifth.number]);
        fifth.asks(at(9), Rank::Command);
        assert!(enter(10).is_none(), "only command sockets are left");
        drop(second);
        assert!(enter(11).is_some());
    }
}
