//! The ray caster: computes pixels from bodies and light.

use nalgebra::Vector3;

use crate::body::{Body, Hits, LANES, Rays};
use crate::light::{self, Light};
use crate::pinhole::Pinhole;
use crate::shadow::Shadows;
use crate::tiles::{TILE, Tiles, View};

/// Neighbouring pixels that differ by more than this (of 255) are sampled again.
const CONTRAST: u8 = 20;

/// Positions of the samples of such a pixel, in pixels from its centre. No two share a row or column.
const SAMPLES: [[f32; 2]; 4] = [[-0.125, -0.375], [0.375, -0.125], [-0.375, 0.125], [0.125, 0.375]];

/// The room around the table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Room {
    /// Reflectances of its walls.
    pub(crate) wall: Vector3<f32>,
    /// Height of its floor, in metres.
    pub(crate) floor: f32,
}

impl Room {
    /// Exposed light from floor and walls along a ray from `eye`. Bodies on the table cast no shadow there.
    pub(crate) fn seen(&self, light: &Light, eye: &Vector3<f32>, direction: &Vector3<f32>) -> Vector3<f32> {
        /// Distance from the base to the walls, in metres.
        const WALL: f32 = 2.2;
        let flat = (direction.x * direction.x + direction.y * direction.y).sqrt().max(1e-6);
        let start = (eye.x * eye.x + eye.y * eye.y).sqrt();
        let to_wall = (WALL + start) / flat;
        let height = eye.z + to_wall * direction.z;
        let lit = light.full();
        // The wall is lit from above; the floor is in shade.
        let wall = self.wall * (lit * (0.74 + 0.16 * (height / 1.5).clamp(-0.6, 1.0)));
        if height >= self.floor {
            return wall;
        }
        let below = (self.floor - height).min(1.0);
        let floor = self.wall * (lit * 0.5);
        wall + (floor - wall) * (below / 0.15).min(1.0)
    }
}

/// Everything that an image shows.
pub(crate) struct Picture<'a> {
    pub(crate) bodies: &'a [Body<'a>],
    pub(crate) shadows: &'a Shadows<'a>,
    pub(crate) light: &'a Light,
    pub(crate) room: &'a Room,
    /// For each body, whether it belongs to the object.
    pub(crate) object: &'a [bool],
    /// Whether every ray tests every body.
    pub(crate) exhaustive: bool,
}

impl View {
    pub(crate) fn new(camera: &Pinhole) -> Self {
        let rotation = camera.pose.rotation.to_rotation_matrix();
        let column = |i: usize| rotation.matrix().column(i).map(|x| x as f32);
        Self {
            eye: camera.pose.translation.vector.map(|x| x as f32),
            right: column(0),
            down: column(1),
            forward: column(2),
            focal: camera.focal_px() as f32,
            width: camera.width,
            height: camera.height,
        }
    }

    /// Rays through these positions in the image (pixels).
    fn rays(&self, places: &[[f32; 2]; LANES]) -> Rays {
        let mut rays = Rays { x: [0.0; LANES], y: [0.0; LANES], z: [0.0; LANES] };
        for (k, [u, v]) in places.iter().enumerate() {
            let [x, y] = self.tangents(*u, *v);
            rays.x[k] = self.forward.x + self.right.x * x + self.down.x * y;
            rays.y[k] = self.forward.y + self.right.y * x + self.down.y * y;
            rays.z[k] = self.forward.z + self.right.z * x + self.down.z * y;
        }
        rays
    }
}

