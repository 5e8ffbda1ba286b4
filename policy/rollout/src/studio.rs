//! Requests over HTTP to a studio: where it is, who asks, which certificate it must show, and why something was not
//! done.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use palpate_wire::api::LEASE_HEADER;
use serde::de::DeserializeOwned;
use serde_json::Value;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio_rustls::{
    TlsConnector,
    rustls::{
        ClientConfig, ClientConnection, RootCertStore, StreamOwned,
        crypto::ring,
        pki_types::{CertificateDer, ServerName, pem::PemObject as _},
    },
};

/// An answer comes within this, or never.
const PATIENCE: Duration = Duration::from_secs(10);
/// A studio that cannot be reached is tried again after this.
const AGAIN: Duration = Duration::from_millis(500);

/// Where a studio is, and who asks it.
#[derive(Clone, Debug)]
pub struct Studio {
    address: String,
    token: Option<String>,
    /// `None` for plain HTTP.
    tls: Option<Tls>,
}

/// What a studio that speaks TLS must show.
#[derive(Clone, Debug)]
struct Tls {
    config: Arc<ClientConfig>,
    name: ServerName<'static>,
    /// Where what is trusted was read.
    ca_file: PathBuf,
}

/// A connection to a studio.
pub(crate) trait Connection: AsyncRead + AsyncWrite + Unpin + Send {}

impl<T: AsyncRead + AsyncWrite + Unpin + Send> Connection for T {}

/// Why a request came to nothing.
#[derive(Debug, thiserror::Error)]
pub enum RequestError {
    /// Nobody answered; whether the studio did what was asked is not known.
    #[error("{method} {path}: {problem}")]
    Unanswered {
        /// Of the request.
        method: &'static str,
        /// Below `/api/v1`.
        path: String,
        /// What happened instead.
        problem: String,
    },
    /// The studio refused.
    #[error("{method} {path}: {detail}")]
    Refused {
        /// Of the request.
        method: &'static str,
        /// Below `/api/v1`.
        path: String,
        /// HTTP's number for the kind of refusal.
        status: u16,
        /// Why, as the studio says it.
        detail: String,
    },
}

impl Studio {
    /// The studio at `url`, as `palpate serve` prints it, asked with `token` where people have to log in. One that
    /// speaks TLS must show a certificate that `ca_file` vouches for.
    ///
    /// # Errors
    /// Another address than one over HTTP; a token that fits no header; a file without certificates, or none for TLS.
    pub fn new(url: &str, token: Option<String>, ca_file: Option<&Path>) -> anyhow::Result<Self> {
        let (address, port, speaks_tls) = match (url.strip_prefix("http://"), url.strip_prefix("https://")) {
            (Some(address), _) => (address, 80, false),
            (None, Some(address)) => (address, 443, true),
            (None, None) => bail!(
                "--url is {url:?}, expected the address that `palpate serve` prints, as http://127.0.0.1:8080 or \
                 https://lab-hand.example:8443"
            ),
        };
        if token.as_ref().is_some_and(|token| !token.chars().all(|letter| letter.is_ascii_graphic())) {
            bail!(
                "PALPATE_TOKEN is no token: expected the letters and digits that `palpate tokens create` printed"
            );
        }
        let address = address.trim_end_matches('/');
        let named = address.rsplit_once(':').filter(|(_, port)| port.parse::<u16>().is_ok());
        let host = named.map_or(address, |(host, _)| host);
        let tls = match (speaks_tls, ca_file) {
            (false, None) => None,
            (false, Some(_)) => bail!("--ca-file is for a studio that speaks TLS, and --url is {url:?}"),
            (true, None) => bail!(
                "--url is {url:?}, so --ca-file has to say which certificates are trusted: a copy of tls/cert.pem in the \
                 studio's data folder, or those of this computer, e.g. /etc/ssl/certs/ca-certificates.crt"
            ),
            (true, Some(ca_file)) => Some(Tls::new(host, ca_file)?),
        };
        let address = named.map_or_else(|| format!("{address}:{port}"), |_| address.to_owned());
        Ok(Self { address, token, tls })
    }

