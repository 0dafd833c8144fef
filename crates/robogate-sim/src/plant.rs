//! What moves: an engine with the drives that follow the commands and the cup that holds. It draws nothing at
//! random and judges nothing.

use nalgebra::{Isometry3, Vector3};
use robogate_core::{Fault, GripperCommand};

use crate::cell::{CONTROL_PERIOD_S, ResolvedCell};
use crate::referee::Hand;
use crate::servo::Servo;
use crate::suction::{self, Change, Suction};
use crate::{Engine, Gripper, JointTargets, Part, SuctionLaw, Touches};

/// What shows of one time step.
#[derive(Debug)]
pub(crate) struct Sight<'a> {
    /// The share of the control period that is over.
    pub(crate) share: f64,
    /// What shows of the gripper's hold.
    pub(crate) hand: Hand,
    /// Who touched whom.
    pub(crate) touches: &'a Touches,
    /// The object's pose.
    pub(crate) object: Isometry3<f64>,
    /// The object's velocity and angular velocity.
    pub(crate) velocity: (Vector3<f64>, Vector3<f64>),
    /// The tool centre point's pose.
    pub(crate) tcp: Isometry3<f64>,
}

impl<'a> Sight<'a> {
    fn of(engine: &'a impl Engine, holding: bool, share: f64) -> Self {
        Self {
            share,
            hand: engine.opening().map_or(Hand::Cup(holding), Hand::Fingers),
            touches: engine.touches(),
            object: engine.object(),
            velocity: engine.object_velocity(),
            tcp: engine.tcp(),
        }
    }
}

/// An engine, driven.
pub(crate) struct Plant<E> {
    pub(crate) engine: E,
    pub(crate) grip_force_n: f64,
    pub(crate) suction_law: SuctionLaw,
    pub(crate) steps_per_period: usize,
    drives: Option<Drives>,
}

/// The drives' state beyond the engine's.
struct Drives {
    servo: Servo,
    targets: JointTargets,
    /// The cup at work, of a gripper that has one.
    suction: Option<Suction>,
    /// The object's parts, which the cup looks at.
    parts: Vec<Part>,
}

impl<E: Engine> Plant<E> {
    /// A plant on this engine; `grip_force_n` replaces the robot's own setting.
    pub(crate) fn new(engine: E, grip_force_n: Option<f64>) -> Result<Self, String> {
        let steps = CONTROL_PERIOD_S / engine.time_step();
        if !(1.0..=1e4).contains(&steps) || (steps - steps.round()).abs() > 1e-6 {
            let step = engine.time_step();
            return Err(format!("the control period of {CONTROL_PERIOD_S} s is no whole number of steps of {step} s"));
        }
        let grip_force_n = grip_force(&engine.robot().settings.gripper, grip_force_n)?;
        let steps_per_period = steps.round() as usize;
        Ok(Self { engine, grip_force_n, suction_law: SuctionLaw::Vacuum, steps_per_period, drives: None })
    }

    /// Sets the cell up: the arm at home and at rest, the gripper open.
    pub(crate) fn load(&mut self, cell: &ResolvedCell) -> Result<(), Fault> {
        self.drives = None;
        let settings = &self.engine.robot().settings;
        let (parameters, gripper) = (&cell.parameters, &settings.gripper);
        let home = settings.arm.home_rad.clone();
        let finger = gripper.jaw().map_or(0.0, |jaw| 0.5 * jaw.opening_m);
        let (threshold, step) = (parameters.grip_threshold_m, self.engine.time_step());
        let suction =
            gripper.cup().map(|cup| Suction::new(self.suction_law, cup.clone(), threshold, parameters.friction, step));
        self.engine.load(&cell.scene, &home)?;
        self.drives = Some(Drives {
            servo: Servo::at_rest(&home, CONTROL_PERIOD_S),
            targets: JointTargets { velocities: vec![0.0; home.len()], positions: home, finger },
            suction,
            parts: cell.scene.object.parts.clone(),
        });
        Ok(())
    }

