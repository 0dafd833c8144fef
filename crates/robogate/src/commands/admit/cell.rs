//! What a cell declares beside its policy: cameras, latency and robot, compared with the judged ones.

use std::fs::File;
use std::io::{BufReader, Cursor, Read};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use clap::Args;
use robogate_campaign::folder::DICTIONARY;
use robogate_core::Domain;
use robogate_core::guard::guarded;
use robogate_core::latency::{LATENCY_PARAMETER, Latency};
use robogate_dictionary::{Dictionary, Provenance};
use robogate_policy::{CellImage, Fingerprint, compare_camera};
use robogate_session::{duration, identity, robot};
use robogate_stats::format::number;

use crate::exit::{Exit, OrExit};
use crate::terminal::{foreign, note};

/// Largest image in bytes, and in pixels along each side.
const MOST_BYTES: u64 = 32 << 20;
const MOST_PIXELS: u32 = 8_192;
/// Time for an image from an address.
const FETCH: Duration = Duration::from_secs(10);
/// The share of a control period up to which a latency counts as none.
const NO_LATENCY: f64 = 0.1;
/// The share of a normal or gamma distribution that counts as judged, as standard deviations from the mean.
const DEVIATIONS: f64 = 2.0;

/// What the cell declares.
#[derive(Debug, Args)]
pub(super) struct CellArguments {
    /// Compare an image of a camera of the cell with those that the judged policy got: NAME=FILE (PNG or JPEG) or NAME=URL of a
    /// snapshot (http, https). Its size, orientation and colours are compared; can be repeated
    #[arg(long, value_name = "NAME=IMAGE|URL")]
    camera: Vec<String>,
    /// Time from an observation to the action in the cell, such as 80ms: another number of control periods than judged is refused;
    /// default: not checked
    #[arg(long, value_name = "TIME", value_parser = duration::seconds)]
    latency: Option<f64>,
    /// Robot of the cell: a built-in one, the folder of its files, or its name; another one than judged is refused; default: not checked
    #[arg(long, value_name = "NAME|FOLDER")]
    robot: Option<String>,
}

impl CellArguments {
    /// Whether something is declared.
    pub(super) fn any(&self) -> bool {
        !self.camera.is_empty() || self.latency.is_some() || self.robot.is_some()
    }

    /// The differences, in words. `folder` is that of the gate or of its evidence.
    pub(super) fn differences(&self, folder: &Path, fingerprint: Option<&Fingerprint>) -> Result<Vec<String>, Exit> {
        if !self.any() {
            return Ok(Vec::new());
        }
        let rows = folder.join(DICTIONARY);
        if !rows.is_file() {
            return Err(anyhow!(
                "{}: --camera, --latency and --robot need the folder of the gate or of its evidence, with {DICTIONARY}",
                foreign(folder.display())
            ))
            .or_usage();
        }
        let dictionary = Dictionary::open(&rows).or_usage()?;
        let judged = dictionary.provenance();
        let mut differences = Vec::new();
        for camera in &self.camera {
            differences.extend(of_camera(camera, judged, fingerprint).or_usage()?);
        }
        if let Some(latency_s) = self.latency {
            differences.extend(of_latency(latency_s, judged));
        }
        if let Some(named) = &self.robot {
            differences.extend(of_robot(named, judged).or_usage()?);
        }
        Ok(differences)
    }

    /// What is not checked, as options.
    pub(super) fn missing(&self) -> Vec<&'static str> {
        let options = [
            (self.camera.is_empty(), "--camera"),
            (self.latency.is_none(), "--latency"),
            (self.robot.is_none(), "--robot"),
        ];
        options.into_iter().filter_map(|(missing, option)| missing.then_some(option)).collect()
    }
}

fn of_camera(camera: &str, judged: &Provenance, fingerprint: Option<&Fingerprint>) -> anyhow::Result<Vec<String>> {
    let Some((name, place)) = camera.split_once('=').filter(|(name, place)| !name.is_empty() && !place.is_empty())
    else {
        bail!("--camera {camera}: expected NAME=FILE or NAME=URL");
    };
    let Some(fingerprint) = fingerprint else {
        bail!("--camera {camera}: the gate has no fingerprint with images of its cameras");
    };
    let image = image(place).with_context(|| format!("--camera {camera}"))?;
    let cameras = &judged.task.observation.cameras;
    let native = |name: &str| {
        let spec = cameras.iter().find(|of| of.name == name)?;
        Some([spec.width, spec.height])
    };
    let check = compare_camera(fingerprint, name, &image, native);
    if !check.told && check.differences.is_empty() {
        note(format_args!(
            "camera {}: orientation and colours cannot be told, because the image is not like the judged ones in one reading only",
            foreign(name)
        ));
    }
    Ok(check.differences)
}

/// Reads an image from a file or an address. It may be wrong in any way.
fn image(place: &str) -> anyhow::Result<CellImage> {
    let mut bytes = Vec::new();
    if place.starts_with("http://") || place.starts_with("https://") {
        let agent: ureq::Agent =
            ureq::Agent::config_builder().timeout_global(Some(FETCH)).max_redirects(0).build().into();
        let mut answer = agent.get(place).call().map_err(|error| anyhow!("no image: {error}"))?;
        bytes = answer
            .body_mut()
            .with_config()
            .limit(MOST_BYTES)
            .read_to_vec()
            .map_err(|error| anyhow!("no image: {error}"))?;
    } else if place.contains("://") {
        bail!("expected a file, or an address with http or https that answers with an image");
    } else {
        File::open(PathBuf::from(place)).context("cannot be read")?.take(MOST_BYTES + 1).read_to_end(&mut bytes)?;
    }
    if bytes.len() as u64 > MOST_BYTES {
        bail!("the image has more than {} MiB", MOST_BYTES >> 20);
    }
    let read = guarded(|| if bytes.starts_with(b"\x89PNG") { of_png(&bytes) } else { of_jpeg(&bytes) });
    read.map_err(|why| anyhow!("not a readable image: {why}"))?
}

