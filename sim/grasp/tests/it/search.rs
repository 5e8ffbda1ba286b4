//! Protocols, trials under them, and the search, on the shipped hand.

use palpate_grasp::Protocol;
use palpate_grasp::search::{SearchConfig, Skill};

use super::{config, station, text};

const SEARCH: &str = "grasp/search/xarm6_leap.toml";

#[test]
fn shipped_protocols_say_what_they_are_named_after_and_their_faults_are_named() {
    let station = station();
    for (name, half_width_m, episode_s, one_claim) in [
        ("paper", 0.02, 10.0, false),
        ("wide", 0.08, 10.0, false),
        ("wide_20s", 0.08, 20.0, false),
        ("claim", 0.08, 10.0, true),
    ] {
        let file = format!("grasp/protocols/{name}.toml");
        let protocol = Protocol::from_toml(&file, &text(&file)).expect("a protocol");
        let mut config = config(&station);
        protocol.apply(&mut config);
        let task = &config.task;
        assert_eq!((task.half_width_m, task.episode_s, task.one_claim), (half_width_m, episode_s, one_claim));
        assert_eq!((protocol.trials, protocol.seed), (50, 2));
    }
    let wide = text("grasp/protocols/wide.toml");
    for (from, to, expected) in [
        ("trials = 50", "trials = 0", "trials is 0"),
        ("0.08", "-0.08", "half_width_m is -0.08"),
        ("10.0", "nan", "episode_s is NaN"),
        ("seed = 2", "sed = 2", "unknown field `sed`"),
    ] {
        let message = Protocol::from_toml("p.toml", &wide.replacen(from, to, 1)).expect_err(to).to_string();
        assert!(message.starts_with("p.toml: ") && message.contains(expected), "{message}");
    }
}

fn search(change: impl Fn(String) -> String) -> Result<SearchConfig, String> {
    SearchConfig::from_toml("s.toml", &change(text(SEARCH))).map_err(|err| err.to_string())
}

fn skill(search: &SearchConfig) -> Result<Skill, String> {
    let (station, file) = (station(), "grasp/scripts/big_egg.toml");
    let config = config(&station);
    let script = palpate_grasp::Script::from_toml(file, &text(file), &station.robot, &config);
    Skill::new(&station, &config, &script.expect("a script"), search).map_err(|err| err.to_string())
}

#[test]
fn what_is_wrong_with_a_search_is_named() {
    for (from, to, expected) in [
        ("down_key = 3", "down_key = 5", "the hand down before it is closed"),
        ("close_s = 1.3", "close_s = 0.0", "close_s is 0"),
        ("wait_s = 0.5", "wait_s = -1.0", "wait_s is -1"),
        ("claim_from = 0.97", "claim_from = 1.5", "claim_from is 1.5"),
        ("[0.01, 0.12]", "[0.0001, 0.12]", "at most 100 steps"),
        ("wait_s", "wait", "unknown field `wait`"),
    ] {
        let message = search(|text| text.replacen(from, to, 1)).expect_err(to);
        assert!(message.contains(expected), "{to}: {message}");
    }
    for (from, to, expected) in [
        ("closed_key = 5", "closed_key = 9", "closed_key is 9, but the script has 6 keys"),
        ("thumb_distal", "palm", "link \"palm\", which belongs to no digit"),
    ] {
        let config = search(|text| text.replacen(from, to, 1)).expect("a file that can be read");
        let message = skill(&config).expect_err(to);
        assert!(message.contains(expected), "{to}: {message}");
    }
}

#[test]
fn the_arm_reaches_every_place_of_the_shipped_search() {
    let skill = skill(&search(|text| text).expect("the shipped search")).expect("a skill");
    assert_eq!(skill.places().len(), 25 * 25);
    let nearest = &skill.places()[skill.nearest([0.043, -0.118])];
    assert!((nearest.at_m[0] - 0.04).abs() < 1e-9 && (nearest.at_m[1] + 0.12).abs() < 1e-9);
}

#[cfg(feature = "mujoco")]
mod with_physics {
    use std::sync::Arc;

    use palpate_grasp::controller::{Command, Controller, Scripted};
    use palpate_grasp::search::{Closings, Experience, Prior, Searcher, Senses, simulate};
    use palpate_grasp::trial::{self, Known, Outcome, conduct};
    use palpate_grasp::{GraspScene, Observation, Script};
    use palpate_sim::SensorModel;

    use super::super::{config, object, station, text};
    use super::{search, skill};

