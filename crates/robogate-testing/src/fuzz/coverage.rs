//! Which code an input reached. `scripts/fuzz.sh` compiles the readers with counters of their branches and links the functions
//! that evaluate them (`scripts/fuzz/coverage.c`). Other builds count nothing.

/// Whether the branches are counted.
pub(super) const IS_COUNTED: bool = cfg!(robogate_coverage);

/// Whether code was reached since the last call that no earlier call knew, or code in a loop much more often. Counting starts again.
#[cfg(robogate_coverage)]
pub(super) fn grew() -> bool {
    #[expect(unsafe_code, reason = "the compiler cannot see the function: scripts/fuzz/coverage.c")]
    unsafe extern "C" {
        safe fn robogate_coverage_grew() -> i32;
    }
    robogate_coverage_grew() != 0
}

/// Nothing is counted.
#[cfg(not(robogate_coverage))]
pub(super) fn grew() -> bool {
    false
}
