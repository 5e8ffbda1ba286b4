//! A connection to a studio's routes.

use std::net::SocketAddr;

use axum::{
    body::Bytes,
    http::{Request, header},
};
use http_body_util::{BodyExt as _, Full};
use hyper::client::conn::http1::{SendRequest, handshake};
use hyper_util::rt::TokioIo;
use palpate_server::Error;
use palpate_wire::api::LEASE_HEADER;
use tokio::net::TcpStream;

/// A connection that stays open, for one request at a time.
pub(super) struct Connection {
    addr: SocketAddr,
    sender: SendRequest<Full<Bytes>>,
}

impl Connection {
    pub(super) async fn open(addr: SocketAddr) -> Result<Self, Error> {
        let failed = |err: &dyn std::fmt::Display| Error::Internal(format!("no connection to {addr}: {err}"));
        let stream = TcpStream::connect(addr).await.map_err(|err| failed(&err))?;
        stream.set_nodelay(true).map_err(|err| failed(&err))?;
        let (sender, connection) = handshake(TokioIo::new(stream)).await.map_err(|err| failed(&err))?;
        // Whoever waits for an answer hears of what goes wrong.
        tokio::spawn(async { drop(connection.await) });
        Ok(Self { addr, sender })
    }

    /// The bytes of the answer to a request with a JSON body, or none; any status but success is an error with the
    /// studio's words. `lease` is whose request it is, 0 for nobody's.
    pub(super) async fn ask(
        &mut self,
        method: &str,
        path: &str,
        lease: u64,
        body: Option<String>,
    ) -> Result<Bytes, Error> {
        let failed = |err: &dyn std::fmt::Display| Error::Internal(format!("{method} {path} failed: {err}"));
        let request = Request::builder()
            .method(method)
            .uri(path)
            .header(header::HOST, self.addr.to_string())
            .header(header::CONTENT_TYPE, "application/json")
            .header(LEASE_HEADER, lease)
            .body(Full::from(body.unwrap_or_default()))
            .map_err(|err| failed(&err))?;
        self.sender.ready().await.map_err(|err| failed(&err))?;
        let answer = self.sender.send_request(request).await.map_err(|err| failed(&err))?;
        let status = answer.status();
        let bytes = answer.into_body().collect().await.map_err(|err| failed(&err))?.to_bytes();
        if !status.is_success() {
            return Err(failed(&format!("{status}: {}", String::from_utf8_lossy(&bytes))));
        }
        Ok(bytes)
    }
}