    fn scene(one_claim: bool, half_width_m: f64) -> (Arc<GraspScene>, Arc<Script>) {
        let station = station();
        let mut config = config(&station);
        config.task.one_claim = one_claim;
        config.task.half_width_m = half_width_m;
        let file = "grasp/scripts/cube.toml";
        let script = Script::from_toml(file, &text(file), &station.robot, &config).expect("a script");
        let model = SensorModel::from_toml("nominal.toml", &station.nominal_model_toml).expect("a model");
        let scene = GraspScene::new(station, config, &object("cube"), &model).expect("a scene");
        (Arc::new(scene), Arc::new(script))
    }

    fn scripted(scene: &GraspScene, script: &Arc<Script>) -> Scripted {
        Scripted::new(Arc::clone(script), Arc::clone(scene.station()), Arc::new(scene.config().clone()))
    }

    #[test]
    fn a_script_under_a_protocol_has_the_verdicts_of_a_script() {
        let (scene, script) = scene(false, 0.05);
        for number in 0..4 {
            let ending =
                conduct(&scene, &mut scripted(&scene, &script), Known::ROBOT, 7, number).expect("a trial");
            let outcome = trial::run(&scene, &script, 7, number).expect("a trial");
            assert_eq!(ending.outcome, outcome);
        }
    }

    /// A script that claims at a time, and writes down what it gets to know.
    struct Claims {
        scripted: Scripted,
        at_s: f64,
        errors_seen: f64,
        touched: bool,
        told: bool,
    }

    impl Controller for Claims {
        fn control(&mut self, now: &Observation<'_>) -> Command {
            let errors = now.commands.iter().zip(now.positions).map(|(command, read)| (command - read).abs());
            self.errors_seen = errors.fold(self.errors_seen, f64::max);
            self.touched |= now.active.contains(&true);
            self.told |= now.told_place_m.is_some();
            Command { claims_held: now.time_s >= self.at_s, ..self.scripted.control(now) }
        }
    }

    #[test]
    fn a_claim_ends_a_trial_and_is_false_unless_the_object_was_held() {
        let run = |one_claim: bool, at_s: f64, known: Known| {
            let (scene, script) = scene(one_claim, 0.0);
            let scripted = scripted(&scene, &script);
            let mut claims = Claims { scripted, at_s, errors_seen: 0.0, touched: false, told: false };
            (conduct(&scene, &mut claims, known, 7, 0).expect("a trial"), claims)
        };
        let (early, _) = run(true, 2.0, Known::ROBOT);
        assert!(early.is_false_claim() && early.outcome == Outcome::EmptyGrasp && early.time_s < 2.2);
        let (right, seen) = run(true, 7.0, Known::ROBOT);
        assert!(right.is_won() && right.claimed && (7.0..7.2).contains(&right.time_s), "{right:?}");
        assert!(seen.errors_seen > 0.05 && seen.touched && !seen.told);
        let (silent, _) = run(true, f64::INFINITY, Known::ROBOT);
        assert!(silent.is_won() && !silent.claimed && silent.time_s > 9.9, "{silent:?}");
        // Where nobody asks, a claim changes nothing, and neither does what the robot does not get to know.
        let (plain, seen) = run(false, 2.0, Known { touch: false, tracking: false, place: true });
        assert!(plain.is_won() && !plain.claimed && plain.time_s < 6.0, "{plain:?}");
        assert!(seen.errors_seen == 0.0 && !seen.touched && seen.told);
    }

    #[test]
    fn closings_and_searches_have_the_same_bits_for_any_number_of_threads() {
        let (scene, _) = scene(false, 0.04);
        let skill = Arc::new(skill(&search(|text| text).expect("a search")).expect("a skill"));
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| {
                let closings = simulate(&scene, &skill, 0, 0.05, 3, 16).expect("closings");
                let closings = Closings { objects: vec!["cube".to_owned()], window_m: 0.05, closings };
                let experience =
                    Experience::new(closings.clone(), &skill, Senses::BOTH).expect("an experience");
                let prior = Prior { half_width_m: 0.04, shape: None };
                let mut searcher = Searcher::new(Arc::clone(&skill), Arc::new(experience), &prior);
                let ending = conduct(&scene, &mut searcher, Known::ROBOT, 5, 0).expect("a trial");
                (closings, ending, searcher.belief().clone())
            })
        };
        let one = run(1);
        assert_eq!(run(3), one);
        let won = one.0.closings.iter().filter(|closing| closing.won).count();
        assert!((4..=16).contains(&won), "{won} of 16 closings within 5 cm held the cube");
        // What is held was felt.
        let felt =
            |closing: &palpate_grasp::search::Closing| closing.closing.touch.iter().any(|share| *share > 0.0);
        assert!(one.0.closings.iter().filter(|closing| closing.won).all(felt));
    }
}
