//! Tests that episodes in a batch are those of the single loop, and that a batch keeps its slots busy.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod line;

use std::cell::RefCell;
use std::ops::ControlFlow;
use std::rc::Rc;
use std::sync::Arc;

use robogate_core::{
    Action, BatchEnvironment, BatchPolicy, Command, Ending, Environment, Episode, Fault, FaultKind, Image, Observation,
    Outcome, Policy, Scenario, Seed, SingleEnvironments, SinglePolicies, Start, Step, TaskInstance, TaskSpec, Tick,
    Workload, rollout, rollout_all, rollout_many, rollout_with,
};

use line::{COLLISION, Line, Walker, scenario};

/// A line whose events follow from the index of the scenario. Its camera shows the number of the step.
#[derive(Default)]
struct Course {
    line: Line,
    renders: Rc<RefCell<Vec<u64>>>,
    index: u64,
}

impl Environment for Course {
    fn task(&self) -> &Arc<TaskSpec> {
        self.line.task()
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        self.index = scenario.index;
        let at = |every: u64, at: u64, step: u32| (scenario.index % every == at).then_some(step);
        self.line.endings = at(3, 1, 1 + (scenario.index % 7) as u32).map(|step| (step, None)).into_iter().collect();
        self.line.breaks_at = at(5, 3, 4);
        self.line.certain_at = at(4, 0, 6);
        self.line.refuses = scenario.index % 11 == 6;
        self.line.reset(scenario)
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        self.line.step(action)
    }

    fn foregone_ending(&self) -> Option<Ending> {
        self.line.foregone_ending()
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        if self.index % 13 == 2 && self.line.steps == 3 {
            return Err(Fault::new(FaultKind::Unavailable, "the camera is off"));
        }
        self.renders.borrow_mut().push(self.index);
        let rgb = vec![self.line.steps as u8; 3];
        Ok(vec![Image { camera: "front".to_owned(), width: 1, height: 1, rgb }])
    }
}

/// A policy with a memory that sees an image for every third action, and gives up at its eighth one.
#[derive(Default)]
struct Rememberer {
    walker: Walker,
    memory: f64,
}

impl Policy for Rememberer {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        self.walker.check(task)
    }

    fn reset(&mut self, task: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault> {
        self.memory = 0.0;
        self.walker.reset(task, instance, seed)
    }

    fn wants_images(&self) -> bool {
        self.walker.acts.is_multiple_of(3)
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        assert_eq!(!observation.images.is_empty(), self.wants_images());
        let mut action = self.walker.act(observation)?;
        let seen = observation.images.first().map_or(0.0, |image| f64::from(image.rgb[0]));
        self.memory = 0.5 * self.memory + observation.vector("position").unwrap()[0] + seen;
        if let Command::Vector(numbers) = &mut action.command {
            numbers[0] += self.memory;
        }
        Ok(action)
    }

    fn gave_up(&self) -> bool {
        self.walker.acts >= 8
    }
}

fn scenarios(n: u64) -> Vec<Scenario> {
    (0..n).map(scenario).collect()
}

fn single(scenario: &Scenario) -> Episode {
    rollout(&mut Course::default(), &mut Rememberer::default(), scenario)
}

fn courses(slots: usize) -> SingleEnvironments {
    SingleEnvironments::new((0..slots).map(|_| Box::new(Course::default()) as Box<dyn Environment>).collect()).unwrap()
}

fn rememberers(slots: usize) -> SinglePolicies {
    SinglePolicies::new((0..slots).map(|_| Box::new(Rememberer::default()) as Box<dyn Policy>).collect())
}

