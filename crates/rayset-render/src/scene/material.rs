//! Materials: how volume objects respond to light.

use super::SceneError;

/// How a volume object responds to light. Local shading is Blinn's (1977): with N the shading
/// vector, L the direction to the light, and H halfway between L and the direction to the eye, a
/// light adds `color·diffuse·|N·L| + specular·|N·H|^shininess`. Both sides of a surface are lit
/// alike.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Factor for ambient light, times the object's colour.
    pub ambient: f64,
    /// Factor for diffusely scattered light, times the object's colour.
    pub diffuse: f64,
    /// Factor for the specular highlight, which has the colour of the light.
    pub specular: f64,
    /// Exponent of the specular highlight.
    pub shininess: f64,
    /// Fraction of light that comes from the mirror direction, 0 to 1.
    pub reflectance: f64,
    /// Refractive index. If it differs from 1, rays are refracted by Snell's law where they enter
    /// and leave the object.
    pub refractive_index: f64,
}

impl Default for Material {
    /// A matte material with a faint highlight, without mirror reflection or refraction.
    fn default() -> Self {
        Self {
            ambient: 0.25,
            diffuse: 0.75,
            specular: 0.10,
            shininess: 32.0,
            reflectance: 0.0,
            refractive_index: 1.0,
        }
    }
}

impl Material {
    /// The values in the order of the fields.
    #[must_use]
    pub fn to_array(&self) -> [f64; 6] {
        [self.ambient, self.diffuse, self.specular, self.shininess, self.reflectance, self.refractive_index]
    }

    /// The inverse of [`to_array`](Self::to_array).
    #[must_use]
    pub fn from_array(v: [f64; 6]) -> Self {
        let [ambient, diffuse, specular, shininess, reflectance, refractive_index] = v;
        Self { ambient, diffuse, specular, shininess, reflectance, refractive_index }
    }

    pub(super) fn check(&self) -> Result<(), SceneError> {
        let number = |what, value: f64, fits: bool, expected| {
            if fits { Ok(()) } else { Err(SceneError::Number { what, value, expected }) }
        };
        let part = |v: f64| (0.0..=1000.0).contains(&v);
        number("ambient", self.ambient, part(self.ambient), "0 to 1000")?;
        number("diffuse", self.diffuse, part(self.diffuse), "0 to 1000")?;
        number("specular", self.specular, part(self.specular), "0 to 1000")?;
        number("shininess", self.shininess, (0.0..=1e4).contains(&self.shininess), "0 to 10000")?;
        number("reflectance", self.reflectance, (0.0..=1.0).contains(&self.reflectance), "0 to 1")?;
        let index = self.refractive_index;
        number("refractive index", index, (0.1..=10.0).contains(&index), "0.1 to 10")
    }
}
