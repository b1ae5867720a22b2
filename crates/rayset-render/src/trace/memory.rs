//! The memory that a render needs besides pages, so that a budget for the whole process can be
//! kept.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use super::interior::graph as caps;
use super::leaves::Leaves;
use super::node_samples::{NodeSamples, RequiredOutputs};
use super::program::PLACE_BYTES;
use super::ray_tree::tree_bytes;
use super::shadow::{DeepShadowMap, SHADOW_TILE_BYTES, TILE_MAKER_BYTES};
use super::transfer::ColorTable;
use crate::field::{LANES, SampleRow};
use crate::scene::{
    ColorRule, Lighting, MOST_ATTRIBUTES, Material, Node, OpacityRule, Operator, RenderSettings, Scene,
    Shape, Transfer, TransferFunction,
};
use rayset_base::geometry::DAffine3;
use rayset_files::grid::Grid;
use rayset_files::grid::format::PAGE_BYTES;
use rayset_files::octree::Cloud;
use rayset_store::working_set::{OVERHEAD_BYTES, WorkingSet};

/// Scratch memory, stack and bookkeeping of one thread that traces a single cloud.
const THREAD_BYTES: u64 = 640 << 10;
/// What look-ahead stores per page of the files, though it never has most of them in view at a
/// time.
const LOOKAHEAD_BYTES: u64 = 24;
/// One part in this many of the pages' memory is set aside for gaps in the allocator's memory for
/// everything else.
const ALLOCATOR_PART: u64 = 32;
/// What a march through the graph keeps for every place: its range of samples, the states of its
/// cloud, grid or field, its shared block.
const MARCH_BYTES: u64 = (24 + 32 + size_of::<Option<NodeSamples>>()) as u64;
/// Memory for the reads in flight and the threads that serve them.
const READING_BYTES: u64 = 1 << 20;

/// What a scene needs in memory besides its pages.
#[derive(Clone, Debug)]
pub struct SceneNeeds {
    pub(super) clouds: Vec<Arc<Cloud>>,
    pub(super) grids: Vec<Arc<Grid>>,
    /// The graph as given and as compiled, and what remains allocated after loading it.
    scene_bytes: u64,
    /// What its caps may take, and how much of this they may not take.
    pub(super) caps_bytes: u64,
    spare_bytes: u64,
    thread_bytes: u64,
    /// Number of tiles of shadow tables.
    shadow_tiles: u64,
    /// What requests take at most, if any file is far away.
    request_bytes: u64,
    /// Whether tiles are made with layers, and whether the picture is written with them.
    pub(super) layers: bool,
    pub(super) writes_layers: bool,
    pub(super) ambient_occlusion: bool,
    /// Width and height of the picture in pixels.
    pub(super) size: (u32, u32),
    pub(super) threads: usize,
    /// What the process takes before the render starts.
    pub(super) process_bytes: u64,
}

impl SceneNeeds {
    /// The needs of a scene that has been checked.
    #[must_use]
    pub fn of(scene: &Scene, settings: &RenderSettings) -> Self {
        match caps::sized(scene, settings) {
            Some((scene, bytes)) => {
                let (caps_bytes, spare_bytes) = (bytes.most, bytes.most - bytes.least);
                Self { caps_bytes, spare_bytes, ..Self::of_graph(&scene, settings, true) }
            }
            None => Self::of_graph(scene, settings, false),
        }
    }

