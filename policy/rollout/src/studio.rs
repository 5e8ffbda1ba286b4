//! Requests over HTTP to a studio: where it is, who asks, and why something was not done.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use serde::de::DeserializeOwned;
use serde_json::Value;

/// An answer comes within this, or never.
const PATIENCE: Duration = Duration::from_secs(10);
/// A studio that cannot be reached is tried again after this.
const AGAIN: Duration = Duration::from_millis(500);

/// Where a studio is, and who asks it.
#[derive(Clone, Debug)]
pub struct Studio {
    address: String,
    token: Option<String>,
}

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
    /// The studio at `url`, as `palpate serve` prints it, asked with `token` where people have to log in.
    ///
    /// # Errors
    /// Another address than one over plain HTTP; a token that fits no header.
    pub fn new(url: &str, token: Option<String>) -> anyhow::Result<Self> {
        let address = url.strip_prefix("http://").with_context(|| {
            format!(
                "--url is {url:?}, expected the address that `palpate serve` prints, as http://127.0.0.1:8080"
            )
        })?;
        if token.as_ref().is_some_and(|token| !token.chars().all(|letter| letter.is_ascii_graphic())) {
            bail!(
                "PALPATE_TOKEN is no token: expected the letters and digits that `palpate tokens create` printed"
            );
        }
        Ok(Self { address: address.trim_end_matches('/').to_owned(), token })
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
        self.exchange("GET", path, "")
    }

    /// `POST` of a JSON document, answered by another one.
    ///
    /// # Errors
    /// The same.
    pub fn post<T: DeserializeOwned>(&self, path: &str, body: &Value) -> Result<T, RequestError> {
        self.exchange("POST", path, &body.to_string())
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
    ) -> Result<T, RequestError> {
        let unanswered =
            |problem: String| RequestError::Unanswered { method, path: path.to_owned(), problem };
        let answer = self.answer(method, path, body).map_err(|err| unanswered(err.to_string()))?;
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

    fn answer(&self, method: &str, path: &str, body: &str) -> std::io::Result<String> {
        let address = &self.address;
        let mut stream = TcpStream::connect(address)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        let login = self.token.iter().map(|token| format!("Authorization: Bearer {token}\r\n"));
        let login: String = login.collect();
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
