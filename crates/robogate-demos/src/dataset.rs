//! Writes a LeRobotDataset 3.0 to disk.

use std::collections::BTreeMap;
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use robogate_core::Pose;
use robogate_dictionary::files;
use robogate_physics::GripperCommand;
use serde_json::{Value, json};

use crate::moments::Moments;
use crate::table::{Column, Table};
use crate::{Demonstration, Frame};

/// The version of the dataset format.
pub const CODEBASE_VERSION: &str = "v3.0";

/// Size in bytes from which a new data file starts (LeRobot's default: 100 MB).
const FILE_BYTES: usize = 100 << 20;
/// Number of files per data folder (LeRobot's default).
const FILES_PER_CHUNK: usize = 1000;

/// The size of the written dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Written {
    /// The number of episodes.
    pub episodes: usize,
    /// The number of frames of all episodes.
    pub frames: usize,
}

/// The reason why a dataset cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// The folder or a file in it cannot be written.
    #[error("cannot {what} {}: {source}", .path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The attempted action.
        what: &'static str,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The target folder exists.
    #[error("{}: the folder exists. Expected a new folder", .0.display())]
    Exists(PathBuf),
    /// Another process writes a dataset with this name.
    #[error("{}: another process writes this dataset. Expected a new folder", .0.display())]
    Locked(PathBuf),
    /// A table cannot be written.
    #[error("cannot write {}: {source}", .path.display())]
    Table {
        /// The file.
        path: PathBuf,
        /// The error of the Parquet library.
        source: ParquetError,
    },
    /// An episode that differs in structure from the first one.
    #[error("episode {episode} cannot be added: {why}")]
    Episode {
        /// The episode number, from 0.
        episode: usize,
        /// The difference.
        why: String,
    },
    /// The dataset has no episodes.
    #[error("the dataset has no episodes. Expected at least one")]
    Empty,
}

/// A dataset that is being written, under a temporary name. The target folder appears only once it is complete.
pub struct Dataset {
    path: PathBuf,
    partial: PathBuf,
    /// The lock of the temporary folder. The operating system releases it when the process ends for any reason.
    _lock: Option<File>,
    fps: u32,
    robot: String,
    form: Option<Form>,
    tasks: Vec<String>,
    /// The current data file and its number.
    data: Option<Table>,
    file: usize,
    episodes: Vec<EpisodeRow>,
    frames: usize,
    moments: BTreeMap<String, Moments>,
    finished: bool,
}

/// The properties that all frames have in common.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Form {
    joints: usize,
    has_opening: bool,
    /// Name, height and width of each camera image.
    cameras: Vec<(String, usize, usize)>,
}

struct EpisodeRow {
    task: usize,
    length: usize,
    first: usize,
    file: usize,
}

impl Dataset {
    /// Starts a dataset in the folder `path`, with `fps` frames per second, for this robot.
    pub fn create(path: &Path, fps: u32, robot: &str) -> Result<Self, DatasetError> {
        if path.exists() {
            return Err(DatasetError::Exists(path.to_owned()));
        }
        let mut name = std::ffi::OsString::from(".");
        name.push(path.file_name().unwrap_or_default());
        name.push(".part");
        let partial = path.with_file_name(name);
        let Some(lock) = create_locked(&partial).map_err(io_error(&partial, "create"))? else {
            return Err(DatasetError::Locked(path.to_owned()));
        };
        // Another process may have completed the dataset in between.
        if path.exists() {
            // Created above. It is empty, so nothing is lost if it stays.
            let _ = fs::remove_dir(&partial);
            return Err(DatasetError::Exists(path.to_owned()));
        }
        clear(&partial).map_err(io_error(&partial, "clear"))?;
        for folder in ["data/chunk-000", "meta/episodes/chunk-000"] {
            let folder = partial.join(folder);
            fs::create_dir_all(&folder).map_err(io_error(&folder, "create"))?;
        }
        Ok(Self {
            path: path.to_owned(),
            partial,
            _lock: lock.0,
            fps,
            robot: robot.to_owned(),
            form: None,
            tasks: Vec::new(),
            data: None,
            file: 0,
            episodes: Vec::new(),
            frames: 0,
            moments: BTreeMap::new(),
            finished: false,
        })
    }

