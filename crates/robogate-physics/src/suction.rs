//! Decides when a suction cup grips the object and when it loses it. The rules are the same for all engines.
//!
//! A cup with a grip command measures distances along the tool's z axis to the object, from the centre of its lip and
//! from [`RIM_POINTS`] points around it. It grips if the distance from the centre to the object is at most the grip
//! threshold. With vacuum, the distance must also be within the range that the lip can follow. The engine then attaches
//! the object ([`crate::Engine::attach`]). The following behaviour depends on the law:
//!
//! [`SuctionLaw::Surface`] is the surface gripper of the paper (section 4.1): the joint never breaks.
//!
//! [`SuctionLaw::Vacuum`] holds by pressure. First the lip must seal: every point of the rim sees the object, and the
//! surface deviates from the plane of the lip, by tilt or by bending, by no more than [`LIP_SHARE`] of the lip's diameter.
//! This is the condition of Dex-Net 3.0 (Mahler et al. 2018, section IV: the cup's ring is projected along the approach
//! onto the surface, and its deformation must be at most 10 %), applied to displacement instead of the strain of springs.
//! Bending also costs force: the fraction of the pressure that is left falls linearly from 1 on a plane to 0 at the limit.
//! Let V = fraction x vacuum x area be the suction force, T the tension along the cup's axis, N = V - T the force that
//! still presses the lip on the surface, S the shear force, M_z and M the torques about and across the axis, R the lip's
//! radius and mu the friction coefficient. The cup holds while
//!
//! - T < V,
//! - (S / (mu N))^2 + (M_z / (mu R N))^2 <= 1: friction of a ring, as the ellipsoid of Howe and Cutkosky (1996),
//! - M <= N R: beyond, the object tips over the edge of the lip. (From N R / 2 on, one side of the ring bears no load. The
//!   rubber follows the surface there, and the seal is assumed to last until the object tips: this is the cup's upper bound.)
//!
//! An overloaded cup leaks and has lost the object. It grips again only after a release command.
//!
//! The vacuum is reached after [`BUILD_UP_S`] of uninterrupted sealing. The joint is stiff but the lip is rubber: the
//! load on the lip is low-pass filtered with a time constant of [`LIP_LAG_S`], so impacts of a few milliseconds do not
//! peel it off.

use std::f64::consts::{PI, TAU};
use std::fmt;
use std::str::FromStr;

use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::{GripperCommand, Part, Primitive, SuctionCup, Wrench};

/// Number of points of the lip from which the distance to the surface is measured.
pub const RIM_POINTS: usize = 16;

/// Largest deviation of the surface from the lip's plane that the lip can follow, as a fraction of its diameter.
pub const LIP_SHARE: f64 = 0.1;

/// Time that a sealed cup takes to reach its vacuum, in seconds: ejectors at the tool need 50 to 200 ms.
pub const BUILD_UP_S: f64 = 0.1;

/// Time constant of the load on a lip, in seconds.
pub const LIP_LAG_S: f64 = 0.02;

/// Start of the distance measurement behind the lip, in metres, so that a lip pressed into the surface still detects
/// it.
const BEHIND_M: f64 = 0.02;

/// The law by which a suction cup holds an object.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SuctionLaw {
    /// A rigid joint that never breaks.
    Surface,
    /// Pressure and friction, up to their limits.
    Vacuum,
}

impl SuctionLaw {
    /// Every law.
    pub const ALL: [Self; 2] = [Self::Surface, Self::Vacuum];

    /// The name on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Surface => "surface",
            Self::Vacuum => "vacuum",
        }
    }
}

impl fmt::Display for SuctionLaw {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl FromStr for SuctionLaw {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|law| law.as_str() == name);
        found.ok_or_else(|| format!("`{name}` is not a suction law. Expected one of: surface, vacuum"))
    }
}

impl SuctionCup {
    /// Area within the lip, in m^2.
    pub fn area_m2(&self) -> f64 {
        0.25 * PI * self.cup_diameter_m * self.cup_diameter_m
    }

