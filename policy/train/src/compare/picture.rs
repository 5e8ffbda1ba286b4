//! Pictures of single trials: where the hand searched, what it felt, and, of searching experts, what they believed.

use std::path::Path;
use std::sync::Arc;

use maud::{Markup, html};
use nalgebra::Vector3;
use palpate_grasp::search::{Belief, Senses};
use palpate_grasp::trial::{Ending, Outcome};
use palpate_grasp::{GraspEnv, GraspScene, Protocol};

use super::films::{Film, Films};
use super::{Contestant, Mover, POLICY, Ready};
use crate::files;

/// A pixel of the map is this wide, m.
const PIXEL_M: f64 = 0.0006;
/// What is drawn around the region that objects start in, m.
const AROUND_M: f64 = 0.04;
/// Width of what was felt over time, pixels, and height of a channel.
const TIME_WIDTH: f64 = 300.0;
const CHANNEL_HEIGHT: f64 = 3.0;
/// Height of the picture of heights, pixels; what it reaches up to, m.
const HEIGHT_HEIGHT: f64 = 60.0;
const MAX_HEIGHT_M: f64 = 0.3;
/// Free on every side, pixels.
const MARGIN: f64 = 24.0;
/// Beliefs that are drawn beside the map: those before the first tries.
const MAX_BELIEFS: usize = 6;
/// A cell that is less likely than this share of the likeliest is not drawn.
const UNLIKELY: f64 = 0.02;
/// Edge of a belief's picture, pixels.
const BELIEF_EDGE: f64 = 96.0;

/// A trial as it went.
#[derive(Default)]
struct Trace {
    moments: Vec<Moment>,
    /// What a searching expert believed before each of its tries, and when.
    beliefs: Vec<(f64, Belief)>,
}

/// After a control step; places from the middle of the region, on the table.
struct Moment {
    time_s: f64,
    /// Mean place of the taxels.
    hand_m: Vector3<f64>,
    object_m: Vector3<f64>,
    active: Vec<usize>,
}

impl Trace {
    fn see(&mut self, env: &GraspEnv) {
        let scene = env.scene();
        let station = scene.station();
        let mut base_from_link = Vec::new();
        station.robot.forward_kinematics(env.positions(), &mut base_from_link);
        let taxels = station.layout.patches.iter().flat_map(|patch| {
            let link = base_from_link[patch.link];
            patch.taxels_in_link.iter().map(move |taxel| (link * taxel).coords)
        });
        let middle = taxels.sum::<Vector3<f64>>() / station.layout.num_channels().max(1) as f64;
        let config = scene.config();
        let [x, y] = config.task.center_m;
        let from_middle = |at: Vector3<f64>| at - Vector3::new(x, y, config.table.top_m);
        let active = env.readings().active.iter().enumerate().filter(|(_, is_active)| **is_active);
        self.moments.push(Moment {
            time_s: env.time_s(),
            hand_m: from_middle(middle),
            object_m: from_middle(env.world().base_from_object().translation.vector),
            active: active.map(|(channel, _)| channel).collect(),
        });
    }
}

/// Draws into the `folder`, and films, the first trial that `arm` won and the first that it lost, of those on one object, if
/// it is the policy itself or a searching expert that can use its senses.
pub(super) fn of_trials(
    folder: Option<&Path>,
    films: &mut Option<Films>,
    arm: &Contestant,
    ready: &Ready,
    scene: &Arc<GraspScene>,
    protocol: &Protocol,
    trials: &[Ending],
) -> anyhow::Result<()> {
    let searches = matches!(arm.mover, Mover::Search(senses) if senses != Senses::NONE);
    let is_drawn = arm.name == POLICY || (searches && arm.known == arm.mover.known());
    if !is_drawn {
        return Ok(());
    }
    let name = name_of(&arm.policy);
    for is_won in [true, false] {
        let Some(trial) = trials.iter().position(|ending| ending.is_won() == is_won) else { continue };
        let end = if is_won { "won" } else { "lost" };
        let file = format!("{}_{end}_{name}", scene.object().id);
        let mut trace = Trace::default();
        let mut film = films.as_ref().map(|_| Film::new(&file, &arm.policy, scene));
        let seen = ready.run_seen(scene, arm.known, protocol.seed, trial as u64, &mut |env| {
            trace.see(env);
            if let Some(film) = &mut film {
                film.see(env);
            }
        })?;
        if let (Some(films), Some(mut film)) = (films.as_mut(), film) {
            film.end(&trials[trial]);
            films.add(film);
        }
        let Some(folder) = folder else { continue };
        trace.beliefs = seen.1;
        let path = folder.join(format!("{file}.svg"));
        let title = format!("{name} on {}, trial {trial}", scene.object().label);
        let picture = draw(&trace, &title, &trials[trial], protocol, scene.station().layout.num_channels());
        files::write_in_one_move(&path, picture.into_string().as_bytes())?;
    }
    Ok(())
}

