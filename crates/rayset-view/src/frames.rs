//! The pictures of one page: a thread takes what the page wants, has the session trace it, and
//! sends it, coarse first.

use std::sync::Arc;
use std::time::{Duration, Instant};

use rayset::image::Band;
use rayset::scene::{Lod, RenderSettings, Samples, Shadows, Step};
use rayset::scene_file::SceneFile;
use rayset::{
    BandSink, CancelToken, FinishedTile, PreparedScene, RenderError, Session, SinkError, View, Work,
};
use serde_json::Value;

use crate::asks::{Current, VisibleScene};
use crate::compose::{self, Opened};
use crate::pacing::Pacing;
use crate::payload::{self, Depths, DisplayPicture, Rectangle};
use crate::picking::clouds;
use crate::protocol::{Changes, MOST_EDGE, Show, ToPage};
use crate::wanted::{Grade, Order, PageWish};

/// Finished parts of a picture are sent at most this often.
const BETWEEN_PARTS: Duration = Duration::from_millis(40);
/// Rows of a finished picture that are sent together.
const BAND_ROWS: u32 = 16;
/// Pixels in a message, about: few enough that a slow line carries it in seconds.
const MOST_PIXELS: usize = 128 << 10;
/// What the page shows where a moving picture is transparent.
const BEHIND: [u8; 3] = [0x26, 0x2a, 0x31];

/// What goes to a page.
#[derive(Debug)]
pub(crate) enum Outgoing {
    Text(ToPage),
    Frame(Vec<u8>),
}

/// Where it goes; `false` if the page has gone.
pub(crate) type Send = Box<dyn Fn(Outgoing) -> bool + std::marker::Send>;

/// Makes the pictures of one page.
pub(crate) struct Frames {
    session: Session,
    opened: Arc<Opened>,
    wanted: Arc<PageWish>,
    send: Send,
    most_pixels: u64,
    /// What was shown last at rest.
    prepared: Option<Prepared>,
    /// What was shown last while it moved: with longer steps and coarser shadows, and without caps,
    /// which take a while.
    draft: Option<Prepared>,
    /// Told of what is shown, for those who ask about it.
    current: Current,
    /// The changes whose legend the page was told last, and the remarks in it.
    told: Option<(Changes, Vec<String>)>,
    pacing: Pacing,
    shown: DisplayPicture,
    depths: Depths,
}

/// A scene that is ready to be traced.
struct Prepared {
    /// What it was made from, without the camera.
    composed: Value,
    scene: PreparedScene,
    file: Arc<SceneFile>,
    /// With which it was prepared.
    lod: Lod,
}

impl Prepared {
    /// Whether a draft with cells so wide is the same.
    fn has_cells(&self, cells: f32) -> bool {
        drafted(self.file.settings, cells).lod == self.lod
    }

    fn seen(&self) -> VisibleScene {
        VisibleScene { file: self.file.clone(), scene: self.scene.clone() }
    }

    /// Whether a pixel depends on its neighbours: tiles one by one are not the picture then.
    fn looks_at_neighbours(&self) -> bool {
        let RenderSettings { ambient_occlusion, samples, .. } = self.file.settings;
        ambient_occlusion > 0.0 || matches!(samples, Samples::Auto { .. })
    }
}

/// Settings with which a picture that moves is traced in a fraction of the time. Steps of a radius,
/// four times the customary ones, hardly ever miss a surface. What is seen from afar is seen in
/// coarser cells, of gas at least so many pixels wide. Surfaces would have gaps between them:
/// theirs are two pixels wide.
fn drafted(settings: RenderSettings, cells: f32) -> RenderSettings {
    const STEPS: f64 = 4.0;
    const LONGEST_FRACTION: f64 = 1.0;
    const SHADOW_RESOLUTION: u32 = 256;
    const SURFACE_CELLS: f32 = 2.0;
    let step = match settings.step {
        Step::Automatic { fraction } => {
            Step::Automatic { fraction: (STEPS * fraction).min(LONGEST_FRACTION).max(fraction) }
        }
        other => other,
    };
    let shadows = match settings.shadows {
        Shadows::Cached { resolution } => Shadows::Cached { resolution: resolution.min(SHADOW_RESOLUTION) },
        _ => Shadows::Cached { resolution: SHADOW_RESOLUTION },
    };
    let lod = match settings.lod {
        Lod::Footprint(factor) => Lod::Coarse((SURFACE_CELLS * factor).clamp(1.0, Lod::FACTORS.1)),
        Lod::Coarse(factor) => Lod::Coarse(factor.max(cells)),
        other => other,
    };
    settings.with_step(step).with_shadows(shadows).with_lod(lod)
}