impl Picture<'_> {
    /// Red, green and blue of each pixel, row by row.
    pub(crate) fn take(&self, camera: &Pinhole) -> Vec<u8> {
        let view = View::new(camera);
        let tiles = Tiles::new(self.bodies, &view, self.exhaustive);
        let (width, height) = (view.width, view.height);
        let mut rgb = vec![0_u8; 3 * width * height];
        for row in 0..height {
            for column in (0..width).step_by(TILE) {
                let places = std::array::from_fn(|k| [(column + k) as f32 + 0.5, row as f32 + 0.5]);
                let colors = self.colors(&view, &tiles, tiles.at(column, row), &places);
                for (k, color) in colors.iter().enumerate().take(width - column) {
                    let at = 3 * (row * width + column + k);
                    rgb[at..at + 3].copy_from_slice(&light::exposed(color));
                }
            }
        }
        self.smooth_edges(&view, &tiles, &mut rgb);
        rgb
    }

    /// Samples pixels that differ from their neighbours again, four times each.
    fn smooth_edges(&self, view: &View, tiles: &Tiles, rgb: &mut [u8]) {
        let (width, height) = (view.width, view.height);
        let pixel = |rgb: &[u8], i: usize| [rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]];
        let differ = |a: [u8; 3], b: [u8; 3]| (0..3).any(|c| a[c].abs_diff(b[c]) > CONTRAST);
        let mut edge = vec![false; width * height];
        for i in 0..width * height {
            let here = pixel(rgb, i);
            if i % width + 1 < width && differ(here, pixel(rgb, i + 1)) {
                (edge[i], edge[i + 1]) = (true, true);
            }
            if i + width < width * height && differ(here, pixel(rgb, i + width)) {
                (edge[i], edge[i + width]) = (true, true);
            }
        }
        // Two pixels of one tile fill a packet.
        for row in 0..height {
            for first in (0..width).step_by(TILE) {
                let mut waiting: [usize; TILE] = [0; TILE];
                let mut count = 0;
                for column in first..(first + TILE).min(width) {
                    if edge[row * width + column] {
                        waiting[count] = column;
                        count += 1;
                    }
                }
                for pair in waiting[..count].chunks(2) {
                    let places = std::array::from_fn(|k| {
                        let [du, dv] = SAMPLES[k % 4];
                        let column = pair[(k / 4).min(pair.len() - 1)];
                        [column as f32 + 0.5 + du, row as f32 + 0.5 + dv]
                    });
                    let colors = self.colors(view, tiles, tiles.at(first, row), &places);
                    for (column, samples) in pair.iter().zip(colors.chunks_exact(4)) {
                        let mean = samples.iter().sum::<Vector3<f32>>() * 0.25;
                        let at = 3 * (row * width + column);
                        rgb[at..at + 3].copy_from_slice(&light::exposed(&mean));
                    }
                }
            }
        }
    }

    /// Nearest hit of each pixel's ray: depth along the line of sight, and index of the body.
    #[cfg(test)]
    pub(crate) fn hits(&self, camera: &Pinhole) -> Vec<(f32, u32)> {
        let view = View::new(camera);
        let tiles = Tiles::new(self.bodies, &view, self.exhaustive);
        let mut found = Vec::with_capacity(view.width * view.height);
        for row in 0..view.height {
            for column in (0..view.width).step_by(TILE) {
                let places = std::array::from_fn(|k| [(column + k) as f32 + 0.5, row as f32 + 0.5]);
                let hits = self.trace(&view, &tiles, tiles.at(column, row), &view.rays(&places), false);
                let last = (view.width - column).min(TILE);
                found.extend((0..last).map(|k| (hits.depth[k], hits.body[k])));
            }
        }
        found
    }

    /// Nearest hits of eight rays of a tile, without the object if `through`.
    fn trace(&self, view: &View, tiles: &Tiles, bits: &[u64], rays: &Rays, through: bool) -> Hits {
        let mut hits = Hits::NONE;
        for (word, bits) in bits.iter().enumerate() {
            let mut bits = *bits;
            while bits != 0 {
                let (body, near) = tiles.order[word * 64 + bits.trailing_zeros() as usize];
                bits &= bits - 1;
                // Bodies are sorted by their smallest depth, so all further ones are hidden.
                if !self.exhaustive && hits.depth.iter().all(|depth| *depth <= near) {
                    return hits;
                }
                if !(through && self.object[body as usize]) {
                    self.bodies[body as usize].meet(body, &view.eye, rays, &mut hits);
                }
            }
        }
        hits
    }

    fn colors(&self, view: &View, tiles: &Tiles, bits: &[u64], places: &[[f32; 2]; LANES]) -> [Vector3<f32>; LANES] {
        let rays = view.rays(places);
        let hits = self.trace(view, tiles, bits, &rays, false);
        let clear = |body: u32| self.bodies.get(body as usize).map_or(0.0, |body| body.finish.transparency as f32);
        let mut colors = self.shade(view, &rays, &hits);
        if hits.body.iter().any(|body| clear(*body) > 0.0) {
            let behind = self.trace(view, tiles, bits, &rays, true);
            let beyond = self.shade(view, &rays, &behind);
            for (lane, color) in colors.iter_mut().enumerate() {
                let share = clear(hits.body[lane]);
                if share > 0.0 {
                    let body = &self.bodies[hits.body[lane] as usize];
                    let direction = rays.direction(lane);
                    // At a grazing angle, glass transmits less and reflects more.
                    let point = view.eye + direction * hits.depth[lane];
                    let normal = body.normal(&body.local(&point), hits.triangle[lane]);
                    let slant = 1.0 - (normal.dot(&direction) / direction.norm()).abs();
                    let share = share * (1.0 - 0.7 * slant * slant * slant);
                    let tint = body.finish.tint();
                    *color = *color * (1.0 - share) + beyond[lane].component_mul(&tint) * share;
                }
            }
        }
        colors
    }

    /// Exposed light from the end of each ray.
    fn shade(&self, view: &View, rays: &Rays, hits: &Hits) -> [Vector3<f32>; LANES] {
        let light = self.light;
        let mut inverse = [0.0; LANES];
        for (k, inverse) in inverse.iter_mut().enumerate() {
            *inverse = 1.0 / (rays.x[k] * rays.x[k] + rays.y[k] * rays.y[k] + rays.z[k] * rays.z[k]).sqrt();
        }
        // Per ray: the terms that depend on the surface.
        let (mut nx, mut ny, mut nz) = ([0.0; LANES], [0.0; LANES], [1.0; LANES]);
        let (mut facing, mut gloss, mut seen) = ([1.0; LANES], [0.0; LANES], [0.0; LANES]);
        let mut albedo = [Vector3::zeros(); LANES];
        for k in 0..LANES {
            let Some(body) = self.bodies.get(hits.body[k] as usize) else { continue };
            let direction = rays.direction(k);
            let point = view.eye + direction * hits.depth[k];
            let local = body.local(&point);
            let mut normal = body.normal(&local, hits.triangle[k]);
            let mut away = normal.dot(&direction) * inverse[k];
            if away > 0.0 {
                // A mesh may be open or have inward normals.
                (normal, away) = (-normal, -away);
            }
            // Size of a pixel on the surface, with half of its growth at grazing angles.
            let footprint = hits.depth[k] / view.focal * (0.5 + 0.5 / (-away).max(0.15));
            (albedo[k], gloss[k]) = body.finish.at(&local, footprint);
            if normal.dot(&light.towards) > 0.0 {
                seen[k] = self.shadows.light_at(&point, hits.body[k]);
            }
            (nx[k], ny[k], nz[k], facing[k]) = (normal.x, normal.y, normal.z, -away);
        }
        // For all eight rays at once: the lighting model.
        let [lx, ly, lz]: [f32; 3] = light.towards.into();
        let (mut diffuse, mut mirrored) = ([0.0; LANES], [0.0; LANES]);
        for k in 0..LANES {
            let (ex, ey, ez) = (-rays.x[k] * inverse[k], -rays.y[k] * inverse[k], -rays.z[k] * inverse[k]);
            let lambert = nx[k] * lx + ny[k] * ly + nz[k] * lz;
            let lamp = light.key * seen[k];
            diffuse[k] = lamp * lambert.max(0.0) + light.around * (0.68 + 0.32 * nz[k]);
            // The cosine between normal and half vector (Blinn 1977) to the 32nd power, from its square.
            let (hx, hy, hz) = (lx + ex, ly + ey, lz + ez);
            let along = (nx[k] * hx + ny[k] * hy + nz[k] * hz).max(0.0);
            let square = along * along / (hx * hx + hy * hy + hz * hz).max(1e-9);
            let fourth = square * square;
            let eighth = fourth * fourth;
            let sixteenth = eighth * eighth;
            // Schlick's approximation (1994) of the reflectance of a dielectric.
            let slant = (1.0 - facing[k]).max(0.0);
            let mirrors = 0.04 + 0.96 * slant * slant * slant * slant * slant;
            let up = 2.0 * facing[k] * nz[k] - ez;
            let sky = light.around * (0.55 + 0.45 * up);
            mirrored[k] = gloss[k] * (0.35 * lamp * sixteenth * sixteenth + mirrors * sky);
        }
        std::array::from_fn(|k| match self.bodies.get(hits.body[k] as usize) {
            Some(_) => albedo[k] * diffuse[k] + Vector3::repeat(mirrored[k]),
            None => self.room.seen(light, &view.eye, &rays.direction(k)),
        })
    }
}
