//! A URDF as [`crate::Robot::from_urdf`] reads it, made from one with meshes.
//!
//! Robots are drawn and touched as primitives, so a mesh becomes the box around its vertices. A text that needs nothing of
//! this stays as it is, comments included.

use urdf_rs::{Collision, Geometry, Pose, Vec3, Visual};

use crate::{ModelError, object::mesh};

/// Thinnest box that a flat mesh becomes, m.
const MIN_THICKNESS_M: f64 = 1e-4;

/// A URDF without meshes, and what was done for it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SimplifiedUrdf {
    /// The text.
    pub text: String,
    /// What differs from the original, a sentence each.
    pub changes: Vec<String>,
    /// What may be wrong with the result, a sentence each: `link "palm": ...`.
    pub warnings: Vec<String>,
}

/// Replaces every mesh of `text` by the box around it. `file` names the text in errors. `read_mesh` turns the name of a mesh
/// into the bytes of an STL or OBJ file, or says why it cannot.
///
/// A mesh that cannot be read is left out with a warning. A link that loses all visual shapes in this way shows its collision
/// shapes. Refused: what is no URDF, such as a xacro file that was not expanded.
pub fn simplify_urdf(
    file: &str,
    text: &str,
    mut read_mesh: impl FnMut(&str) -> Result<Vec<u8>, String>,
) -> Result<SimplifiedUrdf, ModelError> {
    if text.contains("<xacro:") {
        let problem = "is a xacro file, expected a URDF; expand it first: `xacro FILE.xacro > FILE.urdf`";
        return Err(ModelError::new(file, "XML", problem));
    }
    let mut urdf = urdf_rs::read_from_string(text).map_err(|err| {
        let problem = format!("not a URDF: {err}; expected <robot> with <link> and <joint> elements");
        ModelError::new(file, "XML", problem)
    })?;
    let is_mesh = |geometry: &Geometry| matches!(geometry, Geometry::Mesh { .. });
    let has_mesh = urdf.links.iter().any(|link| {
        link.visual.iter().any(|visual| is_mesh(&visual.geometry))
            || link.collision.iter().any(|collision| is_mesh(&collision.geometry))
    });
    let (mut changes, mut warnings) = (Vec::new(), Vec::new());
    if !has_mesh {
        return Ok(SimplifiedUrdf { text: text.to_owned(), changes, warnings });
    }
    for link in &mut urdf.links {
        let mut boxed = 0;
        // The same mesh is often both the visual and the collision shape: one warning is enough.
        let mut unread: Vec<(String, String)> = Vec::new();
        let mut replace = |geometry: &mut Geometry, origin: &mut Pose| -> bool {
            let Geometry::Mesh { filename, scale } = geometry else { return true };
            let scale = scale.map_or([1.0; 3], |scale| scale.0);
            match read_mesh(filename).and_then(|bytes| bounds(filename, &bytes, scale)) {
                Ok([min, max]) => {
                    *origin = shifted(origin, [0, 1, 2].map(|axis| f64::midpoint(min[axis], max[axis])));
                    *geometry = Geometry::Box {
                        size: Vec3([0, 1, 2].map(|axis| (max[axis] - min[axis]).max(MIN_THICKNESS_M))),
                    };
                    boxed += 1;
                    true
                }
                Err(problem) => {
                    if unread.iter().all(|(name, _)| name != filename) {
                        unread.push((filename.clone(), problem));
                    }
                    false
                }
            }
        };
        let had_visuals = !link.visual.is_empty();
        link.visual.retain_mut(|visual| replace(&mut visual.geometry, &mut visual.origin));
        link.collision.retain_mut(|collision| replace(&mut collision.geometry, &mut collision.origin));
        if had_visuals && link.visual.is_empty() {
            let shown = |Collision { name, origin, geometry }: &Collision| Visual {
                name: name.clone(),
                origin: origin.clone(),
                geometry: geometry.clone(),
                material: None,
            };
            link.visual = link.collision.iter().map(shown).collect();
        }
        if boxed > 0 {
            let meshes = if boxed == 1 { "1 mesh is" } else { &format!("{boxed} meshes are") };
            changes.push(format!(
                "link {:?}: {meshes} replaced by the box around {}",
                link.name,
                if boxed == 1 { "it" } else { "each" }
            ));
        }
        for (name, problem) in unread {
            warnings.push(format!("link {:?}: mesh {name:?} is left out: {problem}", link.name));
        }
    }
    let body = urdf_rs::write_to_string(&urdf)
        .map_err(|err| ModelError::new(file, "XML", format!("failed to write it again: {err}")))?;
    Ok(SimplifiedUrdf { text: without_zeros(&body), changes, warnings })
}

/// `text`, as urdf-rs writes it, without what it writes for masses and limits that there are none of.
fn without_zeros(text: &str) -> String {
    const MASS: &str = "    <inertial>\n      <origin xyz=\"0 0 0\" rpy=\"0 0 0\"/>\n      <mass value=\"0\"/>\n      \
                        <inertia ixx=\"0\" ixy=\"0\" ixz=\"0\" iyy=\"0\" iyz=\"0\" izz=\"0\"/>\n    </inertial>\n";
    const LIMIT: &str = "    <limit lower=\"0\" upper=\"0\" effort=\"0\" velocity=\"0\"/>\n";
    let mut text = text.replace(MASS, "").replace(LIMIT, "");
    text.push('\n');
    text
}

