//! From an input and the options to the scene that is rendered, and the line that says what was
//! chosen.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use rayset::file::Header;
use rayset::geometry::DVec3;
use rayset::scene::{Kernel, Lod, SplatFilter};
use rayset::{Cloud, Grid};
use serde_json::{Value, json};

use super::apply::Input;
use super::cloud::CloudLook;
use super::framing::{Axis, one_place, outline, reach};
use super::grid::GridLook;
use super::splats;
use super::statistics::{Statistics, percentile};
use super::turntable::Turntable;
use super::view::{CameraChoice, Orientation};
use crate::style::{Flag, LookName, Style, Words};

/// A scene chosen for an input.
pub struct Chosen {
    /// The scene, as a scene file has it.
    pub scene: Value,
    /// What was chosen, and why.
    pub line: String,
    /// About the middle of the points that are framed; `None` of voxels.
    pub middle: Option<DVec3>,
    /// The name of the look.
    pub look: &'static str,
    /// What is up, and why.
    pub up: String,
    /// What the cameras of a turntable turn about; `None` of one picture, and of an eye whose place
    /// was given.
    pub turntable: Option<Turntable>,
    /// How the input stands, whichever side it is seen from.
    pub stance: Stance,
    /// The classes or labels that its colours tell apart, with their names; none of other colours.
    pub classes: Vec<(f64, String)>,
    /// What opacity is over at some places, estimated.
    pub densities: Densities,
}

impl Chosen {
    /// The kernel by which a cloud is shown, and whether it is normalised.
    #[must_use]
    pub fn kernel(&self) -> (Kernel, bool) {
        let root = &self.scene["root"];
        let kernel = root["kernel"].as_str().and_then(|name| name.parse().ok());
        (kernel.unwrap_or_default(), root["normalised"].as_bool().unwrap_or(false))
    }
}

/// How an input stands in its coordinates.
#[derive(Clone, Debug)]
pub struct Stance {
    /// What is up; length one.
    pub up: DVec3,
    /// The direction in which one looks at the front; length one, at a right angle to `up`.
    pub facing: DVec3,
    /// The least and the largest coordinates of what is framed.
    pub framed: [DVec3; 2],
    /// The outermost places of what is framed, one in each of some directions.
    pub outline: Vec<DVec3>,
}

/// Estimates that cost a while, made when they are asked for.
type Densities = Box<dyn FnOnce() -> Vec<f64>>;

/// The picture that a scene is chosen for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Width and height in pixels.
    pub size: (u32, u32),
    /// Whether it is the first of a turntable, whose others are to see everything, too.
    pub turns: bool,
}

impl From<(u32, u32)> for Picture {
    fn from(size: (u32, u32)) -> Self {
        Self { size, turns: false }
    }
}

/// The scene of a cloud in a style.
///
/// # Errors
/// If a page cannot be read or is damaged, or the style does not fit the cloud.
pub fn of_cloud(cloud: &Arc<Cloud>, style: &Style, picture: impl Into<Picture>) -> Result<Chosen> {
    Looks::of_cloud(cloud.clone())?.chosen(style, picture)
}

/// The scene of a grid in a style.
///
/// # Errors
/// As [`of_cloud`].
pub fn of_grid(grid: &Grid, style: &Style, picture: impl Into<Picture>) -> Result<Chosen> {
    of_sampled_grid(grid, &GridLook::choose(grid, given_up(style))?, style, picture.into())
}

/// The up direction that was given.
fn given_up(style: &Style) -> Option<DVec3> {
    style.up.map(DVec3::from_array)
}

/// A cloud or grid whose look is chosen again and again: what was sampled is kept.
pub struct Looks(Sampled);

enum Sampled {
    Cloud(Arc<Cloud>, Statistics),
    Grid(Box<Grid>, Box<GridLook>),
}

impl Looks {
    /// Of a cloud, of which a sample is read.
    ///
    /// # Errors
    /// If a page cannot be read or is damaged.
    pub fn of_cloud(cloud: Arc<Cloud>) -> Result<Self> {
        let statistics = Statistics::of(&cloud)?;
        Ok(Self(Sampled::Cloud(cloud, statistics)))
    }

    /// Of a grid; `style` says what is up.
    ///
    /// # Errors
    /// As [`of_cloud`](Self::of_cloud).
    pub fn of_grid(grid: Box<Grid>, style: &Style) -> Result<Self> {
        let chosen = GridLook::choose(&grid, given_up(style))?;
        Ok(Self(Sampled::Grid(grid, Box::new(chosen))))
    }

