//! Builds the scene graph of a scene file.

use std::collections::HashMap;
use std::sync::Arc;

use super::data_files::DataFiles;
use super::error::SceneFileError;
use super::reader::{Cursor, Object, listed, nearest, shortened};
use super::transfers::{pattern, read_transfer_function, read_value_transfer, transfers};
use crate::field::{Kernel, SplatFilter};
use crate::scene::{
    CloudObject, FARTHEST, Form, GridObject, MOST_PLACES, Material, Node, NoiseCloud, Operator, Procedural,
    SHORTEST, Shape, Solid, check_transform,
};
use rayset_base::geometry::{DAffine3, DMat3, DQuat, DVec3};

/// Most transforms in a list, and most entries of a node's `transfers`.
const MOST_MOVES: usize = 256;
const MOST_TRANSFERS: usize = 16;

/// Keys that every node may have.
const COMMON: [&str; 6] = ["type", "id", "comment", "transform", "transfers", "material"];

/// Deepest nesting of nodes, with references followed: deeper than anyone would write, but shallow
/// enough for the stack of any thread.
const DEEPEST: usize = 100;
/// Most children of an operator: no graph may have more places of nodes.
const MOST_CHILDREN: usize = MOST_PLACES as usize;
/// Longest name of a node in bytes.
const LONGEST_NAME: usize = 256;

const OPERATORS: [Operator; 4] =
    [Operator::Union, Operator::Intersection, Operator::Difference, Operator::Blend];
const SOLIDS: [&str; 7] = ["sphere", "box", "cylinder", "cone", "torus", "halfSpace", "ellipsoid"];

/// The values of `type`.
#[derive(Clone, Copy)]
enum Type {
    Cloud,
    Grid,
    Operator(Operator),
    Solid(&'static str),
    Noise,
}

/// Builds nodes; a node that has a name is built once and shared.
pub(super) struct GraphReader<'a> {
    /// The definition of every node that has a name.
    named: HashMap<&'a str, Cursor<'a>>,
    made: HashMap<&'a str, Arc<Node>>,
    /// Names of the nodes that are being built, outermost first.
    making: Vec<&'a str>,
    data: DataFiles,
    /// Number of nodes that enclose the one being built.
    depth: usize,
    /// For every node, the number of levels of nodes below it.
    heights: HashMap<*const Node, usize>,
}

impl<'a> GraphReader<'a> {
    /// Collects all names of a file, which may refer to data files that are open.
    pub(super) fn new(file: &Object<'a>, data: DataFiles) -> Result<Self, SceneFileError> {
        let mut reader = Self {
            named: HashMap::new(),
            made: HashMap::new(),
            making: Vec::new(),
            data,
            depth: 0,
            heights: HashMap::new(),
        };
        if let Some(define) = file.get("define") {
            for (name, node) in define.any_object()?.entries() {
                reader.name(name, &node)?;
                reader.find_names(&node, Some(name))?;
            }
        }
        if let Some(root) = file.get("root") {
            reader.find_names(&root, None)?;
        }
        Ok(reader)
    }

    fn name(&mut self, name: &'a str, node: &Cursor<'a>) -> Result<(), SceneFileError> {
        if name.len() > LONGEST_NAME {
            let name = shortened(name);
            return Err(node.error(format!("the name \"{name}…\" is longer than {LONGEST_NAME} bytes")));
        }
        match self.named.insert(name, node.clone()) {
            Some(_) => Err(node.error(format!("the name \"{name}\" is given twice"))),
            None => Ok(()),
        }
    }

    fn find_names(&mut self, node: &Cursor<'a>, known_as: Option<&str>) -> Result<(), SceneFileError> {
        let Ok(object) = node.any_object() else { return Ok(()) };
        if let Some(id) = object.get("id") {
            let name = id.text()?;
            if known_as != Some(name) {
                self.name(name, node)?;
            }
        }
        let children = object.get("children").filter(|at| at.value.is_list());
        for child in children.map(|at| at.list(MOST_CHILDREN)).transpose()?.into_iter().flatten() {
            self.find_names(&child, None)?;
        }
        Ok(())
    }

    /// Builds a node.
    pub(super) fn node(&mut self, at: &Cursor<'a>) -> Result<Arc<Node>, SceneFileError> {
        if self.depth == DEEPEST {
            return Err(at.error(format!("nodes are nested more than {DEEPEST} deep")));
        }
        self.depth += 1;
        let node = self.node_inside(at);
        self.depth -= 1;
        self.measured(node?, at)
    }

