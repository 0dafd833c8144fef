//! Constants of contacts, the same in every engine.

/// Radius of the contact patch of a soft pad, in metres. Torsional friction is that of a disc under uniform pressure:
/// 2/3 of friction times radius.
pub const PATCH_RADIUS_M: f64 = 5e-3;

/// Rolling friction of the object, in metres. It stops a ball on the table.
pub const ROLLING_M: f64 = 5e-4;

/// Time constant of the object's contacts and of joint end stops, in seconds, at critical damping. It is twice MuJoCo's
/// default time step, the stiffest contact that MuJoCo allows. Shorter time steps keep this value and converge to the
/// same physics.
pub const TIME_CONSTANT_S: f64 = 4e-3;

/// Constraint impedance of the object's contacts as MuJoCo defines it: smallest and largest impedance, and the
/// penetration in metres over which it grows.
pub const IMPEDANCE: [f64; 3] = [0.95, 0.99, 0.001];

/// Constraint impedance of joint end stops, as [`IMPEDANCE`]; the third number is in radians or metres.
pub const LIMIT_IMPEDANCE: [f64; 3] = [0.99, 0.999, 1e-4];

/// Mass of a moving fixture, in kilograms. It is large enough that pushed objects do not slow the fixture down.
pub const DRIVEN_MASS_KG: f64 = 1e3;