    /// Largest tension along its axis on a plane, in newtons.
    pub fn force_n(&self) -> f64 {
        self.vacuum_pa * self.area_m2()
    }
}

/// The result of a cup's distance measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Distance from the centre of the lip to the object along the tool's z axis, in metres; negative if they overlap.
    pub gap_m: f64,
    /// Fraction of the suction force that the seal retains. `None` if the lip does not seal.
    pub seal: Option<f64>,
}

/// Measures the distance from a cup at `tcp` to an object of these parts. `None` if no object is in front of it.
pub fn look(cup: &SuctionCup, tcp: &Isometry3<f64>, parts: &[Part], object: &Isometry3<f64>) -> Option<View> {
    let depth = |x: f64, y: f64| {
        let from = object.inverse_transform_point(&(tcp * Point3::new(x, y, -BEHIND_M)));
        let direction = object.inverse_transform_vector(&(tcp.rotation * Vector3::z()));
        let nearest = parts.iter().filter_map(|part| {
            let from = part.pose.inverse_transform_point(&from);
            let direction = part.pose.inverse_transform_vector(&direction);
            enters(&part.primitive, &from, &direction)
        });
        nearest.min_by(f64::total_cmp).map(|distance| distance - BEHIND_M)
    };
    let gap_m = depth(0.0, 0.0)?;
    let radius = 0.5 * cup.cup_diameter_m;
    let rim: Option<Vec<(f64, f64, f64)>> = (0..RIM_POINTS)
        .map(|k| (TAU * k as f64 / RIM_POINTS as f64).sin_cos())
        .map(|(sin, cos)| depth(radius * cos, radius * sin).map(|depth| (cos, sin, depth)))
        .collect();
    let seal = rim.and_then(|rim| {
        // The least-squares plane through evenly spaced points of a circle is given by the first Fourier terms.
        let mean = |f: fn(&(f64, f64, f64)) -> f64| rim.iter().map(f).sum::<f64>() / RIM_POINTS as f64;
        let (level, slope_x, slope_y) = (mean(|p| p.2), 2.0 * mean(|p| p.2 * p.0), 2.0 * mean(|p| p.2 * p.1));
        let tilt = 2.0 * slope_x.hypot(slope_y);
        let bend = rim
            .iter()
            .map(|(cos, sin, depth)| (depth - level - slope_x * cos - slope_y * sin).abs())
            .fold((gap_m - level).abs(), f64::max);
        let limit = LIP_SHARE * cup.cup_diameter_m;
        (tilt <= limit && bend < limit).then(|| 1.0 - bend / limit)
    });
    Some(View { gap_m, seal })
}

/// Distance at which a ray from `from` along the unit vector `direction` enters a primitive. `None` if it misses it or
/// starts inside.
fn enters(primitive: &Primitive, from: &Point3<f64>, direction: &Vector3<f64>) -> Option<f64> {
    let slab = |axis: usize, half: f64| -> Option<(f64, f64)> {
        if direction[axis].abs() < 1e-12 {
            return (from[axis].abs() <= half).then_some((f64::NEG_INFINITY, f64::INFINITY));
        }
        let (a, b) = ((-half - from[axis]) / direction[axis], (half - from[axis]) / direction[axis]);
        Some((a.min(b), a.max(b)))
    };
    let overlap = |a: (f64, f64), b: (f64, f64)| (a.0.max(b.0), a.1.min(b.1));
    // The part of the ray that is within `radius` of the origin.
    let within = |from: Vector3<f64>, direction: Vector3<f64>, radius: f64| -> Option<(f64, f64)> {
        let (a, b, c) = (direction.norm_squared(), from.dot(&direction), from.norm_squared() - radius * radius);
        if a < 1e-12 {
            return (c <= 0.0).then_some((f64::NEG_INFINITY, f64::INFINITY));
        }
        let root = (b * b - a * c).sqrt();
        root.is_finite().then(|| ((-b - root) / a, (-b + root) / a))
    };
    let flat = |v: Vector3<f64>| Vector3::new(v.x, v.y, 0.0);
    let (enter, leave) = match primitive {
        Primitive::Box { half } => overlap(overlap(slab(0, half[0])?, slab(1, half[1])?), slab(2, half[2])?),
        Primitive::Cylinder { radius, half_height } => {
            overlap(within(flat(from.coords), flat(*direction), *radius)?, slab(2, *half_height)?)
        }
        Primitive::Sphere { radius } => within(from.coords, *direction, *radius)?,
        Primitive::Hull(hull) => hull.along(from, direction)?,
    };
    (enter <= leave && enter >= 0.0).then_some(enter)
}

