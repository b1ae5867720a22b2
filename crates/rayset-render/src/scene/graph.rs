//! The volume scene graph: a term of constructive volume geometry (Chen & Tucker 2000), as a rooted
//! DAG.
//!
//! A node is an elemental volume object or an operator over other nodes. Children are held by
//! reference, so a subtree may be used in several places, and cycles cannot occur. Each node may
//! transform its content, apply transfer functions to it, and assign a material.
//!
//! | operator | opacity | attributes | shading vector |
//! | --- | --- | --- | --- |
//! | union | the largest | of the largest (the first child on ties) | of the child that sets the opacity |
//! | intersection | the smallest | of the largest of all children | of the child that sets the opacity |
//! | difference | max(0, O₁ − O₂ − …) | of the first child | the nearest subtrahend's, reversed, if its boundary is nearer and within the unit distance; otherwise the first child's |
//! | blend | min(1, ΣO) | weighted by O | weighted by O |
//!
//! Opacities are limited to [`MAX_OPACITY`](super::MAX_OPACITY) at the leaves, so that opaque
//! objects tie. The attributes of an intersection or blend of many children differ from those of
//! nested pairs.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::sync::Arc;

use super::error::{MOST_ATTRIBUTES, SceneError};
use super::transfer::{ColorMap, ColorRule, MapInput, OpacityRule, TransferError, TransferFunction};
use super::{BRIGHTEST, Material, Procedural, check_transform};
use crate::field::{Kernel, SplatFilter};
use rayset_base::geometry::{Aabb, DAffine3, DVec3};
use rayset_files::grid::Grid;
use rayset_files::octree::Cloud;

/// A node of the scene graph.
#[derive(Clone, Debug)]
pub struct Node {
    /// The object or operator.
    pub shape: Shape,
    /// Transform from the node's local space to the space of its parent (world space for the root).
    /// It does not change opacities.
    pub parent_from_local: DAffine3,
    /// Transfer functions, applied one after another. An opacity of 0 stays 0.
    pub transfers: Vec<Transfer>,
    /// Material of everything below that has no material of its own.
    pub material: Option<Material>,
    /// Of a difference: the colour of a cap, linear light. What the first child encloses is then
    /// filled before the others are taken away from it, so that a cut through a hollow scan shows a
    /// solid.
    pub cap: Option<[f64; 3]>,
}

/// An elemental volume object or an operator.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Shape {
    /// A point cloud.
    Cloud(CloudObject),
    /// A grid.
    Grid(GridObject),
    /// A field given in closed form.
    Procedural(Arc<dyn Procedural>),
    /// An operator and its children, one or more.
    Operator(Operator, Vec<Arc<Node>>),
}

/// How children are combined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Operator {
    /// Everything that any child contains.
    Union,
    /// What all children have in common.
    Intersection,
    /// The first child without the others.
    Difference,
    /// The sum of all children.
    Blend,
}

impl Operator {
    /// Its name in scene files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Union => "union",
            Self::Intersection => "intersection",
            Self::Difference => "difference",
            Self::Blend => "blend",
        }
    }
}

/// A point cloud as a volume object (PBVO).
#[derive(Clone, Debug)]
pub struct CloudObject {
    /// The cloud. Objects that share a cloud share its pages.
    pub cloud: Arc<Cloud>,
    /// The radial basis function.
    pub kernel: Kernel,
    /// Of splats, how they are kept from being seen smaller than a pixel. What is filtered depends
    /// on the picture's pixels: at more of them, splats are narrower. Shadows are those of splats
    /// without a filter.
    pub splat_filter: SplatFilter,
    /// Whether kernels are normalised to integrate to one, so that weight = mass (or
    /// mass·value/density) as in SPH.
    pub normalised: bool,
    /// Opacity and colour from density and attributes.
    pub transfer: TransferFunction,
}

impl CloudObject {
    /// A cloud with the paper's defaults: Wyvill's kernel, O = min(1, D), and the colours of the
    /// points, or white if the cloud has no colours.
    #[must_use]
    pub fn plain(cloud: Arc<Cloud>) -> Self {
        let color = if cloud.header().has_color { ColorRule::Points } else { ColorRule::Uniform([1.0; 3]) };
        let transfer = TransferFunction { opacity: OpacityRule::Clamp, color };
        let (kernel, splat_filter) = (Kernel::default(), SplatFilter::None);
        Self { cloud, kernel, splat_filter, normalised: false, transfer }
    }

