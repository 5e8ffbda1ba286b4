//! A campaign on the physical emulated station, scored blind by somebody else while it goes on.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use palpate_recording::Session;
use palpate_rollout::link::Link;
use palpate_rollout::operator::Operator;
use palpate_rollout::studio::{RequestError, Studio};
use palpate_wire::api::{Campaign, CampaignResults, ComparisonReport, Job, JobState, TrialVerdict};
use serde_json::{Value, json};

use super::station::{self, cube_station, palpate};
use super::{palpate_train, root, turn};

/// Whatever is waited for comes long before this, unless it never does.
const PATIENCE: Duration = Duration::from_secs(300);
/// Verdicts of the scorer by trial, who knows nothing else.
const VERDICTS: [TrialVerdict; 4] =
    [TrialVerdict::Success, TrialVerdict::Slip, TrialVerdict::EmptyGrasp, TrialVerdict::Success];

/// Somebody with a role, whose password is "a password of NAME", and the token of what they use.
pub(crate) fn somebody(palpate: &Path, data: &Path, name: &str, role: &str, scopes: &str) -> String {
    let mut add = Command::new(palpate)
        .args(["people", "add", name, "--role", role, "--data"])
        .arg(data)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .expect("the command starts");
    let mut password = add.stdin.take().expect("its input");
    writeln!(password, "a password of {name}").expect("a password");
    drop(password);
    assert!(add.wait().expect("it ends").success());
    let output = Command::new(palpate)
        .args(["tokens", "create", name, "--name", "test", "--scopes", scopes, "--data"])
        .arg(data)
        .output()
        .expect("the command starts");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let mut words = text.split(|letter: char| letter.is_whitespace() || letter == '"');
    words.find(|word| word.starts_with("plp_")).expect("a token is printed").to_owned()
}

/// The status and the reason of what must be refused.
fn refused<T: std::fmt::Debug>(done: Result<T, RequestError>) -> (u16, String) {
    match done {
        Err(RequestError::Refused { status, detail, .. }) => (status, detail),
        other => panic!("it was not refused: {other:?}"),
    }
}