    /// Host and port.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// What says who asks.
    pub fn token(&self) -> Option<&str> {
        self.token.as_deref()
    }

    /// `GET` of a JSON document below `/api/v1`.
    ///
    /// # Errors
    /// A studio that does not answer or refuses; another document.
    pub fn get<T: DeserializeOwned>(&self, path: &str) -> Result<T, RequestError> {
        self.exchange("GET", path, "", 0)
    }

    /// `POST` of a JSON document, answered by another one.
    ///
    /// # Errors
    /// The same.
    pub fn post<T: DeserializeOwned>(&self, path: &str, body: &Value) -> Result<T, RequestError> {
        self.exchange("POST", path, &body.to_string(), 0)
    }

    /// The same as whoever has `lease`.
    ///
    /// # Errors
    /// The same.
    pub fn post_as<T: DeserializeOwned>(
        &self,
        lease: u64,
        path: &str,
        body: &Value,
    ) -> Result<T, RequestError> {
        self.exchange("POST", path, &body.to_string(), lease)
    }

    /// Does `request` again for as long as nobody answers, `patience` at most. What is asked twice must be kept once.
    ///
    /// # Errors
    /// The last one of those of `request`.
    pub fn until_answered<T>(
        &self,
        patience: Duration,
        mut request: impl FnMut(&Self) -> Result<T, RequestError>,
    ) -> Result<T, RequestError> {
        let begun = Instant::now();
        loop {
            match request(self) {
                Err(RequestError::Unanswered { .. }) if begun.elapsed() < patience => {
                    std::thread::sleep(AGAIN);
                }
                done => return done,
            }
        }
    }

    fn exchange<T: DeserializeOwned>(
        &self,
        method: &'static str,
        path: &str,
        body: &str,
        lease: u64,
    ) -> Result<T, RequestError> {
        let unanswered =
            |problem: String| RequestError::Unanswered { method, path: path.to_owned(), problem };
        let answer = self.answer(method, path, body, lease).map_err(|err| unanswered(err.to_string()))?;
        let (head, content) =
            answer.split_once("\r\n\r\n").ok_or_else(|| unanswered("the answer has no end".to_owned()))?;
        let line = head.lines().next().unwrap_or_default();
        let status = line.split_whitespace().nth(1).and_then(|status| status.parse().ok());
        let status: u16 = status.ok_or_else(|| unanswered(format!("the answer begins with {line:?}")))?;
        if !(200..300).contains(&status) {
            let problem: Value = serde_json::from_str(content).unwrap_or_default();
            let detail = problem["detail"].as_str().unwrap_or(line).to_owned();
            return Err(RequestError::Refused { method, path: path.to_owned(), status, detail });
        }
        serde_json::from_str(content).map_err(|err| RequestError::Refused {
            method,
            path: path.to_owned(),
            status,
            detail: format!(
                "the studio's document is not as expected ({err}); are both of the same version?"
            ),
        })
    }

    /// Address of a WebSocket below `/api/v1`.
    pub(crate) fn socket_url(&self, path: &str) -> String {
        let scheme = if self.tls.is_some() { "wss" } else { "ws" };
        format!("{scheme}://{}/api/v1/{path}", self.address)
    }

    /// A connection for a WebSocket.
    pub(crate) async fn connect(&self) -> std::io::Result<Box<dyn Connection>> {
        let stream = tokio::net::TcpStream::connect(&self.address).await?;
        // Heartbeats must not wait for each other.
        stream.set_nodelay(true)?;
        let Some(tls) = &self.tls else { return Ok(Box::new(stream)) };
        let connector = TlsConnector::from(Arc::clone(&tls.config));
        let stream = connector.connect(tls.name.clone(), stream).await.map_err(|err| tls.explained(err))?;
        Ok(Box::new(stream))
    }

    fn answer(&self, method: &str, path: &str, body: &str, lease: u64) -> std::io::Result<String> {
        let stream = TcpStream::connect(&self.address)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        let Some(tls) = &self.tls else { return self.converse(stream, method, path, body, lease) };
        let connection = ClientConnection::new(Arc::clone(&tls.config), tls.name.clone());
        let stream = StreamOwned::new(connection.map_err(std::io::Error::other)?, stream);
        self.converse(stream, method, path, body, lease).map_err(|err| tls.explained(err))
    }

