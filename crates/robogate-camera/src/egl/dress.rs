//! Adds the cell's appearance to the engine's model: colours, lights, a room and the robot's outfit.
//!
//! OpenGL's fixed pipeline has no sensor model. Every colour is therefore the sensor's response in full light, and
//! shade removes the fraction that a middle grey would lose.

use mujoco_rs::prelude::*;
use mujoco_rs::wrappers::mj_editing::{MjsBody, MjsGeom};
use nalgebra::{Isometry3, Vector3};
use robogate_physics::mujoco::{PREFIX, wxyz};
use robogate_physics::{FixtureKind, MujocoEngine, Primitive, Scene, TABLE_HALF, WORKSPACE_CENTRE};

use crate::FRONT_CAMERA;
use crate::body::Form;
use crate::finish::{Finish, Pattern};
use crate::light::{Light, MIDDLE_ALBEDO, exposed};
use crate::looks::{RobotLooks, SHOWN_GROUPS};
use crate::mesh::Mesh;
use crate::stage::{Prop, Stage, With};
use crate::table;

/// Geometry groups of visible and hidden geoms.
const SHOWN: i32 = 0;
const HIDDEN: i32 = 5;

/// Texels along a side of the shadow map, and the distance in metres that the map covers to each side of the workspace.
const SHADOW_PX: i32 = 2048;
const SHADOW_REACH: f64 = 1.3;

/// Texels along a side of a face of the room, and of a patterned fixture.
const ROOM_PX: usize = 128;
const PATTERN_PX: usize = 128;

/// Samples per pixel.
const SAMPLES: i32 = 4;

/// Exponent of the cosine in a highlight, as in the embedded caster; OpenGL takes it in 128ths.
const HIGHLIGHT: f32 = 32.0 / 128.0;

/// Visualisation options: geoms of the visible groups, without MuJoCo's additions.
pub(super) fn options() -> MjvOption {
    MjvOption {
        geomgroup: [1, 1, 1, 0, 0, 0],
        sitegroup: [0; 6],
        jointgroup: [0; 6],
        tendongroup: [0; 6],
        actuatorgroup: [0; 6],
        ..MjvOption::default()
    }
}

/// The model to render. Its joints and their order equal those of the engine's model.
pub(super) fn model(
    engine: &MujocoEngine,
    scene: &Scene,
    stage: &Stage,
    outfit: Option<&RobotLooks>,
    size: [usize; 2],
) -> Result<MjModel, MjEditError> {
    let mut spec = engine.base().clone();
    let mut wardrobe = Wardrobe { light: stage.light, ground: Vector3::repeat(MIDDLE_ALBEDO), count: 0 };
    wardrobe.robot(&mut spec, outfit);
    engine.furnish(&mut spec, scene)?;
    wardrobe.props(&mut spec, scene, stage);
    set(&mut spec, stage, size);
    spec.compile()
}

