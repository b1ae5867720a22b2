//! Compiles a scene graph: instructions from the leaves up, then what is required of each from the
//! root down.

use std::collections::HashMap;
use std::sync::Arc;

use super::bounce::ScatterKinds;
use super::cloud::CloudVolume;
use super::grid::GridVolume;
use super::node_samples::{Constants, LEAF, LUMP_OPACITY, MATERIAL, Measure, RequiredOutputs};
use super::procedural::ProceduralVolume;
use super::program::{Action, Instruction, Key, Program, Purpose, used_materials};
use super::transfer::{CompiledTransfer, Input};
use super::unopened::Unopened;
use crate::field::{Kernel, SimdLevel};
use crate::scene::{
    CloudObject, GridObject, LightKind, Lighting, Lod, MOST_ATTRIBUTES, Material, Node, Operator, Procedural,
    Scene, Shape, Transfer,
};
use rayset_base::geometry::{Aabb, DAffine3};

/// A compiled node: its action, its bounds in the world, and the colour of all its samples, if it
/// is the same.
type Compiled = (Action<Unopened>, Aabb, Option<[f32; 3]>);

struct Compiler<'s> {
    scene: &'s Scene,
    purpose: Purpose,
    lod: Lod,
    simd: SimdLevel,
    instructions: Vec<Instruction<Unopened>>,
    known: HashMap<Key, usize>,
    /// Attributes that transfer functions read, in alphabetical order.
    names: Vec<Arc<str>>,
    /// Every material that is used, each once.
    materials: Vec<[f32; MATERIAL]>,
    /// Number of leaves so far, if leaf numbers are required.
    leaves: Option<u32>,
}

impl Program<Unopened> {
    /// Compiles a scene that has been checked.
    pub(super) fn compile(scene: &Scene, purpose: Purpose, simd: SimdLevel) -> Self {
        Self::compile_seen(scene, (purpose, Lod::Off), simd)
    }

    /// The same, seen with a level of detail.
    pub(super) fn compile_seen(scene: &Scene, (purpose, lod): (Purpose, Lod), simd: SimdLevel) -> Self {
        let leaves = (purpose == Purpose::Layers).then_some(0);
        let (instructions, known, materials) = (Vec::new(), HashMap::new(), Vec::new());
        let names = scene.root.attributes_read();
        let mut compiler =
            Compiler { scene, purpose, lod, simd, instructions, known, names, materials, leaves };
        let material = compiler.material(&Material::default());
        compiler.add(&scene.root, &DAffine3::IDENTITY, material);
        compiler.finish()
    }
}

