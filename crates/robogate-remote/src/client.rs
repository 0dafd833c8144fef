//! An episode in a server, held to the protocol answer by answer.

use robogate_core::{
    Action, ArmCommand, Assignment, Ending, Fault, FaultKind, GripperCommand, Image, Observation, Scenario, Seed,
    Start, Step,
};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::link::{AskError, Link};
use super::message::{
    ActionSpace, Begun, Hello, Nothing, Period, Render, Rendered, Reset, Stepped, Steps, assignment, check_pose,
    parameters,
};

/// What a server that does not judge is told, and how what it reports is judged.
pub trait World {
    /// The cell that it is told.
    type Cell: Serialize;
    /// What it reads back from its engine.
    type Readback: DeserializeOwned;
    /// What it sees in a time step.
    type Sight: DeserializeOwned;

    /// Whether a server can run this world.
    fn accepts(&self, hello: &Hello) -> Result<(), String>;

    /// Whether a parameter acts on this side alone, so that the server need not know it.
    fn acts_here(&self, parameter: &str) -> bool;

    /// The cell of a scenario.
    fn brief(&mut self, scenario: &Scenario) -> Result<Self::Cell, Fault>;

    /// Begins the episode with what became of the cell. `observation` is of the arm as it is.
    fn start(&mut self, held: Self::Readback, sight: &Self::Sight, observation: &Observation) -> Result<Start, Fault>;

    /// The joint positions (rad) that an action asks for.
    fn command(&mut self, action: &Action) -> Result<Vec<f64>, Fault>;

    /// Judges a control period.
    fn finish(
        &mut self,
        sights: &[Self::Sight],
        observation: &Observation,
        clearance_m: Option<f64>,
        state_hash: u64,
    ) -> Result<Step, Fault>;

    /// What this side's cameras show of what was last reported.
    fn render(&mut self) -> Result<Vec<Image>, Fault>;
}

/// A world for servers that judge: there is none.
#[derive(Debug, Clone, Copy)]
pub enum NoWorld {}

impl World for NoWorld {
    type Cell = Nothing;
    type Readback = Nothing;
    type Sight = Nothing;

    fn accepts(&self, _: &Hello) -> Result<(), String> {
        match *self {}
    }

    fn acts_here(&self, _: &str) -> bool {
        match *self {}
    }

    fn brief(&mut self, _: &Scenario) -> Result<Nothing, Fault> {
        match *self {}
    }

    fn start(&mut self, _: Nothing, _: &Nothing, _: &Observation) -> Result<Start, Fault> {
        match *self {}
    }

    fn command(&mut self, _: &Action) -> Result<Vec<f64>, Fault> {
        match *self {}
    }

    fn finish(&mut self, _: &[Nothing], _: &Observation, _: Option<f64>, _: u64) -> Result<Step, Fault> {
        match *self {}
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        match *self {}
    }
}

fn lie(why: String) -> AskError {
    AskError::Lie(why)
}

/// A scenario's parameters and seed, as a reset asks for them.
fn asked<C>(
    hello: &Hello,
    scenario: &Scenario,
    here: impl Fn(&str) -> bool,
    cell: Option<C>,
) -> Result<Reset<C>, AskError> {
    let there: Assignment = scenario
        .requested
        .iter()
        .filter(|(name, _)| !here(name))
        .map(|(name, value)| (name.into(), value.clone()))
        .collect();
    if let Some((name, _)) = there.iter().find(|(name, _)| !hello.parameters.iter().any(|p| p == name)) {
        let detail = format!("this simulator cannot apply the parameter {name}");
        return Err(AskError::Here(Fault::new(FaultKind::NotApplied, detail)));
    }
    let seed = scenario.seed.campaign_number();
    if scenario.seed != Seed::campaign(seed).episode(scenario.index) {
        let detail = "the scenario's seed is not that of its index";
        return Err(AskError::Here(Fault::new(FaultKind::Setup, detail)));
    }
    Ok(Reset { index: scenario.index, seed, parameters: parameters(&there), cell })
}

