//! What page and program say to each other over the WebSocket.
//!
//! The page says, whenever anything changes, everything that is to be seen ([`Show`]): a message
//! needs none before it, so a page that connects again goes on where it was. Pictures go the other
//! way as binary messages ([`FrameHead`], then the pixels), everything else as JSON.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::cuts::{Cutter, MOST_CUTTERS, Section};
use crate::engine::Report;
use crate::looks::{Choices, Histogram, Stance};
use crate::picking::Picked;
use rayset_inputs::style::{Spelling, Style};

/// Longest message of a page, in bytes.
pub(crate) const MOST_MESSAGE_BYTES: usize = 64 << 10;
/// Largest edge of a picture in a page, in pixels.
pub(crate) const MOST_EDGE: u32 = 4096;

/// A message from the page.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(tag = "type", rename_all = "camelCase", rename_all_fields = "camelCase", deny_unknown_fields)]
pub(crate) enum FromPage {
    /// What is to be seen from now on.
    Show(Box<Show>),
    /// The scene file of what is seen is wanted.
    Save(Box<Show>),
    /// Somebody else is to be let in.
    Invite {},
    /// What lies behind a place of the picture?
    Pick {
        /// Answers say which question they are for.
        question: u32,
        /// From the left and from the top, 0 to 1 each.
        at: [f64; 2],
        show: Box<Show>,
    },
    /// What is in memory, and what has been read? With the map of the cloud, if it is not known
    /// yet.
    Engine {
        #[serde(default)]
        with_map: bool,
    },
    /// The command that renders what is seen is wanted.
    Command {
        /// Answers say which question they are for.
        question: u32,
        show: Box<Show>,
    },
    /// A picture of what is seen is wanted as a file, of the size in `show`.
    Picture(Box<Show>),
    /// It is not wanted any more.
    Cancel {},
    /// A frame has arrived and been drawn.
    Ack {
        /// Its number.
        frame: u32,
    },
}

/// Everything that decides what is seen.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct Show {
    /// Grows with every change; frames say which one they show.
    pub(crate) generation: u32,
    pub(crate) camera: Pose,
    /// Width and height of the picture in pixels.
    pub(crate) size: [u32; 2],
    /// Whether more changes are about to follow: frames are then quick rather than fine.
    pub(crate) moving: bool,
    #[serde(default)]
    pub(crate) changes: Changes,
}

/// Where the camera is, in the units of the data.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, PartialEq)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct Pose {
    pub(crate) position: [f64; 3],
    pub(crate) direction: [f64; 3],
    pub(crate) up: [f64; 3],
    /// Vertical angle in degrees.
    pub(crate) fovy: f64,
    /// Height of the picture of an orthographic camera, in the units of the data; `None` of one
    /// with an angle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) height: Option<f64>,
}

/// How what is seen differs from the scene that was opened. What is missing stays as it is there.
#[derive(Clone, Debug, Default, Deserialize, Serialize, PartialEq)]
#[serde(rename_all = "camelCase", deny_unknown_fields, default)]
pub(crate) struct Changes {
    /// Stops.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) exposure: Option<f64>,
    /// A light in place of the scene's directional lights.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) sun: Option<Sun>,
    /// The box within which the scene is seen; world space.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) section: Option<Section>,
    /// Solids that cut, too.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(crate) cutters: Vec<Cutter>,
    /// The colour with which cuts are filled, `#rrggbb`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) cap: Option<String>,
    /// Of a cloud or grid that was opened by itself: how it looks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) style: Option<PageStyle>,
}

/// A style from a page. Its keys are valid options; its values may be invalid, and are checked when
/// the scene is composed.
#[derive(Clone, Debug, Deserialize, Serialize, PartialEq)]
#[serde(try_from = "Map<String, Value>")]
pub(crate) struct PageStyle(Map<String, Value>);

impl TryFrom<Map<String, Value>> for PageStyle {
    type Error = String;

    fn try_from(object: Map<String, Value>) -> Result<Self, String> {
        match object.keys().find(|key| Spelling::Camel.option(key).is_none()) {
            Some(key) => Err(format!("{key} is no option of a style")),
            None => Ok(Self(object)),
        }
    }
}

