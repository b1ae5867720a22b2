//! The clouds and grids that a scene file refers to, each opened once.

use std::collections::HashMap;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::error::SceneFileError;
use super::reader::Cursor;
use crate::scene::{Node, Shape};
use rayset_base::regular_file;
use rayset_files::grid::{self, Grid};
use rayset_files::octree::{self, Cloud};
use rayset_store::storage::input_file::InputFile;
use rayset_store::storage::{address_of, shown};

/// The least and the largest factor of radii.
const RADIUS_SCALES: [f64; 2] = [1e-3, 1e3];

/// Data files that are open.
#[derive(Default)]
pub(super) struct DataFiles {
    clouds: HashMap<PathBuf, Arc<Cloud>>,
    /// Those with other radii than are stored.
    scaled: Vec<Arc<Cloud>>,
    grids: HashMap<PathBuf, Arc<Grid>>,
}

impl DataFiles {
    /// Uses the data files of another graph where this graph refers to them.
    pub(super) fn share(&mut self, node: &Node) {
        match &node.shape {
            Shape::Cloud(object) => {
                let path = key_of(object.cloud.address());
                drop(path.map(|path| self.clouds.insert(path, object.cloud.stored().clone())));
            }
            Shape::Grid(object) => {
                let path = key_of(object.grid.address());
                drop(path.map(|path| self.grids.insert(path, object.grid.clone())));
            }
            Shape::Operator(_, children) => children.iter().for_each(|child| self.share(child)),
            Shape::Procedural(_) => {}
        }
    }

    /// Uses clouds and grids that are open, where this graph refers to them by their names as they
    /// are.
    pub(super) fn know(&mut self, clouds: &[Arc<Cloud>], grids: &[Arc<Grid>]) {
        self.clouds.extend(clouds.iter().map(|cloud| (cloud.address().to_owned(), cloud.stored().clone())));
        self.grids.extend(grids.iter().map(|grid| (grid.address().to_owned(), grid.clone())));
    }

    /// A cloud with other radii, made once for all nodes that ask for the same.
    pub(super) fn scaled(
        &mut self,
        cloud: Arc<Cloud>,
        at: &Cursor<'_>,
    ) -> Result<Arc<Cloud>, SceneFileError> {
        let factor = at.number(RADIUS_SCALES[0], RADIUS_SCALES[1])? as f32;
        if factor == 1.0 {
            return Ok(cloud);
        }
        let is_same = |known: &&Arc<Cloud>| {
            known.header().radius_scale == factor && Arc::ptr_eq(known.stored(), &cloud)
        };
        if let Some(known) = self.scaled.iter().find(is_same) {
            return Ok(known.clone());
        }
        let scaled = cloud.with_radius_scale(factor).ok_or_else(|| {
            at.error(format!(
                "a radius of {} times this is not from 1e-18 to 1e18",
                cloud.header().radius_mean
            ))
        })?;
        let scaled = Arc::new(scaled);
        self.scaled.push(scaled.clone());
        Ok(scaled)
    }

    /// Opens a grid file, once for all nodes that refer to it.
    pub(super) fn grid(&mut self, at: &Cursor<'_>) -> Result<Arc<Grid>, SceneFileError> {
        if let Some(grid) = self.grids.get(Path::new(at.text()?)) {
            return Ok(grid.clone());
        }
        let path = at.document.beside(at.text()?);
        let key = data_file(at, &path)?;
        if let Some(grid) = self.grids.get(&key) {
            return Ok(grid.clone());
        }
        let grid =
            Arc::new(Grid::open(&path).map_err(|e| unopened(at, &path, grid::format::MAGIC, e.to_string()))?);
        self.grids.insert(key, grid.clone());
        Ok(grid)
    }

    /// Opens a cloud file, once for all nodes that refer to it.
    pub(super) fn cloud(&mut self, at: &Cursor<'_>) -> Result<Arc<Cloud>, SceneFileError> {
        if let Some(cloud) = self.clouds.get(Path::new(at.text()?)) {
            return Ok(cloud.clone());
        }
        let path = at.document.beside(at.text()?);
        let key = data_file(at, &path)?;
        if let Some(cloud) = self.clouds.get(&key) {
            return Ok(cloud.clone());
        }
        let cloud = Arc::new(
            Cloud::open(&path).map_err(|e| unopened(at, &path, octree::format::MAGIC, e.to_string()))?,
        );
        self.clouds.insert(key, cloud.clone());
        Ok(cloud)
    }
}

/// The key of a file that is open.
fn key_of(path: &Path) -> std::io::Result<PathBuf> {
    if address_of(path).is_some() { Ok(path.to_owned()) } else { path.canonicalize() }
}

/// The key under which a data file is shared: its canonical path, or its address. An error if it is
/// not a readable regular file.
fn data_file(at: &Cursor<'_>, path: &Path) -> Result<PathBuf, SceneFileError> {
    let known = match address_of(path) {
        Some(_) => Ok(path.to_owned()),
        None => regular_file::open(path).and_then(|_| path.canonicalize()),
    };
    known.map_err(|e| at.error(format!("cannot open {}: {e}", shown(path))))
}

/// The error for a data file that cannot be opened, with advice: the file may hold other data than
/// its `type` says, or be raw data that has to be built first.
fn unopened(at: &Cursor<'_>, path: &Path, wanted: [u8; 8], what: String) -> SceneFileError {
    let mut head = [0_u8; 8];
    let is_read = InputFile::open(path).and_then(|mut file| file.read_exact(&mut head)).is_ok();
    let name = shown(path);
    at.error(match head {
        _ if is_read && head == wanted => what,
        octree::format::MAGIC => format!("{name} holds points; its \"type\" is \"cloud\""),
        grid::format::MAGIC => format!("{name} holds voxels; its \"type\" is \"grid\""),
        _ => format!("{what}; `rayset build {name} -o FILE.rset` makes one of points or voxels"),
    })
}
