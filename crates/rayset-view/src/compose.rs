//! The scene that a page sees: the one that was opened, with the page's changes. It is a scene
//! file, so that what is seen can be saved and rendered as it is.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use rayset::geometry::Aabb;
use rayset::scene::{Camera, Projection};
use rayset::scene_file::SceneFile;
use rayset::storage::{address_of, beside};
use serde_json::{Value, json};

use crate::cuts;
use rayset_inputs::style::{Flag, Style};

use crate::looks::{Command, Looks, Stance, Styled};
use crate::protocol::{Changes, Legend, PageStyle, Pose, Show, Sun};

/// What was opened.
pub struct Subject {
    /// What the page calls it.
    pub title: String,
    /// The file from which names of files in `scene` are counted.
    pub path: PathBuf,
    /// The scene, as scene files write it.
    pub scene: Value,
    /// Other looks of it; `None` if it is a scene that says itself what it looks like.
    pub looks: Option<Box<dyn Looks>>,
    /// How it stands; `None` of a scene.
    pub stance: Option<Stance>,
    /// The unit of its lengths; `None` if it is not known.
    pub unit: Option<&'static str>,
    /// What was remarked when it was opened.
    pub remarks: Vec<String>,
}

impl Subject {
    /// A scene that says itself what it looks like.
    #[must_use]
    pub fn scene(title: String, path: PathBuf, scene: Value) -> Self {
        Self { title, path, scene, looks: None, stance: None, unit: None, remarks: Vec::new() }
    }
}

/// What was opened, and what is known of it.
pub(crate) struct Opened {
    pub(crate) subject: Subject,
    /// Of the scene without changes; world space.
    pub(crate) bounds: Aabb,
    /// Where it is best seen from.
    pub(crate) camera: Pose,
    /// The scene without changes, whose files stay open.
    pub(crate) file: SceneFile,
    /// The styles that were asked for last, and what they gave.
    styles: Mutex<Vec<(Style, Arc<Styled>)>>,
    /// What a page that says nothing sees.
    first_style: Style,
}

/// Most styles that are remembered.
const MOST_STYLES: usize = 8;

impl Opened {
    /// Reads the scene once.
    pub(crate) fn new(subject: Subject) -> Result<Self, String> {
        let file = SceneFile::parse(&subject.path, &subject.scene.to_string()).map_err(|error| error.what)?;
        let (bounds, camera) = (file.scene.root.bounds(), pose(&file.camera));
        let first_style = subject.looks.as_ref().map_or_else(Style::default, |looks| looks.choices().style);
        Ok(Self { bounds, camera, subject, file, styles: Mutex::default(), first_style })
    }

    /// The scene that a page wants to see. Without caps it is ready sooner.
    ///
    /// # Errors
    /// What is wrong with the style.
    pub(crate) fn composed(&self, show: &Show, with_caps: bool) -> Result<Value, String> {
        let mut scene = match self.styled(&show.changes)? {
            Some(styled) => styled.scene.clone(),
            None => self.subject.scene.clone(),
        };
        scene["camera"] = camera_value(&show.camera);
        scene["image"]["size"] = json!(show.size);
        self.apply(&mut scene, &show.changes, with_caps);
        Ok(scene)
    }

    /// The same, as a file anywhere: names of files are whole.
    pub(crate) fn saved(&self, show: &Show) -> Result<Value, String> {
        let mut scene = self.composed(show, true)?;
        let path = &self.subject.path;
        // Of a name alone the folder is the one that the program runs in; an address is whole.
        let path = if address_of(path).is_some() { Ok(path.clone()) } else { std::path::absolute(path) };
        if let Ok(path) = path
            && let Some(folder) = path.parent()
        {
            name_files(&mut scene, folder);
        }
        Ok(scene)
    }

    /// Reads a composed scene. Its text was never written by anybody, so places in it mean nothing.
    pub(crate) fn parse(&self, scene: &Value) -> Result<SceneFile, String> {
        self.file.parse_changed(&self.subject.path, &scene.to_string()).map_err(|error| error.what)
    }

