//! Speeds: the lengths of velocities, as a column beside their components.

use std::path::{Path, PathBuf};

use rayset::CancelToken;
use rayset::points::{ColumnInfo, ColumnType, PointBatch, PointSource, ReadError, Schema, Values};

/// The name of the column.
pub(crate) const SPEED: &str = "speed";

/// Names of velocities, in lower case.
const VELOCITIES: [&str; 4] = ["velocities", "velocity", "vel", "peculiarvelocity"];

/// Whether a vector of this name is a velocity.
pub(crate) fn is_velocity(name: &str) -> bool {
    VELOCITIES.contains(&name.to_ascii_lowercase().as_str())
}

/// A source with a column of speeds behind its own.
struct WithSpeed {
    source: Box<dyn PointSource>,
    schema: Schema,
    components: [usize; 3],
    /// The places among the selected columns that are speeds.
    places: Vec<usize>,
    speeds: Vec<f64>,
}

/// The same sources; those with a velocity, and no column of this name, have [`SPEED`], too.
pub fn with_speeds(sources: Vec<Box<dyn PointSource>>) -> Vec<Box<dyn PointSource>> {
    sources.into_iter().map(with_speed).collect()
}

fn with_speed(source: Box<dyn PointSource>) -> Box<dyn PointSource> {
    let mut schema = source.schema().clone();
    let Some(components) = velocity(&schema).filter(|_| schema.find(SPEED).is_none()) else { return source };
    let of_first = &schema.columns[components[0]];
    let kind = if of_first.kind == ColumnType::F64 { ColumnType::F64 } else { ColumnType::F32 };
    let unit = of_first.unit.clone();
    schema.columns.push(ColumnInfo::new(SPEED, kind).with_unit(unit));
    Box::new(WithSpeed { source, schema, components, places: Vec::new(), speeds: Vec::new() })
}

/// The columns of the components of a velocity.
fn velocity(schema: &Schema) -> Option<[usize; 3]> {
    schema.names().find_map(|name| {
        let stem = name.strip_suffix("_x").filter(|stem| is_velocity(stem))?;
        let at = |axis: &str| schema.names().position(|name| name == format!("{stem}_{axis}"));
        Some([at("x")?, at("y")?, at("z")?])
    })
}

impl PointSource for WithSpeed {
    fn schema(&self) -> &Schema {
        &self.schema
    }

    fn count_hint(&self) -> Option<u64> {
        self.source.count_hint()
    }

    fn path(&self) -> Option<&Path> {
        self.source.path()
    }

    fn files(&self) -> Vec<PathBuf> {
        self.source.files()
    }

    fn select(&mut self, columns: &[usize]) {
        let speed = self.schema.columns.len() - 1;
        self.places = (0..columns.len()).filter(|&place| columns[place] == speed).collect();
        let mut stored: Vec<usize> = columns.iter().copied().filter(|&column| column != speed).collect();
        if !self.places.is_empty() {
            stored.extend(self.components);
        }
        self.source.select(&stored);
    }

    fn memory_needed(&self) -> u64 {
        // Speeds of a batch, and the components that they are made of.
        self.source.memory_needed() + (1 << 20)
    }

    fn memory_idle(&self) -> u64 {
        self.source.memory_idle() + size_of_val(&*self.schema.columns) as u64
    }

    fn can_skip(&self) -> bool {
        self.source.can_skip()
    }

    fn skip(&mut self, count: u64) -> Result<(), ReadError> {
        self.source.skip(count)
    }

    fn watch(&mut self, cancel: &CancelToken) {
        self.source.watch(cancel);
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        if self.places.is_empty() {
            return self.source.fill(batch, limit);
        }
        // Columns of speeds stand among those of the source, which knows nothing of them.
        for &place in self.places.iter().rev() {
            if place < batch.columns.len() {
                batch.columns.remove(place);
            }
        }
        self.source.fill(batch, limit)?;
        let own = batch.columns.len() - self.components.len();
        let components = batch.columns.split_off(own);
        self.speeds.clear();
        self.speeds.extend((0..batch.len()).map(|i| {
            let squares: f64 = components.iter().map(|component| component.get(i).powi(2)).sum();
            squares.sqrt()
        }));
        let is_double = self.schema.columns.last().is_some_and(|column| column.kind == ColumnType::F64);
        for &place in &self.places {
            let values = if is_double {
                Values::F64(self.speeds.clone())
            } else {
                Values::F32(self.speeds.iter().map(|&speed| speed as f32).collect())
            };
            batch.columns.insert(place, values);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayset::points::ArraySource;

    #[test]
    fn a_velocity_has_its_length_as_a_column_of_its_own_among_any_others() {
        let numbers = |of: fn(f32) -> f32| (0..10).map(|i| of(i as f32)).collect::<Vec<f32>>();
        let columns = vec![
            ("Velocities_x", numbers(|v| 2.0 * v)),
            ("other", numbers(|v| v)),
            ("Velocities_y", numbers(|v| -3.0 * v)),
            ("Velocities_z", numbers(|v| 6.0 * v)),
        ];
        let source: Box<dyn PointSource> = Box::new(ArraySource::new(vec![[0.0; 3]; 10], columns));
        let mut source = with_speed(source);
        let speed = source.schema().find(SPEED).expect("a speed");
        let other = source.schema().find("other").expect("a column");
        let mut batch = PointBatch::default();
        source.select(&[speed, other, speed]);
        let mut seen = 0;
        loop {
            source.fill(&mut batch, 4).expect("it reads");
            if batch.is_empty() {
                break;
            }
            assert_eq!(batch.columns.len(), 3);
            for i in 0..batch.len() {
                let value = f64::from(seen);
                assert_eq!([0, 1, 2].map(|c| batch.columns[c].get(i)), [7.0 * value, value, 7.0 * value]);
                seen += 1;
            }
        }
        assert_eq!(seen, 10);
        let plain: Box<dyn PointSource> =
            Box::new(ArraySource::new(vec![[0.0; 3]], vec![("v_x", vec![1.0])]));
        assert_eq!(with_speed(plain).schema().columns.len(), 1);
    }
}
