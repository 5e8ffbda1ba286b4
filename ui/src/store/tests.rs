//! Asking once, failing in words, losing the connection, following jobs.

use palpate_wire::proto::JobUpdate;

use super::*;

fn answer(request: Request, body: &str) -> ApiEvent {
    ApiEvent::Answer { request, result: Ok(body.as_bytes().to_vec()) }
}

#[test]
fn asking_twice_sends_once() {
    let mut store = Store::default();
    assert!(store.sessions().is_loading());
    assert!(store.sessions().is_loading());
    assert_eq!(store.take_outbox(), [Request::Sessions]);
    store.receive(answer(Request::Sessions, "[]"), 0.0, "");
    assert_eq!(store.sessions(), Loadable::Ready(Arc::new(Vec::new())));
    assert!(store.take_outbox().is_empty());
}

#[test]
fn failure_stays_until_somebody_tries_again() {
    let mut store = Store::default();
    store.sessions();
    store.take_outbox();
    let failed = ApiEvent::Answer { request: Request::Sessions, result: Err("disk is gone".into()) };
    store.receive(failed, 0.0, "");
    assert_eq!(store.sessions().error(), Some("disk is gone"));
    assert!(store.take_outbox().is_empty());
    store.retry_failed();
    assert!(store.sessions().is_loading());
    assert!(store.take_outbox().contains(&Request::Sessions));
}

#[test]
fn damaged_answers_fail_in_words() {
    let mut store = Store::default();
    store.receive(answer(Request::Sessions, "{"), 0.0, "");
    assert!(store.sessions().error().is_some_and(|error| error.contains("could not be read")));
    let take = Request::Take { session: "s".into(), take: "t".into() };
    store.receive(ApiEvent::Answer { request: take, result: Ok(vec![0xff; 7]) }, 0.0, "");
    assert!(store.take("s", "t").error().is_some());
    let station = Request::Station("s".into());
    store.receive(answer(station, r#"{"station_toml":"","files_base64":{"a":"%"}}"#), 0.0, "");
    assert!(store.station("s").error().is_some_and(|error| error.contains("\"a\" arrived damaged")));
}

#[test]
fn loss_remembers_when_and_keeps_the_last_frame() {
    let mut store = Store::default();
    let live = StreamMessage {
        message: Some(stream_message::Message::Live(LiveFrame { time_s: 4.0, ..Default::default() })),
        dropped: 3,
    };
    store.receive(ApiEvent::SocketOpen, 0.0, "14:00:00");
    store.receive(ApiEvent::SocketMessage(live.encode_to_vec()), 1.0, "14:00:01");
    store.receive(ApiEvent::SocketClosed, 2.0, "14:00:02");
    store.receive(ApiEvent::SocketClosed, 9.0, "14:00:09");
    assert_eq!(store.connection, Connection::Lost { since: "14:00:02".into(), since_s: 2.0 });
    assert_eq!(store.live_frame().map(|frame| frame.time_s), Some(4.0));
    assert_eq!(store.dropped_messages, 3);
    store.receive(ApiEvent::SocketOpen, 12.0, "14:00:12");
    assert_eq!(store.connection, Connection::Open);
    assert!(store.take_outbox().contains(&Request::Sessions));
}

#[test]
fn runs_stay_newest_first_however_their_answers_arrive() {
    let mut store = Store::default();
    store.receive(answer(Request::Runs, "[]"), 0.0, "");
    for id in ["run-9", "run-11", "run-10"] {
        let run = format!(
            r#"{{"id":"{id}","request":{{"session":"s"}},"state":"done","fraction":1,"stage":"done",
            "seconds_left":null,"error":null,"report":null,"model_toml":null,"saved_as":null}}"#
        );
        store.receive(answer(Request::Run(id.into()), &run), 0.0, "");
    }
    let runs = store.runs();
    let ids: Vec<&str> = runs.ready().expect("the list").iter().map(|run| run.id.as_str()).collect();
    assert_eq!(ids, ["run-11", "run-10", "run-9"]);
}

#[test]
fn progress_moves_the_run_and_the_end_fetches_the_result() {
    let mut store = Store::default();
    let run = r#"[{"id":"run-7","request":{"session":"s"},"state":"running","fraction":0.1,"stage":"fit",
        "seconds_left":null,"error":null,"report":null,"model_toml":null,"saved_as":null}]"#;
    store.receive(answer(Request::Runs, run), 0.0, "");
    let update = |state: &str, fraction| {
        let job = JobUpdate {
            job: "run-7".into(),
            state: state.into(),
            fraction,
            stage: "alpha 3 of 20".into(),
            seconds_left: 2.0,
            error: String::new(),
        };
        let message = StreamMessage { message: Some(stream_message::Message::Job(job)), dropped: 0 };
        ApiEvent::SocketMessage(message.encode_to_vec())
    };
    store.receive(update("running", 0.5), 0.0, "");
    let runs = store.runs();
    let running = &runs.ready().expect("the list")[0];
    assert_eq!((running.fraction, running.seconds_left), (0.5, Some(2.0)));
    assert!(store.take_outbox().is_empty());
    store.receive(update("done", 1.0), 0.0, "");
    assert_eq!(store.take_outbox(), [Request::Run("run-7".into())]);
}
