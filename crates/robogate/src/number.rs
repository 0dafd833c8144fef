//! Parses numbers of the command line.

use std::num::NonZeroUsize;
use std::str::FromStr;

/// Parses a number that is not zero. The message of the standard library about 0 names a type.
pub(crate) fn at_least_one<T: FromStr>(text: &str) -> Result<T, &'static str> {
    text.parse().map_err(|_| "expected an integer of at least 1")
}

/// Parses a finite number above 0.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    let number: f64 = text.trim().parse().map_err(|_| format!("`{text}` is not a number"))?;
    if number.is_finite() && number > 0.0 { Ok(number) } else { Err("expected a number above 0".to_owned()) }
}

/// Parses a finite number of at least 0.
pub(crate) fn not_negative(text: &str) -> Result<f64, String> {
    let number: f64 = text.trim().parse().map_err(|_| format!("`{text}` is not a number"))?;
    if number.is_finite() && number >= 0.0 { Ok(number) } else { Err("expected a number of at least 0".to_owned()) }
}

/// The most threads, and the most episodes in progress: more would only use up the memory.
const MOST_THREADS: usize = 4_096;
const MOST_IN_FLIGHT: usize = 1 << 20;

/// Parses a number of threads.
pub(crate) fn threads(text: &str) -> Result<NonZeroUsize, String> {
    up_to(MOST_THREADS, text)
}

/// Parses a number of episodes in progress.
pub(crate) fn in_flight(text: &str) -> Result<NonZeroUsize, String> {
    up_to(MOST_IN_FLIGHT, text)
}

fn up_to(most: usize, text: &str) -> Result<NonZeroUsize, String> {
    let found = text.parse::<NonZeroUsize>().ok().filter(|n| n.get() <= most);
    found.ok_or_else(|| format!("expected an integer from 1 to {most}"))
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroU64;

    use super::*;

    #[test]
    fn zero_is_refused() {
        assert_eq!(threads("4097"), Err("expected an integer from 1 to 4096".to_owned()));
        assert_eq!(at_least_one::<NonZeroUsize>("1"), Ok(NonZeroUsize::MIN));
        assert_eq!(at_least_one::<NonZeroU64>("18446744073709551615"), Ok(NonZeroU64::MAX));
        for wrong in ["0", "-1", "1.5", "many", ""] {
            assert!(threads(wrong).is_err() && in_flight(wrong).is_err(), "{wrong:?}");
            assert_eq!(at_least_one::<NonZeroU64>(wrong), Err("expected an integer of at least 1"), "{wrong:?}");
        }
    }
}
