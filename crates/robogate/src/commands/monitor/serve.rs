//! `robogate monitor serve`: connects feeds, outputs and the store.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::{Context, anyhow};
use clap::Args;
use robogate_dictionary::{hex, read_text};
use robogate_monitor::service::{
    Batch, Broker, Deliver, Handle, HttpError, Intake, Output, Periods, Replays, ServiceEngine, Store, Taken,
    diagnostics, json_lines, otlp, serve, subscribe, webhook,
};
use robogate_monitor::{Level, Monitor};
use robogate_policy::TextSocket;
use robogate_session::read_detector;
use sha2::{Digest, Sha256};

use super::bag::{Found, cycles, files, is_bag};
use super::results::{OfRows, is_dictionary, say_left_out};
use super::rosbridge::connect;
use super::simulated::simulated;
use super::{Watched, topic_map};
use crate::exit::{DONE, Exit, FAIL, INFRASTRUCTURE, INVALID, OrExit};
use crate::terminal::{foreign, grouped, note};

/// Lines of a feed that are processed together.
const TOGETHER: u64 = 1_000;
/// Time until a feed tries again.
const RETRY_AFTER: Duration = Duration::from_secs(5);
/// Longest line of a feed, in bytes.
const LONGEST_LINE: usize = 1 << 20;

/// Ingest cycle records and raise alarms.
///
/// Cycles come from a file or pipe (JSON Lines), by HTTP (POST /v1/cycles), by MQTT, from ROS 2 topics (rosbridge), or from
/// a recording (MCAP, rosbag2). Alarms go to stdout as JSON Lines, and optionally to webhooks, OpenTelemetry, MQTT and ROS 2. Acknowledged cycles are in the store. With only a file or pipe, the
/// command ends with it: exit code 1 if a critical alarm of a detector is active, if lines were refused or if ids are missing,
/// 4 if there was no cycle.
#[derive(Debug, Args)]
pub(super) struct Serve {
    /// Read cycles from this file or pipe as JSON Lines, - for stdin; from a dictionary (Parquet), such as one of `robogate import`; or,
    /// with --topics, from an MCAP file or a folder of rosbag2
    feed: Option<PathBuf>,
    /// Store cycles, statistics and alarms in this SQLite file; default: in memory
    #[arg(long, value_name = "FILE")]
    store: Option<PathBuf>,
    /// Serve HTTP at this address, for example 127.0.0.1:7380: /v1/cycles, /v1/status, /metrics, /healthz and the page
    /// at /
    #[arg(long, value_name = "ADDRESS", requires = "store")]
    listen: Option<SocketAddr>,
    /// Read the bearer token from this file; required if other machines can connect
    #[arg(long, value_name = "FILE", requires = "listen")]
    token_file: Option<PathBuf>,
    /// Send each alarm by POST to this URL; can be repeated
    #[arg(long, value_name = "URL")]
    webhook: Vec<String>,
    /// Send each alarm as an OpenTelemetry log (OTLP over HTTP, JSON) to this collector, for example http://127.0.0.1:4318
    #[arg(long, value_name = "URL")]
    otlp: Vec<String>,
    /// Connect to this MQTT broker; user and password come from ROBOGATE_MQTT_USER and ROBOGATE_MQTT_PASSWORD
    #[arg(long, value_name = "HOST:PORT")]
    mqtt: Option<String>,
    /// Subscribe to cycles on this MQTT topic
    #[arg(long, value_name = "TOPIC", requires_all = ["mqtt", "store"])]
    mqtt_cycles: Option<String>,
    /// Publish alarms on this MQTT topic
    #[arg(long, value_name = "TOPIC", requires = "mqtt")]
    mqtt_alarms: Option<String>,
    /// Connect to this rosbridge server (ROS 2), for example ws://cell:9090
    #[arg(long, value_name = "URL")]
    rosbridge: Option<String>,
    /// Read from this file (TOML) which messages of topics are cycles, with --rosbridge and --store or for a recording
    #[arg(long, value_name = "FILE")]
    topics: Option<PathBuf>,
    /// Publish alarms on this ROS topic as diagnostic_msgs/msg/DiagnosticArray, for example /diagnostics
    #[arg(long, value_name = "TOPIC", requires = "rosbridge")]
    diagnostics: Option<String>,
    /// Compare failed cycles on the page with the episodes of this run, by the parameters that the cycles report; default:
    /// the runs that the references name, if they are still there
    #[arg(long, value_name = "RUN", requires = "listen")]
    episodes: Option<PathBuf>,
    /// Warn within episodes with this detector of `robogate warn train`: control periods come by HTTP (POST /v1/periods), by MQTT, from
    /// --periods, or from the messages that [period] of --topics names
    #[arg(long, value_name = "FILE")]
    warner: Option<PathBuf>,
    /// Read control periods from this file or pipe as JSON Lines
    #[arg(long, value_name = "FILE", requires = "warner")]
    periods: Option<PathBuf>,
    /// Subscribe to control periods on this MQTT topic
    #[arg(long, value_name = "TOPIC", requires_all = ["mqtt", "warner", "store"])]
    mqtt_periods: Option<String>,
    #[command(flatten)]
    watched: Watched,
}

