//! The judge renderer: the same rays, samples, transfer function and light as the ray tracer, over the brute-force field
//! in `f64`. Slow by design; it shares no code with what it judges beyond the description of the scene.

use crate::field::judge::{JudgeField, JudgeSample};
use crate::geometry::Ray;
use crate::scene::{Camera, CameraError, ColorRule, MapInput, RenderSettings, Scene, Shading, headlight};

/// A pixel in linear light, premultiplied, and its opacity.
pub type JudgePixel = [f64; 4];

/// Renders one pixel with a given step, world space.
///
/// # Errors
/// [`CameraError`] where the camera makes no rays.
pub fn pixel(
    scene: &Scene,
    field: &JudgeField,
    camera: &Camera,
    settings: &RenderSettings,
    step_world: f64,
    x: u32,
    y: u32,
) -> Result<JudgePixel, CameraError> {
    let ray = camera.ray_maker(settings.width, settings.height)?.pixel_ray(x, y);
    Ok(trace_ray(scene, field, settings, &ray, settings.phase_of(x, y), step_world))
}

/// Every sample of a ray that any point reaches, front to back.
fn trace_ray(
    scene: &Scene,
    field: &JudgeField,
    settings: &RenderSettings,
    ray: &Ray,
    phase: f64,
    step: f64,
) -> JudgePixel {
    let near = field.near(ray);
    let (mut first, mut last) = (f64::INFINITY, 0.0_f64);
    for p in &near.points {
        let t = (p.position - ray.origin).dot(ray.direction);
        first = first.min(t - p.radius);
        last = last.max(t + p.radius);
    }
    let (mut color, mut transmittance) = ([0.0; 3], 1.0);
    let mut j = ((first / step - phase).floor() - 1.0).max(0.0);
    while (j + phase) * step <= last + step {
        let sample = near.sample(ray.at((j + phase) * step));
        j += 1.0;
        let passed = (-scene.transfer.extinction(sample.density) * step).exp();
        if passed >= 1.0 {
            continue;
        }
        let lit = lit(scene, ray, &sample);
        for channel in 0..3 {
            color[channel] += transmittance * (1.0 - passed) * lit[channel];
        }
        transmittance *= passed;
        if transmittance < f64::from(settings.stop_transmittance) {
            break;
        }
    }
    match scene.background {
        Some(b) => {
            let behind = |c: usize| color[c] + transmittance * f64::from(b[c]);
            [behind(0), behind(1), behind(2), 1.0]
        }
        None => [color[0], color[1], color[2], 1.0 - transmittance],
    }
}

fn lit(scene: &Scene, ray: &Ray, sample: &JudgeSample) -> [f64; 3] {
    let weight = scene.cloud.header().weight;
    let least = 1e-12 * f64::from(weight.max().abs().max(weight.min().abs()));
    let mean = |channel: usize| {
        if sample.density.abs() > least { sample.attribute[channel] / sample.density } else { 0.0 }
    };
    let color = match &scene.transfer.color {
        ColorRule::Uniform(c) => c.map(f64::from),
        ColorRule::Points => [mean(0), mean(1), mean(2)],
        ColorRule::Map { map, input, range: (low, high) } => {
            let value = if matches!(input, MapInput::Attribute(_)) { mean(0) } else { sample.density };
            map.display_color((value - low) / (high - low)).map(crate::field::linear_from_srgb)
        }
    };
    if scene.shading == Shading::None {
        return color;
    }
    let length = sample.gradient.length();
    let cosine = if length > 0.0 { (sample.gradient.dot(ray.direction) / length).abs() } else { 0.0 };
    let specular = f64::from(headlight::SPECULAR) * cosine.powi(32);
    color.map(|v| v * (f64::from(headlight::AMBIENT) + f64::from(headlight::DIFFUSE) * cosine) + specular)
}