impl Link {
    /// Begins an episode; with a world where the server does not judge.
    pub fn reset<W: World>(&mut self, scenario: &Scenario, world: Option<&mut W>) -> Result<Start, AskError> {
        let joints = self.hello().joints.len();
        let Some(world) = world else {
            let request = asked::<Nothing>(self.hello(), scenario, |_| false, None)?;
            let begun: Begun<Nothing, Nothing> = self.begin(request)?;
            return judged(self.hello(), begun, &scenario.requested);
        };
        let cell = world.brief(scenario).map_err(AskError::Here)?;
        let request = asked(self.hello(), scenario, |name| world.acts_here(name), Some(cell))?;
        let begun: Begun<W::Readback, W::Sight> = self.begin(request)?;
        let observation = begun.observation.observation(joints, 0.0).map_err(lie)?;
        let (Some(held), Some(sight)) = (begun.readback, begun.sight) else {
            return Err(lie("it has no readback and sight of the start".to_owned()));
        };
        world.start(held, &sight, &observation).map_err(AskError::Here)
    }

    /// Runs one control period; with the same world.
    pub fn step<W: World>(&mut self, action: &Action, world: Option<&mut W>) -> Result<Step, AskError> {
        let Some(world) = world else {
            let (action_space, row) = row(self.hello(), action).map_err(AskError::Here)?;
            let (period, observation) = self.period::<Nothing>(action_space, row)?;
            return judged_step(period, observation);
        };
        let mut row = world.command(action).map_err(AskError::Here)?;
        row.push(grip(action.gripper));
        let due = self.hello().steps_per_period();
        let (period, observation) = self.period::<W::Sight>(ActionSpace::JointPosition, row)?;
        let sights = period.sights.unwrap_or_default();
        if sights.len() != due {
            return Err(lie(format!("{} sights of a period of {due} time steps", sights.len())));
        }
        world.finish(&sights, &observation, period.clearance_m, period.state_hash).map_err(AskError::Here)
    }

    /// What the cameras show now.
    pub fn render(&mut self) -> Result<Vec<Image>, AskError> {
        if self.hello().cameras.is_empty() {
            return Err(AskError::Here(Fault::new(FaultKind::Setup, "this simulator has no cameras")));
        }
        let (answer, frames): (Rendered, _) = self.ask_frames("render", Render { cameras: None })?;
        if answer.tick != self.tick {
            return Err(lie(format!("pictures of tick {}, not {}", answer.tick, self.tick)));
        }
        let cameras = &self.hello().cameras;
        if answer.images.len() != cameras.len() || frames.len() != cameras.len() {
            let (images, sent) = (answer.images.len(), frames.len());
            return Err(lie(format!("{images} pictures in {sent} frames, from {} cameras", cameras.len())));
        }
        let mut frames: Vec<Option<Vec<u8>>> = frames.into_iter().map(Some).collect();
        let mut images = Vec::with_capacity(cameras.len());
        for (camera, picture) in cameras.iter().zip(answer.images) {
            let rgb = picture.frame.checked_sub(1).and_then(|i| frames.get_mut(i)).and_then(Option::take);
            let rgb = rgb.ok_or_else(|| lie(format!("the picture of {} is in no frame of its own", camera.name)))?;
            let same = (&picture.camera, picture.width, picture.height) == (&camera.name, camera.width, camera.height);
            if !same || rgb.len() != 3 * camera.width * camera.height {
                let (name, width, height) = (&camera.name, camera.width, camera.height);
                return Err(lie(format!("the picture of {name} is not {width} x {height} pixels of 3 bytes")));
            }
            images.push(Image { camera: picture.camera, width: picture.width, height: picture.height, rgb });
        }
        Ok(images)
    }