    /// Records the height of a node that has been built; an error if it exceeds [`DEEPEST`].
    fn measured(&mut self, node: Arc<Node>, at: &Cursor<'a>) -> Result<Arc<Node>, SceneFileError> {
        let height = match &node.shape {
            Shape::Operator(_, children) => {
                let below = children.iter().filter_map(|child| self.heights.get(&Arc::as_ptr(child)));
                1 + below.copied().max().unwrap_or(0)
            }
            _ => 0,
        };
        if height > DEEPEST {
            return Err(at.error(format!("nodes are nested more than {DEEPEST} deep")));
        }
        self.heights.insert(Arc::as_ptr(&node), height);
        Ok(node)
    }

    fn node_inside(&mut self, at: &Cursor<'a>) -> Result<Arc<Node>, SceneFileError> {
        let object = at.any_object()?;
        if let Some(reference) = object.get("ref") {
            return self.reference(at, &reference);
        }
        match object.get("id") {
            Some(id) => self.named_node(id.text()?, &id),
            None => self.new_node(at).map(Arc::new),
        }
    }

    /// The node with a name, wherever in the file it is defined.
    fn named_node(&mut self, name: &'a str, from: &Cursor<'a>) -> Result<Arc<Node>, SceneFileError> {
        if let Some(node) = self.made.get(name) {
            return Ok(node.clone());
        }
        if self.making.contains(&name) {
            let way = [&self.making[..], &[name]].concat();
            let way = way.iter().map(|name| shortened(name)).collect::<Vec<_>>().join(" → ");
            return Err(from.error(format!("a node cannot contain itself: {way}")));
        }
        let Some(at) = self.named.get(name).cloned() else {
            let mut names: Vec<&str> = self.named.keys().copied().collect();
            names.sort_unstable();
            let known = match (nearest(name, &names), names.as_slice()) {
                (_, []) => "no node has a name; \"id\" gives one".into(),
                (Some(nearest), _) => format!("did you mean \"{nearest}\"?"),
                (None, names) => format!("the names are {}", listed(names)),
            };
            let name = shortened(name);
            return Err(from.error(format!("no node is named \"{name}\"; {known}")));
        };
        self.making.push(name);
        let node = if at.any_object()?.get("ref").is_some() {
            self.node(&at)?
        } else {
            Arc::new(self.new_node(&at)?)
        };
        let node = self.measured(node, &at)?;
        self.making.pop();
        self.made.insert(name, node.clone());
        Ok(node)
    }

    /// A reference to a named node, optionally with a transform, transfer functions and a material
    /// of its own.
    fn reference(&mut self, at: &Cursor<'a>, reference: &Cursor<'a>) -> Result<Arc<Node>, SceneFileError> {
        let object = at.object(&["ref", "comment", "transform", "transfers", "material"])?;
        let shared = self.named_node(reference.text()?, reference)?;
        let changes = ["transform", "transfers", "material"].iter().any(|key| object.get(key).is_some());
        if !changes {
            return Ok(shared);
        }
        let union = Shape::Operator(Operator::Union, vec![shared]);
        Ok(Arc::new(decorated(union, &object)?))
    }

