//! Records the episodes that a page shows.

use std::path::{Path, PathBuf};

use anyhow::Context;
use robogate_analysis::labels::{mode_label, parameter_label, value_with_unit};
use robogate_analysis::{Analysis, Comparison, HERE, ReplayEpisode, Source, shell_word, worth_watching};
use robogate_campaign::WorkerFactory;
use robogate_core::{Episode, Fault, FaultKind, Outcome, Value};
use robogate_dictionary::{Entry, files};
use robogate_replay::{Clip, FilmFrame, Recording, record, reel};
use robogate_report::{Strip, Watch, WatchItem};
use robogate_stats::format::{counted, number};

use crate::film::{self, Cameras, FILM_FRAMES, Filmed, Shot};
use crate::picture;
use crate::terminal::note;
use robogate_session::{PolicySource, Reopening, Subject, starts_processes};

/// Maximum number of recorded episodes of a page.
const MAX_CLIPS: usize = 12;
/// Maximum number of pairs of episodes of a comparison.
const MAX_PAIRS: usize = 6;

/// The largest number of control periods that are recorded at the end of a run in an environment of another process.
const END_PERIODS: u64 = 1_500;

/// When the episodes are recorded.
#[derive(Clone, Copy)]
pub(crate) enum Moment<'a> {
    /// At the end of a run, with its subject if that is at hand: the processes of its environment still run. Policies
    /// behind servers are left out, because their episodes may take minutes.
    EndOfRun(Option<&'a Subject>),
    /// On request.
    OnRequest,
}

/// Where images with frames of the episodes are written, for pages that cannot play them.
#[derive(Debug, Clone)]
pub(crate) struct Frames {
    /// The folder.
    pub(crate) folder: PathBuf,
    /// Its path relative to the page.
    pub(crate) link: String,
}

/// Number of frames of an episode.
const FRAMES: u32 = 4;
/// Width and height of a frame in pixels, if the built-in cell renders it.
const FRAME_PX: usize = 240;

/// The folders of runs with their environments and policies, and the clips so far.
struct Recorder<'a> {
    place: Place,
    frames: Option<&'a Frames>,
    runs: Vec<Run<'a>>,
    clips: Vec<Clip>,
    /// Number of episodes whose replay differs from the record.
    differing: u64,
    remarks: Vec<String>,
    moment: Moment<'a>,
    /// Control periods that were recorded in a running environment, and the number of episodes that were left out.
    periods: u64,
    left: u64,
}

/// A run whose episodes can be recorded again.
struct Run<'a> {
    folder: &'a Path,
    subject: Held<'a>,
    /// The rows of the episodes that may be recorded.
    entries: Vec<Entry>,
    /// The episodes so far.
    done: Vec<Done>,
}

/// The subject of a run.
enum Held<'a> {
    /// Made again from the record.
    Again(Box<Subject>),
    /// That of a run which has just ended.
    Running(&'a Subject),
}

impl Held<'_> {
    fn get(&self) -> &Subject {
        match self {
            Self::Again(subject) => subject,
            Self::Running(subject) => subject,
        }
    }
}

/// An episode that was recorded again.
#[derive(Clone)]
struct Done {
    index: u64,
    /// The place in the clips. `None` if it cannot be shown.
    clip: Option<usize>,
    strip: Option<Strip>,
}

