//! Sessions, takes, models and the page.

use axum::http::header;
use palpate_messages::bits;
use palpate_recording::Session;
use palpate_reports::CheckReport;
use palpate_robot_model::{Station, StationFiles};
use palpate_wire::{
    api::{
        Info, ModelSummary, ObjectEntry, SessionDetail, SessionSummary, Source, StationDocument, TrashEntry,
        TrashSort,
    },
    proto::{ReplayTrace, TakeTrace},
};
use prost::Message as _;

use crate::support::{Data, NUM_CHANNELS, NUM_DOFS, NUM_FRAMES, NUM_TAKES, STATION, get, post, send};

#[tokio::test]
async fn empty_studio_lists_nothing() {
    let data = Data::empty();
    let app = data.app();
    let info: Info = get(&app, "/api/v1/info").await.json();
    assert_eq!((info.name.as_str(), info.station, info.source), ("palpate", None, Source::Replay));
    for list in ["sessions", "models", "calibrations"] {
        assert_eq!(get(&app, &format!("/api/v1/{list}")).await.json::<Vec<serde_json::Value>>().len(), 0);
    }
    assert!(get(&app, "/api/v1/station").await.problem(404).contains("--emulate"));
    let stations: Vec<String> = get(&app, "/api/v1/stations").await.json();
    assert!(stations.contains(&STATION.to_owned()));
}

#[tokio::test]
async fn session_tells_what_it_holds() {
    let data = Data::with_session();
    let app = data.app();
    let sessions: Vec<SessionSummary> = get(&app, "/api/v1/sessions").await.json();
    assert_eq!(sessions.len(), 1);
    let detail: SessionDetail = get(&app, "/api/v1/sessions/taps").await.json();
    assert_eq!(detail.summary, sessions[0]);
    assert_eq!((detail.summary.id.as_str(), detail.summary.station.as_str()), ("taps", STATION));
    assert_eq!((detail.summary.takes, detail.summary.frames), (NUM_TAKES, NUM_TAKES * NUM_FRAMES));
    assert_eq!(detail.summary.objects, ["sphere_50mm"]);
    assert_eq!(detail.takes[1].id, "take-02");
    assert_eq!(detail.takes[1].object_pose, [0.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0]);
    assert!(detail.takes[1].has_raw && detail.takes[1].accepted);

    let check: CheckReport = get(&app, "/api/v1/sessions/taps/check").await.json();
    assert!(check.ok, "{:?}", check.problems);
    assert_eq!(check.coverage.len(), NUM_CHANNELS);

    let document: StationDocument = get(&app, "/api/v1/sessions/taps/station").await.json();
    let base64 = base64::Engine::decode;
    let files = document
        .files_base64
        .into_iter()
        .map(|(path, text)| (path, base64(&base64::engine::general_purpose::STANDARD, text).unwrap()));
    let files = StationFiles { station_toml: document.station_toml, files: files.collect() };
    assert_eq!(Station::from_files(files).unwrap().layout.num_channels(), NUM_CHANNELS);
}

#[tokio::test]
async fn objects_are_bodies_with_takes_and_bad_files_say_why() {
    let data = Data::with_session();
    let own = data.root().join("objects");
    std::fs::create_dir_all(&own).unwrap();
    let mug = "id = 'mug'\nlabel = 'Mug'\ndensity_kg_m3 = 1000.0\nshape = { kind = 'box', size_m = [0.1, 0.1, 0.1] }";
    std::fs::write(own.join("mug.toml"), mug).unwrap();
    std::fs::write(
        own.join("bad.toml"),
        "id = 'bad'\nlabel = 'Bad'\nshape = { kind = 'sphere', radius_m = -1 }",
    )
    .unwrap();
    let objects: Vec<ObjectEntry> = get(&data.app(), "/api/v1/objects").await.json();
    let entry = |id: &str| objects.iter().find(|object| object.id == id).unwrap_or_else(|| panic!("{id}"));

    let grouped = |group: &str| {
        let of = |object: &&ObjectEntry| {
            object.content.as_ref().is_ok_and(|content| content.group.as_deref() == Some(group))
        };
        objects.iter().filter(of).count()
    };
    assert_eq!((grouped("seen"), grouped("unseen")), (10, 10));
    let cube = entry("cube").content.as_ref().unwrap();
    assert!((cube.mass_kg.unwrap() - 0.06_f64.powi(3) * 550.0).abs() < 1e-9);
    assert_eq!(cube.rest_poses.len(), 6);
    assert_eq!(entry("wedge_80mm").content.as_ref().unwrap().meshes_base64.len(), 1);
    assert_eq!(entry("sphere_50mm").takes.len(), NUM_TAKES);
    assert!(entry("cube").takes.is_empty());

    let mug = entry("mug");
    assert!(mug.own && (mug.content.as_ref().unwrap().mass_kg.unwrap() - 1.0).abs() < 1e-9);
    let problem = entry("bad").content.as_ref().unwrap_err();
    assert!(problem.contains("bad.toml: line 3") && problem.contains("radius_m is -1"), "{problem}");
}

