//! The rule by which samples share shadows.

/// Samples of a ray that share the shadows of one of them: of eight in a row by their numbers, of
/// one step, those behind one that has shadows of its own, as long as they are at most 1/64 of the
/// pixel.
#[derive(Default)]
pub(super) struct SharedShadows {
    /// The number of its first sample over 8, and the step.
    run: Option<(u64, f64)>,
    left: f64,
    /// Whether the present sample takes them from the one before.
    pub(super) are_taken: bool,
    /// For each light, what of it reached the last sample with shadows of its own.
    pub(super) reaching: Vec<f64>,
}

impl SharedShadows {
    /// Advances to a sample that is not transparent, by its number among those of its step, of a
    /// given share of its pixel.
    pub(super) fn comes_to(&mut self, (number, step): (u64, f64), share: f64) {
        let run = Some((number / 8, step));
        self.are_taken = self.run == run && share <= self.left;
        if self.are_taken {
            self.left -= share;
        } else {
            (self.run, self.left) = (run, 1.0 / 64.0);
        }
    }
}
