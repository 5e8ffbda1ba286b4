//! The page: compressed copies where the browser takes them, hashed names cached for ever.

use std::{env, ffi::OsStr, fs, io, path::Path, sync::OnceLock};

use axum::{
    body::Body,
    http::{HeaderMap, StatusCode, Uri, header},
    response::{IntoResponse as _, Response},
};

/// Files by path, sorted. `x.br` and `x.gz` are compressed copies of `x`.
type Files = &'static [(&'static str, &'static [u8])];

/// The page that this binary was built with.
static EMBEDDED: Files = include!(concat!(env!("OUT_DIR"), "/page.rs"));

/// Names a folder whose page is served in place of the embedded one, for tests and for those who work on the page:
/// neither has to build this binary again.
const FOLDER: &str = "PALPATE_UI_DIST";

const NOT_BUILT: &str = "<!doctype html><html lang=\"en\"><title>Palpate</title><h1>Palpate</h1>\
    <p>This binary was built without its page. <code>cargo xtask build</code> builds one that has it.</p>\
    <p>The API answers below <a href=\"/api/v1/info\">/api/v1/</a>.</p></html>";

/// The page that is served, read when it is first asked for.
fn page() -> Files {
    static PAGE: OnceLock<Files> = OnceLock::new();
    PAGE.get_or_init(|| match env::var_os(FOLDER) {
        Some(folder) => read(&folder).unwrap_or_else(|err| {
            tracing::error!(
                "{FOLDER} is {folder:?}, whose page cannot be read, so the embedded one is served: {err}"
            );
            EMBEDDED
        }),
        None => EMBEDDED,
    })
}

/// The files of `folder`, which are kept for as long as the process lives.
fn read(folder: &OsStr) -> io::Result<Files> {
    let mut files: Vec<(&'static str, &'static [u8])> = Vec::new();
    for entry in fs::read_dir(Path::new(folder))? {
        let entry = entry?;
        if entry.file_type()?.is_file() {
            let name = entry.file_name().to_string_lossy().into_owned();
            files.push((name.leak(), fs::read(entry.path())?.leak()));
        }
    }
    files.sort_unstable_by_key(|(name, _)| *name);
    Ok(files.leak())
}

/// Whether there is a page to serve.
pub(crate) fn is_built() -> bool {
    !page().is_empty()
}

/// Serves a file of the page.
pub(crate) async fn serve(uri: Uri, headers: HeaderMap) -> Response {
    let accepted = headers.get(header::ACCEPT_ENCODING).and_then(|value| value.to_str().ok());
    respond(page(), uri.path(), accepted.unwrap_or(""))
}

fn respond(page: Files, path: &str, accept_encoding: &str) -> Response {
    let name = match path.trim_start_matches('/') {
        "" => "index.html",
        name => name,
    };
    let Some(plain) = find(page, name) else {
        if name == "index.html" && page.is_empty() {
            return ([(header::CACHE_CONTROL, "no-cache")], axum::response::Html(NOT_BUILT)).into_response();
        }
        let text = "Nothing is here. The studio's page is at /.\n";
        return (StatusCode::NOT_FOUND, [(header::CONTENT_TYPE, "text/plain; charset=utf-8")], text)
            .into_response();
    };
    let copy = [("br", ".br"), ("gzip", ".gz")].into_iter().find_map(|(encoding, suffix)| {
        let copy = find(page, &format!("{name}{suffix}"))?;
        accepts(accept_encoding, encoding).then_some((encoding, copy))
    });
    let cache = if is_hashed(name) { "public, max-age=31536000, immutable" } else { "no-cache" };
    let mut response = Response::new(Body::from(copy.map_or(plain, |(_, bytes)| bytes)));
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, header::HeaderValue::from_static(media_type(name)));
    headers.insert(header::CACHE_CONTROL, header::HeaderValue::from_static(cache));
    headers.insert(header::VARY, header::HeaderValue::from_static("accept-encoding"));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, header::HeaderValue::from_static("nosniff"));
    if let Some((encoding, _)) = copy {
        headers.insert(header::CONTENT_ENCODING, header::HeaderValue::from_static(encoding));
    }
    response
}

fn find(page: Files, name: &str) -> Option<&'static [u8]> {
    page.binary_search_by_key(&name, |(name, _)| name).ok().map(|idx| page[idx].1)
}

