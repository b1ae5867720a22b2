//! How far a picture has come, by what its pixels cost and not by how many they are: sky is
//! finished in no time, and glass takes minutes.
//!
//! The picture is divided into cells. Once a render has lasted a while, a tile somewhere in every
//! cell is traced, and its pixels are thrown away: what is left of the cell is taken to cost as
//! much, in seconds of a thread. Until then, it is taken to cost what the finished tiles do.

use std::ops::{Range, RangeInclusive};
use std::time::{Duration, Instant};

use super::work::{MAX_TILE_PIXELS, Region, Tile};

/// Cells of a picture, about: at most so many, so that their probes, traced twice, are at most
/// such a share of all that is traced.
const MAX_CELLS: f64 = 100.0;
const MAX_SHARE_OF_PROBES: f64 = 0.03;
/// Where probes are in their cells differs from cell to cell, so that no row of things is met by
/// all or by none: multiples of 1/g and 1/g², where g³ = g + 1 (M. Roberts, "The Unreasonable
/// Effectiveness of Quasirandom Sequences", 2018).
const PLACES: [f64; 2] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_3];

/// The times that pixels are traced: all of them, and those that vary again.
const PASSES: usize = 2;

/// What is known of the costs of a picture that is being rendered.
pub(super) struct Costs {
    around: Region,
    /// Edge of a cell in pixels, and cells across and down.
    edge: u32,
    size: (u32, u32),
    cells: Vec<Cell>,
    /// Of the whole picture what a cell has of its own.
    all: Cell,
    traces_again: bool,
    /// Pixels to render.
    pixels: u64,
    /// Seconds that finished tiles have taken.
    spent: f64,
    /// Seconds that probes have taken at first, and again.
    cold: f64,
    warm: f64,
    /// Since then: seconds that finished tiles have taken, and those that warm probes did.
    since: (f64, f64),
    /// Seconds that the rest takes, if it takes what warm probes did.
    rest: f64,
    /// Most pixels that were said to be finished since what they cost is known.
    told: u64,
    started: Instant,
    probes: Probes,
}

/// Whether cells have been probed.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Probes {
    Never,
    /// When the render has lasted so long.
    Later(Duration),
    /// They are traced for the first time.
    Cold,
    /// They are traced again.
    Warm,
    Done,
}

/// What is left of some pixels, and what is known of their costs.
#[derive(Clone, Copy, Default)]
struct Cell {
    passes: [Timed; PASSES],
    /// Pixels of which it is not decided yet whether they are traced again.
    undecided: f64,
    /// Pixels of which it is, and how many of those are.
    decided: f64,
    varying: f64,
}

/// Pixels in a pass.
#[derive(Clone, Copy, Default)]
struct Timed {
    seconds: f64,
    pixels: f64,
    /// Those that are still to be traced.
    left: f64,
}

impl Timed {
    /// Seconds that a pixel takes, if any was timed.
    fn of_pixel(&self) -> Option<f64> {
        (self.pixels > 0.0).then(|| self.seconds / self.pixels)
    }

    fn add(&mut self, pixels: f64, seconds: f64) {
        (self.pixels, self.seconds) = (self.pixels + pixels, self.seconds + seconds);
    }
}

impl Cell {
    /// The share of pixels that are traced again, if it is known of any.
    fn varying_share(&self) -> Option<f64> {
        (self.decided > 0.0).then(|| self.varying / self.decided)
    }

    fn decide(&mut self, pixels: f64, varying: f64) {
        (self.decided, self.varying) = (self.decided + pixels, self.varying + varying);
    }

    /// Whether none of its pixels is still to be traced.
    fn is_finished(&self) -> bool {
        self.undecided + self.passes.iter().map(|timed| timed.left).sum::<f64>() <= 0.0
    }

    fn forget_costs(&mut self) {
        self.passes.iter_mut().for_each(|timed| (timed.seconds, timed.pixels) = (0.0, 0.0));
        (self.decided, self.varying) = (0.0, 0.0);
    }
}

impl Costs {
    /// Of regions within `around`, of a picture whose pixels are traced once, or those that vary
    /// once more. Cells are probed once the render has lasted some time, if that is given.
    pub(super) fn of(
        around: &Region,
        regions: impl Iterator<Item = Region>,
        traces_again: bool,
        probed_after: Option<Duration>,
    ) -> Self {
        let (width, height) = (around.columns.len() as f64, around.rows.len() as f64);
        // No tile is in two cells, unless tiles are of an odd size.
        let of_probes = 2.0 * f64::from(MAX_TILE_PIXELS.pow(2)) / MAX_SHARE_OF_PROBES;
        let pixels_of_cell = (width * height / MAX_CELLS).max(of_probes);
        let edge = (pixels_of_cell.sqrt() as u32).next_multiple_of(MAX_TILE_PIXELS);
        let edge = edge.max(MAX_TILE_PIXELS);
        let cells = |of: &Range<u32>| (of.end - on_lattice(of.start)).div_ceil(edge).max(1);
        let size = (cells(&around.columns), cells(&around.rows));
        let mut costs = Self {
            around: around.clone(),
            edge,
            size,
            cells: vec![Cell::default(); size.0 as usize * size.1 as usize],
            all: Cell::default(),
            traces_again,
            pixels: 0,
            spent: 0.0,
            cold: 0.0,
            warm: 0.0,
            since: (0.0, 0.0),
            rest: 0.0,
            told: 0,
            started: Instant::now(),
            probes: probed_after.map_or(Probes::Never, Probes::Later),
        };
        regions.for_each(|region| costs.add(&region));
        costs
    }