    fn new_node(&mut self, at: &Cursor<'a>) -> Result<Node, SceneFileError> {
        let any = at.any_object()?;
        let mut types = vec![("cloud", Type::Cloud), ("grid", Type::Grid), ("noise", Type::Noise)];
        types.extend(OPERATORS.map(|o| (o.name(), Type::Operator(o))));
        types.extend(SOLIDS.map(|s| (s, Type::Solid(s))));
        let with = |more: &[&str]| at.object(&[&COMMON[..], more].concat());
        let (object, shape) = match any.require("type")?.one_of(&types)? {
            Type::Cloud => {
                let object = with(&[
                    "file",
                    "kernel",
                    "splatFilter",
                    "normalised",
                    "radiusScale",
                    "transferFunction",
                ])?;
                let cloud = self.cloud(&object)?;
                (object, Shape::Cloud(cloud))
            }
            Type::Grid => {
                let object = with(&["file", "interpolation", "transferFunction"])?;
                let mut made = GridObject::plain(self.data.grid(&object.require("file")?)?);
                if let Some(at) = object.get("transferFunction") {
                    read_value_transfer(&at, &mut made)?;
                }
                let known = [("linear", false), ("label", true)];
                made.labels = object.read_or("interpolation", false, |at| at.one_of(&known))?;
                (object, Shape::Grid(made))
            }
            Type::Operator(operator) => {
                let own: &[&str] =
                    if operator == Operator::Difference { &["children", "cap"] } else { &["children"] };
                let object = with(own)?;
                let at = object.require("children")?;
                let least = if operator == Operator::Difference { 2 } else { 1 };
                let children = at.list(MOST_CHILDREN)?;
                if children.len() < least {
                    let children = if least == 1 { "at least one child" } else { "two children or more" };
                    return Err(at.expected(&format!("{children} of a {}", operator.name())));
                }
                let children = children.iter().map(|child| self.node(child)).collect::<Result<_, _>>()?;
                (object, Shape::Operator(operator, children))
            }
            Type::Solid(name) => {
                let (own, form) = form(name, at)?;
                let object = with(&[own, &["opacity", "edge", "color"]].concat())?;
                let opacity = object.read_or("opacity", 1.0, |at| at.number(0.0, 1.0))?;
                let edge = object.read_or("edge", 0.0, |at| at.number(0.0, FARTHEST))?;
                let solid = Solid { form, opacity, edge, pattern: pattern(&object)? };
                (object, Shape::Procedural(Arc::new(solid) as Arc<dyn Procedural>))
            }
            Type::Noise => {
                let own = ["radii", "scale", "octaves", "roughness", "opacity", "cover", "seed", "color"];
                let object = with(&own)?;
                let radii = object.require("radii")?;
                let cloud = NoiseCloud {
                    radii: positive_vector(&radii)?,
                    scale: object.require("scale")?.positive()?,
                    octaves: object.read_or("octaves", 4, |at| at.whole(1, 8))?,
                    roughness: object.read_or("roughness", 0.5, |at| at.number(0.0, 1.0))?,
                    opacity: object.read_or("opacity", 0.5, |at| at.number(0.0, 1.0))?,
                    cover: object.read_or("cover", 0.6, |at| at.number(0.0, 1.0))?,
                    seed: object.read_or("seed", 0, |at| at.whole(0, u32::MAX))?,
                    pattern: pattern(&object)?,
                };
                (object, Shape::Procedural(Arc::new(cloud)))
            }
        };
        decorated(shape, &object)
    }

    fn cloud(&mut self, object: &Object<'a>) -> Result<CloudObject, SceneFileError> {
        let at = object.require("file")?;
        let cloud = self.data.cloud(&at)?;
        let cloud = match object.get("radiusScale") {
            Some(at) => self.data.scaled(cloud, &at)?,
            None => cloud,
        };
        let mut made = CloudObject::plain(cloud);
        let kernels: Vec<(&str, Kernel)> =
            Kernel::ALL.iter().map(|kernel| (kernel.name(), *kernel)).collect();
        made.kernel = object.read_or("kernel", made.kernel, |at| at.one_of(&kernels))?;
        let filters: Vec<(&str, SplatFilter)> =
            SplatFilter::ALL.iter().map(|filter| (filter.name(), *filter)).collect();
        made.splat_filter = object.read_or("splatFilter", made.splat_filter, |at| at.one_of(&filters))?;
        made.normalised = object.read_or("normalised", false, Cursor::boolean)?;
        if let Some(at) = object.get("transferFunction") {
            read_transfer_function(&at, &mut made)?;
        }
        Ok(made)
    }
}

/// A node of a shape, with the optional keys that all nodes have: transform, transfer functions and
/// material.
fn decorated(shape: Shape, object: &Object<'_>) -> Result<Node, SceneFileError> {
    let mut node = Node::new(shape);
    if let Some(at) = object.get("transform") {
        node.parent_from_local = transform(&at)?;
    }
    if let Some(at) = object.get("transfers") {
        for at in at.list(MOST_TRANSFERS)? {
            node.transfers.extend(transfers(&at, &node)?);
        }
    }
    if let Some(at) = object.get("material") {
        node.material = Some(material(&at)?);
    }
    node.cap = object.get("cap").map(|at| at.color()).transpose()?;
    Ok(node)
}

/// A transform, or a list of transforms that are applied in order.
fn transform(at: &Cursor<'_>) -> Result<DAffine3, SceneFileError> {
    if at.value.is_list() {
        let mut sum = DAffine3::IDENTITY;
        for step in at.list(MOST_MOVES)? {
            sum = transform(&step)? * sum;
        }
        return moved(at, sum);
    }
    one_move(at)
}

