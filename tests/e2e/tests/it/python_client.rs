//! The Python client's own tests, on the `palpate` of this checkout and its emulated station.

use std::env::consts::{DLL_PREFIX, DLL_SUFFIX};
use std::path::PathBuf;
use std::process::Command;

use e2e::{Tools, alone, root};

/// The library of `palpate.touch`, which cargo builds beside the tests.
fn touch_library() -> PathBuf {
    let name = format!("{DLL_PREFIX}palpate_touch{DLL_SUFFIX}");
    std::env::current_exe().expect("the path of this test").with_file_name(name)
}

/// Sessions, runs, live frames, control and the viewer, beside what needs no studio: types, style, decoding.
#[test]
fn python_client_passes_its_tests() {
    let Some(tools) = Tools::find() else { return };
    // Its scripts hold a station that runs in real time.
    let _turn = alone();
    let status = Command::new(&tools.python)
        .args(["-m", "pytest", "-p", "no:cacheprovider"])
        .current_dir(root().join("clients/python"))
        .env("PALPATE_BIN", &tools.palpate)
        .env("PALPATE_BROWSER_TESTS", &tools.browser_tests)
        .env("PALPATE_TOUCH_LIBRARY", touch_library())
        .env("PALPATE_ARTIFACTS", &tools.artifacts)
        .status()
        .expect("the Python of the tests");
    assert!(status.success(), "the Python client's tests failed: {status}; their output is above");
}