/// Lamps, room and quality.
fn set(spec: &mut MjSpec, stage: &Stage, [width, height]: [usize; 2]) {
    let visual = spec.visual_mut();
    (visual.global.offwidth, visual.global.offheight) = (width as i32, height as i32);
    (visual.quality.offsamples, visual.quality.shadowsize) = (SAMPLES, SHADOW_PX);
    (visual.quality.numslices, visual.quality.numstacks) = (48, 24);
    visual.headlight.active = 0;
    visual.map.shadowclip = 1.0;
    let [x, y] = WORKSPACE_CENTRE;
    spec.stat_mut().extent = SHADOW_REACH;
    spec.stat_mut().center = [x - 0.15, y, 0.2];
    let Shares { around, above, lamp, highlight } = Shares::of(&stage.light);
    let towards = stage.light.towards.map(f64::from);
    let world = spec.world_body_mut();
    let sun = world.add_light();
    sun.set_type(MjtLightType::mjLIGHT_DIRECTIONAL);
    sun.set_castshadow(true);
    *sun.pos_mut() = (Vector3::new(x - 0.15, y, 0.2) + towards * 2.0).into();
    *sun.dir_mut() = (-towards).into();
    *sun.diffuse_mut() = [lamp; 3];
    *sun.ambient_mut() = [0.0; 3];
    *sun.specular_mut() = [highlight; 3];
    let sky = world.add_light();
    sky.set_type(MjtLightType::mjLIGHT_DIRECTIONAL);
    sky.set_castshadow(false);
    *sky.pos_mut() = [x, y, 3.0];
    *sky.dir_mut() = [0.0, 0.0, -1.0];
    *sky.diffuse_mut() = [above; 3];
    *sky.ambient_mut() = [around; 3];
    *sky.specular_mut() = [0.0; 3];
    let eye = Vector3::from(FRONT_CAMERA.0).map(|x| x as f32);
    let faces = cube(ROOM_PX, |direction| {
        // In the sky box y points up.
        let direction = Vector3::new(direction.x, -direction.z, direction.y);
        exposed(&stage.room.seen(&stage.light, &eye, &direction))
    });
    texture(spec, "room", MjtTexture::mjTEXTURE_SKYBOX, [ROOM_PX, 6 * ROOM_PX], &faces);
}

/// Fractions of a colour in full light that a surface shows in different orientations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shares {
    /// In any orientation.
    pub(super) around: f32,
    /// In addition, where it faces upwards.
    pub(super) above: f32,
    /// In addition, where it faces the lamp.
    pub(super) lamp: f32,
    /// In addition, where a perfectly glossy surface mirrors the lamp.
    pub(super) highlight: f32,
}

impl Shares {
    /// Chosen so that an upward surface shows its full colour in full light, and in shade the same fraction as a middle
    /// grey.
    pub(super) fn of(light: &Light) -> Self {
        let seen = |radiance: f32| f32::from(exposed(&Vector3::repeat(radiance))[0]);
        let full = seen(MIDDLE_ALBEDO * light.full());
        let shade = seen(MIDDLE_ALBEDO * light.around) / full;
        // Vertical surfaces receive a third less ambient light.
        let around = seen(MIDDLE_ALBEDO * light.around * 0.68) / full;
        let mirror = seen(MIDDLE_ALBEDO * light.full() + 0.35 * light.key) / full - 1.0;
        Self { around, above: shade - around, lamp: (1.0 - shade) / light.towards.z, highlight: mirror }
    }
}

/// Assigns a material to every surface.
struct Wardrobe {
    light: Light,
    /// Mean reflectances of the table's top.
    ground: Vector3<f32>,
    /// Number of materials so far, for their names.
    count: usize,
}

impl Wardrobe {
    /// The robot in its outfit, or in the colours of its model under these lights.
    fn robot(&mut self, spec: &mut MjSpec, outfit: Option<&RobotLooks>) {
        let Some(looks) = outfit else {
            self.own_colours(spec);
            return;
        };
        for geom in spec.geom_iter_mut() {
            geom.set_group(HIDDEN);
        }
        for piece in &looks.pieces {
            let look = self.look(spec, &piece.finish);
            // The first link is the base, which is fixed.
            let (body, place) = if piece.link == 0 {
                (spec.world_body_mut(), piece.place)
            } else {
                let Some((name, _, within)) = looks.bodies.iter().find(|(_, link, _)| *link == piece.link) else {
                    continue;
                };
                let Some(body) = spec.body_mut(name) else { continue };
                (body, within.inverse() * piece.place)
            };
            let (kind, size) = match piece.form {
                Form::Box { half } => (MjtGeomBase::mjGEOM_BOX, half),
                Form::Sphere { radius } => (MjtGeomBase::mjGEOM_SPHERE, [radius, 0.0, 0.0]),
                Form::Capsule { radius, half_height } => (MjtGeomBase::mjGEOM_CAPSULE, [radius, half_height, 0.0]),
                Form::Cylinder { radius, half_height } => (MjtGeomBase::mjGEOM_CYLINDER, [radius, half_height, 0.0]),
                // Outfits have no meshes.
                Form::Mesh(_) => continue,
            };
            add(body, kind, size.map(f64::from), &place, &look);
        }
    }

