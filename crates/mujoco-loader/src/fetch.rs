//! Downloads the library from the Python package index.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;
use std::process::{Command, Stdio};

use crate::{LIBRARY, LoadError, VERSION};

/// The wheel that holds the library. pip checks its digest.
const REQUIREMENT: &str = include_str!("requirement.txt");

/// Extracts one file from the wheel; arguments: folder of the wheel, member, target.
const UNPACK: &str = "import glob, sys, zipfile
wheel, = glob.glob(sys.argv[1] + '/mujoco-*.whl')
with zipfile.ZipFile(wheel) as z, open(sys.argv[3], 'wb') as f:
    f.write(z.read('mujoco/' + sys.argv[2]))
";

/// Downloads the library into `folder`. One process downloads; others that want the same wait for it.
pub(crate) fn library(folder: &Path, arch: &str) -> Result<(), LoadError> {
    fs::create_dir_all(folder).map_err(LoadError::io(folder))?;
    let lock = folder.join("download.lock");
    let guard = File::create(&lock).map_err(LoadError::io(&lock))?;
    guard.lock().map_err(LoadError::io(&lock))?;
    if folder.join(LIBRARY).is_file() {
        return Ok(());
    }
    // A message only: where standard error is closed, the download goes on.
    let _ = writeln!(
        io::stderr(),
        "Downloading MuJoCo {VERSION} (a 25 MB wheel of the Python package index, once) into {} ...",
        folder.display()
    );
    let work = folder.join("download");
    fs::create_dir_all(&work).map_err(LoadError::io(&work))?;
    let result = download(&work, folder, arch);
    // What is left is a copy of the wheel: a failed removal does no harm.
    drop(fs::remove_dir_all(&work));
    result
}

fn download(work: &Path, folder: &Path, arch: &str) -> Result<(), LoadError> {
    let requirements = work.join("requirements.txt");
    fs::write(&requirements, REQUIREMENT).map_err(LoadError::io(&requirements))?;
    let mut pip = Command::new("python3");
    pip.args(["-m", "pip", "download", "--disable-pip-version-check", "--no-deps"]);
    pip.args(["--only-binary=:all:", "--require-hashes", "--python-version", "3.11"]);
    pip.args(["--implementation", "cp", "--abi", "cp311"]);
    for glibc in ["2_28", "2_27"] {
        pip.arg("--platform").arg(format!("manylinux_{glibc}_{arch}"));
    }
    pip.arg("--dest").arg(work).arg("--requirement").arg(&requirements);
    succeed(pip, work)?;
    let library = work.join(LIBRARY);
    let mut unpack = Command::new("python3");
    unpack.args([OsStr::new("-c"), OsStr::new(UNPACK), work.as_os_str(), OsStr::new(LIBRARY), library.as_os_str()]);
    succeed(unpack, work)?;
    // A rename is atomic: no process sees half a library.
    fs::rename(&library, folder.join(LIBRARY)).map_err(LoadError::io(&library))
}

/// Runs a program. Its output, with pip's progress bar, goes to standard error: standard output belongs to the caller.
fn succeed(mut command: Command, work: &Path) -> Result<(), LoadError> {
    let failed = |message: String| LoadError::Download { message };
    let program = command.get_program().to_string_lossy().into_owned();
    let status = command
        // Python imports modules from its current folder first. The user's current folder may contain another user's files.
        .current_dir(work)
        .stdin(Stdio::null())
        .stdout(io::stderr())
        .status()
        .map_err(|error| failed(format!("cannot start {program}: {error}")))?;
    if !status.success() {
        let arguments: Vec<_> = command.get_args().take(3).map(OsStr::to_string_lossy).collect();
        return Err(failed(format!(
            "`{program} {} ...` failed ({status}); its messages are above",
            arguments.join(" ")
        )));
    }
    Ok(())
}