impl PageStyle {
    /// Validates the values.
    ///
    /// # Errors
    /// The first invalid value, for display on the page.
    pub(crate) fn read(&self) -> Result<Style, String> {
        Style::from_object(&self.0, Spelling::Camel).map_err(|error| error.to_string())
    }
}

/// Parallel light.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, PartialEq)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct Sun {
    /// The direction in which it goes.
    pub(crate) direction: [f64; 3],
    pub(crate) intensity: f64,
    /// Whether it throws shadows.
    pub(crate) shadow: bool,
}

/// What a picture shows in which colours.
#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Legend {
    pub(crate) look: String,
    /// What was chosen, and why.
    pub(crate) line: String,
    /// Whether there are lights.
    pub(crate) is_lit: bool,
    /// Stops, if the page says nothing of it.
    pub(crate) exposure: f64,
    /// As the scene file has it.
    pub(crate) transfer_function: Value,
    /// The classes or labels that colours tell apart: values and names.
    pub(crate) classes: Vec<(f64, String)>,
    /// How what opacity is over is spread.
    pub(crate) densities: Option<Histogram>,
    /// What a person should know of the scene.
    pub(crate) remarks: Vec<String>,
}

/// What memory gives pictures.
#[derive(Clone, Copy, Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct PictureMemory {
    /// Bytes of the whole process for each pixel of a page.
    pub(crate) bytes_per_pixel: u64,
    /// The most pixels that any memory gives.
    pub(crate) most_pixels: u64,
}

/// A message to the page.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "type", rename_all = "camelCase")]
pub(crate) enum ToPage {
    /// Before the first: what is to be seen is not ready yet.
    Opening { what: String, part: f64 },
    /// The first of all: what was opened.
    #[serde(rename_all = "camelCase")]
    Hello {
        title: String,
        /// Where it is best seen from.
        camera: Box<Pose>,
        /// The least and the largest coordinates of the scene; world space.
        bounds: [[f64; 3]; 2],
        /// How it stands; `None` of a scene, which does not say.
        stance: Option<Box<Stance>>,
        /// The unit of its lengths.
        unit: Option<&'static str>,
        /// What was remarked when it was opened.
        remarks: Vec<String>,
        /// The scene as it was opened.
        scene: Box<Value>,
        /// The most pixels that a picture on the page may have.
        most_pixels: u64,
        /// What would give it more.
        memory: PictureMemory,
        /// Looks to choose among; `None` for a scene, which says itself what it looks like.
        choices: Option<Box<Choices>>,
    },
    /// What a generation looks like, whenever that has changed.
    Styled(Box<Legend>),
    /// What lies behind a place of the picture.
    Picked(Box<Picked>),
    /// What is in memory, and what has been read.
    Engine(Box<Report>),
    /// How much of the picture that is being saved is done, 0 to 1.
    Progress { part: f64 },
    /// The picture that was to be saved is complete; or why it is not.
    Pictured { what: Option<String> },
    /// The picture of a generation is complete: what `rayset render` makes of the same scene.
    Converged { generation: u32, seconds: f64 },
    /// The command that renders what is seen, as a shell reads it; `None` if it takes a scene file.
    Command { question: u32, command: Option<String> },
    /// This page is not served.
    Refused { what: String },
    /// The scene file that was asked for, as text.
    Saved { scene: String },
    /// A token that opens another page, once.
    Invited { token: String },
    /// What was asked for cannot be shown; what was shown before stays.
    Problem { generation: u32, what: String },
}

/// Bytes of the head of a frame.
pub(crate) const HEAD_BYTES: usize = 16;

/// The head of a binary message, little endian: what follows, of which generation, and where it
/// belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct FrameHead {
    pub(crate) kind: FrameKind,
    pub(crate) generation: u32,
    /// The number to acknowledge.
    pub(crate) frame: u32,
    /// Size of the picture in the frame's own pixels, which the page stretches over its picture.
    pub(crate) size: [u16; 2],
    /// Number of rectangles.
    pub(crate) rectangles: u16,
}