    /// A robot without an outfit, as in MuJoCo's viewer, under these lights.
    fn own_colours(&mut self, spec: &mut MjSpec) {
        let any = spec.geom_iter().any(|geom| geom.group() <= SHOWN_GROUPS);
        let light = self.light;
        let seen = |rgba: &mut [f32; 4]| {
            let color = [rgba[0], rgba[1], rgba[2]].map(|x| (255.0 * x.clamp(0.0, 1.0)).round() as u8);
            let [r, g, b] = in_full_light(&light, &Finish::new(color, 0.0).albedo);
            (rgba[0], rgba[1], rgba[2]) = (r, g, b);
        };
        for geom in spec.geom_iter_mut() {
            seen(geom.rgba_mut());
            if !any {
                geom.set_group(SHOWN);
            }
        }
        for material in spec.material_iter_mut() {
            seen(material.rgba_mut());
        }
    }

    /// Table, obstacles, object and other free bodies.
    fn props(&mut self, spec: &mut MjSpec, scene: &Scene, stage: &Stage) {
        for prop in &stage.props {
            let part = prop.part;
            let name = match prop.with {
                With::Table(i) => {
                    self.table(spec, scene, i, &prop.finish);
                    continue;
                }
                With::Fixture(i) => {
                    let Some(fixture) = scene.fixtures.get(i) else { continue };
                    format!("{PREFIX}{}", fixture.name)
                }
                With::Object => format!("{PREFIX}object_{part}"),
                With::Other(i) => format!("{PREFIX}object@{}_{part}", i + 1),
            };
            let look = match (prop.finish.pattern, prop.with) {
                (Pattern::Hazard, With::Fixture(i)) => {
                    let half = scene.fixtures.get(i).map(|fixture| fixture.part.primitive.half_extent());
                    self.patterned(spec, &prop.finish, half.unwrap_or([0.05; 3]))
                }
                _ => self.look(spec, &prop.finish),
            };
            if let Form::Mesh(mesh) = prop.form() {
                self.mesh(spec, scene, prop, mesh, &look);
            } else if let Some(geom) = spec.geom_mut(&name) {
                geom.set_group(SHOWN);
                geom.set_material(&look);
            }
        }
        // Pieces of meshes are not seen.
        for geom in spec.geom_iter_mut() {
            if geom.name().starts_with(PREFIX) && geom.meshname() == geom.name() {
                geom.set_group(HIDDEN);
            }
        }
    }

    /// The mesh of a body, which its convex pieces stand for in contacts.
    fn mesh(&mut self, spec: &mut MjSpec, scene: &Scene, prop: &Prop, mesh: &Mesh, look: &str) {
        self.count += 1;
        let name = format!("{PREFIX}mesh_{}", self.count);
        let corners: Vec<f32> = mesh.corners().into_iter().flatten().flatten().collect();
        let faces: Vec<i32> = (0..corners.len() as i32 / 3).collect();
        let own = spec.add_mesh().with_name(&name);
        own.set_uservert(&corners);
        own.set_userface(&faces);
        let of_fixture = |i: usize| scene.fixtures.get(i).map(|of| (of.motion.is_some(), &of.name, of.part.pose));
        let (body, place) = match prop.with {
            With::Table(i) | With::Fixture(i) => match of_fixture(i) {
                Some((true, name, _)) => (spec.body_mut(&format!("{PREFIX}{name}")), *prop.place()),
                Some((false, _, pose)) => (Some(spec.world_body_mut()), pose * prop.place()),
                None => return,
            },
            With::Object => (spec.body_mut(&format!("{PREFIX}object")), *prop.place()),
            With::Other(i) => (spec.body_mut(&format!("{PREFIX}object@{}", i + 1)), *prop.place()),
        };
        let Some(body) = body else { return };
        let geom = add(body, MjtGeomBase::mjGEOM_MESH, [0.0; 3], &place, look);
        geom.set_meshname(&name);
        geom.set_mass(0.0);
    }

