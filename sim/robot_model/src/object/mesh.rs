//! Triangle meshes from OBJ and STL files, welded and checked for an inside.

use std::{
    collections::{BTreeMap, HashMap},
    io::Cursor,
};

use nalgebra::Point3;

type Mesh = (Vec<Point3<f64>>, Vec<[u32; 3]>);
/// In the units of the file, not welded yet.
type RawMesh = (Vec<[f64; 3]>, Vec<[u32; 3]>);

/// Reads a mesh by the ending of its `path`. Equal vertices become one, triangles without area are dropped, and a mesh
/// that is inside out is turned, so that the result is closed and counter-clockwise from outside.
pub(super) fn read(path: &str, bytes: &[u8], scale: f64) -> Result<Mesh, String> {
    let (vertices, triangles) = raw(path, bytes)?;
    if let Some(index) = vertices.iter().position(|v| !v.iter().all(|x| x.is_finite())) {
        return Err(format!("vertex {index} is {:?}, expected finite numbers", vertices[index]));
    }
    let (vertices, mut triangles) = weld(&vertices, &triangles);
    if triangles.is_empty() {
        return Err("no triangles with an area, expected a closed surface".to_owned());
    }
    check_closed(&vertices, &triangles)?;
    if six_volumes(&vertices, &triangles) < 0.0 {
        for triangle in &mut triangles {
            triangle.swap(1, 2);
        }
    }
    Ok((vertices.iter().map(|v| Point3::from(*v) * scale).collect(), triangles))
}

/// The vertices of a mesh, in its file's units, by the ending of its `path`. They may be of a surface that is not closed.
pub(crate) fn vertices(path: &str, bytes: &[u8]) -> Result<Vec<[f64; 3]>, String> {
    Ok(raw(path, bytes)?.0)
}

fn raw(path: &str, bytes: &[u8]) -> Result<RawMesh, String> {
    let ending = path.rsplit('.').next().unwrap_or_default().to_ascii_lowercase();
    match ending.as_str() {
        "obj" => obj(bytes),
        "stl" => stl(bytes),
        _ => Err("expected a file that ends in .obj or .stl".to_owned()),
    }
}

fn obj(bytes: &[u8]) -> Result<RawMesh, String> {
    let options = tobj::LoadOptions {
        triangulate: true,
        ignore_points: true,
        ignore_lines: true,
        ..Default::default()
    };
    // Materials only colour the object; a missing .mtl is no reason to refuse its shape.
    let no_materials = |_: &std::path::Path| Ok((Vec::new(), Default::default()));
    let (models, _) = tobj::load_obj_buf(&mut Cursor::new(bytes), &options, no_materials)
        .map_err(|err| format!("failed to read OBJ: {err}"))?;
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for model in models {
        let first = u32::try_from(vertices.len()).map_err(|_| "too many vertices".to_owned())?;
        vertices.extend(model.mesh.positions.chunks_exact(3).map(|v| [v[0], v[1], v[2]]));
        triangles
            .extend(model.mesh.indices.chunks_exact(3).map(|t| [first + t[0], first + t[1], first + t[2]]));
    }
    Ok((vertices, triangles))
}

fn stl(bytes: &[u8]) -> Result<RawMesh, String> {
    let failed = |err| format!("failed to read STL: {err}");
    let mut file = Cursor::new(bytes);
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    // Triangle by triangle: the count in a binary header is not to be trusted with memory.
    for facet in stl_io::create_stl_reader(&mut file).map_err(failed)? {
        let facet = facet.map_err(failed)?;
        let first = u32::try_from(vertices.len()).map_err(|_| "too many vertices".to_owned())?;
        vertices.extend(facet.vertices.iter().map(|v| [0, 1, 2].map(|axis| f64::from(v[axis]))));
        triangles.push([first, first + 1, first + 2]);
    }
    Ok((vertices, triangles))
}

/// Merges vertices with equal coordinates and drops triangles and vertices that this leaves without use.
fn weld(vertices: &[[f64; 3]], triangles: &[[u32; 3]]) -> RawMesh {
    let mut welded = Vec::new();
    let mut index_of = HashMap::new();
    let mut weld_one = |index: u32| {
        let vertex = vertices[index as usize];
        // Adding zero makes one number of 0.0 and -0.0.
        *index_of.entry(vertex.map(|x| (x + 0.0).to_bits())).or_insert_with(|| {
            welded.push(vertex);
            welded.len() as u32 - 1
        })
    };
    let triangles = triangles
        .iter()
        .map(|triangle| triangle.map(&mut weld_one))
        .filter(|[a, b, c]| a != b && b != c && c != a)
        .collect();
    (welded, triangles)
}

/// A closed surface passes each of its edges once in each direction.
fn check_closed(vertices: &[[f64; 3]], triangles: &[[u32; 3]]) -> Result<(), String> {
    let mut balance: BTreeMap<(u32, u32), i64> = BTreeMap::new();
    for [a, b, c] in triangles {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            *balance.entry((*from.min(to), *from.max(to))).or_default() += if from < to { 1 } else { -1 };
        }
    }
    let open: Vec<_> = balance.iter().filter(|(_, passes)| **passes != 0).map(|(edge, _)| *edge).collect();
    match open.first() {
        None => Ok(()),
        Some(&(a, b)) => Err(format!(
            "{} of {} edges do not join two triangles of the same orientation, the first between {:?} and {:?}; \
             expected a closed surface: repair the mesh or describe the object by convex_parts",
            open.len(),
            balance.len(),
            vertices[a as usize],
            vertices[b as usize],
        )),
    }
}

