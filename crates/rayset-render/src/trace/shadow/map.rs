//! The rays of a light: lattices over everything it may light, from fine to coarse.

use crate::field::{Eye, Sight};
use crate::scene::{Light, LightKind};
use rayset_base::geometry::{Aabb, DVec3, Ray};

/// Cells along a side of a tile; the tile's rays pass through the corners of the cells.
pub(super) const TILE_CELLS: u32 = 7;

/// Fewest cells along a side of a face in a level besides the finest.
const FEWEST_CELLS: u32 = 2 * TILE_CELLS;
/// A sample's pixel is at least so many cells of its level wide, or the level is the finest.
const CELLS_OF_A_PIXEL: f64 = 8.0;

/// Rays of a light, through the corners of square cells.
#[derive(Clone, Debug)]
pub(super) struct LightMap {
    faces: Vec<Face>,
    /// The finest first.
    levels: Vec<Level>,
}

/// A lattice of cells over each face.
#[derive(Clone, Copy, Debug)]
struct Level {
    /// Cells along a side of a face; about half as many as in the level before.
    resolution: u32,
    /// Number of its first tile.
    first_tile: u32,
}

impl Level {
    /// Tiles along a side of a face.
    fn side(self) -> u32 {
        self.resolution.div_ceil(TILE_CELLS)
    }
}

/// A square of cells, and the origin of their rays.
#[derive(Clone, Copy, Debug)]
struct Face {
    /// Position of the light, or the centre of the plane from which parallel rays start.
    origin: DVec3,
    forward: DVec3,
    right: DVec3,
    up: DVec3,
    /// Half the side of the square: on the plane at distance 1 for a point light, in world units
    /// for parallel rays.
    half: f64,
    diverges: bool,
    /// Of parallel rays: for each coordinate in cells, columns and rows, the vector to multiply a
    /// position by and what to add; then the distance along the rays likewise.
    parallel: [(DVec3, f64); 3],
}

/// A position projected onto a light's map.
#[derive(Clone, Copy, Debug)]
pub(super) struct Texel {
    pub(super) tile: u32,
    /// Cell within the tile.
    pub(super) cell: (u32, u32),
    /// Position within the cell, 0 to 1.
    pub(super) within: (f64, f64),
    /// Distance along the ray.
    pub(super) distance: f64,
    /// Offset from one ray to the next at this distance, along rows and columns; world space.
    pub(super) next: (DVec3, DVec3),
}

impl LightMap {
    /// The map of a light over the bounds of a scene, with `resolution` cells along a side in its
    /// finest level; `None` if the scene is empty or the light has no rays.
    pub(super) fn new(light: &Light, bounds: &Aabb, resolution: u32) -> Option<Self> {
        if bounds.is_empty() {
            return None;
        }
        let (center, radius) = (bounds.center(), 0.5 * bounds.size().length());
        let faces = match light.kind {
            LightKind::Directional { direction } => {
                let forward = direction.normalize();
                let face = Face::toward(center - forward * (1.001 * radius), forward, 1.001 * radius, false);
                vec![face]
            }
            LightKind::Point { position, .. } => {
                let toward = center - position;
                let sine = radius / toward.length();
                // From well outside, one face covers the whole scene.
                if sine < 0.8 {
                    let tangent = sine / (1.0 - sine * sine).sqrt();
                    vec![Face::toward(position, toward.normalize(), 1.001 * tangent, true)]
                } else {
                    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
                    let all = axes.into_iter().flat_map(|axis| [axis, -axis]);
                    all.map(|forward| Face::toward(position, forward, 1.0, true)).collect()
                }
            }
            LightKind::Ambient | LightKind::Headlight => return None,
        };
        let mut faces = faces;
        faces.iter_mut().for_each(|face| face.count_cells(resolution));
        let mut levels = vec![Level { resolution, first_tile: 0 }];
        while let Some(&last) = levels.last()
            && last.resolution / 2 >= FEWEST_CELLS
        {
            let first_tile = last.first_tile + faces.len() as u32 * last.side() * last.side();
            levels.push(Level { resolution: last.resolution.div_ceil(2), first_tile });
        }
        Some(Self { faces, levels })
    }

    /// Number of tiles of all levels.
    pub(super) fn tiles(&self) -> u32 {
        self.levels.last().map_or(0, |l| l.first_tile + self.faces.len() as u32 * l.side() * l.side())
    }