#[tokio::test]
async fn trace_holds_the_take() {
    let data = Data::with_session();
    let answer = get(&data.app(), "/api/v1/sessions/taps/takes/take-01/trace").await;
    assert_eq!(answer.header(header::CONTENT_TYPE), "application/x-protobuf");
    let trace = TakeTrace::decode(answer.body).unwrap();
    let take = Session::open(data.session()).unwrap().take(0).unwrap();
    assert_eq!(trace.frame_times_s, take.joints.times_s);
    assert_eq!(trace.joint_positions.len(), NUM_FRAMES * NUM_DOFS);
    assert_eq!(bits::unpack(&trace.real_active, NUM_FRAMES * NUM_CHANNELS), take.active_at_frames());
    let gel = &trace.streams[0];
    assert_eq!((gel.stream.as_str(), gel.raw.len()), ("gel", gel.times_s.len() * 9));
    assert_eq!(bits::unpack(&gel.active, gel.raw.len()), take.streams[0].active);
    // Readings are given less their value at rest.
    assert_eq!(gel.raw[4], 0.0);
    let highest = gel.raw.iter().copied().fold(0.0, f32::max);
    assert!((highest - 696.0).abs() < 1e-3, "{highest}");
    assert_eq!(trace.spans[0].kind, "baseline");
}

#[tokio::test]
async fn nominal_replay_feels_the_taps() {
    let data = Data::with_session();
    let app = data.app();
    let answer = get(&app, "/api/v1/sessions/taps/takes/take-01/replay?model=nominal").await;
    let replay = ReplayTrace::decode(answer.body).unwrap();
    assert_eq!(replay.raw.len(), NUM_FRAMES * NUM_CHANNELS);
    assert_eq!(replay.thresholds.len(), NUM_CHANNELS);
    let active = bits::unpack(&replay.active, NUM_FRAMES * NUM_CHANNELS);
    let middle_taxel: Vec<bool> = active.chunks(NUM_CHANNELS).map(|frame| frame[4]).collect();
    assert!(middle_taxel.contains(&true) && middle_taxel.contains(&false));
    for (frame, active) in middle_taxel.iter().enumerate() {
        assert_eq!(*active, replay.raw[frame * NUM_CHANNELS + 4] > replay.thresholds[4], "frame {frame}");
    }
    let again = get(&app, "/api/v1/sessions/taps/takes/take-01/replay").await;
    assert_eq!(ReplayTrace::decode(again.body).unwrap(), replay, "nominal is the default");
}

#[tokio::test]
async fn what_does_not_exist_is_not_found() {
    let data = Data::with_session();
    let app = data.app();
    for path in [
        "/api/v1/sessions/nothing",
        "/api/v1/sessions/nothing/check",
        "/api/v1/sessions/nothing/takes/take-01/trace",
        "/api/v1/sessions/taps/takes/take-99/trace",
        "/api/v1/sessions/taps/takes/take-01/replay?model=nothing",
        "/api/v1/sessions/taps/takes/take-01/replay?model=run:run-9",
        "/api/v1/models/nothing",
        "/api/v1/calibrations/run-9",
        "/api/v1/calibrations/run-9/report.html",
        "/api/v1/nothing",
        "/api/v2/sessions",
    ] {
        let detail = get(&app, path).await.problem(404);
        assert!(
            detail.contains("nothing") || detail.contains('9') || detail.contains("v2"),
            "{path}: {detail}"
        );
    }
    send(&app, "DELETE", "/api/v1/sessions/nothing", None).await.problem(404);
    send(&app, "POST", "/api/v1/sessions/nothing/restore", None).await.problem(404);
    send(&app, "POST", "/api/v1/calibrations/run-9/cancel", None).await.problem(404);
    send(&app, "PUT", "/api/v1/sessions", None).await.problem(405);
}