/// An event that ends the command.
enum End {
    /// The feed ended, or failed.
    Feed(Result<Taken, String>),
    /// The file of control periods ended, or failed: accepted and rejected lines, and warnings.
    Periods(Result<[u64; 3], String>),
    /// The HTTP server ended.
    Http(Result<(), HttpError>),
    /// The process received a signal.
    Signal,
}

impl Serve {
    pub(super) fn execute(&self) -> Result<u8, Exit> {
        let (settings, referred) = self.watched.settings()?;
        let topics = self.topics.as_deref().map(topic_map).transpose()?;
        self.rosbridge.as_deref().map(TextSocket::check).transpose().context("--rosbridge").or_usage()?;
        let bag = self.feed.as_deref().filter(|feed| is_bag(feed) && !is_dictionary(feed));
        self.check_topics(bag).or_usage()?;
        let subscribes = self.mqtt_cycles.is_some() || self.mqtt_periods.is_some();
        let serves = self.listen.is_some() || subscribes || topics.is_some() && bag.is_none();
        if topics.as_ref().is_some_and(|map| map.period.is_some()) && self.warner.is_none() {
            return Err(anyhow!("--topics: [period] needs a detector\nHint: add --warner FILE")).or_usage();
        }
        if self.feed.is_none() && self.periods.is_none() && !serves {
            let hint = "no source of cycles\nHint: give a file (or - for stdin), --listen, --mqtt-cycles or --topics";
            return Err(anyhow!(hint)).or_usage();
        }
        let token = self.token_file.as_deref().map(token).transpose()?;
        let broker = self.mqtt.as_deref().map(broker).transpose()?;
        let store = match &self.store {
            Some(path) => Store::open(path, settings.store).with_context(|| format!("{}", path.display())),
            None => Store::in_memory(settings.store).map_err(anyhow::Error::from),
        };
        let monitor = Monitor::new(settings.detectors).or_usage()?;
        let mut intake = Intake::open(store.or_broken()?, monitor, settings.late_after_s).or_broken()?;
        intake = intake.with_new_recipes_per_hour(settings.new_recipes_per_hour);
        if let Some(path) = &self.warner {
            let (file, text) = read_detector(path)?;
            let sha256 = hex(&Sha256::digest(text));
            intake = intake.with_warner(file, sha256).or_broken()?.or_usage()?;
        }
        let mut replays = None;
        if self.listen.is_some() {
            let simulated = simulated(self.episodes.as_deref(), &referred)?;
            for (recipe, episodes) in simulated.episodes {
                intake = intake.with_episodes(recipe, episodes);
            }
            replays = simulated.replays;
        }
        let engine = ServiceEngine::open(intake, |text| note(text));
        let ending = Arc::new(AtomicBool::new(false));
        let outputs = self.outputs(&engine, broker.as_ref())?;
        let (sender, receiver) = channel();
        let signal = sender.clone();
        ctrlc::set_handler(move || {
            // The receiver may be gone at the end.
            let _ = signal.send(End::Signal);
        })
        .or_broken()?;
        let server = self
            .listen
            .map(|address| http(address, token, &settings.http, engine.handle(), replays.take(), sender.clone()));
        let of_periods = broker.as_ref().zip(self.mqtt_periods.clone()).map(|(broker, topic)| {
            broker.subscribe_periods(topic, engine.handle(), Arc::clone(&ending), |problem| note(problem))
        });
        let subscribers = [
            broker.zip(self.mqtt_cycles.clone()).map(|(broker, topic)| {
                broker.subscribe(topic, engine.handle(), Arc::clone(&ending), |problem| note(problem))
            }),
            of_periods,
            self.rosbridge.as_deref().zip(topics.clone().filter(|_| bag.is_none())).map(|(url, map)| {
                subscribe(map, connect(url), engine.handle(), Arc::clone(&ending), |problem| note(problem))
            }),
        ];
        match (&self.feed, bag.zip(topics)) {
            (_, Some((bag, map))) => {
                let bag = bag.to_owned();
                read_found(move |each| cycles(&bag, map, each), engine.handle(), sender.clone(), serves);
            }
            (Some(path), None) if is_dictionary(path) => {
                let path = path.clone();
                let rows = move |each: &mut dyn FnMut(Found) -> Result<(), String>| {
                    OfRows::default().cycles(&path, each).map(say_left_out).map_err(|why| format!("{why:#}"))
                };
                read_found(rows, engine.handle(), sender.clone(), serves);
            }
            (Some(path), None) => read(path, engine.handle(), sender.clone(), serves)?,
            (None, None) => {}
        }
        if let Some(path) = self.periods.clone() {
            read_periods(path, engine.handle(), sender);
        }
        let mut waits = usize::from(self.feed.is_some()) + usize::from(self.periods.is_some());
        let mut code = DONE;
        let mut broken = None;
        while let Ok(end) = receiver.recv() {
            match end {
                End::Periods(Ok([accepted, rejected, warnings])) => {
                    let counts = [accepted, rejected, warnings].map(grouped);
                    note(format_args!(
                        "{} control periods accepted, {} rejected, {} warnings",
                        counts[0], counts[1], counts[2]
                    ));
                    waits -= 1;
                    if rejected > 0 {
                        code = FAIL;
                    }
                    if !serves && waits == 0 {
                        break;
                    }
                }
                End::Feed(Ok(taken)) => {
                    say(&taken);
                    waits -= 1;
                    if !serves {
                        let of_periods = std::mem::replace(&mut code, DONE);
                        code = match taken.accepted + taken.duplicates {
                            0 => INVALID,
                            // The detectors did not see all cycles.
                            _ if taken.refused + taken.gaps > 0 => FAIL,
                            _ => exit_code(&engine).max(of_periods),
                        };
                        if waits == 0 {
                            break;
                        }
                    }
                }
                End::Feed(Err(because)) | End::Periods(Err(because)) => {
                    broken = Some(anyhow!(because));
                    break;
                }
                End::Http(Err(error)) => {
                    broken = Some(error.into());
                    break;
                }
                End::Http(Ok(())) | End::Signal => break,
            }
        }
        ending.store(true, Ordering::Release);
        if let Some((stop, thread)) = server {
            // The server may have ended already.
            let _ = stop.send(());
            let _ = thread.join();
        }
        for thread in subscribers.into_iter().flatten() {
            let _ = thread.join();
        }
        outputs.into_iter().for_each(Output::end);
        let store = self.store.as_deref().unwrap_or(Path::new("the store")).display();
        engine.close().map_err(|because| anyhow!("{store}: {because}")).or_broken()?;
        match broken {
            Some(error) if matches!(error.downcast_ref(), Some(HttpError::NoToken(_) | HttpError::ShortToken(_))) => {
                Err(error).or_usage()
            }
            Some(error) => Err(Exit { code: INFRASTRUCTURE, error }),
            None => Ok(code),
        }
    }

