//! The platform of a run: what the bits of its results depend on beside the program.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The platform: operating system, architecture, C library and CPU features.
///
/// The C library computes `exp`, `log` and `sin` and chooses a variant of each by the CPU. Two versions, or two
/// variants, can differ in the last bit, after which trajectories diverge. The same holds for the library that runs networks in
/// this process, which has wider vectors where the CPU has AVX-512.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Platform {
    /// Operating system (`linux`).
    pub os: String,
    /// Architecture (`x86_64`).
    pub arch: String,
    /// C library with its version (`glibc 2.36`). Absent if it is unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub libc: Option<String>,
    /// The CPU features by which the C library chooses its variants (`avx2`, `fma`), sorted, and `avx512` if a network ran in this
    /// process with it. Absent if they are unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cpu: Option<Vec<String>>,
}

impl Platform {
    /// The platform of this process.
    pub fn here() -> Self {
        Self {
            os: std::env::consts::OS.to_owned(),
            arch: std::env::consts::ARCH.to_owned(),
            libc: libc_version(),
            cpu: cpu_features(),
        }
    }

    /// The platform of a process that runs networks itself.
    #[must_use]
    pub fn with_networks(mut self) -> Self {
        if let Some(cpu) = self.cpu.as_mut().filter(|_| has_avx512()) {
            cpu.push("avx512".to_owned());
            cpu.sort();
        }
        self
    }

    /// The properties that are known, as names and values.
    pub fn properties(&self) -> Vec<(&'static str, String)> {
        let mut known = vec![("platform", format!("{} {}", self.os, self.arch))];
        known.extend(self.libc.iter().map(|libc| ("C library", libc.clone())));
        let features = |cpu: &Vec<String>| if cpu.is_empty() { "none".to_owned() } else { cpu.join(" ") };
        known.extend(self.cpu.iter().map(|cpu| ("CPU features", features(cpu))));
        known
    }
}

#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn libc_version() -> Option<String> {
    #[expect(unsafe_code, reason = "the standard library does not report the version of the C library")]
    // SAFETY: the function takes nothing and returns a static string. glibc has it since version 2.1.
    let version = unsafe {
        unsafe extern "C" {
            fn gnu_get_libc_version() -> *const std::ffi::c_char;
        }
        std::ffi::CStr::from_ptr(gnu_get_libc_version())
    };
    Some(format!("glibc {}", version.to_string_lossy()))
}

#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn libc_version() -> Option<String> {
    None
}

#[cfg(target_arch = "x86_64")]
fn cpu_features() -> Option<Vec<String>> {
    let known = [
        ("avx2", std::arch::is_x86_feature_detected!("avx2")),
        ("fma", std::arch::is_x86_feature_detected!("fma")),
        ("sse4.1", std::arch::is_x86_feature_detected!("sse4.1")),
    ];
    Some(known.into_iter().filter(|(_, present)| *present).map(|(name, _)| name.to_owned()).collect())
}

/// Whether the library of networks (rten-simd) uses AVX-512 here: it asks for these four extensions.
#[cfg(target_arch = "x86_64")]
fn has_avx512() -> bool {
    std::arch::is_x86_feature_detected!("avx512f")
        && std::arch::is_x86_feature_detected!("avx512vl")
        && std::arch::is_x86_feature_detected!("avx512bw")
        && std::arch::is_x86_feature_detected!("avx512dq")
}

#[cfg(not(target_arch = "x86_64"))]
fn has_avx512() -> bool {
    false
}

/// Other architectures have one variant of each function.
#[cfg(not(target_arch = "x86_64"))]
fn cpu_features() -> Option<Vec<String>> {
    Some(Vec::new())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn old_records_have_unknown_properties() {
        let old: Platform = serde_json::from_str(r#"{"os":"linux","arch":"x86_64"}"#).unwrap();
        assert_eq!(old.properties(), [("platform", "linux x86_64".to_owned())]);
        assert_eq!(serde_json::to_string(&old).unwrap(), r#"{"os":"linux","arch":"x86_64"}"#);
    }

    #[test]
    fn wider_vectors_are_part_of_the_platform_of_networks() {
        let (plain, networks) = (Platform::here(), Platform::here().with_networks());
        let cpu = |platform: &Platform| platform.cpu.clone().unwrap();
        assert!(!cpu(&plain).contains(&"avx512".to_owned()));
        assert_eq!(cpu(&networks).contains(&"avx512".to_owned()), has_avx512());
        assert!(cpu(&networks).is_sorted());
        assert_eq!(plain == networks, !has_avx512());
    }

    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    #[test]
    fn c_library_has_a_version() {
        let libc = Platform::here().libc.unwrap();
        let version = libc.strip_prefix("glibc ").unwrap();
        assert!(version.starts_with("2.") && version.len() > 3, "{libc}");
    }
}