/// What a binary message holds behind its head.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FrameKind {
    /// Distances from the eye (see `Depths`), then one JPEG, the whole picture.
    Whole = 1,
    /// Rectangles, `x`, `y`, `width` and `height` of each as 16-bit numbers; then, compressed by
    /// zlib, their pixels, row by row, rectangle by rectangle: 8-bit RGBA, straight alpha.
    Rectangles = 2,
    /// The next bytes of a picture that is saved as a file; not acknowledged.
    Piece = 3,
}

impl FrameHead {
    pub(crate) fn bytes(self) -> [u8; HEAD_BYTES] {
        let mut bytes = [0; HEAD_BYTES];
        bytes[0] = self.kind as u8;
        bytes[2..4].copy_from_slice(&self.rectangles.to_le_bytes());
        bytes[4..8].copy_from_slice(&self.generation.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.frame.to_le_bytes());
        bytes[12..14].copy_from_slice(&self.size[0].to_le_bytes());
        bytes[14..16].copy_from_slice(&self.size[1].to_le_bytes());
        bytes
    }
}

impl Show {
    /// What is wrong with it before the scene is looked at.
    pub(crate) fn check(&self, most_edge: u32, most_pixels: u64) -> Result<(), String> {
        let [width, height] = self.size;
        if u64::from(width) * u64::from(height) > most_pixels {
            return Err(format!(
                "{width}x{height} are more than the {most_pixels} pixels that a page may have"
            ));
        }
        if !(1..=most_edge).contains(&width) || !(1..=most_edge).contains(&height) {
            return Err(format!("a picture of {width}x{height} pixels; expected 1 to {most_edge} each"));
        }
        if self.changes.cutters.len() > MOST_CUTTERS
            || self.changes.cutters.iter().any(|cutter| cutter.turns.len() > MOST_CUTTERS)
        {
            return Err(format!("at most {MOST_CUTTERS} solids can cut"));
        }
        if self.generation == u32::MAX {
            return Err("generations have run out; reload the page".into());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SHOW: &str = r#"{"type": "show", "generation": 3, "camera": {"position": [0, 1, 2], "direction": [0, 0, -1],
        "up": [0, 1, 0], "fovy": 40}, "size": [640, 360], "moving": true}"#;

    #[test]
    fn what_a_page_says_is_read_and_what_it_must_not_say_is_an_error() {
        let read = |text: &str| serde_json::from_str::<FromPage>(text);
        assert!(
            matches!(read(SHOW), Ok(FromPage::Show(show)) if show.moving && show.changes == Changes::default())
        );
        let with = |change: &str| SHOW.replace("\"moving\": true", &format!("\"moving\": true, {change}"));
        assert!(read(&with(r#""changes": {"exposure": 1.5}"#)).is_ok());
        // A wrong value is said where the picture would be; the connection stays.
        let sent = read(&with(r#""changes": {"style": {"look": "/etc/passwd"}}"#));
        let Ok(FromPage::Show(show)) = sent else { panic!("{sent:?}") };
        let what = show.changes.style.expect("a style").read().expect_err("a wrong value");
        assert!(what.contains("`/etc/passwd` is none of density"), "{what}");
        for wrong in [
            r#""changes": {"file": "/etc/passwd"}"#,
            r#""changes": {"style": {"preset": {"file": "/etc/passwd", "name": "a"}}}"#,
            r#""more": 1"#,
        ] {
            assert!(read(&with(wrong)).is_err(), "{wrong}");
        }
    }

    proptest! {
        #[test]
        fn no_text_makes_the_reader_panic(text in ".{0,200}", at in 0..SHOW.len(), byte in any::<u8>()) {
            let _ = serde_json::from_str::<FromPage>(&text);
            let mut damaged = SHOW.as_bytes().to_vec();
            damaged[at] = byte;
            if let Ok(FromPage::Show(show)) = serde_json::from_slice::<FromPage>(&damaged) {
                let _ = show.check(MOST_EDGE, 1 << 20);
            }
        }
    }
}
