//! Compares the ray caster with parry's ray casts, and with the geometry of a pinhole camera.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use parry3d_f64::math::Vector;
use parry3d_f64::query::{Ray, RayCast};
use parry3d_f64::shape::{Ball, Capsule, Cuboid, Cylinder, TriMesh};
use robogate_core::{Seed, Stream};

use crate::body::{Body, Form, NOWHERE};
use crate::caster::{Picture, Room};
use crate::finish::Finish;
use crate::light::Light;
use crate::mesh::Mesh;
use crate::pinhole::Pinhole;
use crate::shadow::Shadows;

/// A solid in our form and in parry's form. Parry's cylinders and capsules are along y.
struct Both {
    ours: Form,
    theirs: Box<dyn RayCast>,
    pose: Isometry3<f64>,
    /// Rotation from our frame to parry's.
    rotation: UnitQuaternion<f64>,
}

fn solid(kind: usize, stream: &mut Stream) -> Both {
    let mut size = || stream.between(0.02, 0.2);
    let quarter = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
    let (a, b, c) = (size(), size(), size());
    let [x, y, z] = [a, b, c].map(|x| x as f32);
    let (ours, theirs, rotation): (_, Box<dyn RayCast>, _) = match kind % 5 {
        0 => (Form::Box { half: [x, y, z] }, Box::new(Cuboid::new(Vector::new(a, b, c))), UnitQuaternion::identity()),
        1 => (Form::Sphere { radius: x }, Box::new(Ball::new(a)), UnitQuaternion::identity()),
        2 => (Form::Capsule { radius: x, half_height: y }, Box::new(Capsule::new_y(b, a)), quarter),
        3 => (Form::Cylinder { radius: x, half_height: y }, Box::new(Cylinder::new(b, a)), quarter),
        _ => {
            // An octahedron with three different half axes.
            let corners = [[a, 0.0, 0.0], [0.0, b, 0.0], [-a, 0.0, 0.0], [0.0, -b, 0.0], [0.0, 0.0, c], [0.0, 0.0, -c]];
            let faces: Vec<[u32; 3]> = (0..4).flat_map(|i| [[i, (i + 1) % 4, 4], [(i + 1) % 4, i, 5]]).collect();
            let triangles: Vec<_> = faces.iter().map(|f| f.map(|i| Vector3::from(corners[i as usize]))).collect();
            let (mesh, middle) = Mesh::new(&triangles).unwrap();
            assert!(middle.norm() < 1e-12);
            let corners = corners.iter().map(|[x, y, z]| Vector::new(*x, *y, *z)).collect();
            (Form::Mesh(Arc::new(mesh)), Box::new(TriMesh::new(corners, faces).unwrap()), UnitQuaternion::identity())
        }
    };
    let place = Translation3::new(stream.between(-0.4, 0.4), stream.between(-0.5, 0.5), stream.between(-0.1, 0.4));
    let axis = Vector3::new(stream.between(-3.0, 3.0), stream.between(-3.0, 3.0), stream.between(-3.0, 3.0));
    Both { ours, theirs, pose: Isometry3::from_parts(place, UnitQuaternion::from_scaled_axis(axis)), rotation }
}

/// The caster's hits at each pixel of an image of these solids.
fn hits(solids: &[(&Form, Isometry3<f64>)], camera: &Pinhole) -> Vec<(f32, u32)> {
    let finish = Finish::new([128; 3], 0.0);
    let bodies: Vec<_> = solids.iter().map(|(form, pose)| Body::new(form, &finish, pose)).collect();
    let light = Light::new(500.0);
    let shadows = Shadows::new(&bodies, |_| true, &light, Vector3::zeros(), false);
    let room = Room { wall: Vector3::zeros(), floor: -1.0 };
    let object = vec![false; bodies.len()];
    Picture { bodies: &bodies, shadows: &shadows, light: &light, room: &room, object: &object, exhaustive: false }
        .hits(camera)
}

fn camera() -> Pinhole {
    let pose = Pinhole::looking(Point3::new(1.2, 0.3, 0.6), Point3::new(0.0, 0.0, 0.1), &Vector3::z());
    Pinhole { pose, field_of_view_rad: 1.1, width: 120, height: 90 }
}