#[test]
fn batch_equals_single_episodes() {
    let scenarios = scenarios(200);
    let expected: Vec<Episode> = scenarios.iter().map(single).collect();
    for slots in [1, 2, 7, 64, 300] {
        assert_eq!(rollout_all(&mut courses(slots), &mut rememberers(slots), &scenarios), expected, "{slots} slots");
    }
    // The episodes include all kinds of endings.
    let invalid = |kind| move |episode: &&Episode| matches!(&episode.outcome, Outcome::Invalid(f) if f.kind == kind);
    for kind in [FaultKind::Diverged, FaultKind::Setup, FaultKind::Unavailable] {
        assert!(expected.iter().any(|episode| invalid(kind)(&episode)), "{kind}");
    }
    for outcome in [Outcome::Success, Outcome::Failure(COLLISION)] {
        assert!(expected.iter().any(|episode| episode.outcome == outcome), "{outcome:?}");
    }
}

#[test]
fn empty_batch_is_none() {
    assert!(SingleEnvironments::new(Vec::new()).is_none());
    assert!(rollout_all(&mut courses(3), &mut rememberers(3), &[]).is_empty());
}

/// A batch whose calls are counted.
struct Counted<E> {
    batch: E,
    /// The number of episodes in each step.
    widths: Vec<usize>,
}

impl BatchEnvironment for Counted<SingleEnvironments> {
    fn task(&self) -> &Arc<TaskSpec> {
        self.batch.task()
    }

    fn slots(&self) -> std::num::NonZeroUsize {
        self.batch.slots()
    }

    fn reset(&mut self, scenarios: &[(usize, &Scenario)]) -> Vec<Result<Start, Fault>> {
        self.batch.reset(scenarios)
    }

    fn step(&mut self, actions: &[(usize, &Action)]) -> Vec<Result<Step, Fault>> {
        self.widths.push(actions.len());
        self.batch.step(actions)
    }
}

/// Policies that record which slots are answered together.
struct Together {
    slots: Vec<Vec<usize>>,
    walkers: SinglePolicies,
}

impl BatchPolicy for Together {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        self.walkers.check(task)
    }

    fn reset(&mut self, slot: usize, task: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault> {
        self.walkers.reset(slot, task, instance, seed)
    }

    fn act(&mut self, observations: &[(usize, &Observation)]) -> Vec<Result<Action, Fault>> {
        self.slots.push(observations.iter().map(|(slot, _)| *slot).collect());
        self.walkers.act(observations)
    }
}

/// Ends after 1 to 10 steps, or cannot be set up.
fn short(index: u64) -> Line {
    Line { endings: vec![(1 + (index * 7 % 10) as u32, None)], refuses: index % 9 == 8, ..Line::default() }
}

/// A line whose length follows from the index of the scenario.
#[derive(Default)]
struct Short(Line);

impl Environment for Short {
    fn task(&self) -> &Arc<TaskSpec> {
        self.0.task()
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        self.0 = short(scenario.index);
        self.0.reset(scenario)
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        self.0.step(action)
    }
}

fn lines(slots: usize) -> Counted<SingleEnvironments> {
    let lines = (0..slots).map(|_| Box::new(Short::default()) as Box<dyn Environment>).collect();
    Counted { batch: SingleEnvironments::new(lines).unwrap(), widths: Vec::new() }
}

fn walkers(slots: usize) -> SinglePolicies {
    SinglePolicies::new((0..slots).map(|_| Box::new(Walker::default()) as Box<dyn Policy>).collect())
}

#[test]
fn free_slots_are_refilled() {
    let (mut environment, mut policy) = (lines(4), Together { slots: Vec::new(), walkers: walkers(4) });
    let scenarios = scenarios(90);
    let episodes = rollout_all(&mut environment, &mut policy, &scenarios);
    let expected: Vec<Episode> = scenarios
        .iter()
        .map(|scenario| rollout(&mut short(scenario.index), &mut Walker::default(), scenario))
        .collect();
    assert_eq!(episodes, expected);
    // Every slot is busy until fewer episodes than slots are left, which takes at most one time limit.
    let steps: u32 = episodes.iter().map(|episode| episode.ticks).sum();
    assert_eq!(environment.widths.iter().sum::<usize>(), steps as usize);
    let busy = environment.widths.iter().take_while(|width| **width == 4).count();
    assert!(environment.widths.len() - busy <= 10, "{:?}", environment.widths);
    // All requests of a control period are answered together, in the order of the slots.
    assert_eq!(policy.slots.iter().map(Vec::len).collect::<Vec<_>>(), environment.widths);
    assert!(policy.slots.iter().all(|slots| slots.is_sorted()));
}