fn of_png(bytes: &[u8]) -> anyhow::Result<CellImage> {
    let mut decoder = png::Decoder::new(BufReader::new(Cursor::new(bytes)));
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info().context("not a readable PNG image")?;
    let (width, height) = (reader.info().width, reader.info().height);
    check_size(width, height)?;
    let size = reader.output_buffer_size().context("the image is too large")?;
    let mut pixels = vec![0; size];
    let info = reader.next_frame(&mut pixels).context("not a readable PNG image")?;
    let channels = info.color_type.samples();
    let pixels = pixels.get(..info.buffer_size()).unwrap_or_default();
    let rgb = pixels.chunks_exact(channels).flat_map(|pixel| match pixel {
        [r, g, b, ..] => [*r, *g, *b],
        [grey, ..] => [*grey; 3],
        [] => [0; 3],
    });
    Ok(CellImage { width: width as usize, height: height as usize, rgb: rgb.collect() })
}

fn of_jpeg(bytes: &[u8]) -> anyhow::Result<CellImage> {
    use zune_jpeg::JpegDecoder;
    use zune_jpeg::zune_core::bytestream::ZCursor;
    use zune_jpeg::zune_core::colorspace::ColorSpace;
    use zune_jpeg::zune_core::options::DecoderOptions;

    let most = MOST_PIXELS as usize;
    let options = DecoderOptions::default().set_max_width(most).set_max_height(most);
    let options = options.jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    let rgb = decoder.decode().map_err(|why| anyhow!("not a PNG or JPEG image: {why:?}"))?;
    let (width, height) = decoder.dimensions().context("not a PNG or JPEG image")?;
    check_size(u32::try_from(width)?, u32::try_from(height)?)?;
    Ok(CellImage { width, height, rgb })
}

fn check_size(width: u32, height: u32) -> anyhow::Result<()> {
    if width > MOST_PIXELS || height > MOST_PIXELS {
        bail!("the image has {width} x {height} pixels. Expected at most {MOST_PIXELS} along each side");
    }
    Ok(())
}

/// The range of the judged latency, in seconds. `None` if the world waited for the policy.
fn judged_latency(judged: &Provenance) -> Option<[f64; 2]> {
    Some(match &judged.execution()?.latency {
        Latency::Fixed { seconds } => [*seconds; 2],
        Latency::Uniform { low_s, high_s } => [*low_s, *high_s],
        Latency::Normal { mean_s, sd_s } | Latency::Gamma { mean_s, sd_s } => {
            [(mean_s - DEVIATIONS * sd_s).max(0.0), mean_s + DEVIATIONS * sd_s]
        }
        Latency::Measured { samples_s } => {
            let ends = |pick: fn(f64, f64) -> f64| samples_s.iter().copied().reduce(pick).unwrap_or(0.0);
            [ends(f64::min), ends(f64::max)]
        }
        Latency::Parameter => {
            let of = judged.space.parameters().iter().find(|of| &*of.name == LATENCY_PARAMETER)?;
            let Domain::Continuous { low, high, .. } = &of.domain else { return None };
            [*low, *high]
        }
    })
}

/// A latency acts as a number of whole control periods.
fn of_latency(latency_s: f64, judged: &Provenance) -> Option<String> {
    let period_s = judged.task.control_period_s.max(1e-6);
    let periods = |seconds: f64| (seconds / period_s - NO_LATENCY).ceil().max(0.0);
    let ms = |seconds: f64| format!("{} ms", number(1e3 * seconds));
    let range = judged_latency(judged);
    let [low_s, high_s] = range.unwrap_or_default();
    let fits = (periods(low_s)..=periods(high_s)).contains(&periods(latency_s));
    let judged = match range {
        None => "the policy was judged without latency: the world waited for its actions".to_owned(),
        Some([low, high]) if high - low < 1e-9 => format!("the policy was judged with {}", ms(low)),
        Some([low, high]) => format!("the policy was judged with {} to {}", ms(low), ms(high)),
    };
    (!fits).then(|| {
        format!(
            "the latency of the cell is {}, {} control periods of {}; {judged} (`gate --latency fixed:{}ms` judges the cell's)",
            ms(latency_s),
            periods(latency_s),
            ms(period_s),
            number(1e3 * latency_s)
        )
    })
}

/// A robot is the same if its files are, or, where files are unknown, its name.
fn of_robot(named: &str, judged: &Provenance) -> anyhow::Result<Option<String>> {
    let short = |sha256: &str| sha256.get(..12).unwrap_or(sha256).to_owned();
    let known = &judged.robot;
    let Some(files) = &known.sha256 else {
        return Ok(
            (named != known.name).then(|| format!("the robot of the cell is {named} in place of {}", known.name))
        );
    };
    let found = robot(named).with_context(|| {
        format!("--robot {named}: the gate recorded the files of the robot {}, and they are compared", known.name)
    })?;
    let now = identity(&found.files()?);
    Ok((now != *files).then(|| {
        format!(
            "the robot of the cell is {} (files {}...) in place of {} ({}...)",
            found.name(),
            short(&now),
            known.name,
            short(files)
        )
    }))
}
