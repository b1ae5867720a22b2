//! Space-filling curves: Hilbert curves order the points of an octree and the tiles of a picture.

/// Octree levels below the root that an index along the curve resolves; the index has
/// `3 * MAX_LEVEL` bits.
pub const MAX_LEVEL: u32 = 20;

/// Spreads the low 21 bits of `v`, inserting two zero bits after each.
fn spread(v: u32) -> u64 {
    let mut x = u64::from(v) & 0x1f_ffff;
    x = (x | x << 32) & 0x001f_0000_0000_ffff;
    x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

/// Morton code of a cell at [`MAX_LEVEL`], with x in the lowest bit of each triple.
fn morton(cell: [u32; 3]) -> u64 {
    spread(cell[0]) | spread(cell[1]) << 1 | spread(cell[2]) << 2
}

/// For each of 24 orientations of the curve within a cell (entry corner and direction) and each
/// octant: the octant's rank along the curve in the low three bits, and the orientation within it
/// above.
const TURNS: [[u8; 8]; 24] = turns();

/// Computes [`TURNS`] from Gray codes (Hamilton, *Compact Hilbert Indices*, 2006, section 2).
const fn turns() -> [[u8; 8]; 24] {
    const fn rotate_left(v: u32, by: u32) -> u32 {
        let by = by % 3;
        (v << by | v >> (3 - by)) & 7
    }
    let mut table = [[0; 8]; 24];
    let mut state = 0;
    while state < 24 {
        let (entry, direction) = (state as u32 & 7, state as u32 >> 3);
        let mut octant = 0;
        while octant < 8 {
            let gray = rotate_left(octant ^ entry, 3 - (direction + 1) % 3);
            let rank = gray ^ gray >> 1 ^ gray >> 2;
            let (sub_entry, sub_direction) = if rank == 0 {
                (0, 0)
            } else {
                let even = (rank - 1) / 2 * 2;
                let odd = if rank.is_multiple_of(2) { rank - 1 } else { rank };
                (even ^ even >> 1, odd.trailing_ones() % 3)
            };
            let next_entry = entry ^ rotate_left(sub_entry, direction + 1);
            let next_direction = (direction + sub_direction + 1) % 3;
            table[state][octant as usize] = (rank | (next_entry | next_direction << 3) << 3) as u8;
            octant += 1;
        }
        state += 1;
    }
    table
}

/// The same of two levels at once: for each orientation and each octant of an octant, the upper
/// level's first, the rank in the low six bits, and the orientation above.
const TWO_TURNS: [[u16; 64]; 24] = two_turns();

const fn two_turns() -> [[u16; 64]; 24] {
    let mut table = [[0; 64]; 24];
    let mut state = 0;
    while state < 24 {
        let mut octants = 0;
        while octants < 64 {
            let upper = TURNS[state][octants >> 3] as u16;
            let lower = TURNS[(upper >> 3) as usize][octants & 7] as u16;
            table[state][octants] = (upper & 7) << 3 | lower & 7 | lower >> 3 << 6;
            octants += 1;
        }
        state += 1;
    }
    table
}

/// Index of a cell at [`MAX_LEVEL`] along a three-dimensional Hilbert curve. The first `3·l` bits
/// are the index of the cell at level `l` that contains it, so the curve orders an octree as a
/// Morton code does, but without jumps.
#[must_use]
pub fn hilbert(cell: [u32; 3]) -> u64 {
    let interleaved = morton(cell);
    let (mut state, mut place) = (0_usize, 0_u64);
    for pair in (0..MAX_LEVEL / 2).rev() {
        let turn = TWO_TURNS[state][(interleaved >> (6 * pair)) as usize & 63];
        place = place << 6 | u64::from(turn & 63);
        state = usize::from(turn >> 6);
    }
    place
}

const _: () = assert!(MAX_LEVEL.is_multiple_of(2), "levels are looked up in pairs");

/// Column and row of cell number `index` along a Hilbert curve over a square of `side` cells (a
/// power of two).
#[must_use]
pub fn hilbert_cell(side: u32, index: u64) -> (u32, u32) {
    let (mut x, mut y, mut rest) = (0_u32, 0_u32, index);
    let mut s = 1_u32;
    while s < side {
        let rx = u32::from(rest & 2 != 0);
        let ry = u32::from((rest ^ u64::from(rx)) & 1 != 0);
        if ry == 0 {
            if rx == 1 {
                x = s - 1 - x;
                y = s - 1 - y;
            }
            std::mem::swap(&mut x, &mut y);
        }
        x += s * rx;
        y += s * ry;
        rest >>= 2;
        s <<= 1;
    }
    (x, y)
}

/// All cells of a `columns` × `rows` rectangle in the order of a Hilbert curve. A long rectangle is
/// traversed square by square, so that the cost is proportional to its number of cells.
#[must_use]
pub fn hilbert_order(columns: u32, rows: u32) -> Vec<(u32, u32)> {
    let mut order = Vec::with_capacity(columns as usize * rows as usize);
    order.extend(hilbert_cells(columns, rows));
    order
}

/// The cells of [`hilbert_order`], one after another.
pub fn hilbert_cells(columns: u32, rows: u32) -> impl Iterator<Item = (u32, u32)> {
    let side = columns.min(rows).max(1).next_power_of_two();
    let squares = 0..columns.max(rows).div_ceil(side);
    let origins = squares.map(move |at| if columns > rows { (at * side, 0) } else { (0, at * side) });
    origins.flat_map(move |(x0, y0)| {
        let cells = (0..u64::from(side) * u64::from(side)).map(move |index| hilbert_cell(side, index));
        cells.map(move |(x, y)| (x0 + x, y0 + y)).filter(move |&(x, y)| x < columns && y < rows)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn morton_interleaves_x_lowest() {
        assert_eq!(morton([1, 0, 0]), 1);
        assert_eq!(morton([0, 1, 0]), 2);
        assert_eq!(morton([0, 0, 1]), 4);
        assert_eq!(morton([(1 << MAX_LEVEL) - 1; 3]), (1 << (3 * MAX_LEVEL)) - 1);
    }

    #[test]
    fn an_index_is_that_of_one_level_after_another() {
        let mut cell = [7_u32, 1 << 19, 12_345];
        for _ in 0..1000 {
            cell = cell
                .map(|v| v.wrapping_mul(747_796_405).wrapping_add(2_891_336_453) & ((1 << MAX_LEVEL) - 1));
            let (mut state, mut place) = (0, 0);
            for level in (0..MAX_LEVEL).rev() {
                let octant = (0..3).fold(0, |octant, axis| octant | (cell[axis] >> level & 1) << axis);
                let turn = TURNS[state][octant as usize];
                (place, state) = (place << 3 | u64::from(turn & 7), usize::from(turn >> 3));
            }
            assert_eq!(hilbert(cell), place, "{cell:?}");
        }
    }

    #[test]
    fn hilbert_neighbours_touch_and_prefixes_number_cells() {
        let side = 8_u32;
        let shift = MAX_LEVEL - 3;
        let mut cells: Vec<(u64, [u32; 3])> = Vec::new();
        for x in 0..side {
            for y in 0..side {
                for z in 0..side {
                    let corner = [x << shift, y << shift, z << shift];
                    let inside = [(x << shift) + 12_345, (y << shift) + 99_999, (z << shift) + 7];
                    assert_eq!(hilbert(corner) >> (3 * shift), hilbert(inside) >> (3 * shift));
                    cells.push((hilbert(corner) >> (3 * shift), [x, y, z]));
                }
            }
        }
        cells.sort_unstable();
        for (place, pair) in cells.windows(2).enumerate() {
            assert_eq!(pair[0].0, place as u64);
            let steps: u32 = (0..3).map(|axis| pair[0].1[axis].abs_diff(pair[1].1[axis])).sum();
            assert_eq!(steps, 1, "from {:?} to {:?}", pair[0].1, pair[1].1);
        }
    }

    #[test]
    fn hilbert_order_visits_each_cell_once_and_steps_to_neighbours() {
        let order = hilbert_order(8, 8);
        let mut seen = order.clone();
        seen.sort_unstable();
        seen.dedup();
        assert_eq!(seen.len(), 64);
        for pair in order.windows(2) {
            assert_eq!(pair[0].0.abs_diff(pair[1].0) + pair[0].1.abs_diff(pair[1].1), 1);
        }
        for (columns, rows) in [(1, 1), (100, 3), (3, 100), (7, 9)] {
            let mut seen = hilbert_order(columns, rows);
            seen.sort_unstable();
            seen.dedup();
            assert_eq!(seen.len() as u32, columns * rows);
        }
    }
}
