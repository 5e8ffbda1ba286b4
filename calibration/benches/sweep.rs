//! Both searches on a session of the paper's size: 5,670 frames, 784 fingertip nodes, 44 channels.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use palpate_calibration::sweep::{FitData, GridAxes, Watch, alpha_axis, exact, grid};
use palpate_sim::job::{Cancel, NoProgress};

#[path = "../tests/it/synthetic.rs"]
mod synthetic;

fn sweeps(c: &mut Criterion) {
    let size = synthetic::Size::PAPER;
    let layout = synthetic::layout(size);
    let takes = synthetic::takes(size, &layout, 1);
    let data = FitData::new(&layout, &takes);
    let alphas = alpha_axis(&layout, 20);
    let cancel = Cancel::default();
    let watch = Watch { progress: &NoProgress, cancel: &cancel, span: [0.0, 1.0] };
    c.bench_function("exact, 20 alphas", |b| {
        b.iter(|| black_box(exact(&data, &alphas, 0, watch)));
    });
    c.bench_function("one alpha: propagate, sort, scan", |b| {
        b.iter(|| black_box(data.pressure(alphas[10]).best()));
    });
    let axes = GridAxes::from_data(&data, alphas.clone(), 20);
    c.bench_function("grid, 20 x 20 x 20", |b| {
        b.iter(|| black_box(grid(&data, axes.clone(), watch)));
    });
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20);
    targets = sweeps
}
criterion_main!(benches);
