//! Records an expert while it controls the simulator.

use nalgebra::{Isometry3, Translation3};
use robogate_core::{
    Action, Assignment, Command, Fault, FaultKind, Image, Observation, Policy, Pose, Seed, TaskInstance, TaskSpec,
    vectors,
};
use robogate_physics::{Chain, GripperCommand};

use crate::Push;

/// One frame: the observation and action of the expert in one control period.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Simulated time, in seconds.
    pub time_s: f64,
    /// Measured joint positions, in radians.
    pub joints: Vec<f64>,
    /// The tool's pose at the measured joint positions.
    pub tool: Pose,
    /// Opening between the fingers, in metres.
    pub opening_m: Option<f64>,
    /// The camera images as PNG.
    pub pictures: Vec<Picture>,
    /// Joint positions that the expert commanded, in radians.
    pub wanted: Vec<f64>,
    /// The tool's pose at the commanded joint positions.
    pub wanted_tool: Pose,
    /// The tool's motion from the previously commanded pose: translation (m) along and rotation vector (rad) about the
    /// base's axes.
    pub wanted_delta: [f64; 6],
    /// The gripper command of the expert.
    pub gripper: GripperCommand,
    /// Information about the object that the expert has and a learner does not: the initial position of its centre and
    /// its edge length, in metres.
    pub told: [f64; 4],
}

/// A compressed camera image.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// The camera's name.
    pub camera: String,
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// The PNG file.
    pub png: Vec<u8>,
    /// For red, green and blue (0 to 1): minimum, maximum, sum and sum of squares over the pixels.
    pub moments: [[f64; 4]; 3],
}

/// One recorded episode of the expert.
#[derive(Debug, Clone, PartialEq)]
pub struct Demonstration {
    /// The task in natural language.
    pub task: String,
    /// The frames, one per control period.
    pub frames: Vec<Frame>,
}

/// Reads the object that the expert picks first from the details of an episode: position of its centre and edge, in
/// metres.
pub type Told = Box<dyn Fn(&TaskInstance) -> Result<[f64; 4], Fault>>;

/// A policy that follows the expert with random pushes and records it.
///
/// The expert must return joint positions. It receives the observations of an undisturbed arm, so it stays on its path.
pub struct Recorder {
    expert: Box<dyn Policy>,
    told_of: Told,
    chain: Chain,
    rest: Vec<f64>,
    sigma_m: f64,
    push: Push,
    period_s: f64,
    told: [f64; 4],
    /// The last two commands of the expert, each with the command that was sent. The older one comes first.
    sent: Vec<(Vec<f64>, Vec<f64>)>,
    demonstration: Demonstration,
}

impl Recorder {
    /// Records `expert` on the arm `chain` with the rest posture `rest` (rad), and with pushes of `sigma_m` ([`Push`]).
    pub fn new(expert: Box<dyn Policy>, told_of: Told, chain: Chain, rest: Vec<f64>, sigma_m: f64) -> Self {
        Self {
            expert,
            told_of,
            chain,
            rest,
            sigma_m,
            push: Push::new(0.0, Seed::campaign(0)),
            period_s: 0.0,
            told: [0.0; 4],
            sent: Vec::new(),
            demonstration: Demonstration { task: String::new(), frames: Vec::new() },
        }
    }

    /// Takes the frames recorded since the last reset.
    pub fn take(&mut self) -> Demonstration {
        let empty = Demonstration { task: self.demonstration.task.clone(), frames: Vec::new() };
        std::mem::replace(&mut self.demonstration, empty)
    }

    /// The observation without the pushes: the arm is half way between its last two commands.
    fn undisturbed(&self, observation: &Observation) -> Observation {
        let mut seen = Observation { images: Vec::new(), ..observation.clone() };
        if !self.sent.is_empty() {
            let share = 1.0 / self.sent.len() as f64;
            let mut joints = observation.joint_positions().to_vec();
            for (expert, made) in &self.sent {
                for ((q, expert), made) in joints.iter_mut().zip(expert).zip(made) {
                    *q += share * (expert - made);
                }
            }
            let tool = pose(&self.chain.tcp_at(&joints)).to_array().to_vec();
            for (name, values) in &mut seen.vectors {
                match *name {
                    vectors::JOINT_POSITIONS => values.clone_from(&joints),
                    vectors::TOOL_POSE => values.clone_from(&tool),
                    _ => {}
                }
            }
        }
        seen
    }
}

