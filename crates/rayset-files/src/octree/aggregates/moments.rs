//! Sums over the points of a cell, from which its record is made. Those of two cells merge.

use super::histogram::Masses;
use super::points::Points;
use super::record::Aggregate;

use rayset_base::geometry::{DMat3, DQuat, DVec3, eigenvectors};

/// Most values of a class attribute that are told apart in a cell, by their masses.
const MOST_CLASSES: usize = 64;

/// What the attributes of a cloud are.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Carried {
    pub(super) color: bool,
    /// For each attribute, whether it is a class label.
    pub(super) classes: Vec<bool>,
}

/// The sums of the points of a cell.
#[derive(Clone, Debug)]
pub(super) struct Moments {
    pub(super) points: u64,
    pub(super) mass: f64,
    /// Mean position, by mass; of points without any, that of the first.
    mean: DVec3,
    /// Σ m (p − mean)(p − mean)ᵀ, and the shares of the points' own extents.
    spread: DMat3,
    /// Σ m r².
    radius_squared: f64,
    /// Of linear light, by mass.
    color: DVec3,
    attributes: Vec<Value>,
    pub(super) densities: Masses,
}

/// An attribute of a cell.
#[derive(Clone, Debug)]
enum Value {
    /// The sum, by mass, and the mass of those points that have a value.
    Sum(f64, f64),
    /// Masses by class, in ascending order of the class.
    Classes(Vec<(f32, f64)>),
}

impl Moments {
    /// Those of no points.
    pub(super) fn none(carried: &Carried) -> Self {
        let value =
            |&is_class: &bool| if is_class { Value::Classes(Vec::new()) } else { Value::Sum(0.0, 0.0) };
        Self {
            points: 0,
            mass: 0.0,
            mean: DVec3::ZERO,
            spread: DMat3::ZERO,
            radius_squared: 0.0,
            color: DVec3::ZERO,
            attributes: carried.classes.iter().map(value).collect(),
            densities: Masses::default(),
        }
    }

    /// Adds a point and the half octaves of the densities in it, as far as they are known;
    /// `variance` is that of the kernel.
    pub(super) fn add(&mut self, points: &Points, index: usize, half_octaves: &[Option<i32>], variance: f64) {
        let mass = points.mass(index);
        self.move_mean(points.position[index], mass, 1);
        self.spread += points.extent(index) * (mass * variance);
        self.radius_squared += mass * points.radius_squared(index);
        if let Some(color) = points.color.get(index) {
            self.color += color
                .map(f64::from)
                .iter()
                .zip(DVec3::AXES)
                .fold(DVec3::ZERO, |sum, (v, axis)| sum + axis * *v)
                * mass;
        }
        for (value, column) in self.attributes.iter_mut().zip(&points.attributes) {
            value.add(column[index], mass);
        }
        let known = half_octaves.iter().flatten();
        let each = mass / known.clone().count().max(1) as f64;
        known.for_each(|&at| self.densities.add(at, each));
    }

    /// Adds the points of another cell.
    pub(super) fn merge(&mut self, other: &Self) {
        self.move_mean(other.mean, other.mass, other.points);
        self.spread += other.spread;
        self.radius_squared += other.radius_squared;
        self.color += other.color;
        self.attributes.iter_mut().zip(&other.attributes).for_each(|(value, other)| value.merge(other));
        self.densities.merge(&other.densities);
    }

    /// Moves the mean to that of all mass (Chan, Golub, LeVeque 1979).
    fn move_mean(&mut self, place: DVec3, mass: f64, points: u64) {
        if self.points == 0 {
            self.mean = place;
        }
        self.points += points;
        let all = self.mass + mass;
        if mass > 0.0 {
            let (way, part) = (place - self.mean, mass / all);
            let across = way * (self.mass * part);
            self.spread += DMat3::from_cols(across * way.x, across * way.y, across * way.z);
            self.mean += way * part;
            self.mass = all;
        }
    }

    /// The record, without its places; the densities of `above` are for cells of which none are
    /// known. `None` if there is no mass, or nothing is known of its densities.
    pub(super) fn aggregate(&self, above: &Masses) -> Option<Aggregate> {
        if !(self.mass > 0.0) {
            return None;
        }
        let densities = if self.densities.is_empty() { above.bins() } else { self.densities.bins() }?;
        let (variances, axes) = eigenvectors(&(self.spread * (1.0 / self.mass)));
        Some(Aggregate {
            centroid: self.mean,
            mass: self.mass,
            deviations: variances.to_array().map(|variance| variance.max(0.0).sqrt()),
            rotation: DQuat::from_mat3(&axes).normalize(),
            radius: (self.radius_squared / self.mass).sqrt(),
            densities,
            child_mask: 0,
            cells: 0,
            first_child: 0,
            first_point: 0,
            more_points: 0,
        })
    }

    /// The mean colour, linear light.
    pub(super) fn color(&self) -> [f64; 3] {
        if self.mass > 0.0 { (self.color / self.mass).to_array() } else { [0.0; 3] }
    }

    /// The attributes: means, and of classes those of the largest mass.
    pub(super) fn attributes(&self) -> impl Iterator<Item = f32> + '_ {
        self.attributes.iter().map(|value| match value {
            Value::Sum(sum, mass) if *mass > 0.0 => (sum / mass) as f32,
            Value::Sum(..) => 0.0,
            Value::Classes(classes) => {
                let largest = classes.iter().reduce(|a, b| if b.1 > a.1 { b } else { a });
                largest.map_or(0.0, |(class, _)| *class)
            }
        })
    }
}

impl Value {
    fn add(&mut self, value: f32, mass: f64) {
        match self {
            Self::Sum(sum, of) if value.is_finite() => {
                *sum += mass * f64::from(value);
                *of += mass;
            }
            Self::Sum(..) => {}
            Self::Classes(classes) => {
                add_class(classes, value, mass);
                keep_largest(classes, 2 * MOST_CLASSES);
            }
        }
    }

    fn merge(&mut self, other: &Self) {
        match (self, other) {
            (Self::Sum(sum, of), Self::Sum(other, mass)) => {
                *sum += other;
                *of += mass;
            }
            (Self::Classes(classes), Self::Classes(others)) => {
                others.iter().for_each(|&(class, mass)| add_class(classes, class, mass));
                keep_largest(classes, MOST_CLASSES);
            }
            _ => {}
        }
    }
}

fn add_class(classes: &mut Vec<(f32, f64)>, class: f32, mass: f64) {
    match classes.binary_search_by(|(known, _)| known.total_cmp(&class)) {
        Ok(at) => classes[at].1 += mass,
        Err(at) => classes.insert(at, (class, mass)),
    }
}

/// Leaves those classes out that have the least mass, if there are more than so many.
fn keep_largest(classes: &mut Vec<(f32, f64)>, most: usize) {
    while classes.len() > most {
        let less = |least: usize, i: usize| if classes[i].1 < classes[least].1 { i } else { least };
        classes.remove((1..classes.len()).fold(0, less));
    }
}
