//! The records of the paper's files, little-endian.
//!
//! A node takes 244 bytes, as in the paper (section 4.2, footnote 1): extents, the address of the
//! parent and a flag for its type; then eight addresses of children, or the references of a leaf.
//! Like an i-node, a leaf has a fixed list of direct references; those beyond it stand in secondary
//! records of the same size, one after another.

use rayset::geometry::DVec3;

/// Bytes of a node, and of a secondary record.
pub const NODE_BYTES: usize = 244;
/// Bytes of a point: position in double precision, radius, weight.
pub const POINT_BYTES: usize = 32;
/// References that a leaf holds itself.
pub const DIRECT: usize = 43;
/// References in a secondary record.
pub const SECONDARY: usize = NODE_BYTES / 4;
/// No address.
pub const NOWHERE: u64 = u64::MAX;

const PARENT_AT: usize = 48;
const TYPE_AT: usize = 56;
const CHILDREN_AT: usize = 60;
const COUNT_AT: usize = 60;
const SECONDARY_AT: usize = 64;
const DIRECT_AT: usize = 72;
const LEAF: u32 = 1;

/// A node without its references.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Corner of least coordinates.
    pub min: DVec3,
    /// Corner of greatest coordinates.
    pub max: DVec3,
    /// Number of the parent; [`NOWHERE`] at the root.
    pub parent: u64,
    /// What is below.
    pub below: Below,
}

/// What a node leads to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Below {
    /// Eight nodes, octant by octant: x is the lowest bit.
    Children([u64; 8]),
    /// Points: how many, and the first secondary record, where there are more than [`DIRECT`].
    Points {
        /// References.
        count: u32,
        /// Number of the record.
        secondary: u64,
    },
}

/// A point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Position, the cloud's space.
    pub position: DVec3,
    /// Radius of influence.
    pub radius: f32,
    /// Weight.
    pub weight: f32,
}

impl Node {
    /// Whether a place is in the node: the least sides belong to it, the greatest do not.
    #[must_use]
    pub fn contains(&self, q: DVec3) -> bool {
        q.cmpge(self.min).all() && q.cmplt(self.max).all()
    }

    /// Its middle.
    #[must_use]
    pub fn center(&self) -> DVec3 {
        0.5 * (self.min + self.max)
    }

    /// The octant of a place in the node.
    #[must_use]
    pub fn octant(&self, q: DVec3) -> usize {
        let above = q.cmpge(self.center());
        usize::from(above.x) | usize::from(above.y) << 1 | usize::from(above.z) << 2
    }

    /// The box of an octant.
    #[must_use]
    pub fn octant_box(&self, octant: usize) -> (DVec3, DVec3) {
        let center = self.center();
        let (mut min, mut max) = (self.min, center);
        for axis in 0..3 {
            if octant >> axis & 1 == 1 {
                (min[axis], max[axis]) = (center[axis], self.max[axis]);
            }
        }
        (min, max)
    }

    /// Writes the record, and the direct references of a leaf.
    #[must_use]
    pub fn encode(&self, references: &[u32]) -> [u8; NODE_BYTES] {
        let mut bytes = [0; NODE_BYTES];
        let mut put = |at: usize, value: &[u8]| put(&mut bytes, at, value);
        for axis in 0..3 {
            put(8 * axis, &self.min[axis].to_le_bytes());
            put(24 + 8 * axis, &self.max[axis].to_le_bytes());
        }
        put(PARENT_AT, &self.parent.to_le_bytes());
        match self.below {
            Below::Children(children) => {
                for (octant, child) in children.into_iter().enumerate() {
                    put(CHILDREN_AT + 8 * octant, &child.to_le_bytes());
                }
            }
            Below::Points { count, secondary } => {
                put(TYPE_AT, &LEAF.to_le_bytes());
                put(COUNT_AT, &count.to_le_bytes());
                put(SECONDARY_AT, &secondary.to_le_bytes());
                for (i, reference) in references.iter().take(DIRECT).enumerate() {
                    put(DIRECT_AT + 4 * i, &reference.to_le_bytes());
                }
            }
        }
        bytes
    }

    /// Reads a record of [`NODE_BYTES`] bytes.
    #[must_use]
    pub fn decode(bytes: &[u8]) -> Self {
        let vector = |at: usize| DVec3::new(f64_at(bytes, at), f64_at(bytes, at + 8), f64_at(bytes, at + 16));
        let below = if u32_at(bytes, TYPE_AT) == LEAF {
            Below::Points { count: u32_at(bytes, COUNT_AT), secondary: u64_at(bytes, SECONDARY_AT) }
        } else {
            Below::Children(std::array::from_fn(|octant| u64_at(bytes, CHILDREN_AT + 8 * octant)))
        };
        Self { min: vector(0), max: vector(24), parent: u64_at(bytes, PARENT_AT), below }
    }
}

/// The direct references of a leaf's record.
pub fn direct(bytes: &[u8], count: u32) -> impl Iterator<Item = u32> {
    (0..DIRECT.min(count as usize)).map(|i| u32_at(bytes, DIRECT_AT + 4 * i))
}