/// Whether an `Accept-Encoding` header takes `encoding` (RFC 9110, 12.5.3).
pub(crate) fn accepts(header: &str, encoding: &str) -> bool {
    let quality = |name: &str| {
        header.split(',').find_map(|item| {
            let mut parts = item.split(';');
            if !parts.next()?.trim().eq_ignore_ascii_case(name) {
                return None;
            }
            let quality = parts.find_map(|part| part.trim().strip_prefix("q=")?.parse::<f32>().ok());
            Some(quality.unwrap_or(1.0))
        })
    };
    quality(encoding).or_else(|| quality("*")).is_some_and(|quality| quality > 0.0)
}

/// Whether the name changes with the content: it ends in `-` and 16 hexadecimal digits.
fn is_hashed(name: &str) -> bool {
    let stem = name.split_once('.').map_or(name, |(stem, _)| stem);
    stem.rsplit_once('-')
        .is_some_and(|(_, hash)| hash.len() == 16 && hash.chars().all(|c| c.is_ascii_hexdigit()))
}

fn media_type(name: &str) -> &'static str {
    match name.rsplit_once('.').map_or("", |(_, extension)| extension) {
        "html" => "text/html; charset=utf-8",
        "js" => "text/javascript; charset=utf-8",
        "wasm" => "application/wasm",
        "css" => "text/css; charset=utf-8",
        "json" => "application/json",
        "svg" => "image/svg+xml",
        "png" => "image/png",
        "ico" => "image/x-icon",
        "ttf" => "font/ttf",
        "woff2" => "font/woff2",
        "txt" => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    static SMALL: &[(&str, &[u8])] = &[
        ("index.html", b"<html>"),
        ("index.html.br", b"br"),
        ("ui-0123456789abcdef.wasm", b"plain"),
        ("ui-0123456789abcdef.wasm.br", b"brotli"),
        ("ui-0123456789abcdef.wasm.gz", b"gzip"),
    ];

    fn header(response: &Response, name: header::HeaderName) -> &str {
        response.headers().get(name).map_or("", |value| value.to_str().unwrap())
    }

    #[test]
    fn best_accepted_copy_is_sent() {
        let wasm = "/ui-0123456789abcdef.wasm";
        for (accept, encoding) in [
            ("gzip, deflate, br", "br"),
            ("gzip", "gzip"),
            ("br;q=0, gzip;q=0.5", "gzip"),
            ("*", "br"),
            ("identity", ""),
            ("", ""),
        ] {
            let response = respond(SMALL, wasm, accept);
            assert_eq!(header(&response, header::CONTENT_ENCODING), encoding, "{accept}");
            assert_eq!(header(&response, header::CONTENT_TYPE), "application/wasm");
            assert_eq!(header(&response, header::VARY), "accept-encoding");
        }
    }

    #[test]
    fn hashed_files_are_kept_and_the_page_is_asked_for_again() {
        let response = respond(SMALL, "/ui-0123456789abcdef.wasm", "");
        assert!(header(&response, header::CACHE_CONTROL).contains("immutable"));
        let response = respond(SMALL, "/", "br");
        assert_eq!(header(&response, header::CACHE_CONTROL), "no-cache");
        assert_eq!(header(&response, header::CONTENT_TYPE), "text/html; charset=utf-8");
    }

    #[test]
    fn the_page_of_a_folder_is_read_by_name() {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in [("index.html.br", "br"), ("index.html", "<html>")] {
            fs::write(folder.path().join(name), bytes).unwrap();
        }
        fs::create_dir(folder.path().join("folder")).unwrap();
        let files = read(folder.path().as_os_str()).unwrap();
        assert_eq!(files, [("index.html", &b"<html>"[..]), ("index.html.br", b"br")]);
        assert!(read(folder.path().join("none").as_os_str()).is_err());
    }

    #[test]
    fn unknown_file_is_not_found() {
        assert_eq!(respond(SMALL, "/../secret", "").status(), StatusCode::NOT_FOUND);
    }

    #[test]
    fn binary_without_a_page_says_how_to_build_one() {
        let response = respond(&[], "/", "");
        assert_eq!(response.status(), StatusCode::OK);
        assert!(NOT_BUILT.contains("cargo xtask build"));
        assert_eq!(respond(&[], "/x.js", "").status(), StatusCode::NOT_FOUND);
    }
}
