//! Textures of the table's five materials, computed once at several sizes.

use std::sync::OnceLock;

use nalgebra::Vector3;
use robogate_physics::{Color, TABLE_HALF, TableMaterial};

use crate::finish::smooth;
use crate::light::linear;

/// Texels along x and y of the finest level: about 1.6 mm each.
pub(crate) const SIZE: [usize; 2] = [512, 896];
/// Number of levels, each half as fine as the one before.
const LEVELS: usize = 5;

/// Reflectances of a table top.
pub(crate) struct Texture {
    levels: Vec<Level>,
    /// Reflectances of the rim.
    pub(crate) edge: Vector3<f32>,
    mean: Vector3<f32>,
}

struct Level {
    size: [usize; 2],
    /// Square roots of reflectances in 255ths, row by row of x.
    texels: Vec<[u8; 4]>,
}

impl Texture {
    /// The material's texture, computed at its first use.
    pub(crate) fn of(material: TableMaterial) -> &'static Self {
        static PAINTED: [OnceLock<Texture>; 5] = [const { OnceLock::new() }; 5];
        PAINTED[material as usize].get_or_init(|| Self::paint(material))
    }

    fn paint(material: TableMaterial) -> Self {
        let pitch = [0, 1].map(|i| 2.0 * TABLE_HALF[i] as f32 / SIZE[i] as f32);
        let mut fine: Vec<Vector3<f32>> = Vec::with_capacity(SIZE[0] * SIZE[1]);
        for row in 0..SIZE[1] {
            for column in 0..SIZE[0] {
                // Four samples per texel average finer detail.
                let sample = |i: usize, j: usize| {
                    let x = (column as f32 + 0.25 + 0.5 * i as f32) * pitch[0];
                    let y = (row as f32 + 0.25 + 0.5 * j as f32) * pitch[1];
                    paint(material, x, y)
                };
                fine.push((sample(0, 0) + sample(1, 0) + sample(0, 1) + sample(1, 1)) * 0.25);
            }
        }
        let mut levels = Vec::with_capacity(LEVELS);
        let mut size = SIZE;
        loop {
            levels.push(Level::new(size, &fine));
            if levels.len() == LEVELS {
                break;
            }
            let half = size.map(|n| n / 2);
            let mut coarse = Vec::with_capacity(half[0] * half[1]);
            for row in 0..half[1] {
                for column in 0..half[0] {
                    let at = |i: usize, j: usize| fine[(2 * row + j) * size[0] + 2 * column + i];
                    coarse.push((at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1)) * 0.25);
                }
            }
            (size, fine) = (half, coarse);
        }
        let mean = fine.iter().sum::<Vector3<f32>>() / fine.len() as f32;
        Self { levels, edge: mean * 0.55, mean }
    }

    /// Mean reflectances of the top.
    pub(crate) fn mean(&self) -> Vector3<f32> {
        self.mean
    }

    /// Reflectances at a point of the table, in metres from its centre. A pixel covers `footprint` metres.
    pub(crate) fn at(&self, x: f32, y: f32, footprint: f32) -> Vector3<f32> {
        let mut texel = 2.0 * TABLE_HALF[0] as f32 / SIZE[0] as f32;
        let mut level = 0;
        while level + 1 < LEVELS && texel * 1.5 < footprint {
            texel *= 2.0;
            level += 1;
        }
        self.levels[level].at((x + TABLE_HALF[0] as f32) / texel, (y + TABLE_HALF[1] as f32) / texel)
    }
}

impl Level {
    fn new(size: [usize; 2], reflectances: &[Vector3<f32>]) -> Self {
        let code = |x: f32| (255.0 * x.clamp(0.0, 1.0).sqrt() + 0.5) as u8;
        let texels = reflectances.iter().map(|c| [code(c.x), code(c.y), code(c.z), 0]).collect();
        Self { size, texels }
    }

    /// Bilinear interpolation at a position in texels from the corner.
    fn at(&self, u: f32, v: f32) -> Vector3<f32> {
        // Outside the texture, the border texels are repeated.
        let within = |x: f32, size: usize| (x - 0.5).max(0.0).min((size - 1) as f32);
        let (u, v) = (within(u, self.size[0]), within(v, self.size[1]));
        let (left, top) = (u as usize, v as usize);
        let (across, down) = (u - left as f32, v - top as f32);
        let texel = |column: usize, row: usize| {
            let [r, g, b, _] = self.texels[row.min(self.size[1] - 1) * self.size[0] + column.min(self.size[0] - 1)];
            Vector3::new(f32::from(r), f32::from(g), f32::from(b))
        };
        let upper = texel(left, top) * (1.0 - across) + texel(left + 1, top) * across;
        let lower = texel(left, top + 1) * (1.0 - across) + texel(left + 1, top + 1) * across;
        let root = (upper * (1.0 - down) + lower * down) * (1.0 / 255.0);
        root.component_mul(&root)
    }
}

/// Gloss of the table's top.
pub(crate) fn gloss(material: TableMaterial) -> f32 {
    match material {
        TableMaterial::Wood => 0.35,
        TableMaterial::Steel => 0.9,
        TableMaterial::Laminate => 0.5,
        TableMaterial::Rubber => 0.12,
        TableMaterial::Cardboard => 0.0,
    }
}