    /// Checks that `--topics` is given where messages come in, and only there.
    fn check_topics(&self, bag: Option<&Path>) -> anyhow::Result<()> {
        match (bag, &self.topics, &self.rosbridge) {
            (Some(bag), None, _) => {
                // A folder may be no recording at all.
                files(bag).map_err(anyhow::Error::msg)?;
                let bag = bag.display();
                Err(anyhow!(
                    "{bag}: which of its messages are cycles?\nHint: describe them in a TOML file, --topics FILE"
                ))
            }
            (Some(bag), Some(_), _) => files(bag).map(drop).map_err(anyhow::Error::msg),
            (None, Some(_), None) => {
                Err(anyhow!("--topics: no messages\nHint: add --rosbridge URL, or a recording (MCAP, rosbag2)"))
            }
            (None, Some(_), Some(_)) if self.store.is_none() => {
                Err(anyhow!("--rosbridge: no store\nHint: add --store FILE"))
            }
            _ => Ok(()),
        }
    }

    fn outputs(&self, engine: &ServiceEngine, broker: Option<&Broker>) -> Result<Vec<Output>, Exit> {
        let mut all: Vec<(String, Deliver)> = vec![("stdout".to_owned(), json_lines(std::io::stdout()))];
        all.extend(self.webhook.iter().map(|url| (format!("webhook {url}"), webhook(url.clone()))));
        all.extend(self.otlp.iter().map(|url| (format!("otlp {url}"), otlp(url, |problem| note(problem)))));
        if let (Some(broker), Some(topic)) = (broker, &self.mqtt_alarms) {
            all.push((format!("mqtt {topic}"), broker.alarms(topic.clone())));
        }
        if let (Some(url), Some(topic)) = (&self.rosbridge, &self.diagnostics) {
            all.push((format!("rosbridge {topic}"), diagnostics(topic.clone(), connect(url))));
        }
        let start = |(name, deliver)| Output::start(name, engine.handle(), deliver, |problem| note(problem));
        all.into_iter().map(start).collect::<Result<_, _>>().or_broken()
    }
}

