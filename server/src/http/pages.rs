//! Pages of lists: the header that names the next one.

use axum::{
    Json,
    http::{HeaderMap, HeaderValue, Uri, header},
    response::{IntoResponse as _, Response},
};
use serde::Serialize;

/// The page at `uri`, with the header that names the next one.
pub(crate) fn page_of<T: Serialize>(uri: &Uri, page: Json<T>, cursor: Option<&str>) -> Response {
    let mut response = page.into_response();
    link_next(response.headers_mut(), uri, cursor);
    response
}

/// Adds `Link` with the path of the page after the one at `uri` (RFC 8288).
fn link_next(headers: &mut HeaderMap, uri: &Uri, cursor: Option<&str>) {
    let Some(cursor) = cursor else { return };
    let others = uri
        .query()
        .unwrap_or("")
        .split('&')
        .filter(|pair| !pair.is_empty() && pair.split('=').next().is_some_and(|name| name != "cursor"));
    let cursor = format!("cursor={}", encode(cursor));
    let query: Vec<&str> = others.chain([cursor.as_str()]).collect();
    // What came as a URI is one again.
    if let Ok(link) = HeaderValue::from_str(&format!("<{}?{}>; rel=\"next\"", uri.path(), query.join("&"))) {
        headers.insert(header::LINK, link);
    }
}

/// Percent-encodes a path segment or a value of a query (RFC 3986, unreserved characters stay).
pub(crate) fn encode(segment: &str) -> String {
    let unreserved = |byte: u8| byte.is_ascii_alphanumeric() || b"-._~".contains(&byte);
    let bytes = segment.bytes();
    bytes
        .map(|byte| if unreserved(byte) { (byte as char).to_string() } else { format!("%{byte:02X}") })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn next_page_keeps_the_rest_of_the_query() {
        let link = |uri: &str, cursor| {
            let mut headers = HeaderMap::new();
            link_next(&mut headers, &uri.parse().unwrap(), cursor);
            headers.get(header::LINK).map(|link| link.to_str().unwrap().to_owned())
        };
        assert_eq!(link("/api/v1/jobs?limit=2", None), None);
        let expected = "</api/v1/jobs?limit=2&kind=emulate&cursor=17>; rel=\"next\"";
        assert_eq!(
            link("/api/v1/jobs?limit=2&cursor=19&kind=emulate", Some("17")).as_deref(),
            Some(expected)
        );
        let expected = "</api/v1/sessions?cursor=a%20%C3%A9>; rel=\"next\"";
        assert_eq!(link("/api/v1/sessions", Some("a é")).as_deref(), Some(expected));
    }
}
