//! The colour map in use: which it is, and its bar or, of classes and labels, its list.

use rayset::Cloud;
use rayset::scene::{Channel, ColorMap, ColorRule, GridObject, MapInput, Palette, Scene, Shape, Transfer};
use rayset_inputs::units;

use super::canvas::{Color, Piece, Shape as Drawn, rectangle};
use super::classes::{self, Class, View};
use super::layout::Layout;
use super::space::Space;
use super::text::Wrapped;
use super::ticks::{self, Tick};

/// Most lines of a title.
const TITLE_LINES: usize = 4;

/// A colour map of a scene, with what it shows.
pub(super) struct LabelledMap {
    map: ColorMap,
    /// `height (m)`
    title: String,
    /// The classes that occur, with their names, if it shows classes.
    classes: Option<Vec<Class>>,
}

impl LabelledMap {
    /// All maps of a scene, in the order of its graph.
    pub(super) fn all_of(scene: &Scene, space: Space) -> Vec<Self> {
        let mut found: Vec<Self> = Vec::new();
        scene.root.for_each(&mut |node| {
            let own = match &node.shape {
                Shape::Cloud(object) => match &object.transfer.color {
                    ColorRule::Map { map, input } => Some(Self::of_cloud(&object.cloud, map, *input, space)),
                    _ => None,
                },
                Shape::Grid(object) => match &object.transfer.color {
                    ColorRule::Map { map, .. } => Some(Self::of_grid(object, map)),
                    _ => None,
                },
                _ => None,
            };
            let others = node.transfers.iter().filter_map(|transfer| match transfer {
                Transfer::Color { input, map } => Some(Self::named(map, channel_name(input), "")),
                _ => None,
            });
            for shown in own.into_iter().chain(others) {
                if !found.iter().any(|known| known.map == shown.map && known.title == shown.title) {
                    found.push(shown);
                }
            }
        });
        found
    }

    fn of_cloud(cloud: &Cloud, map: &ColorMap, input: MapInput, space: Space) -> Self {
        let header = cloud.header();
        let MapInput::Attribute(number) = input else {
            return Self::named(map, "density", &unit_of_density(cloud));
        };
        match header.attributes.get(number) {
            Some(attribute) => Self {
                classes: attribute.is_class.then(|| classes::in_use(cloud, &attribute.name)),
                ..Self::named(map, &attribute.name, &units::readable(&attribute.name, &attribute.unit))
            },
            None => {
                let axis = ["x", "y", "z"].get(number - header.attributes.len()).unwrap_or(&"");
                Self::named(map, axis, space.unit.unwrap_or(""))
            }
        }
    }

    fn of_grid(object: &GridObject, map: &ColorMap) -> Self {
        let is_named = object.labels && !object.grid.header().labels.values.is_empty();
        if !is_named {
            return Self::named(map, "value", "");
        }
        let shows = |value| object.transfer.opacity.shows_between(value, value);
        let classes = Some(classes::labels(&object.grid, shows));
        Self { classes, ..Self::named(map, "label", "") }
    }

    fn named(map: &ColorMap, name: &str, unit: &str) -> Self {
        let title = if unit.is_empty() { name.to_owned() } else { format!("{name} ({unit})") };
        Self { map: map.clone(), title, classes: None }
    }

    /// The bar, or the list of the classes that `view` sees, at the right of a picture; without a
    /// view, of all classes.
    pub(super) fn piece(&self, layout: &Layout, view: Option<&View<'_>>) -> Piece {
        match (&self.classes, view) {
            (Some(classes), Some(view)) => self.list(&classes::seen(classes, view), layout),
            (Some(classes), None) => self.list(&classes.iter().collect::<Vec<_>>(), layout),
            (None, _) => Bar::new(&self.map, &self.title, layout).piece(layout),
        }
    }

    /// Bytes that the classes' places take.
    pub(super) fn bytes(&self) -> u64 {
        self.classes.iter().flatten().map(Class::bytes).sum()
    }

