//! Maps the columns of the sources to the columns of a record.

use super::depths::Depths;
use super::error::BuildError;
use super::options::{BuildOptions, Rule, ShapeRule};
use super::record::RecordLayout;
use super::shapes_of::ShapesOf;
use crate::octree::format::NAME_BYTES;
use crate::points::{ColumnInfo, ColumnType, PointSource, ROUND_RADIUS, Schema, ShapeOrigin};

/// The columns of a record, and the columns of the sources from which they come.
pub(super) struct Columns {
    pub(super) layout: RecordLayout,
    /// Names of the columns to request from the sources, without repetition.
    pub(super) names: Vec<String>,
    /// Index in `names`.
    pub(super) radius: Option<usize>,
    /// Whether radii are the longest semi-axes.
    pub(super) radius_is_semi_axis: bool,
    pub(super) weight: Option<usize>,
    pub(super) attributes: Vec<usize>,
    /// What shapes are measured of, with the radii. Records may have shapes before: discs by their
    /// normals, and balls of those without one. Only what is no ball by then stays as it is.
    pub(super) shapes_of: ShapesOf,
    /// The attributes, each of the common type of all sources.
    pub(super) infos: Vec<ColumnInfo>,
}

const COLORS: [&str; 3] = ["red", "green", "blue"];
/// Columns that points without colours are shown in grey by; the first that a source has.
const INTENSITIES: [&str; 5] = ["intensity", "reflectance", "scalar_intensity", "reflectivity", "amplitude"];

/// The columns to select of a source, and which of them, in its batches, are what.
pub(super) struct Selection {
    pub(super) columns: Vec<usize>,
    /// What says the shapes of a source: its semi-axes and rotations, or its normals.
    pub(super) shape: Option<ShapeOrigin>,
    /// The coefficients that a source has of harmonics: the constant ones, then the others, first
    /// those of red, then of green and blue.
    pub(super) harmonics: Vec<usize>,
    /// `None` if records have no colours.
    pub(super) colors: Option<ColorOrigin>,
}

/// Where the colours of a source come from: columns of its batches.
pub(super) struct ColorOrigin {
    pub(super) color: Option<[usize; 3]>,
    /// Of points without a colour.
    pub(super) intensity: Option<usize>,
    /// The number that denotes the depth of its colours, and the type of these.
    pub(super) depth: u32,
    pub(super) family: u8,
}