    /// The cloud; `None` of a grid.
    pub fn cloud(&self) -> Option<&Arc<Cloud>> {
        match &self.0 {
            Sampled::Cloud(cloud, _) => Some(cloud),
            Sampled::Grid(..) => None,
        }
    }

    /// The names of looks that there are for it; not all of them for every cloud.
    pub fn names(&self) -> Vec<&'static str> {
        let all = LookName::ALL.iter().map(|(look, _)| *look);
        let is_for_it = |look: &LookName| match &self.0 {
            Sampled::Cloud(..) => !look.is_of_voxels(),
            Sampled::Grid(_, chosen) => chosen.can_be(*look),
        };
        all.filter(is_for_it).map(|look| look.name()).collect()
    }

    /// The scene in a style.
    ///
    /// # Errors
    /// As [`of_cloud`](of_cloud()).
    pub fn chosen(&self, style: &Style, picture: impl Into<Picture>) -> Result<Chosen> {
        let picture = picture.into();
        match &self.0 {
            Sampled::Cloud(cloud, statistics) => of_sampled_cloud(cloud, statistics.clone(), style, picture),
            Sampled::Grid(grid, chosen) => of_sampled_grid(grid, chosen, style, picture),
        }
    }

    /// The values of a stored attribute or a coordinate in a sample; of a grid its values without
    /// the background.
    pub fn values(&self, name: &str) -> Vec<f64> {
        match &self.0 {
            Sampled::Cloud(_, statistics) => statistics.sorted(name),
            Sampled::Grid(_, chosen) => chosen.shown.clone(),
        }
    }
}

fn of_sampled_cloud(
    cloud: &Arc<Cloud>,
    statistics: Statistics,
    style: &Style,
    Picture { size, turns }: Picture,
) -> Result<Chosen> {
    if let Some(name) = style.look.filter(|name| name.is_of_voxels()) {
        bail!(
            "--look {} is for voxels; the input has points, for which `--help` lists the others",
            name.name()
        );
    }
    let camera = CameraChoice { style, turns };
    let mut style = style.clone();
    // Weights that were made of masses are densities already: divided once more by volumes, they
    // are next to nothing.
    let twice = style.normalised == Some(Flag) && weights_are_densities(cloud.header());
    style.normalised = style.normalised.filter(|_| !twice);
    let enlarged =
        if style.radius_scale.is_none() { radii_to_be_seen(cloud, &statistics, &style) } else { None };
    style.radius_scale = style.radius_scale.or(enlarged);
    let (cloud, statistics) = match style.radius_scale {
        // Densities, and the lengths that opacity refers to, are those of the radii that are shown.
        Some(scale) => (&scaled(cloud, scale)?, statistics.with_radius_scale(scale)),
        None => (cloud, statistics),
    };
    let mut chosen = CloudLook::choose(cloud, statistics, style.look, given_up(&style))?;
    if style.recolors() || style.exposure.is_some() {
        // It was for the colours of the points, and is what was asked for.
        chosen.exposure = 0.0;
    }
    let of_splats = style.kernel.is_none_or(|kernel| kernel == Kernel::Splat);
    let filter = chosen.filter.filter(|_| of_splats);
    chosen.filter = filter.map(|guessed| style.splat_filter.unwrap_or(guessed));
    let mut scene = around(
        chosen.root(cloud, &name_in_scene(cloud.address(), cloud.storage().is_some())?),
        &chosen.orientation.reason_and_up(),
        size,
    );
    chosen.dress(cloud, &mut scene);
    let (points, away) = one_place(chosen.points());
    scene["camera"] = camera.scene(&chosen.orientation, &points, aspect(size))?;
    let header = cloud.header();
    let is_filtered = chosen.filter.is_some_and(|filter| filter != SplatFilter::None);
    if is_filtered && style.step.is_none() && style.step_fraction.is_none() {
        splats::lengthen_steps(&mut scene, &points, size.1, header.radius_mean);
    }
    let stored: Vec<&str> = header.attributes.iter().map(|a| a.name.as_str()).collect();
    let stored = if stored.is_empty() {
        "the cloud stores none besides x, y and z; keep columns with `build --attributes`".to_owned()
    } else {
        format!("the cloud stores {}, and x, y and z", stored.join(", "))
    };
    let input = Input {
        has: &|name| header.attribute_number(name).is_some(),
        stored: &stored,
        sorted: &|name| chosen.sorted(name),
        logarithmic: chosen.name == LookName::Gas,
    };
    let by_height = style.color_by.as_deref() == Some("height");
    if by_height && !header.attributes.iter().any(|a| a.name == "height") {
        // In scenes it is z; here it is known what is up.
        style.color_by = Some(chosen.vertical().to_owned());
    }
    style.apply(&mut scene, &input)?;
    let from_afar = match chosen.name {
        LookName::Gas => see_from_afar(cloud, &style, &mut scene),
        _ => "",
    };
    style.apply_image(&mut scene, chosen.exposure);
    let enlarged = enlarged.map_or_else(String::new, |scale| {
        format!("; few points far apart: --radius-scale {scale}, so that they are seen")
    });
    let apart = away.map_or_else(String::new, |away| {
        format!("; the points lie in places {away:.3e} apart, of which the one with the most is framed")
    });
    let shows_height = chosen.name == LookName::Height || by_height;
    let oblique = if shows_height && chosen.orientation.up.abs().max_element() < 0.95 {
        format!("; heights are along {}, the axis nearest to what is up", chosen.vertical())
    } else {
        String::new()
    };
    let twice = if twice {
        "; --normalised is left out: the weights of this cloud are densities already, mass over the volume of the kernel"
    } else {
        ""
    };
    let middle = points.iter().fold(DVec3::ZERO, |sum, (p, _)| sum + *p) / points.len().max(1) as f64;
    Ok(Chosen {
        scene,
        line: chosen.line() + &enlarged + &apart + &oblique + twice + from_afar,
        middle: (!points.is_empty()).then_some(middle),
        look: chosen.name.name(),
        up: chosen.orientation.reason_and_up(),
        turntable: camera.axis(&chosen.orientation, &points).map(turntable),
        stance: stance(&chosen.orientation, &points),
        classes: if style.recolors() { Vec::new() } else { chosen.classes() },
        densities: Box::new(move || chosen.opacity_densities()),
    })
}