/// The episodes of a run that are worth watching. Nothing is recorded for rows without a run's folder, and for a run
/// whose programs `opening` does not permit. With `frames`, images are written too if the environment has a
/// camera.
pub(crate) fn watch(
    source: &Source,
    analysis: &Analysis,
    opening: &Reopening,
    moment: Moment<'_>,
    frames: Option<&Frames>,
) -> anyhow::Result<Watch> {
    let chosen = worth_watching(source, analysis, MAX_CLIPS)?;
    let mut recorder = Recorder::new(moment, Place::Beside);
    recorder.frames = frames;
    let twins = chosen.iter().filter_map(|one| one.twin.as_ref()).map(|twin| twin.episode.index);
    let wanted: Vec<u64> = chosen.iter().map(|one| one.episode.index).chain(twins).collect();
    let run = if chosen.is_empty() { None } else { recorder.add(source.folder(), source, opening, &wanted)? };
    let folder = source.folder().filter(|_| analysis.subject.replayable);
    let mut items = Vec::with_capacity(chosen.len());
    for one in chosen {
        let first = run.and_then(|run| recorder.clip(run, &one.episode));
        let twin = run.and_then(|run| recorder.clip(run, &one.twin.as_ref()?.episode));
        items.push(WatchItem {
            title: one.title,
            why: one.why,
            outcome: mode_label(&one.episode.outcome),
            success: one.episode.outcome.starts_with("success"),
            command: folder.map_or_else(
                || format!("episode {}", one.episode.index),
                |_| command(Path::new(HERE), one.episode.index),
            ),
            beside: one.twin.map_or_else(String::new, |twin| twin.differences),
            clip: first.as_ref().and_then(|done| done.clip),
            second: twin.as_ref().and_then(|done| done.clip),
            strips: [first, twin].into_iter().flatten().filter_map(|done| done.strip).collect(),
        });
    }
    Ok(recorder.finish(items))
}

/// Pairs of episodes with the same scenario and different outcomes, each pair on one clock.
pub(crate) fn compared(
    comparison: &Comparison,
    sources: &[(Source, PathBuf)],
    opening: &Reopening,
) -> anyhow::Result<Watch> {
    let mut recorder = Recorder::new(Moment::OnRequest, Place::Elsewhere);
    let mut items = Vec::new();
    for pair in &comparison.paired {
        let places = [&pair.first, &pair.second]
            .map(|name| comparison.datasets.iter().position(|dataset| dataset.name == *name));
        let [Some(first), Some(second)] = places else { continue };
        if pair.flips.is_empty() {
            continue;
        }
        let room = MAX_PAIRS.saturating_sub(items.len());
        let wanted: Vec<u64> = pair.flips.iter().take(room).map(|flip| flip.index).collect();
        let mut runs = [None; 2];
        for (run, at) in runs.iter_mut().zip([first, second]) {
            if let Some((source, _)) = sources.get(at) {
                *run = recorder.add(source.folder(), source, opening, &wanted)?;
            }
        }
        for flip in pair.flips.iter().take(room) {
            let episode = |outcome: &str| ReplayEpisode {
                index: flip.index,
                stage: String::new(),
                outcome: outcome.to_owned(),
                figure: String::new(),
                parameters: flip.parameters.clone(),
            };
            let clip = runs[0].and_then(|run| recorder.named(run, &episode(&flip.first), &pair.first)?.clip);
            let beside = runs[1].and_then(|run| recorder.named(run, &episode(&flip.second), &pair.second)?.clip);
            items.push(WatchItem {
                title: format!("Episode {}", flip.index),
                why: format!(
                    "{}: {}. {}: {}.",
                    pair.first,
                    mode_label(&flip.first),
                    pair.second,
                    mode_label(&flip.second)
                ),
                outcome: "different outcomes".to_owned(),
                success: false,
                command: flip.replay.first().cloned().unwrap_or_default(),
                beside: String::new(),
                clip,
                second: if clip.is_some() { beside } else { None },
                strips: Vec::new(),
            });
        }
    }
    Ok(recorder.finish(items))
}

/// Where a page is read, for the commands on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    /// Beside the run. The page does not name the folder, so that copies of a run have identical pages.
    Beside,
    /// Anywhere.
    Elsewhere,
}

/// The command that replays an episode of the run in `folder`.
pub(crate) fn command(folder: &Path, index: u64) -> String {
    format!("robogate replay {} {index}", shell_word(&folder.display().to_string()))
}