fn http(
    address: SocketAddr,
    token: Option<String>,
    settings: &robogate_monitor::service::HttpSettings,
    engine: Handle,
    replays: Option<Replays>,
    sender: Sender<End>,
) -> (tokio::sync::oneshot::Sender<()>, JoinHandle<()>) {
    let (stop, stopped) = tokio::sync::oneshot::channel();
    let settings = *settings;
    let thread = std::thread::spawn(move || {
        let listening = |address| note(format_args!("Listening on http://{address}"));
        let ended = serve(address, token, settings, engine, replays, listening, stopped);
        let _ = sender.send(End::Http(ended));
    });
    (stop, thread)
}

/// Reads the token. A file that all users can read is refused. Its group may read it, because the credentials that a
/// service manager hands over have that mode.
fn token(path: &Path) -> Result<String, Exit> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let metadata = std::fs::metadata(path).with_context(|| format!("cannot read {}", path.display())).or_usage()?;
        let mode = metadata.permissions().mode() & 0o777;
        if mode & 0o027 != 0 {
            let path = path.display();
            return Err(anyhow!(
                "--token-file {path}: other users can read it (mode {mode:03o})\nHint: chmod 600 {path}, and choose a new token if it was exposed"
            ))
            .or_usage();
        }
    }
    let text = read_text(path).with_context(|| format!("cannot read {}", path.display())).or_usage()?;
    Ok(text.trim().to_owned())
}

fn broker(place: &str) -> Result<Broker, Exit> {
    let (host, port) = place.rsplit_once(':').unwrap_or((place, "1883"));
    let port = port.parse().with_context(|| format!("--mqtt {place}: `{port}` is not a port number")).or_usage()?;
    let login = std::env::var("ROBOGATE_MQTT_USER").ok().zip(std::env::var("ROBOGATE_MQTT_PASSWORD").ok());
    Ok(Broker { host: host.to_owned(), port, client: "robogate-monitor".to_owned(), login })
}

