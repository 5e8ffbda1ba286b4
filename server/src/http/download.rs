//! Answers that are files to keep: whole, or the part that the request asks for (RFC 9110, section 14).

use std::{
    fs::File,
    io::{self, Seek as _, SeekFrom},
};

use axum::{
    body::{Body, Bytes},
    http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header},
    response::{IntoResponse as _, Response},
};
use base64::Engine as _;
use palpate_wire::api::ProblemType;
use sha2::{Digest as _, Sha256};
use tokio::io::AsyncReadExt as _;
use tokio_util::io::ReaderStream;

use super::{etag, pages::encode, problem::problem};
use crate::Error;

/// SHA-256 of a whole file, also where a part of it is sent.
const REPR_DIGEST: HeaderName = HeaderName::from_static("repr-digest");
/// A file is read in pieces of so many bytes.
const PIECE_BYTES: usize = 256 << 10;

/// A file to send.
pub(crate) struct Download {
    source: Source,
    len: u64,
    tag: HeaderValue,
    content_type: &'static str,
    digest: Option<HeaderValue>,
    name: Option<String>,
}

enum Source {
    Memory(Bytes),
    /// Read while it is sent, however large it is.
    Disk(File),
}

impl Download {
    /// What is in memory, with its SHA-256 as the header `Repr-Digest`.
    pub(crate) fn of_bytes(content: Bytes, content_type: &'static str) -> Self {
        let digest = base64::engine::general_purpose::STANDARD.encode(Sha256::digest(&content));
        Self {
            len: content.len() as u64,
            tag: etag::of(&content),
            content_type,
            digest: HeaderValue::from_str(&format!("sha-256=:{digest}:")).ok(),
            name: None,
            source: Source::Memory(content),
        }
    }

    /// An opened file. `what` says, in any form, all that must change whenever its content does: its entity tag is made of
    /// that.
    pub(crate) fn of_file(file: File, what: &str, content_type: &'static str) -> io::Result<Self> {
        let len = file.metadata()?.len();
        let tag = etag::of(what.as_bytes());
        Ok(Self { source: Source::Disk(file), len, tag, content_type, digest: None, name: None })
    }

    /// Has browsers keep it under `name` instead of showing it.
    pub(crate) fn named(self, name: String) -> Self {
        Self { name: Some(name), ..self }
    }

    /// The answer to a request with the headers `asked`.
    ///
    /// # Errors
    /// A file in which the part cannot be reached.
    pub(crate) fn answer(self, asked: &HeaderMap) -> Result<Response, Error> {
        let is_same = asked.get(header::IF_RANGE).is_none_or(|known| known == self.tag);
        let range = asked.get(header::RANGE).filter(|_| is_same).and_then(|range| range.to_str().ok());
        // A header that cannot be read, and one that asks for several parts, are answered by the whole file.
        let part = range.and_then(|range| http_range_header::parse_range_header(range).ok());
        let part = match part.map(|parts| parts.validate(self.len)) {
            Some(Ok(parts)) if parts.len() == 1 => parts.into_iter().next(),
            Some(Err(_)) => return Ok(self.refusal()),
            _ => None,
        };
        let (first, len) = match &part {
            Some(part) => (*part.start(), part.end() - part.start() + 1),
            None => (0, self.len),
        };
        let body = match self.source {
            // The part lies within the length.
            Source::Memory(content) => Body::from(content.slice(first as usize..(first + len) as usize)),
            Source::Disk(mut file) => {
                file.seek(SeekFrom::Start(first))
                    .map_err(|err| Error::Internal(format!("failed to read the file: {err}")))?;
                let file = tokio::fs::File::from_std(file).take(len);
                Body::from_stream(ReaderStream::with_capacity(file, PIECE_BYTES))
            }
        };
        let mut response = match part {
            Some(part) => {
                let range = format!("bytes {}-{}/{}", part.start(), part.end(), self.len);
                (StatusCode::PARTIAL_CONTENT, [(header::CONTENT_RANGE, range)], body).into_response()
            }
            None => body.into_response(),
        };
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(self.content_type));
        headers.insert(header::CONTENT_LENGTH, len.into());
        headers.insert(header::ACCEPT_RANGES, HeaderValue::from_static("bytes"));
        if let Some(digest) = self.digest {
            headers.insert(REPR_DIGEST, digest);
        }
        if let Some(name) = self.name.and_then(|name| HeaderValue::from_str(&disposition(&name)).ok()) {
            headers.insert(header::CONTENT_DISPOSITION, name);
        }
        etag::insert(headers, self.tag);
        Ok(response)
    }

    fn refusal(&self) -> Response {
        let len = self.len;
        let detail = format!("the file has {len} bytes, and none where the header Range asks for them");
        let mut refused = problem(ProblemType::RangeNotSatisfiable, &detail);
        if let Ok(size) = HeaderValue::from_str(&format!("bytes */{len}")) {
            refused.headers_mut().insert(header::CONTENT_RANGE, size);
        }
        refused
    }
}

/// The header that has a client keep a file under `name` (RFC 6266): in full, and in ASCII for those that know no more, such
/// as `curl -OJ`.
fn disposition(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || "-_. ".contains(c) { c } else { '_' };
    let ascii: String = name.chars().map(plain).collect();
    format!("attachment; filename=\"{ascii}\"; filename*=UTF-8''{}", encode(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_files_are_told_to_old_and_new_clients() {
        let expected = "attachment; filename=\"caf_ _1_.zip\"; filename*=UTF-8''caf%C3%A9%20%221%22.zip";
        assert_eq!(disposition("caf\u{e9} \"1\".zip"), expected);
    }
}
