//! Opening a file: which grid is read, and where its voxels are.

use std::path::Path;

use super::super::orientation::Orientation;
use super::dense::Dense;
use super::grids::{self, GridDescriptor, Head};
use super::stream::{Stream, Wrong};
use super::transform;
use super::tree::{Bounds, Tree};
use super::values::Coding;
use rayset_base::geometry::{DAffine3, DMat3, DVec3};
use rayset_base::numbers::Stored;
use rayset_files::grid::VolumeError;
use rayset_files::grid::{Described, VolumeSource, Voxels};

/// Largest number of voxels of the box around all active ones.
const MOST_VOXELS: u128 = 1 << 32;
/// The grid that is read if there are several.
const PREFERRED: &str = "density";

pub(in super::super) fn open(path: &Path) -> Result<VolumeSource, VolumeError> {
    let mut stream = Stream::open(path)?;
    let grid = Grid::read(&mut stream).map_err(|wrong| wrong.of_file(path))?;
    let bounds = grid.bounds().map_err(|wrong| wrong.of_file(path))?;
    let low = DVec3::from_array(bounds.low.map(|v| v as f64));
    // Voxels come with z fastest and x slowest.
    let DAffine3 { matrix3, .. } = grid.space_from_index;
    let linear = DMat3::from_cols(matrix3.z_axis, matrix3.y_axis, matrix3.x_axis);
    let described = Described {
        size: [2, 1, 0].map(|axis: usize| (bounds.high[axis] - bounds.low[axis] + 1) as u64),
        stored: grid.stored,
        big_endian: false,
        scale: 1.0,
        offset: 0.0,
        space_from_voxel: DAffine3::from_mat3_translation(
            linear,
            grid.space_from_index.transform_point3(low),
        ),
        size_place: format!("byte {}, its tree", grid.start),
        axes_place: format!("byte {}, its transform", grid.start),
    };
    let bytes = described.check(path)?;
    let dense = Dense::new(stream, grid.tree, bounds);
    let memory_bytes = dense.memory_bytes();
    let voxels = Voxels { path: path.to_owned(), data: Box::new(dense), rest: Some(0) };
    let source = VolumeSource::new(&described, bytes, voxels).with_memory_bytes(memory_bytes);
    let source = grid.orientation.applied_to(source);
    Ok(grid.about.into_iter().fold(source, VolumeSource::with_about))
}

/// A grid that can be read.
struct Grid {
    /// Its offset in the file.
    start: u64,
    stored: Stored,
    space_from_index: DAffine3,
    tree: Tree,
    orientation: Orientation,
    about: Vec<String>,
}

impl Grid {
    fn read(stream: &mut Stream) -> Result<Self, Wrong> {
        let Head { entries, creator } = grids::read(stream)?;
        let (entry, stored) = chosen(&entries).map_err(|what| Wrong { at: stream.at(), what })?;
        let start = entry.start;
        if entry.instance {
            let what = format!("the grid `{}` shares the tree of another, which is not read", entry.name);
            return Err(Wrong { at: start, what });
        }
        stream.seek(start)?;
        let compression = stream.u32()?;
        let coding = Coding::new(compression, entry.half, stored.bytes());
        let coding = coding.ok_or_else(|| {
            let what =
                format!("unknown compression {compression}; none, zip, Blosc and active masks are read");
            Wrong { at: start, what }
        })?;
        let mut about = Vec::new();
        if entries.len() > 1 {
            about.push(format!("the grid `{}` is read, of {}", entry.name, names(&entries)));
        }
        grids::metadata(stream, |name, text| {
            if name == "class" && text == "level set" {
                about.push("a level set: values are distances to a surface, negative inside".to_owned());
            }
        })?;
        let space_from_index = transform::read(stream)?;
        let tree = Tree::index(stream, coding)?;
        let orientation = Orientation::of_program(&creator);
        Ok(Self { start, stored, space_from_index, tree, orientation, about })
    }

    /// The active voxels, and one voxel around them, which shows what is outside.
    fn bounds(&self) -> Result<Bounds, Wrong> {
        let active = self.tree.active;
        if active.is_empty() {
            return Err(Wrong { at: self.start, what: "the grid has no active voxels".into() });
        }
        let bounds = Bounds { low: active.low.map(|v| v - 1), high: active.high.map(|v| v + 1) };
        let size: [i64; 3] = std::array::from_fn(|axis| bounds.high[axis] - bounds.low[axis] + 1);
        let voxels: u128 = size.iter().map(|n| n.unsigned_abs() as u128).product();
        if voxels > MOST_VOXELS {
            let what = format!(
                "the box around all active voxels has {} x {} x {} voxels, and at most {MOST_VOXELS} are read; crop \
                 the grid, or resample it with larger voxels",
                size[0], size[1], size[2]
            );
            return Err(Wrong { at: self.start, what });
        }
        Ok(bounds)
    }
}

/// The grid that is read, and the type of its values. An error says which grids there are.
fn chosen(entries: &[GridDescriptor]) -> Result<(&GridDescriptor, Stored), String> {
    let readable = entries.iter().filter_map(|entry| {
        let stored = match entry.tree.as_str() {
            "Tree_float_5_4_3" => Stored::F32,
            "Tree_double_5_4_3" => Stored::F64,
            _ => return None,
        };
        Some((entry, stored))
    });
    let preferred = readable.clone().find(|(entry, _)| entry.name == PREFERRED);
    preferred.or_else(|| readable.clone().next()).ok_or_else(|| match entries {
        [] => "the file has no grid".to_owned(),
        _ => format!(
            "no grid of floats or doubles in a tree of the shape 5-4-3; the file has {}. A vector grid is read once a \
             component, or its length, is a grid of its own",
            names(entries)
        ),
    })
}

fn names(entries: &[GridDescriptor]) -> String {
    let kind =
        |entry: &GridDescriptor| entry.tree.trim_start_matches("Tree_").trim_end_matches("_5_4_3").to_owned();
    let names: Vec<String> =
        entries.iter().map(|entry| format!("`{}` ({})", entry.name, kind(entry))).collect();
    names.join(", ")
}
