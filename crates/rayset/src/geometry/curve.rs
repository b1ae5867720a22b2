//! Space-filling curves: Morton codes for the octree, a Hilbert curve for the order of image tiles.

/// Octree levels below the root that a Morton code resolves; a code has `3 * MAX_LEVEL` bits.
pub const MAX_LEVEL: u32 = 20;

/// Spreads the low 20 bits of `v` so that two zero bits follow each.
fn spread(v: u32) -> u64 {
    let mut x = u64::from(v) & 0x1f_ffff;
    x = (x | x << 32) & 0x001f_0000_0000_ffff;
    x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

/// Morton code of a cell at [`MAX_LEVEL`], x in the lowest bit of each triple.
#[must_use]
pub fn morton(cell: [u32; 3]) -> u64 {
    spread(cell[0]) | spread(cell[1]) << 1 | spread(cell[2]) << 2
}

/// Column and row of step `index` along a Hilbert curve over a square of `side` cells (a power of two).
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

/// All cells of a `columns` × `rows` rectangle, in the order in which a Hilbert curve meets them.
#[must_use]
pub fn hilbert_order(columns: u32, rows: u32) -> Vec<(u32, u32)> {
    let side = columns.max(rows).max(1).next_power_of_two();
    (0..u64::from(side) * u64::from(side))
        .map(|index| hilbert_cell(side, index))
        .filter(|&(x, y)| x < columns && y < rows)
        .collect()
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
    fn hilbert_order_visits_each_cell_once_and_steps_to_neighbours() {
        let order = hilbert_order(8, 8);
        let mut seen = order.clone();
        seen.sort_unstable();
        seen.dedup();
        assert_eq!(seen.len(), 64);
        for pair in order.windows(2) {
            assert_eq!(pair[0].0.abs_diff(pair[1].0) + pair[0].1.abs_diff(pair[1].1), 1);
        }
    }
}
