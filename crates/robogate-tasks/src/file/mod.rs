//! Tasks for an arm from files: data that describes scene, parameters, conditions and an expert.
//!
//! A folder with `task.toml` is a task. [`FileTask`] reads the file once and compiles its conditions; then it is an
//! [`crate::ArmTask`] like the built-in ones. The declaration of the task contains the text of the file, so that every record,
//! and all evidence, contains the task. A file has no code, and its size is limited.

mod bodies;
mod cases;
mod conditions;
mod document;
mod expert;
mod foresight;
mod import;
mod lint;
mod meshes;
pub(crate) mod mjcf;
mod model;
mod moving;
mod names;
mod numbers;
mod parameters;
mod problem;
mod referee;
mod shapes;
mod skills;
mod stack_claims;
pub mod statics;
mod syntax;
mod targets;
mod units;
mod way;

use std::collections::BTreeMap;
use std::sync::{Arc, LazyLock};

use nalgebra::Isometry3;
use robogate_core::{
    Assignment, Better, CameraSpec, FailureMode, Fault, FaultKind, Foresight, Infeasibility, ParameterSpace, Policy,
    Pose, Scenario, Severity, Stream, TaskInstance, TaskSpec, Word,
};
use robogate_physics::{Chain, Color, Fixture, FixtureKind, FreeBody, Gripper, Object, Robot, Scene, Visual, pose};
use serde::{Deserialize, Serialize};
use serde_json::json;

pub use document::Document;
pub use import::{Imported, UNFINISHED, Wishes, import};
pub use meshes::{Files, Find, MOST_FILE_BYTES};
pub use problem::Problem;

use self::expert::{Cell, Expert};
use self::model::{Model, SettingModel, braces};
use self::names::Region;
use self::numbers::{Draws, Layout, Numbers};
use self::referee::{COLLISION, Referee, STAGES};
use self::skills::Skill;
use crate::arm::claims::Claim;
use crate::arm::{
    ArmDeclaration, ArmSettings, GRIP_THRESHOLD_M, HasSettings, Load, OnArm, Parameters, Resolved, Rules, ToolExpert,
    base_spec, briefing, cannot_carry, common_measures, disc_point, encoder_bias, instance, measure, mode,
    out_of_reach, rows,
};
use crate::settings::{Field, SettingRow};

/// The name of the file in a task's folder.
pub const FILE: &str = "task.toml";

/// The keys of the file's text and of the files that it names in the details of a declaration.
const TEXT: &str = "task_toml";
const FILES: &str = "task_files";

/// Colours of parts that state none, in turn.
const COLORS: [Color; 4] = [Color([58, 110, 165]), Color([200, 60, 40]), Color([222, 170, 60]), Color([96, 150, 90])];

/// How often starts in regions are drawn until no two parts overlap.
const MOST_DRAWS: usize = 1000;

/// The files of the built-in tasks.
const SHIPPED: [&str; 1] = [include_str!("../../../../assets/tasks/stacking/task.toml")];

/// The built-in tasks from files.
pub fn shipped() -> impl Iterator<Item = &'static FileTask> {
    static TASKS: LazyLock<Vec<FileTask>> =
        LazyLock::new(|| SHIPPED.iter().filter_map(|text| FileTask::read(text).ok()).collect());
    TASKS.iter()
}

/// A task for an arm from a file.
#[derive(Debug, Clone)]
pub struct FileTask {
    arm: ArmSettings,
    /// Values of the settings of the file.
    settings: Vec<f64>,
    model: Arc<Model>,
}

impl FileTask {
    /// Reads a task from the text of its file, which names no other files.
    ///
    /// # Errors
    /// Every problem that was found.
    pub fn read(text: &str) -> Result<Self, Vec<Problem>> {
        Self::read_with(text, &mut |_| Err("the text of the task came without its folder".to_owned()))
    }

    /// Reads a task from the text of its file. `find` returns the content of a file beside it.
    ///
    /// # Errors
    /// Every problem that was found.
    pub fn read_with(text: &str, find: Find<'_>) -> Result<Self, Vec<Problem>> {
        Ok(Self::of(Arc::new(Model::read(text, find)?)))
    }

    /// The task with the default of each setting.
    fn of(model: Arc<Model>) -> Self {
        let settings = model.settings.iter().map(|setting| setting.default).collect();
        Self { arm: ArmSettings::lasting(model.time_limit_s), settings, model }
    }

