//! What the JSON of a SOG file says: which images hold its splats, and what their bytes stand for;
//! and, of one with levels of detail, which files hold the finest.
//!
//! Format: PlayCanvas, *The SOG Format*, version 2.

use serde_json::Value;

use rayset_files::points::harmonics::coefficients;

/// Lists of coefficients side by side in the image of the palette.
pub(super) const ACROSS: usize = 64;
/// Rows by which an image may be higher than it needs to be.
const SPARE_ROWS: u64 = 4;

/// Most splats: an image has no more pixels.
const MOST_SPLATS: u64 = 1 << 28;
/// Values that bytes stand for.
const CODES: usize = 256;
/// Most lists of a palette, whose numbers have two bytes.
const MOST_LISTS: u64 = 1 << 16;
/// Deepest nesting of a tree of levels.
const DEEPEST: usize = 64;
/// Most files of a tree of levels.
const MOST_FILES: usize = 1 << 16;

/// What the images of a file mean.
#[derive(Debug)]
pub(super) struct Meta {
    pub(super) count: u64,
    pub(super) is_antialiased: bool,
    /// The ends of the ranges of logarithms of coordinates, and the images of low and high bytes.
    pub(super) ranges: [[f64; 2]; 3],
    pub(super) means: [String; 2],
    pub(super) quats: String,
    /// Logarithms of deviations, and their image.
    pub(super) scales: (Vec<f64>, String),
    /// Constant coefficients of colours, and their image, which has opacities, too.
    pub(super) colors: (Vec<f64>, String),
    pub(super) harmonics: Option<MetaHarmonics>,
}

/// The other coefficients of colours: each splat has one list of a palette.
#[derive(Debug)]
pub(super) struct MetaHarmonics {
    pub(super) degree: u8,
    /// Lists in the palette, at most 65 536.
    pub(super) count: u64,
    pub(super) codes: Vec<f64>,
    /// The images of the palette, and of the numbers in it.
    pub(super) palette: String,
    pub(super) labels: String,
}

/// The splats of a file of which some are wanted.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Chosen {
    /// The name of its JSON, or its bundle, relative to the file that tells of it.
    pub(super) name: String,
    /// First and count of each stretch; none for all.
    pub(super) stretches: Vec<(u64, u64)>,
}

type Read<T> = Result<T, String>;

fn numbers(of: &Value, key: &str, count: usize) -> Read<Vec<f64>> {
    let list = of[key].as_array().filter(|list| list.len() == count);
    let numbers = list.and_then(|list| list.iter().map(Value::as_f64).collect::<Option<Vec<_>>>());
    numbers.ok_or_else(|| format!("`{key}`: expected {count} numbers"))
}

/// The names of images, which are beside the JSON.
fn files<const N: usize>(of: &Value, what: &str) -> Read<[String; N]> {
    let names = of["files"].as_array().into_iter().flatten().filter_map(Value::as_str);
    let names: Vec<String> = names.filter(|name| is_beside(name)).map(str::to_owned).collect();
    names.try_into().map_err(|_| format!("`{what}`: expected the names of {N} images beside this file"))
}

/// Whether a name is of a file in the same folder.
fn is_beside(name: &str) -> bool {
    !name.is_empty() && !name.contains(['/', '\\', ':']) && name != ".."
}

impl MetaHarmonics {
    /// Pixels across the image of the palette, and most rows of it.
    pub(super) fn palette_size(&self) -> (u64, u64) {
        ((ACROSS * (coefficients(self.degree) - 1)) as u64, self.count.div_ceil(ACROSS as u64) + SPARE_ROWS)
    }
}

impl Meta {
    /// The names of all images.
    pub(super) fn images(&self) -> Vec<&str> {
        let [low, high] = &self.means;
        let own = [low, high, &self.quats, &self.scales.1, &self.colors.1];
        let others = self.harmonics.iter().flat_map(|of| [&of.palette, &of.labels]);
        own.into_iter().chain(others).map(String::as_str).collect()
    }