    /// Adds an episode.
    pub fn push(&mut self, demonstration: &Demonstration) -> Result<(), DatasetError> {
        let episode = self.episodes.len();
        let unfit = |why: &str| DatasetError::Episode { episode, why: why.to_owned() };
        let first = demonstration.frames.first().ok_or_else(|| unfit("it has no frames"))?;
        let form = self.form.get_or_insert_with(|| Form::of(first)).clone();
        if let Some(i) = demonstration.frames.iter().position(|frame| Form::of(frame) != form) {
            return Err(unfit(&format!(
                "frame {i} differs from the first frame in its joints, cameras or image sizes"
            )));
        }
        let task = self.tasks.iter().position(|task| *task == demonstration.task).unwrap_or_else(|| {
            self.tasks.push(demonstration.task.clone());
            self.tasks.len() - 1
        });
        let length = demonstration.frames.len();
        let columns = self.columns(&form, demonstration, task);
        self.note(&form, demonstration, &columns);
        let path = self.partial.join(data_path(self.file));
        let table_error = |source| DatasetError::Table { path: path.clone(), source };
        let data = match &mut self.data {
            Some(data) => data,
            None => self.data.insert(Table::create(&path, &columns, Vec::new()).map_err(table_error)?),
        };
        let bytes = data.push(&columns).map_err(table_error)?;
        self.episodes.push(EpisodeRow { task, length, first: self.frames, file: self.file });
        self.frames += length;
        if bytes >= FILE_BYTES {
            self.close_file()?;
            self.file += 1;
            let folder = self.partial.join(format!("data/chunk-{:03}", self.file / FILES_PER_CHUNK));
            fs::create_dir_all(&folder).map_err(io_error(&folder, "create"))?;
        }
        Ok(())
    }

    /// Completes the dataset and renames it to its final path.
    pub fn finish(mut self) -> Result<Written, DatasetError> {
        let form = self.form.clone().ok_or(DatasetError::Empty)?;
        self.close_file()?;
        self.write_table("meta/tasks.parquet", self.task_columns(), pandas_metadata())?;
        self.write_table("meta/episodes/chunk-000/file-000.parquet", self.episode_columns(), Vec::new())?;
        self.write_json("meta/info.json", &self.info(&form))?;
        let stats: serde_json::Map<String, Value> =
            self.moments.iter().map(|(name, m)| (name.clone(), m.json(name.starts_with(IMAGES)))).collect();
        self.write_json("meta/stats.json", &Value::Object(stats))?;
        files::sync_all_below(&self.partial).map_err(io_error(&self.path, "write"))?;
        fs::rename(&self.partial, &self.path)
            .and_then(|()| files::sync_parent(&self.path))
            .map_err(io_error(&self.path, "rename to"))?;
        self.finished = true;
        Ok(Written { episodes: self.episodes.len(), frames: self.frames })
    }

    fn close_file(&mut self) -> Result<(), DatasetError> {
        let path = self.partial.join(data_path(self.file));
        match self.data.take() {
            Some(data) => data.finish().map_err(|source| DatasetError::Table { path, source }),
            None => Ok(()),
        }
    }

    fn columns(&self, form: &Form, demonstration: &Demonstration, task: usize) -> Vec<(String, Column)> {
        let frames = &demonstration.frames;
        let n = frames.len();
        let count = |from: usize| (from as i64..(from + n) as i64).collect::<Vec<_>>();
        let mut columns: Vec<(String, Column)> = form
            .cameras
            .iter()
            .enumerate()
            .map(|(i, (camera, ..))| {
                let files = frames.iter().map(|frame| frame.pictures[i].png.clone()).collect();
                (format!("{IMAGES}{camera}"), Column::Images(files))
            })
            .collect();
        for (feature, size, values) in VECTORS {
            let all = frames.iter().flat_map(values).map(|x| x as f32).collect();
            columns.push((feature.to_owned(), Column::FloatLists(size(form), all)));
        }
        let time = (0..n).map(|i| (i as f64 / f64::from(self.fps)) as f32).collect();
        columns.push(("timestamp".to_owned(), Column::Floats(time)));
        for (name, values) in [
            ("frame_index", count(0)),
            ("episode_index", vec![self.episodes.len() as i64; n]),
            ("index", count(self.frames)),
            ("task_index", vec![task as i64; n]),
        ] {
            columns.push((name.to_owned(), Column::Longs(values)));
        }
        columns
    }

    fn note(&mut self, form: &Form, demonstration: &Demonstration, columns: &[(String, Column)]) {
        for frame in &demonstration.frames {
            for (picture, (camera, height, width)) in frame.pictures.iter().zip(&form.cameras) {
                let moments = self.moments.entry(format!("{IMAGES}{camera}")).or_default();
                moments.note_all(&picture.moments, (height * width) as f64);
            }
        }
        for (name, column) in columns {
            let mut note = |values: &[f64]| self.moments.entry(name.clone()).or_default().note(values);
            match column {
                Column::FloatLists(size, values) => values
                    .chunks_exact(*size)
                    .for_each(|row| note(&row.iter().map(|x| f64::from(*x)).collect::<Vec<_>>())),
                Column::Floats(values) => values.iter().for_each(|x| note(&[f64::from(*x)])),
                Column::Longs(values) => values.iter().for_each(|x| note(&[*x as f64])),
                _ => {}
            }
        }
    }

