//! A scene compiled for tracing: immutable, shared by all threads.

use super::RenderError;
use super::bounce::Bounces;
use super::composite::Absorption;
use super::display_values::{all_from_linear, pixel_to_linear};
use super::predict::Foresight;
use super::program::Program;
use super::ray_tree::PixelLight;
use super::shade::Shader;
use super::shadow::ShadowWorld;
use super::steps::StepRule;
use crate::field::SimdLevel;
use crate::scene::{Compositing, Lighting, RenderSettings, Scene};
use rayset_files::PagedFiles;

/// Everything that a thread needs to trace a packet.
pub(super) struct World {
    pub(super) program: Program,
    /// `None` if no light casts shadows.
    pub(super) shadows: Option<ShadowWorld>,
    pub(super) shader: Shader,
    pub(super) steps: StepRule,
    pub(super) absorption: Absorption,
    /// What rays are expected to need.
    pub(super) foresight: Foresight,
    /// `None` if no ray is reflected or refracted.
    pub(super) bounces: Option<Bounces>,
    /// Whether layers are recorded besides the colour of pixels, and whether all of them are.
    pub(super) layers: bool,
    pub(super) all_layers: bool,
    /// The number of the attribute of that name, if it is gathered: with layers, and where rays are
    /// not turned.
    pub(super) lump_opacity: Option<usize>,
    /// As it is composited.
    pub(super) background: Option<[f32; 3]>,
    compositing: Compositing,
}

impl World {
    /// Compiles a scene that has been checked.
    pub(super) fn compile(
        scene: &Scene,
        settings: &RenderSettings,
        simd: SimdLevel,
        paged: &PagedFiles,
    ) -> Result<Self, RenderError> {
        let program = Program::compile_seen(scene, (settings.purpose(), settings.lod), simd).open(paged)?;
        let shader = Shader::new(scene, program.constants, simd);
        let absorption = Absorption {
            unit_distance: scene.unit_distance,
            stop_transmittance: f64::from(settings.stop_transmittance),
            simd,
        };
        let steps = StepRule::new(&program, settings, None)?;
        let bounces = Bounces {
            turns: program.turns(),
            max_depth: settings.max_depth,
            reach_world: scene.unit_distance,
            boundary_steps: steps.boundary_steps(),
        };
        let turn_rays = bounces.turns.any() && bounces.max_depth > 0 && scene.lighting != Lighting::Unlit;
        let (compositing, layers) = (scene.compositing, settings.records_layers());
        let lump_opacity = program.lump_opacity.filter(|_| layers || !turn_rays);
        Ok(Self {
            shadows: ShadowWorld::compile(scene, settings, simd, paged, &steps, absorption)?,
            bounces: turn_rays.then_some(bounces),
            steps,
            foresight: Foresight::new(&program, absorption.stop_transmittance),
            program,
            shader,
            absorption,
            layers,
            lump_opacity,
            all_layers: settings.layers,
            background: scene.background.map(|mut color| {
                if compositing == Compositing::Display {
                    all_from_linear(&mut color);
                }
                color
            }),
            compositing,
        })
    }

    /// What a ray from the eye sees, in linear light, of what was composited.
    pub(super) fn pixel(&self, seen: &PixelLight) -> [f32; 4] {
        let pixel = seen.pixel(self.background);
        match self.compositing {
            Compositing::Linear => pixel,
            Compositing::Display => pixel_to_linear(pixel),
        }
    }
}
