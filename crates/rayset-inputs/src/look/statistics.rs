//! What a sample of points says about a cloud.

use std::sync::{Arc, OnceLock};

use anyhow::Result;
use rayset::Cloud;
use rayset::file::Header;
use rayset::geometry::DVec3;
use rayset::points::{PointBatch, Schema};

/// Points of a sample: enough for percentiles to a hundredth, few enough for the smallest memory
/// budgets.
const SAMPLE_POINTS: usize = 1 << 14;

/// A sample of a cloud's points. Cheap to clone.
#[derive(Clone)]
pub(super) struct Statistics {
    sample: Arc<Sample>,
    /// Radii are those of the sample, times this.
    radius_scale: f64,
}

struct Sample {
    batch: PointBatch,
    schema: Schema,
    /// Of the cloud.
    points: u64,
    /// By what the density of the sample has to be multiplied.
    stride: u64,
    /// See [`Statistics::number_densities`].
    densities: OnceLock<Vec<(usize, f64)>>,
}

impl Statistics {
    pub(super) fn of(cloud: &Cloud) -> Result<Self> {
        let (batch, schema) = (cloud.sample(SAMPLE_POINTS)?, cloud.sample_schema());
        let stride = cloud.sample_stride(SAMPLE_POINTS);
        let points = cloud.header().points;
        let sample = Sample { batch, schema, points, stride, densities: OnceLock::new() };
        Ok(Self { sample: Arc::new(sample), radius_scale: 1.0 })
    }

    /// The same points with other radii.
    pub(super) fn with_radius_scale(&self, factor: f64) -> Self {
        Self { sample: self.sample.clone(), radius_scale: factor }
    }

    /// The values of a column of the sample, point by point.
    fn column(&self, column: usize) -> impl Iterator<Item = f64> + '_ {
        let Sample { batch, schema, .. } = &*self.sample;
        let scale = if schema.columns[column].name == "radius" { self.radius_scale } else { 1.0 };
        (0..batch.len()).map(move |i| batch.columns[column].get(i) * scale)
    }

    /// How many points the cloud has.
    pub(super) fn points(&self) -> f64 {
        self.sample.points as f64
    }

    pub(super) fn positions(&self) -> impl Iterator<Item = DVec3> + '_ {
        self.sample.batch.position.iter().map(|&p| DVec3::from_array(p))
    }

    /// The finite values of a column, or of a coordinate, in ascending order; empty if there is no
    /// such column.
    pub(super) fn sorted(&self, name: &str) -> Vec<f64> {
        let column = self.sample.schema.columns.iter().position(|column| column.name == name);
        let axis = ["x", "y", "z"].iter().position(|axis| *axis == name);
        let mut values: Vec<f64> = match (column, axis) {
            (Some(column), _) => self.column(column).collect(),
            (None, Some(axis)) => self.sample.batch.position.iter().map(|p| p[axis]).collect(),
            (None, None) => Vec::new(),
        };
        values.retain(|value| value.is_finite());
        values.sort_by(f64::total_cmp);
        values
    }

    /// The values of a column, point by point; empty if there is no such column.
    pub(super) fn values(&self, name: &str) -> Vec<f64> {
        let column = self.sample.schema.columns.iter().position(|column| column.name == name);
        column.map_or_else(Vec::new, |column| self.column(column).collect())
    }

    /// Some points of the sample, and the number of points in a unit of volume around each.
    pub(super) fn number_densities(&self) -> &[(usize, f64)] {
        self.sample.densities.get_or_init(|| self.counted_densities())
    }

    fn counted_densities(&self) -> Vec<(usize, f64)> {
        /// Most points that are asked.
        const ASKED: usize = 1024;
        /// The neighbour whose distance is taken, the point itself being the first.
        const NEIGHBOUR: usize = 8;
        let all: Vec<DVec3> = self.positions().collect();
        if all.len() <= NEIGHBOUR {
            return Vec::new();
        }
        let mut squares = vec![0.0; all.len()];
        all.iter()
            .enumerate()
            .step_by(all.len().div_ceil(ASKED))
            .map(|(i, &p)| {
                squares.iter_mut().zip(&all).for_each(|(square, &q)| *square = (q - p).length_squared());
                let (_, &mut farthest, _) = squares.select_nth_unstable_by(NEIGHBOUR, f64::total_cmp);
                let ball = 4.0 / 3.0 * std::f64::consts::PI * farthest.powf(1.5);
                (i, self.sample.stride as f64 * NEIGHBOUR as f64 / ball)
            })
            .collect()
    }

    /// The share of points of each class of a column, by descending share.
    pub(super) fn classes(&self, name: &str) -> Vec<(f64, f64)> {
        let sorted = self.sorted(name);
        let mut classes: Vec<(f64, f64)> = sorted
            .chunk_by(|a, b| a == b)
            .map(|same| (same[0], same.len() as f64 / sorted.len() as f64))
            .collect();
        classes.sort_by(|a, b| b.1.total_cmp(&a.1));
        classes
    }

    /// The number of different values of a column in the sample.
    pub(super) fn different(&self, name: &str) -> usize {
        self.sorted(name).chunk_by(|a, b| a == b).count()
    }

    /// The largest channels of the points' colours, 0 to 1, as displayed, ascending; without black
    /// ones, which are mostly points without a colour.
    pub(super) fn brightnesses(&self, header: &Header) -> Vec<f64> {
        if !header.has_color {
            return Vec::new();
        }
        let channels = ["red", "green", "blue"].map(|name| self.values(name));
        let mut largest: Vec<f64> = (0..self.sample.batch.len())
            .map(|i| channels.iter().map(|channel| channel[i]).fold(0.0, f64::max) / 255.0)
            .filter(|&largest| largest > 0.0)
            .collect();
        largest.sort_by(f64::total_cmp);
        largest
    }

    /// Whether the cloud has colours, and not all are black.
    pub(super) fn has_colors(&self, header: &Header) -> bool {
        !self.brightnesses(header).is_empty()
    }
}

/// The value below which a fraction of sorted values lies; 0 if there are none.
pub(super) fn percentile(sorted: &[f64], fraction: f64) -> f64 {
    let last = sorted.len().saturating_sub(1) as f64;
    sorted.get((fraction * last).round() as usize).copied().unwrap_or(0.0)
}

/// The values between which all but a fraction at either end lie, apart from each other even if all
/// values are the same.
pub(super) fn range(sorted: &[f64], left_out: f64) -> (f64, f64) {
    let (low, high) = (percentile(sorted, left_out), percentile(sorted, 1.0 - left_out));
    if high > low { (low, high) } else { (low, low + low.abs().max(1.0) * 1e-3) }
}