#[test]
fn depths_match_parry() {
    let camera = camera();
    let (mut pixels, mut covered, mut off) = (0, 0, 0);
    for scene in 0..12 {
        let mut stream = Seed::campaign(7).episode(scene).stream("solids");
        let solids: Vec<_> = (0..15).map(|kind| solid(kind, &mut stream)).collect();
        let forms: Vec<_> = solids.iter().map(|both| (&both.ours, both.pose)).collect();
        let eye = camera.pose.translation.vector;
        for (i, (depth, body)) in hits(&forms, &camera).into_iter().enumerate() {
            let place = [(i % camera.width) as f64 + 0.5, (i / camera.width) as f64 + 0.5];
            // Length 1 along the line of sight, so times of impact are depths.
            let direction = camera.point(place, 1.0).coords - eye;
            let first = solids.iter().enumerate().filter_map(|(k, both)| {
                let pose = both.pose * both.rotation.inverse();
                let local = |v: Vector3<f64>| Vector::new(v.x, v.y, v.z);
                let origin = pose.inverse_transform_point(&eye.into()).coords;
                let ray = Ray::new(local(origin), local(pose.inverse_transform_vector(&direction)));
                Some((both.theirs.cast_local_ray(&ray, 10.0, false)?, k as u32))
            });
            let theirs = first.min_by(|a, b| a.0.total_cmp(&b.0));
            pixels += 1;
            covered += usize::from(theirs.is_some());
            let same = match theirs {
                None => body == u32::MAX && depth >= NOWHERE,
                Some((t, _)) => (f64::from(depth) - t).abs() < 2e-4,
            };
            off += usize::from(!same);
        }
    }
    assert!(covered * 8 > pixels, "{covered} of {pixels} pixels show something");
    // In single precision only rays that touch an edge may differ.
    assert!(off * 2000 < pixels, "{off} of {pixels} pixels differ");
}

#[test]
fn balls_appear_at_pinhole_projection() {
    let camera = camera();
    // Tangents of the angles from the line of sight, computed only from the geometry.
    let forward = (Vector3::new(0.0, 0.0, 0.1) - Vector3::new(1.2, 0.3, 0.6)).normalize();
    let right = forward.cross(&Vector3::z()).normalize();
    let up = right.cross(&forward);
    let focal = 45.0 / 0.55_f64.tan();
    let ball = Form::Sphere { radius: 0.02 };
    let mut stream = Seed::campaign(3).stream("points");
    for _ in 0..40 {
        let point = Vector3::new(stream.between(-0.3, 0.3), stream.between(-0.3, 0.3), stream.between(0.0, 0.3));
        let off = point - Vector3::new(1.2, 0.3, 0.6);
        let expected =
            [60.0 + focal * off.dot(&right) / off.dot(&forward), 45.0 - focal * off.dot(&up) / off.dot(&forward)];
        let [u, v, depth] = camera.project(&point.into()).unwrap();
        assert!((u - expected[0]).hypot(v - expected[1]) < 1e-9 && (depth - off.dot(&forward)).abs() < 1e-12);
        let hits = hits(&[(&ball, Isometry3::from(Translation3::from(point)))], &camera);
        let seen: Vec<_> = hits.iter().enumerate().filter(|(_, (_, body))| *body == 0).map(|(i, _)| i).collect();
        let mean = |place: fn(usize, usize) -> usize| {
            seen.iter().map(|i| place(*i, camera.width) as f64 + 0.5).sum::<f64>() / seen.len() as f64
        };
        let (u, v) = (mean(|i, width| i % width), mean(|i, width| i / width));
        assert!((u - expected[0]).hypot(v - expected[1]) < 0.5, "{u} {v} for {expected:?}");
        // The area from the ball's angular size, to a few pixels along its outline.
        let radius = focal * 0.02 / off.dot(&forward);
        let area = std::f64::consts::PI * radius * radius;
        assert!((seen.len() as f64 - area).abs() < 0.2 * area + 2.0, "{} pixels for {area}", seen.len());
    }
}