/// What a policy is called: the name of its file or folder.
fn name_of(policy: &str) -> String {
    let path = Path::new(policy.strip_prefix("clone:").unwrap_or(policy));
    let name = path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy();
    name.replace(|letter: char| !letter.is_ascii_alphanumeric() && letter != '_', "_")
}

fn draw(trace: &Trace, title: &str, ending: &Ending, protocol: &Protocol, num_channels: usize) -> Markup {
    let reach_m = protocol.half_width_m + AROUND_M;
    let edge = 2.0 * reach_m / PIXEL_M;
    let map = Map { left: MARGIN, top: 2.0 * MARGIN, edge, reach_m };
    let right = MARGIN + edge + 2.0 * MARGIN;
    let felt_height = CHANNEL_HEIGHT * num_channels as f64;
    let beliefs = &trace.beliefs[..trace.beliefs.len().min(MAX_BELIEFS)];
    let width = right + TIME_WIDTH + MARGIN;
    let beliefs_top = map.top + edge + 2.0 * MARGIN;
    let height = if beliefs.is_empty() { beliefs_top } else { beliefs_top + BELIEF_EDGE + 2.0 * MARGIN };
    let time_x = |time_s: f64| right + TIME_WIDTH * time_s / protocol.episode_s;
    let felt_top = map.top + HEIGHT_HEIGHT + 2.0 * MARGIN;
    let height_y = |at_m: f64| map.top + HEIGHT_HEIGHT * (1.0 - at_m.clamp(0.0, MAX_HEIGHT_M) / MAX_HEIGHT_M);
    let line = |points: Vec<[f64; 2]>| {
        points.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect::<Vec<_>>().join(" ")
    };
    let on_map = |place: fn(&Moment) -> Vector3<f64>| {
        line(trace.moments.iter().map(|moment| map.at(&place(moment))).collect())
    };
    let over_time = |place: fn(&Moment) -> Vector3<f64>| {
        line(trace.moments.iter().map(|moment| [time_x(moment.time_s), height_y(place(moment).z)]).collect())
    };
    let step_width = trace.moments.get(1).map_or(1.0, |second| time_x(second.time_s) - right).max(0.5);
    let [region_left, region_top] = map.at(&Vector3::new(protocol.half_width_m, protocol.half_width_m, 0.0));
    let region = 2.0 * protocol.half_width_m / PIXEL_M;
    let verdict = match ending.outcome {
        Outcome::Success => "won",
        Outcome::EmptyGrasp => "lost: empty grasp",
        Outcome::Slip => "lost: slip",
        Outcome::EmergencyStop => "lost: emergency stop",
    };
    html! {
        svg xmlns="http://www.w3.org/2000/svg" viewBox=(format!("0 0 {width:.0} {height:.0}")) width=(format!("{width:.0}"))
            role="img" aria-label=(format!("{title}: {verdict}")) font-family="system-ui,sans-serif" font-size="11" {
            style { (STYLE) }
            rect.ground width="100%" height="100%" {}
            text.title x=(MARGIN) y=(MARGIN) { (title) ": " (verdict) (format!(" after {:.1} s", ending.time_s)) }
            // From above, as somebody behind the robot sees it: x away from the robot is up, y is to the left.
            rect.frame x=(map.left) y=(map.top) width=(format!("{edge:.0}")) height=(format!("{edge:.0}")) {}
            rect.region x=(format!("{region_left:.1}")) y=(format!("{region_top:.1}")) width=(format!("{region:.1}"))
                height=(format!("{region:.1}")) {}
            polyline.hand points=(on_map(|moment| moment.hand_m)) {}
            @for moment in trace.moments.iter().filter(|moment| !moment.active.is_empty()) {
                @let [x, y] = map.at(&moment.hand_m);
                circle.felt cx=(format!("{x:.1}")) cy=(format!("{y:.1}")) r=(format!("{:.1}", 1.0 + (moment.active.len() as f64).sqrt())) {}
            }
            polyline.object points=(on_map(|moment| moment.object_m)) {}
            @if let Some(first) = trace.moments.first() {
                @let [x, y] = map.at(&first.object_m);
                circle.start cx=(format!("{x:.1}")) cy=(format!("{y:.1}")) r="6" {}
            }
            @for moment in seconds(&trace.moments) {
                @let [x, y] = map.at(&moment.hand_m);
                text.second x=(format!("{x:.1}")) y=(format!("{y:.1}")) { (format!("{:.0}", moment.time_s)) }
            }
            text x=(map.left) y=(map.top + edge + 14.0) { "from above: hand, what it felt (dots), object; numbers are seconds" }
            text x=(right) y=(map.top - 6.0) { "height of hand and object" }
            rect.frame x=(right) y=(map.top) width=(TIME_WIDTH) height=(HEIGHT_HEIGHT) {}
            polyline.hand points=(over_time(|moment| moment.hand_m)) {}
            polyline.object points=(over_time(|moment| moment.object_m)) {}
            text x=(right) y=(felt_top - 6.0) { "channels that felt something, over " (protocol.episode_s) " s" }
            rect.frame x=(right) y=(felt_top) width=(TIME_WIDTH) height=(felt_height) {}
            @for moment in &trace.moments {
                @for &channel in &moment.active {
                    rect.felt x=(format!("{:.1}", time_x(moment.time_s))) y=(format!("{:.0}", felt_top + CHANNEL_HEIGHT * channel as f64))
                        width=(format!("{step_width:.1}")) height=(CHANNEL_HEIGHT) {}
                }
            }
            @for (idx, (time_s, belief)) in beliefs.iter().enumerate() {
                @let left = MARGIN + idx as f64 * (BELIEF_EDGE + 12.0);
                @let small = Map { left, top: beliefs_top + 8.0, edge: BELIEF_EDGE, reach_m };
                text x=(left) y=(beliefs_top) { (format!("believed at {time_s:.1} s")) }
                rect.frame x=(left) y=(small.top) width=(BELIEF_EDGE) height=(BELIEF_EDGE) {}
                (cells(belief, &small))
            }
        }
    }
}