    /// The number of the level that a tile is of, and of its face.
    fn level_and_face(&self, tile: u32) -> (usize, usize) {
        let number = self.levels.iter().rposition(|level| level.first_tile <= tile).unwrap_or(0);
        let level = &self.levels[number];
        (number, ((tile - level.first_tile) / (level.side() * level.side())) as usize)
    }

    /// How the rays of each face of each level see, of which cells are the pixels.
    pub(super) fn sights(&self) -> impl Iterator<Item = Sight> {
        self.levels.iter().flat_map(|level| self.faces.iter().map(|face| face.sight(level.resolution)))
    }

    /// The number of the sight of a tile.
    pub(super) fn sight_of(&self, tile: u32) -> usize {
        let (level, face) = self.level_and_face(tile);
        level * self.faces.len() + face
    }

    /// The rays of a tile, row by row. They start at the light, or at the plane of parallel rays.
    pub(super) fn rays(&self, tile: u32) -> Vec<Ray> {
        let (level, face) = self.level_and_face(tile);
        let (level, face) = (&self.levels[level], &self.faces[face]);
        let (side, corners, tile) = (level.side(), TILE_CELLS + 1, tile - level.first_tile);
        let (bx, by) = (tile % side, tile / side % side);
        let place = |b: u32, c: u32| f64::from(b * TILE_CELLS + c) / f64::from(level.resolution) * 2.0 - 1.0;
        (0..corners * corners).map(|i| face.ray(place(bx, i % corners), place(by, i / corners))).collect()
    }

    /// Projects a position, seen by a pixel of a given width there, world space; `None` if it is
    /// outside the map.
    #[inline(always)]
    pub(super) fn texel(&self, place: DVec3, pixel_width: f64) -> Option<Texel> {
        let resolution = f64::from(self.levels[0].resolution);
        let (mut number, mut found) = (0, None);
        while found.is_none() && number < self.faces.len() {
            found = self.faces[number].project(place, resolution);
            number += 1;
        }
        let (x, y, distance, depth) = found?;
        let face = &self.faces[number - 1];
        let finest = 2.0 * face.half / resolution * depth;
        let level = self.level(pixel_width / finest);
        let coarser = f64::from(level.resolution) / resolution;
        let (x, y, size) = (x * coarser, y * coarser, finest / coarser);
        let (column, row) = ((x as u32).min(level.resolution - 1), (y as u32).min(level.resolution - 1));
        let (side, tile) = (level.side(), level.first_tile);
        Some(Texel {
            tile: tile + ((number as u32 - 1) * side + row / TILE_CELLS) * side + column / TILE_CELLS,
            cell: (column % TILE_CELLS, row % TILE_CELLS),
            within: (x - f64::from(column), y - f64::from(row)),
            distance,
            next: (face.right * size, face.up * size),
        })
    }
}

impl LightMap {
    /// The level for a pixel that is so many cells of the finest level wide.
    #[inline(always)]
    fn level(&self, cells: f64) -> Level {
        // The exponent is the logarithm, rounded down; what is not a number has the finest level.
        let octaves = ((cells / CELLS_OF_A_PIXEL).max(1.0).to_bits() >> 52) as usize - 1023;
        self.levels[octaves.min(self.levels.len() - 1)]
    }
}

impl Texel {
    /// Edge length of a cell at this distance, world space.
    pub(super) fn size(&self) -> f64 {
        self.next.0.length()
    }
}

impl Face {
    fn toward(origin: DVec3, forward: DVec3, half: f64, diverges: bool) -> Self {
        let right = forward.any_orthonormal_vector();
        let parallel = [(DVec3::ZERO, 0.0); 3];
        Self { origin, forward, right, up: right.cross(forward), half, diverges, parallel }
    }

    fn sight(&self, resolution: u32) -> Sight {
        let pixel = 2.0 * self.half / f64::from(resolution);
        let corner_cosine =
            if self.diverges { (1.0 + 2.0 * self.half * self.half).sqrt().recip() } else { 1.0 };
        let eye = if self.diverges { Eye::At(self.origin) } else { Eye::Along(self.forward) };
        Sight { eye, forward: self.forward, pixel, corner_cosine, is_shown: false }
    }