    fn list(&self, classes: &[&Class], layout: &Layout) -> Piece {
        let (em, margin) = (layout.em, layout.margin);
        let row = 1.45 * em;
        let (upper, lower) = layout.at_the_right();
        let room = layout.room_at_the_right(0.4);
        let title = layout.font.wrapped(&self.title, em, room, TITLE_LINES);
        let below = lower - upper - row - title.drop();
        let most = (((0.7 * layout.height()).min(below) / row) as usize).max(1);
        let (listed, of_name) = (classes.iter().take(most), room - 1.6 * em);
        let sizes = [1.0, 0.9, 0.8].map(|part| part * em);
        let fits = |size: &f32| listed.clone().all(|class| layout.font.width(&class.name, *size) <= of_name);
        let size = sizes.into_iter().find(fits).unwrap_or(sizes[2]);
        let mut rows: Vec<(Option<Color>, String)> = listed
            .map(|Class { value, name, .. }| {
                (Some(color_at(&self.map, *value)), layout.font.shortened_within(name, size, of_name))
            })
            .collect();
        if classes.len() > most {
            rows.push((None, format!("and {} more", classes.len() - most)));
        }
        let widest = rows.iter().map(|(_, text)| layout.font.width(text, size)).fold(0.0, f32::max);
        let widest = (widest + 1.6 * em).max(title.width(&layout.font));
        let left = (layout.width() - margin - widest).max(margin).round();
        let height = row * (rows.len() + 1) as f32 + title.drop();
        let top = (0.5 * (upper + lower - height)).max(upper.max(margin)).round();
        let mut piece = layout.panel((left, top), (left + widest, top + height));
        let mut text = Vec::new();
        title.write(&layout.font, (left, top + em), &mut text);
        for (i, (color, name)) in rows.iter().enumerate() {
            let y = (top + title.drop() + row * (i + 1) as f32).round();
            if let Some(color) = color {
                let side = em.round();
                let swatch = rectangle(left, y + 0.1 * em, side, side);
                piece.shapes.push(layout.halo(&swatch));
                piece.shapes.push(Drawn::Fill { path: swatch, color: *color });
            }
            layout.font.write(name, size, (left + 1.6 * em, y + 0.95 * em), &mut text);
        }
        layout.write(&mut piece, text);
        piece
    }
}

/// The unit of the density of a snapshot whose weights are made of masses: that which the file
/// states of densities, else a mass in a cube; empty of anything else.
fn unit_of_density(cloud: &Cloud) -> String {
    let header = cloud.header();
    if !header.sources.iter().any(|source| source.contains("weight = mass")) {
        return String::new();
    }
    let unit = |name: &str| {
        let found = header.attributes.iter().find(|a| a.name == name && !a.unit.is_empty())?;
        Some(units::readable(&found.name, &found.unit))
    };
    let per_volume = || Some(format!("{} / ({})³", unit("mass")?, units::of_positions(&header.sources)?));
    unit("Density").or_else(per_volume).unwrap_or_default()
}

fn channel_name(channel: &Channel) -> &str {
    match channel {
        Channel::Opacity => "opacity",
        Channel::Red => "red",
        Channel::Green => "green",
        Channel::Blue => "blue",
        Channel::Attribute(name) => name,
        _ => "",
    }
}

/// The colour of a value, as displayed.
pub(super) fn color_at(map: &ColorMap, value: f64) -> Color {
    let (low, high) = map.range;
    map.palette.display_color((value - low) / (high - low)).map(|v| (v * 255.0).round() as u8)
}

/// Whether a map is one over the logarithm: its stops stand for values that grow by the same factor
/// from one to the next.
fn is_logarithmic(map: &ColorMap) -> bool {
    /// Fewer stops may be so by chance.
    const FEWEST: usize = 8;
    let Palette::Stops(stops) = &map.palette else { return false };
    let (low, high) = map.range;
    let values: Vec<f64> = stops.iter().map(|(at, _)| low + at * (high - low)).collect();
    let factors: Vec<f64> = values.windows(2).map(|pair| pair[1] / pair[0]).collect();
    let Some(&last) = factors.last() else { return false };
    // Near the lower end, places are differences of nearly equal numbers.
    values.len() >= FEWEST
        && values.iter().all(|v| *v > 0.0)
        && (last - 1.0).abs() > 1e-3
        && factors.iter().all(|factor| (factor / last - 1.0).abs() < 1e-4)
}

/// A bar of colours with its scale.
pub(super) struct Bar<'m> {
    map: &'m ColorMap,
    title: Wrapped,
    logarithmic: bool,
    least: f64,
    most: f64,
    ticks: Vec<Tick>,
    left: f32,
    top: f32,
    width: f32,
    height: f32,
    /// Left end of the title, and right end of everything.
    title_left: f32,
    right: f32,
}