    /// The task of a declaration that contains its file. `None` for another declaration.
    pub fn recorded(spec: &TaskSpec) -> Option<Result<Self, Vec<Problem>>> {
        let text = spec.details.get(TEXT)?.as_str()?;
        let files = spec.details.get(FILES);
        Some(Self::read_with(text, &mut |name| meshes::of_record(files, name)))
    }

    /// The text of the file.
    pub fn text(&self) -> &str {
        &self.model.text
    }

    /// The files that it names.
    pub fn files(&self) -> &Files {
        &self.model.files
    }

    /// What was measured for each mesh and left out of each MJCF file, as lines.
    pub fn figures(&self) -> &[String] {
        &self.model.figures
    }

    /// Whether the file has an expert.
    pub fn has_expert(&self) -> bool {
        self.model.has_expert()
    }

    /// The settings of the file with their values.
    pub fn own_settings(&self) -> impl Iterator<Item = (&'static str, f64)> {
        self.model.settings.iter().map(|setting| setting.name.as_str()).zip(self.settings.iter().copied())
    }

    /// Whether a fixture moves.
    pub fn moves(&self) -> bool {
        self.model.nominal.motions.iter().any(Option::is_some)
    }

    /// The number of its stages.
    pub fn stages(&self) -> usize {
        self.model.stages.len()
    }

    /// The problems of the task that need no simulation: conditions that cannot hold or that hold at the start, places out of
    /// reach.
    pub fn lint(&self, robot: &Robot, chain: &Chain) -> Vec<Problem> {
        lint::lint(&self.model, robot, chain)
    }

    /// The number of roles of the task's choice.
    fn roles(&self) -> usize {
        self.model.choice.as_ref().map_or(0, |choice| choice.roles.len())
    }

    /// The parts that have the roles with this word of the choice.
    fn order(&self, word: usize) -> &[usize] {
        self.model.choice.as_ref().and_then(|choice| choice.words.get(word)).map_or(&[], |(_, parts)| parts)
    }

    /// The numbers and poses of an episode.
    ///
    /// # Errors
    /// A setup fault if the scenario cannot be set up.
    fn drawn(&self, scenario: &Scenario, robot: &Robot) -> Result<Drawn, Fault> {
        let mut numbers = self.model.numbers(&scenario.requested, &self.settings, robot)?;
        numbers.around.encoders = encoder_bias(scenario, robot, 1.0);
        let draws = self.draws(scenario, &numbers)?;
        let layout = Layout::new(&numbers, &self.model.parents(), &draws);
        Ok(Drawn { numbers, draws, layout })
    }

    fn briefing(&self, numbers: &Numbers, layout: &Layout) -> Briefing {
        let model = &self.model;
        let told = model.parameters.iter().zip(&numbers.values).filter(|(parameter, _)| parameter.told);
        let nominal = Layout::new(numbers, &model.parents(), &vec![Draws::default(); model.parts.len()]).parts;
        let at = |of: usize| match model.parts[of].start {
            Some(_) => Some(pose(&layout.parts[of])),
            // The place of a part follows the reach of the arm.
            None => model.document.scene.fit_reach.then(|| pose(&nominal[of])),
        };
        let starts = model.parts.iter().enumerate().filter_map(|(of, part)| Some((part.name.clone(), at(of)?)));
        let word = model.choice.as_ref().and_then(|choice| choice.words.get(numbers.word));
        Briefing {
            parameters: told.map(|(parameter, value)| (parameter.name.to_string(), *value)).collect(),
            choice: word.map(|(word, _)| word.clone()).unwrap_or_default(),
            parts: starts.collect(),
        }
    }

    /// The draws of an episode.
    fn draws(&self, scenario: &Scenario, numbers: &Numbers) -> Result<Vec<Draws>, Fault> {
        let model = &self.model;
        let mut stream = scenario.seed.stream("part-jitter");
        let mut draws: Vec<Draws> = model
            .parts
            .iter()
            .map(|_| Draws { shift: disc_point(&mut stream), turn: stream.between(-1.0, 1.0), place: None })
            .collect();
        if model.parts.iter().all(|part| part.start.is_none()) {
            return Ok(draws);
        }
        let mut stream = scenario.seed.stream("part-start");
        // Ten parts that are drawn together would hardly ever lie beside each other, so one is drawn after another.
        let mut placed: Vec<usize> = (0..draws.len()).filter(|part| model.parts[*part].start.is_none()).collect();
        for (part, region) in model.parts.iter().enumerate().filter_map(|(part, of)| Some((part, of.start?))) {
            let fits = (0..MOST_DRAWS).any(|_| {
                self.draw_place(numbers, &mut draws, (part, region), &mut stream);
                !self.overlaps(numbers, &draws, part, &placed)
            });
            if !fits {
                let why = "the parts do not fit beside each other into the regions of their starts";
                return Err(Fault::new(FaultKind::Setup, why));
            }
            placed.push(part);
        }
        Ok(draws)
    }