impl Policy for Recorder {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        self.expert.check(task)
    }

    fn note_applied(&mut self, applied: &Assignment) {
        self.expert.note_applied(applied);
    }

    fn reset(&mut self, task: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault> {
        self.push = Push::new(self.sigma_m, seed);
        self.period_s = task.control_period_s;
        self.told = (self.told_of)(instance)?;
        self.sent.clear();
        self.demonstration = Demonstration { task: instance.instruction.clone(), frames: Vec::new() };
        self.expert.reset(task, instance, seed)
    }

    fn wants_images(&self) -> bool {
        true
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        let action = self.expert.act(&self.undisturbed(observation))?;
        let Command::JointPosition(wanted) = &action.command else {
            return Err(Fault::new(FaultKind::BadAction, "demonstrations need an expert that returns joint positions"));
        };
        let goal = self.chain.tcp_at(wanted);
        let off = self.push.next(self.period_s, goal.translation.z);
        let made = if off.norm() > 0.0 {
            let moved = Isometry3::from_parts(Translation3::from(goal.translation.vector + off), goal.rotation);
            self.chain.inverse(&moved, wanted, &self.rest).unwrap_or_else(|_| wanted.clone())
        } else {
            wanted.clone()
        };
        let before = match self.sent.last() {
            Some((expert, _)) => self.chain.tcp_at(expert),
            None => self.chain.tcp_at(observation.joint_positions()),
        };
        let translation = goal.translation.vector - before.translation.vector;
        let rotation = (goal.rotation * before.rotation.inverse()).scaled_axis();
        self.demonstration.frames.push(Frame {
            time_s: observation.time_s,
            joints: observation.joint_positions().to_vec(),
            tool: observation.tool_pose().unwrap_or(Pose::IDENTITY),
            opening_m: observation.gripper_opening_m(),
            pictures: observation.images.iter().map(Picture::of).collect::<Result<_, _>>()?,
            wanted: wanted.clone(),
            wanted_tool: pose(&goal),
            wanted_delta: [translation.x, translation.y, translation.z, rotation.x, rotation.y, rotation.z],
            gripper: GripperCommand::of(&action),
            told: self.told,
        });
        if self.sent.len() == 2 {
            self.sent.remove(0);
        }
        self.sent.push((wanted.clone(), made.clone()));
        Ok(Action { command: Command::JointPosition(made), ..action })
    }
}

impl Picture {
    fn of(image: &Image) -> Result<Self, Fault> {
        let broken = |why: String| Fault::new(FaultKind::Setup, format!("camera {}: {why}", image.camera));
        let side = |n: usize| u32::try_from(n).map_err(|e| broken(e.to_string()));
        let mut png = Vec::new();
        let mut encoder = png::Encoder::new(&mut png, side(image.width)?, side(image.height)?);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Fast);
        let mut writer = encoder.write_header().map_err(|e| broken(e.to_string()))?;
        writer.write_image_data(&image.rgb).map_err(|e| broken(e.to_string()))?;
        writer.finish().map_err(|e| broken(e.to_string()))?;
        let mut moments = [[1.0, 0.0, 0.0, 0.0]; 3];
        for pixel in image.rgb.as_chunks::<3>().0 {
            for ([least, greatest, sum, squares], byte) in moments.iter_mut().zip(pixel) {
                let x = f64::from(*byte) / 255.0;
                (*least, *greatest) = (x.min(*least), x.max(*greatest));
                (*sum, *squares) = (*sum + x, *squares + x * x);
            }
        }
        let Image { camera, width, height, .. } = image;
        Ok(Self { camera: camera.clone(), width: *width, height: *height, png, moments })
    }
}

fn pose(at: &Isometry3<f64>) -> Pose {
    let q = at.rotation.quaternion();
    Pose { position: at.translation.vector.into(), orientation: [q.w, q.i, q.j, q.k] }
}