    /// What a page is told of what it sees.
    pub(crate) fn legend(&self, changes: &Changes, remarks: &[String]) -> Result<Legend, String> {
        let styled = self.styled(changes)?;
        let scene = styled.as_ref().map_or(&self.subject.scene, |styled| &styled.scene);
        let (look, line, classes, densities) = styled.as_ref().map_or_else(Default::default, |styled| {
            (styled.look.clone(), styled.line.clone(), styled.classes.clone(), styled.densities.clone())
        });
        let transfer_function = scene["root"]["transferFunction"].clone();
        let (is_lit, remarks) = (scene["lights"] != "none", remarks.to_vec());
        let exposure = scene["image"]["exposure"].as_f64().unwrap_or(0.0);
        Ok(Legend { look, line, is_lit, exposure, transfer_function, classes, densities, remarks })
    }

    /// The command that renders what a page sees, as a shell reads it; `None` if no options say it.
    /// The scene of the command is made, and compared with that of the page: a command that is
    /// given means the same bytes.
    pub(crate) fn command(&self, show: &Show) -> Option<String> {
        let looks = self.subject.looks.as_ref()?;
        let changes = &show.changes;
        let style = self.style(changes).ok()?;
        let mut seen = self.composed(show, true).ok()?;
        without_comments(&mut seen);
        let means_the_same = |camera: Style| {
            let whole = Style { exposure: changes.exposure, ..camera.or(&style) };
            let Command { words, mut scene } = looks.command(&whole).ok()?;
            scene["image"]["size"] = json!(show.size);
            without_comments(&mut scene);
            (scene == seen).then_some(words)
        };
        // What is up in the picture is what is up in the data, or follows from it: straight from
        // above, where it is north.
        let camera = style_of(&show.camera);
        let without_up = Style { up: None, ..camera.clone() };
        let mut words = means_the_same(camera).or_else(|| means_the_same(without_up))?;
        let [width, height] = show.size;
        words.extend([format!("--size={width}x{height}"), "-o".into(), "picture.png".into()]);
        Some(words.iter().map(|word| quoted(word)).collect::<Vec<_>>().join(" "))
    }

    /// The style of a page.
    fn style(&self, changes: &Changes) -> Result<Style, String> {
        changes.style.as_ref().map_or_else(|| Ok(self.first_style.clone()), PageStyle::read)
    }

    /// The scene in the style of a page; `None` if it has no other looks.
    fn styled(&self, changes: &Changes) -> Result<Option<Arc<Styled>>, String> {
        let Some(looks) = &self.subject.looks else { return Ok(None) };
        let style = self.style(changes)?;
        let styles = || self.styles.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, known)) = styles().iter().find(|(known, _)| *known == style) {
            return Ok(Some(known.clone()));
        }
        // Not under the lock: it takes a while, and other pages want theirs.
        let styled = Arc::new(looks.styled(&style)?);
        let mut styles = styles();
        if styles.len() == MOST_STYLES {
            styles.remove(0);
        }
        styles.push((style, styled.clone()));
        Ok(Some(styled))
    }

    fn apply(&self, scene: &mut Value, changes: &Changes, with_caps: bool) {
        if let Some(stops) = changes.exposure {
            match &self.subject.looks {
                Some(looks) => looks.expose(scene, stops),
                None => scene["image"]["exposure"] = json!(stops),
            }
        }
        if let Some(sun) = &changes.sun {
            set_sun(scene, sun);
        }
        let cap = changes.cap.as_deref().filter(|_| with_caps);
        let root = scene["root"].take();
        scene["root"] = cuts::cut(root, &self.bounds, changes.section.as_ref(), &changes.cutters, cap);
    }
}

/// The camera of a pose, as scene files write it.
fn camera_value(&Pose { position, direction, up, fovy, height }: &Pose) -> Value {
    match height {
        Some(height) => {
            json!({"type": "orthographic", "position": position, "direction": direction, "up": up, "height": height})
        }
        None => json!({"position": position, "direction": direction, "up": up, "fovy": fovy}),
    }
}

/// The camera of a pose, as options of `rayset render`.
fn style_of(&Pose { position, direction, up, fovy, height }: &Pose) -> Style {
    Style {
        position: Some(position),
        direction: Some(direction),
        up: Some(up),
        fovy: height.is_none().then_some(fovy),
        orthographic: height.map(|_| Flag),
        height,
        ..Style::default()
    }
}