impl<'a> Recorder<'a> {
    fn new(moment: Moment<'a>, place: Place) -> Self {
        Self {
            place,
            frames: None,
            runs: Vec::new(),
            clips: Vec::new(),
            differing: 0,
            remarks: Vec::new(),
            moment,
            periods: 0,
            left: 0,
        }
    }

    /// Prepares a run, reads the rows of these episodes in one pass, and returns the run's place. `None` with a remark if its episodes cannot be
    /// recorded again.
    fn add(
        &mut self,
        folder: Option<&'a Path>,
        source: &Source,
        opening: &Reopening,
        wanted: &[u64],
    ) -> anyhow::Result<Option<usize>> {
        let at = self.prepare(folder, source, opening);
        if let Some(run) = at.and_then(|at| self.runs.get_mut(at)) {
            let unread = |index: u64| wanted.contains(&index) && run.entries.iter().all(|entry| entry.index() != index);
            let rows = source.dictionary().entries().filter(|row| row.as_ref().map_or(true, |row| unread(row.index())));
            let rows = rows.collect::<Result<Vec<_>, _>>()?;
            run.entries.extend(rows);
        }
        Ok(at)
    }

    /// Prepares a run, and returns its place. `None` with a remark if its episodes cannot be recorded again.
    fn prepare(&mut self, folder: Option<&'a Path>, source: &Source, opening: &Reopening) -> Option<usize> {
        let provenance = source.dictionary().provenance();
        let Some(folder) = folder.filter(|_| provenance.source.is_none()) else {
            self.remarks.push("These rows do not come from a run's folder, so no episode can be shown.".to_owned());
            return None;
        };
        if let Some(at) = self.runs.iter().position(|run| run.folder == folder) {
            return Some(at);
        }
        let page = if self.place == Place::Beside { Path::new(HERE) } else { folder };
        let subject = match self.moment {
            Moment::EndOfRun(Some(running)) if starts_processes(provenance) => Ok(Held::Running(running)),
            Moment::EndOfRun(None) if starts_processes(provenance) => {
                self.remarks.push(at_request("The environment runs in a process of its own", page));
                return None;
            }
            _ => Subject::recorded(provenance, Some(folder), opening).map(|subject| Held::Again(Box::new(subject))),
        };
        match subject {
            Ok(subject) if matches!(self.moment, Moment::EndOfRun(_)) && behind_server(subject.get()) => {
                self.remarks.push(at_request("The policy is behind a server", page));
                None
            }
            Ok(Held::Running(subject)) => {
                self.runs.push(Run { folder, subject: Held::Running(subject), entries: Vec::new(), done: Vec::new() });
                Some(self.runs.len() - 1)
            }
            Ok(Held::Again(subject)) => {
                // The size of images would change what a policy that sees them receives.
                let seeing = subject.policy_source().and_then(PolicySource::profile).is_some();
                let smaller = self.frames.is_some() && !seeing;
                let subject = if smaller { Box::new(subject.with_pictures_of(FRAME_PX)) } else { subject };
                self.runs.push(Run { folder, subject: Held::Again(subject), entries: Vec::new(), done: Vec::new() });
                Some(self.runs.len() - 1)
            }
            Err(why) => {
                note(format_args!("note: the episodes are not replayed: {why}"));
                self.remarks.push(format!(
                    "The episodes are not shown, because they cannot be replayed here: {}.",
                    why.to_string().lines().next().unwrap_or_default().trim_end_matches('.')
                ));
                None
            }
        }
    }

    fn clip(&mut self, run: usize, episode: &ReplayEpisode) -> Option<Done> {
        self.named(run, episode, "Episode")
    }

