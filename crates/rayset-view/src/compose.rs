//! The scene that a page sees: the one that was opened, with the page's changes. It is a scene file, so that what is seen can be
//! saved and rendered as it is.

use std::path::{Path, PathBuf};

use rayset::geometry::Aabb;
use rayset::scene::{Camera, Projection};
use rayset::scene_file::SceneFile;
use serde_json::{Value, json};

use crate::protocol::{Changes, Pose, Section, Show, Sun};

/// What was opened.
#[derive(Clone, Debug)]
pub struct Subject {
    /// What the page calls it.
    pub title: String,
    /// The file from which names of files in `scene` are counted.
    pub path: PathBuf,
    /// The scene, as scene files write it.
    pub scene: Value,
}

/// What was opened, and what is known of it.
pub(crate) struct Opened {
    pub(crate) subject: Subject,
    /// Of the scene without changes; world space.
    pub(crate) bounds: Aabb,
    /// Where it is best seen from.
    pub(crate) camera: Pose,
}

impl Opened {
    /// Reads the scene once.
    pub(crate) fn new(subject: Subject) -> Result<Self, String> {
        let file = parse(&subject.path, &subject.scene)?;
        Ok(Self { bounds: file.scene.root.bounds(), camera: pose(&file.camera), subject })
    }

    /// The scene that a page wants to see.
    pub(crate) fn composed(&self, show: &Show) -> Value {
        let mut scene = self.subject.scene.clone();
        let Pose { position, direction, up, fovy } = show.camera;
        scene["camera"] = json!({"position": position, "direction": direction, "up": up, "fovy": fovy});
        scene["image"]["size"] = json!(show.size);
        self.apply(&mut scene, &show.changes);
        scene
    }

    /// The same, as a file anywhere: names of files are whole.
    pub(crate) fn saved(&self, show: &Show) -> Value {
        let mut scene = self.composed(show);
        // Of a name alone the folder is the one that the program runs in.
        if let Ok(path) = std::path::absolute(&self.subject.path)
            && let Some(folder) = path.parent()
        {
            name_files(&mut scene, folder);
        }
        scene
    }

    fn apply(&self, scene: &mut Value, changes: &Changes) {
        if let Some(stops) = changes.exposure {
            scene["image"]["exposure"] = json!(stops);
        }
        if let Some(sun) = &changes.sun {
            set_sun(scene, sun);
        }
        if let Some(transfer) = &changes.transfer {
            set_transfer(&mut scene["root"], &serde_json::to_value(transfer).unwrap_or_default());
        }
        if let Some(section) = &changes.section {
            self.cut(scene, section);
        }
    }

    /// Takes away what is outside a box: the difference of the scene and a box beyond each side that cuts, so that cuts look as those
    /// of a scene file do.
    fn cut(&self, scene: &mut Value, section: &Section) {
        let (low, high) = (self.bounds.min.to_array(), self.bounds.max.to_array());
        let beyond = (self.bounds.max - self.bounds.min).max_element();
        let mut children = vec![scene["root"].take()];
        for axis in 0..3 {
            for (cuts, end) in [(section.min[axis] > low[axis], 0), (section.max[axis] < high[axis], 1)] {
                if !cuts {
                    continue;
                }
                let mut ends = [low.map(|v| v - beyond), high.map(|v| v + beyond)];
                ends[1 - end][axis] = [section.min, section.max][end][axis];
                let size: Vec<f64> = (0..3).map(|k| ends[1][k] - ends[0][k]).collect();
                let center: Vec<f64> = (0..3).map(|k| 0.5 * (ends[0][k] + ends[1][k])).collect();
                children.push(json!({"type": "box", "size": size, "transform": {"translate": center}}));
            }
        }
        scene["root"] = match children.len() {
            1 => children.remove(0),
            _ => json!({"type": "difference", "children": children}),
        };
    }
}

/// Makes the names of files whole, wherever they stand.
fn name_files(value: &mut Value, folder: &Path) {
    match value {
        Value::Object(keys) => {
            for (key, value) in keys {
                match value {
                    Value::String(name) if key == "file" => {
                        *name = folder.join(&*name).to_string_lossy().into_owned();
                    }
                    _ => name_files(value, folder),
                }
            }
        }
        Value::Array(values) => values.iter_mut().for_each(|value| name_files(value, folder)),
        _ => {}
    }
}