#[test]
fn a_campaign_is_made_by_one_scored_blind_by_another_and_exported_as_it_was_scored() {
    let Some(palpate) = palpate() else { return };
    let _turn = turn();
    let folder = tempfile::tempdir().expect("a folder");
    let (dir, data) = (folder.path().join("devices"), folder.path().join("data"));
    let (_station, found) = cube_station(&dir);
    let operator_token = somebody(&palpate, &data, "olga", "operator", "read,control,data");
    let scorer_token = somebody(&palpate, &data, "ada", "scorer", "read,score");
    let viewer_token = somebody(&palpate, &data, "vera", "viewer", "read");
    let (_studio, url) = station::studio(&palpate, &data, &["--login", "--tls"], &found);
    let cert = data.join("tls/cert.pem");
    let studio = |token: &str| Studio::new(&url, Some(token.to_owned()), Some(&cert)).expect("a studio");
    let (operator, scorer, viewer) = (studio(&operator_token), studio(&scorer_token), studio(&viewer_token));

    let plan = json!({
        "name": "Night", "starts": 1, "half_width_m": 0.015, "seed": 5, "is_blind": true,
        "policies": [
            { "id": "expert", "source": "{object}.safetensors" },
            { "id": "numb", "source": "{object}.safetensors", "is_silenced": true },
        ],
        "objects": [{ "id": "cube", "group": "seen" }, { "id": "ball", "group": "unseen" }],
    });
    assert_eq!(refused(viewer.post::<Campaign>("/campaigns", &plan)).0, 403);
    assert_eq!(refused(scorer.post::<Campaign>("/campaigns", &plan)).0, 403);
    let _: Campaign = operator.post("/campaigns", &plan).expect("a campaign");

    // Shorter trials, as what they come to is not what is looked at here; the hand is up again by then.
    let world = std::fs::read_to_string(root().join("assets/grasp/xarm6_leap.toml")).expect("a world");
    let short = folder.path().join("world.toml");
    std::fs::write(&short, world.replace("episode_s = 10.0", "episode_s = 6.0")).expect("a file");
    let out = folder.path().join("night");
    // A certificate that vouches for another studio is no reason to talk to this one.
    let other = folder.path().join("other");
    let (another, address) = station::studio(&palpate, &other, &["--tls"], &Value::Null);
    assert!(address.starts_with("https://"), "{address}");
    let wrong =
        Studio::new(&url, Some(operator_token.clone()), Some(&other.join("tls/cert.pem"))).expect("a studio");
    let problem = wrong.get::<Value>("/campaigns").expect_err("another certificate").to_string();
    assert!(problem.contains("does --ca-file"), "{problem}");
    drop(another);
    let mut rollout = palpate_train()
        .args(["rollout", "--campaign", "night", "--url", &url, "--ca-file"])
        .arg(&cert)
        .arg("--operator")
        .arg(found["operator"].as_str().expect("a socket"))
        .arg("--world")
        .arg(&short)
        .arg("--out")
        .arg(&out)
        .env("PALPATE_TOKEN", &operator_token)
        .stdout(Stdio::piped())
        .spawn()
        .expect("the command starts");

    // The scorer scores each trial as it ends; the viewer may neither move nor score.
    let begun = Instant::now();
    let mut num_scored = 0;
    while num_scored < VERDICTS.len() {
        assert!(begun.elapsed() < PATIENCE, "{num_scored} of the trials were made");
        if let Some(status) = rollout.try_wait().expect("a process") {
            assert!(status.success(), "the rollout failed: {status}");
        }
        let seen: Value = scorer.get("/campaigns/night").expect("the campaign");
        let text = seen.to_string();
        assert!(!text.contains("safetensors") && !text.contains("digits were stopped"), "{text}");
        assert!(seen["trials"].as_array().expect("trials").iter().all(|trial| trial["policy"].is_null()));
        let Some(number) = seen["next_to_score"].as_u64() else {
            std::thread::sleep(Duration::from_millis(200));
            continue;
        };
        let score = json!({ "attempt": 0, "verdict": VERDICTS[number as usize - 1] });
        let path = format!("/campaigns/night/trials/{number}/score");
        let (status, why) = refused(viewer.post::<Campaign>(&path, &score));
        assert_eq!(status, 403, "{why}");
        if num_scored == 0 {
            let begin = "/campaigns/night/trials/4/begin";
            assert_eq!(refused(viewer.post::<Campaign>(begin, &json!({}))).0, 403);
            assert_eq!(refused(scorer.post::<Campaign>(begin, &json!({}))).0, 403);
            let moved = Link::connect(&viewer, "vera", true).err().expect("a viewer takes no control");
            eprintln!("viewer: {moved:#}");
            let moved = Link::connect(&scorer, "ada", true).err().expect("a scorer takes no control");
            eprintln!("scorer: {moved:#}");
        }
        let _: Campaign = scorer.post(&path, &score).expect("a score");
        num_scored += 1;
    }
    let printed = rollout.wait_with_output().expect("its output");
    assert!(printed.status.success(), "{printed:?}");
    let printed = String::from_utf8_lossy(&printed.stdout).into_owned();
    assert!(!printed.contains("expert") && !printed.contains("numb"), "the terminal tells nobody: {printed}");

    // What comes out is what was scored, by policy and object.
    assert_eq!(refused(scorer.get::<Value>("/campaigns/night/results")).0, 409);
    let closed: Campaign = operator.post("/campaigns/night/close", &json!({})).expect("it is closed");
    let mut expected: BTreeMap<(String, String), TrialVerdict> = BTreeMap::new();
    for trial in &closed.trials {
        assert_eq!(trial.attempts.len(), 1, "trial {}", trial.number);
        let last = &trial.attempts[0];
        let verdict = VERDICTS[trial.number as usize - 1];
        assert_eq!((last.verdict, last.scores[0].scorer.as_str()), (Some(verdict), "ada"));
        assert_eq!(last.by, "olga");
        let suggested = last.outcome.as_ref().and_then(|outcome| outcome.suggested);
        assert!(suggested.is_some(), "{last:?}");
        let policy = trial.policy.clone().expect("it is open now");
        expected.insert((policy.clone(), trial.object.clone()), verdict);
        let record = last.outcome.as_ref().and_then(|outcome| outcome.record.as_ref()).expect("a record");
        let text = std::fs::read_to_string(record).expect("the record");
        let head: Value = serde_json::from_str(text.lines().next().expect("a line")).expect("JSON");
        assert_eq!(head["trial"]["is_silenced"], policy == "numb");
        assert_eq!(head["trial"]["object"], json!(trial.object));
        let at = |idx: usize| head["trial"]["start"]["object_pose"][idx].as_f64().expect("a pose");
        // The middle of the shipped world's region.
        let away = (at(0) - 0.42 - trial.start.x_m).hypot(at(1) - trial.start.y_m);
        assert!(away < 1e-3, "trial {}: placed {away} m away", trial.number);
    }
    let results: CampaignResults = scorer.get("/campaigns/night/results").expect("results");
    for policy in &results.policies {
        for object in &policy.objects {
            let is = |verdict| {
                u64::from(expected.get(&(policy.policy.clone(), object.object.clone())) == Some(&verdict))
            };
            let counted = [
                object.rate.successes,
                object.failures.empty_grasp,
                object.failures.slip,
                object.rate.trials,
            ];
            let scored = [is(TrialVerdict::Success), is(TrialVerdict::EmptyGrasp), is(TrialVerdict::Slip), 1];
            assert_eq!(counted, scored, "{} on {}", policy.policy, object.object);
        }
    }
    let exported = Command::new(&palpate)
        .args(["campaign", "results", "night", "--json", "--data"])
        .arg(&data)
        .output()
        .expect("the command starts");
    let exported: CampaignResults = serde_json::from_slice(&exported.stdout).expect("results");
    assert_eq!(exported, results);
}

