//! The bytes of a take, from a disk that may have lied. Start from the takes in `tests/fixtures`.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use palpate_recording::Take;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(take) = Take::from_bytes(Path::new("take.mcap"), bytes) {
        // What was accepted can be used without looking.
        let num_cells = take.num_frames() * take.station.layout.num_channels();
        assert_eq!(take.active_at_frames().len(), num_cells);
    }
});