/// The first `count` references of a secondary record.
pub fn secondary(bytes: &[u8], count: usize) -> impl Iterator<Item = u32> {
    (0..SECONDARY.min(count)).map(|i| u32_at(bytes, 4 * i))
}

/// References in a secondary record that leads to the next.
pub const CHAINED: usize = (NODE_BYTES - 8) / 4;
const NEXT_AT: usize = 4 * CHAINED;

/// The first `count` references of a secondary record that leads to the next, and that.
pub fn chained(bytes: &[u8], count: usize) -> (impl Iterator<Item = u32>, u64) {
    ((0..CHAINED.min(count)).map(|i| u32_at(bytes, 4 * i)), u64_at(bytes, NEXT_AT))
}

/// Writes a reference of a secondary record that leads to the next.
pub fn set_chained(bytes: &mut [u8], place: usize, reference: u32) {
    put(bytes, 4 * place, &reference.to_le_bytes());
}

/// Writes where a secondary record leads to.
pub fn set_next(bytes: &mut [u8], next: u64) {
    put(bytes, NEXT_AT, &next.to_le_bytes());
}

/// Writes a direct reference of a leaf.
pub fn set_direct(bytes: &mut [u8], place: usize, reference: u32) {
    put(bytes, DIRECT_AT + 4 * place, &reference.to_le_bytes());
}

/// Writes how many references a leaf has, and where those are that are not its own.
pub fn set_below(bytes: &mut [u8], (count, secondary): (u32, u64)) {
    put(bytes, COUNT_AT, &count.to_le_bytes());
    put(bytes, SECONDARY_AT, &secondary.to_le_bytes());
}

fn put(bytes: &mut [u8], at: usize, value: &[u8]) {
    bytes[at..at + value.len()].copy_from_slice(value);
}

/// Secondary records that a leaf of so many references has.
#[must_use]
pub fn secondary_records(count: u32) -> u64 {
    u64::from(count).saturating_sub(DIRECT as u64).div_ceil(SECONDARY as u64)
}

impl Point {
    /// Writes the record.
    #[must_use]
    pub fn encode(&self) -> [u8; POINT_BYTES] {
        let mut bytes = [0; POINT_BYTES];
        for axis in 0..3 {
            bytes[8 * axis..8 * axis + 8].copy_from_slice(&self.position[axis].to_le_bytes());
        }
        bytes[24..28].copy_from_slice(&self.radius.to_le_bytes());
        bytes[28..].copy_from_slice(&self.weight.to_le_bytes());
        bytes
    }

    /// Reads a record of [`POINT_BYTES`] bytes.
    #[must_use]
    pub fn decode(bytes: &[u8]) -> Self {
        Self {
            position: DVec3::new(f64_at(bytes, 0), f64_at(bytes, 8), f64_at(bytes, 16)),
            radius: f32::from_bits(u32_at(bytes, 24)),
            weight: f32::from_bits(u32_at(bytes, 28)),
        }
    }

    /// Whether its influence reaches into a box.
    #[must_use]
    pub fn reaches(&self, min: DVec3, max: DVec3) -> bool {
        let nearest = self.position.clamp(min, max);
        let radius = f64::from(self.radius);
        self.position.distance_squared(nearest) < radius * radius
    }
}

fn bytes_at<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    let mut out = [0; N];
    out.copy_from_slice(&bytes[at..at + N]);
    out
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes_at(bytes, at))
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes_at(bytes, at))
}

fn f64_at(bytes: &[u8], at: usize) -> f64 {
    f64::from_le_bytes(bytes_at(bytes, at))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_come_back_as_they_were() {
        let (min, max) = (DVec3::new(-1.0, 2.0, 3.5), DVec3::new(1.0, 4.0, 5.5));
        let inner =
            Node { min, max, parent: 7, below: Below::Children(std::array::from_fn(|i| 8 + i as u64)) };
        assert_eq!(Node::decode(&inner.encode(&[])), inner);
        let references: Vec<u32> = (100..200).collect();
        let leaf = Node { min, max, parent: NOWHERE, below: Below::Points { count: 100, secondary: 9 } };
        let bytes = leaf.encode(&references);
        assert_eq!(Node::decode(&bytes), leaf);
        assert!(direct(&bytes, 100).eq(100..143));
        assert_eq!(secondary_records(100), 1);
        let point = Point { position: min, radius: 0.25, weight: -2.0 };
        assert_eq!(Point::decode(&point.encode()), point);
    }

    #[test]
    fn octants_fill_their_node_without_overlap() {
        let node =
            Node { min: DVec3::ZERO, max: DVec3::splat(0.7), parent: 0, below: Below::Children([0; 8]) };
        for i in 0..343 {
            let q = DVec3::new(f64::from(i % 7), f64::from(i / 7 % 7), f64::from(i / 49)) * 0.1;
            let holding: Vec<usize> = (0..8)
                .filter(|&octant| {
                    let (min, max) = node.octant_box(octant);
                    Node { min, max, ..node }.contains(q)
                })
                .collect();
            assert_eq!(holding, [node.octant(q)]);
        }
    }
}