    /// Adds a region to what is to be rendered.
    fn add(&mut self, region: &Region) {
        self.pixels += region.pixels();
        let traces_again = self.traces_again;
        let Region { columns, rows } = region;
        let (across, down) = (self.numbers(columns, true), self.numbers(rows, false));
        for j in down {
            for i in across.clone() {
                let of_cell = self.region((i, j));
                let common = |a: &Range<u32>, b: &Range<u32>| a.start.max(b.start)..a.end.min(b.end);
                let columns = common(&of_cell.columns, columns);
                let pixels = Region { columns, rows: common(&of_cell.rows, rows) }.pixels() as f64;
                for cell in self.with_all((j * self.size.0 + i) as usize) {
                    cell.passes[0].left += pixels;
                    cell.undecided += if traces_again { pixels } else { 0.0 };
                }
            }
        }
    }

    /// The numbers of the cells that a range of columns is in, or of rows.
    fn numbers(&self, range: &Range<u32>, columns: bool) -> RangeInclusive<u32> {
        let (around, size) =
            if columns { (&self.around.columns, self.size.0) } else { (&self.around.rows, self.size.1) };
        let at = |pixel: u32| (pixel.saturating_sub(on_lattice(around.start)) / self.edge).min(size - 1);
        at(range.start)..=at(range.end.max(range.start + 1) - 1)
    }

    /// The pixels of a cell.
    fn region(&self, (i, j): (u32, u32)) -> Region {
        let along = |range: &Range<u32>, at: u32| {
            let start = on_lattice(range.start) + at * self.edge;
            start.max(range.start)..(start + self.edge).min(range.end)
        };
        Region { columns: along(&self.around.columns, i), rows: along(&self.around.rows, j) }
    }

    /// The number of the cell that has the upper left pixel of a tile.
    fn cell(&self, tile: &Tile) -> usize {
        let i = *self.numbers(&(tile.x..tile.x), true).start();
        let j = *self.numbers(&(tile.y..tile.y), false).start();
        (j * self.size.0 + i) as usize
    }

    /// Seconds that a pixel of a cell takes in a pass, and the share of its pixels that are traced
    /// again: as in its own probe, or as in all.
    fn of_cell(&self, cell: &Cell) -> ([f64; PASSES], f64) {
        let [of_all, again] = self.all.passes.map(|timed| timed.of_pixel());
        let of_all = of_all.unwrap_or(0.0);
        let once = cell.passes[0].of_pixel().unwrap_or(of_all);
        // Where no pixel was traced again, that would cost more than elsewhere if the first pass
        // did.
        let dearer = if of_all > 0.0 { once / of_all } else { 1.0 };
        let twice = cell.passes[1].of_pixel().unwrap_or(again.unwrap_or(of_all) * dearer);
        // Until anything is known of them, those that vary take as long as all did at first.
        let share = cell.varying_share().or_else(|| self.all.varying_share()).unwrap_or(1.0);
        ([once, twice], share)
    }

    /// Seconds that what is left of a cell takes.
    fn rest_of(&self, cell: &Cell) -> f64 {
        let ([once, twice], share) = self.of_cell(cell);
        cell.passes[0].left * once + (cell.passes[1].left + cell.undecided * share) * twice
    }

    /// A tile is finished: so many of its pixels were traced in a pass. `is_wanted` if they are
    /// pixels to render, not those around.
    pub(super) fn finished(&mut self, tile: &Tile, pixels: u64, pass: usize, seconds: f32, is_wanted: bool) {
        let (pixels, seconds) = (pixels as f64, f64::from(seconds));
        let number = self.cell(tile);
        match self.probes {
            Probes::Cold | Probes::Warm => {
                // Around a probe are strips a pixel wide, of which a pixel costs more.
                if is_wanted {
                    self.probed(number, pixels, pass, seconds);
                }
                return;
            }
            Probes::Never | Probes::Later(_) => self.all.passes[pass].add(pixels, seconds),
            Probes::Done => {
                let expected = pixels * self.of_cell(&self.cells[number]).0[pass];
                self.since = (self.since.0 + seconds, self.since.1 + expected);
                self.rest -= if is_wanted { expected } else { 0.0 };
            }
        }
        self.spent += seconds;
        if is_wanted {
            for cell in self.with_all(number) {
                cell.passes[pass].left = (cell.passes[pass].left - pixels).max(0.0);
            }
        }
    }