/// Why a picture was not completed.
enum Unfinished {
    /// Something else is wanted, or nobody looks any more.
    GivenUp,
    /// It cannot be made.
    Problem(String),
    /// There is no memory for its scene.
    NoMemory(String),
}

impl From<RenderError> for Unfinished {
    fn from(error: RenderError) -> Self {
        match error {
            // A sink refuses what it cannot send.
            RenderError::Cancelled | RenderError::Sink(_) => Self::GivenUp,
            RenderError::Memory { .. } => Self::NoMemory(error.to_string()),
            other => Self::Problem(other.to_string()),
        }
    }
}

impl Frames {
    pub(crate) fn new(
        session: Session,
        opened: Arc<Opened>,
        most_pixels: u64,
        wanted: Arc<PageWish>,
        current: Current,
        send: Send,
    ) -> Self {
        let (pacing, shown, depths) = (Pacing::new(), DisplayPicture::default(), Depths::default());
        let (prepared, draft, told) = (None, None, None);
        Self {
            session,
            opened,
            most_pixels,
            wanted,
            send,
            prepared,
            draft,
            current,
            told,
            pacing,
            shown,
            depths,
        }
    }

    /// Makes pictures until nobody looks any more.
    pub(crate) fn run(mut self) {
        let mut at_rest_since = Instant::now();
        while let Some(order) = self.wanted.next() {
            if order.grade == Grade::Quick {
                at_rest_since = Instant::now();
            }
            let generation = order.show.generation;
            match self.picture(&order) {
                Ok(()) => {
                    self.wanted.done(&order);
                    if order.grade == Grade::Fine {
                        let seconds = at_rest_since.elapsed().as_secs_f64();
                        (self.send)(Outgoing::Text(ToPage::Converged { generation, seconds }));
                    }
                }
                Err(Unfinished::GivenUp) => self.wanted.given_up(),
                Err(Unfinished::Problem(what) | Unfinished::NoMemory(what)) => {
                    self.current.set(None);
                    self.wanted.failed(&order);
                    (self.send)(Outgoing::Text(ToPage::Problem { generation, what }));
                }
            }
        }
    }

    fn picture(&mut self, order: &Order) -> Result<(), Unfinished> {
        let show = &*order.show;
        // What it may cost says which scene is needed, too.
        let quick = (order.grade == Grade::Quick).then(|| self.pacing.next_size(show.size));
        let prepared = self.prepared(show, order.grade)?;
        let encode = prepared.file.display_transform.rgba8();
        let (scene, camera) = (prepared.scene.clone(), compose::camera(&show.camera));
        let looks_at_neighbours = prepared.looks_at_neighbours();
        self.tell_legend(&show.changes, scene.remarks())?;
        match quick {
            Some([width, height]) => {
                let view = scene.view_of_size(&camera, width, height)?.with_samples(1)?;
                self.quick(order, &view, [width, height], scene.longest_step(), &encode)
            }
            None => {
                let view = scene.view_of_size(&camera, show.size[0], show.size[1])?;
                self.fine(order, &view, looks_at_neighbours, &encode)
            }
        }
    }

    /// The scene that a page wants. Only what has changed is prepared anew: never for the camera
    /// alone.
    fn prepared(&mut self, show: &Show, grade: Grade) -> Result<&Prepared, Unfinished> {
        show.check(MOST_EDGE, self.most_pixels).map_err(Unfinished::Problem)?;
        let whole = self.without_camera(show, true)?;
        if self.prepared.as_ref().is_some_and(|known| known.composed != whole) {
            // What is not shown any more makes room before anything else is made.
            self.current.set(None);
            (self.prepared, self.draft) = (None, None);
        }
        // Once caps have been made, they stay where they are while it moves.
        if grade == Grade::Fine || show.changes.cap.is_some() && self.prepared.is_some() {
            if self.prepared.is_none() {
                self.prepared = Some(self.at_rest(whole)?);
            }
            let prepared = self.prepared.as_ref().ok_or(Unfinished::GivenUp)?;
            self.current.set(Some(prepared.seen()));
            return Ok(prepared);
        }
        let draft = self.without_camera(show, false)?;
        let cells = self.pacing.cells();
        let known = self.draft.take().filter(|known| known.composed == draft && known.has_cells(cells));
        if known.is_none() && self.prepared.is_none() {
            // The one before makes room.
            self.current.set(None);
        }
        let draft = known.map_or_else(|| self.prepare(draft, |settings| drafted(settings, cells)), Ok)?;
        if self.prepared.is_none() {
            self.current.set(Some(draft.seen()));
        }
        Ok(self.draft.insert(draft))
    }