/// Whether a cup with the suction force `suction` (N) and the radius `radius` (m) holds against this load: the wrench of
/// the cup on the object in the tool's frame, z out of the tool. `friction` is the coefficient of lip and object.
pub fn holds(suction: f64, radius: f64, friction: f64, load: &Wrench) -> bool {
    let tension = -load.force.z;
    let pressing = suction - tension;
    if pressing <= 0.0 {
        return false;
    }
    let across = load.force.xy().norm().hypot(load.torque.z / radius);
    across <= friction * pressing && load.torque.xy().norm() <= radius * pressing
}

/// The state of a working cup.
#[derive(Debug, Clone)]
pub(crate) struct Suction {
    law: SuctionLaw,
    cup: SuctionCup,
    threshold: f64,
    friction: f64,
    time_step: f64,
    state: State,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum State {
    Idle,
    /// Sealed for this long, in seconds.
    Sealed(f64),
    /// Holding with this suction force in newtons, under this filtered load.
    Holding(f64, Wrench),
    /// Overloaded: the vacuum is lost.
    Leaked,
}

/// The change that the engine must make.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Change {
    Attach,
    Detach,
}

impl Suction {
    /// Creates a cup that grips within `threshold` (m) of an object with this friction coefficient, for steps of
    /// `time_step` (s).
    pub(crate) fn new(law: SuctionLaw, cup: SuctionCup, threshold: f64, friction: f64, time_step: f64) -> Self {
        Self { law, cup, threshold, friction, time_step, state: State::Idle }
    }

    /// Another object has this friction coefficient.
    pub(crate) fn set_friction(&mut self, friction: f64) {
        self.friction = friction;
    }

    /// Largest tension along the cup's axis on a plane, in newtons.
    pub(crate) fn force_n(&self) -> f64 {
        self.cup.force_n()
    }

    /// The distance at which the cup grips, in metres.
    pub(crate) fn threshold_m(&self) -> f64 {
        self.threshold
    }

    /// Whether the cup holds the object.
    pub(crate) fn holding(&self) -> bool {
        matches!(self.state, State::Holding(..))
    }