    /// Density at the centre of a single point that has the largest weight and, if kernels are
    /// normalised, the largest radius of the cloud. Attributes are defined where the density is
    /// above 1e-12 of it.
    #[must_use]
    pub fn largest_point_density(&self) -> f64 {
        let header = self.cloud.header();
        let weight = f64::from(header.weight.max().abs().max(header.weight.min().abs()));
        if self.kernel == Kernel::Splat {
            // An extinction: of an interval, more than this is as good as nothing.
            weight / f64::from(header.radius.max())
        } else if self.normalised {
            weight / (self.kernel.integral() * f64::from(header.radius.max()).powi(3))
        } else {
            weight
        }
    }

    /// A box in local space outside which the cloud is transparent; empty if the cloud has no
    /// points.
    #[must_use]
    pub fn bounds(&self) -> Aabb {
        let header = self.cloud.header();
        if header.points == 0 {
            return Aabb::EMPTY;
        }
        // Stored positions are rounded.
        header.bounds.inflated(f64::from(header.radius.max()) + header.position_error)
    }

    /// The least and the largest length of which steps are a fraction. Splats absorb the same
    /// whatever the step is: it only tells their colours apart, and is that of the mean radius.
    pub(crate) fn details(&self) -> (f32, f32) {
        let header = self.cloud.header();
        let mean = header.radius_mean as f32;
        if self.kernel == Kernel::Splat { (mean, mean) } else { header.details() }
    }

    fn check(&self) -> Result<(), SceneError> {
        self.transfer.check()?;
        let header = self.cloud.header();
        let absorbs = matches!(self.transfer.opacity, OpacityRule::Extinction(_));
        if self.kernel == Kernel::Splat && (self.normalised || !absorbs) {
            return Err(TransferError::Splats.into());
        }
        if self.kernel != Kernel::Splat && self.splat_filter != SplatFilter::None {
            return Err(TransferError::Filter.into());
        }
        match &self.transfer.color {
            ColorRule::Points if !header.has_color => Err(TransferError::Missing("colours").into()),
            ColorRule::Map { input: MapInput::Attribute(i), .. } if *i >= header.attributes.len() + 3 => {
                Err(TransferError::Missing("such attribute").into())
            }
            _ => Ok(()),
        }
    }
}

/// A grid as a volume object; its values are used in place of densities.
#[derive(Clone, Debug)]
pub struct GridObject {
    /// The grid. Objects that share a grid share its pages.
    pub grid: Arc<Grid>,
    /// Opacity and colour from values.
    pub transfer: TransferFunction,
    /// Whether values are labels, which are never mixed. A sample then has the value of the most
    /// trilinear weight among the eight voxels around it (the larger of two that have as much), in
    /// place of their mean. The object's surface is where half of the weight is that of voxels at
    /// least as opaque as the sample, or that show at all if the sample does not.
    pub labels: bool,
}

impl GridObject {
    /// A grid whose opacity rises from 0 at the smallest value to 1 at the largest, in white.
    #[must_use]
    pub fn plain(grid: Arc<Grid>) -> Self {
        let (low, high) = grid.header().value_range();
        let high = if high > low { high } else { low + 1.0 };
        let transfer = TransferFunction {
            opacity: OpacityRule::Curve(vec![(low, 0.0), (high, 1.0)]),
            color: ColorRule::Uniform([1.0; 3]),
        };
        Self { grid, transfer, labels: false }
    }

    /// The value that defines the boundary: where the opacity first reaches half its maximum.
    #[must_use]
    pub fn boundary_value(&self, unit_distance: f64) -> f64 {
        self.transfer.opacity.boundary_density(unit_distance)
    }

    /// The sign that turns the gradient of the values into the direction of the shading vector: −1
    /// if the object lies toward larger values, 1 if toward smaller ones.
    #[must_use]
    pub fn outward(&self) -> f64 {
        match &self.transfer.opacity {
            OpacityRule::Curve(points) if points.first().map(|p| p.1) > points.last().map(|p| p.1) => 1.0,
            _ => -1.0,
        }
    }
}

/// The name of the attribute that carries the values of a grid through operators.
pub const GRID_ATTRIBUTE: &str = "value";

/// The largest number of places of nodes in a graph, with shared nodes counted at every use.
pub const MOST_PLACES: u64 = 1 << 16;

/// The input of a node's transfer function.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Channel {
    /// The opacity before this transfer function.
    Opacity,
    /// A component of the colour, in linear light.
    Red,
    /// See [`Channel::Red`].
    Green,
    /// See [`Channel::Red`].
    Blue,
    /// An attribute of the objects below, by name: a column of a cloud, [`GRID_ATTRIBUTE`], or one
    /// of [`Procedural::attributes`]. Operators combine attributes as they combine colours; in
    /// objects that lack it, its value is 0.
    Attribute(Arc<str>),
}

/// A transfer function applied to the output of a node.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Transfer {
    /// Replaces the opacity wherever it is not 0.
    Opacity {
        /// The input value.
        input: Channel,
        /// (value, opacity) pairs in ascending order of values, interpolated linearly.
        curve: Vec<(f64, f64)>,
    },
    /// Replaces the colour.
    Color {
        /// The input value.
        input: Channel,
        /// The colours.
        map: ColorMap,
    },
}