#[test]
fn images_are_rendered_on_request_only() {
    let renders = Rc::new(RefCell::new(Vec::new()));
    let course = || Box::new(Course { renders: Rc::clone(&renders), ..Course::default() }) as Box<dyn Environment>;
    let mut batch = SingleEnvironments::new(vec![course(), course()]).unwrap();
    // Slot 0 never wants images.
    let mut policies = SinglePolicies::new(vec![Box::new(Walker::default()), Box::new(Rememberer::default())]);
    let episodes = rollout_all(&mut batch, &mut policies, &[scenario(5), scenario(12)]);
    assert_eq!(episodes.iter().map(|episode| episode.ticks).collect::<Vec<_>>(), [10, 8]);
    assert_eq!(*renders.borrow(), [12, 12, 12]);
}

#[test]
fn missing_replies_are_faults() {
    /// Answers one request too few.
    struct Forgetful(SinglePolicies);

    impl BatchPolicy for Forgetful {
        fn check(&self, task: &TaskSpec) -> Result<(), String> {
            self.0.check(task)
        }

        fn reset(&mut self, slot: usize, task: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault> {
            self.0.reset(slot, task, instance, seed)
        }

        fn act(&mut self, observations: &[(usize, &Observation)]) -> Vec<Result<Action, Fault>> {
            self.0.act(&observations[1..])
        }
    }

    let episodes = rollout_all(&mut lines(3), &mut Forgetful(walkers(3)), &scenarios(3));
    for episode in episodes {
        let Outcome::Invalid(fault) = episode.outcome else { panic!("{:?}", episode.outcome) };
        assert_eq!(fault, Fault::new(FaultKind::Setup, "a batch returned 2 replies to 3 requests"));
    }
}

#[test]
fn observers_see_every_period() {
    /// The time and the bits of the state in each control period, for each episode.
    #[derive(Default)]
    struct Watched {
        scenarios: std::ops::Range<u64>,
        slots: [(u64, Vec<(f64, u64)>); 3],
        seen: Vec<(u64, Vec<(f64, u64)>)>,
    }

    impl Workload for Watched {
        fn next(&mut self, slot: usize) -> Option<Scenario> {
            let index = self.scenarios.next()?;
            self.slots[slot] = (index, Vec::new());
            Some(scenario(index))
        }

        fn observe(&mut self, slot: usize, tick: Tick<'_>) {
            self.slots[slot].1.push((tick.observation.time_s, tick.step.state_hash));
        }

        fn finished(&mut self, slot: usize, episode: Episode, _: &mut dyn BatchEnvironment) -> ControlFlow<()> {
            let (index, seen) = std::mem::take(&mut self.slots[slot]);
            assert_eq!((episode.scenario.index, episode.ticks as usize), (index, seen.len()));
            self.seen.push((index, seen));
            if self.seen.len() < 30 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        }
    }

    let mut watched = Watched { scenarios: 0..40, ..Watched::default() };
    rollout_many(&mut courses(3), &mut rememberers(3), &mut watched);
    assert_eq!(watched.seen.len(), 30, "no episode finishes after a break");
    for (index, seen) in watched.seen {
        let mut expected = Vec::new();
        rollout_with(&mut Course::default(), &mut Rememberer::default(), &scenario(index), &mut |tick| {
            expected.push((tick.observation.time_s, tick.step.state_hash));
        });
        assert_eq!(seen, expected, "{index}");
    }
}
