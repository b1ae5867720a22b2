//! Opens files of points, and says what is lost of them, and what of volumes is read.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow};
use rayset::points::{InTurn, PointSource, ReadError, ReadOptions};
use rayset::volumes::{self, VolumeSource};

use crate::columns;
use crate::files::Files;
use crate::host::Host;
use crate::left_out::LeftOut;

/// Points that are open, as the sources of one cloud.
pub struct Points {
    /// One of each file, or of each snapshot in several files.
    pub sources: Vec<Box<dyn PointSource>>,
    /// The files without which the build goes on.
    pub left_out: LeftOut,
}

impl Points {
    /// Every file that is read.
    pub fn files(&self) -> impl Iterator<Item = PathBuf> {
        self.sources.iter().flat_map(|source| source.files())
    }
}

/// Opens files of points as the sources of one cloud. Those that only a folder or a pattern named
/// are left out if they are damaged, unless `strict`.
///
/// # Errors
/// What is wrong with a file that a person named, or with the first if nothing can be read.
pub fn open_points(files: &Files, options: &ReadOptions, strict: bool, host: &dyn Host) -> Result<Points> {
    let mut open = Opening { in_turn: InTurn::new(options), read_already: HashSet::new(), said: Vec::new() };
    let (mut sources, mut left_out) = (Vec::new(), LeftOut::of(files.paths.len()));
    for (path, named) in files.iter() {
        let may_leave_out = !named && !strict;
        match open.source(path, files.paths.len()) {
            Ok(None) => {}
            Ok(Some(source)) => {
                left_out.expect(path, may_leave_out);
                sources.push(source);
            }
            Err(error) if may_leave_out && LeftOut::is_damage(&error) => left_out.note(path, &error),
            Err(error) => return Err(error.into()),
        }
    }
    // A file may tell of others that were opened before it, such as coarser levels of the same.
    let of_others: HashSet<PathBuf> = sources.iter().flat_map(|source| others_of(&**source)).collect();
    sources.retain(|source| source.path().is_none_or(|path| !of_others.contains(path)));
    if sources.is_empty() {
        let first = left_out.first().unwrap_or_else(|| "no input files".into());
        return Err(anyhow!("{first}"));
    }
    for (sentence, first, count) in &open.said {
        let more = if *count > 1 { format!(" and {} more", count - 1) } else { String::new() };
        host.remark(&format!("{}{more}: {sentence}", first.display()));
    }
    if let Some(points) = options.mesh_points
        && let Some(other) = sources.iter().find(|source| source.count_hint() != Some(points))
    {
        let name = other.path().unwrap_or(Path::new("the input")).display();
        host.remark(&format!(
            "{name}: --mesh-points is for the faces of PLY, OBJ, OFF and STL; its points are read"
        ));
    }
    columns::remark_on_readings(&sources, host);
    remark_on_systems(&sources, host);
    Ok(Points { sources, left_out })
}

/// Files that are opened one after another.
struct Opening {
    in_turn: InTurn,
    /// Files of the snapshots that are open: a folder names all of them, and each stands for the
    /// whole.
    read_already: HashSet<PathBuf>,
    /// What is lost of files: a sentence, the first file of which it is true, and their number.
    said: Vec<(String, PathBuf, usize)>,
}

impl Opening {
    /// The source of a file, one of `count`; `None` if an earlier source reads it.
    fn source(&mut self, path: &Path, count: usize) -> Result<Option<Box<dyn PointSource>>, ReadError> {
        if self.read_already.contains(path) {
            return Ok(None);
        }
        let source = match count {
            // Meshes are read whole to be opened, which is not done twice without need.
            1 => rayset::points::open(path, self.in_turn.options())?,
            _ => self.in_turn.open(path)?,
        };
        for sentence in &source.schema().warnings {
            match self.said.iter_mut().find(|(said, ..)| said == sentence) {
                Some((_, _, count)) => *count += 1,
                None => self.said.push((sentence.clone(), path.to_owned(), 1)),
            }
        }
        let files = source.files();
        if files.len() > 1 {
            self.read_already.extend(files);
        }
        Ok(Some(source))
    }
}

/// The files of a source besides the one that it was opened by.
fn others_of(source: &dyn PointSource) -> Vec<PathBuf> {
    let own = source.path().map(Path::to_owned);
    source.files().into_iter().filter(|file| Some(file) != own.as_ref()).collect()
}

/// Says so if sources have different reference systems, whose coordinates do not belong together.
fn remark_on_systems(sources: &[Box<dyn PointSource>], host: &dyn Host) {
    let mut systems: Vec<&str> = sources.iter().map(|source| &*source.schema().crs).collect();
    systems.retain(|system| !system.is_empty());
    systems.sort_unstable();
    systems.dedup();
    if let [first, second, ..] = systems[..] {
        let name = |system: &str| system.chars().take(60).collect::<String>();
        host.remark(&format!(
            "the inputs have {} reference systems, {} and {} among them, and are put together as they are; `pdal translate` \
             with filters.reprojection brings them into one",
            systems.len(),
            name(first),
            name(second)
        ));
    }
}

/// Whether one of some files is a volume.
pub fn has_volume(files: &[PathBuf]) -> Result<bool> {
    for file in files {
        if volumes::is_volume(file)? {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Says what the reader of a volume chose, and what it knows of the volume.
pub fn remark_about(file: &Path, source: &VolumeSource, host: &dyn Host) {
    for sentence in &source.about {
        host.remark(&format!("{}: {sentence}", file.display()));
    }
}