/// Reads a feed on its own thread, because a pipe may wait for its writer.
fn read(path: &Path, engine: Handle, sender: Sender<End>, wait: bool) -> Result<(), Exit> {
    let path = path.to_owned();
    if path != Path::new("-") {
        std::fs::metadata(&path).with_context(|| format!("cannot read {}", path.display())).or_usage()?;
    }
    std::thread::spawn(move || {
        let reader: Result<Box<dyn BufRead>, String> = if path == Path::new("-") {
            Ok(Box::new(BufReader::new(std::io::stdin())))
        } else {
            File::open(&path)
                .map(|file| -> Box<dyn BufRead> { Box::new(BufReader::with_capacity(1 << 20, file)) })
                .map_err(|error| format!("cannot read {}: {error}", path.display()))
        };
        let _ = sender.send(End::Feed(reader.and_then(|reader| follow(reader, &engine, wait))));
    });
    Ok(())
}

/// Processes lines as they arrive, up to a thousand at a time. A line that is too long is refused.
///
/// `wait`: while the store fails the feed waits, because other clients are served; otherwise the feed ends.
fn follow(mut reader: Box<dyn BufRead>, engine: &Handle, wait: bool) -> Result<Taken, String> {
    let mut all = Taken::default();
    // Complete lines and the start of the next one, and where that starts.
    let (mut batch, mut begun) = (Vec::new(), 0);
    let (mut lines, mut before, mut too_long) = (0, 0, false);
    loop {
        let waiting = reader.fill_buf().map_err(|error| format!("the feed cannot be read: {error}"))?;
        let ended = waiting.is_empty();
        let end = waiting.iter().position(|byte| *byte == b'\n');
        let used = end.map_or(waiting.len(), |at| at + 1);
        if !too_long {
            batch.extend_from_slice(waiting.get(..used).unwrap_or_default());
        }
        // If the next line is not here yet, process the batch without it.
        let more = waiting.get(used..).is_some_and(|rest| rest.contains(&b'\n'));
        reader.consume(used);
        if batch.len() - begun > LONGEST_LINE {
            note(format_args!("line {}: longer than {LONGEST_LINE} bytes", before + lines + 1));
            batch.truncate(begun);
            all.refused += 1;
            too_long = true;
        }
        if end.is_some() {
            if too_long {
                // An empty line keeps the line numbers right.
                batch.push(b'\n');
                too_long = false;
            }
            begun = batch.len();
            lines += 1;
        }
        if (ended || end.is_some() && (lines >= TOGETHER || !more)) && !batch.is_empty() {
            let taken = {
                let batch = std::mem::take(&mut batch);
                let batch = Batch::parse(&batch).map_err(|error| error.to_string())?.after(before);
                take(|| engine.take_parsed(batch.clone()), wait)?
            };
            for refused in &taken.refusals {
                note(format_args!("line {}: {}", refused.line, refused.because));
            }
            all.add(&taken);
            before += lines;
            (lines, begun) = (0, 0);
        }
        if ended {
            return Ok(all);
        }
    }
}

