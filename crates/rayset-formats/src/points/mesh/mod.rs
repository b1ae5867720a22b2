//! Meshes: any number of points on their triangles, evenly by area.

mod obj;
mod obj_points;
mod obj_reader;
mod off;
mod ply;
mod sample;
mod stl;
mod triangles;

pub(super) use self::obj_points::ObjPointReader;
pub(super) use self::off::begins as begins_as_off;
pub(super) use self::sample::MeshFormat;
pub use self::sample::MeshSource;