    /// Reads the JSON of splats.
    pub(super) fn parse(json: &Value) -> Read<Self> {
        match json["version"].as_u64() {
            Some(2) => {}
            None if json["means"].is_null() => {
                return Err("not the JSON of SOG: it has no `means`".into());
            }
            None => {
                return Err("SOG of version 1; `splat-transform FILE new.sog` makes version 2 of it".into());
            }
            Some(other) => return Err(format!("SOG of version {other}; version 2 can be read")),
        }
        let count = json["count"].as_u64().ok_or("`count`: expected the number of splats")?;
        if count > MOST_SPLATS {
            return Err(format!("{count} splats; expected at most {MOST_SPLATS}"));
        }
        let (low, high) = (numbers(&json["means"], "mins", 3)?, numbers(&json["means"], "maxs", 3)?);
        let codes =
            |of: &str| numbers(&json[of], "codebook", CODES).map_err(|what| format!("`{of}`: {what}"));
        let [quats] = files(&json["quats"], "quats")?;
        let [scales] = files(&json["scales"], "scales")?;
        let [colors] = files(&json["sh0"], "sh0")?;
        let of_harmonics = |of: &Value| {
            let degree = of["bands"].as_u64().filter(|bands| (1..=3).contains(bands));
            let degree = degree.ok_or("`shN`: expected `bands` of 1 to 3")? as u8;
            let count = of["count"].as_u64().unwrap_or(MOST_LISTS).min(MOST_LISTS);
            let [palette, labels] = files(of, "shN")?;
            Ok::<_, String>(MetaHarmonics { degree, count, codes: codes("shN")?, palette, labels })
        };
        Ok(Self {
            count,
            is_antialiased: json["antialias"] == true,
            ranges: [0, 1, 2].map(|axis| [low[axis], high[axis]]),
            means: files(&json["means"], "means")?,
            quats,
            scales: (codes("scales")?, scales),
            colors: (codes("sh0")?, colors),
            harmonics: json["shN"].is_object().then(|| of_harmonics(&json["shN"])).transpose()?,
        })
    }
}

/// Whether JSON is of levels of detail.
pub(super) fn has_levels(json: &Value) -> bool {
    json["lodLevels"].is_u64() && json["tree"].is_object()
}

/// The names of all files that one with levels of detail tells of, as far as they are names.
pub(super) fn file_names(json: &Value) -> impl Iterator<Item = &str> {
    let names = json["filenames"].as_array().into_iter().flatten().filter_map(Value::as_str);
    names.filter(|name| is_within(name))
}

/// Whether a name is of a file in the same folder or in one beside it.
fn is_within(name: &str) -> bool {
    let parts: Vec<&str> = name.split('/').collect();
    parts.len() <= 2 && parts.iter().all(|part| is_beside(part))
}

/// The finest splats everywhere of a file with levels of detail.
pub(super) fn finest(json: &Value) -> Read<Vec<Chosen>> {
    let names = json["filenames"].as_array().into_iter().flatten().map(Value::as_str);
    let names = names.collect::<Option<Vec<_>>>().ok_or("`filenames`: expected names")?;
    if names.len() > MOST_FILES || !names.iter().all(|name| is_within(name)) {
        return Err("`filenames`: expected names in folders beside this file".into());
    }
    let mut sorted = names.clone();
    sorted.sort_unstable();
    if sorted.windows(2).any(|w| w[0] == w[1]) {
        return Err("`filenames`: two of them are the same".into());
    }
    let mut chosen: Vec<Chosen> =
        names.iter().map(|name| Chosen { name: (*name).to_owned(), stretches: Vec::new() }).collect();
    add_finest(&json["tree"], &mut chosen, 0)?;
    chosen.retain(|file| !file.stretches.is_empty());
    chosen.iter_mut().for_each(|file| file.stretches.sort_unstable());
    let overlap = |file: &Chosen| file.stretches.windows(2).any(|w| w[0].0.saturating_add(w[0].1) > w[1].0);
    if chosen.iter().any(overlap) {
        return Err("`tree`: two of its nodes have the same splats".into());
    }
    if let Some(name) = json["environment"].as_str().filter(|name| is_within(name)) {
        chosen.push(Chosen { name: name.to_owned(), stretches: Vec::new() });
    }
    Ok(chosen)
}

fn add_finest(node: &Value, chosen: &mut [Chosen], depth: usize) -> Read<()> {
    if depth > DEEPEST {
        return Err(format!("`tree`: deeper than {DEEPEST}"));
    }
    for child in node["children"].as_array().into_iter().flatten() {
        add_finest(child, chosen, depth + 1)?;
    }
    let Some(levels) = node["lods"].as_object() else { return Ok(()) };
    let finest = levels.iter().min_by_key(|(level, _)| level.parse().unwrap_or(u64::MAX));
    let Some((_, of)) = finest else { return Ok(()) };
    let number = |key: &str| of[key].as_u64().ok_or_else(|| format!("`tree`: a node without `{key}`"));
    let (file, first, count) = (number("file")?, number("offset")?, number("count")?);
    let file = usize::try_from(file).ok().and_then(|file| chosen.get_mut(file));
    let file = file.ok_or("`tree`: a node of a file that is not there")?;
    if count > 0 {
        file.stretches.push((first, count));
    }
    Ok(())
}
