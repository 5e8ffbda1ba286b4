//! The API's document as a page: RapiDoc, which comes with the program, so that no other server is asked.

use std::io::Read as _;

use axum::{
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::{Html, IntoResponse as _, Response},
};

use super::page::accepts;

/// Where the page is.
pub(crate) const PAGE_PATH: &str = "/api/docs";
/// Its script. The name has the version, so that it is kept for ever.
pub(crate) const SCRIPT_PATH: &str = "/api/docs/rapidoc-9.3.8.js";

/// `vendor/rapidoc/rapidoc-min.js`, compressed.
static SCRIPT_GZ: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/rapidoc-min.js.gz"));

const PAGE: &str = concat!(
    r#"<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Palpate API</title>"#,
    r#"<meta name="viewport" content="width=device-width, initial-scale=1">"#,
    r#"<script type="module" src="/api/docs/rapidoc-9.3.8.js"></script></head><body>"#,
    r#"<rapi-doc spec-url="/api/v1/openapi.json" render-style="read" show-header="false" load-fonts="false" "#,
    r#"allow-authentication="false" allow-server-selection="false" sort-tags="false" schema-description-expanded="true">"#,
    r#"</rapi-doc></body></html>"#,
);

/// `GET /api/docs`.
pub(crate) async fn page() -> Response {
    ([(header::CACHE_CONTROL, "no-cache")], Html(PAGE)).into_response()
}

/// The script of the page.
pub(crate) async fn script(headers: HeaderMap) -> Response {
    let accepted = headers.get(header::ACCEPT_ENCODING).and_then(|value| value.to_str().ok()).unwrap_or("");
    let takes_gzip = accepts(accepted, "gzip");
    let mut response = match takes_gzip {
        true => SCRIPT_GZ.into_response(),
        false => {
            plain().map_or_else(|| StatusCode::INTERNAL_SERVER_ERROR.into_response(), Vec::into_response)
        }
    };
    let headers = response.headers_mut();
    if takes_gzip {
        headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static("gzip"));
    }
    for (name, value) in [
        (header::CONTENT_TYPE, "text/javascript; charset=utf-8"),
        (header::CACHE_CONTROL, "public, max-age=31536000, immutable"),
        (header::VARY, "accept-encoding"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}

fn plain() -> Option<Vec<u8>> {
    let mut script = Vec::new();
    flate2::read::GzDecoder::new(SCRIPT_GZ).read_to_end(&mut script).ok()?;
    Some(script)
}

#[cfg(test)]
mod tests {
    use sha2::{Digest as _, Sha256};

    use super::*;

    /// SHA-256 of `dist/rapidoc-min.js` of the npm package `rapidoc` 9.3.8.
    const SCRIPT_SHA256: &str = "affbd173a65e870e18f392cca963113bcdafb6e50e88cd2f6a834a65b22db94d";

    #[test]
    fn script_is_the_published_one() {
        let hash = Sha256::digest(plain().unwrap());
        let hex: String = hash.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(hex, SCRIPT_SHA256);
        assert!(SCRIPT_PATH.contains("9.3.8") && PAGE.contains(SCRIPT_PATH));
    }
}