/// Takes remarks for readers out of a scene: they change nothing of the picture.
fn without_comments(value: &mut Value) {
    match value {
        Value::Object(keys) => {
            keys.remove("comment");
            keys.values_mut().for_each(without_comments);
        }
        Value::Array(values) => values.iter_mut().for_each(without_comments),
        _ => {}
    }
}

/// A word as a shell takes it.
fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_=./:,%@+".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', "'\\''"))
}

/// Makes the names of files whole, wherever they stand.
fn name_files(value: &mut Value, folder: &Path) {
    match value {
        Value::Object(keys) => {
            for (key, value) in keys {
                match value {
                    Value::String(name) if key == "file" => {
                        *name = beside(folder, Path::new(&*name)).to_string_lossy().into_owned();
                    }
                    _ => name_files(value, folder),
                }
            }
        }
        Value::Array(values) => values.iter_mut().for_each(|value| name_files(value, folder)),
        _ => {}
    }
}

/// Replaces the directional lights of a scene by one, if it has lights.
fn set_sun(scene: &mut Value, sun: &Sun) {
    // What glows by itself has no light on it.
    if scene["lights"] == "none" {
        return;
    }
    let others = scene["lights"].as_array().cloned().unwrap_or_else(|| {
        // What a scene without lights has, unless it wants none.
        vec![json!({"type": "ambient"}), json!({"type": "headlight"})]
    });
    let is_sun = |light: &Value| light["type"] == "directional";
    let mut lights: Vec<Value> = others.into_iter().filter(|light| !is_sun(light)).collect();
    lights.push(json!({
        "type": "directional", "direction": sun.direction, "intensity": sun.intensity, "shadow": sun.shadow
    }));
    scene["lights"] = Value::Array(lights);
}

/// The camera of a pose, as a scene file with that pose has it.
pub(crate) fn camera(pose: &Pose) -> Camera {
    Camera {
        position: pose.position.into(),
        direction: pose.direction.into(),
        up: pose.up.into(),
        projection: match pose.height {
            Some(height) => Projection::Orthographic { height },
            None => Projection::Perspective { fovy: pose.fovy.to_radians() },
        },
    }
}

