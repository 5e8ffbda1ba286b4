//! Sessions that come in over HTTP: good ones stay, bad ones leave nothing.

use std::{
    fs,
    io::{Cursor, Write as _},
};

use axum::http::header;
use palpate_wire::api::SessionDetail;
use zip::{ZipWriter, write::SimpleFileOptions};

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
    // Streams of no shipped station: the message says of each what it lacks.
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
    wrong_type.problem(415);
    assert_eq!(tree(data.root()), before);
}

#[tokio::test]
async fn odd_names_in_an_archive_are_the_senders_to_mend_and_tell_no_path() {
    let data = Data::empty();
    write_recording(data.csv());
    let app = data.app();
    let zip = |entries: &[(&str, &str)]| {
        let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
        for (name, text) in entries {
            writer.start_file(*name, SimpleFileOptions::default()).unwrap();
            writer.write_all(text.as_bytes()).unwrap();
        }
        writer.finish().unwrap().into_inner()
    };
    let long = format!("take-01/{}", "n".repeat(300));
    for (entries, words) in [
        (vec![(long.as_str(), "x")], "(308 bytes) of the archive has a name"),
        (vec![("a", "x"), ("a/b", "x")], "entry \"a/b\" of the archive is both a file and a folder"),
        (vec![("take-01/take.toml", "object = 1"), ("take-01/joints.csv", "")], "take-01/take.toml: line 1"),
        (vec![("session.toml", "format = 7"), ("x", "")], "session.toml: "),
    ] {
        let answer = upload(&app, &format!("name=odd&station={STATION}"), zip(&entries)).await;
        let detail = answer.problem(422);
        assert!(detail.contains(words), "{detail}");
        assert!(!detail.contains("incoming") && !detail.contains(data.root().to_str().unwrap()), "{detail}");
    }
    assert_eq!(tree(&data.root().join("sessions")).len(), 0);
}

#[tokio::test]
async fn messages_about_sessions_tell_no_path_of_the_server() {
    let data = Data::with_session();
    data.truncate_take();
    let app = data.app();
    let root = data.root().to_str().unwrap();
    let detail = get(&app, "/api/v1/sessions/taps").await.problem(422);
    assert!(detail.starts_with("taps/take-02.mcap: ") && !detail.contains(root), "{detail}");
    let list = String::from_utf8(get(&app, "/api/v1/sessions").await.body.to_vec()).unwrap();
    assert!(list.contains("taps/take-02.mcap: ") && !list.contains(root), "{list}");
    fs::remove_file(data.session().join("session.toml")).unwrap();
    let detail = get(&app, "/api/v1/sessions/taps").await.problem(400);
    assert!(detail.contains("failed to read \"taps/session.toml\"") && !detail.contains(root), "{detail}");
}
