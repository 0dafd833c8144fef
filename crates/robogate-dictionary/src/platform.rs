//! The platform of a run: what the bits of its results depend on beside the program.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::hex;

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
    /// Fingerprint of the mathematical functions: the first 16 hexadecimal digits of the SHA-256 over the bits of their results for
    /// fixed arguments. It differs where the C library chooses other variants than the CPU suggests, for example because of
    /// `GLIBC_TUNABLES`. Absent if it is unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub maths: Option<String>,
}

impl Platform {
    /// The platform of this process.
    pub fn here() -> Self {
        Self {
            os: std::env::consts::OS.to_owned(),
            arch: std::env::consts::ARCH.to_owned(),
            libc: libc_version(),
            cpu: cpu_features(),
            maths: Some(maths_fingerprint()),
        }
    }

    /// Whether only the mathematical functions differ: the same episodes have the same outcomes in all but rare cases, and other
    /// last bits.
    pub fn differs_in_maths_only(&self, other: &Self) -> bool {
        self.maths != other.maths && Self { maths: other.maths.clone(), ..self.clone() } == *other
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
        known.extend(self.maths.iter().map(|maths| ("mathematical functions", maths.clone())));
        known
    }
}

/// The bits of the functions of the C library whose variants differ in the last bit, as a short hash.
fn maths_fingerprint() -> String {
    /// Enough arguments for each variant that is known to differ to show it many times.
    const ARGUMENTS: u32 = 512;
    let functions: [fn(f64) -> f64; 12] = [
        f64::sin,
        f64::cos,
        f64::tan,
        |x| (x / 40.0).asin(),
        |x| (x / 40.0).acos(),
        f64::atan,
        |x| x.atan2(1.7),
        f64::exp,
        f64::ln,
        |x| x.powf(1.37),
        f64::tanh,
        f64::cbrt,
    ];
    let mut hash = Sha256::new();
    for function in functions {
        for n in 1..=ARGUMENTS {
            // Irregular arguments from 0.07 to 38.
            let x = f64::from(n) * 0.074_193_21;
            hash.update(function(std::hint::black_box(x)).to_bits().to_le_bytes());
        }
    }
    hex(&hash.finalize()).chars().take(16).collect()
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

    #[test]
    fn maths_has_one_fingerprint() {
        let here = Platform::here();
        assert_eq!(here.maths.as_deref(), Some(&*maths_fingerprint()));
        let other = Platform { maths: Some("0".repeat(16)), ..here.clone() };
        assert!(here.differs_in_maths_only(&other) && !here.differs_in_maths_only(&here));
        assert!(!here.differs_in_maths_only(&Platform { os: "plan9".to_owned(), ..other }));
    }

    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    #[test]
    fn c_library_has_a_version() {
        let libc = Platform::here().libc.unwrap();
        let version = libc.strip_prefix("glibc ").unwrap();
        assert!(version.starts_with("2.") && version.len() > 3, "{libc}");
    }
}
