//! A session whose object moves, from its import to what the page gets.

use palpate_recording::{Session, Take, check_session, import::import_csv};
use palpate_server::assets;
use palpate_wire::{
    api::SessionDetail,
    proto::{ReplayTrace, TakeTrace},
};
use prost::Message as _;
use serde_json::Value;

use crate::support::{
    Data, NUM_CHANNELS, NUM_FRAMES, NUM_TAKES, STATION, arg, get, palpate_ok,
    write_recording_of_moving_object,
};

/// The session `moved` beside `taps`, in which the hand made the same motions relative to the object.
fn with_both() -> Data {
    let data = Data::with_session();
    let csv = data.path("moved");
    write_recording_of_moving_object(&csv);
    import_csv(&assets::station(STATION).unwrap(), &csv, &data.root().join("sessions/moved")).unwrap();
    data
}

#[tokio::test]
async fn the_page_gets_where_the_object_is_and_the_touch_of_the_same_relative_motion() {
    let data = with_both();
    let app = data.app();
    let detail: SessionDetail = get(&app, "/api/v1/sessions/moved").await.json();
    assert_eq!(detail.takes[0].object_pose, [0.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0], "where it begins");
    let mut num_on = 0;
    for take_idx in 1..=NUM_TAKES {
        let path =
            |session: &str, what: &str| format!("/api/v1/sessions/{session}/takes/take-{take_idx:02}/{what}");
        let trace = TakeTrace::decode(get(&app, &path("moved", "trace")).await.body).unwrap();
        assert_eq!(trace.object_poses.len(), 7 * NUM_FRAMES);
        let heights: Vec<f32> = trace.object_poses.chunks(7).map(|pose| pose[2]).collect();
        assert_eq!(heights[0], 0.05);
        assert!((heights.iter().copied().fold(0.0, f32::max) - 0.058).abs() < 2e-4);
        let still = TakeTrace::decode(get(&app, &path("taps", "trace")).await.body).unwrap();
        assert!(still.object_poses.is_empty());

        let by_object = ReplayTrace::decode(get(&app, &path("moved", "replay")).await.body).unwrap();
        let by_hand = ReplayTrace::decode(get(&app, &path("taps", "replay")).await.body).unwrap();
        assert_eq!(by_object.active, by_hand.active);
        for (by_object, by_hand) in by_object.raw.iter().zip(&by_hand.raw) {
            assert!((by_object - by_hand).abs() < 1e-2, "{by_object} {by_hand}");
        }
        num_on += by_object.active.iter().map(|byte| byte.count_ones()).sum::<u32>();
    }
    assert!(num_on as usize > NUM_CHANNELS);
}

#[test]
fn it_is_checked_calibrated_and_replayed_as_the_hand_that_moves() {
    let data = with_both();
    let session = |name: &str| data.root().join("sessions").join(name);
    let check = check_session(&Session::open(&session("moved")).unwrap()).unwrap();
    assert!(check.ok && check.problems.iter().all(|problem| !problem.place.contains("object_pose")));
    let calibrated = |name: &str| -> Value {
        let model = data.path(&format!("{name}.toml"));
        let json =
            palpate_ok(&["calibrate", "--session", arg(&session(name)), "--out", arg(&model), "--json"]);
        serde_json::from_str(&json).unwrap()
    };
    let (moved, taps) = (calibrated("moved"), calibrated("taps"));
    for key in ["nominal", "calibrated"] {
        assert_eq!(moved[key]["l1"], taps[key]["l1"], "{key}");
    }
    let (take, out) = (session("moved").join("take-01.mcap"), data.path("replayed.mcap"));
    palpate_ok(&[
        "replay",
        "--take",
        arg(&take),
        "--model",
        arg(&data.path("moved.toml")),
        "--out",
        arg(&out),
    ]);
    let (recorded, replayed) = (Take::read(&take).unwrap(), Take::read(&out).unwrap());
    assert_eq!(replayed.object_poses, recorded.object_poses);
    let explained =
        palpate_ok(&["import", "--csv", arg(&data.path("moved")), "--station", STATION, "--explain"]);
    let note =
        "note: the object is where object.csv says: 300 poses, up to 7.9 mm and 0.00 rad from the first";
    assert!(explained.contains(note), "{explained}");
}
