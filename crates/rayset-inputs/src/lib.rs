//! From what a person has to a scene: opens any input, building what has not been built into a
//! cache, and chooses what it looks like. The program and the Python package are front ends over
//! this.
//!
//! [`open()`] takes scenes, built clouds and grids, and files of points or voxels of any kind,
//! folders and patterns among them. [`look`] makes a scene of a cloud or a grid by what is in it.

mod aggregates;
mod cache;
mod choices;
mod columns;
mod files;
mod host;
mod kinds;
mod left_out;
pub mod look;
mod magnitude;
mod open;
mod pixels;
mod sources;
mod speed;
pub mod style;
mod temporary;
pub mod text;
pub mod units;
pub mod values;

pub use self::aggregates::{Aggregating, aggregate};
pub use self::cache::{Cache, fingerprint};
pub use self::choices::BuildChoices;
pub use self::columns::{
    Columns, customary as customary_columns, of_all as all_columns, remark_on_normals,
    wanted as wanted_columns,
};
pub use self::files::{Files, expand};
pub use self::host::{Host, Resources, TemporaryFolder, stage_name};
pub use self::kinds::{Built, is_built, is_scene, open_built};
pub use self::left_out::LeftOut;
pub use self::open::{Input, Opened, open};
pub use self::pixels::Pixels;
pub use self::sources::{Points, has_volume, open_points, remark_about};
pub use self::speed::with_speeds;
pub use self::temporary::OwnFolder;