impl Node {
    /// A node with an identity transform, without transfer functions or material.
    #[must_use]
    pub fn new(shape: Shape) -> Self {
        Self {
            shape,
            parent_from_local: DAffine3::IDENTITY,
            transfers: Vec::new(),
            material: None,
            cap: None,
        }
    }

    /// An operator node with the given children.
    #[must_use]
    pub fn operator(operator: Operator, children: impl IntoIterator<Item = Node>) -> Self {
        Self::new(Shape::Operator(operator, children.into_iter().map(Arc::new).collect()))
    }

    /// Applies a further transform to the node, after the one it has.
    #[must_use]
    pub fn moved(mut self, by: DAffine3) -> Self {
        self.parent_from_local = by * self.parent_from_local;
        self
    }

    /// Sets the material of the node.
    #[must_use]
    pub fn of(mut self, material: Material) -> Self {
        self.material = Some(material);
        self
    }

    /// Sets the colour of the cap of a difference, linear light.
    #[must_use]
    pub fn capped(mut self, color: [f64; 3]) -> Self {
        self.cap = Some(color);
        self
    }

    /// Calls `f` for the node and everything below, once for every place in which a node is used.
    pub fn for_each(&self, f: &mut impl FnMut(&Self)) {
        f(self);
        if let Shape::Operator(_, children) = &self.shape {
            children.iter().for_each(|child| child.for_each(f));
        }
    }

    /// Checks the node and everything below.
    ///
    /// # Errors
    /// [`SceneError`] if the graph, one of its transforms, transfer functions, materials or objects
    /// is invalid.
    pub fn check(&self) -> Result<(), SceneError> {
        // Sharing allows graphs whose expansion is too large to walk.
        let places = self.places(&mut HashMap::new());
        if places > MOST_PLACES {
            return Err(SceneError::TooLarge { places, most: MOST_PLACES });
        }
        self.check_each(&DAffine3::IDENTITY)?;
        let count = self.attributes_read().len();
        if count > MOST_ATTRIBUTES { Err(SceneError::TooManyAttributes { count }) } else { Ok(()) }
    }

    /// The attributes of the objects below, each with the range of its values; of clouds also their
    /// coordinates.
    #[must_use]
    pub fn attributes(&self) -> BTreeMap<String, (f64, f64)> {
        let mut known: BTreeMap<String, (f64, f64)> = BTreeMap::new();
        let mut add = |name: &str, (low, high): (f64, f64)| {
            let range = known.entry(name.into()).or_insert((low, high));
            *range = (range.0.min(low), range.1.max(high));
        };
        self.for_each_once(&mut |node| match &node.shape {
            Shape::Cloud(object) => {
                let header = object.cloud.header();
                let stored = header.attributes.iter().map(|a| a.name.as_str());
                for name in stored.chain(["x", "y", "z", "height"]) {
                    if let Some(number) = header.attribute_number(name) {
                        add(name, header.attribute_range(number));
                    }
                }
            }
            Shape::Grid(object) => add(GRID_ATTRIBUTE, object.grid.header().value_range()),
            Shape::Procedural(field) => field.attributes().iter().for_each(|name| add(name, (0.0, 1.0))),
            Shape::Operator(..) => {}
        });
        known
    }

    /// The attributes that transfer functions read, without duplicates, in alphabetical order.
    #[must_use]
    pub fn attributes_read(&self) -> Vec<Arc<str>> {
        let mut names = Vec::new();
        self.for_each_once(&mut |node| {
            names.extend(node.transfers.iter().filter_map(Transfer::attribute).cloned());
        });
        names.sort();
        names.dedup();
        names
    }

    /// Calls `f` for the node and everything below, shared nodes once.
    pub(super) fn for_each_once(&self, f: &mut impl FnMut(&Self)) {
        fn visit(node: &Node, seen: &mut HashSet<*const Node>, f: &mut impl FnMut(&Node)) {
            if seen.insert(std::ptr::from_ref(node)) {
                f(node);
                if let Shape::Operator(_, children) = &node.shape {
                    children.iter().for_each(|child| visit(child, seen, f));
                }
            }
        }
        visit(self, &mut HashSet::new(), f);
    }

    /// Number of places of nodes in the expanded graph, with shared nodes counted at every use.
    fn places(&self, known: &mut HashMap<*const Self, u64>) -> u64 {
        let Shape::Operator(_, children) = &self.shape else { return 1 };
        if let Some(&places) = known.get(&std::ptr::from_ref(self)) {
            return places;
        }
        let places = children.iter().map(|child| child.places(known)).fold(1, u64::saturating_add);
        known.insert(std::ptr::from_ref(self), places);
        places
    }