/// The pose of a camera. Of an orthographic one, the angle is what it has once a person wants one.
pub(crate) fn pose(camera: &Camera) -> Pose {
    const FOVY_DEGREES: f64 = 35.0;
    let (fovy, height) = match camera.projection {
        Projection::Perspective { fovy } => (fovy.to_degrees(), None),
        Projection::Orthographic { height } => (FOVY_DEGREES, Some(height)),
        _ => (FOVY_DEGREES, None),
    };
    Pose {
        position: camera.position.to_array(),
        direction: camera.direction.to_array(),
        up: camera.up.to_array(),
        fovy,
        height,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cuts::{Cutter, Form, Section, Turn};

    #[test]
    fn words_mean_to_a_shell_what_they_are() {
        assert_eq!(quoted("--opacity=0:0,1:0.5"), "--opacity=0:0,1:0.5");
        assert_eq!(quoted("a b"), "'a b'");
        assert_eq!(quoted("it's $HOME"), "'it'\\''s $HOME'");
        assert_eq!(quoted(""), "''");
    }

    fn opened() -> Opened {
        let scene = json!({
            "rayset": 1,
            "lights": [{"type": "ambient"}, {"type": "directional", "direction": [0, -1, 0]}],
            "root": {"type": "sphere", "radius": 1}
        });
        Opened::new(Subject::scene("a ball".into(), "ball.json".into(), scene)).expect("a scene")
    }

    fn show(changes: Changes) -> Show {
        let camera = Pose {
            position: [0.0, 0.0, 5.0],
            direction: [0.0, 0.0, -1.0],
            up: [0.0, 1.0, 0.0],
            fovy: 40.0,
            height: None,
        };
        Show { generation: 1, camera, size: [64, 48], moving: false, changes }
    }

    #[test]
    fn every_change_gives_a_scene_that_can_be_read() {
        let opened = opened();
        let sun = Sun { direction: [1.0, -1.0, 0.0], intensity: 0.5, shadow: true };
        let section = Section { min: [-1.0; 3], max: [1.0, 1.0, 0.0] };
        let cutter = |form, keep| Cutter {
            form,
            center: [0.5, 0.0, 0.0],
            size: [0.5, 1.0, 0.75],
            turns: vec![Turn { axis: [0.0, 1.0, 0.0], degrees: 30.0 }],
            keep,
        };
        let forms = [Form::Box, Form::Ellipsoid, Form::Cylinder];
        let cutters =
            forms.map(|form| cutter(form, true)).into_iter().chain(forms.map(|form| cutter(form, false)));
        let changes = [
            Changes::default(),
            Changes { exposure: Some(1.0), ..Changes::default() },
            Changes { sun: Some(sun), ..Changes::default() },
            Changes { section: Some(section), ..Changes::default() },
            Changes { section: Some(section), cap: Some("#ff8000".into()), ..Changes::default() },
            Changes { cutters: cutters.collect(), ..Changes::default() },
        ];
        for change in changes {
            let composed = opened.composed(&show(change.clone()), true).expect("a scene");
            let file = opened.parse(&composed).unwrap_or_else(|what| panic!("{change:?}: {what}"));
            assert_eq!(file.scene.root.cap.is_some(), change.cap.is_some());
            assert_eq!((file.settings.width, file.settings.height), (64, 48));
            assert_eq!(file.camera, camera(&show(change).camera));
        }
    }

    #[test]
    fn names_of_files_in_a_saved_scene_are_whole_wherever_the_scene_was_read_from() {
        let saved = |scene: &str, cloud: &str| {
            let mut opened = opened();
            opened.subject.path = scene.into();
            opened.subject.scene["root"] = json!({"type": "cloud", "file": cloud});
            let saved = opened.saved(&show(Changes::default())).expect("a scene");
            saved["root"]["file"].as_str().expect("a name").to_owned()
        };
        assert_eq!(saved("s3://bucket/a/scene.json", "../c.rset"), "s3://bucket/c.rset");
        assert_eq!(saved("s3://bucket/scene.json", "c.rset"), "s3://bucket/c.rset");
        assert_eq!(saved("scene.json", "s3://bucket/c.rset"), "s3://bucket/c.rset");
        let folder = std::env::current_dir().expect("a folder");
        assert_eq!(saved("scene.json", "c.rset"), folder.join("c.rset").to_string_lossy());
    }

    #[test]
    fn a_sun_takes_the_place_of_the_scenes_own_and_leaves_other_lights() {
        let sun = Sun { direction: [1.0, -1.0, 0.0], intensity: 0.5, shadow: true };
        let composed = opened().composed(&show(Changes { sun: Some(sun), ..Changes::default() }), true);
        let composed = composed.expect("a scene");
        let lights = composed["lights"].as_array().expect("lights");
        assert_eq!(lights.len(), 2);
        assert_eq!(lights[1]["direction"], json!([1.0, -1.0, 0.0]));
    }

    #[test]
    fn a_section_leaves_what_is_within_its_box_and_one_around_everything_changes_nothing() {
        let opened = opened();
        let with = |min, max| {
            let changes = Changes { section: Some(Section { min, max }), ..Changes::default() };
            opened.composed(&show(changes), true).expect("a scene")
        };
        assert_eq!(with([-2.0; 3], [2.0; 3])["root"], opened.subject.scene["root"]);
        let half = with([-2.0; 3], [2.0, 2.0, 0.25]);
        let children = half["root"]["children"].as_array().expect("children");
        assert_eq!((children.len(), &half["root"]["type"]), (2, &json!("difference")));
        let (size, center) = (&children[1]["size"], &children[1]["transform"]["translate"]);
        let number = |value: &Value, axis: usize| value[axis].as_f64().expect("a number");
        // It begins where the section ends, and reaches beyond the ball on all other sides.
        assert!((number(center, 2) - 0.5 * number(size, 2) - 0.25).abs() < 1e-12);
        for axis in 0..3 {
            assert!(number(center, axis) + 0.5 * number(size, axis) > 1.0, "{half}");
        }
    }
}