    /// One control period of the answer to a step.
    fn period<S: DeserializeOwned>(
        &mut self,
        action_space: ActionSpace,
        row: Vec<f64>,
    ) -> Result<(Period<S>, Observation), AskError> {
        let request = Steps { tick: self.tick, action_space, actions: vec![row] };
        let stepped: Stepped<S> = self.ask("step", request)?;
        let Ok([period]) = <[Period<S>; 1]>::try_from(stepped.steps) else {
            return Err(lie("it has not one step for one action".to_owned()));
        };
        self.tick += 1;
        let time = self.tick as f64 * self.hello().control_period_s;
        let observation = period.observation.clone().observation(self.hello().joints.len(), time).map_err(lie)?;
        Ok((period, observation))
    }
}

fn grip(gripper: GripperCommand) -> f64 {
    match gripper {
        GripperCommand::Open => -1.0,
        GripperCommand::Close => 1.0,
    }
}

/// An action as a judging server takes it.
fn row(hello: &Hello, action: &Action) -> Result<(ActionSpace, Vec<f64>), Fault> {
    let bad = |why: String| Fault::new(FaultKind::BadAction, why);
    let (space, mut row) = match &action.arm {
        ArmCommand::JointPositions(joints) => {
            if joints.len() != hello.joints.len() || joints.iter().any(|q| !q.is_finite()) {
                return Err(bad(format!("{} finite joint positions were due, got {joints:?}", hello.joints.len())));
            }
            (ActionSpace::JointPosition, joints.clone())
        }
        ArmCommand::ToolDelta { translation_m, rotation_rad } => {
            let scale = hello.tool_delta.ok_or_else(|| bad("this simulator takes no ways of the tool".to_owned()))?;
            let way = translation_m.map(|x| x / scale.translation_m);
            let turn = rotation_rad.map(|x| x / scale.rotation_rad);
            let row: Vec<f64> = way.into_iter().chain(turn).collect();
            // The server would cut it, and the policy's action would not be what was run.
            if row.iter().any(|x| !x.is_finite() || x.abs() > 1.0 + 1e-9) {
                return Err(bad(format!(
                    "a way of {translation_m:?} m and a turn of {rotation_rad:?} rad; this simulator takes up to {} m \
                     and {} rad a period",
                    scale.translation_m, scale.rotation_rad
                )));
            }
            (ActionSpace::ToolDelta, row)
        }
    };
    if !hello.action_spaces.contains(&space) {
        return Err(bad("this simulator takes no joint positions".to_owned()));
    }
    row.push(grip(action.gripper));
    Ok((space, row))
}

fn judged(hello: &Hello, begun: Begun<Nothing, Nothing>, requested: &Assignment) -> Result<Start, AskError> {
    let observation = begun.observation.observation(hello.joints.len(), 0.0).map_err(lie)?;
    let (Some(task), Some(applied)) = (begun.task, begun.applied) else {
        return Err(lie("it has no task and applied parameters".to_owned()));
    };
    if (task.control_period_s, task.time_limit_s) != (hello.control_period_s, hello.time_limit_s) {
        return Err(lie("the task's control period or time limit is another than in hello".to_owned()));
    }
    check_pose("object_pose", &task.object_pose).map_err(lie)?;
    check_pose("target_pose", &task.target_pose).map_err(lie)?;
    Ok(Start { task, observation, applied: assignment(&applied, requested) })
}

fn judged_step(period: Period<Nothing>, observation: Observation) -> Result<Step, AskError> {
    let Some(measures) = period.measures else { return Err(lie("it has no measures".to_owned())) };
    let ending = period.ending.map(Ending::from);
    if let Some(ending) = &ending
        && !(0.0..=observation.time_s + 1e-6).contains(&ending.time_s)
    {
        return Err(lie(format!("an ending at {} s, seen at {} s", ending.time_s, observation.time_s)));
    }
    Ok(Step { observation, measures, ending, events: period.events.unwrap_or_default(), state_hash: period.state_hash })
}
