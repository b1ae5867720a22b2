//! Camera paths: cameras are given at some frames and interpolated at the others.

use super::{Camera, Projection};
use rayset_base::geometry::DVec3;

/// Widest field of view that interpolation may produce, in radians.
const WIDEST: f64 = 179.0 / 180.0 * std::f64::consts::PI;

/// Cameras at certain frames of a sequence. Between them, position, target, up vector and field of
/// view (or height) follow cubic Hermite curves whose slope at a frame is that between its
/// neighbours (Catmull and Rom 1974, for uneven spacing).
#[derive(Clone, Debug, PartialEq)]
pub struct CameraPath {
    keys: Vec<(u32, Camera)>,
}

/// Why cameras do not form a path.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PathError {
    /// There are no cameras.
    #[error("a path needs at least one camera")]
    Empty,
    /// Frames are not in ascending order.
    #[error("frame {0} does not come after the one before it")]
    Order(u32),
    /// The cameras are not all of the same projection.
    #[error("the camera of frame {0} is of another type than the first")]
    Projection(u32),
}

impl CameraPath {
    /// A path through cameras with their frames, which must be in ascending order and of the same
    /// projection.
    ///
    /// # Errors
    /// [`PathError`] if they are not, or if there are none.
    pub fn new(keys: Vec<(u32, Camera)>) -> Result<Self, PathError> {
        let (_, first) = keys.first().ok_or(PathError::Empty)?;
        let kind = std::mem::discriminant(&first.projection);
        if let Some((frame, _)) = keys.iter().find(|(_, c)| std::mem::discriminant(&c.projection) != kind) {
            return Err(PathError::Projection(*frame));
        }
        match keys.windows(2).find(|pair| pair[0].0 >= pair[1].0) {
            Some(pair) => Err(PathError::Order(pair[1].0)),
            None => Ok(Self { keys }),
        }
    }

    /// The first and the last frame.
    #[must_use]
    pub fn ends(&self) -> (u32, u32) {
        let frame = |key: Option<&(u32, Camera)>| key.map_or(0, |key| key.0);
        (frame(self.keys.first()), frame(self.keys.last()))
    }

    /// The camera of a frame; constant before the first frame and after the last.
    #[must_use]
    pub fn camera(&self, frame: u32) -> Camera {
        let after = self.keys.partition_point(|key| key.0 <= frame).clamp(1, self.keys.len());
        let (from, to) = (after - 1, after.min(self.keys.len() - 1));
        let (start, end) = (&self.keys[from], &self.keys[to]);
        if from == to || frame <= start.0 {
            return start.1;
        }
        let length = f64::from(end.0 - start.0);
        let t = f64::from(frame - start.0) / length;
        let projection = match start.1.projection {
            Projection::Perspective { .. } => {
                let fovy = self.between(from, to, t, length, |c| DVec3::splat(extent(c))).x;
                Projection::Perspective { fovy: fovy.clamp(1e-5, WIDEST) }
            }
            Projection::Orthographic { .. } => {
                let height = self.between(from, to, t, length, |c| DVec3::splat(extent(c))).x;
                Projection::Orthographic { height: height.max(f64::MIN_POSITIVE) }
            }
        };
        let position = self.between(from, to, t, length, |c| c.position);
        let target = self.between(from, to, t, length, |c| c.position + c.direction);
        let up = self.between(from, to, t, length, |c| c.up.normalize_or(DVec3::Y));
        Camera { position, direction: target - position, up, projection }
    }

    /// A quantity at the fraction `t` of the interval between two keys.
    fn between(&self, from: usize, to: usize, t: f64, length: f64, of: impl Fn(&Camera) -> DVec3) -> DVec3 {
        let (a, b) = (of(&self.keys[from].1), of(&self.keys[to].1));
        // Slope per frame, times the number of frames between the two keys.
        let slope = |key: usize| {
            let (before, after) = (key.saturating_sub(1), (key + 1).min(self.keys.len() - 1));
            let frames = f64::from(self.keys[after].0 - self.keys[before].0);
            (of(&self.keys[after].1) - of(&self.keys[before].1)) * (length / frames)
        };
        let (t2, t3) = (t * t, t * t * t);
        a * (2.0 * t3 - 3.0 * t2 + 1.0)
            + slope(from) * (t3 - 2.0 * t2 + t)
            + b * (3.0 * t2 - 2.0 * t3)
            + slope(to) * (t3 - t2)
    }
}

/// The field of view or the height of the picture.
fn extent(camera: &Camera) -> f64 {
    match camera.projection {
        Projection::Perspective { fovy } => fovy,
        Projection::Orthographic { height } => height,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn key(frame: u32, x: f64, fovy: f64) -> (u32, Camera) {
        (frame, Camera::look_at(DVec3::new(x, 1.0, 5.0), DVec3::ZERO, DVec3::Y, fovy))
    }

    #[test]
    fn keys_have_their_cameras_and_the_rest_stands_still() {
        let keys = vec![key(3, 0.0, 0.5), key(10, 2.0, 0.6), key(40, -1.0, 0.4)];
        let path = CameraPath::new(keys.clone()).expect("a path");
        for (frame, camera) in &keys {
            assert!((path.camera(*frame).position - camera.position).length() < 1e-12);
        }
        assert_eq!(path.ends(), (3, 40));
        assert_eq!(path.camera(0), path.camera(3));
        assert_eq!(path.camera(99), path.camera(40));
        assert!(matches!(CameraPath::new(vec![]), Err(PathError::Empty)));
        assert!(matches!(CameraPath::new(vec![keys[1], keys[0]]), Err(PathError::Order(3))));
    }

    proptest! {
        #[test]
        fn even_motion_along_a_line_stays_even(frames in proptest::collection::btree_set(0_u32..200, 2..6), speed in -3.0_f64..3.0) {
            let keys: Vec<_> = frames.iter().map(|&f| key(f, speed * f64::from(f), 0.7)).collect();
            let path = CameraPath::new(keys).expect("a path");
            let (first, last) = path.ends();
            for frame in first..=last {
                let camera = path.camera(frame);
                prop_assert!((camera.position.x - speed * f64::from(frame)).abs() < 1e-9);
                prop_assert!((camera.position + camera.direction).length() < 1e-9);
            }
        }
    }
}
