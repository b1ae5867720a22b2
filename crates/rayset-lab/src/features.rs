//! What each feature of a scene costs, compared to the bare picture of its cloud.

use std::sync::Arc;
use std::time::Instant;

use anyhow::Result;
use rayset::Cloud;
use rayset::geometry::{DAffine3, DVec3};
use rayset::memory::Limits;
use rayset::scene::{
    Camera, CloudObject, Compositing, Form, Light, LightKind, Lighting, Material, Node, Operator,
    RenderSettings, Scene, Shadows, Shape, Solid, Step,
};
use rayset::{CancelToken, Picture, RenderCounts, SessionBuilder};

use crate::workloads::median;
use rayset_terminal::memory::process_cpu_seconds;
use rayset_terminal::report;

/// Bytes for pages: enough that nothing is ever evicted.
const PAGES: u64 = 1 << 32;

/// A picture that shows one feature.
struct Feature {
    name: &'static str,
    scene: Scene,
    settings: RenderSettings,
}

/// One line of the table.
#[derive(serde::Serialize)]
pub(crate) struct Cost {
    feature: &'static str,
    /// Median.
    seconds: f64,
    /// Processor time, all threads; median.
    cpu_seconds: f64,
    /// In processor time, which others on the machine disturb least.
    of_bare: f64,
    kernel_evaluations: u64,
    shadow_rays: u64,
    bounced_rays: u64,
}

/// Renders the cloud with every feature `repeat` times, in turns, after one round that does not
/// count.
pub(crate) fn measure(
    cloud: &Arc<Cloud>,
    camera: &Camera,
    session: &SessionBuilder,
    repeat: usize,
) -> Result<Vec<Cost>> {
    let features = features(cloud);
    let mut seconds = vec![Vec::new(); features.len()];
    let mut cpu_seconds = vec![Vec::new(); features.len()];
    let mut counts = vec![RenderCounts::default(); features.len()];
    for round in 0..=repeat.max(1) {
        for (i, feature) in features.iter().enumerate() {
            // Shadow tables are computed anew for each picture; pages of the cloud are read first.
            let session = session.clone().page_limits(Limits::total(PAGES)).build()?;
            let render = |feature: &Feature| -> Result<RenderCounts> {
                let view = session.prepare(&feature.scene, &feature.settings)?.view(camera)?;
                let (whole, mut picture) = (view.region(), Picture::default());
                Ok(view.render_bands(&whole, u32::MAX, &CancelToken::new(), &mut picture)?)
            };
            render(&features[0])?;
            let (started, cpu) = (Instant::now(), process_cpu_seconds());
            counts[i] = render(feature)?;
            if round > 0 {
                seconds[i].push(started.elapsed().as_secs_f64());
                cpu_seconds[i].push(process_cpu_seconds() - cpu);
            }
        }
    }
    let bare = median(&cpu_seconds[0]);
    let costs = features.iter().zip(&seconds).zip(cpu_seconds.iter().zip(&counts)).map(
        |((feature, seconds), (cpu, counts))| Cost {
            feature: feature.name,
            seconds: median(seconds),
            cpu_seconds: median(cpu),
            of_bare: median(cpu) / bare,
            kernel_evaluations: counts.splats.kernel_evaluations,
            shadow_rays: counts.shadow_rays,
            bounced_rays: counts.bounced_rays,
        },
    );
    Ok(costs.collect())
}

pub(crate) fn describe(costs: &[Cost]) {
    report::say("| feature | render s | CPU s | of bare | M evaluations | shadow rays | bounced rays |");
    report::say("| --- | ---: | ---: | ---: | ---: | ---: | ---: |");
    for cost in costs {
        report::say(format_args!(
            "| {} | {:.3} | {:.3} | {:.2} | {} | {} | {} |",
            cost.feature,
            cost.seconds,
            cost.cpu_seconds,
            cost.of_bare,
            cost.kernel_evaluations / 1_000_000,
            report::count(cost.shadow_rays),
            report::count(cost.bounced_rays)
        ));
    }
}

/// All features, the bare picture first.
fn features(cloud: &Arc<Cloud>) -> Vec<Feature> {
    let leaf = Node::new(Shape::Cloud(CloudObject::plain(cloud.clone())));
    let bounds = leaf.bounds();
    let size = bounds.size().max_element();
    let unit_distance = cloud.header().radius_mean;
    let light = |kind, shadow| Light { kind, color: [0.6; 3], shadow };
    let sun = |x: f64, shadow| light(LightKind::Directional { direction: DVec3::new(x, -1.0, -0.6) }, shadow);
    let ambient = light(LightKind::Ambient, false);
    let suns = |count: usize, shadow| -> Vec<Light> {
        let given = [0.4, -0.5, 0.0].into_iter().take(count).map(|x| sun(x, shadow));
        std::iter::once(ambient).chain(given).collect()
    };
    // A fixed step, for the same samples in every picture: automatic steps also depend on the other
    // objects.
    let plain = RenderSettings::default().with_step(Step::Fixed(0.25 * unit_distance));
    let cached = plain.with_shadows(Shadows::Cached { resolution: 512 });
    let of = |root: Node, lights: Option<Vec<Light>>| Scene {
        root: Arc::new(root),
        lighting: lights.map_or(Lighting::Unlit, Lighting::Lit),
        background: None,
        unit_distance,
        compositing: Compositing::Linear,
    };
    let feature = |name, scene, settings| Feature { name, scene, settings };
    let lit = |lights| of(leaf.clone(), Some(lights));
    let far_box = Node::new(Shape::Procedural(Arc::new(Solid::new(Form::Box { size: DVec3::splat(size) }))))
        .moved(DAffine3::from_translation(bounds.center() + DVec3::new(0.0, 40.0 * size, 0.0)));
    let hole = Form::Cylinder { radius: 0.15 * size, height: 4.0 * size };
    let hole = Node::new(Shape::Procedural(Arc::new(Solid::new(hole)))).moved(
        DAffine3::from_translation(bounds.center()) * DAffine3::from_rotation_x(std::f64::consts::FRAC_PI_2),
    );
    let with = |operator, other: &Node| of(Node::operator(operator, [leaf.clone(), other.clone()]), None);
    let mirror = Material { reflectance: 0.3, ..Material::default() };
    let glass = Material { refractive_index: 1.3, ..Material::default() };
    vec![
        feature("bare: one cloud, no light", of(leaf.clone(), None), plain),
        feature("ambient light", lit(vec![ambient]), plain),
        feature("one light", lit(suns(1, false)), plain),
        feature("two lights", lit(suns(2, false)), plain),
        feature("three lights", lit(suns(3, false)), plain),
        feature("one light, cached shadows", lit(suns(1, true)), cached),
        feature("three lights, cached shadows", lit(suns(3, true)), cached),
        feature("one light, exact shadows", lit(suns(1, true)), plain),
        feature("one light, reflectance 0.3", of(leaf.clone().of(mirror), Some(suns(1, false))), plain),
        feature("one light, refractive index 1.3", of(leaf.clone().of(glass), Some(suns(1, false))), plain),
        feature("layers", of(leaf.clone(), None), plain.with_layers(true)),
        feature("difference with a box out of sight", with(Operator::Difference, &far_box), plain),
        feature("union with a box out of sight", with(Operator::Union, &far_box), plain),
        feature("difference with a cylinder", with(Operator::Difference, &hole), plain),
        feature("intersection with a cylinder", with(Operator::Intersection, &hole), plain),
    ]
}
