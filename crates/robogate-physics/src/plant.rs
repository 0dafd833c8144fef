//! The plant: an engine with the drives that follow commands and the suction cup that holds an object.
//!
//! It uses no randomness and does not decide outcomes.

use nalgebra::{Isometry3, Vector3};
use robogate_core::{Fault, FaultKind};

use crate::suction::{self, Change, Suction};
use crate::thread::Threads;
use crate::unrest::Unrest;
use crate::{Engine, Gripper, GripperCommand, JointTargets, Part, Scene, Servo, SuctionCup, SuctionLaw, Touches};

/// The state that an observer gets after each time step.
#[derive(Debug)]
pub struct StepView<'a> {
    /// Elapsed fraction of the control period, above 0 and at most 1.
    pub fraction: f64,
    /// State of the gripper.
    pub gripper: GripperState,
    /// Contacts of this step.
    pub touches: &'a Touches,
    /// Pose of the object.
    pub object: Isometry3<f64>,
    /// Linear (m/s) and angular (rad/s) velocity of the object's frame.
    pub velocity: (Vector3<f64>, Vector3<f64>),
    /// Pose of the tool centre point.
    pub tcp: Isometry3<f64>,
}

/// The state of a gripper, without its contacts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GripperState {
    /// Fingers: the opening between the pads, in metres.
    Fingers(f64),
    /// A suction cup: whether it holds the object.
    Cup(bool),
}

impl<'a> StepView<'a> {
    fn of(engine: &'a impl Engine, holding: bool, fraction: f64) -> Self {
        Self {
            fraction,
            gripper: engine.opening().map_or(GripperState::Cup(holding), GripperState::Fingers),
            touches: engine.touches(),
            object: engine.object(),
            velocity: engine.object_velocity(),
            tcp: engine.tcp(),
        }
    }
}

/// An engine, driven by joint commands at a control rate.
pub struct Plant<E> {
    /// The engine.
    pub engine: E,
    control_period_s: f64,
    grip_force_n: f64,
    suction_law: SuctionLaw,
    steps_per_period: usize,
    drives: Option<Drives>,
}

/// State of the drives outside the engine.
struct Drives {
    servo: Servo,
    targets: JointTargets,
    /// The suction cup, if the gripper has one.
    suction: Option<Suction>,
    /// Parts of each free body, for the distance measurement of the cup.
    parts: Vec<Vec<Part>>,
    /// Friction coefficient of each free body.
    frictions: Vec<f64>,
    /// The free body that the gripper acts on.
    selected: usize,
    /// Grip force of this scene's unit, in newtons.
    grip_force_n: f64,
    threads: Threads,
    unrest: Unrest,
}

impl<E: Engine> Plant<E> {
    /// A plant on this engine with this control period in seconds. `grip_force_n` replaces the robot's own setting.
    ///
    /// # Errors
    /// If the control period is not an integer multiple of the engine's time step, or the gripper cannot hold the
    /// grip force.
    pub fn new(engine: E, control_period_s: f64, grip_force_n: Option<f64>) -> Result<Self, String> {
        let steps = control_period_s / engine.time_step();
        if !(1.0..=1e4).contains(&steps) || (steps - steps.round()).abs() > 1e-6 {
            let step = engine.time_step();
            return Err(format!(
                "the control period of {control_period_s} s is not an integer multiple of the time step of {step} s"
            ));
        }
        let grip_force_n = grip_force(&engine.robot().settings.gripper, grip_force_n)?;
        let steps_per_period = steps.round() as usize;
        let suction_law = SuctionLaw::Vacuum;
        Ok(Self { engine, control_period_s, grip_force_n, suction_law, steps_per_period, drives: None })
    }

    /// The same plant with this law for its suction cup.
    #[must_use]
    pub fn with_suction(mut self, law: SuctionLaw) -> Self {
        self.suction_law = law;
        self
    }

    /// Replaces grip force and law of the suction cup from the next [`Plant::load`] on. Without a grip force it is the
    /// robot's own.
    ///
    /// # Errors
    /// If the gripper cannot hold the grip force.
    pub fn set_gripper(&mut self, grip_force_n: Option<f64>, law: SuctionLaw) -> Result<(), String> {
        self.grip_force_n = grip_force(&self.engine.robot().settings.gripper, grip_force_n)?;
        self.suction_law = law;
        Ok(())
    }

    /// The free body that the gripper acts on.
    pub fn selected(&self) -> usize {
        self.drives.as_ref().map_or(0, |drives| drives.selected)
    }

