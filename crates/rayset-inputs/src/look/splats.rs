//! What is particular to Gaussian splats: their filter, and the steps of those that are filtered.

use rayset::geometry::DVec3;
use rayset::scene::SplatFilter;
use serde_json::{Value, json};

/// Steps as a part of the mean radius, or of a pixel where that is larger.
pub(super) const STEP: f64 = 0.05;

/// The filter of splats whose weights are opacities, by what the files that they are from say of
/// how they were trained; `None` of points that are none of these.
pub(super) fn filter_of(sources: &[String]) -> Option<SplatFilter> {
    // Before it stand the comments of a file, which may be anything.
    let own = sources.iter().filter_map(|said| Some(said.rsplit_once("Gaussian splats, ")?.1));
    let mut own = own.peekable();
    own.peek()?;
    let is_mip = own.all(|said| said.contains(", antialiased"));
    Some(if is_mip { SplatFilter::Mip } else { SplatFilter::Dilated })
}

/// Makes the steps of filtered splats longer where pixels are larger than they are: seen from afar,
/// as where a few points are astray, each is as wide as a pixel, and takes no more samples for it.
/// `points` are those that are framed, and `height` is that of the picture in pixels.
pub(super) fn lengthen_steps(scene: &mut Value, points: &[(DVec3, f64)], height: u32, mean_radius: f64) {
    let camera = &scene["camera"];
    let length = match camera["height"].as_f64() {
        Some(length) => length,
        None => {
            let at = [0, 1, 2].map(|axis| camera["position"][axis].as_f64().unwrap_or(0.0));
            let eye = DVec3::from_array(at);
            let mut distances: Vec<f64> = points.iter().map(|(point, _)| point.distance(eye)).collect();
            let middle = distances.len() / 2;
            if distances.is_empty() {
                return;
            }
            let (_, &mut distance, _) = distances.select_nth_unstable_by(middle, f64::total_cmp);
            2.0 * distance * (0.5 * camera["fovy"].as_f64().unwrap_or(0.0).to_radians()).tan()
        }
    };
    let pixel = length / f64::from(height.max(1));
    if pixel > mean_radius && pixel.is_finite() {
        scene["rendering"]["step"] = json!(STEP * pixel);
        if let Some(rendering) = scene["rendering"].as_object_mut() {
            rendering.remove("stepFraction");
        }
    }
}