impl<'m> Bar<'m> {
    pub(super) fn new(map: &'m ColorMap, title: &str, layout: &Layout) -> Self {
        let em = layout.em;
        let (least, most) = (map.range.0.min(map.range.1), map.range.0.max(map.range.1));
        let logarithmic = is_logarithmic(map);
        let (upper, lower) = layout.at_the_right();
        let room = layout.room_at_the_right(0.6);
        // The number at the title, if there is one, may need a line more; ticks depend on the
        // height.
        let above = layout.font.wrapped(&format!("{title} ×10⁻¹⁰"), em, room, TITLE_LINES).drop();
        let height = (0.46 * layout.height()).min(lower - upper - 3.0 * em - above).max(em).round();
        // Labels have room for themselves and as much again.
        let wanted = f64::from((height / (2.8 * em)).clamp(1.0, 7.0));
        let found = if logarithmic {
            ticks::logarithmic(least, most, wanted)
        } else {
            ticks::linear(least, most, wanted)
        };
        let title = match found.power {
            0 => title.to_owned(),
            power => format!("{title} ×{}", ticks::power_of_ten(power)),
        };
        let title = layout.font.wrapped(&title, em, room, TITLE_LINES);
        let label = |tick: &Tick| layout.font.width(&tick.label, em);
        let labels = found.ticks.iter().map(label).fold(0.0, f32::max);
        let right = layout.width() - layout.margin;
        let width = (1.1 * em).round().max(3.0);
        let left = (right - labels - 0.7 * em - width).round();
        let title_left = left.min(right - title.width(&layout.font)).max(layout.margin);
        let top = (0.5 * (upper + lower - height + title.drop()) + 0.6 * em).round();
        let ticks = found.ticks;
        Self { map, title, logarithmic, least, most, ticks, left, top, width, height, title_left, right }
    }

    /// The value at a share of the bar's height.
    fn value(&self, share: f64) -> f64 {
        if self.logarithmic {
            self.least * (self.most / self.least).powf(share)
        } else {
            self.least + share * (self.most - self.least)
        }
    }

    /// How far below the picture's upper edge a value stands.
    pub(super) fn y_of(&self, value: f64) -> f32 {
        let share = if self.logarithmic {
            (value / self.least).ln() / (self.most / self.least).ln()
        } else {
            (value - self.least) / (self.most - self.least)
        };
        self.top + self.height * (1.0 - share) as f32
    }

    fn piece(&self, layout: &Layout) -> Piece {
        let em = layout.em;
        let mut piece = layout.panel(
            (self.title_left.min(self.left), self.top - 1.7 * em - self.title.drop()),
            (self.right, self.top + self.height + 0.2 * em),
        );
        let frame = layout.line;
        let around = rectangle(
            self.left - frame,
            self.top - frame,
            self.width + 2.0 * frame,
            self.height + 2.0 * frame,
        );
        piece.shapes.push(layout.halo(&around));
        let mut ink = around;
        let tick = 0.3 * em;
        for y in self.ticks.iter().map(|tick| self.y_of(tick.value)) {
            let y = (y - 0.5 * frame).round();
            let mark = rectangle(self.left + self.width + frame, y, tick, frame);
            piece.shapes.push(layout.halo(&mark));
            ink.extend(mark);
        }
        piece.shapes.push(Drawn::Fill { path: ink, color: layout.ink });
        let rows = self.height as u32;
        let colors = (0..rows)
            .map(|row| color_at(self.map, self.value(1.0 - (f64::from(row) + 0.5) / f64::from(rows))))
            .collect();
        let (left, top, width) = (self.left as u32, self.top as u32, self.width as u32);
        piece.shapes.push(Drawn::Rows { left, top, width, colors });
        let mut text = Vec::new();
        let first = self.top - 0.75 * em - self.title.drop();
        self.title.write(&layout.font, (self.title_left, first), &mut text);
        for tick in &self.ticks {
            let place = (self.left + self.width + 0.6 * em, self.y_of(tick.value) + 0.35 * em);
            layout.font.write(&tick.label, em, place, &mut text);
        }
        layout.write(&mut piece, text);
        piece
    }
}

#[cfg(test)]
mod tests {
    use super::super::text::Font;
    use super::*;

    fn layout() -> Layout {
        Layout::new(Font::carried().expect("a typeface"), (800, 600), None)
    }

    /// The pixel of a bar in the middle of its width at a value.
    fn pixel(bar: &Bar<'_>, layout: &Layout, value: f64) -> Color {
        let y = bar.y_of(value).clamp(bar.top, bar.top + bar.height - 1.0) as u32;
        let mut row = vec![0; 4 * 800];
        bar.piece(layout).drawn().over(y, 0, &mut row);
        let at = 4 * (bar.left + 0.5 * bar.width) as usize;
        [row[at], row[at + 1], row[at + 2]]
    }

