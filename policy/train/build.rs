//! Lets the binary find the library that it was linked with.

fn main() {
    println!("cargo::rerun-if-env-changed=MUJOCO_DYNAMIC_LINK_DIR");
    let with_mujoco = std::env::var_os("CARGO_FEATURE_MUJOCO").is_some();
    if let (true, Ok(dir)) = (with_mujoco, std::env::var("MUJOCO_DYNAMIC_LINK_DIR")) {
        println!("cargo::rustc-link-arg=-Wl,-rpath,{dir}");
    }
}
