//! Pictures in parts, which are rendered by several processes and joined by one; and the cameras of turntables and animations.

use std::collections::HashMap;
use std::sync::Arc;

use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::PyBytes;
use rayset::image::{DisplayTransform, ToneMapping};
use rayset::parts::{Joined, Part, PartError, PartOptions, Share};
use rayset::scene::{Camera, Projection};
use rayset::storage::{MemoryStorage, Storage};
use rayset::{CancelToken, SimdLevel};
use rayset_inputs::look::turned;

use crate::errors;
use crate::image::Picture;
use crate::render::{self, Job, Session};
use crate::wait::{self, Progress};

/// Most pixels of a part that are held while it is rendered; with layers they take 15 MiB.
const HELD_PIXELS: u64 = 1 << 18;

/// Names of the vector instructions of this processor, the best first, and whether they are of the class with fused multiply–add.
#[pyfunction]
pub(crate) fn instructions() -> Vec<(&'static str, bool)> {
    SimdLevel::available().into_iter().map(|level| (level.name(), level.is_fused())).collect()
}

/// How the picture is displayed, which is in each part besides pixels.
fn note(display: DisplayTransform) -> Vec<u8> {
    let mut bytes = display.exposure.to_le_bytes().to_vec();
    bytes.push(u8::from(display.tone_mapping == ToneMapping::Filmic));
    bytes
}

fn display(note: &[u8]) -> Option<DisplayTransform> {
    let (exposure, tone_mapping) = note.split_at_checked(8)?;
    let tone_mapping = match tone_mapping {
        [0] => ToneMapping::None,
        [1] => ToneMapping::Filmic,
        _ => return None,
    };
    Some(DisplayTransform { exposure: f64::from_le_bytes(exposure.try_into().ok()?), tone_mapping })
}

/// Renders share `number` of `of` of a picture. Returns the bytes of the part.
#[pyfunction]
pub(crate) fn render_part<'py>(
    py: Python<'py>,
    session: &Session,
    job: Job,
    share: (u32, u32),
    told: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyBytes>> {
    let (number, of) = share;
    let share = Share::new(number, of);
    let share = share.ok_or_else(|| errors::value(format!("there is no part {number} of {of}")))?;
    let engine = session.engine(py)?;
    let wanted = job.without_python();
    let (cancel, progress) = (CancelToken::new(), Progress::default());
    let work = || {
        let shot = session.shot(&engine, &wanted)?;
        let options = PartOptions::new(share).with_note(note(shot.display)).with_held_pixels(HELD_PIXELS);
        let mut bytes = Vec::new();
        let mut tell = |done, total| progress.set("tracing", done, total);
        shot.view()?.render_part(&shot.region, &options, &cancel, &mut tell, &mut bytes)?;
        Ok(bytes)
    };
    let bytes = wait::run(py, &cancel, &progress, told, work)?;
    bytes.map(|bytes| PyBytes::new(py, &bytes)).map_err(|failure| render::raised(py, failure))
}

/// Joins the parts of a picture, each with a name for messages.
#[pyfunction]
pub(crate) fn join_parts(py: Python<'_>, parts: Vec<(String, PyBackedBytes)>) -> PyResult<Picture> {
    let joined = py.detach(|| {
        let parts = parts.into_iter().map(|(name, bytes)| {
            let storage: Arc<dyn Storage> = Arc::new(MemoryStorage::new(Arc::new(bytes)));
            Part::from_storage(&name, storage)
        });
        // Pictures are the caller's, and no budget counts them.
        let joined = Joined::join(parts, u64::MAX)?;
        let region = joined.region();
        Ok(Picture {
            picture: joined.picture()?,
            display: display(joined.note()).unwrap_or_default(),
            corner: (region.columns.start, region.rows.start),
            whole: joined.size(),
        })
    });
    joined.map_err(|error: PartError| errors::of_part(py, error))
}

/// The numbers of a camera by the keys that scenes have for them; those of one number have a list of one.
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

/// The cameras of a turntable of so many pictures, or else of the animation of the scene: of all its frames.
#[pyfunction]
pub(crate) fn cameras(
    py: Python<'_>,
    job: Job,
    turntable: Option<u32>,
) -> PyResult<Vec<HashMap<&'static str, Vec<f64>>>> {
    let wanted = job.without_python();
    let file = py.detach(|| wanted.parsed()).map_err(|failure| render::raised(py, failure))?;
    if let Some(turns) = turntable {
        let turn = |k| turned(&file.camera, &file.scene, f64::from(k) / f64::from(turns));
        return Ok((0..turns).map(|k| numbers(&turn(k))).collect());
    }
    let path = file.path.ok_or_else(|| {
        errors::value("this scene has no \"animation\"; say cameras=[...] or turntable=24, for example")
    })?;
    let (first, last) = path.ends();
    Ok((first..=last).map(|frame| numbers(&path.camera(frame))).collect())
}