#[tokio::test]
async fn ids_cannot_leave_their_folder() {
    let data = Data::with_session();
    std::fs::write(data.root().join("secret.toml"), "secret").unwrap();
    let app = data.app();
    for path in [
        "/api/v1/sessions/%2E%2E",
        "/api/v1/sessions/..%2F..%2Fcsv",
        "/api/v1/sessions/taps%2F",
        "/api/v1/sessions/.incoming-x",
        "/api/v1/models/..%2Fsecret",
        "/api/v1/calibrations/..%2F..%2Fsecret",
        "/api/v1/calibrations/%2E%2E/report.html",
        "/api/v1/sessions/taps/takes/take-01/replay?model=..%2Fsecret",
        "/api/v1/sessions/%00",
    ] {
        let detail = get(&app, path).await.problem(400);
        assert!(detail.contains("expected a plain name"), "{path}: {detail}");
    }
    // A take's id is looked up in the session's list and never becomes a path.
    get(&app, "/api/v1/sessions/taps/takes/..%2Fsession.toml/trace").await.problem(404);
    send(&app, "DELETE", "/api/v1/sessions/..%2Fsessions", None).await.problem(400);
    get(&app, "/api/v1/sessions/%FF").await.problem(400);
    assert!(data.session().is_dir());
}

#[tokio::test]
async fn deleted_session_comes_back() {
    let data = Data::with_session();
    let app = data.app();
    let before: SessionDetail = get(&app, "/api/v1/sessions/taps").await.json();
    assert_eq!(send(&app, "DELETE", "/api/v1/sessions/taps", None).await.status, 204);
    get(&app, "/api/v1/sessions/taps").await.problem(404);
    assert!(get(&app, "/api/v1/sessions").await.json::<Vec<SessionSummary>>().is_empty());
    let deleted: Vec<TrashEntry> = get(&app, "/api/v1/trash").await.json();
    assert_eq!(deleted.len(), 1, "{deleted:?}");
    assert_eq!((deleted[0].sort, deleted[0].id.as_str()), (TrashSort::Session, "taps"));
    let ago_s = palpate_jobs::seconds_between(&deleted[0].deleted, std::time::SystemTime::now());
    assert!(ago_s.is_some_and(|ago| (-1.0..3600.0).contains(&ago)), "{deleted:?}");
    let restored = send(&app, "POST", "/api/v1/sessions/taps/restore", None).await;
    assert!(get(&app, "/api/v1/trash").await.json::<Vec<TrashEntry>>().is_empty());
    assert_eq!(restored.json::<SessionDetail>(), before);
    send(&app, "POST", "/api/v1/sessions/taps/restore", None).await.problem(404);
}

#[tokio::test]
async fn session_deleted_twice_keeps_both() {
    let data = Data::with_session();
    let app = data.app();
    for _ in 0..2 {
        assert_eq!(send(&app, "DELETE", "/api/v1/sessions/taps", None).await.status, 204);
        let station = palpate_server::assets::station(STATION).unwrap();
        palpate_recording::import::import_csv(&station, data.csv(), data.session()).unwrap();
    }
    assert_eq!(std::fs::read_dir(data.root().join("trash/sessions")).unwrap().count(), 2);
    let deleted: Vec<TrashEntry> = get(&app, "/api/v1/trash").await.json();
    assert_eq!(deleted.len(), 1, "only the later one can be restored by its name: {deleted:?}");
    let detail = send(&app, "POST", "/api/v1/sessions/taps/restore", None).await.problem(409);
    assert!(detail.contains("taps"), "{detail}");
}