    /// Advances one time step with the command, the measured distances and the load.
    pub(crate) fn step(
        &mut self,
        command: GripperCommand,
        view: impl FnOnce(&SuctionCup) -> Option<View>,
        load: Option<Wrench>,
    ) -> Option<Change> {
        match (command, self.state) {
            (GripperCommand::Open, State::Holding(..)) => {
                self.state = State::Idle;
                Some(Change::Detach)
            }
            (GripperCommand::Open, _) => {
                self.state = State::Idle;
                None
            }
            (GripperCommand::Close, State::Idle | State::Sealed(_)) => {
                let within = match self.law {
                    SuctionLaw::Surface => self.threshold,
                    SuctionLaw::Vacuum => self.threshold.min(LIP_SHARE * self.cup.cup_diameter_m),
                };
                let view = view(&self.cup).filter(|view| view.gap_m <= within);
                self.state = match (self.law, view, self.state) {
                    (_, None, _) | (SuctionLaw::Vacuum, Some(View { seal: None, .. }), _) => State::Idle,
                    (SuctionLaw::Surface, Some(_), _) => State::Holding(f64::INFINITY, Wrench::ZERO),
                    (SuctionLaw::Vacuum, Some(View { seal: Some(share), .. }), State::Sealed(time))
                        if time + self.time_step >= BUILD_UP_S =>
                    {
                        State::Holding(share * self.cup.force_n(), Wrench::ZERO)
                    }
                    (SuctionLaw::Vacuum, _, State::Sealed(time)) => State::Sealed(time + self.time_step),
                    (SuctionLaw::Vacuum, ..) => State::Sealed(0.0),
                };
                self.holding().then_some(Change::Attach)
            }
            (GripperCommand::Close, State::Holding(suction, mut felt)) => {
                if let (SuctionLaw::Vacuum, Some(load)) = (self.law, load) {
                    let share = 1.0 - (-self.time_step / LIP_LAG_S).exp();
                    felt.force += (load.force - felt.force) * share;
                    felt.torque += (load.torque - felt.torque) * share;
                    if !holds(suction, 0.5 * self.cup.cup_diameter_m, self.friction, &felt) {
                        self.state = State::Leaked;
                        return Some(Change::Detach);
                    }
                }
                self.state = State::Holding(suction, felt);
                None
            }
            (GripperCommand::Close, State::Leaked) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};

    const CUP: f64 = 0.04;

    fn cup() -> SuctionCup {
        SuctionCup { cup_body: "cup".to_owned(), cup_diameter_m: CUP, vacuum_pa: 60_000.0, bellows: None }
    }

    fn cube(size: f64) -> Primitive {
        Primitive::Box { half: [0.5 * size; 3] }
    }

    fn ball(size: f64) -> Primitive {
        Primitive::Sphere { radius: 0.5 * size }
    }

    /// The view of a cup that points down from `height` above the top of a primitive at the origin, offset by `at`.
    fn view(primitive: Primitive, at: [f64; 2], height: f64, tilt: f64) -> Option<View> {
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI + tilt);
        let top = primitive.half_extent()[2];
        let tcp = Isometry3::from_parts(Translation3::new(at[0], at[1], top + height), down);
        look(&cup(), &tcp, &[Part { primitive, pose: Isometry3::identity() }], &Isometry3::identity())
    }

    #[test]
    fn force_is_pressure_times_area() {
        assert!((cup().force_n() - 75.4).abs() < 0.1);
    }

    #[test]
    fn gap_may_be_negative() {
        let cylinder = Primitive::Cylinder { radius: 0.025, half_height: 0.025 };
        for (primitive, height) in [(cube(0.05), 0.01), (cylinder, 0.002), (ball(0.05), -0.003)] {
            let gap = view(primitive.clone(), [0.0, 0.0], height, 0.0).unwrap().gap_m;
            assert!((gap - height).abs() < 1e-12, "{primitive:?}: {gap}");
        }
        assert_eq!(view(cube(0.05), [0.03, 0.0], 0.01, 0.0), None);
    }

    #[test]
    fn lip_seals_only_on_planes() {
        assert_eq!(view(cube(0.05), [0.004, 0.0], 0.002, 0.0).unwrap().seal, Some(1.0));
        assert_eq!(view(cube(0.05), [0.006, 0.0], 0.002, 0.0).unwrap().seal, None);
        assert!(view(cube(0.05), [0.0, 0.0], 0.002, 0.09).unwrap().seal.unwrap() > 0.999);
        assert_eq!(view(cube(0.05), [0.0, 0.0], 0.002, 0.11).unwrap().seal, None);
    }

    #[test]
    fn ball_bends_the_lip() {
        // The cap of a ball of radius r under a lip of radius R is r - sqrt(r^2 - R^2) high.
        let r: f64 = 0.1;
        let cap = r - (r * r - 0.02 * 0.02_f64).sqrt();
        let seal = view(ball(0.2), [0.0, 0.0], 0.001, 0.0).unwrap().seal.unwrap();
        assert!((seal - (1.0 - cap / (LIP_SHARE * CUP))).abs() < 1e-9);
        assert_eq!(view(ball(0.05), [0.0, 0.0], 0.001, 0.0).unwrap().seal, None);
    }