    /// What a page wants to see, the camera and the size aside.
    fn without_camera(&self, show: &Show, with_caps: bool) -> Result<Value, Unfinished> {
        let mut composed = self.opened.composed(show, with_caps).map_err(Unfinished::Problem)?;
        // Any will do; the scene file's own are those that were opened.
        if let Some(keys) = composed.as_object_mut() {
            keys.remove("camera");
        }
        if let Some(image) = composed["image"].as_object_mut() {
            image.remove("size");
        }
        Ok(composed)
    }

    /// A scene to be seen at rest. If there is no memory for it besides the one that moves, that
    /// one is made again when it is needed.
    fn at_rest(&mut self, composed: Value) -> Result<Prepared, Unfinished> {
        let first = self.prepare(composed.clone(), |settings| settings);
        if matches!(first, Err(Unfinished::NoMemory(_))) && self.draft.take().is_some() {
            self.current.set(None);
            return self.prepare(composed, |settings| settings);
        }
        first
    }

    fn prepare(
        &self,
        composed: Value,
        adapted: impl Fn(RenderSettings) -> RenderSettings,
    ) -> Result<Prepared, Unfinished> {
        let file = self.opened.parse(&composed).map_err(Unfinished::Problem)?;
        // Distances, with which the page moves a picture until the next has come. They change no
        // pixel.
        let settings = adapted(file.settings).with_depths(true);
        let scene = self.session.prepare(&file.scene, &settings)?;
        self.pin_nodes();
        Ok(Prepared { composed, scene, file: Arc::new(file), lod: settings.lod })
    }

    /// Tells the page what its changes show in which colours. Other changes may need no other
    /// scene; the page waits for their legend all the same.
    fn tell_legend(&mut self, changes: &Changes, remarks: &[String]) -> Result<(), Unfinished> {
        let is_told = |(told, said): &(Changes, Vec<String>)| told == changes && said == remarks;
        if self.told.as_ref().is_some_and(is_told) {
            return Ok(());
        }
        let legend = self.opened.legend(changes, remarks).map_err(Unfinished::Problem)?;
        (self.send)(Outgoing::Text(ToPage::Styled(Box::new(legend))));
        self.told = Some((changes.clone(), remarks.to_vec()));
        Ok(())
    }

    /// Keeps the coarse parts of octrees in memory, where they take little of it: a camera that
    /// jumps needs them first.
    fn pin_nodes(&self) {
        const PART: u64 = 8;
        let clouds = clouds(&self.opened.file.scene.root);
        let each = self.session.page_budget_bytes() / PART / clouds.len().max(1) as u64;
        for (object, _) in clouds {
            // Pictures do without; what is wrong with a file is said where it is rendered.
            let _ = self.session.pin_nodes(&object.cloud, each);
        }
    }

