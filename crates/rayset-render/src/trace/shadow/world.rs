//! The scene as shadow rays see it; it is constant for a given scene and lights.

use super::table::DeepShadowMap;
use crate::field::SimdLevel;
use crate::scene::{Light, LightKind, Lighting, RenderSettings, Scene, Shadows};
use crate::trace::RenderError;
use crate::trace::composite::Absorption;
use crate::trace::predict::Foresight;
use crate::trace::program::{Program, Purpose};
use crate::trace::steps::StepRule;
use rayset_base::geometry::DVec3;
use rayset_files::PagedFiles;

/// A light that casts shadows.
pub(super) struct LightWithShadows {
    pub(super) light: Light,
    /// The direction to it, of length one, if it is the same everywhere; world space.
    pub(super) direction: Option<DVec3>,
    /// Its deep shadow map; `None` if its shadows are computed exactly.
    pub(super) table: Option<DeepShadowMap>,
}

/// The scene as shadow rays see it.
pub(in crate::trace) struct ShadowWorld {
    /// The graph, compiled for its opacity only.
    pub(in crate::trace) program: Program,
    pub(super) steps: StepRule,
    pub(super) absorption: Absorption,
    /// What its rays are expected to need.
    pub(in crate::trace) foresight: Foresight,
    /// In the order of the scene's lights; `None` for those that cast no shadows.
    pub(super) lights: Vec<Option<LightWithShadows>>,
}

impl ShadowWorld {
    /// `None` if no light casts shadows. Step rule and absorption are those of the rays from the
    /// eye.
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
        let program = Program::compile(scene, Purpose::Shadow, simd).open(paged)?;
        let bounds = scene.root.bounds();
        let table = |light: &Light| match settings.shadows {
            Shadows::Cached { resolution } => DeepShadowMap::new(light, &bounds, resolution, &paged.pages),
            Shadows::Exact => None,
        };
        let lights = lights.iter().map(|light| {
            let direction = match light.kind {
                LightKind::Directional { direction } => Some(-direction.normalize()),
                _ => None,
            };
            light.throws_shadows().then(|| LightWithShadows { light: *light, direction, table: table(light) })
        });
        let foresight = Foresight::new(&program, absorption.stop_transmittance);
        Ok(Some(Self { program, steps: steps.clone(), absorption, foresight, lights: lights.collect() }))
    }
}