    #[test]
    fn colours_at_ticks_are_those_of_the_map_whether_linear_logarithmic_or_reversed() {
        let layout = layout();
        let logarithmic: Vec<(f64, [f64; 3])> = (0..=64)
            .map(|i| f64::from(i) / 64.0)
            .map(|t| ((1e4_f64.powf(t) - 1.0) / (1e4 - 1.0), [t, 1.0 - t, 0.5]))
            .collect();
        let maps = [
            (ColorMap::named("viridis".parse().expect("a map"), (-3.0, 17.0)), false),
            (ColorMap::named("inferno_r".parse().expect("a map"), (2e-7, 1e-7)), false),
            (ColorMap { palette: Palette::Stops(logarithmic.into()), range: (1e-3, 10.0) }, true),
        ];
        for (map, is_log) in &maps {
            assert_eq!(is_logarithmic(map), *is_log);
            let bar = Bar::new(map, "name (unit)", &layout);
            assert!(bar.ticks.len() >= 4, "{:?}", bar.ticks);
            // A pixel further along the bar, the colour is another already.
            let row = |value: f64| (bar.y_of(value) - bar.top) / bar.height;
            for Tick { value, label } in &bar.ticks {
                let share = f64::from(1.0 - row(*value));
                let (before, behind) = (bar.value(share - 1.0 / 276.0), bar.value(share + 1.0 / 276.0));
                let found = pixel(&bar, &layout, *value);
                for channel in 0..3 {
                    let near = [before, *value, behind].map(|v| color_at(map, v)[channel]);
                    let (least, most) = (near.iter().min(), near.iter().max());
                    let slack = found[channel].saturating_add(1) >= *least.expect("three")
                        && found[channel].saturating_sub(1) <= *most.expect("three");
                    assert!(slack, "{label}: {found:?} is not within {near:?}");
                }
            }
        }
    }

    #[test]
    fn no_letter_of_a_title_of_forty_is_lost_and_longer_ones_end_in_an_ellipsis() {
        let size = (640, 480);
        let map = ColorMap::named("viridis".parse().expect("a map"), (0.0, 4e-9));
        let beside = Layout::new(Font::carried().expect("a typeface"), size, None);
        let beside = beside.beside(super::super::sheet::Sheet::new(size, 2));
        let over = Layout::new(Font::carried().expect("a typeface"), size, None);
        assert!(beside.is_beside() && !over.is_beside());
        let titles = [
            "short (kpc)".to_owned(),
            "a_quantity_with_a_long_name (1e10 M☉/kpc³)".to_owned(),
            "photosynthetically active radiation (W)".to_owned(),
            "W".repeat(40),
        ];
        let letters = |text: &str| text.chars().filter(|c| !c.is_whitespace()).collect::<String>();
        for layout in [&beside, &over] {
            let (upper, lower) = layout.at_the_right();
            for title in &titles {
                let bar = Bar::new(&map, title, layout);
                let found = bar.title.lines.concat();
                assert_eq!(letters(&found), letters(&format!("{title} ×10⁻⁹")), "{:?}", bar.title);
                let width = bar.title.width(&layout.font);
                assert!(
                    bar.title_left >= layout.margin && bar.title_left + width <= bar.right + 0.5,
                    "{title}"
                );
                let above = bar.top - 0.75 * layout.em - bar.title.drop() - bar.title.em;
                assert!(above >= upper && bar.top + bar.height <= lower, "{title}: {above}");
            }
            let long = Bar::new(&map, &"a name without an end ".repeat(20), layout);
            assert!(long.title.lines.len() == TITLE_LINES, "{:?}", long.title);
            assert!(long.title.lines[TITLE_LINES - 1].ends_with('…'), "{:?}", long.title);
            assert!(long.title.width(&layout.font) <= layout.room_at_the_right(0.6));
        }
        // What fits is as large as ever, in one line.
        assert_eq!(Bar::new(&map, "short", &beside).title.em, beside.em);
        assert_eq!(Bar::new(&map, "short", &beside).title.lines, ["short ×10⁻⁹"]);
    }

    #[test]
    fn maps_with_few_or_evenly_spaced_stops_are_not_taken_for_logarithmic_ones() {
        let even: Vec<(f64, [f64; 3])> = (0..=16).map(|i| (f64::from(i) / 16.0, [0.5; 3])).collect();
        let map =
            |stops: &[(f64, [f64; 3])]| ColorMap { palette: Palette::Stops(stops.into()), range: (1.0, 9.0) };
        assert!(!is_logarithmic(&map(&even)));
        assert!(!is_logarithmic(&map(&[(0.0, [0.0; 3]), (0.25, [0.5; 3]), (1.0, [1.0; 3])])));
    }
}
