//! Sessions that come in over HTTP: good ones stay, bad ones leave nothing.

use std::fs;

use axum::http::header;
use palpate_wire::api::SessionDetail;

use crate::support::{
    Answer, Data, NUM_FRAMES, NUM_TAKES, STATION, get, send, tree, write_recording, zip_folder,
};

async fn upload(app: &axum::Router, query: &str, archive: Vec<u8>) -> Answer {
    send(app, "POST", &format!("/api/v1/sessions?{query}"), Some(("application/zip", archive))).await
}

#[tokio::test]
async fn csv_folder_becomes_a_session() {
    let data = Data::empty();
    write_recording(data.csv());
    let app = data.app();
    for (name, prefix) in [("flat", ""), ("within a folder", "my recording")] {
        let archive = zip_folder(data.csv(), prefix);
        let query = format!("name={}&station={STATION}", name.replace(' ', "%20"));
        let answer = upload(&app, &query, archive).await;
        let location = answer.header(header::LOCATION).to_owned();
        assert_eq!(answer.status, 201, "{:?}", answer.body);
        let detail: SessionDetail = answer.json();
        assert_eq!((detail.summary.id.as_str(), detail.summary.frames), (name, NUM_TAKES * NUM_FRAMES));
        assert_eq!(get(&app, &location).await.json::<SessionDetail>(), detail);
    }
    let names: Vec<_> = fs::read_dir(data.root()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert!(names.iter().all(|name| !name.to_string_lossy().starts_with('.')), "{names:?}");
}

#[tokio::test]
async fn recordings_find_the_shipped_station_that_has_their_streams() {
    let data = Data::empty();
    write_recording(data.csv());
    let app = data.app();
    let answer = upload(&app, "name=unnamed", zip_folder(data.csv(), "")).await;
    assert_eq!(answer.json::<SessionDetail>().summary.station, STATION);
    // Streams of no shipped station: the message speaks of the default one, which says what it expected.
    fs::remove_file(data.csv().join("take-01/film.csv")).unwrap();
    let detail = upload(&app, "name=odd", zip_folder(data.csv(), "")).await.problem(422);
    assert!(detail.contains("take-01"), "{detail}");
}

#[tokio::test]
async fn session_folder_comes_back_as_it_was() {
    let data = Data::with_session();
    let app = data.app();
    let answer = upload(&app, "name=copy", zip_folder(data.session(), "taps")).await;
    assert_eq!(answer.status, 201, "{:?}", answer.body);
    let original = tree(data.session());
    let copy = tree(&data.root().join("sessions/copy"));
    assert!(original.values().eq(copy.values()));
}

#[tokio::test]
async fn bad_upload_leaves_nothing() {
    let data = Data::with_session();
    let app = data.app();
    let archive = zip_folder(data.csv(), "");
    let session = zip_folder(data.session(), "");
    let broken_csv = |file: &str, edit: &dyn Fn(String) -> String| {
        let dir = tempfile::tempdir().unwrap();
        write_recording(dir.path());
        let path = dir.path().join("take-02").join(file);
        fs::write(&path, edit(fs::read_to_string(&path).unwrap())).unwrap();
        zip_folder(dir.path(), "recording")
    };
    let truncated = {
        let broken = Data::with_session();
        broken.truncate_take();
        zip_folder(broken.session(), "")
    };
    let cut = archive[..archive.len() / 2].to_vec();
    let query = format!("name=new&station={STATION}");
    let line_5 = |text: String, row: &str| {
        let mut lines: Vec<&str> = text.lines().collect();
        lines[4] = row;
        lines.join("\n")
    };
    let cases: Vec<(&str, u16, Vec<u8>, &[&str])> = vec![
        (&query, 422, b"no archive".to_vec(), &["zip"]),
        (&query, 422, cut, &["zip"]),
        (&query, 422, zip_folder(&data.path("nowhere"), ""), &["empty"]),
        (&query, 422, truncated, &["take-02.mcap"]),
        (
            &query,
            422,
            broken_csv("gel.csv", &|text| line_5(text, "0.02,1,2")),
            &["take-02/gel.csv", "line 5"],
        ),
        (
            &query,
            422,
            broken_csv("joints.csv", &|text| line_5(text, "0.04,0,0,0.1")),
            &["take-02/joints.csv", "line 5"],
        ),
        (
            &query,
            422,
            broken_csv("joints.csv", &|text| line_5(text, "0.12,0,NaN,0.1")),
            &["take-02/joints.csv", "line 5"],
        ),
        (&query, 422, broken_csv("film.csv", &|text| text.replace(",v5", "")), &["take-02/film.csv"]),
        ("name=new&station=xarm6-leap", 422, archive.clone(), &["take-01"]),
        ("name=new&station=nowhere", 400, archive.clone(), &["nowhere", STATION]),
        (&query, 422, broken_csv("take.toml", &|_| "object = 3".to_owned()), &["take-02/take.toml"]),
        ("name=taps", 409, session.clone(), &["taps"]),
        ("name=..%2Fnew", 400, session.clone(), &["plain name"]),
        ("name=", 400, session, &["empty"]),
    ];
    let before = tree(data.root());
    for (query, status, archive, words) in cases {
        let detail = upload(&app, query, archive).await.problem(status);
        for word in words {
            assert!(detail.contains(word), "{query}: {word:?} is missing in {detail:?}");
        }
        assert!(!detail.contains(".incoming"), "the sender has never seen the server's folders: {detail}");
        assert_eq!(tree(data.root()), before, "{query}: something on disk changed: {detail}");
    }
    let wrong_type = send(&app, "POST", "/api/v1/sessions?name=new", Some(("text/plain", archive))).await;
    wrong_type.problem(400);
    assert_eq!(tree(data.root()), before);
}
