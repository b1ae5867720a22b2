//! A scene compiled for tracing: immutable, shared by all threads.

use super::RenderError;
use super::bounce::Bounces;
use super::composite::Absorption;
use super::program::{Program, Purpose};
use super::shade::Shader;
use super::shadow::DeepShadowMap;
use super::steps::StepRule;
use crate::field::SimdLevel;
use crate::scene::{Lighting, RenderSettings, Scene, Shadows};
use crate::working_set::PagedFiles;

/// Everything that a thread needs to trace a packet.
pub(super) struct World {
    pub(super) program: Program,
    /// The same graph, for its opacity alone; `None` where no light throws shadows.
    pub(super) shadow_program: Option<Program>,
    pub(super) shader: Shader,
    /// For each light, where its shadows are looked up; `None` where they are exact or there are none.
    pub(super) light_tables: Vec<Option<DeepShadowMap>>,
    pub(super) steps: StepRule,
    pub(super) absorption: Absorption,
    /// `None` where all rays go straight on.
    pub(super) bounces: Option<Bounces>,
    /// Whether more is asked of pixels than their colour.
    pub(super) layers: bool,
    pub(super) background: Option<[f32; 3]>,
}

impl World {
    /// Compiles a scene that has been checked.
    pub(super) fn compile(
        scene: &Scene,
        settings: &RenderSettings,
        simd: SimdLevel,
        paged: &PagedFiles,
    ) -> Result<Self, RenderError> {
        let purpose = if settings.layers { Purpose::Layers } else { Purpose::Picture };
        let program = Program::compile(scene, purpose, simd, paged)?;
        let shader = Shader::new(&scene.lighting, program.color, program.material);
        let shadow_program = match shader.shadow_lights().next() {
            Some(_) => Some(Program::compile(scene, Purpose::Shadow, simd, paged)?),
            None => None,
        };
        let mut light_tables: Vec<Option<DeepShadowMap>> = (0..shader.lights()).map(|_| None).collect();
        if let Shadows::Cached { resolution } = settings.shadows {
            let bounds = scene.root.bounds();
            for (number, light) in shader.shadow_lights() {
                light_tables[number] = DeepShadowMap::new(light, &bounds, resolution, &paged.pages);
            }
        }
        let absorption = Absorption {
            unit_distance: scene.unit_distance,
            stop_transmittance: f64::from(settings.stop_transmittance),
            simd,
        };
        let bounces = Bounces {
            turns: program.turns(),
            max_depth: settings.max_depth,
            reach_world: scene.unit_distance,
        };
        let turn_rays = bounces.turns.any() && bounces.max_depth > 0 && scene.lighting != Lighting::Unlit;
        Ok(Self {
            bounces: turn_rays.then_some(bounces),
            steps: StepRule::new(&program, settings)?,
            program,
            shadow_program,
            shader,
            light_tables,
            absorption,
            layers: settings.layers,
            background: scene.background,
        })
    }
}