    /// The needs of a scene without caps, or of one in which something else takes their place.
    fn of_graph(scene: &Scene, settings: &RenderSettings, has_caps: bool) -> Self {
        let leaves = Leaves::of(scene);
        let turns = has(scene, |node| {
            node.material.is_some_and(|m| m.reflectance > 0.0 || m.refractive_index != 1.0)
        });
        let required = largest_outputs(scene, settings, turns, has_caps);
        let census = Census::of(&scene.root);
        let most_held = node_samples_held(&scene.root) + census.shared;
        let picture = most_held * NodeSamples::bytes(required);
        let opacity_only = RequiredOutputs { attributes: required.attributes, ..RequiredOutputs::default() };
        let shadow =
            if scene.lighting.throws_shadows() { most_held * NodeSamples::bytes(opacity_only) } else { 0 };
        let passes = if shadow > 0 { 2 } else { 1 };
        // Shadows have a march for rays and one for tables, each with node samples and clouds of
        // its own.
        let marches = if shadow > 0 { 3 } else { 1 };
        let tree = if turns && settings.max_depth > 0 { tree_bytes(settings.max_depth) } else { 0 };
        // Sums of attributes in the field of a cloud; of class labels, the label and what speaks
        // for it.
        let sums = 2
            * u64::from(required.attributes.count_ones())
            * marches
            * (LANES * size_of::<SampleRow>()) as u64;
        let lights = if let Lighting::Lit(lights) = &scene.lighting { lights.as_slice() } else { &[] };
        let in_shadow = lights.iter().filter(|light| light.throws_shadows()).count();
        let thread_bytes = THREAD_BYTES
            + (picture + 2 * shadow) as u64
            + marches * leaves.march_bytes()
            + tree
            + sums
            + marches * census.places * MARCH_BYTES
            + (in_shadow * LANES * size_of::<SampleRow>()) as u64
            + if shadow > 0 { TILE_MAKER_BYTES as u64 } else { 0 };
        let scene_bytes = census.given_bytes
            + passes * (census.places * PLACE_BYTES + census.table_bytes)
            + 4 * size_of_val(lights) as u64;
        let shadow_tiles = DeepShadowMap::tiles_of(scene, settings.shadows);
        Self {
            request_bytes: request_bytes(&leaves),
            clouds: leaves.clouds,
            grids: leaves.grids,
            scene_bytes,
            caps_bytes: 0,
            spare_bytes: 0,
            thread_bytes,
            shadow_tiles,
            layers: settings.records_layers(),
            writes_layers: settings.layers,
            ambient_occlusion: settings.ambient_occlusion > 0.0,
            size: (settings.width, settings.height),
            threads: 1,
            process_bytes: 0,
        }
    }

    /// Sets the number of threads that render; otherwise one.
    #[must_use]
    pub fn with_threads(self, threads: usize) -> Self {
        Self { threads, ..self }
    }

    /// Sets what the process takes before the render starts, for budgets of whole processes;
    /// otherwise nothing.
    #[must_use]
    pub fn with_process(self, process_bytes: u64) -> Self {
        Self { process_bytes, ..self }
    }

    /// Adds the memory that loading the scene took: little of it becomes available to pages,
    /// because what remains allocated lies scattered in it.
    #[must_use]
    pub fn with_loading(self, loading_bytes: u64) -> Self {
        Self { scene_bytes: self.scene_bytes + loading_bytes, ..self }
    }

    /// The same with as little memory for caps as finding them takes; `None` if that is all they
    /// may take.
    pub(super) fn with_least_caps(&self) -> Option<Self> {
        (self.spare_bytes > 0).then(|| self.clone().with_caps(self.caps_bytes - self.spare_bytes))
    }

    /// The same with another amount of memory for caps, when it is known how much they take.
    #[doc(hidden)]
    #[must_use]
    pub fn with_caps(self, caps_bytes: u64) -> Self {
        Self { caps_bytes, spare_bytes: 0, ..self }
    }

    /// Every grid of the scene, each once.
    #[must_use]
    pub fn grids(&self) -> &[Arc<Grid>] {
        &self.grids
    }

    /// The number of pages of every file, and the bytes of each page.
    fn files(&self) -> impl Iterator<Item = (u64, u64)> {
        let clouds =
            self.clouds.iter().map(|c| (u64::from(c.header().pages()), u64::from(c.header().page_bytes)));
        clouds.chain(self.grids.iter().map(|grid| (grid.header().pages(), PAGE_BYTES as u64)))
    }

    /// Every cloud of the scene, each once.
    #[must_use]
    pub fn clouds(&self) -> &[Arc<Cloud>] {
        &self.clouds
    }
}

/// What requests to the files of a scene take at most; those of several files share it.
fn request_bytes(leaves: &Leaves) -> u64 {
    let clouds = leaves.clouds.iter().filter_map(|cloud| cloud.storage());
    let storages = clouds.chain(leaves.grids.iter().filter_map(|grid| grid.storage()));
    let transports = storages.filter_map(|storage| storage.transport());
    transports.map(|transport| transport.memory_bytes()).max().unwrap_or(0)
}

/// An upper bound on the number of node samples in use at a time, not counting those that several
/// operators need.
fn node_samples_held(node: &Node) -> usize {
    let Shape::Operator(operator, children) = &node.shape else { return 1 };
    let deepest = children.iter().map(|child| node_samples_held(child)).max().unwrap_or(0);
    let own = if *operator == Operator::Intersection { children.len() } else { 2 };
    own + deepest
}

