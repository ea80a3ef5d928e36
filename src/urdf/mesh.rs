//! Triangles of a URDF's meshes.

use nalgebra::Vector3;
use plumbline_core::BadInput;
use std::path::{Path, PathBuf};

/// Where the packages of `package://NAME/...` lie.
pub struct Packages {
    /// Folder of the URDF.
    pub urdf: PathBuf,
    /// Folders to look into besides: each holds packages, or is one.
    pub more: Vec<PathBuf>,
}

impl Packages {
    /// The file that a URDF's `filename` names; `None` where it is not at hand.
    ///
    /// `package://NAME/REST` is looked for as NAME/REST in every given folder and every parent folder of the URDF, and as REST in those that
    /// are called NAME or hold it. Other names are relative to the URDF.
    pub fn find(&self, filename: &str) -> Option<PathBuf> {
        let plain = filename.strip_prefix("file://").unwrap_or(filename);
        let Some(rest) = filename.strip_prefix("package://").or_else(|| filename.strip_prefix("model://")) else {
            let path = self.urdf.join(plain);
            return path.is_file().then_some(path);
        };
        let inside = rest.split_once('/').map_or(rest, |(_, inside)| inside);
        let folders = self.more.iter().map(PathBuf::as_path).chain(self.urdf.ancestors());
        folders.flat_map(|folder| [folder.join(rest), folder.join(inside)]).find(|path| path.is_file())
    }
}

/// Triangles of an STL, OBJ or COLLADA file in its own axes \[m, as the file has it\].
pub fn triangles(path: &Path) -> Result<Vec<[Vector3<f64>; 3]>, BadInput> {
    let unreadable = |error: &dyn std::fmt::Display| {
        BadInput::new(path.display().to_string(), "mesh", error, "a readable STL, OBJ or COLLADA (.dae) file")
    };
    let scene = mesh_loader::Loader::default().load(path).map_err(|error| unreadable(&error))?;
    let mut found = Vec::new();
    for mesh in &scene.meshes {
        for face in &mesh.faces {
            let corner =
                |k: u32| mesh.vertices.get(k as usize).map(|v| Vector3::new(v[0].into(), v[1].into(), v[2].into()));
            let [Some(a), Some(b), Some(c)] = face.map(corner) else {
                return Err(unreadable(&"a face names a vertex that is not there"));
            };
            if [a, b, c].iter().any(|v| v.iter().any(|x: &f64| !x.is_finite())) {
                return Err(unreadable(&"a vertex is not finite"));
            }
            found.push([a, b, c]);
        }
    }
    if found.is_empty() {
        return Err(unreadable(&"no triangle"));
    }
    Ok(found)
}
