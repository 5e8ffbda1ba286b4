//! One session of a null bar: calibrate, simulate with nothing missing, try every effect everywhere and fit the best. The
//! session is short; what a diagnosis of one of full length costs is in `BENCHMARKS.md`.

use std::hint::black_box;
use std::path::Path;

use criterion::{Criterion, criterion_group, criterion_main};
use palpate_diagnosis::{DiagnosisConfig, null_bar};
use palpate_sim::SensorModel;
use palpate_sim::job::{Cancel, NoProgress};
use palpate_truth::Stage;

fn null_session(c: &mut Criterion) {
    let truth = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets/truth/small.toml"));
    let stage = Stage::read(truth).expect("a shipped world");
    let takes = stage.record(&[], 1).expect("a session of the shipped plan");
    let nominal = SensorModel::from_toml("nominal", &stage.station().nominal_model_toml).expect("shipped");
    let config = DiagnosisConfig::default();
    c.bench_function("null session, three takes", |b| {
        b.iter(|| {
            let bar = null_bar(&config, &takes, &nominal, 1, &NoProgress, &Cancel::default());
            black_box(bar.expect("a session that can be diagnosed"))
        });
    });
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10);
    targets = null_session
}
criterion_main!(benches);