    /// Grip force in newtons: of each pad, or of the cup along its axis.
    pub fn grip_force_n(&self) -> f64 {
        self.grip_force_n
    }

    /// The grip force that acts in this scene, in newtons: that of [`Self::grip_force_n`] before [`Plant::load`].
    pub fn acting_force_n(&self) -> f64 {
        let acting = |drives: &Drives| drives.suction.as_ref().map_or(drives.grip_force_n, Suction::force_n);
        self.drives.as_ref().map_or(self.grip_force_n, acting)
    }

    /// Number of engine time steps in a control period.
    pub fn steps_per_period(&self) -> usize {
        self.steps_per_period
    }

    /// The distance at which the suction cup grips, in metres. `None` without a cup or before [`Plant::load`].
    pub fn grip_threshold_m(&self) -> Option<f64> {
        self.drives.as_ref()?.suction.as_ref().map(Suction::threshold_m)
    }

    /// Sets the scene up: the arm at home and at rest, the gripper open. A suction cup grips within `grip_threshold_m`
    /// of the object; fingers ignore the threshold.
    pub fn load(&mut self, scene: &Scene, grip_threshold_m: f64) -> Result<(), Fault> {
        self.drives = None;
        let settings = &self.engine.robot().settings;
        let gripper = &settings.gripper;
        let home = settings.arm.home_rad.clone();
        let finger = gripper.jaw().map_or(0.0, |jaw| 0.5 * jaw.opening_m);
        let step = self.engine.time_step();
        let force_scale = scene.gripper.force_scale;
        let suction = gripper.cup().map(|cup| {
            let cup = SuctionCup { vacuum_pa: cup.vacuum_pa * force_scale, ..cup.clone() };
            Suction::new(self.suction_law, cup, grip_threshold_m, scene.friction_of(&scene.object), step)
        });
        let grip_force_n = unit_grip_force(gripper, self.grip_force_n, force_scale)?;
        self.engine.load(scene, &home)?;
        self.drives = Some(Drives {
            servo: Servo::at_rest(&home, self.control_period_s),
            targets: JointTargets { velocities: vec![0.0; home.len()], positions: home, finger },
            suction,
            // A cup does not hold a body on a joint.
            parts: scene
                .free_bodies()
                .map(|(object, _)| if object.joint.is_some() { Vec::new() } else { object.parts.clone() })
                .collect(),
            frictions: scene.free_bodies().map(|(object, _)| scene.friction_of(object)).collect(),
            selected: 0,
            grip_force_n,
            threads: Threads::of(scene),
            unrest: Unrest::default(),
        });
        Ok(())
    }

    /// Selects the free body that the gripper acts on, as [`Engine::select`]. A body that the cup holds stays selected.
    pub fn select(&mut self, body: usize) {
        if let Some(drives) = &mut self.drives
            && body < drives.parts.len()
            && !drives.suction.as_ref().is_some_and(Suction::holding)
        {
            drives.selected = body;
            if let Some(suction) = &mut drives.suction {
                suction.set_friction(drives.frictions[body]);
            }
            self.engine.select(body);
        }
    }

