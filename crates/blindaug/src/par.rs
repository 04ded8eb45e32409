//! Loops over rows or items: shared among rayon's threads with the feature `threads`, plain loops without it.
//! Each item is computed by itself, so results do not depend on the number of threads.

#[cfg(feature = "threads")]
use rayon::prelude::*;

/// The number of elements up to which rows are not shared among threads: handing them out would take longer than most loops.
#[cfg(feature = "threads")]
const TOO_SMALL_TO_SHARE: usize = 4096;

/// Calls `f(y, row)` for each row of `width` elements of `data`.
pub(crate) fn for_each_row<T: Send>(data: &mut [T], width: usize, f: impl Fn(usize, &mut [T]) + Sync + Send) {
    if width == 0 {
        return;
    }
    #[cfg(feature = "threads")]
    if data.len() > TOO_SMALL_TO_SHARE {
        data.par_chunks_mut(width).enumerate().for_each(|(y, row)| f(y, row));
        return;
    }
    data.chunks_mut(width).enumerate().for_each(|(y, row)| f(y, row));
}

/// `[f(0), f(1), .., f(n - 1)]`, in that order.
pub(crate) fn map<R: Send>(n: usize, f: impl Fn(usize) -> R + Sync + Send) -> Vec<R> {
    #[cfg(feature = "threads")]
    return (0..n).into_par_iter().map(f).collect();
    #[cfg(not(feature = "threads"))]
    (0..n).map(f).collect()
}

/// The number of bytes up to which fresh memory is written by one thread. The system clears each page at the first write to it, for which one
/// thread would have all others wait.
#[cfg(feature = "threads")]
const LARGE: usize = 1 << 20;

/// `n` times `value`.
pub(crate) fn filled<T: Copy + Send + Sync>(n: usize, value: T) -> Vec<T> {
    #[cfg(feature = "threads")]
    if n.saturating_mul(size_of::<T>()) > LARGE {
        return rayon::iter::repeat_n(value, n).collect();
    }
    vec![value; n]
}

/// A copy of `data`.
pub(crate) fn copied<T: Copy + Send + Sync>(data: &[T]) -> Vec<T> {
    #[cfg(feature = "threads")]
    if size_of_val(data) > LARGE {
        return data.par_iter().copied().collect();
    }
    data.to_vec()
}

/// `(a(), b())`.
pub(crate) fn both<A: Send, B: Send>(a: impl FnOnce() -> A + Send, b: impl FnOnce() -> B + Send) -> (A, B) {
    #[cfg(feature = "threads")]
    return rayon::join(a, b);
    #[cfg(not(feature = "threads"))]
    (a(), b())
}

/// Runs `f` on one of the pool's threads, so that many short loops in `f` start without a change of thread.
pub(crate) fn within<R: Send>(f: impl FnOnce() -> R + Send) -> R {
    both(f, || ()).0
}
