//! The threads that share a simulator.

use std::collections::BTreeMap;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use robogate_core::{Fault, FaultKind};

use super::server::{Identity, Row, Server};
use super::world::{Period, World};
use crate::mujoco::numbers::{Numbers, Plan};

/// A new group has room for so many more worlds than are needed, as one over this.
const SPARE: usize = 8;

/// A world that the simulator does not have yet.
#[derive(Debug, Clone)]
pub(super) struct Entry {
    pub(super) plan: Plan,
    pub(super) numbers: Numbers,
    pub(super) model: Vec<u8>,
}

/// The place of a world in a simulator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Place {
    group: usize,
    world: usize,
}

/// A simulator that several threads share.
#[derive(Debug)]
pub struct Simulator {
    state: Mutex<State>,
    done: Condvar,
    identity: Identity,
}

#[derive(Debug)]
struct State {
    server: Server,
    topologies: BTreeMap<u64, Topology>,
    /// Free worlds of each group, and how many it has.
    groups: Vec<(Vec<usize>, usize)>,
    members: usize,
    /// Submissions of this period, in order of arrival.
    submissions: Vec<Submission>,
    /// Replies of the last period, by member.
    replies: BTreeMap<u64, Result<Vec<Place>, Fault>>,
    next_member: u64,
}

#[derive(Debug)]
struct Topology {
    model: std::path::PathBuf,
    groups: Vec<usize>,
}

#[derive(Debug)]
struct Submission {
    member: u64,
    worlds: Vec<Submitted>,
}

/// A world of a period: its place, which has its command, or what a new world needs.
#[derive(Debug)]
enum Submitted {
    Placed(Place),
    New(Box<Entry>, Vec<f32>),
}

/// Where the numbers of a world are.
#[derive(Debug)]
pub(super) struct Rows {
    command: Row,
    held: Row,
    reports: Row,
    qpos: Row,
    qvel: Row,
    lost: Row,
}

impl Simulator {
    /// A simulator behind this connection.
    pub fn new(server: Server) -> Self {
        let identity = server.identity().clone();
        let state = State {
            server,
            topologies: BTreeMap::new(),
            groups: Vec::new(),
            members: 0,
            submissions: Vec::new(),
            replies: BTreeMap::new(),
            next_member: 0,
        };
        Self { state: Mutex::new(state), done: Condvar::new(), identity }
    }

    /// The simulator, as it describes itself.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // A panic while the lock is held leaves worlds that nothing refers to.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A thread that shares a simulator. The simulator runs a control period when each member has given its commands.
#[derive(Debug)]
pub struct Member {
    simulator: Arc<Simulator>,
    id: u64,
    /// Places of this member's worlds.
    held: Vec<Place>,
}

impl Member {
    /// A new member. It must exchange soon, because all others wait for it.
    pub fn join(simulator: Arc<Simulator>) -> Self {
        let mut state = simulator.lock();
        state.members += 1;
        state.next_member += 1;
        let id = state.next_member;
        drop(state);
        Self { simulator, id, held: Vec::new() }
    }

    /// Gives a world's place back.
    pub fn release(&mut self, world: &mut World) {
        if let Some((place, _)) = world.place.take() {
            self.held.retain(|held| *held != place);
            self.simulator.lock().groups[place.group].0.push(place.world);
        }
    }

    /// Runs one control period of these worlds with their commands, together with those of all other members. Returns one reply per
    /// world, in order.
    ///
    /// # Errors
    /// If the simulator is unavailable.
    pub fn exchange(&mut self, worlds: &mut [(&mut World, Vec<f32>)]) -> Result<Vec<Result<Period, Fault>>, Fault> {
        let mut sent = Vec::with_capacity(worlds.len());
        let mut submitted = Vec::with_capacity(worlds.len());
        for (world, command) in worlds.iter_mut() {
            sent.push(world.entry.as_ref().map(|entry| entry.numbers.values.clone()));
            submitted.push(match (&world.place, world.entry.take()) {
                (_, Some(entry)) => Submitted::New(Box::new(entry), std::mem::take(command)),
                // Each thread writes its own commands. All of them do so at once.
                (Some((place, rows)), None) => {
                    rows.command.write(command)?;
                    Submitted::Placed(*place)
                }
                (None, None) => {
                    let why = "the simulator of many worlds: it failed in an earlier period";
                    return Err(Fault::new(FaultKind::Unavailable, why));
                }
            });
        }
        let places = self.submit(Submission { member: self.id, worlds: submitted })?;
        for ((world, _), place) in worlds.iter_mut().zip(places).filter(|((world, _), _)| world.place.is_none()) {
            world.place = Some((place, self.simulator.lock().rows(place)?));
            self.held.push(place);
        }
        let read = |((world, _), sent): (&(&mut World, Vec<f32>), Option<Vec<f32>>)| match &world.place {
            Some((_, rows)) => rows.read(sent.as_deref()),
            None => Err(Fault::new(FaultKind::Unavailable, "the simulator of many worlds has no such world")),
        };
        Ok(worlds.iter().zip(sent).map(read).collect())
    }