/// Reads cycles and control periods from a source on its own thread, up to a thousand cycles at a time.
fn read_found(
    source: impl FnOnce(&mut dyn FnMut(Found) -> Result<(), String>) -> Result<(), String> + Send + 'static,
    engine: Handle,
    sender: Sender<End>,
    wait: bool,
) {
    std::thread::spawn(move || {
        let (mut all, mut waiting, mut before) = (Taken::default(), Vec::new(), 0);
        let mut flush = |waiting: &mut Vec<_>| {
            let batch = Batch::of(std::mem::take(waiting)).after(before);
            let taken = take(|| engine.take_parsed(batch.clone()), wait)?;
            for refused in &taken.refusals {
                note(format_args!("cycle {}: {}", refused.line, refused.because));
            }
            before += taken.accepted + taken.duplicates + taken.refused;
            all.add(&taken);
            Ok(())
        };
        let mut periods = [0; 3];
        let read = source(&mut |found| match found {
            Found::Cycle(cycle) => {
                waiting.push(cycle);
                if waiting.len() as u64 >= TOGETHER { flush(&mut waiting) } else { Ok(()) }
            }
            Found::Periods(found, now_s) => {
                // An alarm of the cycles before suspends warnings.
                if !waiting.is_empty() {
                    flush(&mut waiting)?;
                }
                hear(&engine, Periods::of(found, now_s), 0, &mut periods)
            }
        });
        if periods != [0; 3] {
            let counts = periods.map(grouped);
            note(format_args!(
                "{} control periods accepted, {} rejected, {} warnings",
                counts[0], counts[1], counts[2]
            ));
        }
        // The cycles before a damaged place count.
        let read = flush(&mut waiting).and(read);
        let _ = sender.send(End::Feed(read.map(|()| all)));
    });
}

/// Reads control periods on their own thread, because a pipe may wait for its writer. Each line is processed at once.
fn read_periods(path: PathBuf, engine: Handle, sender: Sender<End>) {
    std::thread::spawn(move || {
        let unreadable = |error: std::io::Error| format!("cannot read {}: {error}", path.display());
        let read = || {
            let mut reader: Box<dyn BufRead> = if path == Path::new("-") {
                Box::new(BufReader::new(std::io::stdin()))
            } else {
                Box::new(BufReader::new(File::open(&path).map_err(unreadable)?))
            };
            let (mut counts, mut line, mut text) = ([0; 3], 0, Vec::new());
            loop {
                text.clear();
                let read =
                    reader.by_ref().take(LONGEST_LINE as u64).read_until(b'\n', &mut text).map_err(unreadable)?;
                if read == 0 {
                    return Ok(counts);
                }
                let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
                let periods = Periods::parse(&text, now).map_err(|error| error.to_string())?;
                hear(&engine, periods, line, &mut counts)?;
                line += 1;
            }
        };
        let _ = sender.send(End::Periods(read()));
    });
}

/// Processes control periods after so many lines of their file, and counts accepted and rejected ones and warnings.
fn hear(engine: &Handle, periods: Periods, before: u64, counts: &mut [u64; 3]) -> Result<(), String> {
    /// Rejected lines that are shown.
    const SHOWN: u64 = 10;
    let heard = engine.hear(periods)?;
    for of in heard.rejections.iter().take_while(|_| counts[1] < SHOWN) {
        note(format_args!("control period {}: {}", before + of.line, foreign(&of.because)));
    }
    let new = [heard.accepted, heard.rejected, heard.warnings.len() as u64];
    counts.iter_mut().zip(new).for_each(|(count, new)| *count += new);
    Ok(())
}

fn take(take: impl Fn() -> Result<Taken, String>, wait: bool) -> Result<Taken, String> {
    loop {
        match take() {
            Err(because) if wait => {
                note(format_args!("the feed waits: {because}"));
                std::thread::sleep(RETRY_AFTER);
            }
            answer => return answer,
        }
    }
}

fn say(taken: &Taken) {
    note(format_args!(
        "{} cycles accepted, {} duplicates, {} out of order ({} late), {} outside the validated region, {} gaps, {} refused",
        grouped(taken.accepted),
        grouped(taken.duplicates),
        grouped(taken.out_of_order),
        grouped(taken.late),
        grouped(taken.outside),
        grouped(taken.gaps),
        grouped(taken.refused)
    ));
}

/// Exit code 1 while a critical alarm is active.
fn exit_code(engine: &ServiceEngine) -> u8 {
    let critical = |status: robogate_monitor::service::Status| {
        status.recipes.iter().any(|recipe| recipe.level == Some(Level::Critical))
    };
    if engine.handle().status().is_ok_and(critical) { FAIL } else { DONE }
}
