//! Finds, verifies and loads the pinned MuJoCo library at run time.
//!
//! Binaries do not name the library in their dynamic section, so they start without it and contain no path of the machine
//! that built them. [`load`] searches these places in order:
//!
//! 1. the file or folder in `ROBOGATE_MUJOCO_LIB`, where it is set;
//! 2. the folder of the executable, and `../lib/robogate` beside it, for packages that contain the library;
//! 3. the cache folder: `ROBOGATE_CACHE_DIR`, else `$XDG_CACHE_HOME/robogate`, else `~/.cache/robogate`. A library that is
//!    missing there is downloaded once from the Python package index.
//!
//! A library of places 2 and 3 must have the pinned SHA-256 digest, and is hashed before it is loaded. One that the user
//! names (place 1) may have another digest, which records of episodes then state.

mod fetch;
mod find;
mod functions;

use std::ffi::c_void;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use sha2::{Digest, Sha256};

/// The MuJoCo release that the binding was generated for.
pub const VERSION: &str = "3.17.0";

/// File name of the library.
pub const LIBRARY: &str = "libmujoco.so.3.17.0";

/// Environment variable that names a library, or its folder, to use in place of the pinned one.
pub const LIBRARY_VARIABLE: &str = "ROBOGATE_MUJOCO_LIB";

/// Environment variable that names the folder for downloads.
pub const CACHE_VARIABLE: &str = "ROBOGATE_CACHE_DIR";

/// The library that this process uses.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Library {
    /// Its file.
    pub path: PathBuf,
    /// SHA-256 digest of the file, computed before it was loaded, in lower-case hexadecimal digits.
    pub sha256: String,
}

/// Error: MuJoCo cannot be used.
#[derive(Debug, Clone, thiserror::Error)]
pub enum LoadError {
    /// No release of MuJoCo is pinned for this platform.
    #[error(
        "MuJoCo {VERSION} is provided for Linux on x86_64 and aarch64 only\nHint: set {LIBRARY_VARIABLE} to the MuJoCo {VERSION} library of this system, or use the Rapier engine"
    )]
    Platform,
    /// The path that the user named holds no library.
    #[error("{LIBRARY_VARIABLE}={}: no such library. Expected the path of {LIBRARY} or of its folder", path.display())]
    Named {
        /// The value of the variable.
        path: PathBuf,
    },
    /// No folder for downloads is known.
    #[error("MuJoCo {VERSION}: no folder for downloads\nHint: set {CACHE_VARIABLE} or HOME to an absolute path")]
    NoCache,
    /// A file cannot be read or written.
    #[error(
        "MuJoCo {VERSION}: {}: {message}\nHint: set {CACHE_VARIABLE} to a folder that can be written, or {LIBRARY_VARIABLE} to a {LIBRARY} of this machine", path.display()
    )]
    Io {
        /// The file.
        path: PathBuf,
        /// Message of the operating system.
        message: String,
    },
    /// The download failed.
    #[error(
        "MuJoCo {VERSION} cannot be downloaded: {message}\nHint: provide python3 with pip and access to a Python package index, or set {LIBRARY_VARIABLE} to a {LIBRARY} of this machine"
    )]
    Download {
        /// What failed.
        message: String,
    },
    /// The file is not the pinned library.
    #[error(
        "{}: SHA-256 digest {found}. Expected {expected}, the library of MuJoCo {VERSION}\nHint: reinstall, or delete this file to have it downloaded again", path.display()
    )]
    Digest {
        /// The file.
        path: PathBuf,
        /// Its digest.
        found: String,
        /// The pinned digest.
        expected: &'static str,
    },
    /// The operating system cannot load the file.
    #[error("{}: cannot load MuJoCo: {message}", path.display())]
    Load {
        /// The file.
        path: PathBuf,
        /// Message of the dynamic loader.
        message: String,
    },
}

impl LoadError {
    fn io(path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |error| Self::Io { path: path.to_owned(), message: error.to_string() }
    }
}

/// Loads MuJoCo once for the whole process; later calls return the first result. Call it before any function of MuJoCo:
/// without it, such a call aborts the process.
///
/// Writes one line to standard error before a download.
///
/// # Errors
/// If no library is found and none can be downloaded, if its digest is wrong, or if it lacks a function.
pub fn load() -> Result<&'static Library, LoadError> {
    static LOADED: OnceLock<Result<Library, LoadError>> = OnceLock::new();
    LOADED.get_or_init(find_and_load).as_ref().map_err(Clone::clone)
}

fn find_and_load() -> Result<Library, LoadError> {
    let library = find::library(&find::Places::of_process())?;
    let cannot = |error: libloading::Error| LoadError::Load { path: library.path.clone(), message: error.to_string() };
    // SAFETY: the initialisers of MuJoCo have no preconditions. The digest was checked, or the user vouches for the file.
    #[expect(unsafe_code, reason = "loading a library runs its initialisers")]
    let loaded = unsafe { libloading::Library::new(&library.path) }.map_err(cannot)?;
    functions::connect(|name| {
        // SAFETY: the symbol is only stored; functions::connect gives it the type that the binding declares.
        #[expect(unsafe_code, reason = "the type of a symbol cannot be checked")]
        let symbol = unsafe { loaded.get::<*const c_void>(name.to_bytes_with_nul()) }.map_err(cannot)?;
        Ok(*symbol)
    })?;
    // The entry points refer to it until the process ends.
    std::mem::forget(loaded);
    Ok(library)
}

/// Sets how many significant digits MuJoCo writes into models. Call [`load`] first.
pub fn set_xml_precision(digits: i32) {
    // SAFETY: it stores a number. `load` has connected the function.
    #[expect(unsafe_code, reason = "a function of MuJoCo that the binding lacks")]
    unsafe {
        functions::set_xml_precision(digits);
    }
}

/// SHA-256 digest of a file, in lower-case hexadecimal digits.
fn digest(path: &Path) -> Result<String, LoadError> {
    let mut hasher = Sha256::new();
    let mut file = File::open(path).map_err(LoadError::io(path))?;
    io::copy(&mut file, &mut HashWriter(&mut hasher)).map_err(LoadError::io(path))?;
    Ok(hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}

struct HashWriter<'a>(&'a mut Sha256);

impl io::Write for HashWriter<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
