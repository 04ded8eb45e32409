//! How much memory there is, where the system tells (Linux).

/// Bytes that can be had.
pub fn free() -> Option<usize> {
    bytes("/proc/meminfo", "MemAvailable:")
}

/// The most bytes that this process has had.
pub fn most() -> Option<usize> {
    bytes("/proc/self/status", "VmHWM:")
}

fn bytes(path: &str, key: &str) -> Option<usize> {
    let text = std::fs::read_to_string(path).ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix(key))?;
    line.trim().strip_suffix("kB")?.trim().parse::<usize>().ok().map(|kb| kb << 10)
}
