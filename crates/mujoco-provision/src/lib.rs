//! Downloads the pinned MuJoCo library once and links it. For build scripts only.
//!
//! The library comes from the `mujoco` wheel on the Python package index. pip checks the wheel against a pinned
//! SHA-256. The library is stored in a cache folder that debug, release, test and installed binaries share. They find
//! it there by rpath, so `cargo clean` does not break them.

use std::env;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

/// The MuJoCo release that the binding was generated for.
pub const VERSION: &str = "3.17.0";

/// The library's file name, which is also its `SONAME`.
pub const LIBRARY: &str = "libmujoco.so.3.17.0";

/// Environment variable with the path of an existing library, or of its folder.
pub const LIBRARY_VARIABLE: &str = "ROBOGATE_MUJOCO_LIB";

/// Environment variable with the download folder. The default is `$XDG_CACHE_HOME/robogate`, otherwise
/// `~/.cache/robogate`.
pub const CACHE_VARIABLE: &str = "ROBOGATE_CACHE_DIR";

/// The pip requirement. One wheel per platform contains the library for any Python version; the two hashes are those of
/// x86_64 and aarch64.
const REQUIREMENT: &str = "mujoco==3.17.0 \
    --hash=sha256:d66928d86a2d1b601bbaa4dc11db50214d17d5301bb8afd84721313b67ff0874 \
    --hash=sha256:91a70ed9979c383ff1f5c03f25cc2e1280a8254c1a8e558d5dd7f4184f01efc9\n";

/// Python script that extracts the library from the wheel. Arguments: folder with the wheel, member, target.
const UNPACK: &str = "import glob, sys, zipfile
wheel, = glob.glob(sys.argv[1] + '/mujoco-*.whl')
with zipfile.ZipFile(wheel) as z, open(sys.argv[3], 'wb') as f:
    f.write(z.read('mujoco/' + sys.argv[2]))
";

/// The complete build script of a package whose binaries or tests run MuJoCo.
#[expect(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a build script writes instructions to stdout and errors to stderr"
)]
pub fn link() -> ExitCode {
    println!("cargo::rerun-if-env-changed={LIBRARY_VARIABLE}");
    println!("cargo::rerun-if-env-changed={CACHE_VARIABLE}");
    println!("cargo::rerun-if-changed=build.rs");
    match provide() {
        Ok(folder) => {
            println!("cargo::rerun-if-changed={}", folder.join(LIBRARY).display());
            println!("cargo::rustc-link-search=native={}", folder.display());
            println!("cargo::rustc-link-arg=-Wl,-rpath,{}", folder.display());
            ExitCode::SUCCESS
        }
        Err(why) => {
            eprintln!("error: MuJoCo {VERSION} could not be set up: {why}");
            eprintln!(
                "hint: install python3 with pip and make a package index reachable, \
                 or set {LIBRARY_VARIABLE} to the path of an existing {LIBRARY} (or of its folder)"
            );
            ExitCode::FAILURE
        }
    }
}

/// Returns the folder that contains [`LIBRARY`], and downloads the library if needed.
fn provide() -> Result<PathBuf, String> {
    if let Some(given) = env::var_os(LIBRARY_VARIABLE).filter(|v| !v.is_empty()) {
        return given_folder(Path::new(&given));
    }
    let arch = env::var("CARGO_CFG_TARGET_ARCH").unwrap_or_default();
    let os = env::var("CARGO_CFG_TARGET_OS").unwrap_or_default();
    if os != "linux" || !["x86_64", "aarch64"].contains(&arch.as_str()) {
        return Err(format!("automatic download supports only Linux on x86_64 and aarch64 (this is {os} on {arch})"));
    }
    let folder = cache()?.join(format!("mujoco-{VERSION}-{arch}"));
    if !folder.join(LIBRARY).is_file() {
        download(&folder, &arch)?;
    }
    Ok(folder)
}

fn given_folder(given: &Path) -> Result<PathBuf, String> {
    let folder = if given.is_dir() { Some(given) } else { given.parent() };
    match folder.filter(|f| given.is_absolute() && f.join(LIBRARY).is_file()) {
        Some(folder) => Ok(folder.to_owned()),
        None => Err(format!(
            "{LIBRARY_VARIABLE}={}: expected the absolute path of {LIBRARY} or of its folder",
            given.display()
        )),
    }
}

fn cache() -> Result<PathBuf, String> {
    let named = |variable: &str| env::var_os(variable).filter(|v| !v.is_empty()).map(PathBuf::from);
    named(CACHE_VARIABLE)
        .or_else(|| named("XDG_CACHE_HOME").map(|p| p.join("robogate")))
        .or_else(|| named("HOME").map(|p| p.join(".cache/robogate")))
        .filter(|p| p.is_absolute())
        .ok_or_else(|| format!("no cache folder is known. Set {CACHE_VARIABLE} or HOME to an absolute path"))
}

fn download(folder: &Path, arch: &str) -> Result<(), String> {
    // Two build scripts may run this at once. Each works in a separate folder, and the last step, a rename, is atomic.
    let work = folder.with_extension(format!("part-{}", std::process::id()));
    let io = |what: &Path| {
        let what = what.display().to_string();
        move |e: std::io::Error| format!("{what}: {e}")
    };
    fs::create_dir_all(&work).map_err(io(&work))?;
    let requirements = work.join("requirements.txt");
    fs::write(&requirements, REQUIREMENT).map_err(io(&requirements))?;
    let mut pip = Command::new("python3");
    pip.args(["-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]);
    pip.args(["--only-binary=:all:", "--require-hashes", "--python-version", "3.11"]);
    pip.args(["--implementation", "cp", "--abi", "cp311"]);
    for glibc in ["2_28", "2_27"] {
        pip.arg("--platform").arg(format!("manylinux_{glibc}_{arch}"));
    }
    pip.arg("--dest").arg(&work).arg("--requirement").arg(&requirements);
    let result = succeed(pip).and_then(|()| {
        let mut unpack = Command::new("python3");
        unpack.args([OsStr::new("-c"), OsStr::new(UNPACK), work.as_os_str(), OsStr::new(LIBRARY)]);
        unpack.arg(work.join(LIBRARY));
        succeed(unpack)?;
        fs::create_dir_all(folder).map_err(io(folder))?;
        fs::rename(work.join(LIBRARY), folder.join(LIBRARY)).map_err(io(folder))
    });
    // Only a copy of the wheel is left. A failed deletion is harmless.
    drop(fs::remove_dir_all(&work));
    result
}

fn succeed(mut command: Command) -> Result<(), String> {
    let output = command.output().map_err(|e| format!("cannot start python3: {e}"))?;
    if output.status.success() {
        return Ok(());
    }
    Err(format!("`{:?}` failed: {}", command, String::from_utf8_lossy(&output.stderr).trim()))
}
