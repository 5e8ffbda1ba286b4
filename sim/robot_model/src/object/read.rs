//! Object files.

use nalgebra::Point3;
use serde::Deserialize;
use toml::Spanned;

use super::{
    ObjectGroup, ObjectModel, ObjectShape, mesh,
    revolved::{self, RevolvedConfig},
};
use crate::{
    ModelError, PoseConfig,
    config::{Source, check_id, positive},
};

impl ObjectModel {
    /// Reads an object file. `read_mesh` gives the bytes of a mesh that the file names (OBJ or STL), or why it cannot.
    ///
    /// Refused, with line, object, part and reason: non-positive sizes, an open or empty mesh, a flat convex part,
    /// non-finite numbers, unknown keys, a group without a density.
    ///
    /// ```
    /// use palpate_robot_model::{ObjectModel, ObjectShape};
    ///
    /// let text = r#"
    ///     id = "mug"
    ///     label = "Mug, without its handle"
    ///     shape = { kind = "cylinder", radius_m = 0.04, height_m = 0.09 }
    /// "#;
    /// let mug = ObjectModel::from_toml("mug.toml", text, |path| Err(format!("no {path} here")))?;
    /// assert!(matches!(mug.shape, ObjectShape::Cylinder { height_m: 0.09, .. }));
    /// # Ok::<(), palpate_robot_model::ModelError>(())
    /// ```
    pub fn from_toml(
        file: &str,
        text: &str,
        mut read_mesh: impl FnMut(&str) -> Result<Vec<u8>, String>,
    ) -> Result<Self, ModelError> {
        let source = Source { file, text };
        let config: ObjectConfig = source.parse()?;
        check_id("id", &config.id).map_err(|problem| source.error_at("id", problem))?;
        let error = |span, problem| source.error(span, format!("object {:?}", config.id), problem);
        let group = config.group.as_ref().map(|group| *group.get_ref());
        let density_kg_m3 = match (&config.density_kg_m3, &config.group) {
            (Some(density), _) => Some(
                positive("density_kg_m3", *density.get_ref())
                    .map_err(|problem| error(density.span(), problem))?,
            ),
            (None, Some(group)) => {
                let problem = "density_kg_m3 is missing, and an object with a group is grasped, so its mass \
                    matters; add it, such as density_kg_m3 = 550.0";
                return Err(error(group.span(), problem.to_owned()));
            }
            (None, None) => None,
        };
        let span = config.shape.span();
        let shape =
            shape(config.shape.into_inner(), &mut read_mesh).map_err(|problem| error(span, problem))?;
        Ok(Self { id: config.id, label: config.label, group, density_kg_m3, shape })
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ObjectConfig {
    id: String,
    label: String,
    group: Option<Spanned<ObjectGroup>>,
    density_kg_m3: Option<Spanned<f64>>,
    shape: Spanned<ShapeConfig>,
}

#[derive(Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
enum ShapeConfig {
    Sphere {
        radius_m: f64,
    },
    Cylinder {
        radius_m: f64,
        height_m: f64,
    },
    Capsule {
        radius_m: f64,
        length_m: f64,
    },
    Box {
        size_m: [f64; 3],
    },
    ConvexParts {
        parts_m: Vec<Vec<[f64; 3]>>,
    },
    Revolved(RevolvedConfig),
    Mesh {
        file: String,
        /// Metres in one unit of the mesh file: 0.001 for the usual STL in millimetres.
        #[serde(default = "one")]
        scale: f64,
    },
    Compound {
        /// Each is a [`PartConfig`], read by itself so that a complaint can say which.
        parts: Vec<toml::Table>,
    },
}

fn one() -> f64 {
    1.0
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PartConfig {
    #[serde(default)]
    pose: PoseConfig,
    shape: ShapeConfig,
}

fn shape(
    config: ShapeConfig,
    read_mesh: &mut impl FnMut(&str) -> Result<Vec<u8>, String>,
) -> Result<ObjectShape, String> {
    Ok(match config {
        ShapeConfig::Sphere { radius_m } => ObjectShape::Sphere { radius_m: positive("radius_m", radius_m)? },
        ShapeConfig::Cylinder { radius_m, height_m } => ObjectShape::Cylinder {
            radius_m: positive("radius_m", radius_m)?,
            height_m: positive("height_m", height_m)?,
        },
        ShapeConfig::Capsule { radius_m, length_m } => ObjectShape::Capsule {
            radius_m: positive("radius_m", radius_m)?,
            length_m: positive("length_m", length_m)?,
        },
        ShapeConfig::Box { size_m } => {
            for edge_m in size_m {
                positive("an edge in size_m", edge_m)?;
            }
            ObjectShape::Box { size_m }
        }
        ShapeConfig::ConvexParts { parts_m } => {
            if parts_m.is_empty() {
                return Err("parts_m is empty, expected at least one part".to_owned());
            }
            let mut parts = Vec::with_capacity(parts_m.len());
            for (part_idx, part) in parts_m.into_iter().enumerate() {
                let part: Vec<Point3<f64>> = part.into_iter().map(Point3::from).collect();
                check_convex_part(&part)
                    .map_err(|problem| format!("part {part_idx} of parts_m {problem}"))?;
                parts.push(part);
            }
            ObjectShape::ConvexParts { parts }
        }
        ShapeConfig::Revolved(config) => {
            let parts = revolved::convex_parts(&config)?;
            for part in &parts {
                check_convex_part(part).map_err(|problem| format!("the solid of profile_m {problem}"))?;
            }
            ObjectShape::ConvexParts { parts }
        }
        ShapeConfig::Mesh { file, scale } => {
            let scale = positive("scale", scale)?;
            let bytes =
                read_mesh(&file).map_err(|problem| format!("failed to read mesh {file:?}: {problem}"))?;
            let (vertices, triangles) =
                mesh::read(&file, &bytes, scale).map_err(|problem| format!("mesh {file:?}: {problem}"))?;
            ObjectShape::Mesh { vertices, triangles }
        }
        ShapeConfig::Compound { parts } => {
            if parts.is_empty() {
                return Err("parts is empty, expected at least one part".to_owned());
            }
            let mut posed = Vec::with_capacity(parts.len());
            for (part_idx, part) in parts.into_iter().enumerate() {
                let in_part = |problem: String| format!("part {part_idx}: {problem}");
                let part: PartConfig = part.try_into().map_err(|err| in_part(err.message().to_owned()))?;
                posed.push((
                    part.pose.to_isometry().map_err(in_part)?,
                    shape(part.shape, read_mesh).map_err(in_part)?,
                ));
            }
            ObjectShape::Compound { parts: posed }
        }
    })
}

/// A convex hull needs an inside: four finite points that do not share a plane.
fn check_convex_part(points: &[Point3<f64>]) -> Result<(), String> {
    if let Some(bad) = points.iter().find(|point| !point.coords.iter().all(|v| v.is_finite())) {
        return Err(format!("has the point {bad:?}, expected finite numbers"));
    }
    let (Some(first), 4..) = (points.first(), points.len()) else {
        return Err(format!(
            "has {} points, expected at least four that do not lie in one plane",
            points.len()
        ));
    };
    let offsets = || points.iter().map(|point| point - first);
    let along = offsets().max_by(|a, b| a.norm().total_cmp(&b.norm())).unwrap_or_default();
    let size_m = along.norm();
    let across = offsets()
        .map(|offset| along.cross(&offset))
        .max_by(|a, b| a.norm().total_cmp(&b.norm()))
        .unwrap_or_default();
    let volume_m3 = offsets().map(|offset| across.dot(&offset).abs()).fold(0.0, f64::max);
    // `across` scales with size^2 and `volume` with size^4, so the comparison does not depend on the unit.
    if volume_m3 <= 1e-9 * size_m.powi(4) {
        return Err("is flat, expected at least four points that do not lie in one plane".to_owned());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(shape: &str) -> Result<ObjectModel, ModelError> {
        let text = format!("id = \"thing\"\nlabel = \"Thing\"\nshape = {shape}\n");
        ObjectModel::from_toml("thing.toml", &text, |path| match path {
            "wedge.obj" => Ok(mesh::WEDGE_OBJ.as_bytes().to_vec()),
            other => Err(format!("no such file {other:?}")),
        })
    }

    #[test]
    fn every_kind_of_shape_is_read() {
        let sphere = read("{ kind = \"sphere\", radius_m = 0.05 }").unwrap();
        assert!(matches!(sphere.shape, ObjectShape::Sphere { radius_m: 0.05 }));
        let capsule = read("{ kind = \"capsule\", radius_m = 0.01, length_m = 0.04 }").unwrap();
        assert!(matches!(capsule.shape, ObjectShape::Capsule { radius_m: 0.01, length_m: 0.04 }));
        let cone = read("{ kind = \"revolved\", profile_m = [[0, 0], [0.02, 0], [0, 0.05]], segments = 12 }")
            .unwrap();
        assert!(matches!(cone.shape, ObjectShape::ConvexParts { parts } if parts.len() == 1));
        let block = read("{ kind = \"box\", size_m = [0.1, 0.2, 0.3] }").unwrap();
        assert!(matches!(block.shape, ObjectShape::Box { size_m: [0.1, 0.2, 0.3] }));
        let parts =
            read("{ kind = \"convex_parts\", parts_m = [[[0,0,0], [1,0,0], [0,1,0], [0,0,1]]] }").unwrap();
        assert!(matches!(parts.shape, ObjectShape::ConvexParts { parts } if parts[0].len() == 4));
        let mesh = read("{ kind = \"mesh\", file = \"wedge.obj\", scale = 0.001 }").unwrap();
        let ObjectShape::Mesh { vertices, triangles } = mesh.shape else { panic!("a mesh") };
        assert_eq!((vertices.len(), triangles.len()), (6, 8));
        let compound = read(
            "{ kind = \"compound\", parts = [{ shape = { kind = \"sphere\", radius_m = 1 } }, \
             { pose = { position_m = [0, 0, 1] }, shape = { kind = \"cylinder\", radius_m = 1, height_m = 2 } }] }",
        )
        .unwrap();
        let ObjectShape::Compound { parts } = compound.shape else { panic!("a compound") };
        assert_eq!(parts[1].0.translation.z, 1.0);
    }

    #[test]
    fn faults_name_line_and_object() {
        for (shape, expected) in [
            ("{ kind = \"sphere\", radius_m = 0.0 }", "radius_m is 0"),
            ("{ kind = \"sphere\", radius_m = nan }", "radius_m is NaN"),
            ("{ kind = \"cylinder\", radius_m = 0.1, height_m = -0.1 }", "height_m is -0.1"),
            ("{ kind = \"box\", size_m = [0.1, 0.0, 0.1] }", "an edge in size_m is 0"),
            ("{ kind = \"capsule\", radius_m = 0.1, length_m = inf }", "length_m is inf"),
            ("{ kind = \"convex_parts\", parts_m = [[[0,0,0], [1,0,0], [0,1,0]]] }", "has 3 points"),
            (
                "{ kind = \"compound\", parts = [{ shape = { kind = \"sphere\", radius_m = 1 } }, \
                 { shape = { kind = \"sphere\", radius_m = 1, hight_m = 1 } }] }",
                "part 1: unknown field `hight_m`",
            ),
            (
                "{ kind = \"compound\", parts = [{ shpe = { kind = \"sphere\", radius_m = 1 } }] }",
                "part 0: unknown field `shpe`",
            ),
            ("{ kind = \"torus\", radius_m = 1.0 }", "unknown variant `torus`"),
            ("{ kind = \"sphere\", radius_m = 1.0, height_m = 1.0 }", "unknown field `height_m`"),
            ("{ kind = \"convex_parts\", parts_m = [] }", "at least one part"),
            (
                "{ kind = \"convex_parts\", parts_m = [[[0,0,0], [1,0,0], [0,1,0], [1,1,0]]] }",
                "part 0 of parts_m is flat",
            ),
            (
                "{ kind = \"convex_parts\", parts_m = [[[0,0,0], [1,0,0], [0,1,0], [0,0,nan]]] }",
                "expected finite",
            ),
            ("{ kind = \"mesh\", file = \"other.stl\" }", "failed to read mesh \"other.stl\": no such file"),
            ("{ kind = \"mesh\", file = \"wedge.obj\", scale = 0 }", "scale is 0"),
            ("{ kind = \"compound\", parts = [] }", "at least one part"),
            (
                "{ kind = \"compound\", parts = [{ shape = { kind = \"sphere\", radius_m = -1 } }] }",
                "part 0: radius_m is -1",
            ),
        ] {
            let error = read(shape).expect_err(shape).to_string();
            assert!(error.contains(expected), "{shape}: {error}");
            assert!(error.starts_with("thing.toml: line 3"), "{shape}: {error}");
        }
    }

    #[test]
    fn group_and_density_are_read_and_checked() {
        let read = |head: &str| {
            let text = format!(
                "id = \"thing\"\nlabel = \"Thing\"\n{head}shape = {{ kind = \"sphere\", radius_m = 1 }}\n"
            );
            ObjectModel::from_toml("thing.toml", &text, |_| Err("no mesh".to_owned()))
        };
        let plain = read("").unwrap();
        assert_eq!((plain.group, plain.density_kg_m3), (None, None));
        let seen = read("group = \"seen\"\ndensity_kg_m3 = 550\n").unwrap();
        assert_eq!((seen.group, seen.density_kg_m3), (Some(ObjectGroup::Seen), Some(550.0)));
        assert_eq!(seen.group.map(ObjectGroup::as_str), Some("seen"));
        for (head, expected) in [
            ("group = \"unseen\"\n", "density_kg_m3 is missing"),
            ("density_kg_m3 = -1.0\n", "density_kg_m3 is -1, expected a finite number above zero"),
            ("density_kg_m3 = nan\n", "density_kg_m3 is NaN"),
            (
                "group = \"known\"\ndensity_kg_m3 = 1.0\n",
                "unknown variant `known`, expected `seen` or `unseen`",
            ),
            ("densty_kg_m3 = 1.0\n", "unknown field `densty_kg_m3`"),
        ] {
            let error = read(head).expect_err(head).to_string();
            assert!(error.contains(expected), "{head}: {error}");
            assert!(error.starts_with("thing.toml: line 3"), "{head}: {error}");
        }
    }
}
