//! Sessions and takes that are taken away over HTTP: whole, in parts, and back into a studio.

use std::fs;

use crate::support::{Answer, Data, answer_of, get, send, tree};
use axum::{
    Router,
    body::Body,
    http::{Request, header},
};

const ARCHIVE: &str = "/api/v1/sessions/taps/session.zip";
const TAKE: &str = "/api/v1/sessions/taps/takes/take-02/take.mcap";

async fn get_part(app: &Router, path: &str, headers: &[(header::HeaderName, &str)]) -> Answer {
    let mut request = Request::builder().uri(path).header(header::HOST, "localhost");
    for (name, value) in headers {
        request = request.header(name, *value);
    }
    answer_of(app, request.body(Body::empty()).unwrap()).await
}

#[tokio::test]
async fn session_that_is_downloaded_can_be_uploaded_again() {
    let data = Data::with_session();
    let app = data.app();
    let archive = get(&app, ARCHIVE).await;
    assert_eq!(archive.status, 200);
    assert_eq!(archive.header(header::CONTENT_TYPE), "application/zip");
    assert_eq!(
        archive.header(header::CONTENT_DISPOSITION),
        "attachment; filename=\"taps.zip\"; filename*=UTF-8''taps.zip"
    );
    let back =
        send(&app, "POST", "/api/v1/sessions?name=back", Some(("application/zip", archive.body.to_vec())))
            .await;
    assert_eq!(back.status, 201, "{:?}", back.body);
    let [original, back] = ["taps", "back"].map(|id| tree(&data.root().join("sessions").join(id)));
    assert!(original.values().eq(back.values()));
    let left: Vec<_> = fs::read_dir(data.root()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert!(left.iter().all(|name| !name.to_string_lossy().starts_with('.')), "{left:?}");
}

#[tokio::test]
async fn download_that_broke_off_goes_on() {
    let data = Data::with_session();
    let app = data.app();
    let on_disk = fs::read(data.session().join("take-02.mcap")).unwrap();
    for path in [ARCHIVE, TAKE] {
        let whole = get(&app, path).await;
        assert_eq!(whole.header(header::ACCEPT_RANGES), "bytes");
        if path == TAKE {
            assert_eq!(whole.body, on_disk);
            assert!(whole.header(header::CONTENT_DISPOSITION).ends_with("taps-take-02.mcap"));
        }
        let tag = whole.header(header::ETAG).to_owned();
        let len = whole.body.len();
        let part = get_part(&app, path, &[(header::RANGE, "bytes=100-299"), (header::IF_RANGE, &tag)]).await;
        assert_eq!(part.status, 206);
        assert_eq!(part.header(header::CONTENT_RANGE), format!("bytes 100-299/{len}"));
        assert_eq!(part.body, whole.body[100..300]);
        let rest = get_part(&app, path, &[(header::RANGE, "bytes=300-")]).await;
        assert_eq!(rest.body, whole.body[300..]);
        // Of another content the rest would not fit.
        let other = get_part(&app, path, &[(header::RANGE, "bytes=300-"), (header::IF_RANGE, "\"x\"")]).await;
        assert_eq!((other.status.as_u16(), other.body.len()), (200, len));
        let beyond = get_part(&app, path, &[(header::RANGE, "bytes=999999999-")]).await;
        assert_eq!(beyond.header(header::CONTENT_RANGE), format!("bytes */{len}"));
        beyond.problem(416);
        let known = get_part(&app, path, &[(header::IF_NONE_MATCH, &tag)]).await;
        assert_eq!((known.status.as_u16(), known.body.len()), (304, 0));
    }
    // Another content is another version.
    let tag = get(&app, ARCHIVE).await.header(header::ETAG).to_owned();
    data.edit_session(|text| text.replacen("accepted = true", "accepted = false", 1));
    assert_ne!(get(&app, ARCHIVE).await.header(header::ETAG), tag);
}

#[tokio::test]
async fn what_cannot_be_downloaded_says_why_and_tells_no_path() {
    let data = Data::with_session();
    let app = data.app();
    let detail = get(&app, "/api/v1/sessions/nope/session.zip").await.problem(404);
    assert!(detail.contains("nope"), "{detail}");
    let detail = get(&app, "/api/v1/sessions/taps/takes/nope/take.mcap").await.problem(404);
    assert!(detail.contains("nope"), "{detail}");
    // A take that is a link to what lies elsewhere is not given away, neither alone nor in the archive.
    let secret = data.root().join("secret");
    fs::write(&secret, "people's passwords").unwrap();
    let take = data.session().join("take-02.mcap");
    fs::remove_file(&take).unwrap();
    std::os::unix::fs::symlink(&secret, &take).unwrap();
    for path in [ARCHIVE, TAKE] {
        let detail = get(&app, path).await.problem(422);
        assert!(
            detail.contains("take-02.mcap") && !detail.contains(data.root().to_str().unwrap()),
            "{detail}"
        );
    }
    fs::remove_file(&take).unwrap();
    for path in [ARCHIVE, TAKE] {
        let answer = get(&app, path).await;
        assert!(answer.status.is_client_error(), "{}", answer.status);
    }
}
