//! A queue that yields the nearest of its entries first.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// What entries of [`NearestFirst`] are ordered by: a distance, or a count of steps.
pub trait Distance: Copy {
    /// How it compares with another.
    fn compare(&self, other: &Self) -> Ordering;
}

impl Distance for u64 {
    fn compare(&self, other: &Self) -> Ordering {
        self.cmp(other)
    }
}

impl Distance for f64 {
    fn compare(&self, other: &Self) -> Ordering {
        self.total_cmp(other)
    }
}

/// Items with their distances, of which the nearest is taken first. The order of items at the same
/// distance is not defined.
#[derive(Clone, Debug)]
pub struct NearestFirst<D, T> {
    heap: BinaryHeap<Entry<D, T>>,
}

impl<D: Distance, T> Default for NearestFirst<D, T> {
    fn default() -> Self {
        Self { heap: BinaryHeap::new() }
    }
}

impl<D: Distance, T> NearestFirst<D, T> {
    /// Adds an item.
    pub fn push(&mut self, distance: D, item: T) {
        self.heap.push(Entry { distance, item });
    }

    /// Takes the nearest item, with its distance.
    pub fn pop(&mut self) -> Option<(D, T)> {
        self.heap.pop().map(|Entry { distance, item }| (distance, item))
    }

    /// Takes the nearest item if it is nearer than a distance.
    pub fn pop_before(&mut self, end: D) -> Option<(D, T)> {
        let nearest = self.nearest()?;
        if nearest.compare(&end).is_lt() { self.pop() } else { None }
    }

    /// The distance of the nearest item.
    pub fn nearest(&self) -> Option<D> {
        self.heap.peek().map(|entry| entry.distance)
    }

    /// All items with their distances, in no order.
    pub fn iter(&self) -> impl Iterator<Item = (D, &T)> {
        self.heap.iter().map(|entry| (entry.distance, &entry.item))
    }

    /// Takes all items out and keeps the memory.
    pub fn clear(&mut self) {
        self.heap.clear();
    }
}

/// An item that compares by its distance alone, and greater if nearer: a `BinaryHeap` yields its
/// greatest entry first.
#[derive(Clone, Debug)]
struct Entry<D, T> {
    distance: D,
    item: T,
}

impl<D: Distance, T> PartialEq for Entry<D, T> {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl<D: Distance, T> Eq for Entry<D, T> {}

impl<D: Distance, T> PartialOrd for Entry<D, T> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl<D: Distance, T> Ord for Entry<D, T> {
    fn cmp(&self, other: &Self) -> Ordering {
        other.distance.compare(&self.distance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn items_come_nearest_first_and_none_from_the_end_on() {
        let mut queue = NearestFirst::default();
        for distance in [3.0, -0.0, 7.5, 0.5, 3.0] {
            queue.push(distance, ());
        }
        assert_eq!(queue.nearest(), Some(-0.0));
        let before: Vec<f64> = std::iter::from_fn(|| queue.pop_before(3.0)).map(|(d, ())| d).collect();
        assert_eq!(before, [0.0, 0.5]);
        let rest: Vec<f64> = std::iter::from_fn(|| queue.pop()).map(|(d, ())| d).collect();
        assert_eq!(rest, [3.0, 3.0, 7.5]);
    }
}
