//! Compiles the .proto files without protoc, and keeps their descriptors for clients that ask what messages hold.

use std::{env, fs, path::Path};

use prost::Message as _;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo::rerun-if-changed=proto");
    let files = ["proto/palpate/control.proto", "proto/palpate/trace.proto"];
    let mut descriptors = protox::compile(files, ["proto"])?;
    prost_build::Config::new().compile_fds(descriptors.clone())?;
    // Comments and line numbers are of no use to a reader of messages, and larger than all the rest.
    for file in &mut descriptors.file {
        file.source_code_info = None;
    }
    let out_dir = env::var("OUT_DIR")?;
    fs::write(Path::new(&out_dir).join("descriptors.bin"), descriptors.encode_to_vec())?;
    Ok(())
}
