//! Parses numbers of the command line.

use std::str::FromStr;

/// Parses a number that is not zero. The message of the standard library about 0 names a type.
pub(crate) fn at_least_one<T: FromStr>(text: &str) -> Result<T, &'static str> {
    text.parse().map_err(|_| "expected an integer of at least 1")
}

#[cfg(test)]
mod tests {
    use std::num::{NonZeroU64, NonZeroUsize};

    use super::*;

    #[test]
    fn zero_is_refused() {
        assert_eq!(at_least_one::<NonZeroUsize>("1"), Ok(NonZeroUsize::MIN));
        assert_eq!(at_least_one::<NonZeroU64>("18446744073709551615"), Ok(NonZeroU64::MAX));
        for wrong in ["0", "-1", "1.5", "many", ""] {
            assert_eq!(at_least_one::<NonZeroU64>(wrong), Err("expected an integer of at least 1"), "{wrong:?}");
        }
    }
}