#[test]
fn studio_makes_trials_itself_for_as_long_as_somebody_places_objects() {
    let Some(palpate) = palpate() else { return };
    let _turn = turn();
    let folder = tempfile::tempdir().expect("a folder");
    let (dir, data) = (folder.path().join("devices"), folder.path().join("data"));
    let (_station, found) = cube_station(&dir);
    let token = somebody(&palpate, &data, "olga", "operator", "read,control,data,jobs");
    let train = env!("CARGO_BIN_EXE_palpate-train");
    let (_studio, url) = station::studio(&palpate, &data, &["--login", "--tls", "--train", train], &found);
    let studio = Studio::new(&url, Some(token), Some(&data.join("tls/cert.pem"))).expect("a studio");
    let plan = json!({
        "name": "By the studio", "starts": 2, "half_width_m": 0.015, "seed": 5,
        "policies": [{ "id": "expert", "source": "{object}.safetensors" }], "objects": [{ "id": "cube" }],
    });
    let _: Campaign = studio.post("/campaigns", &plan).expect("a campaign");
    let request = json!({ "kind": "rollouts", "request": { "campaign": "by-the-studio" } });
    let ask = || studio.post::<Job>("/jobs", &request).expect("a job").id;
    let id = ask();
    let until = |id: &str, wanted: &dyn Fn(&Job) -> bool| {
        let begun = Instant::now();
        loop {
            let job: Job = studio.get(&format!("/jobs/{id}")).expect("the job");
            if wanted(&job) {
                return job;
            }
            let log = std::fs::read_to_string(data.join("runs").join(id).join("log.txt")).unwrap_or_default();
            assert!(job.is_unfinished() && begun.elapsed() < PATIENCE, "{job:?}\n{log}");
            std::thread::sleep(Duration::from_millis(100));
        }
    };

    // The robot waits, out of the way, until the object of the first trial is placed and the trial begun.
    until(&id, &|job| job.stage.contains("trial 1 of 2 waits"));
    let campaign: Campaign = studio.get("/campaigns/by-the-studio").expect("the campaign");
    let start = campaign.trials[0].start;
    let place = json!({
        "act": "place", "object": "cube", "offset_m": [start.x_m, start.y_m], "yaw_rad": start.yaw_rad,
        "side": start.side, "seed": start.seed,
    });
    let mut operator =
        Operator::connect(Path::new(found["operator"].as_str().expect("a socket"))).expect("the operator");
    let placed = operator.ask(&place).expect("it is placed");
    assert!(placed["object_pose"].is_array(), "{placed}");
    let _: Campaign = studio.post("/campaigns/by-the-studio/trials/1/begin", &json!({})).expect("it begins");
    let job = until(&id, &|job| job.stage.contains("trial 2 of 2 waits"));
    assert!((job.fraction - 0.5).abs() < 1e-9, "{job:?}");
    let campaign: Campaign = studio.get("/campaigns/by-the-studio").expect("the campaign");
    let first = &campaign.trials[0].attempts[0];
    let outcome = first.outcome.as_ref().expect("what came of it");
    assert_eq!(first.by, "olga");
    assert!(outcome.suggested.is_some_and(|verdict| verdict != TrialVerdict::Void), "{outcome:?}");
    let record = outcome.record.as_ref().expect("a record");
    assert!(Path::new(record).starts_with(data.join("campaigns/by-the-studio/rollout")), "{record}");

    // Nobody places the second one: it is stopped, another job goes on where it was, and a break ends that one well.
    let _: Job = studio.post(&format!("/jobs/{id}/cancel"), &json!({})).expect("it is asked");
    assert_eq!(until(&id, &|job| !job.is_unfinished()).state, JobState::Cancelled);
    let id = ask();
    until(&id, &|job| job.stage.contains("trial 2 of 2 waits"));
    let _: Campaign = studio.post("/campaigns/by-the-studio/pause", &json!({})).expect("a break");
    assert_eq!(until(&id, &|job| !job.is_unfinished()).state, JobState::Done);
    let report = std::fs::read(data.join("runs").join(&id).join("report.json")).expect("a report");
    let report: Value = serde_json::from_slice(&report).expect("JSON");
    let session = "by-the-studio-takes";
    let expected =
        json!({ "campaign": "by-the-studio", "ended": "paused", "trials_made": 0, "session": session });
    assert_eq!(report, expected);

    // The trial became a take, which has the object where the plan put it, and is compared with simulation from there.
    let campaign: Campaign = studio.get("/campaigns/by-the-studio").expect("the campaign");
    assert_eq!(campaign.trials[0].attempts[0].take, Some(format!("{session}/take-01")));
    let takes =
        Session::open(&data.join("sessions").join(session)).and_then(|session| session.accepted_takes());
    let take = takes.expect("a session").into_iter().next().expect("a take");
    let planned_at = take.meta.base_from_object.translation;
    let seen_at: [f64; 7] = serde_json::from_value(placed["object_pose"].clone()).expect("a pose");
    let away_m =
        (planned_at.x - seen_at[0]).hypot(planned_at.y - seen_at[1]).hypot(planned_at.z - seen_at[2]);
    assert!(away_m < 0.002 && !take.meta.fixture_trusted, "{planned_at} against {seen_at:?}");
    let request = json!({ "kind": "comparison", "request": { "campaign": "by-the-studio" } });
    let id = studio.post::<Job>("/jobs", &request).expect("a job").id;
    assert_eq!(until(&id, &|job| !job.is_unfinished()).state, JobState::Done);
    let report = std::fs::read(data.join("runs").join(&id).join("report.json")).expect("a report");
    let report: ComparisonReport = serde_json::from_slice(&report).expect("a comparison");
    let [compared] = &report.trials[..] else { panic!("one trial: {report:?}") };
    assert!(compared.is_start_planned && !compared.is_followed, "{compared:?}");
    assert_eq!((compared.simulated.len(), report.pairings.len()), (1, 1), "{report:?}");
    assert!(report.pairings[0].touch.as_ref().is_some_and(|touch| touch.f1.is_some()), "{report:?}");
}