#[tokio::test]
async fn models_are_listed_read_and_restored() {
    let data = Data::with_session();
    let app = data.app();
    let model = "format = 1\nname = \"Soft\"\n[theta]\nlambda_con_m = 0.001\nalpha_per_m = 80.0\n\
        lambda_pre_pa = 500.0\n";
    std::fs::write(data.root().join("models/soft.toml"), model).unwrap();
    std::fs::write(data.root().join("models/broken.toml"), "format = 9").unwrap();
    let models: Vec<ModelSummary> = get(&app, "/api/v1/models").await.json();
    assert_eq!(models.len(), 1, "a model that cannot be read is left out");
    assert_eq!((models[0].id.as_str(), models[0].theta.alpha_per_m), ("soft", 80.0));
    let detail = get(&app, "/api/v1/models/broken").await.problem(422);
    assert!(detail.contains("broken.toml"), "{detail}");
    let text = get(&app, "/api/v1/models/soft").await;
    assert_eq!(text.body, model);
    let replay = get(&app, "/api/v1/sessions/taps/takes/take-01/replay?model=soft").await;
    assert_eq!(ReplayTrace::decode(replay.body).unwrap().thresholds[4], 500.0);
    assert_eq!(send(&app, "DELETE", "/api/v1/models/soft", None).await.status, 204);
    get(&app, "/api/v1/models/soft").await.problem(404);
    let deleted: Vec<TrashEntry> = get(&app, "/api/v1/trash").await.json();
    assert_eq!((deleted[0].sort, deleted[0].id.as_str()), (TrashSort::Model, "soft"));
    let restored: ModelSummary = send(&app, "POST", "/api/v1/models/soft/restore", None).await.json();
    assert_eq!(restored, models[0]);
}

#[tokio::test]
async fn damaged_session_is_listed_with_what_is_wrong() {
    let data = Data::with_session();
    let file = data.truncate_take();
    let app = data.app();
    let sessions: Vec<SessionSummary> = get(&app, "/api/v1/sessions").await.json();
    let error = sessions[0].error.as_deref().unwrap();
    assert!(error.contains(&file), "{error}");
    for path in ["", "/takes/take-02/trace", "/takes/take-02/replay"] {
        let detail = get(&app, &format!("/api/v1/sessions/taps{path}")).await.problem(422);
        assert!(detail.contains(&file), "{detail}");
    }
    let check: CheckReport = get(&app, "/api/v1/sessions/taps/check").await.json();
    assert!(!check.ok && check.problems[0].place.contains("take-02"), "{:?}", check.problems);
    assert_eq!(get(&app, "/api/v1/sessions/taps/takes/take-01/trace").await.status, 200);
}

#[tokio::test]
async fn page_or_how_to_build_it_is_at_the_root() {
    let data = Data::empty();
    let app = data.app();
    let answer = get(&app, "/").await;
    assert_eq!(answer.status, 200);
    assert!(answer.header(header::CONTENT_TYPE).starts_with("text/html"));
    assert_eq!(answer.header(header::CACHE_CONTROL), "no-cache");
    assert!(String::from_utf8_lossy(&answer.body).contains("Palpate"));
    assert_eq!(get(&app, "/nothing.js").await.status, 404);
}

#[tokio::test]
async fn requests_that_make_no_sense_are_refused() {
    let data = Data::with_session();
    let app = data.app();
    let start = "/api/v1/calibrations";
    let refused = |body| post(&app, start, body);
    let no_such_session = serde_json::json!({"session": "nothing"});
    refused(&no_such_session).await.problem(404);
    let method = serde_json::json!({"session": "taps", "method": "guess"});
    assert!(refused(&method).await.problem(400).contains("exact"));
    let hold_out = serde_json::json!({"session": "taps", "hold_out": ["take-77"]});
    assert!(refused(&hold_out).await.problem(400).contains("take-01"));
    let unknown_field = serde_json::json!({"session": "taps", "speed": 3});
    assert!(refused(&unknown_field).await.problem(422).contains("speed"));
    send(&app, "POST", start, Some(("application/json", b"{".to_vec()))).await.problem(400);
    send(&app, "POST", start, Some(("text/plain", b"{}".to_vec()))).await.problem(415);
    send(&app, "POST", "/api/v1/sessions", Some(("application/zip", Vec::new()))).await.problem(400);
    assert!(get(&app, start).await.json::<Vec<serde_json::Value>>().is_empty());
}
