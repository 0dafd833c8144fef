//! The scripted controller of the pendulum: energy swing-up, then balancing by a PD law.
//!
//! The energy of the pole about its hinge is E = I w²/2 - m g l cos(a), with the angle a from hanging and the centre of
//! mass at l. A torque in the direction of motion adds energy. The controller adds energy until it reaches that of the
//! upright pole (Åström and Furuta 2000, Automatica 36). It always uses the nominal parameters of the pole.

use robogate_core::{Action, Command, Fault, FaultKind, Observation, Policy, Seed, TaskInstance, TaskSpec, Word};

use super::environment::from_upright;
use super::parameters::GRAVITY;
use super::{ANGLE, BALANCE, SPEED, SWING};

/// Nominal mass in kg, length in m and torque limit in N m.
const MASS: f64 = 0.5;
const LENGTH: f64 = 0.5;
const TORQUE_LIMIT: f64 = 0.5;

/// The controller balances within this angle of upright, in rad ...
const CATCH_RAD: f64 = 0.35;
/// ... and below this speed, in rad/s.
const CATCH_SPEED: f64 = 4.0;
/// Gains of the balancing controller, in N m/rad and N m s/rad.
const STIFFNESS: f64 = 4.0;
const DAMPING: f64 = 0.6;
/// Torque per joule of missing energy, in N m/J.
const PUMP: f64 = 2.0;

/// The scripted controller.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct SwingUp;

impl Policy for SwingUp {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        if task.name == "pendulum" {
            Ok(())
        } else {
            Err(format!("this controller drives the pendulum, not {}", task.name))
        }
    }

    fn reset(&mut self, _: &TaskSpec, _: &TaskInstance, _: Seed) -> Result<(), Fault> {
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        let read = |name: Word| observation.vector(name.as_str()).and_then(|values| values.first()).copied();
        let (Some(angle), Some(speed)) = (read(ANGLE), read(SPEED)) else {
            return Err(Fault::new(FaultKind::BadAction, "the observation has no angle and speed"));
        };
        let error = from_upright(angle);
        let (torque, phase) = if error.abs() < CATCH_RAD && speed.abs() < CATCH_SPEED {
            (-STIFFNESS * error - DAMPING * speed, BALANCE)
        } else {
            let inertia = MASS * LENGTH * LENGTH / 3.0;
            let weight = MASS * GRAVITY * 0.5 * LENGTH;
            let missing = weight * (1.0 + angle.cos()) - 0.5 * inertia * speed * speed;
            // At rest, either direction works.
            let along = if speed.abs() > 1e-3 { speed.signum() } else { 1.0 };
            (PUMP * missing * along, SWING)
        };
        let command = (torque / TORQUE_LIMIT).clamp(-1.0, 1.0);
        Ok(Action { command: Command::Vector(vec![command]), gripper: None, phase: Some(phase) })
    }
}
