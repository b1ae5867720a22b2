//! The inner loop leaves out what changes nothing: samples behind the end of a ray, and points that
//! no ray of a group comes near.

use std::sync::Arc;

use rayset::field::Kernel;
use rayset::geometry::DVec3;
use rayset::octree::Cloud;
use rayset::octree::build::BuildOptions;
use rayset::scene::{
    Camera, CloudObject, Lighting, Node, OpacityRule, Operator, RenderSettings, Scene, Shape,
    TransferFunction,
};
use rayset::trace::{ExecSettings, RenderCounts, render_once};

use crate::common::{bits, build_at, folder, look, mixed_points, paged, scene_of, settings, workload_cloud};

fn rendered(
    scene: &Scene,
    camera: &Camera,
    settings: &RenderSettings,
    (tile_pixels, slab_samples): (u32, usize),
) -> (Vec<[u32; 4]>, RenderCounts) {
    let exec = ExecSettings { threads: 2, tile_pixels, slab_samples, ..ExecSettings::default() };
    let files = paged(scene, u64::MAX / 2);
    let (picture, counts) = render_once(scene, camera, settings, &exec, &files).expect("a picture");
    (bits(&picture.pixels), counts)
}

/// From (0, 0, 3) at the origin.
fn seen_under(fovy: f64) -> Camera {
    Camera::look_at(DVec3::new(0.0, 0.0, 3.0), DVec3::ZERO, DVec3::Y, fovy)
}

fn with_opacity(cloud: &Arc<Cloud>, kernel: Kernel, opacity: OpacityRule) -> CloudObject {
    let look = look(cloud, kernel);
    CloudObject { transfer: TransferFunction { opacity, ..look.transfer.clone() }, ..look }
}

/// Pairs of a sample and a point that reaches it, of all samples that rays take, one by one, until
/// they end.
fn pairs_until_rays_end(cloud: &Cloud, pixels: u32, fovy: f64, kappa: f64, stop: f64) -> u64 {
    let (header, mut points) = (cloud.header(), Vec::new());
    cloud.for_each_run(|_, run| points.extend(run.positions(header.root_cell()))).expect("the cloud reads");
    let radius = header.radius_mean;
    let (step, half) = (radius / 4.0, (0.5 * fovy).tan());
    let (origin, mut pairs) = (DVec3::new(0.0, 0.0, 3.0), 0);
    for pixel in 0..pixels * pixels {
        let at = |i: u32| (2.0 * (f64::from(i) + 0.5) / f64::from(pixels) - 1.0) * half;
        let direction = DVec3::new(at(pixel % pixels), -at(pixel / pixels), -1.0).normalize();
        // Distance along the ray, and the square of half the length within reach.
        let mut near: Vec<(f64, f64)> = (points.iter())
            .map(|&point| {
                let along = (point - origin).dot(direction);
                (along, radius * radius - (point - origin - direction * along).length_squared())
            })
            .filter(|&(_, inside)| inside > 0.0)
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut transmittance = 1.0;
        for sample in (0..).map_while(|j| Some((f64::from(j) + 0.5) * step).filter(|&t| t < 5.0)) {
            let mut depth = 0.0;
            for &(along, inside) in &near {
                let left = (inside - (sample - along).powi(2)) / (radius * radius);
                if left > 0.0 {
                    pairs += 1;
                    depth += kappa * left.powi(3) * step;
                }
            }
            transmittance *= f64::exp(-depth);
            if transmittance < stop {
                break;
            }
        }
    }
    pairs
}