    /// Runs one control period towards these joint positions (rad). `observe` is called after each time step with the
    /// engine and the state.
    ///
    /// # Errors
    /// If the engine diverges, or if the fingers have not come to rest for two seconds under one command, which no policy can cause.
    pub fn run(
        &mut self,
        command: &[f64],
        gripper: GripperCommand,
        observe: &mut dyn FnMut(&E, &StepView<'_>),
    ) -> Result<(), Fault> {
        let Some(mut drives) = self.drives.take() else { return Ok(()) };
        let settings = &self.engine.robot().settings;
        drives.servo.command(command, &settings.arm, self.engine.chain());
        let jaw = settings.gripper.jaw().map(|jaw| {
            // The closing target is beyond the closed position: the object or the other finger stops the fingers.
            let goal = match gripper {
                GripperCommand::Open => 0.5 * jaw.opening_m,
                GripperCommand::Close => -0.5 * jaw.opening_m,
            };
            // The fingers press with the grip force: their target is ahead of them by at most the distance over which
            // the servo's spring builds up that force.
            (goal, drives.grip_force_n / jaw.stiffness_n_m, jaw.finger_speed_m_s * self.engine.time_step())
        });
        let mut restless = None;
        for k in 1..=self.steps_per_period {
            let fraction = k as f64 / self.steps_per_period as f64;
            let targets = &mut drives.targets;
            drives.servo.targets(fraction, &mut targets.positions, &mut targets.velocities);
            if let (Some((goal, lead, step)), Some(opening)) = (jaw, self.engine.drive_opening()) {
                let finger = 0.5 * opening;
                let next = targets.finger + (goal - targets.finger).clamp(-step, step);
                targets.finger = next.clamp(finger - lead, finger + lead);
            }
            self.engine.advance(targets);
            if let Some(opening) = self.engine.drive_opening() {
                restless = drives.unrest.step(gripper, opening, self.engine.time_step()).or(restless);
            }
            if let Some(suction) = &mut drives.suction {
                let (engine, parts) = (&self.engine, &drives.parts[drives.selected]);
                let view = |cup: &_| suction::look(cup, &engine.tcp(), parts, &engine.object());
                match suction.step(gripper, view, engine.cup_load()) {
                    Some(Change::Attach) => self.engine.attach(),
                    Some(Change::Detach) => self.engine.detach(),
                    None => {}
                }
            }
            drives.threads.step(&mut self.engine);
            let holding = drives.suction.as_ref().is_some_and(Suction::holding);
            observe(&self.engine, &StepView::of(&self.engine, holding, fraction));
        }
        self.drives = Some(drives);
        restless.map_or(Ok(()), |frequency| Err(unrest(frequency)))?;
        self.engine.health()
    }

    /// The true state of arm and gripper.
    pub fn arm_state(&self) -> ArmState {
        ArmState::of(&self.engine)
    }

    /// A hash of the engine's full state.
    pub fn state_hash(&self) -> u64 {
        state_hash(&self.engine)
    }
}

/// A hash of an engine's full state.
pub fn state_hash(engine: &impl Engine) -> u64 {
    // FNV-1a over 64-bit words.
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    engine.state_bits(&mut |bits| hash = (hash ^ bits).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(5));
    hash
}

/// The fault of fingers that oscillate at this frequency, in hertz.
pub(crate) fn unrest(frequency: f64) -> Fault {
    Fault::new(
        FaultKind::Diverged,
        format!(
            "the fingers oscillate at {frequency:.0} Hz while the command to the gripper does not change: the model of the hand is unstable. Check it with `robogate robots check`"
        ),
    )
}

/// The grip force in newtons of a unit whose force is `scale` times `grip_force_n`.
///
/// # Errors
/// If it is above the gripper's limit.
pub(crate) fn unit_grip_force(gripper: &Gripper, grip_force_n: f64, scale: f64) -> Result<f64, Fault> {
    let force = grip_force_n * scale;
    match gripper.jaw() {
        Some(jaw) if force > jaw.force_limit_n => Err(Fault::new(
            FaultKind::Setup,
            format!("the grip force of {force:.1} N is above the gripper's limit of {:.1} N", jaw.force_limit_n),
        )),
        _ => Ok(force),
    }
}

/// True state of an arm and its gripper, without encoder errors.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmState {
    /// Joint positions in radians.
    pub joint_positions: Vec<f64>,
    /// Joint velocities in rad/s.
    pub joint_velocities: Vec<f64>,
    /// Opening between the pads, in metres; `None` without fingers.
    pub opening_m: Option<f64>,
}

impl ArmState {
    /// The state in an engine.
    pub fn of(engine: &impl Engine) -> Self {
        Self {
            joint_positions: engine.joint_positions(),
            joint_velocities: engine.joint_velocities(),
            opening_m: engine.opening(),
        }
    }
}

/// The grip force in newtons: the gripper's setting, or `wanted` if the gripper can apply it.
///
/// # Errors
/// If `wanted` is outside the gripper's limit, or the gripper has no fingers.
pub fn grip_force(gripper: &Gripper, wanted: Option<f64>) -> Result<f64, String> {
    match gripper {
        Gripper::ParallelJaw(jaw) => {
            let force = wanted.unwrap_or(jaw.force_n);
            if !(force > 0.0 && force <= jaw.force_limit_n) {
                let limit = jaw.force_limit_n;
                return Err(format!(
                    "the grip force of {force} N is out of range. Expected above 0 and at most {limit} N, the gripper's limit"
                ));
            }
            Ok(force)
        }
        Gripper::Suction(cup) => match wanted {
            Some(force) => {
                Err(format!("a grip force of {force} N needs fingers, but this gripper is {}", gripper.description()))
            }
            None => Ok(cup.force_n()),
        },
    }
}
