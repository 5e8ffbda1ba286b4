//! Meshes of objects, OBJ and STL. The first byte says which.
#![no_main]

use libfuzzer_sys::fuzz_target;
use palpate_robot_model::ObjectModel;

fuzz_target!(|bytes: &[u8]| {
    let Some((&which, mesh)) = bytes.split_first() else { return };
    let extension = if which % 2 == 0 { "obj" } else { "stl" };
    let text =
        format!("id = 'thing'\nlabel = 'Thing'\nshape = {{ kind = 'mesh', file = 'thing.{extension}' }}");
    let _ = ObjectModel::from_toml("thing.toml", &text, |_| Ok(mesh.to_vec()));
});