/// Lowest and highest coordinates of a mesh's vertices.
fn bounds(name: &str, bytes: &[u8], scale: [f64; 3]) -> Result<[[f64; 3]; 2], String> {
    let vertices = mesh::vertices(name, bytes)?;
    let (mut min, mut max) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for vertex in &vertices {
        for axis in 0..3 {
            let value = vertex[axis] * scale[axis];
            if !value.is_finite() {
                return Err(format!("has a vertex at {vertex:?}, expected finite numbers"));
            }
            (min[axis], max[axis]) = (min[axis].min(value), max[axis].max(value));
        }
    }
    if vertices.is_empty() { Err("has no vertices".to_owned()) } else { Ok([min, max]) }
}

/// `origin`, moved by `by` along its own axes.
fn shifted(origin: &Pose, by: [f64; 3]) -> Pose {
    let [roll, pitch, yaw] = origin.rpy.0;
    let moved = nalgebra::Rotation3::from_euler_angles(roll, pitch, yaw) * nalgebra::Vector3::from(by);
    let xyz = [0, 1, 2].map(|axis| origin.xyz.0[axis] + moved[axis]);
    Pose { xyz: Vec3(xyz), rpy: origin.rpy }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{LinkShape, Robot};

    const TEXT: &str = r#"<robot name="r"><!-- kept only where nothing is replaced -->
        <link name="base">
          <visual><geometry><mesh filename="package://hand/base.dae"/></geometry></visual>
          <collision><origin xyz="1 0 0" rpy="0 0 1.5707963267948966"/>
            <geometry><mesh filename="base.obj" scale="0.001 0.001 0.002"/></geometry></collision>
        </link>
        <link name="tip"><visual><geometry><sphere radius="0.01"/></geometry></visual></link>
        <joint name="curl" type="revolute"><parent link="base"/><child link="tip"/><axis xyz="0 1 0"/>
          <limit lower="0" upper="1.25" velocity="3" effort="4"/></joint>
        <joint name="tilt" type="fixed"><parent link="tip"/><child link="nail"/></joint>
        <link name="nail"/>
      </robot>"#;
    const CORNERS: &str = "v 0 0 0\nv 40 0 0\nv 0 20 10\nf 1 2 3\n";

    #[test]
    fn meshes_become_boxes_and_everything_else_stays() {
        let read = |name: &str| match name {
            "base.obj" => Ok(CORNERS.as_bytes().to_vec()),
            _ => Err("no such file".to_owned()),
        };
        let simplified = simplify_urdf("r.urdf", TEXT, read).unwrap();
        assert_eq!(simplified.changes, ["link \"base\": 1 mesh is replaced by the box around it"]);
        assert_eq!(
            simplified.warnings,
            ["link \"base\": mesh \"package://hand/base.dae\" is left out: no such file"]
        );
        let robot = Robot::from_urdf("r.urdf", &simplified.text, &[]).unwrap();
        let base = &robot.links[0];
        for shapes in [&base.collisions, &base.visuals] {
            let [shape] = &shapes[..] else { panic!("one shape, also drawn: {shapes:?}") };
            assert_eq!(shape.shape, LinkShape::Box { size_m: [0.04, 0.02, 0.02] });
            // The middle of the mesh, (20, 10, 10) mm, a quarter turn on about z.
            let t = shape.link_from_shape.translation.vector;
            assert!((t - nalgebra::Vector3::new(0.99, 0.02, 0.01)).norm() < 1e-12, "{t}");
        }
        let curl = robot.dofs().next().unwrap();
        assert_eq!((curl.name.as_str(), curl.limits.unwrap().upper), ("curl", 1.25));
        assert!(!simplified.text.contains("inertial") && simplified.text.matches("<limit").count() == 1);
        assert_eq!(
            robot.links.iter().map(|link| link.name.as_str()).collect::<Vec<_>>(),
            ["base", "tip", "nail"]
        );
    }

    #[test]
    fn a_text_without_meshes_stays_as_it_is() {
        let text = r#"<robot name="r"><!-- mine --><link name="a"/></robot>"#;
        let simplified = simplify_urdf("r.urdf", text, |_| Err(String::new())).unwrap();
        assert_eq!(simplified.text, text);
        assert!(simplified.changes.is_empty() && simplified.warnings.is_empty());
    }

    #[test]
    fn xacro_and_other_texts_are_refused() {
        let refusal =
            |text: &str| simplify_urdf("r.urdf", text, |_| Err(String::new())).unwrap_err().to_string();
        assert!(refusal("<robot><xacro:include filename='a'/></robot>").contains("expand it first"));
        assert!(refusal("hand: 1").contains("not a URDF"));
    }

    #[test]
    fn broken_meshes_are_left_out() {
        for bytes in [&b""[..], b"v 1 2\nf 1 2 3", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"] {
            let simplified = simplify_urdf("r.urdf", TEXT, |_| Ok(bytes.to_vec())).unwrap();
            assert_eq!(simplified.warnings.len(), 2, "{:?}", simplified.warnings);
            assert!(Robot::from_urdf("r.urdf", &simplified.text, &[]).is_ok());
        }
    }
}