    /// The same of a probe. What is known of all cells is then known of their probes alone: these
    /// are anywhere in a cell, and finished tiles are all on one side of it.
    fn probed(&mut self, number: usize, pixels: f64, pass: usize, seconds: f64) {
        if self.probes == Probes::Cold {
            self.cold += seconds;
            return;
        }
        self.warm += seconds;
        for cell in self.with_all(number) {
            cell.passes[pass].add(pixels, seconds);
        }
    }

    /// It is decided of the pixels of a tile how many of them are traced again.
    pub(super) fn decided(&mut self, tile: &Tile, varying: u64) {
        let (pixels, varying) = (tile.pixels() as f64, varying as f64);
        let number = self.cell(tile);
        match self.probes {
            Probes::Cold => return,
            Probes::Warm => {
                self.with_all(number).into_iter().for_each(|cell| cell.decide(pixels, varying));
                return;
            }
            Probes::Never | Probes::Later(_) => self.all.decide(pixels, varying),
            Probes::Done => {
                let ([_, twice], share) = self.of_cell(&self.cells[number]);
                self.rest += (varying - pixels * share) * twice;
            }
        }
        for cell in self.with_all(number) {
            cell.undecided = (cell.undecided - pixels).max(0.0);
            cell.passes[1].left += varying;
        }
    }

    /// A cell, and what is known of all.
    fn with_all(&mut self, number: usize) -> [&mut Cell; 2] {
        [&mut self.cells[number], &mut self.all]
    }

    /// How many pixels are rendered.
    #[cfg(feature = "parts")]
    pub(super) fn pixels(&self) -> u64 {
        self.pixels
    }

    /// Seconds that the rest takes. Pages and tables of shadows are needed first by a cold probe,
    /// and are there for a warm one; of the rest, several tiles share them. So it takes more than
    /// warm probes did and less than cold ones, by as much as tiles have since. It may take less,
    /// too, for rays that bounce are traced in fuller packets with those of other tiles; how much
    /// less is known once much of the picture is finished.
    fn left(&self) -> f64 {
        if self.probes != Probes::Done {
            return self.rest_of(&self.all);
        }
        // Sums are rounded.
        if self.all.is_finished() {
            return 0.0;
        }
        let most = if self.warm > 0.0 { (self.cold / self.warm).max(1.0) } else { 1.0 };
        let scale = if self.since.1 > 0.0 { self.since.0 / self.since.1 } else { most.sqrt() };
        let finished = self.spent / (self.spent + self.rest.max(0.0)).max(1e-9);
        scale.clamp(1.0 - 0.5 * (finished - 0.2).max(0.0), most) * self.rest.max(0.0)
    }

    /// How many of the pixels to render are finished, as far as their costs say; never fewer than
    /// before, unless cells have been probed since.
    pub(super) fn done(&mut self) -> u64 {
        let left = self.left();
        let share = if left > 0.0 { self.spent / (self.spent + left) } else { 1.0 };
        self.told = self.told.max((self.pixels as f64 * share) as u64);
        self.told
    }

    /// Whether cells are to be probed now.
    pub(super) fn are_due(&self) -> bool {
        let is_time = matches!(self.probes, Probes::Later(after) if self.started.elapsed() >= after);
        is_time && self.spent < self.left()
    }

    /// Begins to probe. Returns the tiles, some at a time, each of which is to be traced cold and
    /// then warm.
    pub(super) fn begin_probes(&mut self) -> Vec<Vec<Region>> {
        self.all.forget_costs();
        let tile = |range: Range<u32>, share: f64| {
            let start = on_lattice(range.start + (range.len() as f64 * share) as u32);
            start.max(range.start)..(start + MAX_TILE_PIXELS).min(range.end)
        };
        let is_left = |(i, j): &(u32, u32)| !self.cells[(j * self.size.0 + i) as usize].is_finished();
        let of_cell = |(i, j): (u32, u32)| {
            let place = |a: u32, b: u32| (PLACES[0] * f64::from(a) + PLACES[1] * f64::from(b)).fract();
            let (u, v) = (place(j, i), place(i, j));
            let Region { columns, rows } = self.region((i, j));
            Region { columns: tile(columns, u), rows: tile(rows, v) }
        };
        let row = |j: u32| (0..self.size.0).map(|i| (i, j)).filter(is_left).map(of_cell).collect();
        (0..self.size.1).map(row).collect()
    }

    /// Some tiles are probed now.
    pub(super) fn probe(&mut self, is_warm: bool) {
        self.probes = if is_warm { Probes::Warm } else { Probes::Cold };
    }

    /// Ends to probe. What was said before may have been too much. Returns the share of the time of
    /// the whole picture that one ray through the middle of each pixel takes.
    pub(super) fn end_probes(&mut self) -> f64 {
        self.probes = Probes::Done;
        self.told = 0;
        self.rest = self.cells.iter().map(|cell| self.rest_of(cell)).sum();
        let [first, again] = self.all.passes.map(|timed| timed.seconds);
        if first > 0.0 { first / (first + again) } else { 1.0 }
    }
}

/// The pixel at which the tile begins that has a pixel.
fn on_lattice(pixel: u32) -> u32 {
    pixel / MAX_TILE_PIXELS * MAX_TILE_PIXELS
}

#[cfg(test)]
mod tests;