    fn draw_place(&self, numbers: &Numbers, draws: &mut [Draws], (part, region): (usize, Region), stream: &mut Stream) {
        let layout = Layout::new(numbers, &self.model.parents(), draws);
        let [x, y] = [0, 1].map(|axis| region.at[axis] + stream.between(-region.half[axis], region.half[axis]));
        let frame = match region.on {
            numbers::Frame::Fixture(of) => layout.fixtures[of],
            _ => Isometry3::identity(),
        };
        let at = frame * nalgebra::Point3::new(x, y, region.at.z);
        draws[part].place = Some([at.x, at.y]);
    }

    /// Whether the circle around a part overlaps that around one of others.
    fn overlaps(&self, numbers: &Numbers, draws: &[Draws], part: usize, others: &[usize]) -> bool {
        let layout = Layout::new(numbers, &self.model.parents(), draws);
        let radius = |index: usize| {
            let reach = |part: &robogate_physics::Part| {
                let [x, y, _] = part.primitive.half_extent();
                part.pose.translation.vector.xy().norm() + x.hypot(y)
            };
            numbers.parts[index].shapes.iter().map(reach).fold(0.0, f64::max)
        };
        let near = |one: usize, other: usize| {
            let off = layout.parts[one].translation.vector - layout.parts[other].translation.vector;
            off.xy().norm() < radius(one) + radius(other)
        };
        others.iter().any(|other| near(part, *other))
    }

    /// The scene with these numbers and poses.
    fn scene(&self, numbers: &Numbers, layout: &Layout) -> Scene {
        let model = &self.model;
        let body = |index: usize| {
            let (part, own) = (&model.parts[index], &numbers.parts[index]);
            let object =
                Object { parts: own.shapes.clone(), mass: own.mass(), joint: own.joint, friction: own.friction };
            FreeBody {
                name: part.name.clone(),
                object,
                pose: layout.parts[index],
                color: part.color.unwrap_or(COLORS[index % COLORS.len()]),
            }
        };
        let mut fixtures = vec![Fixture::table()];
        let frames = layout.fixtures.iter().zip(&layout.motions).zip(&numbers.frictions);
        for (fixture, ((frame, motion), friction)) in model.fixtures.iter().zip(frames) {
            for (index, shape) in fixture.shapes.iter().enumerate() {
                let name = match fixture.shapes.len() {
                    1 => fixture.name.clone(),
                    _ => format!("{}.{}", fixture.name, index + 1),
                };
                let part = robogate_physics::Part { pose: frame * shape.pose, ..shape.clone() };
                let (kind, color) = (FixtureKind::Receptacle, fixture.color);
                fixtures.push(Fixture { name, kind, part, motion: *motion, friction: *friction, color });
            }
        }
        let FreeBody { object, pose: object_pose, color, .. } = body(0);
        Scene {
            object,
            object_pose,
            others: (1..model.parts.len()).map(body).collect(),
            friction: numbers.friction,
            table_friction: None,
            arm_stiffness: 1.0,
            gripper: numbers.around.gripper,
            fixtures,
            gravity: numbers.gravity,
            marker: None,
            visual: Visual { object_color: color, ..numbers.around.visual() },
        }
    }

    /// What a record contains of the file. It names a built-in task.
    fn details(&self) -> serde_json::Value {
        let Model { text, files, .. } = &*self.model;
        match (SHIPPED.contains(&&**text), files.is_empty()) {
            (true, _) => json!(null),
            (false, true) => json!({ TEXT: text }),
            (false, false) => json!({ TEXT: text, FILES: meshes::recorded(files) }),
        }
    }

