//! Camera, image and render settings of a scene file.

use super::error::SceneFileError;
use super::reader::{Cursor, Object};
use crate::image::{DisplayTransform, ToneMapping};
use crate::scene::{
    Camera, CameraPath, Compositing, Lod, Projection, RenderSettings, SHORTEST, SampleOffset, Samples,
    Sampling, Shadows, Step,
};
use rayset_base::geometry::{Aabb, DVec3};

/// Most cameras of an animation.
const MOST_KEYS: usize = 16_384;

/// Default width and height of a picture in pixels.
const SIZE: u32 = 512;

/// Default resolution of the tables of shadows. They are the default, with and without settings
/// under `rendering`.
const SHADOW_RESOLUTION: u32 = 512;

pub(super) fn settings(file: &Object<'_>) -> Result<(RenderSettings, DisplayTransform), SceneFileError> {
    let shadows = Shadows::Cached { resolution: SHADOW_RESOLUTION };
    let mut settings = RenderSettings { width: SIZE, height: SIZE, shadows, ..RenderSettings::default() };
    let mut display_transform = DisplayTransform::default();
    if let Some(at) = file.get("image") {
        let image = at.object(&["size", "samples", "pattern", "exposure", "toneMapping"])?;
        if let Some(at) = image.get("size") {
            let sides = at.list(usize::MAX)?;
            let [width, height] = sides.as_slice() else {
                return Err(at.expected("width and height, like [1024, 768]"));
            };
            (settings.width, settings.height) = (width.whole(1, 1 << 20)?, height.whole(1, 1 << 20)?);
        }
        settings.samples = image.read_or("samples", Samples::Fixed(1), samples)?;
        let patterns = [("fixed", Sampling::Fixed), ("stratified", Sampling::Stratified)];
        settings.sampling = image.read_or("pattern", Sampling::Fixed, |at| at.one_of(&patterns))?;
        display_transform.exposure = image.read_or("exposure", 0.0, |at| at.number(-32.0, 32.0))?;
        settings.samples = settings.samples.shown_with(display_transform.exposure);
        let mappings = [("none", ToneMapping::None), ("filmic", ToneMapping::Filmic)];
        display_transform.tone_mapping =
            image.read_or("toneMapping", ToneMapping::None, |at| at.one_of(&mappings))?;
    }
    if let Some(at) = file.get("rendering") {
        let known = [
            "step",
            "stepFraction",
            "phase",
            "stopTransmittance",
            "unitDistance",
            "compositing",
            "shadows",
            "shadowResolution",
            "maxDepth",
            "ambientOcclusion",
            "capResolution",
            "lod",
        ];
        let rendering = at.object(&known)?;
        settings.step = step(&rendering)?;
        let phases = [("half", SampleOffset::Half), ("hashed", SampleOffset::Hashed)];
        settings.sample_offset =
            rendering.read_or("phase", settings.sample_offset, |at| at.one_of(&phases))?;
        let stop = rendering.read_or("stopTransmittance", 0.01, |at| at.number(0.0, 0.999))?;
        settings.stop_transmittance = stop as f32;
        settings.max_depth = rendering.read_or("maxDepth", settings.max_depth, |at| at.whole(0, 16))?;
        let occlusion = rendering.read_or("ambientOcclusion", 0.0, |at| at.number(0.0, 4.0))?;
        settings.ambient_occlusion = occlusion as f32;
        settings.lod = rendering.read_or("lod", settings.lod, lod)?;
        settings.cap_resolution =
            rendering.read_or("capResolution", settings.cap_resolution, |at| at.whole(8, 1024))?;
        let resolution =
            rendering.read_or("shadowResolution", SHADOW_RESOLUTION, |at| at.whole(16, 16384))?;
        let kinds = [("exact", Shadows::Exact), ("cached", Shadows::Cached { resolution })];
        settings.shadows =
            rendering.read_or("shadows", Shadows::Cached { resolution }, |at| at.one_of(&kinds))?;
    }
    Ok((settings, display_transform))
}

/// Rays of a pixel.
fn samples(at: &Cursor<'_>) -> Result<Samples, SceneFileError> {
    match at.value.as_str() {
        Some("auto") => Ok(Samples::Auto { exposure: 0.0 }),
        Some(_) => Err(at.expected("a whole number from 1 to 64 or \"auto\"")),
        None => at.whole(1, 64).map(Samples::Fixed),
    }
}

/// How points are seen from afar.
fn lod(at: &Cursor<'_>) -> Result<Lod, SceneFileError> {
    let known = match at.value.as_str() {
        Some("off") => Some(Lod::Off),
        Some("auto") => Some(Lod::AUTO),
        Some("coarse") => Some(Lod::COARSE),
        Some(_) => None,
        None => at.number(0.0, f64::MAX).ok().and_then(Lod::footprint),
    };
    known.ok_or_else(|| at.expected("\"off\", \"auto\", \"coarse\" or a number from 0.0625 to 64"))
}

fn step(rendering: &Object<'_>) -> Result<Step, SceneFileError> {
    let fraction = rendering.read_or("stepFraction", 0.25, |at| at.number(1e-3, 4.0))?;
    match rendering.get("step") {
        None => Ok(Step::Automatic { fraction }),
        Some(at) if at.value.as_str() == Some("auto") => Ok(Step::Automatic { fraction }),
        Some(at) if at.value.is_number() => Ok(Step::Fixed(at.positive()?)),
        Some(at) => Err(at.expected("a length above 0 or \"auto\"")),
    }
}