/// Six times the signed volume, by the divergence theorem: the sum of the tetrahedra to the origin.
fn six_volumes(vertices: &[[f64; 3]], triangles: &[[u32; 3]]) -> f64 {
    let at = |index: u32| Point3::from(vertices[index as usize]).coords;
    triangles.iter().map(|&[a, b, c]| at(a).dot(&at(b).cross(&at(c)))).sum()
}

/// A ramp 40 x 20 x 10 mm, with quadrilaterals as a modeller would write it.
#[cfg(test)]
pub(super) const WEDGE_OBJ: &str = "mtllib wedge.mtl
o wedge
v 0 0 0
v 40 0 0
v 40 20 0
v 0 20 0
v 0 0 10
v 0 20 10
f 1 4 3 2
f 1 2 5
f 4 6 3
f 2 3 6 5
f 1 5 6 4
";

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The wedge as STL, each triangle with its own corners, as the format has it.
    fn ascii_stl((vertices, triangles): &Mesh) -> String {
        let mut text = "solid wedge\n".to_owned();
        for triangle in triangles {
            text += "facet normal 0 0 0\nouter loop\n";
            for &index in triangle {
                let v = vertices[index as usize];
                text += &format!("vertex {} {} {}\n", v.x, v.y, v.z);
            }
            text += "endloop\nendfacet\n";
        }
        text + "endsolid wedge\n"
    }

    #[test]
    fn obj_and_stl_give_the_same_closed_mesh_in_metres() {
        let obj = read("wedge.obj", WEDGE_OBJ.as_bytes(), 0.001).unwrap();
        assert_eq!(obj.0.len(), 6);
        assert_eq!(obj.1.len(), 8);
        let raw = read("wedge.obj", WEDGE_OBJ.as_bytes(), 1.0).unwrap();
        let stl = read("wedge.STL", ascii_stl(&raw).as_bytes(), 0.001).unwrap();
        assert_eq!((stl.0.len(), stl.1.len()), (6, 8));
        let volume = |(vertices, triangles): &Mesh| {
            let vertices: Vec<[f64; 3]> = vertices.iter().map(|v| [v.x, v.y, v.z]).collect();
            six_volumes(&vertices, triangles) / 6.0
        };
        // Half of a 40 x 20 x 10 mm block.
        assert!((volume(&obj) - 4e-6).abs() < 1e-12);
        assert!((volume(&stl) - 4e-6).abs() < 1e-12);
    }

    #[test]
    fn a_mesh_that_is_inside_out_is_turned() {
        let (vertices, mut triangles) = read("wedge.obj", WEDGE_OBJ.as_bytes(), 1.0).unwrap();
        triangles.iter_mut().for_each(|t| t.swap(0, 1));
        let turned = read("wedge.stl", ascii_stl(&(vertices, triangles)).as_bytes(), 1.0).unwrap();
        let corners: Vec<[f64; 3]> = turned.0.iter().map(|v| [v.x, v.y, v.z]).collect();
        assert!(six_volumes(&corners, &turned.1) > 0.0);
    }

    #[test]
    fn open_empty_garbled_and_non_finite_meshes_are_refused() {
        let open = WEDGE_OBJ.replace("f 1 2 5\n", "");
        assert!(read("open.obj", open.as_bytes(), 1.0).unwrap_err().contains("3 of 12 edges"));
        let flipped = WEDGE_OBJ.replace("f 1 2 5\n", "f 1 5 2\n");
        assert!(read("flipped.obj", flipped.as_bytes(), 1.0).unwrap_err().contains("closed surface"));
        assert!(read("empty.obj", b"", 1.0).unwrap_err().contains("no triangles"));
        assert!(read("empty.stl", b"", 1.0).unwrap_err().contains("failed to read STL"));
        assert!(read("garbled.stl", b"solid but not for long", 1.0).is_err());
        let nan = WEDGE_OBJ.replace("v 0 20 10", "v 0 nan 10");
        assert!(read("nan.obj", nan.as_bytes(), 1.0).is_err());
        assert!(read("wedge.ply", b"", 1.0).unwrap_err().contains(".obj or .stl"));
        let mut truncated = vec![0; 80];
        truncated.extend(u32::MAX.to_le_bytes());
        truncated.extend([0; 120]);
        assert!(read("truncated.stl", &truncated, 1.0).unwrap_err().contains("failed to read STL"));
        let beyond = WEDGE_OBJ.replace("f 4 6 3", "f 4 60 3");
        assert!(read("beyond.obj", beyond.as_bytes(), 1.0).is_err());
    }

    proptest! {
        #[test]
        fn no_bytes_make_the_readers_panic(bytes in prop::collection::vec(any::<u8>(), 0..400), text in "[vf0-9 ./\\n-]{0,200}") {
            for ending in ["obj", "stl"] {
                let _ = read(&format!("noise.{ending}"), &bytes, 1.0);
                let _ = read(&format!("noise.{ending}"), text.as_bytes(), 1.0);
            }
            let mut solid = b"solid x\n".to_vec();
            solid.extend(&bytes);
            let _ = read("noise.stl", &solid, 1.0);
        }

        #[test]
        fn a_spoilt_byte_never_makes_the_reader_panic(at in 0..WEDGE_OBJ.len(), byte in 32..127_u8) {
            let mut bytes = WEDGE_OBJ.as_bytes().to_vec();
            bytes[at] = byte;
            if let Ok((vertices, triangles)) = read("wedge.obj", &bytes, 1.0) {
                prop_assert!(vertices.iter().all(|v| v.coords.iter().all(|x| x.is_finite())));
                prop_assert!(triangles.iter().flatten().all(|&index| (index as usize) < vertices.len()));
            }
        }
    }
}
