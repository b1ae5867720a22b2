//! Lays out runs and nodes in pages, in file order; then writes the header and gives the file its
//! name.
//!
//! Nodes are stored in the order in which they are finished: every group of siblings comes after
//! all its descendants, so that references only point backwards.

use std::io::{self, BufWriter, Cursor, Seek, Write};
use std::path::{Path, PathBuf};

use super::context::Context;
use super::error::BuildError;
use super::pieces::Assemble;
use super::plan::Cell;
use super::subtree::{DraftRun, Piece, Summary};
use super::survey::Survey;

use crate::octree::format::Header;
use crate::octree::layout::{
    ColumnLayout, NODE_BYTES, NodeRef, RUN_HEAD_BYTES, RootCell, least_page_bytes, nodes_per_page,
};
use crate::octree::node::{Node, RunRange, to_cell_units};
use crate::octree::page::RunHead;
use rayset_base::geometry::DVec3;
use rayset_store::container::{
    BLOCK_BYTES, FileKind, Identity, PAGE_HEAD_BYTES, PageHead, PageKind, SectionKind, seal_file,
    stored_page_checksum,
};
use rayset_store::output::{OutputFile, OutputWriter};
use rayset_store::spill::Spill;

/// Below this number of points, pages are smaller, so that the last ones waste less space.
const SMALL_CLOUD_POINTS: u64 = 500_000;

/// An inner node that is not yet finished.
struct OpenNode {
    cell: Cell,
    own: RunRange,
    summary: Summary,
    children: Vec<(u8, Node)>,
}

pub(super) struct Assembler {
    output: Output,
    page_bytes: usize,
    root: RootCell,
    identity: Identity,
    columns: ColumnLayout,
    // The point page that is being filled.
    heads: Vec<RunHead>,
    data: Vec<u8>,
    point_pages: u32,
    point_data_bytes: u64,
    // Node pages are stored temporarily in a spill, because point pages come first in the file.
    node_spill: Spill,
    node_page: Vec<u8>,
    nodes_in_page: usize,
    node_pages: u32,
    nodes: u64,
    open: Vec<OpenNode>,
    finished_root: Option<(Node, Summary)>,
    point_digest: u32,
    node_digest: u32,
    temp_dir: PathBuf,
}

/// The output: a file, through a buffer, or the bytes of a cloud in memory.
pub(super) enum Output {
    File { buffer: BufWriter<OutputWriter>, file: OutputFile },
    Memory(Cursor<Vec<u8>>),
}

trait WriteSeek: Write + Seek {}
impl<T: Write + Seek> WriteSeek for T {}

impl Output {
    pub(super) fn to_file(file: OutputFile) -> Self {
        Self::File { buffer: BufWriter::with_capacity(1 << 20, file.writer()), file }
    }

    pub(super) fn in_memory() -> Self {
        Self::Memory(Cursor::default())
    }

    /// The bytes written to memory; empty for a file.
    pub(super) fn into_bytes(self) -> Vec<u8> {
        match self {
            Self::File { .. } => Vec::new(),
            Self::Memory(bytes) => bytes.into_inner(),
        }
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), BuildError> {
        self.with(|buffer| buffer.write_all(bytes))
    }

    fn with(&mut self, f: impl FnOnce(&mut dyn WriteSeek) -> io::Result<()>) -> Result<(), BuildError> {
        let (written, path) = match self {
            Self::File { buffer, file } => (f(buffer), file.destination().path()),
            Self::Memory(bytes) => (f(bytes), Path::new("memory")),
        };
        written.map_err(|source| BuildError::Io { action: "write", path: path.to_owned(), source })
    }

    /// Makes a file durable and gives it its name.
    pub(super) fn publish(mut self) -> Result<(), BuildError> {
        self.with(|output| output.flush())?;
        if let Self::File { file, .. } = self {
            file.publish()?;
        }
        Ok(())
    }
}