    fn submit(&self, submission: Submission) -> Result<Vec<Place>, Fault> {
        let simulator = &self.simulator;
        let mut state = simulator.lock();
        state.submissions.push(submission);
        loop {
            if let Some(reply) = state.replies.remove(&self.id) {
                return reply;
            }
            if state.submissions.len() >= state.members {
                state.run();
                simulator.done.notify_all();
            } else {
                state = simulator.done.wait(state).unwrap_or_else(PoisonError::into_inner);
            }
        }
    }
}

impl Drop for Member {
    fn drop(&mut self) {
        let mut state = self.simulator.lock();
        state.members -= 1;
        for place in &self.held {
            state.groups[place.group].0.push(place.world);
        }
        drop(state);
        // The others may have waited for this member alone.
        self.simulator.done.notify_all();
    }
}

impl Rows {
    /// Reads the period of the world. A new world must have the numbers that it was sent.
    fn read(&self, sent: Option<&[f32]>) -> Result<Period, Fault> {
        let mut numbers = Vec::new();
        if let Some(sent) = sent {
            self.held.read(&mut numbers)?;
            let same = |(sent, held): (&f32, &f32)| sent.to_bits() == held.to_bits();
            if sent.len() != numbers.len() || !sent.iter().zip(&numbers).all(same) {
                let why = "the simulator of many worlds: the device does not have the numbers of the scene";
                return Err(Fault::new(FaultKind::NotApplied, why));
            }
        }
        let mut period = Period::default();
        self.reports.read(&mut period.reports)?;
        self.qpos.read(&mut period.qpos)?;
        self.qvel.read(&mut period.qvel)?;
        self.lost.read(&mut numbers)?;
        period.lost = numbers.first().map_or(0, |lost| *lost as u32);
        Ok(period)
    }
}

impl State {
    /// Runs one control period of all submitted worlds.
    fn run(&mut self) {
        let submissions = std::mem::take(&mut self.submissions);
        let members: Vec<u64> = submissions.iter().map(|submission| submission.member).collect();
        match self.period(submissions) {
            Ok(places) => self.replies.extend(members.into_iter().zip(places.into_iter().map(Ok))),
            Err(fault) => self.replies.extend(members.into_iter().map(|member| (member, Err(fault.clone())))),
        }
    }

    fn period(&mut self, submissions: Vec<Submission>) -> Result<Vec<Vec<Place>>, Fault> {
        let mut demand: BTreeMap<u64, usize> = BTreeMap::new();
        for world in submissions.iter().flat_map(|submission| &submission.worlds) {
            if let Submitted::New(entry, _) = world {
                *demand.entry(entry.numbers.topology).or_default() += 1;
            }
        }
        let mut resets: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        let mut running: Vec<usize> = Vec::new();
        let mut places = Vec::new();
        for Submission { worlds, .. } in submissions {
            let mut own = Vec::with_capacity(worlds.len());
            for world in worlds {
                let place = match world {
                    Submitted::Placed(place) => place,
                    Submitted::New(entry, command) => {
                        let topology = entry.numbers.topology;
                        let left = demand.entry(topology).or_insert(1);
                        let wanted = *left;
                        *left -= 1;
                        let place = self.place(&entry, &command, wanted, &mut resets)?;
                        self.server.row(place.group, "numbers", place.world)?.write(&entry.numbers.values)?;
                        self.server.row(place.group, "command", place.world)?.write(&command)?;
                        place
                    }
                };
                if !running.contains(&place.group) {
                    running.push(place.group);
                }
                own.push(place);
            }
            places.push(own);
        }
        running.sort_unstable();
        let resets: Vec<(usize, Vec<usize>)> = resets.into_iter().collect();
        self.server.step(&resets, &running)?;
        Ok(places)
    }

    /// A free world of the topology of `entry`. A new group has room for `demand` worlds; those without an episode repeat
    /// `command`.
    fn place(
        &mut self,
        entry: &Entry,
        command: &[f32],
        demand: usize,
        resets: &mut BTreeMap<usize, Vec<usize>>,
    ) -> Result<Place, Fault> {
        let Numbers { topology, values, fields } = &entry.numbers;
        if !self.topologies.contains_key(topology) {
            let model = self.server.store(&format!("{topology:016x}.mjb"), &entry.model)?;
            self.topologies.insert(*topology, Topology { model, groups: Vec::new() });
        }
        let Topology { model, groups } = &self.topologies[topology];
        let mut free = groups.iter().copied().filter(|group| !self.groups[*group].0.is_empty());
        let group = match free.next() {
            Some(group) => group,
            None => {
                let there: usize = groups.iter().map(|group| self.groups[*group].1).sum();
                let worlds = (demand + demand / SPARE).max(there / SPARE).max(1);
                let group = self.server.create(model, &entry.plan, fields, worlds)?;
                self.groups.push(((0..worlds).rev().collect(), worlds));
                // Worlds without an episode are stepped too: they begin like this one.
                for world in 0..worlds {
                    self.server.row(group, "numbers", world)?.write(values)?;
                    self.server.row(group, "command", world)?.write(command)?;
                }
                resets.insert(group, (0..worlds).collect());
                if let Some(topology) = self.topologies.get_mut(topology) {
                    topology.groups.push(group);
                }
                group
            }
        };
        let world = self.groups[group].0.pop().unwrap_or_default();
        let due = resets.entry(group).or_default();
        if !due.contains(&world) {
            due.push(world);
        }
        Ok(Place { group, world })
    }

    fn rows(&self, place: Place) -> Result<Rows, Fault> {
        let row = |table| self.server.row(place.group, table, place.world);
        Ok(Rows {
            command: row("command")?,
            held: row("held")?,
            reports: row("reports")?,
            qpos: row("qpos")?,
            qvel: row("qvel")?,
            lost: row("lost")?,
        })
    }
}