    /// Runs one control period towards these joint positions (rad) and shows each of its time steps.
    pub(crate) fn run(
        &mut self,
        command: &[f64],
        told: GripperCommand,
        show: &mut dyn FnMut(&Sight<'_>),
    ) -> Result<(), Fault> {
        let Some(mut drives) = self.drives.take() else { return Ok(()) };
        let settings = &self.engine.robot().settings;
        drives.servo.command(command, &settings.arm, self.engine.chain());
        let jaw = settings.gripper.jaw().map(|jaw| {
            // Closing drives past the closed position: what stops the fingers is the object or each other.
            let goal = match told {
                GripperCommand::Open => 0.5 * jaw.opening_m,
                GripperCommand::Close => -0.5 * jaw.opening_m,
            };
            // The fingers press with the grip force: their target runs ahead of them by no more than the way on
            // which the servo's spring builds it up.
            (goal, self.grip_force_n / jaw.stiffness_n_m, jaw.finger_speed_m_s * self.engine.time_step())
        });
        for k in 1..=self.steps_per_period {
            let share = k as f64 / self.steps_per_period as f64;
            let targets = &mut drives.targets;
            drives.servo.targets(share, &mut targets.positions, &mut targets.velocities);
            if let (Some((goal, lead, step)), Some(opening)) = (jaw, self.engine.opening()) {
                let finger = 0.5 * opening;
                let next = targets.finger + (goal - targets.finger).clamp(-step, step);
                targets.finger = next.clamp(finger - lead, finger + lead);
            }
            self.engine.advance(targets);
            if let Some(suction) = &mut drives.suction {
                let (engine, parts) = (&self.engine, &drives.parts);
                let view = |cup: &_| suction::look(cup, &engine.tcp(), parts, &engine.object());
                match suction.step(told, view, engine.cup_load()) {
                    Some(Change::Join) => self.engine.join(),
                    Some(Change::Part) => self.engine.part(),
                    None => {}
                }
            }
            show(&Sight::of(&self.engine, drives.suction.as_ref().is_some_and(Suction::holding), share));
        }
        self.drives = Some(drives);
        self.engine.health()
    }

    /// The arm as it is now.
    pub(crate) fn arm_state(&self) -> ArmState {
        ArmState {
            joint_positions: self.engine.joint_positions(),
            joint_velocities: self.engine.joint_velocities(),
            opening_m: self.engine.opening(),
        }
    }

    /// A hash of the engine's full state.
    pub(crate) fn state_hash(&self) -> u64 {
        // FNV-1a over 64-bit words.
        let mut hash = 0xcbf2_9ce4_8422_2325_u64;
        self.engine.state_bits(&mut |bits| hash = (hash ^ bits).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(5));
        hash
    }
}

/// An arm and its gripper as they are, whatever the encoders read.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ArmState {
    /// In radians.
    pub(crate) joint_positions: Vec<f64>,
    /// In rad/s.
    pub(crate) joint_velocities: Vec<f64>,
    /// Between the pads, in metres.
    pub(crate) opening_m: Option<f64>,
}

/// The force of a grip (N): what the gripper is set to, or `wanted` where it can hold that.
pub(crate) fn grip_force(gripper: &Gripper, wanted: Option<f64>) -> Result<f64, String> {
    match gripper {
        Gripper::ParallelJaw(jaw) => {
            let force = wanted.unwrap_or(jaw.force_n);
            if !(force > 0.0 && force <= jaw.force_limit_n) {
                let limit = jaw.force_limit_n;
                return Err(format!("a grip force of {force} N is outside 0 to {limit} N, the gripper's limit"));
            }
            Ok(force)
        }
        Gripper::Suction(cup) => match wanted {
            Some(force) => {
                Err(format!("a grip force of {force} N is for fingers: this gripper is {}", gripper.words()))
            }
            None => Ok(cup.force_n()),
        },
    }
}