impl Compiler<'_> {
    /// The index of a material, which is added if it is new.
    fn material(&mut self, material: &Material) -> usize {
        let mut numbers = [0.0; MATERIAL];
        let given = material.to_array().map(|v| v as f32);
        numbers[..given.len()].copy_from_slice(&given);
        let known = self.materials.iter().position(|m| *m == numbers);
        known.unwrap_or_else(|| {
            self.materials.push(numbers);
            self.materials.len() - 1
        })
    }

    /// The values of the material of a leaf, with the number of the leaf if it is required.
    fn of_leaf(&mut self, material: usize, shape: &Shape) -> [f32; MATERIAL] {
        let mut numbers = self.materials[material];
        if let Some(leaves) = self.leaves.as_mut().filter(|_| !matches!(shape, Shape::Operator(..))) {
            *leaves += 1;
            numbers[LEAF] = *leaves as f32;
        }
        numbers
    }

    /// Adds a node and what it needs; returns the index of its instruction. `material` applies if
    /// the node has none of its own.
    fn add(&mut self, node: &Arc<Node>, world_from_parent: &DAffine3, material: usize) -> usize {
        let material = node.material.as_ref().map_or(material, |m| self.material(m));
        let world_from_local = *world_from_parent * node.parent_from_local;
        let key = (Arc::as_ptr(node), world_from_local.to_cols_array().map(f64::to_bits), material);
        if let Some(&at) = self.known.get(&key) {
            self.instructions[at].uses += 1;
            return at;
        }
        let of_leaf = self.of_leaf(material, &node.shape);
        // A function of the opacity of what is seen from afar is not what points would make of it.
        let lod = self.lod;
        if node.transfers.iter().any(|t| matches!(t, Transfer::Opacity { .. })) {
            self.lod = Lod::Off;
        }
        let (action, bounds, color) = match &node.shape {
            Shape::Operator(operator, children) => {
                self.operator(*operator, children, &world_from_local, material)
            }
            Shape::Cloud(object) => self.cloud(object, &world_from_local, of_leaf),
            Shape::Grid(object) => self.grid(object, &world_from_local, of_leaf),
            Shape::Procedural(field) => self.procedural(field, &world_from_local, of_leaf),
        };
        self.lod = lod;
        let transfers: Vec<CompiledTransfer> =
            node.transfers.iter().map(|t| CompiledTransfer::new(t, &self.names)).collect();
        let recolored = transfers.iter().any(CompiledTransfer::makes_color);
        self.instructions.push(Instruction {
            action,
            bounds,
            object_bounds: bounds,
            required: RequiredOutputs::default(),
            made: RequiredOutputs::default(),
            measures: (Measure::Opacity, Measure::Opacity),
            transfers,
            uses: 1,
            color: color.filter(|_| !recolored),
        });
        let at = self.instructions.len() - 1;
        self.known.insert(key, at);
        at
    }

    fn cloud(
        &self,
        object: &CloudObject,
        world_from_local: &DAffine3,
        material: [f32; MATERIAL],
    ) -> Compiled {
        // Rays to lights end at the first surface of what is solid: few points are looked at, and
        // what stands for these would throw shadows on itself.
        let sees_all = self.purpose == Purpose::Shadow && object.transfer.opacity.is_solid();
        let lod = if sees_all { Lod::Off } else { self.lod };
        let volume = CloudVolume::new(object, world_from_local, (self.scene, lod), material);
        let color = volume.shading.uniform_color();
        (Action::Cloud(Box::new(volume)), object.bounds().transformed(world_from_local), color)
    }

    fn grid(&self, object: &GridObject, world_from_local: &DAffine3, material: [f32; MATERIAL]) -> Compiled {
        let unit = self.scene.unit_distance;
        let volume = GridVolume::new(object, world_from_local, unit, material);
        let bounds = Node::new(Shape::Grid(object.clone())).bounds().transformed(world_from_local);
        let color = volume.uniform_color();
        (Action::Grid(Box::new(volume)), bounds, color)
    }

    fn procedural(
        &self,
        field: &Arc<dyn Procedural>,
        world_from_local: &DAffine3,
        material: [f32; MATERIAL],
    ) -> Compiled {
        let reach = self.scene.unit_distance;
        let volume = ProceduralVolume::new(field.clone(), world_from_local, reach, material);
        let color = field.uniform_color().map(|c| c.map(|v| v as f32));
        (Action::Procedural(Box::new(volume)), field.bounds().transformed(world_from_local), color)
    }

    fn operator(
        &mut self,
        operator: Operator,
        children: &[Arc<Node>],
        world_from_local: &DAffine3,
        material: usize,
    ) -> Compiled {
        let children = children.iter().map(|child| self.add(child, world_from_local, material)).collect();
        let (operator, children) = self.drop_unreachable_subtrahends(operator, children);
        let bounds = self.operator_bounds(operator, &children);
        let first = self.instructions[children[0]].color;
        let colored = if operator == Operator::Difference { &children[..1] } else { &children[..] };
        let same = colored.iter().all(|&c| self.instructions[c].color == first);
        (Action::Operator(operator, children), bounds, first.filter(|_| same))
    }

    /// Leaves out subtracted objects that are so far from the first operand that they neither cut
    /// it nor affect its shading.
    fn drop_unreachable_subtrahends(
        &self,
        operator: Operator,
        mut children: Vec<usize>,
    ) -> (Operator, Vec<usize>) {
        if operator != Operator::Difference {
            return (operator, children);
        }
        // How far filtered splats reach is known when they are seen.
        if self.is_filtered(children[0]) || children[1..].iter().any(|&child| self.is_filtered(child)) {
            return (operator, children);
        }
        let reached = self.instructions[children[0]].bounds.inflated(self.scene.unit_distance);
        let mut first = true;
        children.retain(|&child| {
            let meets = !self.instructions[child].bounds.intersection(reached).is_empty();
            std::mem::take(&mut first) || meets
        });
        // A single operand is its own union, which is cheaper to evaluate.
        (if children.len() == 1 { Operator::Union } else { operator }, children)
    }

    /// Whether an instruction has splats that are filtered.
    fn is_filtered(&self, at: usize) -> bool {
        match &self.instructions[at].action {
            Action::Cloud(volume) => volume.placement.is_filtered(),
            Action::Operator(_, children) => children.iter().any(|&child| self.is_filtered(child)),
            Action::Grid(_) | Action::Procedural(_) => false,
        }
    }

    fn operator_bounds(&self, operator: Operator, children: &[usize]) -> Aabb {
        let mut boxes = children.iter().map(|&c| self.instructions[c].bounds);
        match operator {
            Operator::Union | Operator::Blend => boxes.fold(Aabb::EMPTY, Aabb::union),
            // The boxes of filtered splats may meet when they are seen.
            Operator::Intersection if children.iter().any(|&child| self.is_filtered(child)) => {
                boxes.next().unwrap_or(Aabb::EMPTY)
            }
            Operator::Intersection => boxes.reduce(Aabb::intersection).unwrap_or(Aabb::EMPTY),
            Operator::Difference => boxes.next().unwrap_or(Aabb::EMPTY),
        }
    }

    /// Passes the required outputs down from the root to each instruction.
    fn finish(mut self) -> Program<Unopened> {
        let used = used_materials(&self.instructions);
        let material = if used.len() == 1 { used.first().copied() } else { None };
        let root = self.instructions.len() - 1;
        let color = self.instructions[root].color;
        let lump_opacity = self.name_lump_opacity();
        self.instructions[root].required = RequiredOutputs {
            attributes: lump_opacity.map_or(0, |number| 1 << number),
            ..self.wanted_of_root(color, material.is_none())
        };
        self.instructions[root].measures.1 = Measure::OpticalDepth;
        let has_splats = self.has_cloud(|c| c.shading.kernel == Kernel::Splat || c.lod.is_some());
        for at in (0..=root).rev() {
            self.pass_down(at, has_splats);
        }
        let reach = self.scene.unit_distance;
        let mut required = RequiredOutputs::default();
        for instruction in &mut self.instructions {
            required = required.and(instruction.required);
            if instruction.required.outside
                && !matches!(instruction.action, Action::Cloud(_) | Action::Grid(_))
            {
                instruction.bounds = instruction.bounds.inflated(reach);
            }
        }
        let constants = Constants { color, material };
        let (instructions, simd) = (self.instructions, self.simd);
        Program { instructions, required, reach, constants, simd, has_splats, lump_opacity }
    }

    fn has_cloud(&self, is_meant: impl Fn(&CloudVolume<Unopened>) -> bool) -> bool {
        let is_one = |action: &Action<_>| matches!(action, Action::Cloud(volume) if is_meant(volume));
        self.instructions.iter().any(|instruction| is_one(&instruction.action))
    }

    /// Adds the name of an attribute that says how wrong what is seen from afar may be, if anything
    /// is, and if there is room for a name.
    fn name_lump_opacity(&mut self) -> Option<usize> {
        let is_of_eye = matches!(self.purpose, Purpose::Picture | Purpose::Layers);
        let is_seen = is_of_eye && self.has_cloud(|cloud| cloud.lod.is_some());
        (is_seen && self.names.len() < MOST_ATTRIBUTES).then(|| {
            self.names.push(LUMP_OPACITY.into());
            self.names.len() - 1
        })
    }

    fn wanted_of_root(&self, color: Option<[f32; 3]>, materials_differ: bool) -> RequiredOutputs {
        if self.purpose == Purpose::Shadow {
            return RequiredOutputs::default();
        }
        if self.purpose == Purpose::Surface {
            return RequiredOutputs { normal: true, ..RequiredOutputs::default() };
        }
        let layers = self.purpose == Purpose::Layers;
        let lights = match &self.scene.lighting {
            Lighting::Unlit if layers => &Vec::new(),
            Lighting::Unlit => {
                return RequiredOutputs { color: color.is_none(), ..RequiredOutputs::default() };
            }
            Lighting::Lit(lights) => lights,
        };
        let turns_rays = ScatterKinds::of(&used_materials(&self.instructions)).any();
        RequiredOutputs {
            color: color.is_none(),
            normal: layers || turns_rays || lights.iter().any(|l| l.kind != LightKind::Ambient),
            boundary: self.scene.lighting.throws_shadows() || turns_rays,
            outside: false,
            material: materials_differ || layers,
            attributes: 0,
        }
    }

    fn pass_down(&mut self, at: usize, has_splats: bool) {
        let Instruction { required, made, measures, transfers, action, .. } = &mut self.instructions[at];
        // Differences are the same in both measures; that of depths, which splats need, is slower.
        let sums = match action {
            Action::Operator(Operator::Blend, _) => true,
            Action::Operator(Operator::Difference, _) => !has_splats,
            _ => false,
        };
        measures.0 = if sums || !transfers.is_empty() { Measure::Opacity } else { measures.1 };
        let reads_color = transfers.iter().any(|t| matches!(t.input, Input::Color(_)));
        let makes_color = transfers.iter().any(CompiledTransfer::makes_color);
        // Rows are required both for the inputs and for the outputs of transfer functions.
        required.color |= reads_color;
        required.attributes =
            transfers.iter().fold(required.attributes, |bits, t| bits | t.input.attributes());
        let below = RequiredOutputs { color: required.color && (reads_color || !makes_color), ..*required };
        *made = below;
        let (operator, children) = match action {
            Action::Operator(operator, children) => (operator, children),
            Action::Cloud(volume) => {
                return volume.carry(below, &self.names);
            }
            Action::Grid(volume) => return volume.carry(&self.names),
            Action::Procedural(volume) => return volume.carry(&self.names),
        };
        let (operator, children, measure) = (*operator, children.clone(), measures.0);
        for (place, child) in children.into_iter().enumerate() {
            let of_child = match operator {
                Operator::Difference => RequiredOutputs {
                    boundary: below.boundary || below.normal,
                    outside: below.outside || (below.normal && place > 0),
                    color: below.color && place == 0,
                    material: below.material && place == 0,
                    attributes: if place == 0 { below.attributes } else { 0 },
                    ..below
                },
                // Where children are equally opaque, their boundaries say which of them has the
                // surface.
                Operator::Intersection => {
                    RequiredOutputs { boundary: below.boundary || below.normal, ..below }
                }
                Operator::Union | Operator::Blend => below,
            };
            let child = &mut self.instructions[child];
            child.required = child.required.and(of_child);
            child.measures.1 = measure;
        }
    }
}