    /// Records an episode. It has no clip if its replay differs from the record.
    fn named(&mut self, run: usize, chosen: &ReplayEpisode, name: &str) -> Option<Done> {
        let Run { folder, subject, entries, done } = self.runs.get_mut(run)?;
        if let Some(known) = done.iter().find(|known| known.index == chosen.index) {
            return Some(known.clone());
        }
        let mut strip = None;
        let before = entries.iter().find(|entry| entry.index() == chosen.index).context("its row is missing");
        if let (Held::Running(_), Ok(before)) = (&*subject, &before) {
            let periods = self.periods + u64::from(before.episode.ticks);
            if periods > END_PERIODS {
                self.left += 1;
                done.push(Done { index: chosen.index, clip: None, strip: None });
                return None;
            }
            self.periods = periods;
        }
        let subject = subject.get();
        let again = before.and_then(|before| Again::of(subject, &before.episode, self.frames.is_some()));
        let clip = match again {
            Ok(Some(again)) => {
                let shots = &again.shots;
                match self.frames.map(|frames| write_strip(frames, &again.recording, chosen.index, shots)) {
                    Some(Ok(written)) => strip = written,
                    Some(Err(why)) => {
                        self.remarks.push(format!("Episode {} has no frames: {why:#}.", chosen.index));
                    }
                    None => {}
                }
                let title = if name == "Episode" {
                    format!("Episode {}", chosen.index)
                } else {
                    format!("{name}, episode {}", chosen.index)
                };
                let folder = if self.place == Place::Beside { Path::new(HERE) } else { folder };
                self.clips.push(again.labelled(title, command(folder, chosen.index)));
                Some(self.clips.len() - 1)
            }
            Ok(None) => {
                self.differing += 1;
                None
            }
            Err(why) => {
                let why = why.to_string();
                self.remarks.push(format!("Episode {} is not shown: {why}.", chosen.index));
                None
            }
        };
        let one = Done { index: chosen.index, clip, strip };
        done.push(one.clone());
        Some(one)
    }

    fn finish(mut self, items: Vec<WatchItem>) -> Watch {
        if self.differing > 0 {
            self.remarks.push(format!(
                "{} not shown, because the replay differs from the record: the tool, the engine, the platform or the policy \
                 is another one, or the policy is not deterministic.",
                counted(self.differing, "episode")
            ));
        }
        if self.left > 0 {
            self.remarks.push(format!(
                "{} not recorded at the end of the run, which records {END_PERIODS} control periods. `robogate report {HERE}` records \
                 them all.",
                counted_are(self.left, "episode")
            ));
        }
        let clips = self.clips;
        if !clips.is_empty() && clips.iter().all(|clip| clip.recording.trajectory.is_none()) {
            let what = if clips.iter().any(|clip| !clip.film.is_empty()) {
                "images of its first camera"
            } else {
                "signals and events"
            };
            self.remarks
                .push(format!("This environment offers no geometry, so the viewer shows {what} without a 3-D view."));
        }
        let reel = (!clips.is_empty()).then(|| reel(&clips));
        if let Some(reel) = reel.as_ref().filter(|reel| reel.simplified > 0) {
            let meshes = if reel.simplified == 1 {
                "1 mesh is shown as a box".to_owned()
            } else {
                format!("{} meshes are shown as boxes", reel.simplified)
            };
            self.remarks.push(format!("{meshes}, because the page has a budget for meshes."));
        }
        Watch { items, reel, remarks: self.remarks }
    }
}

/// So many things, with the verb.
fn counted_are(n: u64, thing: &str) -> String {
    format!("{} {}", counted(n, thing), if n == 1 { "is" } else { "are" })
}

/// Why nothing is recorded at the end of a run, and how to record it.
fn at_request(because: &str, folder: &Path) -> String {
    let folder = shell_word(&folder.display().to_string());
    format!("{because}, so its episodes are not recorded at the end of a run. `robogate report {folder}` records them.")
}

/// Whether the policy is behind a server.
fn behind_server(subject: &Subject) -> bool {
    subject.policy_source().and_then(PolicySource::profile).is_some_and(|profile| !profile.dialect.is_file())
}

/// An episode that was recorded again.
pub(crate) struct Again {
    recording: Recording,
    /// Images at equal distances in time, for a strip of frames.
    shots: Vec<Shot>,
    /// Images of an episode without the motion of its bodies.
    film: Vec<FilmFrame>,
}

