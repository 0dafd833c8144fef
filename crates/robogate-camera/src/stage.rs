//! A scene as the cameras store it.

use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, Vector3};
use robogate_physics::{FixtureKind, Hull, Part, Primitive, Scene, Visual, WORKSPACE_CENTRE};

use crate::Posture;
use crate::body::{Body, Form};
use crate::caster::{Picture, Room};
use crate::finish::{Finish, Pattern};
use crate::light::{Light, color, linear};
use crate::looks::RobotLooks;
use crate::mesh::Mesh;
use crate::pinhole::Pinhole;
use crate::shadow::Shadows;
use crate::table;

/// Height of the room's floor, in metres.
const FLOOR: f32 = -0.75;

/// Colours of the obstacles, in rotation. They differ from usual colours of objects and of the marker.
const OBSTACLES: [[u8; 3]; 5] = [[92, 112, 140], [150, 140, 120], [84, 100, 104], [168, 160, 150], [110, 100, 126]];

/// A scene as the cameras store it.
#[derive(Debug)]
pub(crate) struct Stage {
    /// The front camera's pose.
    pub(crate) front: Isometry3<f64>,
    /// Number of fixtures.
    pub(crate) fixtures: usize,
    /// Names of the fixtures.
    pub(crate) names: Vec<String>,
    /// Names of the free bodies other than the object.
    pub(crate) others: Vec<String>,
    pub(crate) light: Light,
    pub(crate) room: Room,
    pub(crate) props: Vec<Prop>,
}

/// A mesh about the centre of its bounding box, and that centre.
type Centred = (Arc<Mesh>, Vector3<f64>);

/// The meshes of parts, by the piece that has each: a task has the same ones in every episode. A piece without one is not seen.
#[derive(Debug, Default)]
pub(crate) struct Meshes(Vec<(Arc<Hull>, Option<Centred>)>);

impl Meshes {
    fn of(&mut self, hull: &Arc<Hull>) -> Option<Centred> {
        let known = self.0.iter().position(|(known, _)| Arc::ptr_eq(known, hull));
        let index = known.unwrap_or_else(|| {
            let corners = hull.mesh().into_iter().flat_map(robogate_physics::Mesh::corners);
            let triangles: Vec<_> = corners.map(|triangle| triangle.map(|corner| corner.coords)).collect();
            self.0.push((Arc::clone(hull), Mesh::new(&triangles).map(|(mesh, centre)| (Arc::new(mesh), centre))));
            self.0.len() - 1
        });
        self.0[index].1.clone()
    }
}

/// A solid and the body that it moves with.
#[derive(Debug)]
pub(crate) struct Prop {
    form: Form,
    pub(crate) finish: Finish,
    pub(crate) with: With,
    /// The pose in that body's frame.
    place: Isometry3<f64>,
    /// The index of its shape among those of the body.
    #[cfg_attr(not(feature = "egl"), expect(dead_code, reason = "only MuJoCo's renderer names shapes"))]
    pub(crate) part: usize,
}

impl Prop {
    /// The look of a shape. The first piece of a mesh looks like the mesh, the others are not seen.
    fn new(meshes: &mut Meshes, shape: &Part, (with, part): (With, usize), finish: Finish) -> Option<Self> {
        let place = match with {
            // The pose of a fixture is that of its only shape.
            With::Fixture(_) | With::Table(_) => Isometry3::identity(),
            With::Object | With::Other(_) => shape.pose,
        };
        let form = match &shape.primitive {
            Primitive::Box { half } => Form::Box { half: half.map(|x| x as f32) },
            Primitive::Cylinder { radius, half_height } => {
                Form::Cylinder { radius: *radius as f32, half_height: *half_height as f32 }
            }
            Primitive::Sphere { radius } => Form::Sphere { radius: *radius as f32 },
            Primitive::Hull(hull) => {
                let (mesh, centre) = meshes.of(hull)?;
                return Some(Self {
                    form: Form::Mesh(mesh),
                    finish,
                    with,
                    place: place * Translation3::from(centre),
                    part,
                });
            }
        };
        Some(Self { form, finish, with, place, part })
    }

    /// The shape.
    pub(crate) fn form(&self) -> &Form {
        &self.form
    }