/// Reflectances at a position, in metres from the table's corner: x across the table, y along it.
fn paint(material: TableMaterial, x: f32, y: f32) -> Vector3<f32> {
    let shade = |color: [u8; 3], by: f32| linear_of(color) * by;
    match material {
        TableMaterial::Wood => {
            // Staggered planks along y, each with a different grain.
            let width = 0.1;
            let plank = (x / width).floor();
            let across = x / width - plank;
            let shift = lattice(plank as i32, 7, 0);
            let length = 0.7;
            let along = y / length + shift;
            let (board, place) = (along.floor(), along - along.floor());
            let seed = 17.0 * plank + 31.0 * board;
            let wave = 0.012 * noise(y * 3.0 + seed, x * 6.0);
            let rings = noise((x + wave) * 90.0 + seed, y * 1.6 + seed);
            let fibre = noise((x + wave) * 620.0, y * 14.0 + seed);
            let pore = smooth((noise((x + wave) * 900.0, y * 30.0 + seed) - 0.72) * 6.0);
            let tone = 0.86 + 0.22 * lattice(plank as i32, board as i32, 3);
            let light = tone * (0.84 + 0.24 * rings + 0.14 * fibre - 0.12 * pore);
            let seam = ((across.min(1.0 - across) * width).min(place.min(1.0 - place) * length) / 0.0012).min(1.0);
            let mixed = shade([201, 158, 110], 1.0) * rings + shade([178, 128, 80], 1.0) * (1.0 - rings);
            mixed * light * (0.45 + 0.55 * seam)
        }
        TableMaterial::Steel => {
            let brush = noise(x * 1400.0, y * 5.0) + 0.6 * noise(x * 420.0 + 9.0, y * 2.0);
            let cloud = noise(x * 5.0, y * 4.0);
            shade([172, 175, 179], 0.8 + 0.17 * brush + 0.1 * cloud)
        }
        TableMaterial::Laminate => {
            let fleck = smooth((noise(x * 520.0, y * 520.0) - 0.8) * 8.0);
            let cloud = noise(x * 9.0, y * 9.0);
            shade([231, 231, 226], 0.96 + 0.04 * cloud - 0.16 * fleck)
        }
        TableMaterial::Rubber => {
            // A mat with round studs, 1.2 cm apart.
            let pitch = 0.012;
            let (u, v) = (x / pitch, y / pitch + 0.5 * ((x / pitch).floor() as i32 & 1) as f32);
            let (du, dv) = (u - u.floor() - 0.5, v - v.floor() - 0.5);
            let stud = smooth((0.36 - (du * du + dv * dv).sqrt()) * 8.0);
            shade([50, 51, 54], 0.72 + 0.4 * stud + 0.3 * noise(x * 300.0, y * 300.0))
        }
        TableMaterial::Cardboard => {
            // The flutes appear as faint bands, 8 mm apart. The fibres have random directions.
            let flute = ((x / 0.008).rem_euclid(1.0) - 0.5).abs() * 2.0;
            let fibre = noise(x * 240.0, y * 700.0) + noise(x * 700.0 + 5.0, y * 240.0);
            let stain = noise(x * 7.0, y * 7.0);
            let crease = ((y - 0.7).abs() / 0.002).min(1.0);
            shade([186, 146, 99], (0.8 + 0.07 * smooth(flute) + 0.11 * fibre + 0.08 * stain) * (0.6 + 0.4 * crease))
        }
    }
}

fn linear_of(color: [u8; 3]) -> Vector3<f32> {
    linear(Color(color))
}

/// A number from 0 to below 1 per lattice point, from the mixed bits of an integer (after Jenkins's one-at-a-time
/// hash).
fn lattice(x: i32, y: i32, z: i32) -> f32 {
    let mut h = 0x9e37_79b9_u32;
    for part in [x, y, z] {
        h = h.wrapping_add(part as u32);
        h = h.wrapping_add(h << 10);
        h ^= h >> 6;
    }
    h = h.wrapping_add(h << 3);
    h ^= h >> 11;
    h = h.wrapping_add(h << 15);
    (h >> 8) as f32 / 16_777_216.0
}

/// The largest integer below `x`. `f32::floor` is a function call on processors without a rounding instruction.
fn below(x: f32) -> i32 {
    let towards_zero = x as i32;
    towards_zero - i32::from(x < towards_zero as f32)
}

/// Value noise in the plane: from 0 to 1, features about one unit wide.
fn noise(x: f32, y: f32) -> f32 {
    let (i, j) = (below(x), below(y));
    let (a, b) = (smooth(x - i as f32), smooth(y - j as f32));
    let line = |j| lattice(i, j, 0) * (1.0 - a) + lattice(i + 1, j, 0) * a;
    line(j) * (1.0 - b) + line(j + 1) * b
}

/// Value noise in space.
pub(crate) fn noise3(p: Vector3<f32>) -> f32 {
    let [i, j, k] = [below(p.x), below(p.y), below(p.z)];
    let [a, b, c] = [smooth(p.x - i as f32), smooth(p.y - j as f32), smooth(p.z - k as f32)];
    let line = |j, k| lattice(i, j, k) * (1.0 - a) + lattice(i + 1, j, k) * a;
    let plane = |k| line(j, k) * (1.0 - b) + line(j + 1, k) * b;
    plane(k) * (1.0 - c) + plane(k + 1) * c
}
