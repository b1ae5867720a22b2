//! Pictures in parts, which are rendered by several processes and joined by one; and the cameras of
//! turntables and animations.

use std::collections::HashMap;
use std::sync::Arc;

use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::PyBytes;
use rayset::parts::{Joined, Part, PartOptions, Share};
use rayset::scene::{Camera, Projection};
use rayset::storage::{self, MemoryStorage, Storage};
use rayset::{CancelToken, Region, SimdLevel};
use rayset_inputs::Pixels;
use rayset_inputs::look::{Turntable, standing_back};

use crate::errors;
use crate::image::Picture;
use crate::looks::TurnsAbout;
use crate::render::{self, Failure, Job, PIXEL_BYTES, Session};
use crate::room;
use crate::wait::{self, Progress};

/// Most pixels of a part that are held while it is rendered; with layers they take 16 MiB.
const HELD_PIXELS: u64 = 1 << 18;

/// Names of the vector instructions of this processor, the best first, and whether they are of the
/// class with fused multiply–add.
#[pyfunction]
pub(crate) fn instructions() -> Vec<(&'static str, bool)> {
    SimdLevel::available().into_iter().map(|level| (level.name(), level.is_fused())).collect()
}

/// Renders share `number` of `of` of a picture, or of a smaller one whose pixels are squares of
/// `edge` pixels. Returns the bytes of the part.
#[pyfunction]
#[pyo3(signature = (session, job, share, told, edge = 1))]
pub(crate) fn render_part<'py>(
    py: Python<'py>,
    session: &Session,
    job: Job,
    share: (u32, u32),
    told: Option<&Bound<'py, PyAny>>,
    edge: u32,
) -> PyResult<Bound<'py, PyBytes>> {
    let (number, of) = share;
    let share = Share::new(number, of);
    let share = share.ok_or_else(|| errors::value(format!("there is no part {number} of {of}")))?;
    let engine = session.engine(py)?;
    let wanted = job.without_python();
    let (cancel, progress) = (CancelToken::new(), Progress::default());
    let work = || {
        let shot = session.shot(&engine, &wanted)?;
        let options =
            PartOptions::new(share).with_note(shot.pixels.encode().to_vec()).with_held_pixels(HELD_PIXELS);
        let mut bytes = Vec::new();
        let mut tell = |done, total| progress.set("tracing", done, total);
        let (view, region) = if edge <= 1 { (shot.view()?, shot.region.clone()) } else { shot.coarse(edge)? };
        view.render_part(&region, &options, &cancel, &mut tell, &mut bytes)?;
        Ok(bytes)
    };
    let bytes = wait::run(py, &cancel, &progress, told, work)?;
    bytes.map(|bytes| PyBytes::new(py, &bytes)).map_err(|failure| render::raised(py, failure))
}

/// A part of a picture with a name for messages.
type Named = (String, PyBackedBytes);

/// The parts of a picture; of those that are missing there is nothing, if `partly`. Pictures are
/// the caller's, and no budget counts them.
fn joined(parts: Vec<Named>, partly: bool) -> Result<(Joined, Picture), Failure> {
    let parts = parts.into_iter().map(|(name, bytes)| {
        let storage: Arc<dyn Storage> = Arc::new(MemoryStorage::new(Arc::new(bytes)));
        Part::from_storage(&name, storage)
    });
    let joined = if partly { Joined::join_partly(parts, u64::MAX)? } else { Joined::join(parts, u64::MAX)? };
    let region = joined.region();
    room::check(region.pixels(), PIXEL_BYTES, "the picture of these parts", "join fewer of them, by crop=")?;
    let picture = Picture {
        picture: joined.picture()?,
        pixels: Pixels::decode(joined.note()).unwrap_or_default(),
        corner: (region.columns.start, region.rows.start),
        whole: joined.size(),
    };
    Ok((joined, picture))
}

/// Joins the parts of a picture. Those that are missing are an error, unless there is a picture
/// below them.
#[pyfunction]
#[pyo3(signature = (parts, below = None))]
pub(crate) fn join_parts(py: Python<'_>, parts: Vec<Named>, below: Option<&Picture>) -> PyResult<Picture> {
    let picture = py.detach(|| {
        let (joined, mut picture) = joined(parts, below.is_some())?;
        let size = |of: &Picture| (of.picture.width, of.picture.height, of.picture.layers.is_empty());
        if let Some(below) = below.filter(|below| size(below) == size(&picture)) {
            let (x, y) = picture.corner;
            for region in joined.missing() {
                for row in region.rows {
                    let from = (row - y) as usize * picture.picture.width as usize;
                    let from = from + (region.columns.start - x) as usize;
                    let places = from..from + region.columns.len();
                    picture.picture.pixels[places.clone()]
                        .copy_from_slice(&below.picture.pixels[places.clone()]);
                    if !picture.picture.layers.is_empty() {
                        picture.picture.layers[places.clone()].copy_from_slice(&below.picture.layers[places]);
                    }
                }
            }
        }
        Ok(picture)
    });
    picture.map_err(|failure: Failure| render::raised(py, failure))
}

