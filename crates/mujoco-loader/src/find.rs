//! Where the library is.

use std::env;
use std::path::{Path, PathBuf};

use crate::{CACHE_VARIABLE, LIBRARY, LIBRARY_VARIABLE, Library, LoadError, VERSION, digest, fetch};

/// SHA-256 digest of the library in the `mujoco` wheel of the Python package index, by architecture.
const PINNED: [(&str, &str); 2] = [
    ("x86_64", "23496b023ee80fb61ab71167e94bc649f9941710fde96b18bb8204fb332523ad"),
    ("aarch64", "e2edd0204fb9229f75f332a4fcd1a32345bb9f90651dc0fddfa20ec0670db789"),
];

/// The places that are searched.
pub(crate) struct Places {
    /// A file or folder that the user named.
    pub(crate) named: Option<PathBuf>,
    /// Folder of the executable.
    pub(crate) executable: Option<PathBuf>,
    /// Folder for downloads.
    pub(crate) cache: Option<PathBuf>,
}

impl Places {
    /// The places of this process.
    pub(crate) fn of_process() -> Self {
        let path = |variable: &str| env::var_os(variable).filter(|value| !value.is_empty()).map(PathBuf::from);
        Self {
            named: path(LIBRARY_VARIABLE),
            executable: env::current_exe().ok().and_then(|file| Some(file.parent()?.to_owned())),
            cache: path(CACHE_VARIABLE)
                .or_else(|| Some(path("XDG_CACHE_HOME")?.join("robogate")))
                .or_else(|| Some(path("HOME")?.join(".cache/robogate")))
                .filter(|folder| folder.is_absolute()),
        }
    }
}

/// Finds the library and computes its digest; downloads it where no place has it.
pub(crate) fn library(places: &Places) -> Result<Library, LoadError> {
    if let Some(named) = &places.named {
        let path = if named.is_dir() { named.join(LIBRARY) } else { named.clone() };
        let path = path.canonicalize().map_err(|_| LoadError::Named { path: named.clone() })?;
        let sha256 = digest(&path)?;
        return Ok(Library { path, sha256 });
    }
    let expected = PINNED
        .iter()
        .find(|(arch, _)| cfg!(target_os = "linux") && *arch == env::consts::ARCH)
        .ok_or(LoadError::Platform)?
        .1;
    let installed = places
        .executable
        .iter()
        .flat_map(|folder| [folder.join(LIBRARY), folder.join("../lib/robogate").join(LIBRARY)]);
    for path in installed {
        if path.is_file() {
            return verified(&path, expected);
        }
    }
    let cache = places.cache.as_deref().ok_or(LoadError::NoCache)?;
    let folder = cache.join(format!("mujoco-{VERSION}-{}", env::consts::ARCH));
    let path = folder.join(LIBRARY);
    if !path.is_file() {
        fetch::library(&folder, env::consts::ARCH)?;
    }
    verified(&path, expected)
}

fn verified(path: &Path, expected: &'static str) -> Result<Library, LoadError> {
    let sha256 = digest(path)?;
    if sha256 != expected {
        return Err(LoadError::Digest { path: path.to_owned(), found: sha256, expected });
    }
    Ok(Library { path: path.to_owned(), sha256 })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use tempfile::TempDir;

    use super::*;

    fn places(named: Option<PathBuf>, executable: Option<&Path>, cache: Option<&Path>) -> Places {
        Places { named, executable: executable.map(Path::to_owned), cache: cache.map(Path::to_owned) }
    }

    #[test]
    fn a_named_library_may_have_any_digest() {
        let dir = TempDir::new().unwrap();
        let file = dir.path().join(LIBRARY);
        fs::write(&file, "abc").unwrap();
        // Digest of "abc" from FIPS 180-2, appendix B.1.
        let sha256 = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        for named in [file.clone(), dir.path().to_owned()] {
            let found = library(&places(Some(named), None, None)).unwrap();
            assert_eq!((found.path, found.sha256.as_str()), (file.canonicalize().unwrap(), sha256));
        }
    }

    #[test]
    fn a_named_library_must_exist() {
        let missing = PathBuf::from("/nonexistent/libmujoco.so");
        let error = library(&places(Some(missing), None, None)).unwrap_err();
        assert!(matches!(&error, LoadError::Named { .. }), "{error}");
        assert!(error.to_string().contains("ROBOGATE_MUJOCO_LIB=/nonexistent"), "{error}");
    }

    #[test]
    fn an_altered_library_is_rejected() {
        let dir = TempDir::new().unwrap();
        let (bin, lib) = (dir.path().join("bin"), dir.path().join("lib/robogate"));
        fs::create_dir_all(&bin).unwrap();
        fs::create_dir_all(&lib).unwrap();
        fs::write(lib.join(LIBRARY), "not MuJoCo").unwrap();
        let error = library(&places(None, Some(&bin), None)).unwrap_err();
        assert!(matches!(&error, LoadError::Digest { .. }), "{error}");
        // The folder of the executable comes first.
        fs::write(bin.join(LIBRARY), "something else").unwrap();
        let LoadError::Digest { path, .. } = library(&places(None, Some(&bin), None)).unwrap_err() else {
            panic!("the digest is wrong");
        };
        assert_eq!(path, bin.join(LIBRARY));
    }

    #[test]
    fn an_altered_download_is_rejected() {
        let dir = TempDir::new().unwrap();
        let folder = dir.path().join(format!("mujoco-{VERSION}-{}", env::consts::ARCH));
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join(LIBRARY), "cut").unwrap();
        let error = library(&places(None, None, Some(dir.path()))).unwrap_err();
        assert!(error.to_string().contains("delete this file"), "{error}");
    }

    #[test]
    fn downloads_need_a_folder() {
        let error = library(&places(None, None, None)).unwrap_err();
        assert!(matches!(&error, LoadError::NoCache), "{error}");
    }
}
