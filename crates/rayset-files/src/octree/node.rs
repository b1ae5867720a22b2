//! Node records: tight bounds of influence, the data for level of detail, and the places of
//! children and points.

use super::format::Header;
use super::layout::{DEEPEST_LEVEL, NODE_BYTES, NodeRef, RootCell, nodes_per_page};
use super::page::round_up_to_16_bits;
use rayset_base::geometry::{Aabb, DVec3};
use rayset_store::container::{PAGE_HEAD_BYTES, PageError, PageHead, PageKind};

/// The runs that a node owns, which may continue over several pages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct RunRange {
    /// Page of the first run.
    pub first_page: u32,
    /// Index of the first run in that page.
    pub first_run: u16,
    /// Number of runs; at the end of a page, the range continues with run 0 of the next page.
    pub runs: u32,
}

/// One node of the loose octree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Bounds of influence of all points at and below the node, in units of the root cell, rounded
    /// outward.
    pub bounds_min: [f32; 3],
    /// See `bounds_min`.
    pub bounds_max: [f32; 3],
    /// Number of points at and below the node.
    pub points: u64,
    /// Sum of their weights.
    pub weight_sum: f64,
    /// Their mean position, weighted by the absolute values of their weights, in units of the root
    /// cell.
    pub centroid: [f32; 3],
    /// Smallest detail of a point at and below the node: of balls the radius, of ellipsoids twice
    /// the shortest semi-axis if that is less.
    pub detail_min: f32,
    /// A bound on the details, at most 1/128 above the largest of ellipsoids; of balls the largest
    /// radius.
    pub detail_max: f32,
    /// Largest radius at and below the node.
    pub radius_max: f32,
    /// The node's own points.
    pub own: RunRange,
    /// Bit k is set if child k exists.
    pub child_mask: u8,
    /// Level of the node; the root is at level 0.
    pub level: u8,
    /// The first child; its siblings follow it in the same page, in the order of their numbers.
    pub first_child: NodeRef,
}

impl Node {
    /// Bounds of influence in world space.
    #[must_use]
    pub fn bounds(&self, root: RootCell) -> Aabb {
        let corner = |c: [f32; 3]| root.min + DVec3::from_array(c.map(f64::from)) * root.size;
        Aabb::new(corner(self.bounds_min), corner(self.bounds_max))
    }

    /// Whether this can be a child of `parent`: it must be one level below.
    #[must_use]
    pub fn is_child_of(&self, parent: &Self) -> bool {
        u16::from(self.level) == u16::from(parent.level) + 1
    }

    /// The node of points whose radii are multiplied by a factor above 0. Its bounds hold them, and
    /// are not always tight.
    fn with_radii_scaled(self, factor: f32, root_size: f64) -> Self {
        let margin = (f64::from(factor) - 1.0).max(0.0) * f64::from(self.radius_max) / root_size;
        // Records of a damaged file may be beyond what its header says.
        let scaled = |radius: f32| (radius * factor).clamp(f32::MIN_POSITIVE, f32::MAX);
        // Two `f32` steps cover the rounding of the conversion and of the sum.
        let down = |v: f32| ((f64::from(v) - margin) as f32).next_down().next_down();
        let up = |v: f32| ((f64::from(v) + margin) as f32).next_up().next_up();
        Self {
            bounds_min: self.bounds_min.map(down),
            bounds_max: self.bounds_max.map(up),
            detail_min: scaled(self.detail_min),
            detail_max: scaled(self.detail_max),
            radius_max: scaled(self.radius_max),
            ..self
        }
    }

    /// Writes the record into its 80 bytes.
    pub fn encode(&self, bytes: &mut [u8]) {
        let mut at = 0;
        let mut put = |b: &[u8]| {
            bytes[at..at + b.len()].copy_from_slice(b);
            at += b.len();
        };
        for v in self.bounds_min.iter().chain(&self.bounds_max) {
            put(&v.to_le_bytes());
        }
        put(&self.points.to_le_bytes());
        put(&self.weight_sum.to_le_bytes());
        for v in &self.centroid {
            put(&v.to_le_bytes());
        }
        put(&self.detail_min.to_le_bytes());
        put(&self.radius_max.to_le_bytes());
        put(&self.own.first_page.to_le_bytes());
        put(&self.own.runs.to_le_bytes());
        put(&self.own.first_run.to_le_bytes());
        put(&[self.child_mask, self.level]);
        put(&self.first_child.page.to_le_bytes());
        put(&self.first_child.index.to_le_bytes());
        let of_balls = self.detail_max == self.radius_max;
        put(&if of_balls { 0 } else { round_up_to_16_bits(self.detail_max) }.to_le_bytes());
    }