    fn task_columns(&self) -> Vec<(String, Column)> {
        vec![
            ("task_index".to_owned(), Column::Longs((0..self.tasks.len() as i64).collect())),
            ("task".to_owned(), Column::Texts(self.tasks.clone())),
        ]
    }

    fn episode_columns(&self) -> Vec<(String, Column)> {
        let longs = |of: &dyn Fn(&EpisodeRow) -> usize| {
            Column::Longs(self.episodes.iter().map(|episode| of(episode) as i64).collect())
        };
        let indices = Column::Longs((0..self.episodes.len() as i64).collect());
        let tasks = self.episodes.iter().map(|episode| self.tasks[episode.task].clone()).collect();
        let columns = [
            ("episode_index", indices),
            ("tasks", Column::TextLists(tasks)),
            ("length", longs(&|e| e.length)),
            ("data/chunk_index", longs(&|e| e.file / FILES_PER_CHUNK)),
            ("data/file_index", longs(&|e| e.file % FILES_PER_CHUNK)),
            ("dataset_from_index", longs(&|e| e.first)),
            ("dataset_to_index", longs(&|e| e.first + e.length)),
            ("meta/episodes/chunk_index", longs(&|_| 0)),
            ("meta/episodes/file_index", longs(&|_| 0)),
        ];
        columns.map(|(name, column)| (name.to_owned(), column)).into()
    }

    fn info(&self, form: &Form) -> Value {
        let mut features = serde_json::Map::new();
        for (camera, height, width) in &form.cameras {
            let names = ["height", "width", "channels"];
            let feature = json!({"dtype": "image", "shape": [height, width, 3], "names": names, "fps": self.fps});
            features.insert(format!("{IMAGES}{camera}"), feature);
        }
        let joints = (1..=form.joints).map(|i| format!("joint_{i}_rad"));
        let tool = ["x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"].map(|part| format!("tool_{part}"));
        let opening = form.has_opening.then(|| "gripper_opening_m".to_owned());
        let delta = ["x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad"].map(|part| format!("tool_delta_{part}"));
        let object = ["x_m", "y_m", "z_m", "edge_m"].map(|part| format!("object_{part}"));
        let names: [Vec<String>; 5] = [
            joints.clone().chain(tool.clone()).chain(opening).collect(),
            joints.chain(["gripper_open".to_owned()]).collect(),
            tool.into(),
            delta.into(),
            object.into(),
        ];
        for ((feature, size, _), names) in VECTORS.into_iter().zip(names) {
            let feature_json = json!({"dtype": "float32", "shape": [size(form)], "names": names, "fps": self.fps});
            features.insert(feature.to_owned(), feature_json);
        }
        let scalar = |dtype: &str| json!({"dtype": dtype, "shape": [1], "names": null, "fps": self.fps});
        features.insert("timestamp".to_owned(), scalar("float32"));
        for name in ["frame_index", "episode_index", "index", "task_index"] {
            features.insert(name.to_owned(), scalar("int64"));
        }
        json!({
            "codebase_version": CODEBASE_VERSION,
            "robot_type": self.robot,
            "total_episodes": self.episodes.len(),
            "total_frames": self.frames,
            "total_tasks": self.tasks.len(),
            "chunks_size": FILES_PER_CHUNK,
            "data_files_size_in_mb": FILE_BYTES >> 20,
            "video_files_size_in_mb": 200,
            "fps": self.fps,
            "splits": {"train": format!("0:{}", self.episodes.len())},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": null,
            "features": features,
        })
    }

    fn write_table(
        &self,
        name: &str,
        rows: Vec<(String, Column)>,
        metadata: Vec<KeyValue>,
    ) -> Result<(), DatasetError> {
        let path = self.partial.join(name);
        let written = Table::create(&path, &rows, metadata).and_then(|mut table| {
            table.push(&rows)?;
            table.finish()
        });
        written.map_err(|source| DatasetError::Table { path, source })
    }

    fn write_json(&self, name: &str, value: &Value) -> Result<(), DatasetError> {
        let path = self.partial.join(name);
        fs::write(&path, format!("{value:#}\n")).map_err(io_error(&path, "write"))
    }
}

impl Drop for Dataset {
    fn drop(&mut self) {
        if !self.finished {
            // A failure to delete the temporary folder cannot be reported here. The next dataset with this name deletes
            // it.
            let _ = fs::remove_dir_all(&self.partial);
        }
    }
}

