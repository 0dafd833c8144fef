//! Memory that a piece of work needs, counted by the allocator.
#![expect(unsafe_code, reason = "an allocator that counts must be one")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

/// An allocator that counts the bytes of each thread. Install it in a test binary:
///
/// ```
/// #[global_allocator]
/// static MEMORY: robogate_testing::CountingAllocator = robogate_testing::CountingAllocator;
///
/// fn main() {
///     let (_, peak) = robogate_testing::peak_memory(|| vec![0_u8; 1_000_000]);
///     assert!((1_000_000..1_001_000).contains(&peak));
/// }
/// ```
///
/// An allocation of more than [`LARGEST`] bytes fails, which ends the process as on a machine with little memory.
#[derive(Debug, Clone, Copy)]
pub struct CountingAllocator;

/// The largest single allocation that a test may make, in bytes.
pub const LARGEST: usize = 1 << 30;

thread_local! {
    static LIVE: Cell<isize> = const { Cell::new(0) };
    static PEAK: Cell<isize> = const { Cell::new(0) };
}

fn add(bytes: isize) {
    // A thread that ends frees memory after its counters are gone.
    let _ = LIVE.try_with(|live| {
        live.set(live.get() + bytes);
        let _ = PEAK.try_with(|peak| peak.set(peak.get().max(live.get())));
    });
}

fn admit(bytes: usize) -> bool {
    bytes <= LARGEST
}

// SAFETY: all calls go to the system's allocator unchanged, or fail; the counters are thread-local numbers.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if !admit(layout.size()) {
            return std::ptr::null_mut();
        }
        add(layout.size().cast_signed());
        // SAFETY: the caller fulfils the contract.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        if !admit(layout.size()) {
            return std::ptr::null_mut();
        }
        add(layout.size().cast_signed());
        // SAFETY: the caller fulfils the contract.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        if !admit(size) {
            return std::ptr::null_mut();
        }
        // Old and new bytes may exist at the same time.
        add(size.cast_signed());
        add(-layout.size().cast_signed());
        // SAFETY: the caller fulfils the contract.
        unsafe { System.realloc(pointer, layout, size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        add(-layout.size().cast_signed());
        // SAFETY: the caller fulfils the contract.
        unsafe { System.dealloc(pointer, layout) }
    }
}

/// Runs `work` and returns its result with the most bytes that this thread held in addition to those before.
///
/// # Panics
/// If nothing is counted, because [`CountingAllocator`] is not installed.
pub fn peak_memory<T>(work: impl FnOnce() -> T) -> (T, usize) {
    let probe = |bytes: usize| std::hint::black_box(Vec::<u8>::with_capacity(bytes)).capacity();
    PEAK.set(LIVE.get());
    let before = LIVE.get();
    assert!(probe(64) >= 64 && PEAK.get() > before, "the counting allocator is not installed");
    PEAK.set(before);
    let result = work();
    (result, (PEAK.get() - before).unsigned_abs())
}