    /// A board in the rim's colour, and a sheet on it with the texture of the top and the marker.
    fn table(&mut self, spec: &mut MjSpec, scene: &Scene, fixture: usize, finish: &Finish) {
        let Some(table) = scene.fixtures.get(fixture).filter(|fixture| fixture.kind == FixtureKind::Table) else {
            return;
        };
        let Primitive::Box { half } = table.part.primitive else { return };
        if let Some(geom) = spec.geom_mut(&format!("{PREFIX}{}", table.name)) {
            geom.set_group(HIDDEN);
        }
        let (rim, _) = finish.at(&Vector3::new(0.0, 0.0, -1.0), 0.01);
        let rim = self.material(spec, in_full_light(&self.light, &rim), 1.0, 0.2, None);
        /// Distance of the board below the sheet, in metres.
        const BELOW: f64 = 2e-3;
        let board = table.part.pose * Isometry3::translation(0.0, 0.0, -0.5 * BELOW);
        let size = [half[0], half[1], half[2] - 0.5 * BELOW];
        add(spec.world_body_mut(), MjtGeomBase::mjGEOM_BOX, size, &board, &rim);
        let [columns, rows] = table::SIZE;
        let pitch = [2.0 * TABLE_HALF[0] / columns as f64, 2.0 * TABLE_HALF[1] / rows as f64];
        let mut texels = Vec::with_capacity(3 * columns * rows);
        let mut sum = Vector3::zeros();
        // MuJoCo's first row is at the largest y.
        for row in (0..rows).rev() {
            for column in 0..columns {
                let x = (column as f64 + 0.5) * pitch[0] - TABLE_HALF[0];
                let y = (row as f64 + 0.5) * pitch[1] - TABLE_HALF[1];
                let (top, _) = finish.at(&Vector3::new(x as f32, y as f32, half[2] as f32), pitch[0] as f32);
                texels.extend(exposed(&(top * self.light.full())));
                sum += top;
            }
        }
        self.ground = sum / (columns * rows) as f32;
        texture(spec, "table", MjtTexture::mjTEXTURE_2D, [columns, rows], &texels);
        let top = self.material(spec, [1.0; 3], 1.0, finish.gloss, Some("table"));
        let sheet = table.part.pose * Isometry3::translation(0.0, 0.0, half[2]);
        add(spec.world_body_mut(), MjtGeomBase::mjGEOM_PLANE, [half[0], half[1], 0.05], &sheet, &top);
    }

    /// A plain surface of this finish.
    fn look(&mut self, spec: &mut MjSpec, finish: &Finish) -> String {
        let (color, opacity) = self.clear(finish);
        self.material(spec, color, opacity, finish.gloss, None)
    }

    /// Colour and opacity of a finish. OpenGL blends sensor responses instead of light, so they are chosen to be
    /// correct above the table.
    fn clear(&self, finish: &Finish) -> ([f32; 3], f32) {
        let own = in_full_light(&self.light, &finish.albedo);
        let share = finish.transparency as f32;
        if share <= 0.0 {
            return (own, 1.0);
        }
        let dark = in_full_light(&self.light, &(finish.albedo * (1.0 - share)));
        let through = finish.tint().component_mul(&self.ground) * share;
        let over = in_full_light(&self.light, &(finish.albedo * (1.0 - share) + through));
        let ground = in_full_light(&self.light, &self.ground);
        // Mean fraction of the ground's colour that remains visible.
        let left = (0..3).map(|i| (over[i] - dark[i]) / ground[i].max(1e-3)).sum::<f32>() / 3.0;
        let opacity = (1.0 - left).clamp(0.02, 1.0);
        let color = [0, 1, 2].map(|i: usize| ((over[i] - (1.0 - opacity) * ground[i]) / opacity).clamp(0.0, 1.0));
        (color, opacity)
    }

