//! Entity tags: a client that has a document already is told so, instead of being sent it again.

use axum::{
    body::{Body, HttpBody as _},
    extract::Request,
    http::{HeaderMap, HeaderValue, Method, StatusCode, header},
    middleware::Next,
    response::Response,
};
use http_body_util::BodyExt as _;
use sha2::{Digest as _, Sha256};

/// Larger documents go out without a tag, unless their handler gave them one: hashing them takes a core for milliseconds.
const MAX_TAGGED_BYTES: u64 = 1 << 20;

/// Gives what a GET is answered with a strong tag, and answers 304 where the client has that already.
pub(crate) async fn tag(request: Request, next: Next) -> Response {
    if request.method() != Method::GET {
        return next.run(request).await;
    }
    let known: Vec<HeaderValue> = request.headers().get_all(header::IF_NONE_MATCH).iter().cloned().collect();
    let response = next.run(request).await;
    if !matches!(response.status(), StatusCode::OK | StatusCode::PARTIAL_CONTENT) {
        return response;
    }
    let response = match response.headers().contains_key(header::ETAG) {
        true => response,
        false => tagged(response).await,
    };
    let Some(tag) = response.headers().get(header::ETAG) else { return response };
    if !known.iter().any(|known| names(known, tag)) {
        return response;
    }
    let mut unchanged = Response::new(Body::empty());
    *unchanged.status_mut() = StatusCode::NOT_MODIFIED;
    for name in [header::ETAG, header::CACHE_CONTROL] {
        if let Some(value) = response.headers().get(&name) {
            unchanged.headers_mut().insert(name, value.clone());
        }
    }
    unchanged
}

/// The tag of a document with this content.
pub(crate) fn of(content: &[u8]) -> HeaderValue {
    let hash = Sha256::digest(content);
    let hex: String = hash.iter().take(16).map(|byte| format!("{byte:02x}")).collect();
    HeaderValue::from_str(&format!("\"{hex}\"")).unwrap_or(HeaderValue::from_static("\"\""))
}

/// What is told to keep a document, and to ask each time whether it is still the same.
pub(crate) fn insert(headers: &mut HeaderMap, tag: HeaderValue) {
    headers.insert(header::ETAG, tag);
    headers.entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-cache"));
}

/// Tags what is in memory and not too large; what streams stays as it is.
async fn tagged(response: Response) -> Response {
    if response.status() != StatusCode::OK
        || response.body().size_hint().exact().is_none_or(|size| size > MAX_TAGGED_BYTES)
    {
        return response;
    }
    let (mut parts, body) = response.into_parts();
    // A body of known size is in memory, and cannot fail.
    let content = body.collect().await.map(|content| content.to_bytes()).unwrap_or_default();
    insert(&mut parts.headers, of(&content));
    Response::from_parts(parts, Body::from(content))
}

/// Whether an `If-None-Match` header names `tag` (RFC 9110, 13.1.2: weak tags of the same text count).
fn names(header: &HeaderValue, tag: &HeaderValue) -> bool {
    let (Ok(header), Ok(tag)) = (header.to_str(), tag.to_str()) else { return false };
    header.trim() == "*"
        || header.split(',').any(|known| {
            let known = known.trim();
            known.strip_prefix("W/").unwrap_or(known) == tag
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tags_are_found_in_lists_of_them() {
        let tag = of(b"a document");
        let text = tag.to_str().unwrap();
        assert_ne!(of(b"another"), tag);
        for header in [text, &format!("W/{text}"), &format!("\"x\", {text}"), "*"] {
            assert!(names(&header.parse().unwrap(), &tag), "{header}");
        }
        for header in ["", "\"x\"", text.trim_matches('"')] {
            assert!(!names(&header.parse().unwrap(), &tag), "{header}");
        }
    }
}