impl Assembler {
    pub(super) fn create(
        context: &Context<'_>,
        survey: &Survey,
        mut output: Output,
    ) -> Result<Self, BuildError> {
        let small = survey.count < SMALL_CLOUD_POINTS;
        let default_bytes = if small { 16 << 10 } else { 32 << 10 };
        let columns = survey.column_layout();
        let least = least_page_bytes(columns);
        let page_bytes = match context.options.page_bytes {
            Some(bytes) if (bytes as usize) < least => {
                let what = format!("{bytes} bytes do not hold 128 points of so many columns; {least} would");
                return Err(BuildError::Option { option: "page size", what });
            }
            Some(bytes) => bytes as usize,
            None => default_bytes.max(least),
        };
        output.write(&[0; BLOCK_BYTES])?;
        Ok(Self {
            output,
            page_bytes,
            root: survey.root,
            identity: survey.identity,
            columns,
            heads: Vec::new(),
            data: Vec::new(),
            point_pages: 0,
            point_data_bytes: 0,
            node_spill: context.spill()?,
            node_page: vec![0; page_bytes],
            nodes_in_page: 0,
            node_pages: 0,
            nodes: 0,
            open: Vec::new(),
            finished_root: None,
            point_digest: 0,
            node_digest: 0,
            temp_dir: context.temp_dir(),
        })
    }

    /// Places runs in pages in order; returns the place of each.
    fn place_runs(&mut self, runs: &[DraftRun], data: &[u8]) -> Result<Vec<RunRange>, BuildError> {
        let mut places = Vec::with_capacity(runs.len());
        for run in runs {
            let heads = data_start(self.heads.len() + 1);
            let bytes = &data[run.data.clone()];
            debug_assert_eq!(bytes.len(), run.head.data_bytes(self.columns));
            if heads + self.data.len() + bytes.len() > self.page_bytes {
                self.finish_point_page()?;
            }
            places.push(RunRange {
                first_page: self.point_pages,
                first_run: self.heads.len() as u16,
                runs: 1,
            });
            self.heads.push(run.head.placed_at(self.data.len() / 4));
            self.data.extend_from_slice(bytes);
        }
        Ok(places)
    }

    fn finish_point_page(&mut self) -> Result<(), BuildError> {
        let mut page = vec![0; self.page_bytes];
        let data_at = data_start(self.heads.len());
        for (index, head) in self.heads.iter().enumerate() {
            let at = PAGE_HEAD_BYTES + index * RUN_HEAD_BYTES;
            head.placed_at(head.place() + data_at / 4).encode(&mut page[at..at + RUN_HEAD_BYTES]);
        }
        page[data_at..data_at + self.data.len()].copy_from_slice(&self.data);
        PageHead {
            kind: PageKind::Points,
            page: self.point_pages,
            records: self.heads.len() as u32,
            used_bytes: (data_at + self.data.len()) as u32,
        }
        .seal(&mut page, self.identity);
        self.point_data_bytes += self.data.len() as u64;
        self.point_pages += 1;
        self.heads.clear();
        self.data.clear();
        self.point_digest = with_page(self.point_digest, &page);
        self.output.write(&page)
    }

    fn node(
        &self,
        summary: &Summary,
        level: u32,
        own: RunRange,
        children: &[(u8, Node)],
        first_child: NodeRef,
    ) -> Node {
        let (bounds_min, bounds_max) = to_cell_units(&summary.influence, self.root);
        let centroid = if summary.mass > 0.0 {
            summary.moment / summary.mass / self.root.size
        } else {
            (summary.influence.center() - self.root.min) / self.root.size
        };
        Node {
            bounds_min,
            bounds_max,
            points: summary.points,
            weight_sum: summary.weight_sum,
            centroid: centroid.to_array().map(|v| v as f32),
            detail_min: summary.detail_min,
            detail_max: summary.detail_max,
            radius_max: summary.radius_max,
            own,
            child_mask: children.iter().fold(0, |mask, (octant, _)| mask | 1 << octant),
            level: level as u8,
            first_child,
        }
    }

