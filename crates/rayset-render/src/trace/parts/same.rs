//! What proves that parts are of one picture: what was rendered, by what, in text.

use std::collections::HashMap;
use std::fmt::{self, Write as _};

use serde::{Deserialize, Serialize};

use crate::field::SimdLevel;
use crate::scene::{Lod, Node, Scene, Shape};
use crate::trace::View;
use rayset_store::container::{Identity, StreamHash};

/// What is the same in all parts of a picture, besides its size.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Same {
    program: String,
    build: String,
    files: String,
    scene: String,
    settings: String,
    view: String,
    fused: bool,
    simd: String,
    functions: String,
    note: String,
}

/// How two parts differ, and what to do.
pub(super) struct Difference {
    pub(super) what: String,
    pub(super) advice: &'static str,
}

const ONE_COMMAND: &str = "render all parts with the same input and options";

impl Same {
    pub(super) fn of(view: &View, simd: SimdLevel, build: &str, note: &[u8]) -> Self {
        let scene = &view.prepared.scene;
        Self {
            program: format!("rayset {}", env!("CARGO_PKG_VERSION")),
            build: build.to_owned(),
            files: files(scene, view.settings.lod),
            scene: scene_identity(scene),
            settings: format!("{:?}", view.settings),
            view: format!("{:?}", view.rays),
            fused: simd.is_fused(),
            simd: simd.name().to_owned(),
            functions: functions().to_string(),
            note: identity_of("note", |hash| hash.update(note)).to_string(),
        }
    }

    /// The first difference from another part's.
    pub(super) fn difference(&self, other: &Self) -> Option<Difference> {
        let different = |what: String, advice| Some(Difference { what, advice });
        if self.program != other.program || self.build != other.build {
            let text = |of: &Self| format!("{} {}", of.program, of.build).trim().to_owned();
            return different(
                format!("it was rendered by {}, and that by {}", text(self), text(other)),
                "render all parts with one build of one program",
            );
        }
        if self.files != other.files {
            return different(
                format!("its clouds and grids are {}, and there {}", self.files, other.files),
                "render all parts from the same files, built once",
            );
        }
        if self.scene != other.scene {
            return different(format!("its scene is {}, and there {}", self.scene, other.scene), ONE_COMMAND);
        }
        if self.settings != other.settings {
            return different(first_setting(&self.settings, &other.settings), ONE_COMMAND);
        }
        if self.view != other.view {
            return different("it is seen by another camera".into(), ONE_COMMAND);
        }
        if self.fused != other.fused {
            let text = |of: &Self| {
                format!("{} fused multiply–add ({})", if of.fused { "with" } else { "without" }, of.simd)
            };
            return different(
                format!("it was rendered {}, and that {}", text(self), text(other)),
                "render all parts with one --simd that all machines have, as --simd avx2 or --simd sse2",
            );
        }
        if self.functions != other.functions {
            return different(
                "exponentials or sines are rounded otherwise there, by another system library or processor"
                    .into(),
                "render all parts on machines with the same system library and kind of processor",
            );
        }
        (self.note != other.note)
            .then(|| Difference { what: "exposure or annotations differ".into(), advice: ONE_COMMAND })
    }
}

/// `its samples are …`: the first of two lists of settings, as `Debug` writes them, that differs.
fn first_setting(own: &str, other: &str) -> String {
    let pairs = own.split([',', '{']).zip(other.split([',', '{']));
    let differing = pairs.map(|(a, b)| (a.trim(), b.trim())).find(|(a, b)| a != b);
    let clean = |text: &str| text.trim_end_matches([' ', '}']).to_owned();
    differing.map_or_else(
        || "its settings differ".into(),
        |(a, b)| format!("its settings have {}, and there {}", clean(a), clean(b)),
    )
}

/// Text on its way into a hash.
struct Hashed(StreamHash);

impl fmt::Write for Hashed {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.0.update(text.as_bytes());
        Ok(())
    }
}

fn identity_of(what: &str, fill: impl FnOnce(&mut StreamHash)) -> Identity {
    let mut hash = StreamHash::new(what);
    fill(&mut hash);
    hash.identity()
}

/// The files of a scene by their identities, wherever they lie.
fn files(scene: &Scene, lod: Lod) -> String {
    let mut found: Vec<Identity> = Vec::new();
    scene.root.for_each(&mut |node| match &node.shape {
        Shape::Cloud(object) => {
            let header = object.cloud.header();
            found.push(header.identity);
            // The same points may have other aggregates.
            if let Some(aggregates) = header.aggregates.as_ref().filter(|_| lod != Lod::Off) {
                found.push(identity_of("aggregates", |hash| hash.update(&aggregates.encode())));
            }
        }
        Shape::Grid(object) => found.push(object.grid.header().identity),
        Shape::Procedural(_) | Shape::Operator(..) => {}
    });
    found.sort_unstable_by_key(|identity| identity.0);
    found.dedup();
    match found.as_slice() {
        [] => "none".into(),
        [one] => one.to_string(),
        several => {
            let all = identity_of("files", |hash| several.iter().for_each(|one| hash.update(&one.0)));
            format!("{} files, {all}", several.len())
        }
    }
}

