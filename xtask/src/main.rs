//! Set-up, build, run, test: what the README and CI call.

fn main() {}