impl Again {
    /// Records an episode again, with frames for a strip on request. An environment without geometry is filmed by its first
    /// camera. `None` if the episode differs from the record.
    pub(crate) fn of(subject: &Subject, before: &Episode, strip: bool) -> anyhow::Result<Option<Self>> {
        let (recording, shots) = filmed(subject, before, if strip { FRAMES } else { 0 })?;
        if let Some(fault) = not_run(before, &recording.episode) {
            return Err(fault.clone().into());
        }
        if !recording.episode.repeats(before) {
            return Ok(None);
        }
        let mut film = Vec::new();
        if recording.trajectory.is_none() && !subject.task().observation.cameras.is_empty() {
            film = film::film(&filmed(subject, before, FILM_FRAMES)?.1)?;
        }
        Ok(Some(Self { recording, shots, film }))
    }

    /// The recording with its labels on a page.
    pub(crate) fn labelled(self, title: String, command: String) -> Clip {
        let Self { recording, film, .. } = self;
        let show = |value: &Value| match value {
            Value::Number(x) => number(*x),
            other => other.to_string(),
        };
        let parameters = recording.episode.scenario.requested.iter();
        Clip {
            title,
            outcome: mode_label(recording.episode.outcome.as_str()),
            success: recording.episode.outcome == Outcome::Success,
            parameters: parameters
                .map(|(name, value)| (parameter_label(name), value_with_unit(&show(value), name)))
                .collect(),
            command,
            recording,
            film,
        }
    }
}

/// The fault because of which a valid episode could not run again. Such a replay does not differ from the record: it says
/// nothing about it.
pub(crate) fn not_run<'a>(before: &Episode, again: &'a Episode) -> Option<&'a Fault> {
    match (&before.outcome, &again.outcome) {
        (Outcome::Success | Outcome::Failure(_), Outcome::Invalid(fault)) => {
            matches!(fault.kind, FaultKind::Setup | FaultKind::Unavailable).then_some(fault)
        }
        _ => None,
    }
}

/// Records an episode again, with so many images at equal distances in time.
fn filmed(subject: &Subject, before: &Episode, images: u32) -> anyhow::Result<(Recording, Vec<Shot>)> {
    let mut worker = subject.worker().map_err(|fault| anyhow::anyhow!("{fault}"))?;
    // The last observation. A policy that gives up ends an episode before the time of its ending.
    let end_s = f64::from(before.ticks) * worker.environment.task().control_period_s;
    let times: Vec<f64> = (0..images).map(|i| end_s * f64::from(i) / f64::from(images - 1)).collect();
    let mut filmed = Filmed::at(&mut *worker.environment, Cameras::First, &times);
    let recording = record(&mut filmed, &mut *worker.policy, &before.scenario);
    // An environment that cannot render has no images.
    Ok((recording, std::mem::take(&mut filmed.shots)))
}

/// Writes frames of an episode. `None` without frames.
fn write_strip(frames: &Frames, recording: &Recording, index: u64, shots: &[Shot]) -> anyhow::Result<Option<Strip>> {
    let (Some(first), Some(last)) = (shots.first(), shots.last()) else { return Ok(None) };
    let name = format!("episode-{index}.png");
    let image = film::strip(&shots.iter().collect::<Vec<_>>());
    let path = frames.folder.join(&name);
    files::create_folders(&frames.folder)
        .and_then(|()| files::write(&path, picture::png(&image).map_err(std::io::Error::other)?))
        .with_context(|| format!("cannot write {}", path.display()))?;
    let alt = format!(
        "Episode {index}, {}: {} from {:.2} s to {:.2} s",
        mode_label(recording.episode.outcome.as_str()),
        counted(shots.len() as u64, "frame"),
        first.time_s,
        last.time_s
    );
    Ok(Some(Strip { file: format!("{}/{name}", frames.link), alt }))
}