/// By what the radii of a few points that are far apart are multiplied, so that the picture is not
/// empty; `None` if they are seen as they are. At two significant digits.
fn radii_to_be_seen(cloud: &Cloud, statistics: &Statistics, style: &Style) -> Option<f64> {
    /// More points than these make a picture however small they are.
    const FEW: u64 = 10_000;
    /// The least radius that is seen, as a part of the extent: a pixel of a small picture…
    const SEEN: f64 = 1.0 / 400.0;
    /// … and the least part of the square of the extent that all points' squares of radii add up
    /// to.
    const COVERED: f64 = 4e-3;
    let count = cloud.header().points;
    // Splats are as large as they were made.
    let are_splats = cloud.header().sources.iter().any(|source| source.contains("Gaussian splat"));
    if count > FEW || are_splats || matches!(style.look, Some(LookName::Density | LookName::Splats)) {
        return None;
    }
    // Of what will be framed.
    let (framed, _) = one_place(statistics.positions().map(|p| (p, 0.0)).collect());
    let ends = |of: fn(DVec3, DVec3) -> DVec3| framed.iter().map(|(p, _)| *p).reduce(of);
    let extent = ends(DVec3::max).unwrap_or_default().distance(ends(DVec3::min).unwrap_or_default());
    let least = extent * (COVERED / count as f64).sqrt().clamp(SEEN, 8.0 * SEEN);
    // If a few are seen, more radius would make them hide the others.
    let radius = percentile(&statistics.sorted("radius"), 0.9);
    let scale = least / radius;
    let digits = 10_f64.powf(scale.log10().floor() - 1.0);
    (radius > 0.0 && scale.is_finite() && scale > 1.0).then(|| ((scale / digits).ceil() * digits).min(1e3))
}

/// Whether all weights of a cloud were made of masses and volumes of kernels, as its sources say.
fn weights_are_densities(header: &Header) -> bool {
    let sources = &header.sources;
    header.weight.is_stored()
        && !sources.is_empty()
        && sources.iter().all(|said| said.contains("weight = mass"))
}

/// A cloud with other radii.
fn scaled(cloud: &Arc<Cloud>, scale: f64) -> Result<Arc<Cloud>> {
    let scaled = cloud.with_radius_scale(scale as f32);
    scaled
        .map(Arc::new)
        .with_context(|| format!("--radius-scale {scale}: radii would not be from 1e-18 to 1e18"))
}

