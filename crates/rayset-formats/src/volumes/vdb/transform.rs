//! The place of a grid in its space.

use super::stream::{Stream, Wrong};
use rayset_base::geometry::{DAffine3, DMat3, DVec3};

/// Reads the map from the coordinates of voxels to space.
pub(super) fn read(stream: &mut Stream) -> Result<DAffine3, Wrong> {
    let at = stream.at();
    let kind = stream.text(256)?;
    Ok(match kind.as_str() {
        "UniformScaleMap" | "ScaleMap" => {
            // Values that follow from the scales are stored behind them.
            let [scale, ..] = vectors::<5>(stream)?;
            DAffine3::from_scale(scale)
        }
        "UniformScaleTranslateMap" | "ScaleTranslateMap" => {
            let [translation, scale, ..] = vectors::<6>(stream)?;
            DAffine3::from_mat3_translation(DMat3::from_diagonal(scale), translation)
        }
        "TranslationMap" => {
            let [translation] = vectors::<1>(stream)?;
            DAffine3::from_translation(translation)
        }
        // Rows are stored, and vectors are multiplied from the left, so a row is the image of an
        // axis.
        "AffineMap" | "UnitaryMap" => {
            let m: [f64; 16] = stream.doubles()?;
            let row = |r: usize| DVec3::new(m[4 * r], m[4 * r + 1], m[4 * r + 2]);
            DAffine3::from_mat3_translation(DMat3::from_cols(row(0), row(1), row(2)), row(3))
        }
        _ => {
            let what = format!(
                "the grid is placed by a `{kind}`, and linear maps alone are read; resample it into a linear \
                 transform, as Houdini's VDB Resample does"
            );
            return Err(Wrong { at, what });
        }
    })
}

fn vectors<const N: usize>(stream: &mut Stream) -> Result<[DVec3; N], Wrong> {
    let mut all = [DVec3::ZERO; N];
    for one in &mut all {
        *one = DVec3::from_array(stream.doubles()?);
    }
    Ok(all)
}