/// The picture of parts whose pixels are squares, as part `crop` of a picture of size `whole`.
#[pyfunction]
pub(crate) fn join_coarse(
    py: Python<'_>,
    parts: Vec<Named>,
    crop: [u32; 4],
    whole: (u32, u32),
) -> PyResult<Picture> {
    let [x, y, width, height] = crop;
    let picture = py.detach(|| {
        let (_, picture) = joined(parts, false)?;
        Ok(Picture { corner: (x, y), whole, ..picture.enlarged(width, height)? })
    });
    picture.map_err(|failure: Failure| render::raised(py, failure))
}

/// What each of `of` shares of part `crop` of a picture is expected to cost. `costs` are those of
/// the pixels of a coarse picture, row after row, each of which stands for a square of pixels with
/// this `edge`.
#[pyfunction]
pub(crate) fn share_costs(costs: Vec<f64>, crop: [u32; 4], edge: u32, of: u32) -> Vec<f64> {
    let [x, y, width, height] = crop;
    let region = Region { columns: x..x.saturating_add(width), rows: y..y.saturating_add(height) };
    let edge = edge.max(1);
    let (first, row) = (region.columns.start / edge, region.rows.start / edge);
    let columns = region.columns.end.div_ceil(edge) - first;
    // Of a square as many pixels as the coarse picture has there.
    let of_square = |square: Region| -> f64 {
        let (left, right) = (square.columns.start / edge, square.columns.end.div_ceil(edge));
        let (above, below) = (square.rows.start / edge, square.rows.end.div_ceil(edge));
        let places = (above..below).flat_map(|j| (left..right).map(move |i| (i, j)));
        let at = |(i, j)| costs.get((j - row) as usize * columns as usize + (i - first) as usize);
        let count = u64::from(right - left) * u64::from(below - above);
        places.filter_map(at).sum::<f64>() / count.max(1) as f64 * square.pixels() as f64
    };
    Share::all(of).map(|share| share.squares(&region).map(of_square).sum()).collect()
}

/// The numbers of a camera by the keys that scenes have for them; those of one number have a list
/// of one.
fn numbers(camera: &Camera) -> HashMap<&'static str, Vec<f64>> {
    let mut all = HashMap::from([
        ("position", camera.position.to_array().to_vec()),
        ("direction", camera.direction.to_array().to_vec()),
        ("up", camera.up.to_array().to_vec()),
    ]);
    match camera.projection {
        Projection::Perspective { fovy } => all.insert("fovy", vec![fovy.to_degrees()]),
        Projection::Orthographic { height } => all.insert("height", vec![height]),
        _ => None,
    };
    all
}

/// What the numbers of a camera take, with their keys.
const CAMERA_BYTES: u64 = 1024;

/// The cameras of a turntable of so many pictures, or else of the animation of the scene: of all
/// its frames. `about` is what the cameras of a turntable turn about, if the camera of the scene
/// was chosen to be the first; otherwise it is the middle of the scene, and a camera that frames it
/// stands back until all of them see it.
#[pyfunction]
pub(crate) fn cameras(
    py: Python<'_>,
    job: Job,
    turntable: Option<u32>,
    about: Option<TurnsAbout>,
) -> PyResult<Vec<HashMap<&'static str, Vec<f64>>>> {
    let wanted = job.without_python();
    let parse = || {
        storage::look_again();
        wanted.parsed()
    };
    let file = py.detach(parse).map_err(|failure| render::raised(py, failure))?;
    if let Some(turns) = turntable {
        room::check(u64::from(turns), CAMERA_BYTES, "the list of the cameras", "ask for fewer pictures")?;
        let aspect = f64::from(file.settings.width) / f64::from(file.settings.height);
        let (first, about) = match about {
            Some((center, axis)) => (file.camera, Turntable { center: center.into(), axis: axis.into() }),
            None => {
                let first = standing_back(&file.camera, &file.scene, aspect);
                (first, Turntable::of_scene(&file.scene, &first))
            }
        };
        let turn = |k| about.turned(&first, f64::from(k) / f64::from(turns));
        return Ok((0..turns).map(|k| numbers(&turn(k))).collect());
    }
    let path = file.path.ok_or_else(|| {
        errors::value("this scene has no \"animation\"; say cameras=[...] or turntable=24, for example")
    })?;
    let (first, last) = path.ends();
    Ok((first..=last).map(|frame| numbers(&path.camera(frame))).collect())
}
