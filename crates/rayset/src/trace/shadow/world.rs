//! What shadow rays are traced through: fixed as long as scene and lights are.

use super::table::DeepShadowMap;
use crate::field::SimdLevel;
use crate::scene::Light;
use crate::scene::{Lighting, RenderSettings, Scene, Shadows};
use crate::trace::RenderError;
use crate::trace::composite::Absorption;
use crate::trace::program::{Program, Purpose};
use crate::trace::steps::StepRule;
use crate::working_set::PagedFiles;

/// A light that throws shadows.
pub(super) struct LightWithShadows {
    pub(super) light: Light,
    /// Where they are looked up; `None` if they are exact.
    pub(super) table: Option<DeepShadowMap>,
}

/// A scene as shadow rays see it.
pub(in crate::trace) struct ShadowWorld {
    /// The graph, for its opacity alone.
    pub(super) program: Program,
    pub(super) steps: StepRule,
    pub(super) absorption: Absorption,
    /// By their numbers in the scene; `None` for those that throw no shadows.
    pub(super) lights: Vec<Option<LightWithShadows>>,
}

impl ShadowWorld {
    /// `None` if no light throws shadows. Steps and absorption are those of the rays from the eye.
    pub(in crate::trace) fn compile(
        scene: &Scene,
        settings: &RenderSettings,
        simd: SimdLevel,
        paged: &PagedFiles,
        steps: &StepRule,
        absorption: Absorption,
    ) -> Result<Option<Self>, RenderError> {
        let Lighting::Lit(lights) = &scene.lighting else { return Ok(None) };
        if !scene.lighting.throws_shadows() {
            return Ok(None);
        }
        let program = Program::compile(scene, Purpose::Shadow, simd, paged)?;
        let bounds = scene.root.bounds();
        let table = |light: &Light| match settings.shadows {
            Shadows::Cached { resolution } => DeepShadowMap::new(light, &bounds, resolution, &paged.pages),
            Shadows::Exact => None,
        };
        let lights = lights.iter().map(|light| {
            light.throws_shadows().then(|| LightWithShadows { light: *light, table: table(light) })
        });
        Ok(Some(Self { program, steps: steps.clone(), absorption, lights: lights.collect() }))
    }
}
