//! Replay and propagation on the shipped hand, at the size of a whole calibration session, beside what bounds them.
//!
//! `cargo bench -p palpate_sim --features batch --bench replay`; without `batch` there is one thread.
//! The hand stays at the object all the time, so that culling skips less than in a recorded session.

use std::hint::black_box;
use std::path::Path;

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{Isometry3, Point3, Vector3};
use palpate_robot_model::{SensorKind, Station};
use palpate_sim::geometry::SignedDistance;
use palpate_sim::replay::{ContactTrace, NEAR_M, PatchTrace, contact_trace};
use palpate_sim::tactile::raw_signals;

const NUM_FRAMES: usize = 5674;

struct Scene {
    station: Station,
    base_from_object: Isometry3<f64>,
    positions: Vec<f64>,
}

/// The second pressure patch presses 2 mm into a ball of `radius_m` and moves about there.
fn scene(radius_m: f64) -> Scene {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/stations");
    let read = |path: &str| std::fs::read(dir.join(path)).map_err(|err| err.to_string());
    let station = Station::read("xarm6_leap.toml", read).expect("the shipped station is valid");
    let num_dofs = station.robot.num_dofs();
    let rest: Vec<f64> =
        (0..num_dofs).map(|dof| if station.carrier_dofs.contains(&dof) { 0.0 } else { 0.4 }).collect();
    let mut root_from_link = Vec::new();
    station.robot.forward_kinematics(&rest, &mut root_from_link);
    let is_pressure = |stream: usize| station.layout.streams[stream].kind == SensorKind::Pressure;
    let patch =
        station.layout.patches.iter().filter(|patch| is_pressure(patch.stream)).nth(1).expect("a second tip");
    let taxel_in_root = root_from_link[patch.link] * patch.taxels_in_link[0];
    let normal_in_root = root_from_link[patch.link] * patch.taxel_normals_in_link[0].into_inner();
    let center = taxel_in_root + normal_in_root * (radius_m - 0.002);
    let positions = (0..NUM_FRAMES)
        .flat_map(|frame| {
            let phase = frame as f64 * 0.05;
            let swing = |dof: usize| if dof < 6 { 0.004 } else { 0.08 } * (phase + dof as f64).sin();
            rest.iter().enumerate().map(move |(dof, position)| position + swing(dof)).collect::<Vec<_>>()
        })
        .collect();
    Scene { station, base_from_object: Isometry3::translation(center.x, center.y, center.z), positions }
}

impl Scene {
    fn replay(&self, object: &SignedDistance) -> ContactTrace {
        let Station { robot, layout, .. } = &self.station;
        contact_trace(robot, layout, object, &self.base_from_object.into(), &self.positions)
            .expect("valid path")
    }

    /// Prints what the times are to be divided by.
    fn print_counts(&self, name: &str, object: &SignedDistance) {
        let layout = &self.station.layout;
        let trace = self.replay(object);
        let nodes = |kind: SensorKind| -> usize {
            let of_kind = layout.patches.iter().filter(|patch| layout.streams[patch.stream].kind == kind);
            of_kind.map(|patch| patch.nodes.len()).sum()
        };
        let (mut entries_total, mut frames_touched, mut near) = (0, 0, 0);
        for patch in &trace.patches {
            match &**patch {
                PatchTrace::Pressure { offsets, entries } => {
                    entries_total += entries.len();
                    frames_touched += offsets.windows(2).filter(|pair| pair[1] > pair[0]).count();
                }
                PatchTrace::Proximity { min_distance_m, .. } => {
                    near += min_distance_m.iter().filter(|&&distance| distance < NEAR_M).count();
                }
            }
        }
        println!(
            "{name}: {NUM_FRAMES} frames, {} pressure and {} proximity nodes in {} patches, {} links; \
             {entries_total} touched nodes in {frames_touched} touched patch frames, {near} near patch frames",
            nodes(SensorKind::Pressure),
            nodes(SensorKind::Proximity),
            layout.patches.len(),
            self.station.robot.links.len(),
        );
    }
}

/// Runs work on a fixed number of threads.
struct Threads {
    count: usize,
    #[cfg(feature = "batch")]
    pool: rayon::ThreadPool,
}

impl Threads {
    #[cfg(feature = "batch")]
    fn all() -> Vec<Self> {
        let pool = |count| rayon::ThreadPoolBuilder::new().num_threads(count).build().expect("threads");
        [1, 2].map(|count| Self { count, pool: pool(count) }).into()
    }

    #[cfg(not(feature = "batch"))]
    fn all() -> Vec<Self> {
        vec![Self { count: 1 }]
    }

    #[cfg(feature = "batch")]
    fn run<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        self.pool.install(work)
    }

    #[cfg(not(feature = "batch"))]
    fn run<T>(&self, work: impl FnOnce() -> T) -> T {
        work()
    }
}

fn bench(criterion: &mut Criterion) {
    let scene = scene(0.05);
    let object = |id: &str| {
        SignedDistance::new(&scene.station.objects[id].shape)
            .unwrap_or_else(|problem| panic!("{id}: {problem}"))
    };
    let objects =
        ["sphere_50mm", "cylinder_25x100mm", "corner_block_80mm", "wedge_80mm"].map(|id| (id, object(id)));
    let threads = Threads::all();

    let mut group = criterion.benchmark_group("replay");
    group.sample_size(10);
    for (id, object) in &objects {
        scene.print_counts(id, object);
        for threads in &threads {
            group.bench_function(format!("{id}/threads={}", threads.count), |bencher| {
                bencher.iter(|| threads.run(|| scene.replay(black_box(object))));
            });
        }
    }
    group.finish();

    // What a replay cannot do without: kinematics of every frame, and one distance per node that culling leaves.
    let mut group = criterion.benchmark_group("bound");
    group.sample_size(10);
    let robot = &scene.station.robot;
    group.bench_function("kinematics of every frame", |bencher| {
        let mut root_from_link = Vec::new();
        bencher.iter(|| {
            for positions in scene.positions.chunks(robot.num_dofs()) {
                robot.forward_kinematics(black_box(positions), &mut root_from_link);
                black_box(&root_from_link);
            }
        });
    });
    let points: Vec<Point3<f64>> = (0..1000)
        .map(|i| Point3::from(Vector3::new(0.04, 0.001 * f64::from(i % 10), 0.0001 * f64::from(i))))
        .collect();
    for (id, object) in &objects {
        group.bench_function(format!("1000 distances/{id}"), |bencher| {
            bencher.iter(|| {
                black_box(&points).iter().map(|point| object.distance_m(point)).fold(f64::INFINITY, f64::min)
            });
        });
    }
    group.finish();

    let mut group = criterion.benchmark_group("propagation per alpha");
    group.sample_size(20);
    let trace = scene.replay(&objects[0].1);
    for threads in &threads {
        group.bench_function(format!("threads={}", threads.count), |bencher| {
            bencher.iter(|| threads.run(|| raw_signals(&scene.station.layout, black_box(&trace), 250.0)));
        });
    }
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