    fn decode(bytes: &[u8]) -> Self {
        let u16_at = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        let u32_at = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let u64_at = |at: usize| u64::from(u32_at(at)) | u64::from(u32_at(at + 4)) << 32;
        let f32_at = |at: usize| f32::from_bits(u32_at(at));
        let detail = u16_at(78);
        Self {
            bounds_min: [f32_at(0), f32_at(4), f32_at(8)],
            bounds_max: [f32_at(12), f32_at(16), f32_at(20)],
            points: u64_at(24),
            weight_sum: f64::from_bits(u64_at(32)),
            centroid: [f32_at(40), f32_at(44), f32_at(48)],
            detail_min: f32_at(52),
            detail_max: if detail == 0 { f32_at(56) } else { f32::from_bits(u32::from(detail) << 16) },
            radius_max: f32_at(56),
            own: RunRange { first_page: u32_at(60), runs: u32_at(64), first_run: u16_at(68) },
            child_mask: bytes[70],
            level: bytes[71],
            first_child: NodeRef { page: u32_at(72), index: u16_at(76) },
        }
    }
}

/// A node page whose records have been checked.
#[derive(Clone, Copy, Debug)]
pub struct NodePage<'a> {
    bytes: &'a [u8],
    nodes: usize,
    /// What radii are multiplied by, and the edge of the root cell in world space.
    scale: (f32, f64),
}

impl<'a> NodePage<'a> {
    /// Checks a page: its head, and that every record refers to existing pages, and only to nodes
    /// stored before it, so that there are no cycles.
    ///
    /// # Errors
    /// [`PageError`], which says what is wrong.
    pub fn check(bytes: &'a [u8], page: u32, header: &Header) -> Result<Self, PageError> {
        let head = PageHead::check(bytes, PageKind::Octree, page, header.identity)?;
        let this = Self::trusted(bytes);
        let wrong = |what| Err(PageError::Content { what });
        debug_assert_eq!(this.nodes, head.records as usize);
        if this.nodes > nodes_per_page(bytes.len()) {
            return wrong("more nodes than fit the page");
        }
        for index in 0..this.nodes {
            let node = this.node(index);
            let numbers = node.bounds_min.iter().chain(&node.bounds_max).chain(&node.centroid);
            if !numbers.copied().all(f32::is_finite)
                || !(node.detail_min > 0.0 && node.detail_max.is_finite() && node.radius_max.is_finite())
            {
                return wrong("a node whose bounds or radii are not finite");
            }
            if !(node.detail_min <= node.detail_max && node.detail_min <= node.radius_max)
                || (0..3).any(|a| node.bounds_min[a] > node.bounds_max[a])
            {
                return wrong("a node whose smallest radius or bound exceeds the largest");
            }
            if node.level > DEEPEST_LEVEL || (node.child_mask != 0 && node.level == DEEPEST_LEVEL) {
                return wrong("a node below the deepest level");
            }
            if u64::from(node.own.runs) > node.points || node.points > header.points {
                return wrong("a node of more runs than points, or of more points than the cloud");
            }
            let own_end = u64::from(node.own.first_page) + u64::from(node.own.runs.min(1));
            if own_end > u64::from(header.point_pages) {
                return wrong("a node whose points are in no point page");
            }
            let (c, here) = (node.first_child, page - header.point_pages);
            let last = usize::from(c.index) + node.child_mask.count_ones() as usize;
            let before = c.page < here || (c.page == here && last <= index);
            if node.child_mask != 0 && (!before || last > nodes_per_page(bytes.len())) {
                return wrong("a node whose children are not before it");
            }
        }
        Ok(this)
    }

    /// A page that has already passed [`check`](Self::check).
    #[must_use]
    pub fn trusted(bytes: &'a [u8]) -> Self {
        let nodes = u32::from_le_bytes([bytes[12], bytes[13], bytes[14], bytes[15]]) as usize;
        Self { bytes, nodes, scale: (1.0, 1.0) }
    }

    /// As [`trusted`](Self::trusted), with radii, and the bounds that follow from them, as the
    /// header of a cloud scales them.
    #[must_use]
    pub fn scaled(bytes: &'a [u8], header: &Header) -> Self {
        Self { scale: (header.radius_scale, header.root_size), ..Self::trusted(bytes) }
    }

    /// Number of nodes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.nodes
    }

    /// Whether the page holds no node.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.nodes == 0
    }

    /// A record, or `None` if `index` is beyond the page.
    #[must_use]
    pub fn get(&self, index: usize) -> Option<Node> {
        (index < self.nodes).then(|| self.node(index))
    }

    fn node(&self, index: usize) -> Node {
        let at = PAGE_HEAD_BYTES + index * NODE_BYTES;
        let node = Node::decode(&self.bytes[at..at + NODE_BYTES]);
        let (scale, root_size) = self.scale;
        if scale == 1.0 { node } else { node.with_radii_scaled(scale, root_size) }
    }
}

/// Rounds world bounds outward to the units of the root cell.
#[must_use]
pub fn to_cell_units(bounds: &Aabb, root: RootCell) -> ([f32; 3], [f32; 3]) {
    // Two `f32` steps cover the rounding of the division and of the conversion.
    let down = |v: f64| (v as f32).next_down().next_down();
    let up = |v: f64| (v as f32).next_up().next_up();
    let (min, max) = ((bounds.min - root.min) / root.size, (bounds.max - root.min) / root.size);
    (min.to_array().map(down), max.to_array().map(up))
}