    #[test]
    fn each_load_has_its_limit() {
        let load = |x: f64, pull: f64, across: f64, twist: f64| Wrench {
            force: Vector3::new(x, 0.0, -pull),
            torque: Vector3::new(0.0, across, twist),
        };
        let holds = |load| holds(100.0, 0.02, 0.5, &load);
        assert!(holds(load(0.0, 99.9, 0.0, 0.0)) && !holds(load(0.0, 100.0, 0.0, 0.0)));
        assert!(holds(load(24.9, 50.0, 0.0, 0.0)) && !holds(load(25.1, 50.0, 0.0, 0.0)));
        assert!(holds(load(0.0, 50.0, 0.0, 0.499)) && !holds(load(0.0, 50.0, 0.0, 0.501)));
        assert!(holds(load(0.0, 50.0, 0.999, 0.0)) && !holds(load(0.0, 50.0, 1.001, 0.0)));
    }

    #[test]
    fn leaked_cup_must_release_first() {
        use GripperCommand::{Close, Open};
        let near = |_: &SuctionCup| Some(View { gap_m: 0.001, seal: Some(1.0) });
        let heavy = Wrench { force: Vector3::new(0.0, 0.0, -800.0), torque: Vector3::zeros() };
        let mut suction = Suction::new(SuctionLaw::Vacuum, cup(), 0.01, 0.8, 0.6 * BUILD_UP_S);
        assert_eq!(suction.step(Open, near, None), None);
        for _ in 0..2 {
            let changes: Vec<_> = (0..3).map(|_| suction.step(Close, near, None)).collect();
            assert_eq!(changes, [None, None, Some(Change::Attach)]);
            assert_eq!(suction.step(Close, near, Some(heavy)), Some(Change::Detach));
            assert_eq!(suction.step(Close, near, None), None);
            assert_eq!(suction.step(Open, near, None), None);
        }
        // After a broken seal, the build-up starts again.
        assert_eq!(suction.step(Close, near, None), None);
        assert_eq!(suction.step(Close, |_| None, None), None);
        assert_eq!(suction.step(Close, near, None), None);
        assert_eq!(suction.step(Close, near, None), None);
        assert_eq!(suction.step(Close, near, None), Some(Change::Attach));
    }

    #[test]
    fn vacuum_needs_contact() {
        let mut suction = Suction::new(SuctionLaw::Vacuum, cup(), 0.02, 0.8, BUILD_UP_S);
        let before = |gap_m: f64| move |_: &SuctionCup| Some(View { gap_m, seal: Some(1.0) });
        for _ in 0..5 {
            assert_eq!(suction.step(GripperCommand::Close, before(0.005), None), None);
        }
        assert_eq!(suction.step(GripperCommand::Close, before(0.004), None), None);
        assert_eq!(suction.step(GripperCommand::Close, before(0.004), None), Some(Change::Attach));
    }

    #[test]
    fn surface_gripper_never_loses_object() {
        use GripperCommand::{Close, Open};
        let heavy = Wrench { force: Vector3::new(0.0, 0.0, -8000.0), torque: Vector3::zeros() };
        let mut surface = Suction::new(SuctionLaw::Surface, cup(), 0.01, 0.8, 0.002);
        let far = |_: &SuctionCup| Some(View { gap_m: 0.011, seal: Some(1.0) });
        let near = |_: &SuctionCup| Some(View { gap_m: 0.01, seal: None });
        assert_eq!(surface.step(Close, far, None), None);
        assert_eq!(surface.step(Close, near, None), Some(Change::Attach));
        assert_eq!(surface.step(Close, far, Some(heavy)), None);
        assert_eq!(surface.step(Open, near, None), Some(Change::Detach));
    }
}
