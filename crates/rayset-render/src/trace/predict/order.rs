//! The order in which a render visits its picture: tiles, and the squares of tiles that are looked
//! at together. A place is the index of a tile in this order.

use std::ops::Range;
use std::sync::Arc;

use crate::trace::work::{LOOKAHEAD_TILE_PIXELS, Region, Tile};

/// Edge of the squares that the picture is divided into, in pixels: a power of two, at most that of
/// look-ahead tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Edge(u32);

impl Default for Edge {
    fn default() -> Self {
        Self::MOST
    }
}

impl Edge {
    /// That of look-ahead tiles.
    pub(super) const MOST: Self = Self(LOOKAHEAD_TILE_PIXELS);
    /// That of tiles.
    const LEAST: Self = Self(8);

    /// Half the edge; `None` if squares would be smaller than tiles.
    pub(super) fn halved(self) -> Option<Self> {
        (self > Self::LEAST).then_some(Self(self.0 / 2))
    }

    /// Twice the edge, at most that of look-ahead tiles.
    pub(super) fn doubled(self) -> Self {
        Self(2 * self.0).min(Self::MOST)
    }
}

/// The tiles of a render, of which there is at least one.
pub(super) struct Order {
    tiles: Arc<[Tile]>,
    /// The region that they cover.
    region: Region,
    /// The first column and row of look-ahead tiles, and how many there are.
    first: (u32, u32),
    columns: u32,
    rows: u32,
    /// For each look-ahead tile, its last place, row by row.
    last: Vec<u32>,
}

impl Order {
    pub(super) fn new(tiles: Arc<[Tile]>) -> Self {
        let region = Region::around(&tiles);
        let edge = LOOKAHEAD_TILE_PIXELS;
        let first = (region.columns.start / edge, region.rows.start / edge);
        let columns = region.columns.end.div_ceil(edge) - first.0;
        let rows = region.rows.end.div_ceil(edge) - first.1;
        let mut last = vec![0; columns as usize * rows as usize];
        for (place, tile) in tiles.iter().enumerate() {
            let (column, row) = (tile.x / edge - first.0, tile.y / edge - first.1);
            last[(row * columns + column) as usize] = place as u32;
        }
        Self { tiles, region, first, columns, rows, last }
    }

    /// Number of tiles.
    pub(super) fn len(&self) -> u32 {
        self.tiles.len() as u32
    }

    fn square(&self, place: u32, Edge(edge): Edge) -> (u32, u32) {
        let tile = &self.tiles[place as usize];
        (tile.x / edge, tile.y / edge)
    }

    /// The places from one on that follow each other in one square.
    pub(super) fn rest_of_square(&self, place: u32, edge: Edge) -> Range<u32> {
        let square = self.square(place, edge);
        let end = (place..self.len()).find(|&other| self.square(other, edge) != square);
        place..end.unwrap_or(self.len())
    }

    /// The first of the places up to one that follow each other in one square.
    pub(super) fn begin_of_square(&self, place: u32, edge: Edge) -> u32 {
        let square = self.square(place, edge);
        let before = (0..place).rev().find(|&other| self.square(other, edge) != square);
        before.map_or(0, |other| other + 1)
    }

    /// The pixels of a place's square: columns and rows.
    pub(super) fn pixels_of_square(&self, place: u32, edge: Edge) -> Region {
        let (i, j) = self.square(place, edge);
        let Region { columns, rows } = &self.region;
        let within = |at: u32, all: &Range<u32>| {
            (at * edge.0).max(all.start)..(at.saturating_add(1)).saturating_mul(edge.0).min(all.end)
        };
        Region { columns: within(i, columns), rows: within(j, rows) }
    }

    /// The last place whose look-ahead tile overlaps a rectangle of pixels; the rectangle may reach
    /// beyond the picture.
    pub(super) fn last_place(&self, low: (f64, f64), high: (f64, f64)) -> u32 {
        let index = |v: f64, first: u32, count: u32| {
            (v / f64::from(LOOKAHEAD_TILE_PIXELS) - f64::from(first)).clamp(0.0, f64::from(count - 1)) as u32
        };
        let columns = index(low.0, self.first.0, self.columns)..=index(high.0, self.first.0, self.columns);
        let rows = index(low.1, self.first.1, self.rows)..=index(high.1, self.first.1, self.rows);
        let last = |row: u32, column: u32| self.last[(row * self.columns + column) as usize];
        rows.flat_map(|row| columns.clone().map(move |column| last(row, column))).max().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tiles of 8 × 8 pixels of a picture of 64 × 32, look-ahead tile by look-ahead tile, in each
    /// by quarters.
    fn order() -> Order {
        let mut tiles = Vec::new();
        for big in 0..2 {
            for at in 0..16 {
                let (i, j) = (at & 1 | at >> 1 & 2, at >> 1 & 1 | at >> 2 & 2);
                tiles.push(Tile { x: 32 * big + 8 * i, y: 8 * j, width: 8, height: 8 });
            }
        }
        Order::new(tiles.into())
    }

    #[test]
    fn squares_of_every_edge_are_runs_of_tiles() {
        let order = order();
        let quarter = Edge::MOST.halved().unwrap();
        let tile = quarter.halved().unwrap();
        assert_eq!(tile.halved(), None);
        assert_eq!((tile.doubled(), Edge::MOST.doubled()), (quarter, Edge::MOST));
        assert_eq!(order.rest_of_square(3, Edge::MOST), 3..16);
        assert_eq!(order.rest_of_square(5, quarter), 5..8);
        assert_eq!(order.rest_of_square(5, tile), 5..6);
        assert_eq!(order.rest_of_square(31, Edge::MOST), 31..32);
        assert_eq!(order.begin_of_square(20, Edge::MOST), 16);
        assert_eq!(order.begin_of_square(7, quarter), 4);
        assert_eq!(order.pixels_of_square(5, quarter), Region { columns: 16..32, rows: 0..16 });
        assert_eq!(order.pixels_of_square(5, tile), Region { columns: 24..32, rows: 0..8 });
    }

    #[test]
    fn the_last_place_of_a_rectangle_is_that_of_its_last_look_ahead_tile() {
        let order = order();
        assert_eq!(order.last_place((-5.0, 3.0), (20.0, 4.0)), 15);
        assert_eq!(order.last_place((-5.0, 3.0), (1e9, 4.0)), 31);
        assert_eq!(order.last_place((40.0, -9.0), (41.0, 1e9)), 31);
    }
}