#[test]
fn an_opaque_picture_evaluates_few_kernels_that_stopping_sample_by_sample_would_not() {
    let folder = folder();
    let cloud = workload_cloud("sphere-20k", folder.path());
    let (pixels, fovy, kappa) = (40, 12_f64.to_radians(), 2.0 / cloud.header().radius_mean);
    let object = with_opacity(&cloud, Kernel::Triweight, OpacityRule::Extinction(kappa));
    let settings = RenderSettings { stop_transmittance: 0.01, ..settings(pixels, pixels) };
    let (_, counts) = rendered(&scene_of(object, false), &seen_under(fovy), &settings, (8, 32));
    let needed = pairs_until_rays_end(&cloud, pixels, fovy, kappa, f64::from(settings.stop_transmittance));
    let evaluated = counts.splats.kernel_evaluations;
    // A point reaches 5.3 samples of a ray on average, which lie in 1.5 blocks of eight; and a ray
    // that ends has taken half a block too many.
    assert!(evaluated >= needed, "{evaluated} evaluations where {needed} are needed");
    assert!(evaluated < 5 * needed, "{evaluated} evaluations where {needed} are needed");
}

#[test]
fn samples_behind_the_end_of_a_ray_change_no_bit() {
    let folder = folder();
    let sphere = workload_cloud("sphere-10k", folder.path());
    let mixed = Box::new(mixed_points(20_000, 4.0, 5));
    let mixed = build_at(&folder.path().join("mixed.rset"), mixed, &BuildOptions::default());
    let dense = |cloud: &Arc<Cloud>| OpacityRule::Extinction(4.0 / cloud.header().radius_mean);
    let leaf = |object: &CloudObject| Node::new(Shape::Cloud(object.clone()));
    let (opaque, clamped) = (
        with_opacity(&sphere, Kernel::Wyvill, dense(&sphere)),
        with_opacity(&mixed, Kernel::Chen, OpacityRule::Clamp),
    );
    let thin = with_opacity(&mixed, Kernel::Wyvill, OpacityRule::Extinction(1.0));
    let mut roots = vec![leaf(&opaque), leaf(&clamped)];
    for operator in [Operator::Union, Operator::Blend, Operator::Difference, Operator::Intersection] {
        roots.push(Node::operator(operator, vec![leaf(&thin), leaf(&clamped), leaf(&opaque)]));
    }
    for (number, root) in roots.into_iter().enumerate() {
        let scene =
            Scene { root: root.into(), lighting: Lighting::headlight(), ..scene_of(opaque.clone(), true) };
        for stop_transmittance in [0.5, 0.01, 1e-4] {
            let settings = RenderSettings { stop_transmittance, ..settings(40, 40) };
            // In a slab of one block a ray ends where it ends, and no block is left out.
            let camera = seen_under(0.2);
            let (expected, all) = rendered(&scene, &camera, &settings, (8, 8));
            let (found, counts) = rendered(&scene, &camera, &settings, (8, 32));
            assert!(found == expected, "scene {number}, rays end at {stop_transmittance}");
            // Not all blocks are evaluated, though the slab has four of them.
            let (all, some) = (all.splats.kernel_evaluations, counts.splats.kernel_evaluations);
            assert!(number > 0 || some < all + all / 3, "scene {number}: {some} evaluations, {all} at least");
        }
    }
}

#[test]
fn rays_that_look_for_points_together_see_what_each_sees_alone() {
    let folder = folder();
    let sphere = workload_cloud("sphere-40k", folder.path());
    let mixed = Box::new(mixed_points(20_000, 6.0, 11));
    let mixed = build_at(&folder.path().join("mixed.rset"), mixed, &BuildOptions::default());
    // So near that neighbouring rays are a small part of a radius apart.
    let near = seen_under(6_f64.to_radians());
    for (cloud, lit) in [(&sphere, false), (&mixed, true)] {
        let scene = scene_of(look(cloud, Kernel::Wyvill), lit);
        let settings = RenderSettings { stop_transmittance: 0.0, ..settings(40, 40) };
        let (expected, alone) = rendered(&scene, &near, &settings, (1, 32));
        let (found, together) = rendered(&scene, &near, &settings, (8, 32));
        assert!(found == expected, "lit: {lit}");
        // Rays among points of very different radii look for themselves.
        let fewer = together.splats.pairs_tested < alone.splats.pairs_tested;
        assert!(fewer || lit, "{together:?}, {alone:?}");
    }
}