/// Prefix of the image features, before the camera's name.
const IMAGES: &str = "observation.images.";

type Size = fn(&Form) -> usize;
type Values = fn(&Frame) -> Vec<f64>;

/// The vector features: name, size, values. `meta/info.json` documents their meaning.
const VECTORS: [(&str, Size, Values); 5] = [
    (
        "observation.state",
        |form| form.joints + 7 + usize::from(form.has_opening),
        |frame| frame.joints.iter().copied().chain(flat(&frame.tool)).chain(frame.opening_m).collect(),
    ),
    (
        "action",
        |form| form.joints + 1,
        |frame| {
            let open = if frame.gripper == GripperCommand::Open { 1.0 } else { 0.0 };
            frame.wanted.iter().copied().chain([open]).collect()
        },
    ),
    ("action.tool_pose", |_| 7, |frame| flat(&frame.wanted_tool).collect()),
    ("action.tool_delta", |_| 6, |frame| frame.wanted_delta.to_vec()),
    // Information that the expert had at the start, the same in all frames. It is for losses and analysis, never for
    // the policy.
    ("expert.object", |_| 4, |frame| frame.told.to_vec()),
];

fn flat(pose: &Pose) -> impl Iterator<Item = f64> {
    pose.position.into_iter().chain(pose.orientation)
}

impl Form {
    fn of(frame: &Frame) -> Self {
        let cameras = frame.pictures.iter().map(|p| (p.camera.clone(), p.height, p.width)).collect();
        Self { joints: frame.joints.len(), has_opening: frame.opening_m.is_some(), cameras }
    }
}

/// The path of data file `file` within the dataset.
fn data_path(file: usize) -> String {
    format!("data/chunk-{:03}/file-{:03}.parquet", file / FILES_PER_CHUNK, file % FILES_PER_CHUNK)
}

/// LeRobot reads the tasks with pandas and expects the task text as the index, which pandas records here.
fn pandas_metadata() -> Vec<KeyValue> {
    let column = |name: &str, kind: &str, numpy: &str| json!({"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": null});
    let pandas = json!({
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
        "creator": {"library": "robogate", "version": env!("CARGO_PKG_VERSION")},
        "pandas_version": "2.2.3",
    });
    vec![KeyValue::new("pandas".to_owned(), pandas.to_string())]
}

/// The lock of a folder. `None` if folders cannot be opened or locked (Windows, some network file systems).
struct Lock(Option<File>);

/// How often a folder is created that other processes delete or rename meanwhile.
const ATTEMPTS: u32 = 100;

/// Creates a folder, unless it exists, and locks it. `None` if another process uses it.
fn create_locked(folder: &Path) -> io::Result<Option<Lock>> {
    for _ in 0..ATTEMPTS {
        fs::create_dir_all(folder)?;
        let opened = match File::open(folder) {
            Ok(opened) => opened,
            Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
            Err(_) => return Ok(Some(Lock(None))),
        };
        match opened.try_lock() {
            Ok(()) if is_at(&opened, folder) => return Ok(Some(Lock(Some(opened)))),
            // Another process has deleted or renamed the folder after it was opened, so this lock protects nothing.
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Ok(None),
            Err(TryLockError::Error(_)) => return Ok(Some(Lock(None))),
        }
    }
    Ok(None)
}

/// Whether an opened folder is the one with this path now.
#[cfg(unix)]
fn is_at(opened: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;

    let identity = |metadata: io::Result<fs::Metadata>| metadata.ok().map(|metadata| (metadata.dev(), metadata.ino()));
    let locked = identity(opened.metadata());
    locked.is_some() && locked == identity(fs::metadata(path))
}

/// An opened folder cannot be deleted or renamed.
#[cfg(not(unix))]
fn is_at(_: &File, _: &Path) -> bool {
    true
}

/// Deletes the remains of a killed process. The folder itself stays, because it is locked.
fn clear(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() { fs::remove_dir_all(entry.path())? } else { fs::remove_file(entry.path())? }
    }
    Ok(())
}

fn io_error(path: &Path, what: &'static str) -> impl FnOnce(io::Error) -> DatasetError {
    let path = path.to_owned();
    move |source| DatasetError::Io { path, what, source }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn replaced_folder_is_noticed() {
        let base = tempfile::tempdir().unwrap();
        let folder = base.path().join("demos");
        fs::create_dir(&folder).unwrap();
        let opened = File::open(&folder).unwrap();
        assert!(is_at(&opened, &folder));
        fs::rename(&folder, base.path().join("other")).unwrap();
        assert!(!is_at(&opened, &folder));
        fs::create_dir(&folder).unwrap();
        assert!(!is_at(&opened, &folder));
    }
}