    fn instruction(&self, numbers: &Numbers) -> String {
        let mut text = self.model.document.instruction.text.clone();
        for name in braces(&self.model.document.instruction.text) {
            if let Some(part) = self.model.in_role(numbers.word, name) {
                text = text.replace(&format!("{{{name}}}"), &self.model.parts[part].name.replace('_', " "));
                continue;
            }
            let index = self.model.parameters.iter().position(|parameter| parameter.name.as_str() == name);
            let Some(index) = index else { continue };
            let unit = self.model.parameters[index].dimension.unit();
            let shown = format!("{:.3}", numbers.values[index]);
            let shown = shown.trim_end_matches('0').trim_end_matches('.');
            text = text.replace(&format!("{{{name}}}"), format!("{shown} {unit}").trim_end());
        }
        text
    }
}

impl OnArm for FileTask {
    fn arm(&self) -> &ArmSettings {
        &self.arm
    }

    fn arm_mut(&mut self) -> &mut ArmSettings {
        &mut self.arm
    }

    fn defaults(&self) -> Self {
        Self::of(Arc::clone(&self.model))
    }
}

impl HasSettings for FileTask {
    fn rows(&self) -> Vec<SettingRow<Self>> {
        let tables = &self.model.document.setting;
        let row = |(index, setting): (usize, &SettingModel)| SettingRow {
            name: setting.name.as_str(),
            meaning: tables[index].meaning.clone().into(),
            field: Field::Listed(setting.range, index, |task: &mut Self, index| &mut task.settings[index]),
        };
        rows(self.model.settings.iter().enumerate().map(row))
    }
}

impl ArmDeclaration for FileTask {
    fn name(&self) -> &'static str {
        self.model.name.as_str()
    }

    fn summary(&self) -> &str {
        &self.model.document.summary
    }

    fn brought_space(&self) -> Option<ParameterSpace> {
        self.model.own_space()
    }

    fn space(&self, _: &Gripper) -> &'static str {
        self.model.space.unwrap_or(self.name())
    }

    fn suite(&self) -> Option<&'static str> {
        self.model.suite.map(Word::as_str)
    }

    fn parameters(&self) -> &dyn Parameters {
        &*self.model
    }

    fn first_part(&self, instance: &TaskInstance, robot: &Robot) -> Result<[f64; 4], Fault> {
        let cell = Cell::new(&self.model, &self.settings, robot, &Briefing::of(&self.model, instance)?);
        let first = self.model.skills(cell.numbers.word).iter().find_map(Skill::grasped);
        let (part, edge) =
            first.and_then(|part| Some((part, cell.numbers.parts[part].size_m()?))).ok_or_else(|| {
                Fault::new(FaultKind::Setup, "the expert of the task grasps no cube, so it cannot be pushed")
            })?;
        let [x, y, z] = cell.layout.parts[part].translation.vector.into();
        Ok([x, y, z, edge])
    }

    fn own_claims(&self, _: &Gripper) -> Vec<Claim> {
        self.model.foresight.map_or_else(Vec::new, |(_, plug_in)| plug_in.claims.to_vec())
    }

    fn controller(&self, robot: Robot, chain: Chain) -> Box<dyn Policy> {
        Box::new(Expert::new(Arc::clone(&self.model), self.settings.clone(), robot, chain))
    }

    fn tool_expert(&self, robot: Robot, chain: Chain) -> Option<Box<dyn Policy>> {
        let joints = self.model.nominal.parts.iter().any(|part| part.joint.is_some());
        if !self.has_expert() || self.moves() || joints {
            return None;
        }
        let (model, gripper) = (Arc::clone(&self.model), robot.settings.gripper.clone());
        let expert = Expert::new(Arc::clone(&model), self.settings.clone(), robot.clone(), chain.clone());
        let way = move |_: &Robot, instance: &TaskInstance| {
            let (Ok(stages) | Err(stages)) = expert.stages(&Briefing::of(&model, instance)?);
            Ok(way::way(&stages, &chain, &gripper))
        };
        Some(Box::new(ToolExpert::new(self.name(), Arc::new(way), robot)))
    }
}