/// The place to which errors about a setting refer: its key, otherwise `rendering`, otherwise the
/// whole file.
pub(super) fn in_rendering<'a>(file: &Object<'a>, key: &str) -> Cursor<'a> {
    let rendering = file.get("rendering").unwrap_or_else(|| file.cursor.clone());
    let setting = rendering.any_object().ok().and_then(|rendering| rendering.get(key));
    setting.unwrap_or(rendering)
}

/// The length that opacities refer to: the file's value, otherwise a hundredth of the diagonal of
/// the scene, or 1 if the diagonal is not finite and positive.
pub(super) fn unit_distance(file: &Object<'_>, bounds: &Aabb) -> Result<f64, SceneFileError> {
    let rendering = file.get("rendering").map(|at| at.any_object()).transpose()?;
    if let Some(at) = rendering.and_then(|rendering| rendering.get("unitDistance")) {
        return at.positive();
    }
    let diagonal = bounds.size().length();
    Ok(if !bounds.is_empty() && diagonal.is_finite() && diagonal > 0.0 { diagonal / 100.0 } else { 1.0 })
}

/// In which values light is added up along rays: linear light, unless the file says otherwise.
pub(super) fn compositing(file: &Object<'_>) -> Result<Compositing, SceneFileError> {
    let Some(at) = file.get("rendering") else { return Ok(Compositing::default()) };
    let kinds = [("linear", Compositing::Linear), ("display", Compositing::Display)];
    at.any_object()?.read_or("compositing", Compositing::default(), |at| at.one_of(&kinds))
}

/// The camera path of an animation, if the file has one.
pub(super) fn path(
    file: &Object<'_>,
    bounds: &Aabb,
    settings: &RenderSettings,
) -> Result<Option<CameraPath>, SceneFileError> {
    let Some(at) = file.get("animation") else { return Ok(None) };
    let keys_at = at.object(&["keys"])?.require("keys")?;
    let mut keys: Vec<(u32, Camera)> = Vec::new();
    for key in keys_at.list(MOST_KEYS)? {
        let object = key.object(&["frame", "camera"])?;
        let frame_at = object.require("frame")?;
        let frame = frame_at.whole(0, 999_999)?;
        if keys.last().is_some_and(|last| last.0 >= frame) {
            return Err(frame_at.error("expected frames in ascending order"));
        }
        object.require("camera")?;
        keys.push((frame, camera(&object, bounds, settings)?));
    }
    CameraPath::new(keys).map(Some).map_err(|e| keys_at.error(e.to_string()))
}

/// The camera of an object, or a default camera that frames `bounds`.
pub(super) fn camera(
    file: &Object<'_>,
    bounds: &Aabb,
    settings: &RenderSettings,
) -> Result<Camera, SceneFileError> {
    let aspect = f64::from(settings.width) / f64::from(settings.height);
    let customary = DVec3::new(-0.15, -0.3, -1.0);
    let bounds = if bounds.is_empty() { Aabb::new(DVec3::ZERO, DVec3::ONE) } else { *bounds };
    let Some(at) = file.get("camera") else {
        return Ok(Camera::framing(&bounds, customary, DVec3::Y, 45_f64.to_radians(), aspect, false));
    };
    let of_type = at.any_object()?.get("type");
    let types = [("perspective", false), ("orthographic", true)];
    let orthographic = of_type.map_or(Ok(false), |at| at.one_of(&types))?;
    let common = ["type", "position", "lookAt", "direction", "up"];
    let own = if orthographic { "height" } else { "fovy" };
    let object = at.object(&[&common[..], &[own]].concat())?;
    let up = object.read_or("up", DVec3::Y, Cursor::direction)?;
    let fovy = object.read_or("fovy", 45.0, |at| at.number(1e-3, 179.0))?.to_radians();
    let (look_at, direction) = (object.get("lookAt"), object.get("direction"));
    if let (Some(at), Some(_)) = (&look_at, &direction) {
        return Err(at.error("\"lookAt\" and \"direction\" exclude each other"));
    }
    let mut camera = match object.get("position") {
        None => {
            if let Some(at) = look_at {
                return Err(at.error("\"lookAt\" needs a \"position\" to look from"));
            }
            let toward = direction.map_or(Ok(customary), |at| at.direction())?;
            Camera::framing(&bounds, toward, up, fovy, aspect, orthographic)
        }
        Some(position) => {
            let position = position.vector()?;
            let direction = match (look_at, direction) {
                (Some(at), _) => {
                    let toward = at.vector()? - position;
                    if toward.length() < SHORTEST {
                        return Err(at.error("the camera stands where it looks at"));
                    }
                    toward
                }
                (None, Some(at)) => at.direction()?,
                (None, None) => bounds.center() - position,
            };
            let projection = if orthographic {
                Projection::Orthographic { height: bounds.size().max_element() }
            } else {
                Projection::Perspective { fovy }
            };
            Camera { position, direction, up, projection }
        }
    };
    if let Some(at) = object.get("height") {
        camera.projection = Projection::Orthographic { height: at.positive()? };
    }
    camera.ray_maker(settings.width, settings.height).map_err(|e| at.error(e.to_string()))?;
    Ok(camera)
}
