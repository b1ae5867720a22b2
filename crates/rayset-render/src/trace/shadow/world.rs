//! The scene as shadow rays see it; it is constant for a given scene and lights.

use super::map::LightMap;
use super::place::BoundaryReach;
use super::sights::{LightSight, Octaves, sees_from_afar};
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
    /// Of rays that see every point.
    pub(super) steps: StepRule,
    /// How rays from samples see what is far.
    pub(super) octaves: Octaves,
    pub(super) absorption: Absorption,
    pub(super) reach: BoundaryReach,
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
        let program = Program::compile_seen(scene, (Purpose::Shadow, settings.lod), simd).open(paged)?;
        let bounds = scene.root.bounds();
        let table = |light: &Light| {
            let Shadows::Cached { resolution } = settings.shadows else { return Ok(None) };
            let Some(map) = LightMap::new(light, &bounds, resolution) else { return Ok(None) };
            let seen = map.sights().filter(|_| sees_from_afar(&program));
            let seen = seen.map(|sight| LightSight::new(&program, settings, sight));
            let sights = seen.collect::<Result<_, RenderError>>()?;
            Ok::<_, RenderError>(Some(DeepShadowMap::new(map, sights, &paged.pages)))
        };
        let lights = lights.iter().map(|light| {
            if !light.throws_shadows() {
                return Ok(None);
            }
            let direction = match light.kind {
                LightKind::Directional { direction } => Some(-direction.normalize()),
                _ => None,
            };
            Ok(Some(LightWithShadows { light: *light, direction, table: table(light)? }))
        });
        Ok(Some(Self {
            lights: lights.collect::<Result<_, RenderError>>()?,
            steps: steps.clone(),
            octaves: Octaves::new(&program, settings, &bounds)?,
            absorption,
            reach: BoundaryReach { steps: steps.boundary_steps(), solid_world: scene.unit_distance },
            foresight: Foresight::new(&program, absorption.stop_transmittance),
            program,
        }))
    }
}
