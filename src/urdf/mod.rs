//! An arm from a URDF: chain, limits, bodies and volumes in plumbline's own frames.
//!
//! | file | what |
//! |---|---|
//! | `document` | links and joints of the document |
//! | `arm` | the serial arm in it: path, axes, limits, bodies |
//! | `volumes`, `mesh` | capsules around its collision geometry |
//! | `robot_file` | the robot file of it |

mod arm;
mod document;
mod mesh;
mod robot_file;
mod volumes;

pub use arm::{Arm, Choice};
pub use document::{Joint, Urdf, declared, parse, read};
pub use mesh::Packages;
pub use robot_file::robot_file;
pub use volumes::volumes;