impl Rules for FileTask {
    fn only_here(&self) -> Option<&'static str> {
        self.model.is_local().then_some(
            "the file of the task has meshes, joints, motions or contacts that only an engine in this process simulates and reports: \
             use `--engine mujoco`, without --simulator",
        )
    }

    fn foresight(&self, robot: &Robot, chain: &Chain, grip_force_n: f64) -> Option<Arc<dyn Foresight>> {
        let (_, plug_in) = self.model.foresight?;
        Some((plug_in.new)(self.clone(), robot, chain, grip_force_n))
    }

    fn infeasibility(&self, requested: &Assignment, robot: &Robot, grip_force_n: f64) -> Option<Infeasibility> {
        let numbers = self.model.numbers(requested, &self.settings, robot).ok()?;
        let layout = Layout::new(&numbers, &self.model.parents(), &vec![Draws::default(); self.model.parts.len()]);
        let carried = &self.model.cases[numbers.word].carried;
        let far = |part: &usize| {
            let [x, y, _] = layout.parts[*part].translation.vector.into();
            out_of_reach(robot, "part", [x, y], numbers.parts[*part].spread_m)
        };
        let heavy = |part: &usize| {
            let part = &numbers.parts[*part];
            let pads = part.friction.unwrap_or(numbers.friction) * numbers.around.gripper.pad_friction_scale;
            // A cube has vertical faces only.
            let (width_m, friction) = (part.size_m(), part.size_m().map(|_| pads));
            let load = Load {
                width_m: width_m.filter(|_| pads < 1.0),
                friction: friction.filter(|pads| *pads < 1.0),
                weight_n: part.mass_kg * numbers.gravity,
                force_scale: numbers.around.gripper.force_scale,
            };
            cannot_carry(robot, &load, grip_force_n, self.arm.suction)
        };
        carried.iter().find_map(far).or_else(|| carried.iter().find_map(heavy))
    }

    fn spec(&self, robot: &Robot, cameras: Vec<CameraSpec>) -> TaskSpec {
        let model = &self.model;
        let failures = |at_limit: bool| {
            let failures = model.failures.iter().zip(&model.document.failure);
            let failures = failures.filter(move |(_, table)| table.at_limit == at_limit);
            failures.map(|(name, table)| mode(*name, table.severity, &table.meaning))
        };
        let collision = mode(
            COLLISION,
            Severity::Critical,
            "A link or finger of the robot touched itself, the table or a fixture that it may not touch.",
        );
        let timeout =
            mode(FailureMode::TIMEOUT, Severity::Minor, "The time limit passed before the success condition held.");
        let own = model.measures.iter().zip(&model.document.measure);
        let own = own.map(|((name, of), table)| measure(*name, &of.unit(), table.better, &table.meaning));
        let stages: Vec<String> = model.stages.iter().map(ToString::to_string).collect();
        let meaning = format!("Number of stages that were reached, in order: {}.", stages.join(", "));
        let stages = (!stages.is_empty()).then(|| measure(STAGES, "", Better::Higher, &meaning));
        TaskSpec {
            version: model.document.version,
            instruction: self.instruction(&model.nominal),
            failure_modes: failures(false).chain([collision]).chain(failures(true)).chain([timeout]).collect(),
            draws: model.foresight.map(|(_, plug_in)| (plug_in.draws)(self, robot)).unwrap_or_default(),
            measures: own.chain(stages).chain(common_measures()).collect(),
            stages: model.stages.clone(),
            phases: skills::phases(model.skills(model.nominal.word)),
            details: self.details(),
            ..base_spec(self.name(), robot, cameras)
        }
    }

    fn resolve(&self, scenario: &Scenario, robot: &Robot, grip_force_n: f64) -> Result<Resolved, Fault> {
        let model = &self.model;
        let Drawn { numbers, draws, layout } = self.drawn(scenario, robot)?;
        let briefing = self.briefing(&numbers, &layout);
        Ok(Resolved {
            scene: self.scene(&numbers, &layout),
            grip_threshold_m: GRIP_THRESHOLD_M,
            bias: numbers.around.bias(scenario, robot)?,
            instance: instance(self.instruction(&numbers), &briefing),
            trial: Box::new(Referee::new(Arc::clone(model), numbers, layout, draws, grip_force_n)),
        })
    }
}

/// The numbers and poses of an episode.
struct Drawn {
    numbers: Numbers,
    draws: Vec<Draws>,
    layout: Layout,
}

/// Information that a policy may use about one episode.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
struct Briefing {
    /// Values of the parameters that the policy is told.
    parameters: BTreeMap<String, f64>,
    /// The word of the task's choice, if it has one.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    choice: String,
    /// Poses of the parts that start in a region, and nominal poses of parts whose places follow the reach of the arm.
    parts: BTreeMap<String, Pose>,
}

impl Briefing {
    /// Reads the briefing from the details of an episode.
    ///
    /// # Errors
    /// A setup fault if the details are not those of this task.
    fn of(model: &Model, instance: &TaskInstance) -> Result<Self, Fault> {
        briefing(model.name.as_str(), instance)
    }
}