fn of_sampled_grid(
    grid: &Grid,
    chosen: &GridLook,
    style: &Style,
    Picture { size, turns }: Picture,
) -> Result<Chosen> {
    let camera = CameraChoice { style, turns };
    let name = chosen.named(style.look)?;
    let (file, points) = (name_in_scene(grid.address(), grid.storage().is_some())?, chosen.points(name));
    let mut scene = around(chosen.root(name, &file), &chosen.orientation.reason_and_up(), size);
    chosen.dress(name, &mut scene);
    scene["camera"] = camera.scene(&chosen.orientation, points, aspect(size))?;
    let input = Input {
        has: &|_| false,
        stored: "a grid has nothing but its values",
        sorted: &|_| Some(chosen.shown.clone()),
        logarithmic: false,
    };
    style.apply(&mut scene, &input)?;
    style.apply_image(&mut scene, 0.0);
    Ok(Chosen {
        scene,
        line: chosen.line(name),
        middle: None,
        look: name.name(),
        up: chosen.orientation.reason_and_up(),
        turntable: camera.axis(&chosen.orientation, points).map(turntable),
        stance: stance(&chosen.orientation, points),
        classes: if style.recolors() { Vec::new() } else { chosen.classes(name) },
        densities: {
            let shown = chosen.shown.clone();
            Box::new(move || shown)
        },
    })
}

/// Lets a cloud of gas be seen from afar, if its aggregates are for its kernel: one ray of a pixel
/// then sees all of it. Returns what is to be said.
fn see_from_afar(cloud: &Cloud, style: &Style, scene: &mut Value) -> &'static str {
    let (header, root) = (cloud.header(), &scene["root"]);
    let can_be = header.radius_scale == 1.0
        && root["radiusScale"].is_null()
        && header.weight.min() >= 0.0
        && header.points >= MANY_POINTS;
    let Some(aggregates) = &header.aggregates else {
        let by_default = style.lod.is_none() && style.kernel.is_none() && style.normalised.is_none();
        return if can_be && by_default { NO_AGGREGATES } else { "" };
    };
    let kernel = root["kernel"].as_str().map_or(Some(Kernel::default()), |name| name.parse().ok());
    let is_right = kernel == Some(aggregates.kernel)
        && root["normalised"].as_bool().unwrap_or(false) == aggregates.normalised
        && header.radius_scale == 1.0
        && root["radiusScale"].is_null();
    if !is_right || style.lod == Some(Lod::Off) {
        return "";
    }
    scene["rendering"]["lod"] = json!("coarse");
    // Of what is narrower than a pixel, one ray does not see all.
    if !matches!(style.lod, Some(Lod::Footprint(factor)) if factor < 1.0) {
        scene["image"]["samples"] = json!(1);
    }
    "; small points are seen together (--lod off: each by itself)"
}

/// Of so many points and more, gas is seen from afar: each ray goes through all of it, and most of
/// the time of its pictures would go into points that are small beside a pixel.
pub const MANY_POINTS: u64 = 200_000;

/// What is said of gas that could be seen from afar.
const NO_AGGREGATES: &str = "; every point is looked at: `rayset lod FILE` adds to a cloud file what makes pictures like this in a part of the time";

fn stance(orientation: &Orientation, points: &[(DVec3, f64)]) -> Stance {
    let framed = reach(points);
    Stance { up: orientation.up, facing: orientation.facing, framed, outline: outline(points, framed) }
}

/// A scene of one object, without camera and lights.
fn around(root: Value, comment: &str, (width, height): (u32, u32)) -> Value {
    let mut root = root;
    root["comment"] = json!(comment);
    json!({
        "rayset": 1,
        "image": {"size": [width, height], "samples": 2},
        "rendering": {},
        "root": root,
    })
}

fn turntable(Axis { center, up }: Axis) -> Turntable {
    Turntable { center, axis: up }
}

fn aspect((width, height): (u32, u32)) -> f64 {
    f64::from(width) / f64::from(height)
}

/// The path of a file for a scene that may be rendered from anywhere; what is in memory has its
/// name.
fn name_in_scene(path: &Path, in_memory: bool) -> Result<String> {
    let whole = if in_memory { Ok(path.to_owned()) } else { std::fs::canonicalize(path) };
    let path = whole.with_context(|| format!("cannot open {}", path.display()))?;
    let Some(text) = path.to_str() else {
        bail!("{}: a path that is not UTF-8 cannot stand in a scene; rename the file", path.display())
    };
    Ok(text.to_owned())
}
