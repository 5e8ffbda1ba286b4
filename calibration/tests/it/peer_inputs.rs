//! The files for a peer in another language.

use std::fs;

use palpate_calibration::bench::{SweepBenchConfig, sweep, write_peer_inputs};

use crate::synthetic;

#[test]
fn peer_inputs_are_numpy_arrays_of_the_right_shape() {
    let layout = synthetic::layout(crate::SMALL);
    let takes = synthetic::takes(crate::SMALL, &layout, 3);
    let dir = tempfile::tempdir().expect("a temporary folder");
    write_peer_inputs(SweepBenchConfig::default(), &layout, &takes, dir.path()).expect("written");
    for (name, header, item_bytes) in [
        ("pressures_1", "{'descr': '<f8', 'fortran_order': False, 'shape': (720,25,), }", 720 * 25 * 8),
        ("node_distances_0", "{'descr': '<f8', 'fortran_order': False, 'shape': (3,25,), }", 3 * 25 * 8),
        ("real_pressure_0", "{'descr': '|b1', 'fortran_order': False, 'shape': (720,3,), }", 720 * 3),
        ("distances", "{'descr': '<f8', 'fortran_order': False, 'shape': (720,3,), }", 720 * 3 * 8),
        ("real_proximity", "{'descr': '|b1', 'fortran_order': False, 'shape': (720,3,), }", 720 * 3),
        ("alphas", "{'descr': '<f8', 'fortran_order': False, 'shape': (20,), }", 160),
    ] {
        let bytes = fs::read(dir.path().join(format!("{name}.npy"))).expect("written");
        assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
        let header_len = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        assert_eq!((10 + header_len) % 64, 0);
        let text = str::from_utf8(&bytes[10..10 + header_len]).expect("ASCII");
        assert_eq!(text.trim_end(), header);
        assert_eq!(bytes.len() - 10 - header_len, item_bytes);
    }
}

#[test]
fn bench_reports_an_exact_objective_no_worse_than_the_grids() {
    let layout = synthetic::layout(crate::SMALL);
    let takes = synthetic::takes(crate::SMALL, &layout, 3);
    let config = SweepBenchConfig { repeats: 1, ..SweepBenchConfig::default() };
    let report = sweep(config, &layout, &takes, &|| 0.0).expect("a sound session");
    assert!(report.exact_refined_l1 <= report.exact_l1 && report.exact_l1 <= report.grid_l1, "{report:?}");
    assert_eq!((report.frames, report.channels, report.grid_points), (720, 9, 8000));
}