/// The size of a graph, in numbers.
#[derive(Default)]
struct Census {
    /// Number of places of the graph: nodes, each in one place of the world.
    places: u64,
    /// How many of these several operators need, or one operator needs several times.
    shared: usize,
    /// Bytes of the graph itself, counting shared nodes once.
    given_bytes: u64,
    /// Bytes of tables and curves, summed over all places.
    table_bytes: u64,
}

/// A node with its transform to the world and its material: one instruction of a program.
type InstructionKey = (*const Node, [u64; 12], [u64; 6]);

impl Census {
    fn of(root: &Arc<Node>) -> Self {
        let mut census = Self::default();
        let (mut known, mut nodes) = (HashMap::new(), HashSet::new());
        census.visit(root, &DAffine3::IDENTITY, Material::default(), &mut known, &mut nodes);
        census.places = known.len() as u64;
        census.shared = known.values().filter(|&&uses| uses > 1).count();
        census
    }

    fn visit(
        &mut self,
        node: &Arc<Node>,
        world_from_parent: &DAffine3,
        material: Material,
        known: &mut HashMap<InstructionKey, u32>,
        nodes: &mut HashSet<*const Node>,
    ) {
        let material = node.material.unwrap_or(material);
        let world_from_local = *world_from_parent * node.parent_from_local;
        let transform = world_from_local.to_cols_array().map(f64::to_bits);
        let place = (Arc::as_ptr(node), transform, material.to_array().map(f64::to_bits));
        let uses = known.entry(place).or_insert(0);
        *uses += 1;
        if *uses > 1 {
            return;
        }
        self.table_bytes += tables(node);
        if nodes.insert(Arc::as_ptr(node)) {
            /// What the allocations of a node take besides their contents.
            const BLOCKS: usize = 64;
            let own = match &node.shape {
                Shape::Procedural(field) => size_of_val(&**field),
                Shape::Operator(_, children) => 2 * size_of_val(children.as_slice()),
                Shape::Cloud(_) | Shape::Grid(_) => 0,
            };
            let transfers = size_of_val(node.transfers.as_slice());
            self.given_bytes += (size_of::<Node>() + BLOCKS + own + transfers) as u64 + given(node);
        }
        if let Shape::Operator(_, children) = &node.shape {
            children.iter().for_each(|child| self.visit(child, &world_from_local, material, known, nodes));
        }
    }
}

/// Bytes of a curve.
fn curve_bytes(curve: &[(f64, f64)]) -> u64 {
    // Twice, because the list may have grown point by point.
    2 * size_of_val(curve) as u64
}

/// The transfer function over the values of a leaf, if it has one.
fn transfer_of(node: &Node) -> Option<&TransferFunction> {
    match &node.shape {
        Shape::Cloud(object) => Some(&object.transfer),
        Shape::Grid(object) => Some(&object.transfer),
        Shape::Procedural(_) | Shape::Operator(..) => None,
    }
}

/// Bytes of a node's compiled transfer functions, at each of its places.
fn tables(node: &Node) -> u64 {
    let of_leaf = transfer_of(node).map_or(0, |transfer| {
        let curve = if let OpacityRule::Curve(curve) = &transfer.opacity { curve_bytes(curve) } else { 0 };
        curve + if let ColorRule::Map { map, .. } = &transfer.color { ColorTable::bytes(map) } else { 0 }
    });
    let others = node.transfers.iter().map(|transfer| match transfer {
        Transfer::Opacity { curve, .. } => curve_bytes(curve),
        Transfer::Color { map, .. } => ColorTable::bytes(map),
    });
    // Each is in a list of its own, with its input.
    of_leaf + others.map(|bytes| bytes + 256).sum::<u64>()
}

/// Bytes of a node's curves and palettes as given.
fn given(node: &Node) -> u64 {
    let stops = |map: &crate::scene::ColorMap| size_of_val(&*map.palette.stops()) as u64;
    let of_leaf = transfer_of(node).map_or(0, |transfer| {
        let curve = if let OpacityRule::Curve(curve) = &transfer.opacity { curve_bytes(curve) } else { 0 };
        curve + if let ColorRule::Map { map, .. } = &transfer.color { stops(map) } else { 0 }
    });
    let others = node.transfers.iter().map(|transfer| match transfer {
        Transfer::Opacity { curve, .. } => curve_bytes(curve),
        Transfer::Color { map, .. } => stops(map),
    });
    of_leaf + others.sum::<u64>()
}

/// Whether `wanted` holds for any node of a scene.
fn has(scene: &Scene, wanted: impl Fn(&Node) -> bool) -> bool {
    let mut found = false;
    scene.root.for_each(&mut |node| found |= wanted(node));
    found
}