    fn converse(
        &self,
        mut stream: impl Read + Write,
        method: &str,
        path: &str,
        body: &str,
        lease: u64,
    ) -> std::io::Result<String> {
        let address = &self.address;
        let login = self.token.iter().map(|token| format!("Authorization: Bearer {token}\r\n"));
        let lease = (lease != 0).then(|| format!("{LEASE_HEADER}: {lease}\r\n"));
        let login: String = login.chain(lease).collect();
        // HTTP/1.0: the answer ends where the connection does.
        write!(
            stream,
            "{method} /api/v1{path} HTTP/1.0\r\nHost: {address}\r\n{login}Content-Type: application/json\r\n\
             Content-Length: {}\r\n\r\n{body}",
            body.len()
        )?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer)?;
        Ok(answer)
    }
}

impl Tls {
    /// Trust in the certificates in `ca_file`, for the studio that is called `host`.
    fn new(host: &str, ca_file: &Path) -> anyhow::Result<Self> {
        let name = host.trim_start_matches('[').trim_end_matches(']');
        let name = ServerName::try_from(name.to_owned())
            .with_context(|| format!("--url names {host:?}, which is neither a name nor an address"))?;
        let certificates: Vec<CertificateDer<'static>> = CertificateDer::pem_file_iter(ca_file)
            .and_then(Iterator::collect)
            .with_context(|| format!("failed to read certificates in PEM from --ca-file, {ca_file:?}"))?;
        let mut roots = RootCertStore::empty();
        let (num_trusted, _) = roots.add_parsable_certificates(certificates);
        if num_trusted == 0 {
            bail!("--ca-file is {ca_file:?}, which holds no certificate in PEM");
        }
        let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()?
            .with_root_certificates(roots)
            .with_no_client_auth();
        Ok(Self { config: Arc::new(config), name, ca_file: ca_file.to_owned() })
    }

    /// `err`, and what to look at where the certificate is not trusted.
    fn explained(&self, err: std::io::Error) -> std::io::Error {
        if err.kind() != std::io::ErrorKind::InvalidData {
            return err;
        }
        let ca_file = &self.ca_file;
        std::io::Error::new(
            err.kind(),
            format!("{err}; does --ca-file {ca_file:?} vouch for the certificate of this studio?"),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_has_a_port_and_what_is_wrong_with_one_is_said() {
        let address = |url: &str| Studio::new(url, None, None).map(|studio| studio.address().to_owned());
        assert_eq!(address("http://127.0.0.1:8080/").expect("an address"), "127.0.0.1:8080");
        assert_eq!(address("http://lab-hand").expect("an address"), "lab-hand:80");
        assert_eq!(address("http://[::1]").expect("an address"), "[::1]:80");
        for (url, expected) in [
            ("lab-hand:8080", "expected the address that `palpate serve` prints"),
            ("https://lab-hand:8443", "--ca-file has to say which certificates are trusted"),
        ] {
            let said = address(url).expect_err("no studio").to_string();
            assert!(said.contains(expected), "{url}: {said}");
        }
        let said =
            Studio::new("http://lab-hand", Some("two\r\nlines".to_owned()), None).expect_err("no token");
        assert!(said.to_string().contains("PALPATE_TOKEN is no token"), "{said}");
    }

    #[test]
    fn files_without_certificates_are_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let (empty, missing) = (folder.path().join("empty.pem"), folder.path().join("missing.pem"));
        std::fs::write(&empty, "no certificate\n").expect("a file");
        let said = |url: &str, file: &Path| {
            let err = Studio::new(url, None, Some(file)).expect_err("no studio");
            format!("{err:#}")
        };
        let url = "https://127.0.0.1:8443";
        assert!(said(url, &empty).contains("holds no certificate"), "{}", said(url, &empty));
        assert!(said(url, &missing).contains("missing.pem"), "{}", said(url, &missing));
        assert!(said("http://lab-hand", &empty).contains("--ca-file is for a studio that speaks TLS"));
        assert!(said("https://lab hand", &empty).contains("neither a name nor an address"));
    }
}