/// A hash of everything that a scene says, and of its files what they are called by their
/// identities.
fn scene_identity(scene: &Scene) -> String {
    let mut text = Hashed(StreamHash::new("scene"));
    // Writing into a hash does not fail.
    let _ = write!(
        text,
        "{:?} {:?} {:?} {:?}",
        scene.lighting, scene.background, scene.unit_distance, scene.compositing
    );
    let _ = write_node(&scene.root, &mut HashMap::new(), &mut text);
    text.0.identity().to_string()
}

/// Writes a node and those below; one that was written before, by its number.
fn write_node(
    node: &Node,
    known: &mut HashMap<*const Node, usize>,
    text: &mut impl fmt::Write,
) -> fmt::Result {
    if let Some(number) = known.get(&std::ptr::from_ref(node)) {
        return write!(text, "(#{number})");
    }
    known.insert(node, known.len());
    let Node { shape, parent_from_local, transfers, material, cap } = node;
    write!(text, "({parent_from_local:?} {transfers:?} {material:?} {cap:?} ")?;
    match shape {
        Shape::Cloud(object) => {
            let header = object.cloud.header();
            write!(text, "cloud {} {:?} ", header.identity, header.radius_scale)?;
            write!(text, "{:?} {:?} {:?}", object.kernel, object.normalised, object.transfer)?;
            write!(text, " {}", object.splat_filter)?;
        }
        Shape::Grid(object) => {
            let header = object.grid.header();
            write!(text, "grid {} {:?} ", header.identity, header.space_from_voxel)?;
            write!(text, "{:?} {:?} {:?}", header.scale, header.offset, object.transfer)?;
        }
        Shape::Procedural(field) => write!(text, "field {field:?}")?,
        Shape::Operator(operator, children) => {
            write!(text, "{operator:?} {}", children.len())?;
            children.iter().try_for_each(|child| write_node(child, known, text))?;
        }
    }
    write!(text, ")")
}

/// A hash of what the functions give that the system's library computes, and that it may round as
/// it likes.
fn functions() -> Identity {
    /// So many arguments of each function.
    const ARGUMENTS: u32 = 512;
    identity_of("functions", |hash| {
        for i in 1..=ARGUMENTS {
            // Of irregular bits, 0 to 8.
            let x = f64::from(i.wrapping_mul(0x9e37_79b9)) / f64::from(1_u32 << 29);
            let y = x as f32;
            let wide =
                [x.exp(), (-x).exp_m1(), x.ln(), x.ln_1p(), x.exp2(), x.powf(2.4), x.sin(), x.cos(), x.tan()];
            let narrow =
                [y.exp(), (-y).exp_m1(), y.ln(), y.ln_1p(), y.exp2(), y.powf(2.4), y.sin(), y.cos(), y.tan()];
            wide.iter().for_each(|v| hash.update(&v.to_le_bytes()));
            narrow.iter().for_each(|v| hash.update(&v.to_le_bytes()));
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn same() -> Same {
        Same {
            program: "rayset 1".into(),
            build: String::new(),
            files: "a".into(),
            scene: "b".into(),
            settings: "Settings { width: 8, step: Fixed { length: 0.5 }, samples: 2 }".into(),
            view: "c".into(),
            fused: true,
            simd: "avx2".into(),
            functions: functions().to_string(),
            note: "d".into(),
        }
    }

    #[test]
    fn what_differs_is_said_with_both_values() {
        let said = |change: fn(&mut Same)| {
            let mut other = same();
            change(&mut other);
            let difference = same().difference(&other).expect("they differ");
            format!("{}; {}", difference.what, difference.advice)
        };
        assert!(said(|s| s.program = "rayset 2".into()).contains("by rayset 1, and that by rayset 2"));
        assert!(said(|s| s.build = "x".into()).contains("rayset 1, and that by rayset 1 x"));
        assert!(said(|s| s.files = "z".into()).contains("clouds and grids are a, and there z"));
        assert!(said(|s| s.scene = "z".into()).contains("scene is b, and there z"));
        let settings = said(|s| s.settings = s.settings.replace("samples: 2", "samples: 3"));
        assert!(settings.contains("settings have samples: 2, and there samples: 3"), "{settings}");
        assert!(said(|s| s.view = "z".into()).contains("camera"));
        let simd = said(|s| (s.fused, s.simd) = (false, "sse2".into()));
        assert!(simd.contains("with fused multiply–add (avx2), and that without"), "{simd}");
        assert!(simd.contains("--simd"), "{simd}");
        assert!(said(|s| s.functions = "z".into()).contains("system library"));
        assert!(said(|s| s.note = "z".into()).contains("annotations"));
        // Instruction sets of one class give the same bits.
        assert!(same().difference(&Same { simd: "avx512".into(), ..same() }).is_none());
    }
}
