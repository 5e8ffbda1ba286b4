//! A campaign on the physical emulated station, led, scored blind and watched by three people in browsers of their own.

use std::collections::BTreeMap;
use std::process::{Child, Command};
use std::time::Duration;

use palpate_rollout::studio::Studio;
use palpate_wire::api::{Campaign, CampaignResults, CampaignSummary, TrialVerdict};
use serde::Deserialize;

use super::campaigns::somebody;
use super::station::{self, browser, cube_station};
use super::{palpate_train, root, turn};

/// Whether there is a trial to make is looked for this often.
const LOOK_AGAIN: Duration = Duration::from_millis(200);

/// Starts of each object with each policy; `PALPATE_ROUNDS` asks for more.
const STARTS: u32 = 2;

/// A verdict that the scorer gave on their page.
#[derive(Deserialize)]
struct Scored {
    trial: u32,
    verdict: TrialVerdict,
}

/// A process that ends with its owner.
struct Ends(Child);

impl Drop for Ends {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Ends {
    /// Whether it has ended, which it does well or not at all.
    fn has_ended(&mut self, what: &str) -> bool {
        let status = self.0.try_wait().expect("a process");
        assert!(status.is_none_or(|status| status.success()), "{what}: {status:?}");
        status.is_some()
    }
}

#[test]
fn three_people_lead_score_and_watch_a_campaign_in_their_browsers() {
    let Some(browser) = browser() else { return };
    let rounds = std::env::var("PALPATE_ROUNDS").ok();
    let starts = rounds.map_or(STARTS, |rounds| rounds.parse().expect("PALPATE_ROUNDS is a number"));
    let _turn = turn();
    let folder = tempfile::tempdir().expect("a folder");
    let (dir, data) = (folder.path().join("devices"), folder.path().join("data"));
    let (_station, found) = cube_station(&dir);
    let token = somebody(&browser.palpate, &data, "olga", "operator", "read,control,data");
    somebody(&browser.palpate, &data, "ada", "scorer", "read,score");
    somebody(&browser.palpate, &data, "vera", "viewer", "read");
    let (_studio, url) = station::studio(&browser.palpate, &data, &["--login", "--tls"], &found);
    let cert = data.join("tls/cert.pem");
    let studio = Studio::new(&url, Some(token.clone()), Some(&cert)).expect("a studio");

    // What trials come to is not looked at here: they are as short as the script's way up allows.
    let world = std::fs::read_to_string(root().join("assets/grasp/xarm6_leap.toml")).expect("a world");
    let short = folder.path().join("world.toml");
    std::fs::write(&short, world.replace("episode_s = 10.0", "episode_s = 5.0")).expect("a file");
    let start_rollout = |campaign: &str| {
        let rollout = palpate_train()
            .args(["rollout", "--campaign", campaign, "--url", &url, "--ca-file"])
            .arg(&cert)
            .arg("--operator")
            .arg(found["operator"].as_str().expect("a socket"))
            .arg("--world")
            .arg(&short)
            .arg("--out")
            .arg(folder.path().join("rollout"))
            .env("PALPATE_TOKEN", &token)
            .spawn();
        Ends(rollout.expect("the command starts"))
    };
    let told = folder.path().join("scored.json");
    let people = Command::new("node")
        .arg("campaign.mjs")
        .arg(&url)
        .arg(&browser.artifacts)
        .arg(&told)
        .arg(starts.to_string())
        .current_dir(&browser.scripts)
        .spawn();
    let mut people = Ends(people.expect("node"));

    // A rollout makes trials as long as there are some and nobody takes a break.
    let mut rollout: Option<Ends> = None;
    let mut num_rollouts = 0;
    while !people.has_ended("campaign.mjs; see above and the pictures in target/e2e") {
        if rollout.as_mut().is_some_and(|rollout| rollout.has_ended("the rollout")) {
            rollout = None;
        }
        let campaigns: Vec<CampaignSummary> = studio.get("/campaigns").expect("campaigns");
        let open = campaigns.iter().find(|campaign| campaign.paused.is_none() && campaign.closed.is_none());
        if let (None, Some(open)) = (&rollout, open) {
            let campaign: Campaign = studio.get(&format!("/campaigns/{}", open.id)).expect("the campaign");
            if campaign.next.is_some() {
                rollout = Some(start_rollout(&open.id));
                num_rollouts += 1;
            }
        }
        std::thread::sleep(LOOK_AGAIN);
    }
    assert_eq!(num_rollouts, 2, "one before the break and one after it");

    // What the scorer pressed is what is on disk and what the command prints.
    let scored = std::fs::read(&told).expect("what was scored");
    let scored: Vec<Scored> = serde_json::from_slice(&scored).expect("verdicts");
    let scored: BTreeMap<u32, TrialVerdict> =
        scored.iter().map(|score| (score.trial, score.verdict)).collect();
    let campaign: Campaign = studio.get("/campaigns/two-arms").expect("the campaign");
    assert_eq!((campaign.trials.len(), scored.len()), (4 * starts as usize, 4 * starts as usize));
    let mut expected: BTreeMap<(&str, &str, TrialVerdict), u64> = BTreeMap::new();
    for trial in &campaign.trials {
        let verdict = trial.attempts.last().and_then(|attempt| attempt.verdict);
        assert_eq!(verdict, scored.get(&trial.number).copied(), "trial {}", trial.number);
        let policy = trial.policy.as_deref().expect("it is open now");
        let verdict = verdict.expect("it was scored");
        *expected.entry((policy, trial.object.as_str(), verdict)).or_default() += 1;
    }
    let printed = Command::new(&browser.palpate)
        .args(["campaign", "results", "two-arms", "--json", "--data"])
        .arg(&data)
        .output()
        .expect("the command starts");
    let printed: CampaignResults = serde_json::from_slice(&printed.stdout).expect("results");
    for policy in &printed.policies {
        for object in &policy.objects {
            let count = |verdict| {
                expected.get(&(policy.policy.as_str(), object.object.as_str(), verdict)).copied().unwrap_or(0)
            };
            let counted = [
                object.rate.successes,
                object.failures.empty_grasp,
                object.failures.slip,
                object.failures.emergency_stop,
                object.void,
            ];
            assert_eq!(counted, TrialVerdict::ALL.map(count), "{} on {}", policy.policy, object.object);
        }
    }
}