    fn ray(&self, u: f64, v: f64) -> Ray {
        let across = (self.right * u + self.up * v) * self.half;
        if self.diverges {
            Ray { origin: self.origin, direction: (self.forward + across).normalize() }
        } else {
            Ray { origin: self.origin + across, direction: self.forward }
        }
    }

    /// Prepares the projection of positions onto a lattice of `resolution` cells a side.
    fn count_cells(&mut self, resolution: u32) {
        let half_side = 0.5 * f64::from(resolution);
        let along = |axis: DVec3| {
            let per_length = axis * (half_side / self.half);
            (per_length, half_side - self.origin.dot(per_length))
        };
        self.parallel = [along(self.right), along(self.up), (self.forward, -self.origin.dot(self.forward))];
    }

    /// Position on the face in cells, 0 to `resolution`, distance along the ray, and depth (1 for
    /// parallel rays); `None` if it is outside the face.
    #[inline(always)]
    fn project(&self, place: DVec3, resolution: f64) -> Option<(f64, f64, f64, f64)> {
        if !self.diverges {
            let [(right, left), (up, low), (forward, near)] = self.parallel;
            let (x, y, distance) = (place.dot(right) + left, place.dot(up) + low, place.dot(forward) + near);
            let inside = distance > 0.0 && x >= 0.0 && x <= resolution && y >= 0.0 && y <= resolution;
            return inside.then_some((x, y, distance, 1.0));
        }
        let offset = place - self.origin;
        let depth = offset.dot(self.forward);
        let per_half = 1.0 / (depth * self.half);
        let (u, v) = (offset.dot(self.right) * per_half, offset.dot(self.up) * per_half);
        let inside = depth > 0.0 && u.abs() <= 1.0 && v.abs() <= 1.0;
        let cells = |u: f64| (u + 1.0) * 0.5 * resolution;
        inside.then(|| (cells(u), cells(v), offset.length(), depth))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_place_is_between_the_rays_of_its_cell(
            place in prop::array::uniform3(-1.0_f64..1.0),
            light in prop::array::uniform3(-4.0_f64..4.0),
            parallel in any::<bool>(),
            pixel_width in prop_oneof![Just(0.0), 0.001_f64..1.0, Just(f64::NAN), Just(f64::INFINITY)],
        ) {
            let (place, light) = (DVec3::from_array(place), DVec3::from_array(light));
            prop_assume!(light.distance(place) > 0.1);
            let kind = if parallel {
                LightKind::Directional { direction: light }
            } else {
                LightKind::Point { position: light, decays: false }
            };
            let light = Light { kind, color: [1.0; 3], shadow: true };
            let map = LightMap::new(&light, &Aabb::new(DVec3::NEG_ONE, DVec3::ONE), 100).expect("it has rays");
            let texel = map.texel(place, pixel_width).expect("the map covers the scene");
            prop_assert!(texel.tile < map.tiles());
            let finest = map.texel(place, 0.0).expect("likewise");
            let (size, least) = (texel.size(), finest.size() * 0.999);
            prop_assert!(size >= least, "{size} < {least}");
            prop_assert!(pixel_width.is_nan() || size <= (0.126 * pixel_width).max(1.001 * finest.size()));
            let coarsest = size >= 3.9 * finest.size();
            prop_assert!(pixel_width.is_nan() || coarsest || size >= 0.06 * pixel_width, "{size}, {pixel_width}");
            let rays = map.rays(texel.tile);
            let sights: Vec<Sight> = map.sights().collect();
            let cell = sights[map.sight_of(texel.tile)].pixel_at(place);
            prop_assert!(cell <= 1.001 * texel.size() && cell >= 0.19 * texel.size(), "{cell}, {}", texel.size());
            let ray = |i: u32, j: u32| rays[((texel.cell.1 + j) * (TILE_CELLS + 1) + texel.cell.0 + i) as usize];
            for (i, j) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let away = ray(i, j).at(texel.distance).distance(place);
                prop_assert!(away <= 3.0 * texel.size(), "{away} of {}", texel.size());
            }
            let (u, v) = texel.within;
            let nearest = ray(u32::from(u > 0.5), u32::from(v > 0.5)).at(texel.distance).distance(place);
            prop_assert!(nearest <= 1.5 * texel.size(), "{nearest} of {}", texel.size());
        }
    }
}