    fn check_each(&self, world_from_parent: &DAffine3) -> Result<(), SceneError> {
        check_transform(&self.parent_from_local)?;
        let world_from_local = *world_from_parent * self.parent_from_local;
        check_transform(&world_from_local)?;
        self.transfers.iter().try_for_each(|transfer| transfer.check(self))?;
        self.material.as_ref().map_or(Ok(()), Material::check)?;
        self.check_cap()?;
        match &self.shape {
            Shape::Cloud(object) => object.check(),
            Shape::Grid(object) => Ok(object.transfer.check()?),
            Shape::Procedural(field) => {
                let (value, bounds) = (field.detail(), field.bounds());
                if !(value > 0.0) || bounds.min.is_nan() || bounds.max.is_nan() {
                    let what = "the detail of a field in closed form";
                    return Err(SceneError::Number {
                        what,
                        value,
                        expected: "a positive number, and bounds",
                    });
                }
                Ok(())
            }
            Shape::Operator(operator, children) => {
                let least = if matches!(operator, Operator::Difference) { 2 } else { 1 };
                if children.len() < least {
                    let (operator, children) = (operator.name(), children.len());
                    return Err(SceneError::Children { operator, children, least });
                }
                children.iter().try_for_each(|child| child.check_each(&world_from_local))
            }
        }
    }

    fn check_cap(&self) -> Result<(), SceneError> {
        let Some(color) = self.cap else { return Ok(()) };
        if !matches!(self.shape, Shape::Operator(Operator::Difference, _)) {
            return Err(SceneError::Cap);
        }
        match color.into_iter().find(|v| !(0.0..=BRIGHTEST).contains(v)) {
            Some(value) => {
                Err(SceneError::Number { what: "the colour of a cap", value, expected: "0 to 1e12" })
            }
            None => Ok(()),
        }
    }

    /// Bounding box of all solids, noise and grids, intersected with the bounds of the node; empty
    /// if there are none. In the space of the node's parent.
    #[must_use]
    pub fn bounds_of_solids(&self) -> Aabb {
        fn visit(node: &Node, world_from_parent: &DAffine3, within: Aabb) -> Aabb {
            let world_from_local = *world_from_parent * node.parent_from_local;
            match &node.shape {
                Shape::Cloud(_) => Aabb::EMPTY,
                Shape::Grid(_) | Shape::Procedural(_) => {
                    let bounds = node.bounds().transformed(world_from_parent).intersection(within);
                    if bounds.is_empty() { Aabb::EMPTY } else { bounds }
                }
                Shape::Operator(_, children) => children
                    .iter()
                    .map(|child| visit(child, &world_from_local, within))
                    .fold(Aabb::EMPTY, Aabb::union),
            }
        }
        visit(self, &DAffine3::IDENTITY, self.bounds())
    }

    /// A box outside which the node is transparent, in the space of its parent; infinite if the
    /// node is unbounded.
    #[must_use]
    pub fn bounds(&self) -> Aabb {
        let local = match &self.shape {
            Shape::Cloud(object) => object.bounds(),
            Shape::Grid(object) => {
                let header = object.grid.header();
                Aabb::new(DVec3::ZERO, header.last_voxel()).transformed(&header.space_from_voxel)
            }
            Shape::Procedural(field) => field.bounds(),
            Shape::Operator(operator, children) => {
                let mut boxes = children.iter().map(|child| child.bounds());
                match operator {
                    Operator::Union | Operator::Blend => boxes.fold(Aabb::EMPTY, Aabb::union),
                    Operator::Intersection => boxes.reduce(Aabb::intersection).unwrap_or(Aabb::EMPTY),
                    Operator::Difference => boxes.next().unwrap_or(Aabb::EMPTY),
                }
            }
        };
        local.transformed(&self.parent_from_local)
    }
}

impl Transfer {
    /// The attribute that the transfer function reads, if any.
    fn attribute(&self) -> Option<&Arc<str>> {
        match self {
            Self::Opacity { input: Channel::Attribute(name), .. }
            | Self::Color { input: Channel::Attribute(name), .. } => Some(name),
            Self::Opacity { .. } | Self::Color { .. } => None,
        }
    }

    fn check(&self, node: &Node) -> Result<(), SceneError> {
        if let Some(name) = self.attribute() {
            let known = node.attributes();
            if !known.contains_key(&**name) {
                return Err(SceneError::NoAttribute {
                    name: name.to_string(),
                    known: known.into_keys().collect(),
                });
            }
        }
        match self {
            Self::Opacity { curve, .. } => Ok(OpacityRule::Curve(curve.clone()).check()?),
            Self::Color { map, .. } => Ok(map.check()?),
        }
    }
}
