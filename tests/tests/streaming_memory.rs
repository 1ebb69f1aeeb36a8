//! Memory use is independent of the length of a recording.

use std::alloc::{GlobalAlloc, Layout, System};
use std::fmt::Write;
use std::sync::atomic::{AtomicUsize, Ordering};

use model_export::recordings::align::Alignment;
use model_export::recordings::description::RecordingDescription;
use model_export::recordings::stream::AlignedStream;
use tests::{RECORDING_TOML, write_recording};

static ALLOCATED: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

struct Counting;

// SAFETY: delegates to the system's allocator; only sizes are counted.
#[allow(unsafe_code)]
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let allocated = ALLOCATED.fetch_add(layout.size(), Ordering::Relaxed) + layout.size();
        PEAK.fetch_max(allocated, Ordering::Relaxed);
        // SAFETY: as promised by the caller.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        ALLOCATED.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: as promised by the caller.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Peak memory in bytes while a recording is streamed, and its number of aligned rows.
fn peak_of(seconds: u64) -> (usize, u64) {
    let folder = tempfile::tempdir().unwrap();
    {
        let (mut hall, mut force) =
            ("t_us,s0_x_lsb,s0_y_lsb,s0_z_lsb\n".to_owned(), "t_us,f0_x_n\n".to_owned());
        for ms in 0..1000 * seconds {
            writeln!(hall, "{},{},10000,3", 1000 * ms, ms % 700).unwrap();
            if ms % 10 == 0 {
                writeln!(force, "{},{}", 1000 * ms, ms % 90).unwrap();
            }
        }
        write_recording(folder.path(), RECORDING_TOML, &hall, &force);
    }
    let before = ALLOCATED.load(Ordering::Relaxed);
    PEAK.store(before, Ordering::Relaxed);
    let (description, _) = RecordingDescription::read(folder.path()).unwrap();
    let mut stream =
        AlignedStream::open(folder.path(), &description, Alignment { delay_us: 0.0 }, 1.0).unwrap();
    let mut rows = 0;
    while stream.next_row().unwrap().is_some() {
        rows += 1;
    }
    (PEAK.load(Ordering::Relaxed) - before, rows)
}

#[test]
fn a_tenfold_length_takes_the_same_memory() {
    let (short, rows) = peak_of(10);
    let (long, ten_times_rows) = peak_of(100);
    assert_eq!((rows, ten_times_rows), (999, 9999));
    // The noise estimate stores one number per column and 200 rows: 8 B of 6.4 kB.
    let file = 100_000 * "12345000,500,10000,3\n".len();
    assert!(long < short + file / 100, "{short} and {long} bytes");
}