/// What is seen from above.
struct Map {
    left: f64,
    top: f64,
    edge: f64,
    reach_m: f64,
}

impl Map {
    /// Where a place is drawn: x away from the robot is up, y is to the left.
    fn at(&self, place_m: &Vector3<f64>) -> [f64; 2] {
        let share = |at_m: f64| (0.5 - 0.5 * at_m / self.reach_m).clamp(0.0, 1.0);
        [self.left + self.edge * share(place_m.y), self.top + self.edge * share(place_m.x)]
    }
}

/// The likeliest cell of `belief` is the darkest.
fn cells(belief: &Belief, map: &Map) -> Markup {
    let (places, cell_m) = belief.places();
    let most = places.iter().map(|(_, mass)| *mass).fold(f64::MIN_POSITIVE, f64::max);
    let edge = map.edge * cell_m / (2.0 * map.reach_m);
    let is_drawn = |(at_m, mass): &&([f64; 2], f64)| {
        *mass >= UNLIKELY * most && at_m.iter().all(|at_m| at_m.abs() + 0.5 * cell_m <= map.reach_m)
    };
    html! {
        @for (at_m, mass) in places.iter().filter(is_drawn) {
            @let [x, y] = map.at(&Vector3::new(at_m[0] + 0.5 * cell_m, at_m[1] + 0.5 * cell_m, 0.0));
            rect.believed x=(format!("{x:.1}")) y=(format!("{y:.1}")) width=(format!("{edge:.1}")) height=(format!("{edge:.1}"))
                opacity=(format!("{:.2}", mass / most)) {}
        }
    }
}

/// The first moment of each second.
fn seconds(moments: &[Moment]) -> impl Iterator<Item = &Moment> {
    let next = moments.iter().skip(1);
    moments
        .iter()
        .zip(next)
        .filter(|(one, next)| next.time_s.floor() > one.time_s.floor())
        .map(|(_, next)| next)
}

const STYLE: &str = ".ground{fill:#fff}.frame{fill:none;stroke:#9aa}.region{fill:none;stroke:#567;stroke-dasharray:4 3}\
    .hand{fill:none;stroke:#0a6fb5;stroke-width:1.5;opacity:.8}.object{fill:none;stroke:#b5560a;stroke-width:2}\
    .start{fill:none;stroke:#b5560a;stroke-width:2}.felt{fill:#7a2f8f;opacity:.7}.believed{fill:#0a6fb5}\
    .second{fill:#0a6fb5;font-size:9px}.title{font-size:13px;font-weight:600}";