    /// The pose in the frame of its body.
    pub(crate) fn place(&self) -> &Isometry3<f64> {
        &self.place
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum With {
    /// A fixture, by its index in the scene.
    Fixture(usize),
    /// The table. It casts no visible shadow.
    Table(usize),
    Object,
    /// Another free body, by its index in the scene.
    Other(usize),
}

impl Stage {
    pub(crate) fn new(scene: &Scene, front: Isometry3<f64>, meshes: &mut Meshes) -> Self {
        let visual = &scene.visual;
        let mut props = Vec::new();
        let mut obstacles = OBSTACLES.iter().cycle();
        for (i, fixture) in scene.fixtures.iter().enumerate() {
            let (with, finish) = match fixture.kind {
                FixtureKind::Table => {
                    let table = fixture.part.pose.translation.vector;
                    let marker = scene.marker.map(|[x, y]| [(x - table.x) as f32, (y - table.y) as f32]);
                    let pattern = Pattern::Table { material: visual.table_material, marker };
                    (With::Table(i), Finish::new([128; 3], table::gloss(visual.table_material)).with(pattern))
                }
                FixtureKind::Obstacle => {
                    let own = obstacles.next().copied().unwrap_or_default();
                    (With::Fixture(i), Finish::new(own, 0.3).with(Pattern::Grain))
                }
                FixtureKind::Receptacle => {
                    (With::Fixture(i), Finish::new(fixture.color.map_or([120, 126, 134], |color| color.0), 0.5))
                }
                FixtureKind::Occluder => (With::Fixture(i), Finish::new([122, 134, 140], 0.4)),
                FixtureKind::Disturbance => (With::Fixture(i), Finish::new([236, 184, 22], 0.3).with(Pattern::Hazard)),
            };
            props.extend(Prop::new(meshes, &fixture.part, (with, 0), finish));
        }
        for (part, shape) in scene.object.parts.iter().enumerate() {
            let mut finish = Finish::new(visual.object_color.0, 0.55);
            finish.transparency = visual.object_transparency;
            props.extend(Prop::new(meshes, shape, (With::Object, part), finish));
        }
        for (i, body) in scene.others.iter().enumerate() {
            for (part, shape) in body.object.parts.iter().enumerate() {
                props.extend(Prop::new(meshes, shape, (With::Other(i), part), Finish::new(body.color.0, 0.55)));
            }
        }
        Self {
            others: scene.others.iter().map(|body| body.name.clone()).collect(),
            front: Pinhole::turned(&front, visual.camera_roll_rad, visual.camera_pitch_rad),
            fixtures: scene.fixtures.len(),
            names: scene.fixtures.iter().map(|fixture| fixture.name.clone()).collect(),
            light: Light::new(visual.lighting_lux),
            room: Room { wall: linear(visual.background_color), floor: FLOOR },
            props,
        }
    }

    /// The appearance, read from lamp, surfaces and camera. `nominal` is the nominal pose of the front camera.
    pub(crate) fn visual(&self, nominal: &Isometry3<f64>) -> Option<Visual> {
        // A quaternion of doubles has no more digits.
        let rounded = |x: f64| (x * 1e12).round() / 1e12;
        let [camera_roll_rad, camera_pitch_rad] = Pinhole::turn_between(nominal, &self.front).map(rounded);
        let table_material = self.props.iter().find_map(|prop| match prop.finish.pattern {
            Pattern::Table { material, .. } => Some(material),
            _ => None,
        })?;
        let object = &self.props.iter().find(|prop| prop.with == With::Object)?.finish;
        Some(Visual {
            lighting_lux: self.light.lux,
            camera_roll_rad,
            camera_pitch_rad,
            table_material,
            background_color: color(&self.room.wall),
            object_color: color(&object.albedo),
            object_transparency: object.transparency,
        })
    }

    /// Calls `draw` with the scene in this posture.
    pub(crate) fn with_bodies<T>(
        &self,
        robot: &RobotLooks,
        posture: &Posture,
        exhaustive: bool,
        draw: impl FnOnce(&Picture<'_>) -> T,
    ) -> T {
        let mut bodies = Vec::with_capacity(self.props.len() + robot.pieces.len());
        let mut object = Vec::with_capacity(bodies.capacity());
        let mut casts = Vec::with_capacity(bodies.capacity());
        for prop in &self.props {
            let frame = match prop.with {
                With::Fixture(i) | With::Table(i) => posture.fixtures.get(i),
                With::Object => Some(&posture.object),
                With::Other(i) => posture.others.get(i),
            };
            let Some(frame) = frame else { continue };
            bodies.push(Body::new(&prop.form, &prop.finish, &(frame * prop.place)));
            object.push(prop.with == With::Object);
            casts.push(!matches!(prop.with, With::Table(_)));
        }
        let links = robot.links(posture);
        for piece in &robot.pieces {
            let Some(link) = links.get(piece.link) else { continue };
            bodies.push(Body::new(&piece.form, &piece.finish, &(link * piece.place)));
            object.push(false);
            casts.push(true);
        }
        let [x, y] = WORKSPACE_CENTRE.map(|x| x as f32);
        let shadows = Shadows::new(&bodies, |i| casts[i], &self.light, Vector3::new(x - 0.1, y, 0.0), exhaustive);
        draw(&Picture {
            bodies: &bodies,
            shadows: &shadows,
            light: &self.light,
            room: &self.room,
            object: &object,
            exhaustive,
        })
    }
}