/// A transform, or an error if it is not allowed in a scene.
fn moved(at: &Cursor<'_>, transform: DAffine3) -> Result<DAffine3, SceneFileError> {
    check_transform(&transform).map_err(|e| at.error(e.to_string()))?;
    Ok(transform)
}

fn one_move(at: &Cursor<'_>) -> Result<DAffine3, SceneFileError> {
    let object = at.object(&["scale", "rotate", "translate", "matrix"])?;
    let mut sum = DAffine3::IDENTITY;
    if let Some(at) = object.get("matrix") {
        let rows = at.list(usize::MAX)?;
        let [x, y, z] = rows.as_slice() else {
            return Err(at.expected("three rows of four numbers"));
        };
        let rows = [x.numbers::<4>()?, y.numbers::<4>()?, z.numbers::<4>()?];
        let column = |c: usize| DVec3::new(rows[0][c], rows[1][c], rows[2][c]);
        let linear = DMat3::from_cols(column(0), column(1), column(2));
        sum = DAffine3::from_mat3_translation(linear, column(3));
    }
    if let Some(at) = object.get("scale") {
        let scale = if at.value.is_number() { DVec3::splat(at.any_number()?) } else { at.vector()? };
        sum = DAffine3::from_scale(scale) * sum;
    }
    if let Some(at) = object.get("rotate") {
        let rotate = at.object(&["axis", "degrees"])?;
        let axis = rotate.require("axis")?.direction()?.normalize();
        let angle = rotate.require("degrees")?.any_number()?.to_radians();
        sum = DAffine3::from_quat(DQuat::from_axis_angle(axis, angle)) * sum;
    }
    if let Some(at) = object.get("translate") {
        sum = DAffine3::from_translation(at.vector()?) * sum;
    }
    let determinant = sum.matrix3.determinant();
    if determinant == 0.0 || !determinant.is_finite() {
        return Err(
            at.error("this transform flattens space: no scale may be 0, no row of a matrix may repeat")
        );
    }
    moved(at, sum)
}

fn material(at: &Cursor<'_>) -> Result<Material, SceneFileError> {
    let known = ["ambient", "diffuse", "specular", "shininess", "reflectance", "refractiveIndex"];
    let object = at.object(&known)?;
    let plain = Material::default();
    let part = |key: &str, default: f64| object.read_or(key, default, |at| at.number(0.0, 1000.0));
    Ok(Material {
        ambient: part("ambient", plain.ambient)?,
        diffuse: part("diffuse", plain.diffuse)?,
        specular: part("specular", plain.specular)?,
        shininess: object.read_or("shininess", plain.shininess, |at| at.number(0.0, 1e4))?,
        reflectance: object.read_or("reflectance", plain.reflectance, |at| at.number(0.0, 1.0))?,
        refractive_index: object
            .read_or("refractiveIndex", plain.refractive_index, |at| at.number(0.1, 10.0))?,
    })
}

fn positive_vector(at: &Cursor<'_>) -> Result<DVec3, SceneFileError> {
    let vector = at.vector()?;
    if vector.min_element() >= SHORTEST {
        Ok(vector)
    } else {
        Err(at.expected(&format!("three numbers of at least {SHORTEST:e}")))
    }
}

/// The shape of a solid, and the keys that are specific to it.
fn form(name: &str, at: &Cursor<'_>) -> Result<(&'static [&'static str], Form), SceneFileError> {
    let object = at.any_object()?;
    let length = |key: &str| object.require(key)?.positive();
    Ok(match name {
        "sphere" => (&["radius"], Form::Sphere { radius: length("radius")? }),
        "box" => (&["size"], Form::Box { size: positive_vector(&object.require("size")?)? }),
        "cylinder" => {
            (&["radius", "height"], Form::Cylinder { radius: length("radius")?, height: length("height")? })
        }
        "cone" => {
            (&["radius", "height"], Form::Cone { radius: length("radius")?, height: length("height")? })
        }
        "torus" => {
            let (major, minor) = (length("majorRadius")?, length("minorRadius")?);
            (&["majorRadius", "minorRadius"], Form::Torus { major, minor })
        }
        "halfSpace" => {
            let normal = object.require("normal")?.direction()?.normalize();
            let offset = object.read_or("offset", 0.0, Cursor::any_number)?;
            (&["normal", "offset"], Form::HalfSpace { normal, offset })
        }
        _ => (&["radii"], Form::Ellipsoid { radii: positive_vector(&object.require("radii")?)? }),
    })
}
