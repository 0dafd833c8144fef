//! Panics of third-party libraries become errors.
//!
//! A library may panic on a damaged file or message. [`guarded`] runs it and returns the panic as a text. While it runs,
//! [`is_guarded`] tells the process's panic hook to print nothing, because the caller reports an error.

use std::any::Any;
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};

thread_local! {
    static DEPTH: Cell<u32> = const { Cell::new(0) };
}

/// Runs `work` and converts a panic into its message. What `work` changed by reference must not be used after a panic.
///
/// # Errors
/// If `work` panicked.
pub fn guarded<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    DEPTH.set(DEPTH.get() + 1);
    let result = catch_unwind(AssertUnwindSafe(work));
    DEPTH.set(DEPTH.get() - 1);
    result.map_err(|panic| message(&*panic).to_owned())
}

/// Whether this thread is inside [`guarded`].
#[must_use]
pub fn is_guarded() -> bool {
    DEPTH.get() > 0
}

/// The message of a panic.
#[must_use]
pub fn message(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("without a message")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panics_become_texts() {
        let numbers: Vec<u8> = Vec::new();
        let at = numbers.len() + 3;
        let why = guarded(|| {
            assert!(is_guarded());
            numbers[at]
        })
        .unwrap_err();
        assert!(why.contains("index out of bounds"), "{why}");
        assert!(!is_guarded());
        assert_eq!(guarded(|| guarded(|| 3)), Ok(Ok(3)));
    }
}