    /// Stores siblings next to each other in a page; returns the place of the first.
    fn place_siblings(&mut self, siblings: &[(u8, Node)]) -> Result<NodeRef, BuildError> {
        if siblings.is_empty() {
            return Ok(NodeRef::default());
        }
        if self.nodes_in_page + siblings.len() > nodes_per_page(self.page_bytes) {
            self.finish_node_page()?;
        }
        let place = NodeRef { page: self.node_pages, index: self.nodes_in_page as u16 };
        for (_, node) in siblings {
            let at = PAGE_HEAD_BYTES + self.nodes_in_page * NODE_BYTES;
            node.encode(&mut self.node_page[at..at + NODE_BYTES]);
            self.nodes_in_page += 1;
        }
        self.nodes += siblings.len() as u64;
        Ok(place)
    }

    /// Writes the node page to the spill. Its page number is only known at the end, so it is sealed
    /// then.
    fn finish_node_page(&mut self) -> Result<(), BuildError> {
        self.node_page[..4].copy_from_slice(&(self.nodes_in_page as u32).to_le_bytes());
        let at = u64::from(self.node_pages) * self.page_bytes as u64;
        self.node_spill.write_at(&self.node_page, at).map_err(|source| BuildError::Io {
            action: "write temporary files in",
            path: self.temp_dir.clone(),
            source,
        })?;
        self.node_page.fill(0);
        self.nodes_in_page = 0;
        self.node_pages += 1;
        Ok(())
    }

    /// Places the runs and nodes of a piece; returns its root, which is not stored yet.
    fn place_piece(&mut self, piece: &Piece) -> Result<(Node, Summary), BuildError> {
        let places = self.place_runs(&piece.runs, &piece.data)?;
        let mut done: Vec<Option<Node>> = vec![None; piece.nodes.len()];
        for (index, draft) in piece.nodes.iter().enumerate() {
            let own = range_of(&places[draft.own.clone()]);
            let children: Vec<(u8, Node)> = draft
                .children
                .iter()
                .filter_map(|&(octant, i)| done[i].take().map(|n| (octant, n)))
                .collect();
            let first_child = self.place_siblings(&children)?;
            done[index] = Some(self.node(&draft.summary, draft.level, own, &children, first_child));
        }
        let root = done.pop().flatten().expect("a piece ends with its root");
        Ok((root, piece.nodes[piece.nodes.len() - 1].summary))
    }

    fn attach(&mut self, cell: Cell, node: Node, summary: Summary) {
        match self.open.last_mut() {
            Some(parent) => {
                parent.summary.merge(&summary);
                parent.children.push((cell.octant(), node));
            }
            None => self.finished_root = Some((node, summary)),
        }
    }

    pub(super) fn finish(
        mut self,
        context: &Context<'_>,
        survey: &Survey,
    ) -> Result<(Output, Header), BuildError> {
        if !self.heads.is_empty() {
            self.finish_point_page()?;
        }
        let root = match self.finished_root.take() {
            Some((node, summary)) => Some((self.place_siblings(&[(0, node)])?, summary)),
            None => None,
        };
        if self.nodes_in_page > 0 {
            self.finish_node_page()?;
        }
        self.copy_node_pages(context)?;
        let mut header = self.header(context, survey, root);
        let pages = [
            (SectionKind::POINTS, self.point_pages, self.point_digest),
            (SectionKind::NODES, self.node_pages, self.node_digest),
        ];
        let sections =
            [(SectionKind::CLOUD, header.encode_numbers()), (SectionKind::COLUMNS, header.encode_columns())];
        let (identity, page_bytes, metadata) = (self.identity, header.page_bytes, survey.stored_metadata());
        self.output.with(|mut file| {
            let kind = FileKind::Cloud;
            let whole = seal_file(&mut file, kind, identity, page_bytes, &pages, &sections, &metadata)?;
            header.file_bytes = whole.file_bytes;
            Ok(())
        })?;
        Ok((self.output, header))
    }

    fn copy_node_pages(&mut self, context: &Context<'_>) -> Result<(), BuildError> {
        let mut page = vec![0; self.page_bytes];
        for number in 0..self.node_pages {
            context.check()?;
            let at = u64::from(number) * self.page_bytes as u64;
            self.node_spill.read_at(&mut page, at).map_err(|source| BuildError::Io {
                action: "read temporary files in",
                path: self.temp_dir.clone(),
                source,
            })?;
            let records = u32::from_le_bytes([page[0], page[1], page[2], page[3]]);
            PageHead {
                kind: PageKind::Octree,
                page: self.point_pages + number,
                records,
                used_bytes: (PAGE_HEAD_BYTES + records as usize * NODE_BYTES) as u32,
            }
            .seal(&mut page, self.identity);
            self.node_digest = with_page(self.node_digest, &page);
            self.output.write(&page)?;
        }
        Ok(())
    }