/// Reads a composed scene. Its text was never written by anybody, so places in it mean nothing.
pub(crate) fn parse(path: &Path, scene: &Value) -> Result<SceneFile, String> {
    SceneFile::parse(path, &scene.to_string()).map_err(|error| error.what)
}

/// Replaces the directional lights of a scene by one.
fn set_sun(scene: &mut Value, sun: &Sun) {
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

/// Puts keys in the place of those of the transfer function of a cloud or grid.
fn set_transfer(node: &mut Value, keys: &Value) {
    if node["type"] != "cloud" && node["type"] != "grid" {
        return;
    }
    if !keys["color"].is_null()
        && let Some(own) = node["transferFunction"].as_object_mut()
    {
        // They belong to the map that is replaced.
        own.remove("input");
        own.remove("valueRange");
    }
    for (key, value) in keys.as_object().into_iter().flatten() {
        node["transferFunction"][key] = value.clone();
    }
}

/// The camera of a pose, as a scene file with that pose has it.
pub(crate) fn camera(pose: &Pose) -> Camera {
    Camera {
        position: pose.position.into(),
        direction: pose.direction.into(),
        up: pose.up.into(),
        projection: Projection::Perspective { fovy: pose.fovy.to_radians() },
    }
}

/// The pose of a camera. An orthographic one, which pages do not have, stands back until it sees as much at the place that its rays
/// start from.
pub(crate) fn pose(camera: &Camera) -> Pose {
    const FOVY_DEGREES: f64 = 35.0;
    let (fovy, back) = match camera.projection {
        Projection::Perspective { fovy } => (fovy.to_degrees(), 0.0),
        Projection::Orthographic { height } => {
            (FOVY_DEGREES, 0.5 * height / (0.5 * FOVY_DEGREES).to_radians().tan())
        }
        _ => (FOVY_DEGREES, 0.0),
    };
    Pose {
        position: (camera.position - camera.direction.normalize_or_zero() * back).to_array(),
        direction: camera.direction.to_array(),
        up: camera.up.to_array(),
        fovy,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn opened() -> Opened {
        let scene = json!({
            "rayset": 1,
            "lights": [{"type": "ambient"}, {"type": "directional", "direction": [0, -1, 0]}],
            "root": {"type": "sphere", "radius": 1}
        });
        let subject = Subject { title: "a ball".into(), path: "ball.json".into(), scene };
        Opened::new(subject).expect("a scene")
    }

    fn show(changes: Changes) -> Show {
        let camera =
            Pose { position: [0.0, 0.0, 5.0], direction: [0.0, 0.0, -1.0], up: [0.0, 1.0, 0.0], fovy: 40.0 };
        Show { generation: 1, camera, size: [64, 48], moving: false, changes }
    }

    #[test]
    fn every_change_gives_a_scene_that_can_be_read() {
        let opened = opened();
        let sun = Sun { direction: [1.0, -1.0, 0.0], intensity: 0.5, shadow: true };
        let section = Section { min: [-1.0; 3], max: [1.0, 1.0, 0.0] };
        let changes = [
            Changes::default(),
            Changes { exposure: Some(1.0), ..Changes::default() },
            Changes { sun: Some(sun), ..Changes::default() },
            Changes { section: Some(section), ..Changes::default() },
        ];
        for change in changes {
            let composed = opened.composed(&show(change.clone()));
            let file =
                parse(&opened.subject.path, &composed).unwrap_or_else(|what| panic!("{change:?}: {what}"));
            assert_eq!((file.settings.width, file.settings.height), (64, 48));
            assert_eq!(file.camera, camera(&show(change).camera));
        }
    }

    #[test]
    fn a_sun_takes_the_place_of_the_scenes_own_and_leaves_other_lights() {
        let sun = Sun { direction: [1.0, -1.0, 0.0], intensity: 0.5, shadow: true };
        let composed = opened().composed(&show(Changes { sun: Some(sun), ..Changes::default() }));
        let lights = composed["lights"].as_array().expect("lights");
        assert_eq!(lights.len(), 2);
        assert_eq!(lights[1]["direction"], json!([1.0, -1.0, 0.0]));
    }

    #[test]
    fn a_section_leaves_what_is_within_its_box_and_one_around_everything_changes_nothing() {
        let opened = opened();
        let with = |min, max| {
            opened.composed(&show(Changes { section: Some(Section { min, max }), ..Changes::default() }))
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
