//! Cuts through a scene, as nodes of its graph: what is saved is cut in the same way.

use rayset::geometry::Aabb;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Most solids that a page may cut with.
pub(crate) const MOST_CUTTERS: usize = 16;

/// A box along the axes.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, PartialEq)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct Section {
    pub(crate) min: [f64; 3],
    pub(crate) max: [f64; 3],
}

/// A solid that takes away what is inside of it, or leaves nothing else.
#[derive(Clone, Debug, Deserialize, Serialize, PartialEq)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct Cutter {
    pub(crate) form: Form,
    /// World space.
    pub(crate) center: [f64; 3],
    /// Lengths along its own axes.
    pub(crate) size: [f64; 3],
    /// Made one after another, about its centre.
    #[serde(default)]
    pub(crate) turns: Vec<Turn>,
    /// Whether what is inside is kept, and the rest taken away.
    #[serde(default)]
    pub(crate) keep: bool,
}

#[derive(Clone, Copy, Debug, Deserialize, Serialize, PartialEq)]
#[serde(rename_all = "camelCase")]
pub(crate) enum Form {
    Box,
    Ellipsoid,
    /// Along its own y.
    Cylinder,
}

#[derive(Clone, Copy, Debug, Deserialize, Serialize, PartialEq)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct Turn {
    pub(crate) axis: [f64; 3],
    pub(crate) degrees: f64,
}

/// The graph `root` cut by a section box and by solids. `bounds` are those of the scene; `cap` is
/// the colour that fills what the cuts open, if they are to be filled.
pub(crate) fn cut(
    root: Value,
    bounds: &Aabb,
    section: Option<&Section>,
    cutters: &[Cutter],
    cap: Option<&str>,
) -> Value {
    let mut children = vec![root];
    if let Some(section) = section {
        children.extend(beyond(section, bounds));
    }
    children.extend(cutters.iter().map(|cutter| taken_away(cutter, bounds)));
    if children.len() == 1 {
        return children.remove(0);
    }
    let mut node = json!({"type": "difference", "children": children});
    if let Some(color) = cap {
        node["cap"] = json!(color);
    }
    node
}

/// A box beyond each side of a section that cuts.
fn beyond(section: &Section, bounds: &Aabb) -> Vec<Value> {
    let (low, high) = (bounds.min.to_array(), bounds.max.to_array());
    let far = bounds.size().max_element();
    let mut boxes = Vec::new();
    for axis in 0..3 {
        for (cuts, end) in [(section.min[axis] > low[axis], 0), (section.max[axis] < high[axis], 1)] {
            if !cuts {
                continue;
            }
            let mut ends = [low.map(|v| v - far), high.map(|v| v + far)];
            ends[1 - end][axis] = [section.min, section.max][end][axis];
            let size: Vec<f64> = (0..3).map(|k| ends[1][k] - ends[0][k]).collect();
            let center: Vec<f64> = (0..3).map(|k| 0.5 * (ends[0][k] + ends[1][k])).collect();
            boxes.push(json!({"type": "box", "size": size, "transform": {"translate": center}}));
        }
    }
    boxes
}

/// What a solid takes away from a scene.
fn taken_away(cutter: &Cutter, bounds: &Aabb) -> Value {
    let [x, y, z] = cutter.size;
    let mut solid = match cutter.form {
        Form::Box => json!({"type": "box", "size": [x, y, z]}),
        Form::Ellipsoid => json!({"type": "ellipsoid", "radii": [0.5 * x, 0.5 * y, 0.5 * z]}),
        // One of radius and height 1, stretched.
        Form::Cylinder => json!({"type": "cylinder", "radius": 1, "height": 1}),
    };
    let mut moves = Vec::new();
    if cutter.form == Form::Cylinder {
        moves.push(json!({"scale": [0.5 * x, y, 0.5 * z]}));
    }
    moves.extend(
        cutter.turns.iter().map(|turn| json!({"rotate": {"axis": turn.axis, "degrees": turn.degrees}})),
    );
    moves.push(json!({"translate": cutter.center}));
    solid["transform"] = Value::Array(moves);
    if !cutter.keep {
        return solid;
    }
    // Points whose radii are scaled reach beyond the bounds.
    let around = [bounds.size().max_element() * 4.0; 3];
    let whole =
        json!({"type": "box", "size": around, "transform": {"translate": bounds.center().to_array()}});
    json!({"type": "difference", "children": [whole, solid]})
}