    fn header(&self, context: &Context<'_>, survey: &Survey, root: Option<(NodeRef, Summary)>) -> Header {
        let (radius, weight) = survey.columns();
        let (root, summary) = root.unwrap_or((NodeRef::default(), Summary::EMPTY));
        let mut header = Header {
            identity: self.identity,
            page_bytes: self.page_bytes as u32,
            point_pages: self.point_pages,
            node_pages: self.node_pages,
            file_bytes: 0,
            points: survey.count,
            skipped: survey.skipped.total(),
            nodes: self.nodes,
            root,
            root_min: self.root.min,
            root_size: self.root.size,
            bounds: survey.bounds.inflated(summary.position_error),
            radius,
            // Summed up the tree, so that the last digit does not depend on the order of the input.
            radius_mean: match survey.radius {
                Some(radius) if survey.count > 0 => radius.into(),
                None if survey.count > 0 => summary.radius_sum / survey.count as f64,
                _ => 1.0,
            },
            radius_scale: 1.0,
            weight,
            position_error: summary.position_error,
            position_error_radii: summary.position_error_radii,
            has_color: survey.layout.has_color,
            harmonics: survey.layout.harmonics,
            shape: survey.has_shapes.then_some((summary.detail_min, summary.detail_max)),
            attributes: survey.attributes.clone(),
            point_data_bytes: self.point_data_bytes,
            render_memory: context.options.render_memory.unwrap_or(0),
            crs: survey.metadata.crs.clone(),
            sources: survey.metadata.sources.clone(),
            up: survey.metadata.up(),
            step: survey.metadata.step(),
            copies: survey.metadata.copies,
            aggregates: None,
            columns: self.columns,
        };
        if survey.count == 0 {
            header.bounds = rayset_base::geometry::Aabb::new(DVec3::ZERO, DVec3::ZERO);
        }
        header
    }
}

/// Extends a digest of pages by another page.
fn with_page(digest: u32, page: &[u8]) -> u32 {
    crc32c::crc32c_append(digest, &stored_page_checksum(page).to_le_bytes())
}

/// Offset in a page of `runs` runs at which their data start.
fn data_start(runs: usize) -> usize {
    (PAGE_HEAD_BYTES + runs * RUN_HEAD_BYTES).next_multiple_of(4)
}

/// The range of consecutive places.
fn range_of(places: &[RunRange]) -> RunRange {
    places.first().map_or(RunRange::default(), |first| RunRange { runs: places.len() as u32, ..*first })
}

impl Assemble<Piece> for Assembler {
    fn open(&mut self, cell: Cell) {
        self.open.push(OpenNode {
            cell,
            own: RunRange::default(),
            summary: Summary::EMPTY,
            children: Vec::new(),
        });
    }

    fn own(&mut self, piece: Piece) -> Result<(), BuildError> {
        let places = self.place_runs(&piece.runs, &piece.data)?;
        let node = self.open.last_mut().expect("own points come after their node is opened");
        if node.own.runs == 0 {
            node.own = range_of(&places);
        } else {
            node.own.runs += places.len() as u32;
        }
        piece.runs.iter().for_each(|r| node.summary.merge(&r.summary));
        Ok(())
    }

    fn subtree(&mut self, cell: Cell, piece: Piece) -> Result<(), BuildError> {
        let (node, summary) = self.place_piece(&piece)?;
        self.attach(cell, node, summary);
        Ok(())
    }

    fn close(&mut self) -> Result<(), BuildError> {
        let open = self.open.pop().expect("closed as often as opened");
        let first_child = self.place_siblings(&open.children)?;
        let node = self.node(&open.summary, open.cell.level, open.own, &open.children, first_child);
        self.attach(open.cell, node, open.summary);
        Ok(())
    }
}
