//! Procedural fields, given in closed form, as volume objects in the world.
//!
//! Where a ray is in a field is found once a packet. Its samples there are evaluated eight at a
//! time, front to back: a ray that ends needs none of the samples behind its end. Solids are
//! evaluated in vectors (`solid`, `solid_rows`), other fields as they implement it.

mod solid;
mod solid_rows;
mod volume;

pub(super) use self::volume::{ProceduralMarch, ProceduralRequest, ProceduralVolume};