    /// One frame of as many rays as its time allows, as JPEG.
    fn quick(
        &mut self,
        order: &Order,
        view: &View,
        size: [u32; 2],
        step: f64,
        encode: &impl Fn([f32; 4]) -> [u8; 4],
    ) -> Result<(), Unfinished> {
        let started = Instant::now();
        self.shown.resize(size);
        self.depths.resize(size, step);
        let (shown, depths) = (&mut self.shown, &mut self.depths);
        let mut sink = |finished: &FinishedTile<'_>| -> Result<(), SinkError> {
            put(shown, finished, encode);
            let tile = finished.tile;
            for (y, row) in (tile.y..).zip(finished.layers.chunks(tile.width as usize)) {
                depths.set_row(tile.x, y, row.iter().map(|pixel| pixel.depth));
            }
            Ok(())
        };
        let rendered = view.render(&Work::tiles(view.tiles(&view.region())), &order.cancel, &mut sink);
        if let Err(error) = rendered {
            self.pacing.gave_up(size, started.elapsed());
            return Err(error.into());
        }
        self.pacing.traced(size, started.elapsed());
        let frame = self.wanted.wait_to_send(&order.cancel).ok_or(Unfinished::GivenUp)?;
        self.give(payload::whole(order.show.generation, frame, &self.shown, &self.depths, BEHIND))
    }

    /// The picture that `rayset render` makes, part by part, without loss: one ray a pixel first,
    /// then all.
    fn fine(
        &mut self,
        order: &Order,
        view: &View,
        looks_at_neighbours: bool,
        encode: &impl Fn([f32; 4]) -> [u8; 4],
    ) -> Result<(), Unfinished> {
        self.shown.resize(order.show.size);
        let mut parts = Parts {
            generation: order.show.generation,
            shown: &mut self.shown,
            waiting: Vec::new(),
            pixels: 0,
            sent: Instant::now(),
            wanted: &self.wanted,
            send: &self.send,
            cancel: &order.cancel,
        };
        let tiles = Work::tiles(view.tiles(&view.region()));
        let mut sink = |finished: &FinishedTile<'_>| {
            put(parts.shown, finished, encode);
            let tile = finished.tile;
            parts.add([tile.x as u16, tile.y as u16, tile.width as u16, tile.height as u16])
        };
        if looks_at_neighbours {
            view.clone().with_samples(1)?.render(&tiles, &order.cancel, &mut sink)?;
            let mut bands = Bands { parts: &mut parts, encode };
            view.render_bands(&view.region(), BAND_ROWS, &order.cancel, &mut bands)?;
        } else {
            view.render(&tiles.progressive(), &order.cancel, &mut sink)?;
        }
        Ok(parts.flush()?)
    }

    fn give(&self, frame: Vec<u8>) -> Result<(), Unfinished> {
        if (self.send)(Outgoing::Frame(frame)) { Ok(()) } else { Err(Unfinished::GivenUp) }
    }
}

/// Puts a tile in its place.
fn put(shown: &mut DisplayPicture, finished: &FinishedTile<'_>, encode: &impl Fn([f32; 4]) -> [u8; 4]) {
    let tile = finished.tile;
    for (row, pixels) in finished.pixels.chunks(tile.width as usize).enumerate() {
        shown.set_row(tile.x, tile.y + row as u32, pixels.iter().map(|&pixel| encode(pixel)));
    }
}

/// Parts of a picture that have been finished and not yet sent.
struct Parts<'a> {
    generation: u32,
    shown: &'a mut DisplayPicture,
    waiting: Vec<Rectangle>,
    /// In these.
    pixels: usize,
    sent: Instant,
    wanted: &'a PageWish,
    send: &'a Send,
    cancel: &'a CancelToken,
}

impl Parts<'_> {
    /// Adds a part, and sends all if it is time and the page has drawn what it got before.
    fn add(&mut self, part: Rectangle) -> Result<(), SinkError> {
        self.waiting.push(part);
        self.pixels += usize::from(part[2]) * usize::from(part[3]);
        if self.pixels >= MOST_PIXELS {
            return self.flush();
        }
        if self.sent.elapsed() >= BETWEEN_PARTS
            && let Some(frame) = self.wanted.try_send()
        {
            return self.send_as(frame);
        }
        Ok(())
    }

    /// Sends what waits, as soon as the page can take it.
    fn flush(&mut self) -> Result<(), SinkError> {
        if self.waiting.is_empty() {
            return Ok(());
        }
        let frame = self.wanted.wait_to_send(self.cancel).ok_or(RenderError::Cancelled)?;
        self.send_as(frame)
    }

    fn send_as(&mut self, frame: u32) -> Result<(), SinkError> {
        let message = payload::parts(self.generation, frame, self.shown, &self.waiting);
        self.waiting.clear();
        self.pixels = 0;
        self.sent = Instant::now();
        if (self.send)(Outgoing::Frame(message)) { Ok(()) } else { Err(RenderError::Cancelled.into()) }
    }
}

impl From<SinkError> for Unfinished {
    fn from(_: SinkError) -> Self {
        Self::GivenUp
    }
}

/// Takes a finished picture band by band.
struct Bands<'a, 'p, E> {
    parts: &'a mut Parts<'p>,
    encode: &'a E,
}

impl<E: Fn([f32; 4]) -> [u8; 4]> BandSink for Bands<'_, '_, E> {
    fn band(&mut self, band: &Band) -> Result<(), SinkError> {
        for (y, pixels) in (band.first_row..).zip(band.pixels.chunks(band.width as usize)) {
            self.parts.shown.set_row(0, y, pixels.iter().map(|&pixel| (self.encode)(pixel)));
        }
        let rows = band.pixels.len() / band.width as usize;
        self.parts.add([0, band.first_row as u16, band.width as u16, rows as u16])
    }
}