/// All outputs that may be required of any node of a scene.
fn largest_outputs(
    scene: &Scene,
    settings: &RenderSettings,
    turns_rays: bool,
    has_caps: bool,
) -> RequiredOutputs {
    let lit = scene.lighting != Lighting::Unlit;
    // To find out what is inside takes shading vectors.
    let normal = lit || settings.records_layers() || has_caps;
    let of_boundary = |operator| matches!(operator, Operator::Difference | Operator::Intersection);
    let cuts =
        || has(scene, |node| matches!(node.shape, Shape::Operator(operator, _) if of_boundary(operator)));
    let names = scene.root.attributes_read().len().min(MOST_ATTRIBUTES) as u32;
    RequiredOutputs {
        color: true,
        normal,
        boundary: normal && (turns_rays || scene.lighting.throws_shadows() || cuts()),
        outside: false,
        material: settings.records_layers() || (lit && has(scene, |node| node.material.is_some())),
        attributes: u32::MAX.checked_shr(32 - names).unwrap_or(0),
    }
}

/// Divides the memory of a session that has prepared these scenes. Returns the bytes for pages, and
/// how many of these shadow tables may take.
///
/// # Errors
/// The smallest sufficient memory in bytes.
pub(super) fn divide(scenes: &[&SceneNeeds], threads: usize, total: u64) -> Result<(u64, u64), u64> {
    let demand = Demand::of(scenes, threads);
    let least = demand.fixed + demand.least_page_bytes();
    if total < least { Err(least) } else { Ok(demand.divide(total - demand.fixed)) }
}

/// What the scenes of a session need besides pages, and how large their pages are.
pub(super) struct Demand {
    threads: usize,
    pub(super) fixed: u64,
    /// Bytes of the largest page of a file.
    pub(super) page: u64,
    /// Bytes of the largest and of the smallest page, including tiles of shadow tables.
    largest: u64,
    smallest: u64,
    /// Bytes of all pages of the files.
    file_bytes: u64,
}

impl Demand {
    pub(super) fn of(scenes: &[&SceneNeeds], threads: usize) -> Self {
        let tile = SHADOW_TILE_BYTES as u64;
        let files = || scenes.iter().flat_map(|needs| needs.files());
        let shadow_tiles: u64 = scenes.iter().map(|needs| needs.shadow_tiles).sum();
        let page = files().map(|(_, bytes)| bytes).max().unwrap_or(4096);
        let (largest, smallest) =
            if shadow_tiles > 0 { (page.max(tile), page.min(tile)) } else { (page, page) };
        let pages: u64 = files().map(|(pages, _)| pages).sum();
        let slots = u32::try_from(pages + shadow_tiles).unwrap_or(u32::MAX);
        let of_scenes: u64 = scenes.iter().map(|needs| needs.scene_bytes + needs.caps_bytes).sum();
        // Each thread works on one scene at a time.
        let of_thread = scenes.iter().map(|needs| needs.thread_bytes).max().unwrap_or(0);
        Self {
            threads,
            fixed: of_scenes
                + threads as u64 * of_thread
                + WorkingSet::overhead_bytes(slots)
                + pages * LOOKAHEAD_BYTES
                + READING_BYTES
                + scenes.iter().map(|needs| needs.request_bytes).max().unwrap_or(0),
            page,
            largest,
            smallest,
            file_bytes: files().map(|(pages, bytes)| pages * bytes).sum(),
        }
    }

    /// The least memory that pages need.
    pub(super) fn least_page_bytes(&self) -> u64 {
        least_pages(self.threads) * (self.largest + OVERHEAD_BYTES + self.largest / ALLOCATOR_PART)
    }

    /// Bytes of pages that fit in `room` bytes of memory, and how many of these shadow tables may
    /// take.
    pub(super) fn divide(&self, room: u64) -> (u64, u64) {
        // The overhead per page weighs most for small pages.
        let each = self.smallest + OVERHEAD_BYTES + self.smallest / ALLOCATOR_PART;
        let page_bytes = (room / each * self.smallest).max(least_pages(self.threads) * self.largest);
        let shadow_bytes = page_bytes
            .saturating_sub(self.file_bytes)
            .max(page_bytes / 2)
            .max(SHADOW_TILE_BYTES as u64 * (self.threads as u64 + 1))
            .min(page_bytes);
        (page_bytes, shadow_bytes)
    }
}

/// The smallest number of pages with which threads cannot wait for each other forever: each retains
/// one at a time while another is being loaded.
#[must_use]
pub fn least_pages(threads: usize) -> u64 {
    2 * threads as u64 + 2
}