    /// A material for a solid with these half extents (m) and a finish that varies over it.
    fn patterned(&mut self, spec: &mut MjSpec, finish: &Finish, half: [f64; 3]) -> String {
        let half = Vector3::from(half).map(|x| x as f32);
        let full = self.light.full();
        let faces = cube(PATTERN_PX, |direction| {
            let (color, _) = finish.at(&direction.component_mul(&half), 0.002);
            exposed(&(color * full))
        });
        texture(spec, "pattern", MjtTexture::mjTEXTURE_CUBE, [PATTERN_PX, 6 * PATTERN_PX], &faces);
        self.material(spec, [1.0; 3], 1.0, finish.gloss, Some("pattern"))
    }

    fn material(
        &mut self,
        spec: &mut MjSpec,
        [red, green, blue]: [f32; 3],
        opacity: f32,
        gloss: f32,
        texture: Option<&str>,
    ) -> String {
        self.count += 1;
        let name = format!("{PREFIX}look_{}", self.count);
        let material = spec.add_material().with_name(&name);
        *material.rgba_mut() = [red, green, blue, opacity];
        material.set_specular(gloss);
        material.set_shininess(HIGHLIGHT);
        material.set_reflectance(0.0);
        material.set_emission(0.0);
        if let Some(texture) = texture {
            material.set_texuniform(false);
            material.set_texture(MjtTextureRoleBase::mjTEXROLE_RGB, &format!("{PREFIX}{texture}"));
        }
        name
    }
}

/// Response of the sensor to these reflectances in full light, from 0 to 1.
fn in_full_light(light: &Light, albedo: &Vector3<f32>) -> [f32; 3] {
    exposed(&(albedo * light.full())).map(|x| f32::from(x) / 255.0)
}

fn add<'a>(
    body: &'a mut MjsBody,
    kind: MjtGeomBase,
    size: [f64; 3],
    place: &Isometry3<f64>,
    look: &str,
) -> &'a mut MjsGeom {
    let geom: &mut MjsGeom = body.add_geom();
    geom.set_type(kind);
    *geom.size_mut() = size;
    *geom.pos_mut() = place.translation.vector.into();
    *geom.quat_mut() = wxyz(&place.rotation);
    geom.set_contype(0);
    geom.set_conaffinity(0);
    geom.set_group(SHOWN);
    geom.set_material(look);
    *geom.rgba_mut() = [0.5, 0.5, 0.5, 1.0];
    geom
}

fn texture(spec: &mut MjSpec, name: &str, kind: MjtTexture, [width, height]: [usize; 2], texels: &[u8]) {
    let texture = spec.add_texture().with_name(&format!("{PREFIX}{name}"));
    texture.set_type(kind);
    texture.set_width(width as i32);
    texture.set_height(height as i32);
    texture.set_nchannel(3);
    texture.set_data(texels);
}

/// The six faces of a cube map in OpenGL's order and orientation. `color` gives the colour in a direction whose largest
/// component is 1.
fn cube(side: usize, color: impl Fn(Vector3<f32>) -> [u8; 3]) -> Vec<u8> {
    let mut texels = Vec::with_capacity(18 * side * side);
    for face in 0..6 {
        for row in 0..side {
            for column in 0..side {
                let [u, v] = [column, row].map(|i| (2.0 * i as f32 + 1.0) / side as f32 - 1.0);
                texels.extend(color(match face {
                    0 => Vector3::new(1.0, -v, -u),
                    1 => Vector3::new(-1.0, -v, u),
                    2 => Vector3::new(u, 1.0, v),
                    3 => Vector3::new(u, -1.0, -v),
                    4 => Vector3::new(u, -v, 1.0),
                    _ => Vector3::new(-u, -v, -1.0),
                }));
            }
        }
    }
    texels
}