/// The rule for radii: the one in the options, otherwise [`Rule::Auto`] of a fluid, the column
/// `radius` if every source has one, the longest semi-axis if every source has these, or
/// [`ROUND_RADIUS`] if points are to be round and every source has that, otherwise [`Rule::Auto`].
pub(super) fn radius_rule(options: &BuildOptions, sources: &[Box<dyn PointSource + '_>]) -> Rule {
    match &options.radius {
        Some(rule) => rule.clone(),
        None if options.shape == ShapeRule::Fluid => Rule::Auto,
        None if options.shape == ShapeRule::Round && all_have(sources, ROUND_RADIUS) => {
            Rule::Attribute(ROUND_RADIUS.into())
        }
        None if all_have(sources, "radius") => Rule::Attribute("radius".into()),
        None if options.shape == ShapeRule::Auto && all_have_axes(sources) => Rule::SemiAxis,
        None => Rule::Auto,
    }
}

/// The rule for weights: the one in the options, otherwise the column `weight` if every source has
/// one, otherwise 1.
pub(super) fn weight_rule(options: &BuildOptions, sources: &[Box<dyn PointSource + '_>]) -> Rule {
    match &options.weight {
        Some(rule) => rule.clone(),
        None if all_have(sources, "weight") => Rule::Attribute("weight".into()),
        None => Rule::Number(1.0),
    }
}

fn all_have_axes(sources: &[Box<dyn PointSource + '_>]) -> bool {
    sources.iter().all(|source| source.schema().axes_of_shapes().is_some())
}

fn all_have(sources: &[Box<dyn PointSource + '_>], name: &str) -> bool {
    sources.iter().all(|s| s.schema().find(name).is_some())
}

impl Columns {
    pub(super) fn choose(
        options: &BuildOptions,
        radius: &Rule,
        weight: &Rule,
        sources: &[Box<dyn PointSource + '_>],
    ) -> Result<Self, BuildError> {
        let mut names: Vec<String> = Vec::new();
        let mut place = |name: &str| {
            names.iter().position(|n| n == name).unwrap_or_else(|| {
                names.push(name.to_owned());
                names.len() - 1
            })
        };
        let mut of_rule =
            |rule: &Rule| if let Rule::Attribute(name) = rule { Some(place(name)) } else { None };
        let (is_auto, radius_is_semi_axis) = (*radius == Rule::Auto, *radius == Rule::SemiAxis);
        let (radius, weight) = (of_rule(radius), of_rule(weight));
        let has_color = options.keep_color && sources.iter().any(|source| colors(source.schema()).is_some());
        let degrees = sources.iter().map(|source| source.schema().harmonics().0);
        let degree = degrees.max().filter(|_| has_color).unwrap_or(0);
        let of_any = |of: fn(&Schema) -> Option<ShapeOrigin>| {
            options.shape == ShapeRule::Auto && sources.iter().any(|source| of(source.schema()).is_some())
        };
        let has_axes = of_any(Schema::axes_of_shapes);
        let shapes_of = match options.shape {
            ShapeRule::Auto if is_auto && !has_axes => ShapesOf::Surfaces,
            ShapeRule::Fluid if is_auto => ShapesOf::Fluid,
            _ => ShapesOf::Nothing,
        };
        let has_normals = shapes_of == ShapesOf::Surfaces && of_any(by_normals);
        let attributes: Vec<usize> = options.attributes.iter().map(|name| place(name)).collect();
        for (input, source) in sources.iter().enumerate() {
            if let Some(name) = names.iter().find(|name| source.schema().find(name).is_none()) {
                let available = source.schema().names().collect::<Vec<_>>().join(", ");
                let available = if available.is_empty() { "x, y, z only".to_owned() } else { available };
                return Err(BuildError::NoSuchColumn { input: input + 1, name: name.clone(), available });
            }
        }
        let infos: Vec<ColumnInfo> = options.attributes.iter().map(|name| common(name, sources)).collect();
        let layout = RecordLayout {
            has_radius: radius.is_some() || radius_is_semi_axis,
            has_shape: has_axes || has_normals,
            has_weight: weight.is_some(),
            has_color,
            harmonics: degree,
            attributes: infos.iter().map(|info| info.kind).collect(),
        };
        Ok(Self { layout, names, radius, radius_is_semi_axis, weight, attributes, shapes_of, infos })
    }

    /// The columns to select of source `input`. Those in `names` come first, in their order.
    pub(super) fn selection(&self, schema: &Schema, input: usize) -> Selection {
        let mut selected: Vec<usize> = self.names.iter().filter_map(|name| schema.find(name)).collect();
        let mut select = |column: usize| {
            selected.push(column);
            selected.len() - 1
        };
        let shape = match self.layout.has_shape {
            true if self.shapes_of.are_measured() => by_normals(schema),
            true => schema.axes_of_shapes(),
            false => None,
        };
        let shape = shape.map(|origin| origin.map(&mut select));
        if !self.layout.has_color {
            return Selection { columns: selected, shape, harmonics: Vec::new(), colors: None };
        }
        let columns = colors(schema);
        // Only numbers that can be NaN can be missing.
        let may_lack =
            columns.is_none_or(|colors| colors.iter().any(|&c| !schema.columns[c].kind.is_integer()));
        let intensity = INTENSITIES.iter().filter(|_| may_lack).find_map(|name| schema.find(name));
        let origin = ColorOrigin {
            color: columns.map(|columns| columns.map(&mut select)),
            intensity: intensity.map(&mut select),
            depth: Depths::number(schema, input),
            family: Depths::family(schema),
        };
        let harmonics = schema.harmonics().1.into_iter().map(&mut select).collect();
        Selection { columns: selected, shape, harmonics, colors: Some(origin) }
    }
}

/// The three columns of colours, if a source has all of them.
fn colors(schema: &Schema) -> Option<[usize; 3]> {
    let [red, green, blue] = COLORS.map(|name| schema.find(name));
    Some([red?, green?, blue?])
}

/// The columns by which the points of a source are discs across their normals.
fn by_normals(schema: &Schema) -> Option<ShapeOrigin> {
    schema.normals().map(ShapeOrigin::Normal)
}

/// A column as it is stored: of the common type of all sources, and with their unit if it is the
/// same for all.
fn common(name: &str, sources: &[Box<dyn PointSource + '_>]) -> ColumnInfo {
    let infos: Vec<&ColumnInfo> = sources
        .iter()
        .filter_map(|s| s.schema().find(name).map(|index| &s.schema().columns[index]))
        .collect();
    let unit = infos.first().map_or("", |info| info.unit.as_str());
    let same = infos.iter().all(|info| info.unit == unit) && unit.len() <= NAME_BYTES;
    ColumnInfo {
        name: name.to_owned(),
        kind: infos.iter().map(|info| info.kind).reduce(ColumnType::common).unwrap_or(ColumnType::F32),
        unit: if same { unit.to_owned() } else { String::new() },
        is_class: !infos.is_empty() && infos.iter().all(|info| info.is_class),
    }
}
